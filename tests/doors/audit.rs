//! The audit log: every administrative act writes an entry in the transaction of its change, and so
//! do refused calls.

use std::process::Command;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::clock::Clock;
use graphfix::contract::access::CALLS;
use graphfix::contract::v1;
use graphfix::grpc::longrunning::DeleteOperationRequest;
use graphfix::grpc::longrunning::operations_client::OperationsClient;
use graphfix::grpc::v1::audit_client::AuditClient;
use graphfix::session::{SessionLimits, Sessions};
use graphfix::store::AuditFilter;
use serde_json::{Value, json};
use sqlx::{Connection, PgConnection, SqliteConnection};
use tonic::Status;
use tower::ServiceExt;

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code, epoch};
use crate::support::jobs::{BOUNDARY, MINUTE, body};
use crate::support::wait::until;

use super::tenants::world::{Key, asked, base, get, key_of, marker, operator, session, uploaded};

on_both_databases!(
    each_act_leaves_an_entry,
    an_act_without_an_entry_is_not_done,
    refused_calls_leave_entries,
    a_tenant_reads_its_own_entries,
    the_log_comes_in_pages,
    entries_are_removed_by_age_and_never_changed,
    commands_leave_entries,
);

/// A password at a caster, which must not appear in the log.
const PASSWORD: &str = "word-of-the-caster";

/// The entries that a key reads, with these parameters of the call.
async fn entries(doors: &Doors, key: &Key, query: &str) -> Vec<Value> {
    let answer = get(doors, key, &format!("/v1/audit?pageSize=1000{query}")).await;
    assert_eq!(answer["nextPageToken"], "", "{answer}");
    answer["entries"].as_array().unwrap().clone()
}

/// An entry without its id and time, and without the request and node.
fn short(entry: &Value) -> [&str; 5] {
    ["tenant", "actor", "call", "object", "outcome"].map(|field| entry[field].as_str().unwrap())
}

fn shorts(entries: &[Value]) -> Vec<[&str; 5]> {
    entries.iter().map(short).collect()
}

async fn ok(doors: &Doors, key: &Key, method: &str, path: &str, body: Value) -> Value {
    let (status, answer) = asked(doors, key, method, path, body).await;
    assert!(status.is_success(), "{method} {path}: {answer}");
    answer
}

/// Does one act with this key. Returns the id of the object of the act.
async fn done(doors: &Doors, key: &Key, act: &str) -> String {
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let new_session = async || {
        let id = session(doors, key, json!({"label": "rover"})).await;
        let push = json!({"epochs": [epoch(1)]});
        ok(doors, key, "POST", &format!("/v1/sessions/{id}/epochs"), push).await;
        id
    };
    let new_key = async || {
        let new = json!({"rights": ["read"], "label": "screen", "lifetimeS": 3600});
        text(&ok(doors, key, "POST", "/v1/keys", new).await["key"]["key"])
    };
    let caster = json!({"caster": "http://127.0.0.1:1", "mountpoint": "ROOF", "user": "field",
                        "password": PASSWORD});
    match act {
        "Keys.Create" => new_key().await,
        "Keys.Revoke" => {
            let id = new_key().await;
            ok(doors, key, "DELETE", &format!("/v1/keys/{id}"), Value::Null).await;
            id
        }
        "Tenants.Set" => {
            let quotas = json!({"quotas": {"sessions": 7}});
            ok(doors, key, "PUT", "/v1/tenants/fleet", quotas).await;
            "fleet".to_owned()
        }
        "Bases.Create" => base(doors, key, json!({"label": "roof", "ntrip": caster})).await,
        "Bases.Delete" => {
            let id = base(doors, key, json!({"label": "roof", "marker": marker()})).await;
            ok(doors, key, "DELETE", &format!("/v1/bases/{id}"), Value::Null).await;
            id
        }
        "Navigation.Push" => {
            let answer = uploaded(doors, key, "/v1/navigation", &MINUTE.navigation).await;
            assert_eq!(answer.status, StatusCode::OK, "{}", answer.text);
            String::new()
        }
        "Sessions.Update" => {
            let id = new_session().await;
            let change = json!({"label": "boat", "retentionDays": 3});
            ok(doors, key, "PATCH", &format!("/v1/sessions/{id}"), change).await;
            id
        }
        "Sessions.Reset" => {
            let id = new_session().await;
            ok(doors, key, "POST", &format!("/v1/sessions/{id}:reset"), json!({})).await;
            id
        }
        "Sessions.Close" => {
            let id = new_session().await;
            ok(doors, key, "DELETE", &format!("/v1/sessions/{id}"), Value::Null).await;
            id
        }
        "Sessions.Delete" => {
            let id = new_session().await;
            let path = format!("/v1/sessions/{id}");
            ok(doors, key, "DELETE", &path, Value::Null).await;
            ok(doors, key, "DELETE", &format!("{path}?purge=true"), Value::Null).await;
            id
        }
        "Jobs.Delete" => {
            let path = format!("/v1/jobs/{}", job(doors, key).await);
            ok(doors, key, "DELETE", &path, Value::Null).await;
            let purge = format!("{path}?purge=true");
            text(&ok(doors, key, "DELETE", &purge, Value::Null).await["job"])
        }
        "Operations.DeleteOperation" => {
            let id = job(doors, key).await;
            ok(doors, key, "DELETE", &format!("/v1/jobs/{id}"), Value::Null).await;
            deleted_job(doors, key, &id).await.unwrap();
            id
        }
        other => panic!("{other} has no case"),
    }
}

/// Creates a job.
async fn job(doors: &Doors, key: &Key) -> String {
    let parts: [(&str, &[u8]); 2] = [("rover", &MINUTE.rover), ("navigation", &MINUTE.navigation)];
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let request = Request::post("/v1/jobs").header("content-type", kind);
    let request = request.header("authorization", format!("Bearer {}", key.secret));
    let (status, job) = doors.ask(request.body(Body::from(body(&parts))).unwrap()).await;
    assert_eq!(status, StatusCode::CREATED, "{job}");
    job["job"].as_str().unwrap().to_owned()
}

/// Deletes a job that has ended.
async fn deleted_job(doors: &Doors, key: &Key, id: &str) -> Result<(), Status> {
    let mut request = tonic::Request::new(DeleteOperationRequest { name: id.to_owned() });
    let bearer = format!("Bearer {}", key.secret).parse().unwrap();
    request.metadata_mut().insert("authorization", bearer);
    let mut client = OperationsClient::new(doors.router.clone());
    client.delete_operation(request).await.map(drop)
}

/// The description of the change in the entry of each act.
fn expected_change(act: &str) -> &'static str {
    match act {
        "Keys.Create" => "rights read, label \"screen\", for 3600 s",
        "Keys.Revoke" => "label \"screen\"",
        "Tenants.Set" => "sessions none → 7",
        "Bases.Create" => "label \"roof\", caster http://127.0.0.1:1 stream \"ROOF\"",
        "Bases.Delete" => "label \"roof\"",
        "Navigation.Push" => "ephemerides, ",
        "Sessions.Update" => "label \"rover\" → \"boat\", retentionDays the service's → 3",
        "Sessions.Delete" => "label \"rover\"",
        "Jobs.Delete" | "Operations.DeleteOperation" => "state ",
        _ => "",
    }
}

async fn each_act_leaves_an_entry(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let first = entries(&doors, &operator, "").await;
    let opened = ["default", "loopback", "Keys.Create", &operator.id, "DONE"];
    assert_eq!(shorts(&first), [opened], "the key that ended the time without keys");
    let acts: Vec<&str> = CALLS.iter().filter_map(|call| call.act).collect();
    assert_eq!(acts.len(), 12);
    for act in acts {
        let object = done(&doors, &operator, act).await;
        let newest = entries(&doors, &operator, "").await.remove(0);
        let tenant = if act == "Tenants.Set" { "fleet" } else { "default" };
        assert_eq!(short(&newest), [tenant, &operator.id, act, &object, "DONE"]);
        let change = newest["change"].as_str().unwrap();
        assert!(change.contains(expected_change(act)), "{act}: {change}");
        if !object.is_empty() {
            let query = format!("&call={act}&object={object}");
            assert_eq!(entries(&doors, &operator, &query).await.len(), 1, "{act}");
        }
        assert_eq!(newest["request"].as_str().unwrap().len(), 36);
        assert_eq!(newest["node"], json!(node(&doors).await));
    }
    // A call that changes nothing writes no entry, like a second revocation of a key.
    let id = done(&doors, &operator, "Keys.Revoke").await;
    ok(&doors, &operator, "DELETE", &format!("/v1/keys/{id}"), Value::Null).await;
    assert_eq!(entries(&doors, &operator, &format!("&object={id}")).await.len(), 2);
    let id = done(&doors, &operator, "Sessions.Update").await;
    for change in [json!({}), json!({"label": "boat"}), json!({"clearOverrides": ["window_s"]})] {
        ok(&doors, &operator, "PATCH", &format!("/v1/sessions/{id}"), change).await;
    }
    assert_eq!(entries(&doors, &operator, &format!("&object={id}")).await.len(), 1);
    done(&doors, &operator, "Tenants.Set").await; // The same quotas again.
    assert_eq!(entries(&doors, &operator, "&object=fleet").await.len(), 1);
    let log = Value::from(entries(&doors, &operator, "").await).to_string();
    for secret in [&*operator.secret, "gfx_", PASSWORD] {
        assert!(!log.contains(secret), "{secret} is in {log}");
    }
    let restarted = doors.restarted().await;
    assert_eq!(Value::from(entries(&restarted, &operator, "").await).to_string(), log);
    restarted.close().await;
}

/// The name of the node that answers; entries must have the same name.
async fn node(doors: &Doors) -> String {
    let request = Request::get("/healthz").body(Body::empty()).unwrap();
    let answer = doors.router.clone().oneshot(request).await.unwrap();
    answer.headers()["x-graphfix-node"].to_str().unwrap().to_owned()
}

/// While the log accepts no entry, no act is done. Afterwards each act is done once.
async fn an_act_without_an_entry_is_not_done(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let kept = base(&doors, &operator, json!({"label": "roof", "marker": marker()})).await;
    let id = session(&doors, &operator, json!({"label": "rover"})).await;
    let path = format!("/v1/sessions/{id}");
    let push = json!({"epochs": [epoch(1), epoch(2)]});
    ok(&doors, &operator, "POST", &format!("{path}/epochs"), push).await;
    let closed = session(&doors, &operator, json!({})).await;
    ok(&doors, &operator, "DELETE", &format!("/v1/sessions/{closed}"), Value::Null).await;
    let acts = [
        ("POST", "/v1/keys".to_owned(), json!({"rights": ["read"]})),
        ("PUT", "/v1/tenants/fleet".to_owned(), json!({"quotas": {"sessions": 1}})),
        ("POST", "/v1/bases".to_owned(), json!({"label": "new", "marker": marker()})),
        ("DELETE", format!("/v1/bases/{kept}"), Value::Null),
        ("DELETE", format!("/v1/sessions/{closed}?purge=true"), Value::Null),
        ("PATCH", path.clone(), json!({"label": "boat"})),
        ("POST", format!("{path}:reset"), json!({})),
    ];
    let ended = job(&doors, &operator).await;
    ok(&doors, &operator, "DELETE", &format!("/v1/jobs/{ended}"), Value::Null).await;
    let things = async || {
        let mut things = Vec::new();
        for (path, list, passing) in [
            ("/v1/tenants", "tenants", "used"),
            ("/v1/bases", "bases", "ageS"),
            ("/v1/sessions", "sessions", ""),
        ] {
            let mut answer = get(&doors, &operator, path).await;
            for item in answer[list].as_array_mut().unwrap() {
                item.as_object_mut().unwrap().remove(passing);
            }
            things.push(answer);
        }
        things.push(json!(database.count("api_keys").await));
        things.push(json!(database.count("session_arcs").await));
        things.push(json!(database.count("jobs").await));
        things
    };
    let before = things().await;
    database.execute("ALTER TABLE audit_entries RENAME TO taken_away").await;
    for (method, path, body) in &acts {
        let (status, answer) = asked(&doors, &operator, method, path, body.clone()).await;
        let failed = (StatusCode::SERVICE_UNAVAILABLE, "DATABASE_FAILED");
        assert_eq!((status, code(&answer)), failed, "{method} {path}: {answer}");
    }
    let failed = deleted_job(&doors, &operator, &ended).await.unwrap_err();
    assert_eq!(graphfix::grpc::code_of(&failed).as_deref(), Some("DATABASE_FAILED"));
    assert_eq!(things().await, before);
    database.execute("ALTER TABLE taken_away RENAME TO audit_entries").await;
    for (method, path, body) in &acts {
        let ask = async || asked(&doors, &operator, method, path, body.clone()).await;
        until("done", ask, |(status, _)| status.is_success()).await;
    }
    let log = entries(&doors, &operator, "").await;
    let calls: Vec<&str> = log.iter().rev().skip(3).map(|entry| short(entry)[2]).collect();
    let expected = [
        "Keys.Create",
        "Tenants.Set",
        "Bases.Create",
        "Bases.Delete",
        "Sessions.Delete",
        "Sessions.Update",
        "Sessions.Reset",
    ];
    assert_eq!(calls, expected);
    assert_eq!(database.count("session_arcs").await, 1);
    doors.close().await;
}

async fn refused_calls_leave_entries(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let acme = key_of(&doors, &operator, "acme", "").await;
    let limited = async |rights: &[&str]| {
        let new = json!({"rights": rights, "tenant": "acme"});
        let answer = ok(&doors, &operator, "POST", "/v1/keys", new).await;
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        Key { id: text(&answer["key"]["key"]), secret: text(&answer["secret"]) }
    };
    let (reader, device) = (limited(&["read"]).await, limited(&["device"]).await);
    let revoked = limited(&["admin"]).await;
    ok(&doors, &operator, "DELETE", &format!("/v1/keys/{}", revoked.id), Value::Null).await;
    let roof = base(&doors, &acme, json!({"marker": marker()})).await;
    session(&doors, &acme, json!({"mode": "rtk-fgo", "base": roof})).await;
    let tracked = session(&doors, &device, json!({})).await;
    let wrong = Key { id: String::new(), secret: format!("gfx_{}", "0".repeat(64)) };
    let before = entries(&doors, &operator, "").await.len();

    let new = json!({"rights": ["read"]});
    let by_secret = format!("/v1/keys/{}", operator.secret);
    let of_operator = format!("/v1/keys/{}", operator.id);
    let used = format!("/v1/bases/{roof}");
    let reset = format!("/v1/sessions/{tracked}:reset");
    let refused = [
        (&wrong, "POST", "/v1/keys", ["Keys.Create", "", "KEY_INVALID"]),
        (&revoked, "POST", "/v1/keys", ["Keys.Create", "", "KEY_REVOKED"]),
        (&reader, "POST", "/v1/keys", ["Keys.Create", "", "RIGHT_MISSING"]),
        (&acme, "PUT", "/v1/tenants/b", ["Tenants.Set", "", "OPERATOR_ONLY"]),
        (&acme, "DELETE", &*of_operator, ["Keys.Revoke", "", "KEY_NOT_FOUND"]),
        (&acme, "DELETE", &*by_secret, ["Keys.Revoke", "", "KEY_NOT_FOUND"]),
        (&acme, "DELETE", &*used, ["Bases.Delete", &roof, "BASE_IN_USE"]),
    ];
    let mut expected = Vec::new();
    for (key, method, path, [call, object, refusal]) in refused {
        let body = if method == "POST" { new.clone() } else { json!({"quotas": {}}) };
        let (status, answer) = asked(&doors, key, method, path, body).await;
        assert!(status.is_client_error(), "{method} {path}: {answer}");
        assert_eq!(code(&answer), refusal, "{method} {path}");
        let (tenant, actor) =
            if key.id.is_empty() { ("default", "unknown") } else { ("acme", &*key.id) };
        expected.insert(0, [tenant, actor, call, object, refusal]);
    }
    // Calls of a device on a session are no administrative acts, also when they are refused.
    for key in [&device, &reader, &wrong] {
        asked(&doors, key, "POST", &reset, json!({})).await;
    }
    asked(&doors, &device, "POST", "/v1/sessions/ses_1:reset", json!({})).await;
    let (status, _) = doors.post("/v1/keys", new.clone()).await;
    assert_eq!(status, StatusCode::UNAUTHORIZED);
    expected.insert(0, ["default", "unknown", "Keys.Create", "", "KEY_REQUIRED"]);
    let log = entries(&doors, &operator, "").await;
    assert_eq!(shorts(&log[..log.len() - before]), expected);
    assert!(!Value::from(log).to_string().contains("gfx_"));

    // Repeated refusals do not fill the log.
    for _ in 0..40 {
        asked(&doors, &wrong, "POST", "/v1/keys", new.clone()).await;
    }
    let unknown = entries(&doors, &operator, "&actor=unknown").await;
    assert_eq!(unknown.len(), 20);
    asked(&doors, &reader, "POST", "/v1/keys", new).await;
    let of_reader = entries(&doors, &operator, &format!("&actor={}", reader.id)).await;
    assert_eq!(of_reader.len(), 2, "others are not left out");
    doors.close().await;
}

async fn a_tenant_reads_its_own_entries(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let acme = key_of(&doors, &operator, "acme", "").await;
    let other = key_of(&doors, &operator, "other", "").await;
    for key in [&acme, &other, &operator] {
        done(&doors, key, "Bases.Delete").await;
    }
    let log = entries(&doors, &acme, "").await;
    let by_operator = ["acme", "operator", "Keys.Create", &acme.id, "DONE"];
    assert_eq!(log.len(), 3, "{log:?}");
    assert_eq!(short(&log[2]), by_operator);
    assert_eq!((&log[2]["request"], &log[2]["node"]), (&json!(""), &json!("")));
    assert!(log.iter().all(|entry| entry["tenant"] == "acme"), "{log:?}");
    let hidden = [&operator.id, &other.id, "other"];
    let text = Value::from(log.clone()).to_string();
    assert!(hidden.iter().all(|trace| !text.contains(*trace)), "{text}");

    let count = async |query: &str| entries(&doors, &acme, query).await.len();
    assert_eq!(count(&format!("&actor={}", operator.id)).await, 0, "an id is not guessed");
    assert_eq!(count("&actor=operator").await, 1);
    assert_eq!(count(&format!("&actor={}", acme.id)).await, 2);
    assert_eq!(count("&tenant=acme").await, 3);
    let (status, answer) = asked(&doors, &acme, "GET", "/v1/audit?tenant=other", Value::Null).await;
    assert_eq!((status, code(&answer)), (StatusCode::FORBIDDEN, "OPERATOR_ONLY"));

    // The operator sees the entries of all tenants or of one. It also sees the id of its own key.
    let all = entries(&doors, &operator, "").await;
    assert_eq!(all.len(), 9, "{all:?}");
    let of_acme = entries(&doors, &operator, "&tenant=acme").await;
    assert_eq!(short(&of_acme[2]), ["acme", &operator.id, "Keys.Create", &acme.id, "DONE"]);
    let whole = get(&doors, &operator, "/v1/audit?pageSize=2").await;
    let token = whole["nextPageToken"].as_str().unwrap();
    let (_, answer) =
        asked(&doors, &acme, "GET", &format!("/v1/audit?pageToken={token}"), Value::Null).await;
    assert_eq!(code(&answer), "PAGE_TOKEN_INVALID", "it is after an entry of another tenant");
    doors.close().await;
}

async fn the_log_comes_in_pages(database: Database) {
    let doors = Doors::on(&database.url).await;
    for label in ["a", "b", "c", "d", "e"] {
        let (_, base) = doors.post("/v1/bases", json!({"label": label, "marker": marker()})).await;
        let path = format!("/v1/bases/{}", base["base"].as_str().unwrap());
        doors.send("DELETE", &path, Value::Null).await;
    }
    doors.send("DELETE", "/v1/bases/bas_1", Value::Null).await;
    let read = async |query: &str| doors.get(&format!("/v1/audit?{query}")).await.1;
    let whole = read("").await["entries"].as_array().unwrap().clone();
    assert_eq!(whole.len(), 11);
    for (order, reversed) in [("NEWEST_FIRST", false), ("OLDEST_FIRST", true)] {
        let (mut pages, mut token) = (Vec::new(), String::new());
        loop {
            let page = read(&format!("pageSize=4&order={order}&pageToken={token}")).await;
            let entries = page["entries"].as_array().unwrap().clone();
            assert!(entries.len() <= 4);
            pages.extend(entries);
            token = page["nextPageToken"].as_str().unwrap().to_owned();
            if token.is_empty() {
                break;
            }
        }
        if reversed {
            pages.reverse();
        }
        assert_eq!(pages, whole, "{order}");
    }
    let count = async |query: &str| read(query).await["entries"].as_array().unwrap().len();
    assert_eq!(count("call=Bases.Create").await, 5);
    assert_eq!(count("refused=true").await, 1);
    assert_eq!(count("refused=false&call=Bases.Delete").await, 5);
    assert_eq!(count(&format!("object={}", whole[1]["object"].as_str().unwrap())).await, 2);
    let third = whole[8]["createdUtc"].as_str().unwrap();
    let (until, from) =
        (count(&format!("toUtc={third}")).await, count(&format!("fromUtc={third}")).await);
    assert!(until <= 2 && until + from == 11, "{until} and {from}");
    assert_eq!(count("fromUtc=2100-01-01T00:00:00Z").await, 0);
    for (query, field) in [
        ("fromUtc=yesterday", "fromUtc"),
        ("toUtc=2026-02-30T00:00:00Z", "toUtc"),
        ("order=RANDOM", "order"),
        ("pageSize=1001", "pageSize"),
    ] {
        let answer = read(query).await;
        assert_eq!(answer["field"], *field, "{query}: {answer}");
    }
    let mut client = AuditClient::new(doors.router.clone());
    let request = v1::ListAuditRequest { page_size: 11, ..Default::default() };
    let answer = client.list(request).await.unwrap().into_inner();
    assert_eq!(serde_json::to_value(&answer.entries).unwrap(), Value::from(whole));
    doors.close().await;
}

/// Runs SQL directly on the database, and returns the error with which it is refused.
async fn refused_by(database: &Database, sql: &str) -> String {
    let refused = if database.url.starts_with("sqlite") {
        let mut connection = SqliteConnection::connect(&database.url).await.unwrap();
        sqlx::query(sql).execute(&mut connection).await.map(drop)
    } else {
        let mut connection = PgConnection::connect(&database.url).await.unwrap();
        sqlx::query(sql).execute(&mut connection).await.map(drop)
    };
    refused.unwrap_err().to_string()
}

async fn entries_are_removed_by_age_and_never_changed(database: Database) {
    const MS_PER_DAY: i64 = 86_400_000;
    // 2026-01-01 12:00 UTC.
    let now = (20_454 * 2 + 1) * MS_PER_DAY / 2;
    let store = database.store().await;
    let row = |number: i64| {
        let unix_ms = now - number * MS_PER_DAY / 100;
        let act = "'default', 'loopback', 'default', 'Keys.Create', '', 'DONE', '', 'n', ''";
        format!("('aud_{number}', {unix_ms}, {act})")
    };
    // A hundred entries a day, for twelve days.
    let rows: Vec<String> = (0..1200).map(row).collect();
    let insert = "INSERT INTO audit_entries (id, unix_ms, tenant, actor, actor_tenant, call, \
                  object, outcome, request, node, change) VALUES";
    database.execute(&format!("{insert} {}", rows.join(", "))).await;
    // Whole days are kept, and the half of the present day that has passed.
    for (audit_days, kept) in [(0, 1200), (3, 351), (2, 251)] {
        let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
        let limits = SessionLimits { audit_days, ..SessionLimits::service() };
        let sessions = Sessions::open_at(store.clone(), aiding, limits, Clock::at(now));
        sessions.remove_expired().await.unwrap();
        assert_eq!(database.count("audit_entries").await, kept, "{audit_days} days");
        sessions.drain().await;
    }
    let update = "UPDATE audit_entries SET actor = 'nobody' WHERE id = 'aud_1'";
    let refused = refused_by(&database, update).await;
    assert!(refused.contains("entries of the audit log are not changed"), "{refused}");
    let page = store.audit(&AuditFilter::all(), 1000, None).await.unwrap();
    assert!(page.items.iter().all(|entry| entry.author.actor == "loopback"));
    store.close().await;
}

/// Commands write entries, too, and print the log.
async fn commands_leave_entries(database: Database) {
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.args(arguments).args(["--database", &database.url]);
        let output = command.output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{arguments:?}: {errors}");
        String::from_utf8(output.stdout).unwrap()
    };
    let id = |text: &str| text.split(' ').next().unwrap().to_owned();
    let first = run(&["keys", "create", "--right", "admin", "--tenant", "acme"]);
    let second = run(&["keys", "rotate", &id(&first), "--overlap", "0"]);
    run(&["keys", "revoke", &id(&second)]);
    run(&["tenants", "set", "acme", "--sessions", "5"]);
    let log = run(&["keys", "audit"]);
    let lines: Vec<&str> = log.lines().map(|line| line.split_once(' ').unwrap().1).collect();
    let (first, second) = (id(&first), id(&second));
    let expected = [
        "acme command-line Tenants.Set DONE [acme] sessions none → 5".to_owned(),
        format!("acme command-line Keys.Revoke DONE [{second}] label \"\""),
        format!(
            "acme command-line Keys.Rotate DONE [{second}] rights admin, label \"\", \
             until it is revoked, in place of {first}"
        ),
        format!(
            "acme command-line Keys.Create DONE [{first}] rights admin, label \"\", \
             until it is revoked"
        ),
    ];
    assert_eq!(lines, expected);
    assert_eq!(run(&["keys", "audit", "--count", "1"]).lines().count(), 1);
    assert_eq!(run(&["keys", "audit", "--tenant", "default"]), "");
}
