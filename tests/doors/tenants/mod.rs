//! Tenants by both doors: no call of one tenant reads, changes or reveals data of another.

mod cases;
mod mutated;
pub(super) mod world;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::contract::access::CALLS;
use graphfix::contract::convert::epoch_message;
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::Ecef;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::Doors;
use crate::support::jobs::MINUTE;
use crate::support::pair::PAIR;

use cases::{Case, Things, case, posted_job};
use mutated::ten_thousand_mutated_calls_learn_and_change_nothing;
use world::{
    Answer, Key, MARK, absent, asked, base, furnished, get, key_of, marker, operator, seen, sent,
    session, uploaded,
};

on_both_databases!(
    no_call_reaches_what_belongs_to_another_tenant,
    a_tenant_keeps_what_it_has_over_a_restart,
    navigation_serves_its_tenant_until_another_agrees,
    the_bases_of_the_operator_serve_all,
    a_tenant_uses_its_own_bases_as_the_nearest,
    ten_thousand_mutated_calls_learn_and_change_nothing,
);

/// Asks for things of another tenant and for things that do not exist, by every call: the answers
/// are the same, and the other tenant sees the same as before.
async fn no_call_reaches_what_belongs_to_another_tenant(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let intruder = key_of(&doors, &operator, "a", "of a").await;
    let other = key_of(&doors, &operator, "strangers", MARK).await;
    let owned = furnished(&doors, &other, "strangers").await;
    let before = seen(&doors, &other, &owned).await;
    for call in CALLS {
        check(&doors, &intruder, call, &owned).await;
        // The operator manages keys and tenants, and reads the audit log of all. Its bases and
        // navigation data serve all. It reaches no other data of a tenant.
        let is_for_all = call.grpc.starts_with("Keys/")
            || call.grpc.starts_with("Tenants/")
            || call.grpc.starts_with("Audit/")
            || ["Bases/Create", "Navigation/Push"].contains(&call.grpc)
            || call.rest == "GET /metrics";
        if !is_for_all {
            check(&doors, &operator, call, &owned).await;
        }
    }
    assert_eq!(seen(&doors, &other, &owned).await, before, "something has changed");
    let tracked = format!("/v1/sessions/{}/epochs", owned.session);
    let more = json!({"epochs": [crate::support::doors::epoch(4)]});
    let (status, answer) = asked(&doors, &other, "POST", &tracked, more).await;
    assert_eq!((status, &answer["durableThrough"]), (StatusCode::OK, &json!(4)), "{answer}");
    doors.close().await;
}

/// Sends the requests of one call, for things of another tenant and for none.
async fn check(
    doors: &Doors,
    intruder: &Key,
    call: &graphfix::contract::access::Call,
    owned: &Things,
) {
    let nothing = absent();
    let (Case::Requests(theirs), Case::Requests(nobodys)) =
        (case(call, owned), case(call, &nothing))
    else {
        return;
    };
    assert!(!theirs.is_empty() && theirs.len() == nobodys.len());
    for (theirs, nobodys) in theirs.into_iter().zip(nobodys) {
        let what = format!("{} {}", theirs.method(), theirs.uri());
        let there = hidden(owned, sent(doors, intruder, theirs).await);
        let nowhere = hidden(&nothing, sent(doors, intruder, nobodys).await);
        assert!(there.status.as_u16() < 500, "{what}: {there:?}");
        for trace in [
            MARK,
            &owned.session,
            &owned.base,
            &owned.job,
            &owned.upload,
            &owned.key,
            &owned.tenant,
        ] {
            assert!(!there.text.contains(trace), "{what} shows {trace}: {}", there.text);
        }
        assert_eq!((&there.status, &there.refusal), (&nowhere.status, &nowhere.refusal), "{what}");
        if there.refusal.is_some() {
            assert_eq!(there.text, nowhere.text, "{what}");
        }
    }
}

/// An answer without the ids that the request has named.
fn hidden(of: &Things, answer: Answer) -> Answer {
    let is_refused = answer.refusal.is_some();
    // A served answer must not contain the ids at all; a refusal repeats those of the request.
    let text = if is_refused { of.hidden(&answer.text) } else { answer.text };
    let refusal = answer.refusal.map(|(code, details)| {
        let hidden = details.into_iter().map(|(key, value)| (key, of.hidden(&value)));
        (code, hidden.collect())
    });
    Answer { text, refusal, ..answer }
}

/// The tenant is known from the rows of the store after a restart, also for parked and replayed
/// sessions.
async fn a_tenant_keeps_what_it_has_over_a_restart(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let [one, other] = ["a", "b"].map(|tenant| key_of(&doors, &operator, tenant, tenant));
    let (one, other) = (one.await, other.await);
    let mut owned = Vec::new();
    for key in [&one, &other] {
        // A second tenant uses the same request name. It gets a job of its own, and no hint of the
        // other tenant's.
        owned.push(furnished(&doors, key, "").await);
        let again = sent(&doors, key, posted_job("nightly")).await;
        assert_eq!(again.status, StatusCode::OK, "{}", again.text);
    }
    assert_ne!(owned[0].job, owned[1].job);
    let doors = doors.restarted().await;
    for (key, own, others) in [(&one, &owned[0], &owned[1]), (&other, &owned[1], &owned[0])] {
        let listed = async |path: &str, list: &str, id: &str| {
            let page = get(&doors, key, path).await;
            let items = page[list].as_array().unwrap().clone();
            items.iter().map(|item| item[id].as_str().unwrap().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(listed("/v1/sessions", "sessions", "session").await, [&*own.session]);
        assert_eq!(listed("/v1/sessions:heads", "heads", "session").await, [&*own.session]);
        let watch = Request::get("/v1/sessions:watch").body(Body::empty()).unwrap();
        let watched = sent(&doors, key, watch).await.text;
        assert!(watched.contains(&own.session) && !watched.contains(&others.session), "{watched}");
        assert_eq!(listed("/v1/bases", "bases", "base").await, [&*own.base]);
        assert_eq!(listed("/v1/jobs", "jobs", "job").await, [&*own.job]);
        assert_eq!(listed("/v1/keys", "keys", "key").await, [&*key.id]);
        seen(&doors, key, own).await;
        let path = format!("/v1/sessions/{}", others.session);
        assert_eq!(asked(&doors, key, "GET", &path, Value::Null).await.0, StatusCode::NOT_FOUND);
    }
    let all = get(&doors, &operator, "/v1/keys?tenant=b").await;
    assert_eq!(all["keys"][0]["key"], json!(other.id));
    let revoke = format!("/v1/keys/{}", other.id);
    let (status, answer) = asked(&doors, &operator, "DELETE", &revoke, Value::Null).await;
    assert_eq!((status, &answer["tenant"]), (StatusCode::OK, &json!("b")), "{answer}");
    let refused = asked(&doors, &other, "GET", "/v1/sessions", Value::Null).await;
    assert_eq!(refused.0, StatusCode::UNAUTHORIZED);
    doors.close().await;
}

/// Number of ephemerides that serve a tenant.
async fn ephemerides(doors: &Doors, key: &Key) -> u64 {
    // A protobuf number of 64 bits; zero is left out.
    get(doors, key, "/v1/navigation").await["ephemerides"].as_u64().unwrap_or(0)
}

async fn navigation_serves_its_tenant_until_another_agrees(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let [a, b, c] = ["a", "b", "c"].map(|tenant| key_of(&doors, &operator, tenant, ""));
    let (a, b, c) = (a.await, b.await, c.await);
    let answer = uploaded(&doors, &a, "/v1/navigation", &MINUTE.navigation).await;
    assert_eq!(answer.status, StatusCode::OK, "{}", answer.text);
    let all = ephemerides(&doors, &a).await;
    assert!(8 < all, "{all} ephemerides");
    // A second upload of the same tenant is no second source.
    uploaded(&doors, &a, "/v1/navigation", &MINUTE.navigation).await;
    for key in [&b, &operator] {
        assert_eq!(ephemerides(&doors, key).await, 0);
    }
    let doors = doors.restarted().await;
    assert_eq!((ephemerides(&doors, &a).await, ephemerides(&doors, &b).await), (all, 0));
    let status = get(&doors, &a, "/v1/navigation").await;
    assert_eq!(status["satellites"][0]["source"], json!("own"));

    uploaded(&doors, &b, "/v1/navigation", &MINUTE.navigation).await;
    for key in [&a, &b, &c, &operator] {
        assert_eq!(ephemerides(&doors, key).await, all);
    }
    let status = get(&doors, &c, "/v1/navigation").await;
    assert_eq!(status["satellites"][0]["source"], json!("agreed"));
    assert_eq!(status["sources"], json!([]));
}

async fn the_bases_of_the_operator_serve_all(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let key = key_of(&doors, &operator, "a", "").await;
    let shared = base(&doors, &operator, json!({"label": "roof", "marker": marker()})).await;
    let caster = json!({"caster": "http://127.0.0.1:1", "mountpoint": "VRS", "followRover": true});
    let following = base(&doors, &operator, json!({"label": "virtual", "ntrip": caster})).await;
    let caster = json!({"caster": "http://127.0.0.1:1", "mountpoint": "ROOF", "user": "operator"});
    let streamed = base(&doors, &operator, json!({"label": "stream", "ntrip": caster})).await;

    let listed = get(&doors, &key, "/v1/bases").await;
    let mut ids: Vec<&str> =
        listed["bases"].as_array().unwrap().iter().map(|b| b["base"].as_str().unwrap()).collect();
    ids.sort_unstable();
    let mut expected = [&*shared, &*streamed];
    expected.sort_unstable();
    assert_eq!(ids, expected, "one that follows its rovers shows where they are");
    assert!(!listed.to_string().contains("127.0.0.1"), "{listed}");
    assert_eq!(listed["networks"], json!([]));
    session(&doors, &key, json!({"mode": "rtk-fgo", "base": shared})).await;
    let hidden = json!({"mode": "rtk-fgo", "base": following});
    let (status, answer) = asked(&doors, &key, "POST", "/v1/sessions", hidden).await;
    assert_eq!((status, &answer["code"]), (StatusCode::NOT_FOUND, &json!("BASE_NOT_FOUND")));

    let epochs = json!({"epochs": [crate::support::doors::epoch(1)]});
    let path = format!("/v1/bases/{shared}");
    for (method, path, body) in
        [("DELETE", path.clone(), Value::Null), ("POST", format!("{path}/epochs"), epochs)]
    {
        let (status, answer) = asked(&doors, &key, method, &path, body).await;
        let refused = (StatusCode::FORBIDDEN, &json!("BASE_OF_OPERATOR"));
        assert_eq!((status, &answer["code"]), refused, "{method} {path}: {answer}");
    }
    let (status, answer) = asked(&doors, &key, "GET", "/metrics", Value::Null).await;
    assert_eq!((status, &answer["code"]), (StatusCode::FORBIDDEN, &json!("OPERATOR_ONLY")));
}

/// The statuses of a session's solutions of a minute, relative to the nearest base.
async fn statuses(doors: &Doors, key: &Key) -> Vec<String> {
    let new = json!({"mode": "rtk-fgo", "base": "nearest"});
    let path = format!("/v1/sessions/{}", session(doors, key, new).await);
    let epochs = &PAIR.rover[..60];
    let push = json!({"epochs": epochs.iter().map(message).collect::<Vec<_>>()});
    let (status, answer) = asked(doors, key, "POST", &format!("{path}/epochs"), push).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let results = answer["results"].as_array().unwrap();
    let status = |result: &Value| result["solution"]["status"].as_str().unwrap().to_owned();
    results.iter().map(status).collect()
}

fn message(epoch: &SequencedEpoch) -> Value {
    serde_json::to_value(epoch_message(epoch.seq, &epoch.epoch)).unwrap()
}

async fn a_tenant_uses_its_own_bases_as_the_nearest(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let (a, b) =
        (key_of(&doors, &operator, "a", "").await, key_of(&doors, &operator, "b", "").await);
    let mut navigation = Vec::new();
    write_navigation(&mut navigation, &PAIR.navigation).unwrap();
    uploaded(&doors, &operator, "/v1/navigation", &navigation).await;
    let fill = async |key: &Key| {
        let Ecef(position) = PAIR.position;
        let marker = json!({"xM": position.x, "yM": position.y, "zM": position.z});
        let id = base(&doors, key, json!({"label": "roof", "marker": marker})).await;
        let epochs = PAIR.base[..61]
            .iter()
            .map(|epoch| serde_json::to_value(epoch_message(0, epoch)).unwrap());
        let push = json!({"epochs": epochs.collect::<Vec<_>>()});
        let path = format!("/v1/bases/{id}/epochs");
        let (status, answer) = asked(&doors, key, "POST", &path, push).await;
        assert_eq!(status, StatusCode::OK, "{answer}");
    };
    fill(&b).await;
    let is_relative = |statuses: &[String]| {
        assert_eq!(statuses.len(), 60);
        statuses.iter().any(|status| status == "FIXED" || status == "FLOAT")
    };
    assert!(is_relative(&statuses(&doors, &b).await));
    assert!(!is_relative(&statuses(&doors, &a).await), "the base of b serves a");
    assert!(!is_relative(&statuses(&doors, &operator).await), "the base of b serves the operator");
    fill(&operator).await;
    assert!(is_relative(&statuses(&doors, &a).await));
    doors.close().await;
}
