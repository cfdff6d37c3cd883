//! Quotas of tenants: refusals have code, limit and delay; changes are in force at once; use is
//! counted by tenant.

use std::process::Command;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use futures::future::join_all;
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use serde_json::{Value, json};
use tonic::Code as Status;
use tonic::service::interceptor::InterceptedService;
use tonic_types::StatusExt;

use crate::support::data;
use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code, epoch};
use crate::support::jobs::MINUTE;
use crate::support::pair::PAIR;
use crate::support::streams::unpacked;
use crate::support::wait::until;

use super::jobs::post;
use super::tenants::world::{Key, asked, get, key_of, operator, session, uploaded};

on_both_databases!(
    a_tenant_has_no_more_sessions_than_its_quota,
    epochs_are_refused_by_each_quota,
    raw_bytes_that_arrive_at_once_stay_within_the_quota,
    refused_raw_bytes_count_towards_no_quota,
    refused_epochs_count_towards_no_quota,
    files_of_jobs_are_refused_by_their_quota,
    the_operator_sets_quotas_beside_the_service,
);

async fn set(doors: &Doors, operator: &Key, tenant: &str, quotas: Value) {
    let path = format!("/v1/tenants/{tenant}");
    let (status, answer) = asked(doors, operator, "PUT", &path, json!({"quotas": quotas})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    for (name, quota) in answer["quotas"].as_object().unwrap() {
        assert_eq!(quota, &quotas[name], "{name}");
    }
}

async fn a_tenant_has_no_more_sessions_than_its_quota(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let (a, b) =
        (key_of(&doors, &operator, "a", "").await, key_of(&doors, &operator, "b", "").await);
    set(&doors, &operator, "a", json!({"sessions": 2})).await;
    let first = session(&doors, &a, json!({})).await;
    session(&doors, &a, json!({})).await;
    let (status, refused) = asked(&doors, &a, "POST", "/v1/sessions", json!({})).await;
    assert_eq!(status, StatusCode::TOO_MANY_REQUESTS);
    assert_eq!(refused["code"], "SESSION_QUOTA_EXCEEDED");
    assert!(refused["detail"].as_str().unwrap().contains("quota is 2"), "{refused}");
    assert!(refused["retryAfterMs"].is_u64(), "{refused}");
    let secret = a.secret.clone();
    let bearer = move |mut request: tonic::Request<()>| {
        request.metadata_mut().insert("authorization", format!("Bearer {secret}").parse().unwrap());
        Ok(request)
    };
    let wire = InterceptedService::new(doors.router.clone(), bearer);
    let create = v1::CreateSessionRequest::default();
    let status = SessionsClient::new(wire).create(create).await.unwrap_err();
    assert_eq!(status.code(), Status::ResourceExhausted);
    assert_eq!(code_of(&status).as_deref(), Some("SESSION_QUOTA_EXCEEDED"));
    assert!(status.get_error_details().retry_info().is_some());
    session(&doors, &b, json!({})).await;

    let doors = doors.restarted().await;
    let (status, _) = asked(&doors, &a, "POST", "/v1/sessions", json!({})).await;
    assert_eq!(status, StatusCode::TOO_MANY_REQUESTS, "the quota is stored");
    let purge = format!("/v1/sessions/{first}?purge=true");
    assert_eq!(asked(&doors, &a, "DELETE", &purge, Value::Null).await.0, StatusCode::OK);
    session(&doors, &a, json!({})).await;
    assert_eq!(get(&doors, &a, "/v1/tenants/a").await["used"]["sessions"], 2);
    doors.close().await;
}

async fn epochs_are_refused_by_each_quota(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let (a, b) =
        (key_of(&doors, &operator, "a", "").await, key_of(&doors, &operator, "b", "").await);
    let (of_a, of_b) = (session(&doors, &a, json!({})).await, session(&doors, &b, json!({})).await);
    let mut seq = 0;
    let mut push = async |key: &Key, session: &str| {
        seq += 1;
        let path = format!("/v1/sessions/{session}/epochs");
        let (status, answer) =
            asked(&doors, key, "POST", &path, json!({"epochs": [epoch(seq)]})).await;
        let code = answer["code"].as_str().unwrap_or_default().to_owned();
        assert_eq!(status == StatusCode::TOO_MANY_REQUESTS, answer["retryAfterMs"].is_u64());
        (status, code)
    };
    let taken = (StatusCode::OK, String::new());
    assert_eq!(push(&a, &of_a).await, taken);
    for (quotas, code) in [
        (json!({"epochsPerS": 0.0}), "EPOCH_QUOTA_EXCEEDED"),
        (json!({"cpuSPerMinute": 0.0}), "CPU_QUOTA_EXCEEDED"),
        (json!({"storedBytes": 1}), "STORAGE_QUOTA_EXCEEDED"),
    ] {
        set(&doors, &operator, "a", quotas).await;
        let refused = (StatusCode::TOO_MANY_REQUESTS, code.to_owned());
        assert_eq!(push(&a, &of_a).await, refused);
        assert_eq!(push(&b, &of_b).await, taken, "of another tenant");
        let raw = format!("/v1/sessions/{of_a}/raw?offset=0");
        let answer = super::tenants::world::uploaded(&doors, &a, &raw, &[0xb5, 0x62]).await;
        assert_eq!(answer.refusal.unwrap().0, code);
        let solve = json!({"mode": "spp"});
        let path = format!("/v1/sessions/{of_a}:solve");
        let (status, answer) = asked(&doors, &a, "POST", &path, solve).await;
        let is_of_cpu = code == "CPU_QUOTA_EXCEEDED";
        assert_eq!(status == StatusCode::TOO_MANY_REQUESTS, is_of_cpu, "{answer}");
        let path = format!("/v1/sessions/{of_a}/solutions:residuals");
        let (status, answer) = asked(&doors, &a, "GET", &path, Value::Null).await;
        assert_eq!(status == StatusCode::TOO_MANY_REQUESTS, is_of_cpu, "{answer}");
        set(&doors, &operator, "a", json!({})).await;
        assert_eq!(push(&a, &of_a).await, taken);
    }
    let used = get(&doors, &operator, "/v1/tenants/a").await["used"].clone();
    assert!(0.0 < used["cpuSPerMinute"].as_f64().unwrap(), "{used}");
    assert!(used["storedBytes"].as_u64().unwrap() > 100, "{used}");
    let purge = format!("/v1/sessions/{of_a}?purge=true");
    assert_eq!(asked(&doors, &a, "DELETE", &purge, Value::Null).await.0, StatusCode::OK);
    let used = get(&doors, &operator, "/v1/tenants/a").await["used"].clone();
    assert_eq!(used["storedBytes"].as_u64().unwrap_or(0), 0, "{used}");
    doors.close().await;
}

/// Epochs that no mailbox has taken leave the quota to others.
async fn refused_epochs_count_towards_no_quota(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let a = key_of(&doors, &operator, "a", "").await;
    let (open, closed) =
        (session(&doors, &a, json!({})).await, session(&doors, &a, json!({})).await);
    let close = format!("/v1/sessions/{closed}");
    assert_eq!(asked(&doors, &a, "DELETE", &close, Value::Null).await.0, StatusCode::OK);
    // A push uses up the quota for a minute and a half.
    set(&doors, &operator, "a", json!({"epochsPerS": 1.0})).await;
    let epochs: Vec<Value> = (1..=100).map(epoch).collect();
    let push = async |session: &str| {
        let path = format!("/v1/sessions/{session}/epochs");
        let (_, answer) = asked(&doors, &a, "POST", &path, json!({"epochs": epochs})).await;
        answer["code"].as_str().unwrap_or_default().to_owned()
    };
    for _ in 0..2 {
        assert_eq!(push(&closed).await, "SESSION_CLOSED");
    }
    assert_eq!(push(&open).await, "", "taken");
    assert_eq!(push(&closed).await, "EPOCH_QUOTA_EXCEEDED");
    doors.close().await;
}

/// The epochs of raw bytes are known once they are decoded. What is decoded beyond the quota is
/// refused as a whole, and taken when it is sent again.
async fn raw_bytes_that_arrive_at_once_stay_within_the_quota(database: Database) {
    const CHUNK: usize = 15;
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let a = key_of(&doors, &operator, "a", "").await;
    let mut paths = Vec::new();
    for _ in 0..8 {
        paths.push(format!(
            "/v1/sessions/{}/raw?offset=0&end=true",
            session(&doors, &a, json!({})).await
        ));
    }
    // 20 epochs may come at once.
    set(&doors, &operator, "a", json!({"epochsPerS": 2.0})).await;
    let file = PAIR.file_of(&PAIR.base[..CHUNK], None);
    let upload = async |path: &String| uploaded(&doors, &a, path, &file).await;
    let answers = join_all(paths.iter().map(&upload)).await;
    let mut refused = Vec::new();
    for (path, answer) in paths.iter().zip(&answers) {
        if let Some((code, _)) = &answer.refusal {
            assert_eq!(code, "EPOCH_QUOTA_EXCEEDED");
            refused.push(path);
        }
    }
    let taken = database.count("epochs").await as usize;
    assert_eq!(taken, (paths.len() - refused.len()) * CHUNK);
    assert!((1..20 + CHUNK).contains(&taken), "{taken} epochs at once");
    set(&doors, &operator, "a", json!({})).await;
    for path in refused {
        assert!(upload(path).await.refusal.is_none(), "the stream continues where it was");
    }
    assert_eq!(database.count("epochs").await as usize, paths.len() * CHUNK);
    doors.close().await;
}

/// The ephemerides of a chunk cannot be stored, so the chunk is refused. Its epochs count once it is
/// taken.
async fn refused_raw_bytes_count_towards_no_quota(database: Database) {
    let Some(folder) = data::set("galway-static") else { return };
    let mut log = unpacked(&folder.join("rover-20181004-1237.ubx.gz"));
    log.truncate(200_000);
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let a = key_of(&doors, &operator, "a", "").await;
    let path = format!("/v1/sessions/{}/raw?offset=0", session(&doors, &a, json!({})).await);
    let rate = async || {
        let used = get(&doors, &operator, "/v1/tenants/a").await["used"].clone();
        used["epochsPerS"].as_f64().unwrap_or(0.0)
    };
    database.execute("ALTER TABLE ephemerides RENAME TO ephemerides_away").await;
    for _ in 0..3 {
        let refused = uploaded(&doors, &a, &path, &log).await.refusal.unwrap();
        assert_eq!(refused.0, "DATABASE_FAILED");
        assert_eq!(rate().await, 0.0);
    }
    database.execute("ALTER TABLE ephemerides_away RENAME TO ephemerides").await;
    let taken = uploaded(&doors, &a, &path, &log).await;
    assert!(taken.refusal.is_none(), "{:?}", taken.refusal);
    assert!(0.0 < rate().await);
    doors.close().await;
}

async fn files_of_jobs_are_refused_by_their_quota(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let (a, b) =
        (key_of(&doors, &operator, "a", "").await, key_of(&doors, &operator, "b", "").await);
    let post = async |key: &Key, headers: &[(&str, &str)]| {
        let bearer = format!("Bearer {}", key.secret);
        let headers = [&[("authorization", &*bearer)], headers].concat();
        let (status, answer) = post(&doors, MINUTE.body(&json!({})), &headers).await;
        assert_eq!(status == StatusCode::TOO_MANY_REQUESTS, answer["retryAfterMs"].is_u64());
        (status.as_u16(), code(&answer).to_owned(), answer)
    };
    let upload = async |length: u64| {
        let request = Request::post("/v1/uploads").header("tus-resumable", "1.0.0");
        let request = request.header("authorization", format!("Bearer {}", a.secret));
        let request = request.header("upload-length", length).body(Body::empty()).unwrap();
        let (status, answer) = doors.ask(request).await;
        (status.as_u16(), code(&answer).to_owned())
    };
    let used = async || {
        let tenant = get(&doors, &operator, "/v1/tenants/a").await;
        tenant["used"]["jobBytes"].as_u64().unwrap_or(0)
    };
    let refused = (429, "JOB_STORAGE_QUOTA_EXCEEDED".to_owned());
    let inputs = (MINUTE.rover.len() + MINUTE.navigation.len() + MINUTE.base.len()) as u64;

    // An accepted job is finished, even if its result exceeds the quota.
    set(&doors, &operator, "a", json!({"jobBytes": inputs})).await;
    let (status, _, job) = post(&a, &[]).await;
    assert_eq!(status, 201, "{job}");
    let path = format!("/v1/jobs/{}", job["job"].as_str().unwrap());
    let job =
        until("ended", async || get(&doors, &a, &path).await, |job| job["state"] == "SUCCEEDED");
    let result = job.await["resultBytes"].as_u64().unwrap();
    assert_eq!(used().await, inputs + result);
    let (status, code, answer) = post(&a, &[]).await;
    assert_eq!((status, code), refused, "{answer}");
    assert_eq!(upload(1).await, refused);
    assert_eq!(post(&b, &[]).await.0, 201, "of another tenant");

    // A body is refused at the byte that exceeds the rest of the quota, and an upload by its stated
    // size.
    let left = inputs - 1;
    set(&doors, &operator, "a", json!({"jobBytes": inputs + result + left})).await;
    let (status, code, answer) = post(&a, &[]).await;
    assert_eq!((status, code), refused, "{answer}");
    assert_eq!(upload(left + 1).await, refused);
    assert_eq!(upload(left).await.0, 201);
    assert_eq!(used().await, inputs + result + left);
    assert_eq!(upload(1).await, refused);

    // Files that two jobs have in common count once.
    set(&doors, &operator, "a", json!({"jobBytes": 3 * inputs + result})).await;
    let (status, _, answer) = post(&a, &[]).await;
    assert_eq!(status, 201, "{answer}");
    let again = format!("/v1/jobs/{}", answer["job"].as_str().unwrap());
    until("ended", async || get(&doors, &a, &again).await, |job| job["state"] == "SUCCEEDED").await;
    assert_eq!(used().await, inputs + 2 * result + left);
    for path in [path, again] {
        let purge = format!("{path}?purge=true");
        assert_eq!(asked(&doors, &a, "DELETE", &purge, Value::Null).await.0, StatusCode::OK);
    }
    assert_eq!(used().await, left);
    doors.close().await;
}

async fn the_operator_sets_quotas_beside_the_service(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let a = key_of(&doors, &operator, "a", "").await;
    key_of(&doors, &operator, "b", "").await;
    let tenants = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.args(["tenants", "--database", &database.url]).args(arguments).output().unwrap()
    };
    let set = tenants(&["set", "a", "--sessions", "0", "--epochs-per-s", "2.5"]);
    assert!(set.status.success(), "{set:?}");
    let create = async || asked(&doors, &a, "POST", "/v1/sessions", json!({})).await.0;
    until("in force", create, |status| *status == StatusCode::TOO_MANY_REQUESTS).await;
    let listed = String::from_utf8(tenants(&["list"]).stdout).unwrap();
    let names: Vec<&str> = listed.lines().map(|line| line.split(':').next().unwrap()).collect();
    assert_eq!(names, ["a", "b", "default"]);
    assert!(listed.contains("of 0") && listed.contains("2.5 epochs a second"), "{listed}");
    assert!(!tenants(&["set", "no/name"]).status.success());
    assert!(!tenants(&["set", "a", "--epochs-per-s", "-1"]).status.success());

    let names = async |key: &Key, path: &str| {
        let page = get(&doors, key, path).await;
        let tenants = page["tenants"].as_array().unwrap().clone();
        tenants.iter().map(|t| t["tenant"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(names(&operator, "/v1/tenants?pageSize=2").await, ["a", "b"]);
    let page = get(&doors, &operator, "/v1/tenants?pageSize=2").await;
    let rest = format!("/v1/tenants?pageToken={}", page["nextPageToken"].as_str().unwrap());
    assert_eq!(names(&operator, &rest).await, ["default"]);
    assert_eq!(names(&a, "/v1/tenants").await, ["a"]);
    for (key, name) in [(&a, "b"), (&operator, "nobody")] {
        let path = format!("/v1/tenants/{name}");
        let (status, answer) = asked(&doors, key, "GET", &path, Value::Null).await;
        assert_eq!((status, &answer["code"]), (StatusCode::NOT_FOUND, &json!("TENANT_NOT_FOUND")));
    }
    let negative = json!({"quotas": {"epochsPerS": -1.0}});
    let (status, answer) = asked(&doors, &operator, "PUT", "/v1/tenants/a", negative).await;
    assert_eq!((status, &answer["field"]), (StatusCode::BAD_REQUEST, &json!("quotas.epochsPerS")));
}
