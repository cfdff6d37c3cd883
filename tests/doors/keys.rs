//! API keys by both doors: which requests are refused and when. No call is served without an entry
//! in the table of calls.

use std::collections::BTreeSet;

use axum::body::Body;
use axum::http::{Request, Response, StatusCode};
use futures::StreamExt;
use graphfix::contract::access::{CALLS, Call, Need};
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::keys_client::KeysClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use graphfix::keys::{Right, Rights};
use prost::Message;
use serde_json::{Value, json};
use tokio::sync::Notify;
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::{Status, Streaming};
use tower::ServiceExt;

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code, epoch};
use crate::support::flow::{self, EpochFlow};
use crate::support::wait::until;

on_both_databases!(
    a_key_opens_what_its_rights_allow,
    a_revocation_ends_open_streams_and_watches,
    an_expiry_ends_a_key_and_its_watch,
    answers_beside_a_revocation_are_whole,
    uses_are_noted_and_the_service_starts_again,
);

/// A key's id and secret.
struct Key {
    id: String,
    secret: String,
}

/// Creates a key by REST. If the service has keys, the call needs the key `by`.
async fn created(doors: &Doors, by: Option<&Key>, request: Value) -> Key {
    let (status, answer) = asked(doors, by, "POST", "/v1/keys", request).await;
    assert_eq!(status, StatusCode::CREATED, "{answer}");
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    Key { id: text(&answer["key"]["key"]), secret: text(&answer["secret"]) }
}

/// A key with all rights, the first of the service.
async fn first_key(doors: &Doors) -> Key {
    created(doors, None, json!({"rights": ["device", "read", "operate", "admin"]})).await
}

fn request(key: Option<&Key>, method: &str, path: &str, body: &Value) -> Request<Body> {
    let request = Request::builder().method(method).uri(path);
    let request = request.header("content-type", "application/json");
    let request = match key {
        Some(key) => request.header("authorization", format!("Bearer {}", key.secret)),
        None => request,
    };
    request.body(Body::from(body.to_string())).unwrap()
}

async fn asked(
    doors: &Doors,
    key: Option<&Key>,
    method: &str,
    path: &str,
    body: Value,
) -> (StatusCode, Value) {
    doors.ask(request(key, method, path, &body)).await
}

/// A key as the metadata of a gRPC client.
#[derive(Clone)]
struct Bearer(String);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: tonic::Request<()>) -> Result<tonic::Request<()>, Status> {
        request.metadata_mut().insert("authorization", self.0.parse().unwrap());
        Ok(request)
    }
}

/// The router for a gRPC client with a key.
fn wire_of(doors: &Doors, key: &Key) -> InterceptedService<axum::Router, Bearer> {
    let bearer = Bearer(format!("bearer {}", key.secret));
    InterceptedService::new(doors.router.clone(), bearer)
}

fn message(seq: u64) -> v1::Epoch {
    serde_json::from_value(epoch(seq)).unwrap()
}

/// Every method of gRPC and every path of REST is in the table, and nothing else is.
#[tokio::test]
async fn the_table_of_calls_is_complete() {
    let set = prost_types::FileDescriptorSet::decode(graphfix::grpc::DESCRIPTORS).unwrap();
    let services = set.file.iter().flat_map(|file| {
        file.service.iter().map(|service| format!("/{}.{}", file.package(), service.name()))
    });
    let methods = set.file.iter().flat_map(|file| &file.service);
    let methods: BTreeSet<String> = services
        .zip(methods)
        .flat_map(|(path, service)| {
            service.method.iter().map(move |method| format!("{path}/{}", method.name()))
        })
        .collect();
    // Health and reflection are tonic's.
    let own = |call: &&Call| !call.grpc.is_empty() && !call.grpc.starts_with("/grpc.");
    let listed: BTreeSet<String> = CALLS.iter().filter(own).map(path_of).collect();
    assert_eq!(methods, listed);

    let document = serde_json::to_value(graphfix::http::document()).unwrap();
    let paths = document["paths"].as_object().unwrap();
    let operations: BTreeSet<String> = paths
        .iter()
        .flat_map(|(path, methods)| {
            let names = methods.as_object().unwrap().keys();
            names.map(move |method| format!("{} {path}", method.to_uppercase()))
        })
        .collect();
    let is_call = |call: &&Call| call.rest.contains(" /v1/");
    let listed: BTreeSet<String> = CALLS
        .iter()
        .filter(is_call)
        .map(|call| call.rest.split('?').next().unwrap().to_owned())
        .collect();
    assert_eq!(operations, listed);
}

const TABLE_BEGIN: &str =
    "<!-- calls: GRAPHFIX_ACCEPT=1 cargo test --test main the_document_has_the_table -->\n";
const TABLE_END: &str = "<!-- end of calls -->";

#[test]
fn the_document_has_the_table() {
    let mut table = "| gRPC | REST | needs |\n|---|---|---|\n".to_owned();
    for call in CALLS {
        let shown = |text: &str| match text {
            "" => "–".to_owned(),
            text => format!("`{}`", text.trim_start_matches('/')),
        };
        let need = match call.need {
            Need::Nothing => "nothing".to_owned(),
            Need::Key => "a key".to_owned(),
            Need::OneOf(rights) => rights.names().join(", "),
            Need::OfOperator(rights) => format!("{}; the operator", rights.names().join(", ")),
        };
        let grpc = match call.grpc.starts_with('/') {
            true => call.grpc.to_owned(),
            false => call.grpc.replace('/', "."),
        };
        table += &format!("| {} | {} | {need} |\n", shown(&grpc), shown(call.rest));
    }
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/keys.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (before, rest) = text.split_once(TABLE_BEGIN).expect("the table begins with its marker");
    let (printed, after) = rest.split_once(TABLE_END).expect("the table ends with its marker");
    if std::env::var_os("GRAPHFIX_ACCEPT").is_some() {
        let text = format!("{before}{TABLE_BEGIN}{table}{TABLE_END}{after}");
        std::fs::write(path, text).unwrap();
    } else {
        assert_eq!(printed, table, "look at the change, then run with GRAPHFIX_ACCEPT=1");
    }
}

/// The path of a call on gRPC.
fn path_of(call: &Call) -> String {
    match call.grpc.starts_with('/') {
        true => call.grpc.to_owned(),
        false => format!("/graphfix.v1.{}", call.grpc),
    }
}

/// A request of each call on each of its doors.
fn requests(call: &Call, authorization: Option<&str>) -> Vec<Request<Body>> {
    let mut requests = Vec::new();
    let authorized = |request: axum::http::request::Builder| match authorization {
        Some(text) => request.header("authorization", text),
        None => request,
    };
    if !call.grpc.is_empty() {
        let request = Request::post(path_of(call)).header("content-type", "application/grpc");
        let request = authorized(request).header("te", "trailers");
        requests.push(request.body(Body::from(vec![0; 5])).unwrap());
    }
    if let Some((method, path)) = call.rest.split_once(' ') {
        let path = path.replace("{session}", "ses_0").replace("{base}", "bas_0");
        let path = path.replace("{seq}", "1").replace("{key}", "key_0").replace("{file}", "x");
        let path = path.replace("{format}", "csv").replace("{job}", "job_0");
        let path = path.replace("{tenant}", "default").replace("{upload}", "upl_0");
        let request = authorized(Request::builder().method(method).uri(path));
        requests.push(request.body(Body::empty()).unwrap());
    }
    requests
}

/// The stable code of an answer of either door, if it is a refusal.
async fn refusal(response: Response<Body>) -> Option<String> {
    if let Some(status) = Status::from_header_map(response.headers()) {
        return code_of(&status);
    }
    let kind = response.headers().get("content-type");
    let is_stream = ["application/grpc", "text/event-stream"]
        .into_iter()
        .any(|stream| kind.is_some_and(|kind| kind.as_bytes().starts_with(stream.as_bytes())));
    if is_stream {
        return None; // The call is served. Some of these streams have no end.
    }
    let bytes = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    let answer: Value = serde_json::from_slice(&bytes).ok()?;
    answer["code"].as_str().map(ToOwned::to_owned)
}

/// Without a key, with a wrong key and without the right, both doors refuse every call, and no
/// memory stays reserved. Health and pages are served without a key.
#[tokio::test]
async fn every_call_needs_a_key_with_its_right() {
    let doors = Doors::open().await;
    let admin = first_key(&doors).await;
    let mut keys = Vec::new();
    for right in Right::ALL {
        let key = created(&doors, Some(&admin), json!({"rights": [right.name()]})).await;
        keys.push((right, key));
    }
    let refusals = ["KEY_REQUIRED", "KEY_INVALID", "RIGHT_MISSING"];
    let check = async |call: &Call, authorization: Option<&str>, expected: Option<&str>| {
        for request in requests(call, authorization) {
            let what = format!("{} {}", request.method(), request.uri());
            let response = doors.router.clone().oneshot(request).await.unwrap();
            let code = refusal(response).await;
            match expected {
                Some(expected) => assert_eq!(code.as_deref(), Some(expected), "{what}"),
                None => {
                    let is_open = code.as_deref().is_none_or(|code| !refusals.contains(&code));
                    assert!(is_open, "{what}: {code:?}");
                }
            }
        }
    };
    let wrong = format!("Bearer gfx_{}", "0".repeat(64));
    for call in CALLS {
        let need = |code| (call.need != Need::Nothing).then_some(code);
        check(call, None, need("KEY_REQUIRED")).await;
        check(call, Some("Basic Zm9v"), need("KEY_INVALID")).await;
        check(call, Some(&wrong), need("KEY_INVALID")).await;
        for (right, key) in &keys {
            let has = match call.need {
                Need::Nothing | Need::Key => true,
                Need::OneOf(rights) | Need::OfOperator(rights) => {
                    rights.meets(Rights::of(&[*right]))
                }
            };
            let bearer = format!("Bearer {}", key.secret);
            check(call, Some(&bearer), (!has).then_some("RIGHT_MISSING")).await;
        }
    }
    let budget = async || doors.service.budget().used();
    until("returned to the budget", budget, |used| *used == 0).await;
}

/// Status, headers and remedy of refusals. An unknown path is reported as such, also without a key.
#[tokio::test]
async fn a_refusal_says_what_to_do() {
    let doors = Doors::open().await;
    let admin = first_key(&doors).await;
    let device = created(&doors, Some(&admin), json!({"rights": ["device"]})).await;
    let response = doors
        .router
        .clone()
        .oneshot(request(None, "GET", "/v1/sessions", &Value::Null))
        .await
        .unwrap();
    assert_eq!(response.status(), StatusCode::UNAUTHORIZED);
    assert_eq!(response.headers()["www-authenticate"], "Bearer realm=\"graphfix\"");
    let (status, answer) = asked(&doors, Some(&device), "GET", "/v1/sessions", json!(null)).await;
    assert_eq!((status, code(&answer)), (StatusCode::FORBIDDEN, "RIGHT_MISSING"));
    assert!(answer["detail"].as_str().unwrap().contains(&device.id), "{answer}");
    let twice = Request::get("/v1/sessions")
        .header("authorization", format!("Bearer {}", admin.secret))
        .header("authorization", format!("Bearer {}", admin.secret));
    let (status, answer) = doors.ask(twice.body(Body::empty()).unwrap()).await;
    assert_eq!((status.as_u16(), code(&answer)), (401, "KEY_INVALID"), "{answer}");
    for (path, expected) in [("/v1/nothing", 404), ("/graphfix.v1.Nothing/Do", 404)] {
        let (status, answer) = asked(&doors, None, "GET", path, json!(null)).await;
        assert_eq!((status.as_u16(), code(&answer)), (expected, "ROUTE_NOT_FOUND"), "{path}");
    }
    let put = request(Some(&admin), "PUT", "/v1/sessions", &json!({}));
    let response = doors.router.clone().oneshot(put).await.unwrap();
    assert_eq!(response.status(), StatusCode::METHOD_NOT_ALLOWED);
    assert_eq!(response.headers()["allow"], "POST, GET");
}

async fn a_key_opens_what_its_rights_allow(database: Database) {
    let doors = Doors::on(&database.url).await;
    let session = doors.session().await; // Without keys everything is open.
    let admin = first_key(&doors).await;
    let request = json!({"rights": ["read"], "label": "dashboard", "lifetimeS": 3600});
    let reader = created(&doors, Some(&admin), request).await;
    let path = format!("/v1/sessions/{session}");
    let (status, _) = asked(&doors, Some(&reader), "GET", &path, json!(null)).await;
    assert_eq!(status, StatusCode::OK);
    let (status, answer) = asked(&doors, Some(&reader), "DELETE", &path, json!(null)).await;
    assert_eq!((status, code(&answer)), (StatusCode::FORBIDDEN, "RIGHT_MISSING"));

    let mut keys = KeysClient::new(wire_of(&doors, &admin));
    let listed = keys.list(v1::ListKeysRequest::default()).await.unwrap().into_inner().keys;
    let ids: Vec<&str> = listed.iter().map(|key| &*key.key).collect();
    assert_eq!(ids, [&*reader.id, &*admin.id], "the newest first");
    let of_reader = &listed[0];
    assert_eq!((&*of_reader.label, &*of_reader.tenant), ("dashboard", "default"));
    assert_eq!(of_reader.rights, ["read"]);
    assert!(of_reader.created_utc < *of_reader.expires_utc.as_ref().unwrap());
    let page = v1::ListKeysRequest { page_size: 1, ..Default::default() };
    let first = keys.list(page.clone()).await.unwrap().into_inner();
    let page = v1::ListKeysRequest { page_token: first.next_page_token, ..page };
    let second = keys.list(page).await.unwrap().into_inner();
    assert_eq!([first.keys, second.keys].concat(), listed);

    let by_rest = asked(&doors, Some(&admin), "GET", "/v1/keys", json!(null)).await.1;
    assert_eq!(by_rest["keys"], json!(listed));
    let text = by_rest.to_string();
    assert!(!text.contains(&reader.secret[4..]), "the secret is shown once");

    let one = keys.get(v1::GetKeyRequest { key: reader.id.clone() }).await.unwrap().into_inner();
    assert_eq!(one, listed[0]);
    let path = format!("/v1/keys/{}", reader.id);
    let (status, by_rest) = asked(&doors, Some(&admin), "GET", &path, json!(null)).await;
    assert_eq!((status, by_rest), (StatusCode::OK, json!(one)));
    let (_, refused) = asked(&doors, Some(&reader), "GET", &path, json!(null)).await;
    assert_eq!(code(&refused), "RIGHT_MISSING");
    assert_eq!(asked(&doors, Some(&admin), "DELETE", &path, json!(null)).await.0, StatusCode::OK);
    let (_, revoked) = asked(&doors, Some(&admin), "GET", &path, json!(null)).await;
    assert!(revoked["revokedUtc"].is_string(), "{revoked}");
}

/// Only its own tenant and the operator find a key by its id. For others the answer is the same as
/// for a key that does not exist.
#[tokio::test]
async fn a_key_is_found_in_its_tenant_and_by_the_operator() {
    let doors = Doors::open().await;
    let operator = first_key(&doors).await;
    let of_tenant = json!({"rights": ["admin"], "tenant": "mowers"});
    let mower = created(&doors, Some(&operator), of_tenant).await;
    let found = async |by: &Key, id: &str| {
        asked(&doors, Some(by), "GET", &format!("/v1/keys/{id}"), json!(null)).await
    };
    for by in [&mower, &operator] {
        let (status, key) = found(by, &mower.id).await;
        assert_eq!((status, &key["tenant"]), (StatusCode::OK, &json!("mowers")), "{key}");
    }
    let unknown = format!("key_{}", "0".repeat(32));
    for id in [&*operator.id, &unknown, "none"] {
        let (status, refused) = found(&mower, id).await;
        assert_eq!((status.as_u16(), code(&refused)), (404, "KEY_NOT_FOUND"), "{id}");
        let detail = refused["detail"].as_str().unwrap().replace(id, "ID");
        assert_eq!(
            detail,
            found(&mower, &unknown).await.1["detail"].as_str().unwrap().replace(&unknown, "ID")
        );
    }
}

/// An open stream and both watches of a key.
struct Open {
    stream: EpochFlow,
    watch: Streaming<v1::WatchSolutionsResponse>,
    events: axum::body::BodyDataStream,
}

async fn opened(doors: &Doors, key: &Key, session: &str) -> Open {
    let opening = v1::StreamOpening { session: session.to_owned(), ..v1::StreamOpening::default() };
    let mut stream = flow::epochs(wire_of(doors, key), opening).await;
    stream.answer().await;
    let request_of =
        v1::WatchSolutionsRequest { session: session.to_owned(), ..Default::default() };
    let mut client = SolutionsClient::new(wire_of(doors, key));
    let mut watch = client.watch(request_of).await.unwrap().into_inner();
    watch.message().await.unwrap().unwrap();
    let path = format!("/v1/sessions/{session}/solutions:watch");
    let ask = request(Some(key), "GET", &path, &Value::Null);
    let response = doors.router.clone().oneshot(ask).await.unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    Open { stream, watch, events: response.into_body().into_data_stream() }
}

/// The last bytes of an event stream.
async fn last_event(events: &mut axum::body::BodyDataStream) -> String {
    let mut last = String::new();
    while let Some(bytes) = events.next().await {
        last = String::from_utf8(bytes.unwrap().to_vec()).unwrap();
    }
    last
}

/// The code with which a watch ends.
async fn end_of(watch: &mut Streaming<v1::WatchSolutionsResponse>) -> String {
    loop {
        match watch.message().await {
            Ok(message) => assert!(message.is_some(), "the watch ended without a reason"),
            Err(status) => return code_of(&status).unwrap(),
        }
    }
}

impl Open {
    /// Waits for the end of all three, and checks its code.
    async fn end_with(mut self, expected: &str) {
        let status = self.stream.refusal().await;
        assert_eq!(code_of(&status).as_deref(), Some(expected), "{status:?}");
        assert_eq!(status.code(), tonic::Code::Unauthenticated);
        assert_eq!(end_of(&mut self.watch).await, expected);
        let last = last_event(&mut self.events).await;
        assert!(last.contains("event: end") && last.contains(expected), "{last}");
    }
}

/// A revocation ends active and idle streams within a second. Streams of other keys continue.
async fn a_revocation_ends_open_streams_and_watches(database: Database) {
    let doors = Doors::on(&database.url).await;
    let session = doors.session().await;
    let before = opened_without(&doors, &session).await;
    let admin = first_key(&doors).await;
    before.end_with("KEY_REQUIRED").await;
    let rights = json!({"rights": ["device", "read"]});
    let (one, other) = (
        created(&doors, Some(&admin), rights.clone()).await,
        created(&doors, Some(&admin), rights).await,
    );
    let ended = opened(&doors, &one, &session).await;
    let mut stays = opened(&doors, &other, &session).await;
    ended.stream.push(vec![message(1)]).await;
    let path = format!("/v1/keys/{}", one.id);
    let (status, revoked) = asked(&doors, Some(&admin), "DELETE", &path, json!(null)).await;
    assert_eq!(status, StatusCode::OK);
    assert!(revoked["revokedUtc"].is_string(), "{revoked}");
    ended.stream.push(vec![message(2)]).await;
    ended.end_with("KEY_REVOKED").await;
    let (status, answer) = asked(&doors, Some(&one), "GET", "/v1/sessions", json!(null)).await;
    assert_eq!((status.as_u16(), code(&answer)), (401, "KEY_REVOKED"));
    let last = SessionsClient::new(wire_of(&doors, &other))
        .get(v1::GetSessionRequest { session })
        .await
        .unwrap()
        .into_inner()
        .durable_through
        .unwrap_or(0);
    stays.stream.push(vec![message(last + 1)]).await;
    stays.stream.until_durable(last + 1).await;
}

/// A stream and watches that were opened before the first key exists.
async fn opened_without(doors: &Doors, session: &str) -> Open {
    let nobody = Key { id: String::new(), secret: "nothing".to_owned() };
    opened(doors, &nobody, session).await
}

async fn an_expiry_ends_a_key_and_its_watch(database: Database) {
    let doors = Doors::on(&database.url).await;
    let session = doors.session().await;
    let admin = first_key(&doors).await;
    let request = json!({"rights": ["device", "read"], "lifetimeS": 3600});
    let key = created(&doors, Some(&admin), request).await;
    let open = opened(&doors, &key, &session).await;
    // Another process, such as `graphfix keys rotate`, sets an earlier expiry in this way.
    database.execute("UPDATE api_key_changes SET number = number + 1").await;
    let expire = format!(
        "UPDATE api_keys SET expires_unix_ms = 1, \
         changed = (SELECT number FROM api_key_changes) WHERE id = '{}'",
        key.id
    );
    database.execute(&expire).await;
    open.end_with("KEY_EXPIRED").await;
    let (status, answer) = asked(&doors, Some(&key), "GET", "/v1/sessions", json!(null)).await;
    assert_eq!((status.as_u16(), code(&answer)), (401, "KEY_EXPIRED"));
}

/// Many requests run while their key is revoked. Each gets a whole answer or a refusal with its
/// code.
async fn answers_beside_a_revocation_are_whole(database: Database) {
    let doors = Doors::on(&database.url).await;
    let session = doors.session().await;
    let epochs: Vec<Value> = (1..=200).map(epoch).collect();
    doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": epochs})).await;
    let admin = first_key(&doors).await;
    let key = created(&doors, Some(&admin), json!({"rights": ["read"]})).await;
    let path = format!("/v1/sessions/{session}/solutions");
    let is_used = Notify::new();
    let ask = async || {
        let mut whole = 0;
        loop {
            let (status, answer) = asked(&doors, Some(&key), "GET", &path, json!(null)).await;
            match status.as_u16() {
                200 => {
                    assert_eq!(answer["solutions"].as_array().map(Vec::len), Some(200));
                    is_used.notify_one();
                }
                _ => {
                    assert_eq!((status.as_u16(), code(&answer)), (401, "KEY_REVOKED"), "{answer}");
                    return whole;
                }
            }
            whole += 1;
        }
    };
    let revoke = async {
        is_used.notified().await;
        let path = format!("/v1/keys/{}", key.id);
        asked(&doors, Some(&admin), "DELETE", &path, json!(null)).await
    };
    let (a, b, c, (status, revoked)) = tokio::join!(ask(), ask(), ask(), revoke);
    assert_eq!(status, StatusCode::OK, "{revoked}");
    assert!(0 < a + b + c);
}

/// The last uses of keys are stored when the service stops, and the service can start again at
/// once.
async fn uses_are_noted_and_the_service_starts_again(database: Database) {
    let mut doors = Doors::on(&database.url).await;
    let admin = first_key(&doors).await;
    for _ in 0..3 {
        let (status, listed) = asked(&doors, Some(&admin), "GET", "/v1/keys", json!(null)).await;
        assert_eq!(status, StatusCode::OK, "{listed}");
        doors = doors.restarted().await;
    }
    let listed = asked(&doors, Some(&admin), "GET", "/v1/keys", json!(null)).await.1;
    assert!(listed["keys"][0]["lastUsedUtc"].is_string(), "{listed}");
}
