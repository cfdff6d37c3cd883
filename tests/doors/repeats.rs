//! Requests that are sent again, and changes to objects that somebody else has changed meanwhile.

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode};
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::bases_client::BasesClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use serde_json::{Value, json};
use tonic::Code;
use tower::ServiceExt;

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code};

use super::tenants::world::{asked, key_of, operator};

on_both_databases!(
    a_named_request_creates_one_session,
    a_named_request_creates_one_base,
    names_of_requests_are_a_tenants_own,
    a_change_of_changed_settings_is_refused,
);

/// Status, headers and JSON of the answer to a request with one more header.
async fn sent(
    doors: &Doors,
    (method, path): (&str, &str),
    (name, value): (&str, &str),
    body: Value,
) -> (StatusCode, HeaderMap, Value) {
    let request = Request::builder().method(method).uri(path).header(name, value);
    let request = request.header("content-type", "application/json");
    let request = request.body(Body::from(body.to_string())).unwrap();
    let (head, body) = doors.router.clone().oneshot(request).await.unwrap().into_parts();
    let body = axum::body::to_bytes(body, usize::MAX).await.unwrap();
    (head.status, head.headers, serde_json::from_slice(&body).unwrap())
}

/// A call of gRPC with the name of its request in the metadata.
fn named_by_metadata<T>(message: T) -> tonic::Request<T> {
    let mut request = tonic::Request::new(message);
    request.metadata_mut().insert("idempotency-key", "6f1c".parse().unwrap());
    request
}

async fn a_named_request_creates_one_session(database: Database) {
    let doors = Doors::on(&database.url).await;
    let (list, new) =
        ("/v1/sessions", json!({"label": "rover", "overrides": {"elevation_mask_deg": "12"}}));
    let named = ("idempotency-key", "6f1c");
    let (status, headers, first) = sent(&doors, ("POST", list), named, new.clone()).await;
    assert_eq!(status, StatusCode::CREATED, "{first}");
    let session = first["session"].as_str().unwrap().to_owned();
    assert_eq!(headers["location"], format!("/v1/sessions/{session}"));
    assert_eq!(headers["etag"], format!("\"{}\"", first["etag"].as_str().unwrap()));

    let doors = doors.restarted().await;
    let (status, headers, again) = sent(&doors, ("POST", list), named, new).await;
    assert_eq!((status, &again), (StatusCode::OK, &first));
    assert_eq!(headers["location"], format!("/v1/sessions/{session}"));
    let other = json!({"label": "another"});
    let (status, _, refused) = sent(&doors, ("POST", list), named, other.clone()).await;
    assert_eq!((status, code(&refused)), (StatusCode::CONFLICT, "IDEMPOTENCY_CONFLICT"));
    let contradiction = json!({"requestId": "7a2d"});
    let (status, _, refused) = sent(&doors, ("POST", list), named, contradiction).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "INVALID_FIELD"));

    let mut client = SessionsClient::new(doors.router.clone());
    let mut request = v1::CreateSessionRequest {
        label: "rover".to_owned(),
        overrides: [("elevation_mask_deg".to_owned(), "12".to_owned())].into(),
        request_id: "6f1c".to_owned(),
        ..Default::default()
    };
    let by_grpc = client.create(request.clone()).await.unwrap().into_inner();
    assert_eq!(by_grpc.session, session, "the same name on the other door");
    let by_metadata = |request_id: &str| {
        let request_id = request_id.to_owned();
        named_by_metadata(v1::CreateSessionRequest { request_id, ..request.clone() })
    };
    for request_id in ["", "6f1c"] {
        let again = client.create(by_metadata(request_id)).await.unwrap().into_inner();
        assert_eq!(again.session, session, "the name in the metadata");
    }
    let status = client.create(by_metadata("7a2d")).await.unwrap_err();
    assert_eq!(code_of(&status).as_deref(), Some("INVALID_FIELD"), "two names");
    request.mode = "fgo".to_owned();
    let status = client.create(request).await.unwrap_err();
    assert_eq!(status.code(), Code::AlreadyExists);
    assert_eq!(code_of(&status).as_deref(), Some("IDEMPOTENCY_CONFLICT"));

    let (_, listed) = doors.get(list).await;
    assert_eq!(listed["sessions"].as_array().unwrap().len(), 1);
    doors.send("DELETE", &format!("{list}/{session}?purge=true"), Value::Null).await;
    let (status, _, fresh) = sent(&doors, ("POST", list), named, other).await;
    assert_eq!(status, StatusCode::CREATED, "the name is free again: {fresh}");
    doors.close().await;
}

/// Of many equal requests at the same time only one creates a session.
#[tokio::test]
async fn repetitions_at_once_create_one_session() {
    let doors = Doors::open().await;
    let new = json!({"requestId": "at once"});
    let all = (0..20).map(|_| doors.post("/v1/sessions", new.clone()));
    let answers = futures::future::join_all(all).await;
    let created = answers.iter().filter(|(status, _)| *status == StatusCode::CREATED);
    assert_eq!(created.count(), 1);
    let ids: std::collections::BTreeSet<_> =
        answers.iter().map(|(_, answer)| answer["session"].as_str().unwrap()).collect();
    assert_eq!(ids.len(), 1, "{answers:?}");
}

async fn a_named_request_creates_one_base(database: Database) {
    let doors = Doors::on(&database.url).await;
    let marker = json!({"xM": 4_033_460.75, "yM": 23_538.02, "zM": 4_924_318.39});
    let (list, new) = ("/v1/bases", json!({"label": "roof", "marker": marker}));
    let named = ("idempotency-key", "roof");
    let (status, headers, first) = sent(&doors, ("POST", list), named, new.clone()).await;
    assert_eq!(status, StatusCode::CREATED, "{first}");
    let base = first["base"].as_str().unwrap().to_owned();
    assert_eq!(headers["location"], format!("/v1/bases/{base}"));

    let doors = doors.restarted().await;
    let (status, _, again) = sent(&doors, ("POST", list), named, new).await;
    assert_eq!((status, &again["base"]), (StatusCode::OK, &first["base"]));
    let other = v1::CreateBaseRequest { request_id: "roof".to_owned(), ..Default::default() };
    let status = BasesClient::new(doors.router.clone()).create(other.clone()).await.unwrap_err();
    assert_eq!(code_of(&status).as_deref(), Some("IDEMPOTENCY_CONFLICT"));
    doors.send("DELETE", &format!("{list}/{base}"), Value::Null).await;
    let fresh = BasesClient::new(doors.router.clone()).create(other).await.unwrap();
    assert_ne!(fresh.into_inner().base, base, "the name is free again");
    doors.close().await;
}

async fn names_of_requests_are_a_tenants_own(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let mut ids = std::collections::BTreeSet::new();
    for tenant in ["a", "b"] {
        let key = key_of(&doors, &operator, tenant, "").await;
        for (list, id) in [("/v1/sessions", "session"), ("/v1/bases", "base")] {
            let new = json!({"label": tenant, "requestId": "one"});
            let (status, answer) = asked(&doors, &key, "POST", list, new).await;
            assert_eq!(status, StatusCode::CREATED, "{tenant}: {answer}");
            assert!(ids.insert(answer[id].to_string()));
        }
    }
    doors.close().await;
}

async fn a_change_of_changed_settings_is_refused(database: Database) {
    let doors = Doors::on(&database.url).await;
    let path = format!("/v1/sessions/{}", doors.session().await);
    let (_, read) = doors.get(&path).await;
    let etag = format!("\"{}\"", read["etag"].as_str().unwrap());
    let change = |label: &str| json!({"label": label});
    let at = ("PATCH", &*path);
    let (status, headers, changed) = sent(&doors, at, ("if-match", &etag), change("mine")).await;
    assert_eq!(status, StatusCode::OK, "{changed}");
    assert_ne!(headers["etag"], *etag);
    let (status, _, refused) = sent(&doors, at, ("if-match", &etag), change("late")).await;
    let expected = (StatusCode::PRECONDITION_FAILED, "ETAG_MISMATCH");
    assert_eq!((status, code(&refused)), expected);
    assert_eq!(refused["field"], "etag");
    let (status, _, refused) = sent(&doors, at, ("if-match", "W/\"1\""), change("weak")).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "INVALID_FIELD"));
    assert_eq!(doors.get(&path).await.1["label"], "mine");
    assert_eq!(sent(&doors, at, ("if-match", "*"), change("any")).await.0, StatusCode::OK);

    let update = v1::UpdateSessionRequest {
        session: read["session"].as_str().unwrap().to_owned(),
        etag: read["etag"].as_str().unwrap().to_owned(),
        ..Default::default()
    };
    let status = SessionsClient::new(doors.router.clone()).update(update).await.unwrap_err();
    assert_eq!(status.code(), Code::Aborted);

    let tenant = ("PUT", "/v1/tenants/default");
    let (_, read) = doors.get(tenant.1).await;
    let etag = format!("\"{}\"", read["etag"].as_str().unwrap());
    let quotas = |sessions: u64| json!({"quotas": {"sessions": sessions}});
    let (status, _, set) = sent(&doors, tenant, ("if-match", &etag), quotas(7)).await;
    assert_eq!(status, StatusCode::OK, "{set}");
    let (status, _, refused) = sent(&doors, tenant, ("if-match", &etag), quotas(8)).await;
    assert_eq!((status, code(&refused)), expected);
    let read = doors.get(tenant.1).await.1;
    assert_eq!(read["quotas"]["sessions"], 7);
    // It depends on the tenant's own quotas only, and reveals nothing of the changes of others.
    let (_, _, other) =
        sent(&doors, ("PUT", "/v1/tenants/other"), ("accept", "*/*"), quotas(7)).await;
    assert_eq!(other["etag"], read["etag"]);
    doors.close().await;
}
