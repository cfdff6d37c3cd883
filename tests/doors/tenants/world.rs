//! A service with tenants, and the objects that one of them has.

use std::collections::BTreeMap;

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode, header};
use graphfix::aiding::bases::BaseId;
use graphfix::grpc::code_of;
use graphfix::jobs::JobId;
use graphfix::keys::KeyId;
use graphfix::session::SessionId;
use http_body_util::BodyExt;
use serde_json::{Value, json};
use tonic::Status;
use tonic_types::StatusExt;
use tower::ServiceExt;

use crate::support::doors::{Doors, epoch};
use crate::support::jobs::MINUTE;
use crate::support::wait::until;

use super::cases::{Things, posted_job};

/// A mark in every text of the tenant, and in no other text.
pub(in crate::doors) const MARK: &str = "mark-of-the-other-tenant";
/// The name of the requests of the tenant's session, base and job.
const REQUEST: &str = "nightly";

/// A key of a tenant.
#[derive(Clone)]
pub(in crate::doors) struct Key {
    pub(in crate::doors) id: String,
    pub(in crate::doors) secret: String,
}

/// The answer to a request, without the parts that change with time.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::doors) struct Answer {
    pub(in crate::doors) status: StatusCode,
    /// The code and details of a refusal.
    pub(in crate::doors) refusal: Option<(String, BTreeMap<String, String>)>,
    pub(in crate::doors) text: String,
}

/// Sends a request with a key.
pub(in crate::doors) async fn sent(doors: &Doors, key: &Key, mut request: Request<Body>) -> Answer {
    let bearer = format!("Bearer {}", key.secret).parse().unwrap();
    request.headers_mut().insert(header::AUTHORIZATION, bearer);
    let path = request.uri().path().to_owned();
    let response = doors.router.clone().oneshot(request).await.unwrap();
    let (parts, body) = response.into_parts();
    let (text, trailers) = content(&path, body).await;
    let status = Status::from_header_map(&parts.headers);
    let status = status.or_else(|| Status::from_header_map(&trailers));
    if let Some(status) = status.filter(|status| status.code() != tonic::Code::Ok) {
        let details = status.get_details_error_info().map(|info| info.metadata);
        let details = details.unwrap_or_default().into_iter().collect();
        let code = code_of(&status).unwrap_or_default();
        let text = text + status.message();
        return Answer { status: parts.status, refusal: Some((code, details)), text };
    }
    let problem: Value = serde_json::from_str(&text).unwrap_or_default();
    let refusal = problem["code"].as_str().map(|code| (code.to_owned(), BTreeMap::new()));
    Answer { status: parts.status, refusal, text }
}

/// The content of an answer and its trailers. A watch of heads has no end, and is read through its
/// first message.
async fn content(path: &str, mut body: Body) -> (String, HeaderMap) {
    let (mut bytes, mut trailers) = (Vec::new(), HeaderMap::new());
    let first = match path {
        "/v1/sessions:watch" => Some("data: "),
        "/graphfix.v1.Sessions/WatchHeads" => Some(""),
        _ => None,
    };
    while let Some(frame) = body.frame().await {
        match frame.unwrap().into_data() {
            Ok(data) => bytes.extend_from_slice(&data),
            Err(last) => trailers = last.into_trailers().unwrap_or_default(),
        }
        let has_message = |first| String::from_utf8_lossy(&bytes).contains(first);
        if !bytes.is_empty() && first.is_some_and(has_message) {
            break;
        }
    }
    (String::from_utf8_lossy(&bytes).into_owned(), trailers)
}

pub(in crate::doors) async fn asked(
    doors: &Doors,
    key: &Key,
    method: &str,
    path: &str,
    body: Value,
) -> (StatusCode, Value) {
    let request = Request::builder().method(method).uri(path);
    let request = request.header("content-type", "application/json");
    let Answer { status, text, .. } =
        sent(doors, key, request.body(Body::from(body.to_string())).unwrap()).await;
    (status, serde_json::from_str(&text).unwrap_or(Value::String(text)))
}

pub(in crate::doors) async fn get(doors: &Doors, key: &Key, path: &str) -> Value {
    let (status, answer) = asked(doors, key, "GET", path, Value::Null).await;
    assert_eq!(status, StatusCode::OK, "{path}: {answer}");
    answer
}

pub(in crate::doors) async fn uploaded(
    doors: &Doors,
    key: &Key,
    path: &str,
    content: &[u8],
) -> Answer {
    let request = Request::post(path).header("content-type", "application/octet-stream");
    sent(doors, key, request.body(Body::from(content.to_vec())).unwrap()).await
}

/// A key with all rights of the operator, the first of the service.
pub(in crate::doors) async fn operator(doors: &Doors) -> Key {
    let none = Key { id: String::new(), secret: String::new() };
    let rights = json!({"rights": ["device", "read", "operate", "admin"]});
    created_key(asked(doors, &none, "POST", "/v1/keys", rights).await)
}

/// A key with all rights of a tenant.
pub(in crate::doors) async fn key_of(
    doors: &Doors,
    operator: &Key,
    tenant: &str,
    label: &str,
) -> Key {
    let rights = ["device", "read", "operate", "admin"];
    let new = json!({"rights": rights, "tenant": tenant, "label": label});
    created_key(asked(doors, operator, "POST", "/v1/keys", new).await)
}

fn created_key((status, answer): (StatusCode, Value)) -> Key {
    assert_eq!(status, StatusCode::CREATED, "{answer}");
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    Key { id: text(&answer["key"]["key"]), secret: text(&answer["secret"]) }
}

pub(in crate::doors) async fn session(doors: &Doors, key: &Key, new: Value) -> String {
    let (status, session) = asked(doors, key, "POST", "/v1/sessions", new).await;
    assert_eq!(status, StatusCode::CREATED, "{session}");
    session["session"].as_str().unwrap().to_owned()
}

pub(in crate::doors) async fn base(doors: &Doors, key: &Key, new: Value) -> String {
    let (status, base) = asked(doors, key, "POST", "/v1/bases", new).await;
    assert_eq!(status, StatusCode::CREATED, "{base}");
    base["base"].as_str().unwrap().to_owned()
}

/// A marker on the ground.
pub(in crate::doors) fn marker() -> Value {
    json!({"xM": -2_414_266.9, "yM": 5_386_768.9, "zM": 2_407_460.0})
}

/// Creates one object of each kind for a tenant.
pub(in crate::doors) async fn furnished(doors: &Doors, key: &Key, tenant: &str) -> Things {
    let uploaded = uploaded(doors, key, "/v1/navigation", &MINUTE.navigation).await;
    assert_eq!(uploaded.status, StatusCode::OK, "{}", uploaded.text);
    let session = session(doors, key, json!({"label": MARK, "requestId": REQUEST})).await;
    let push = json!({"epochs": [epoch(1), epoch(2), epoch(3)]});
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, answer) = asked(doors, key, "POST", &path, push).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let new = json!({"label": MARK, "marker": marker(), "requestId": REQUEST});
    let base = base(doors, key, new).await;
    let push = json!({"epochs": [epoch(1), epoch(2)]});
    let (status, answer) =
        asked(doors, key, "POST", &format!("/v1/bases/{base}/epochs"), push).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let posted = sent(doors, key, posted_job(REQUEST)).await;
    assert_eq!(posted.status, StatusCode::CREATED, "{}", posted.text);
    let job: Value = serde_json::from_str(&posted.text).unwrap();
    let job = job["job"].as_str().unwrap().to_owned();
    let state = async || get(doors, key, &format!("/v1/jobs/{job}")).await["state"].clone();
    until("the job", state, |state| *state == "SUCCEEDED").await;
    let (tenant, request) = (tenant.to_owned(), REQUEST.to_owned());
    let upload = Request::post("/v1/uploads").header("tus-resumable", "1.0.0");
    let upload = upload.header("upload-length", "7").body(Body::empty()).unwrap();
    let begun = sent(doors, key, upload).await;
    assert_eq!(begun.status, StatusCode::CREATED, "{}", begun.text);
    let upload: Value = serde_json::from_str(&begun.text).unwrap();
    let upload = upload["upload"].as_str().unwrap().to_owned();
    Things { session, base, job, upload, key: key.id.clone(), tenant, request }
}

/// Ids of objects that do not exist.
pub(in crate::doors) fn absent() -> Things {
    Things {
        session: SessionId::random().to_string(),
        base: BaseId::random().to_string(),
        job: JobId::random().to_string(),
        upload: JobId::random().to_string().replace("job_", "upl_"),
        key: KeyId::random().to_string(),
        tenant: "nobody".to_owned(),
        request: "another".to_owned(),
    }
}

/// All that a tenant can read of its own objects, without values that change with time.
pub(in crate::doors) async fn seen(doors: &Doors, key: &Key, of: &Things) -> Vec<(String, Value)> {
    let Things { session, base, job, upload, .. } = of;
    let (session, job) = (format!("/v1/sessions/{session}"), format!("/v1/jobs/{job}"));
    let paths = [
        "/v1/sessions".to_owned(),
        "/v1/sessions:heads".to_owned(),
        session.clone(),
        format!("{session}/solutions?revisions=all"),
        format!("{session}/solutions:series"),
        format!("{session}/solutions:residuals"),
        "/v1/history/fleet?from=2051:0&to=2051:604799".to_owned(),
        "/v1/history/sessions?from=2051:0&to=2051:604799".to_owned(),
        session.replace("sessions", "history/sessions"),
        format!("{session}/epochs/1"),
        format!("{session}/track.csv"),
        "/v1/bases".to_owned(),
        format!("/v1/bases/{base}"),
        "/v1/jobs".to_owned(),
        job.clone(),
        format!("/v1/uploads/{upload}"),
        format!("{job}/report"),
        format!("{job}/result"),
        "/v1/keys".to_owned(),
        "/v1/audit".to_owned(),
        "/v1/navigation".to_owned(),
    ];
    let mut seen = Vec::new();
    for path in paths {
        let mut answer = get(doors, key, &path).await;
        settle(&mut answer);
        seen.push((path, answer));
    }
    seen
}

/// Removes values that change with time.
fn settle(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            for passing in ["ageS", "nowUtc", "lastUsedUtc"] {
                fields.remove(passing);
            }
            fields.values_mut().for_each(settle);
        }
        Value::Array(items) => items.iter_mut().for_each(settle),
        _ => {}
    }
}
