//! Keys, sign-ins and TLS in a cluster: a call that reaches the wrong node is answered as at the
//! right one.

#![cfg(target_os = "linux")]

use std::time::{Duration, Instant};

use futures::StreamExt;
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::navigation_client::NavigationClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use serde_json::{Value, json};
use tonic::metadata::AsciiMetadataValue;
use tonic::service::interceptor::InterceptedService;
use tonic::{Request, Status};

use crate::support::database::{Database, on_postgres};
use crate::support::doors::code;
use crate::support::drive::DRIVE;
use crate::support::flow::{self, EpochFlow};
use crate::support::nodes::{
    Node, Setting, bearing, created, key_of, node_of, of_session, push_of, two,
};
use crate::support::server::{Answer, ask, replayed};
use crate::support::tls::{Authority, Files, text};
use crate::support::wait::until;

/// A change of a key is in force at every node within this time.
const IN_FORCE: Duration = Duration::from_secs(1);
/// Time between requests with a key that may not be known yet.
const SELDOM: Duration = Duration::from_millis(150);

/// The headers of a browser or a device.
#[derive(Clone, Default)]
struct Headers(Vec<(String, String)>);

impl Headers {
    fn key(secret: &str) -> Self {
        Self(vec![("Authorization".to_owned(), format!("Bearer {secret}"))])
    }

    fn with(&self, name: &str, value: &str) -> Self {
        let mut headers = self.clone();
        headers.0.push((name.to_owned(), value.to_owned()));
        headers
    }

    fn ask(&self, node: &Node, method: &str, path: &str, body: &Value) -> Answer {
        let headers: Vec<(&str, &str)> = self.0.iter().map(|(n, v)| (&**n, &**v)).collect();
        let body = if body.is_null() { String::new() } else { body.to_string() };
        ask(node.port, (method, path), &headers, &body).unwrap()
    }
}

/// Two nodes that need keys, and the secret of a key with all rights.
async fn with_keys(database: &Database) -> ([Node; 2], String) {
    let rights = ["--right", "device,read,operate,admin"];
    let key = key_of(&database.url, &rights);
    let nodes = two(&database.url, &Setting::default()).await;
    let push = v1::PushNavigationRequest { content: DRIVE.navigation_file().into() };
    let push = bearing(&key, Request::new(push));
    // The push goes to the node that does not lead.
    let answer = NavigationClient::new(nodes[1].channel()).push(push).await.unwrap();
    assert_eq!(node_of(&answer), "first");
    (nodes, key)
}

/// A session at a node.
async fn session_at(node: &Node, key: &str) -> String {
    let new = v1::CreateSessionRequest { mode: "fgo".to_owned(), ..Default::default() };
    let new = bearing(key, Request::new(new));
    let answer = SessionsClient::new(node.channel()).create(new).await.unwrap();
    assert_eq!(node_of(&answer), node.name);
    let session = answer.into_inner().session;
    // The node claims the session at its first push.
    let push = bearing(key, of_session(&session, push_of(&session, 1)));
    let answer = PositioningClient::new(node.channel()).push_epochs(push).await.unwrap();
    assert_eq!(node_of(&answer), node.name);
    session
}

/// Creates a key by a call at a node. Returns its id and its secret.
fn new_key(node: &Node, by: &str, rights: &Value) -> (String, String) {
    let answer = Headers::key(by).ask(node, "POST", "/v1/keys", &json!({ "rights": rights }));
    assert_eq!(answer.status, 201, "{answer:?}");
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    (text(&answer.json()["key"]["key"]), text(&answer.json()["secret"]))
}

/// Time until a node knows a key that another node has just made. Requests are seldom, because the
/// service counts wrong keys.
async fn known_after(node: &Node, key: &str) -> Duration {
    let made = Instant::now();
    let ask = async || {
        tokio::time::sleep(SELDOM).await;
        Headers::key(key).ask(node, "GET", "/v1/sessions", &Value::Null)
    };
    until("known", ask, |answer| answer.status == 200).await;
    made.elapsed()
}

/// The epoch of this number as a body of REST.
fn body_of(session: &str, seq: u64) -> Value {
    json!({ "epochs": serde_json::to_value(push_of(session, seq)).unwrap()["epochs"] })
}

/// A stream of a session through a node, with a key.
async fn stream_of(node: &Node, session: &str, key: &str) -> EpochFlow {
    let bearer: AsciiMetadataValue = format!("Bearer {key}").parse().unwrap();
    let header: AsciiMetadataValue = session.parse().unwrap();
    let channel = InterceptedService::new(node.channel(), move |mut request: Request<()>| {
        request.metadata_mut().insert("authorization", bearer.clone());
        request.metadata_mut().insert("x-graphfix-session", header.clone());
        Ok::<_, Status>(request)
    });
    let opening = v1::StreamOpening { session: session.to_owned(), ..Default::default() };
    flow::epochs(channel, opening).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_key_is_worth_the_same_at_every_node() {
    on_postgres(async |database| {
        let ([first, second], admin) = with_keys(&database).await;
        let session = session_at(&second, &admin).await;
        let epochs = format!("/v1/sessions/{session}/epochs");
        // The key is used at once, before the node of the session can have read it.
        for seq in 2..=6 {
            let (_, key) = new_key(&first, &admin, &json!(["device"]));
            let body = body_of(&session, seq);
            let answer = Headers::key(&key).ask(&first, "POST", &epochs, &body);
            assert_eq!((answer.status, answer.header("x-graphfix-node")), (200, "second"));
            assert_eq!(answer.json()["results"][0]["seq"], seq, "{answer:?}");
        }
        // A key is used at another node than the one that made it.
        let (_, key) = new_key(&second, &admin, &json!(["read"]));
        let known = known_after(&first, &key).await;
        // Rights, wrong keys and missing ones are refused by the first node.
        let answer = Headers::key(&key).ask(&first, "POST", &epochs, &body_of(&session, 7));
        assert_eq!((answer.status, code(&answer.json())), (403, "RIGHT_MISSING"));
        let wrong = format!("gfx_{}", "0".repeat(64));
        let answer = Headers::key(&wrong).ask(&first, "POST", &epochs, &body_of(&session, 7));
        assert_eq!((answer.status, code(&answer.json())), (401, "KEY_INVALID"));
        let answer = Headers::default().ask(&first, "POST", &epochs, &body_of(&session, 7));
        assert_eq!((answer.status, code(&answer.json())), (401, "KEY_REQUIRED"));
        // A request that claims to be forwarded by a node needs the secret of this node.
        let forged = Headers::default().with("x-graphfix-from", "1.0").with("x-graphfix-key", "");
        let answer = forged.ask(&second, "POST", &epochs, &body_of(&session, 7));
        assert_eq!((answer.status, code(&answer.json())), (401, "KEY_REQUIRED"));
        eprintln!("a key is known elsewhere after {known:?}");
        assert!(known < IN_FORCE, "{known:?}");
        let (is_equal, text, error) = replayed(&database.url, &session, &[]);
        assert!(is_equal, "{text}{error}");
    })
    .await;
}

/// A stream and a watch go through the wrong node, and their key is revoked there. Both nodes
/// refuse the key, and stream and watch end.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_revoked_key_is_refused_by_every_node() {
    on_postgres(async |database| {
        let (nodes, admin) = with_keys(&database).await;
        for (owner, other) in [(0, 1), (1, 0)] {
            let (owner, other) = (&nodes[owner], &nodes[other]);
            let session = session_at(owner, &admin).await;
            let (id, key) = new_key(owner, &admin, &json!(["device", "read"]));
            known_after(other, &key).await;

            let mut stream = stream_of(other, &session, &key).await;
            let watch = v1::WatchSolutionsRequest {
                session: session.clone(),
                after_seq: Some(0),
                ..Default::default()
            };
            let watch = bearing(&key, Request::new(watch));
            let answer = SolutionsClient::new(other.channel()).watch(watch).await.unwrap();
            assert_eq!(node_of(&answer), other.name);
            let mut watch = answer.into_inner();
            stream.push(push_of(&session, 2).epochs).await;
            stream.until_durable(2).await;
            let mut seen = Vec::new();
            while seen.last() != Some(&2) {
                let message = watch.next().await.unwrap().unwrap();
                seen.extend(message.solutions.iter().map(|solution| solution.seq));
            }
            assert_eq!(seen, [1, 2]);

            let path = format!("/v1/keys/{id}");
            let revoked = Instant::now();
            let answer = Headers::key(&admin).ask(other, "DELETE", &path, &Value::Null);
            assert_eq!(answer.status, 200, "{answer:?}");
            let at = async |node: &Node| {
                let ask =
                    async || Headers::key(&key).ask(node, "GET", "/v1/sessions", &Value::Null);
                let answer = until("refused", ask, |answer| answer.status != 200).await;
                assert_eq!((answer.status, code(&answer.json())), (401, "KEY_REVOKED"));
                revoked.elapsed()
            };
            let refused = [at(other).await, at(owner).await];
            assert_eq!(code_of(&stream.refusal().await).as_deref(), Some("KEY_REVOKED"));
            let ended = loop {
                match watch.next().await.unwrap() {
                    Ok(_) => {}
                    Err(status) => break status,
                }
            };
            assert_eq!(code_of(&ended).as_deref(), Some("KEY_REVOKED"));
            let all = revoked.elapsed();
            eprintln!("refused after {refused:?}, stream and watch ended after {all:?}");
            assert!(all < IN_FORCE, "{refused:?}, {all:?}");
        }
    })
    .await;
}

/// The cookie that an answer sets, as a browser sends it back.
fn cookie_of(answer: &Answer) -> String {
    answer.header("set-cookie").split(';').next().unwrap().to_owned()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_browser_is_signed_in_at_every_node() {
    on_postgres(async |database| {
        let ([mut first, second], admin) = with_keys(&database).await;
        let session = session_at(&second, &admin).await;
        let path = format!("/v1/sessions/{session}");
        let begun = Headers::key(&admin).ask(&first, "POST", "/v1/sign-in", &Value::Null);
        assert_eq!(begun.status, 201, "{begun:?}");
        let cookie = Headers::default().with("Cookie", &cookie_of(&begun));
        let token = begun.json()["csrfToken"].as_str().unwrap().to_owned();
        let signed = cookie.with("x-graphfix-csrf", &token);
        // The cookie works at once at the other node.
        let known = cookie.ask(&second, "GET", "/v1/sessions", &Value::Null);
        assert_eq!((known.status, known.header("x-graphfix-node")), (200, "second"));
        let state = cookie.ask(&second, "GET", "/v1/sign-in", &Value::Null);
        assert_eq!(state.json()["csrfToken"].as_str(), Some(&*token), "{state:?}");
        // Changes go through each node to the other: of a session, and of a base.
        let label = |label: &str| json!({ "label": label });
        let refused = cookie.ask(&first, "PATCH", &path, &label("a"));
        assert_eq!((refused.status, code(&refused.json())), (403, "CSRF_TOKEN_INVALID"));
        let foreign = cookie.with("x-graphfix-csrf", &format!("gfx_{}", "0".repeat(64)));
        let refused = foreign.ask(&first, "PATCH", &path, &label("a"));
        assert_eq!((refused.status, code(&refused.json())), (403, "CSRF_TOKEN_INVALID"));
        let changed = signed.ask(&first, "PATCH", &path, &label("changed"));
        assert_eq!((changed.status, changed.header("x-graphfix-node")), (200, "second"));
        assert_eq!(changed.json()["label"], "changed", "{changed:?}");
        let base = signed.ask(&second, "POST", "/v1/bases", &label("base"));
        assert_eq!((base.status, base.header("x-graphfix-node")), (201, "first"), "{base:?}");
        let pushed = signed.ask(&first, "POST", &format!("{path}/epochs"), &body_of(&session, 2));
        assert_eq!((pushed.status, pushed.header("x-graphfix-node")), (200, "second"));
        // A made-up cookie is refused.
        let made_up = format!("graphfix_sign_in=gfx_{}", "0".repeat(64));
        let made_up = Headers::default().with("Cookie", &made_up);
        let refused = made_up.ask(&second, "GET", "/v1/sessions", &Value::Null);
        assert_eq!((refused.status, code(&refused.json())), (401, "SIGN_IN_ENDED"));

        // The sign-in outlives its node. When it ends at one node, it ends at the other.
        first.kill();
        first.serve();
        first.is_ready().await;
        let kept = cookie.ask(&first, "GET", "/v1/sessions", &Value::Null);
        assert_eq!(kept.status, 200, "{kept:?}");
        let ended = Instant::now();
        let out = signed.ask(&second, "DELETE", "/v1/sign-in", &Value::Null);
        assert_eq!(out.status, 200, "{out:?}");
        let ask = async || cookie.ask(&first, "GET", "/v1/sessions", &Value::Null);
        let refused = until("signed out", ask, |answer| answer.status != 200).await;
        assert_eq!((refused.status, code(&refused.json())), (401, "SIGN_IN_ENDED"));
        let ended = ended.elapsed();
        eprintln!("signed out elsewhere after {ended:?}");
        assert!(ended < IN_FORCE, "{ended:?}");
    })
    .await;
}

/// Nodes that reach each other with TLS, and a node that trusts another authority.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nodes_check_each_others_certificates() {
    on_postgres(async |database| {
        let (authority, stranger) = (Authority::new("one"), Authority::new("other"));
        let files = Files::new(&authority.signed());
        let setting = |authority_file: &str, authorities: &Authority| {
            let path = files.write(authority_file, &authorities.pem);
            let (certificate, key) = (files.path("service.pem"), files.path("service.key"));
            let arguments = [
                ("--tls-certificate", text(&certificate)),
                ("--tls-key", text(&key)),
                ("--cluster-ca", text(&path)),
            ];
            let arguments: Vec<&str> = arguments.iter().flat_map(|(n, v)| [*n, *v]).collect();
            Setting { client: Some(authority.client(None, "h2")), ..Setting::of(&arguments) }
        };
        let trusting = setting("nodes.pem", &authority);
        let [first, second] = two(&database.url, &trusting).await;
        let push = v1::PushNavigationRequest { content: DRIVE.navigation_file().into() };
        NavigationClient::new(second.channel()).push(push).await.unwrap();
        let session = created(&second.channel(), "fgo").await;
        let mut numbers = 1_u64..;
        let mut push = async |node: &Node| {
            let push = of_session(&session, push_of(&session, numbers.next().unwrap()));
            PositioningClient::new(node.channel()).push_epochs(push).await
        };
        for node in [&second, &first, &second, &first] {
            let answer = push(node).await.unwrap();
            assert_eq!(node_of(&answer), "second");
        }
        let distrusting = setting("strangers.pem", &stranger);
        let third = Node::start("third", &database.url, &distrusting).await;
        third.is_ready().await;
        let refused = push(&third).await.unwrap_err();
        assert_eq!(code_of(&refused).as_deref(), Some("NODE_UNREACHABLE"), "{refused}");
        assert!(refused.message().contains("certificate"), "{refused}");
    })
    .await;
}
