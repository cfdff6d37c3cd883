//! Traces for OpenTelemetry: the spans that an independent collector receives. A collector that is
//! gone or silent harms nothing.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::contract::v1;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::support::doors::{Doors, epoch};
use crate::support::python;
use crate::support::server::free_port;
use crate::support::wait::until;

/// The caller's trace and span, as in the example of W3C Trace Context.
const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const CALLER: &str = "00f067aa0ba902b7";

/// The collector of another project, with the spans that it has received.
struct Collector {
    child: Child,
    port: u16,
    spans: Arc<Mutex<Vec<Value>>>,
}

impl Collector {
    /// `None` (noted) if its messages are not installed.
    fn start() -> Option<Self> {
        let python =
            python::with("grpc, opentelemetry.proto.collector.trace.v1.trace_service_pb2")?;
        let (port, spans) = (free_port(), Arc::<Mutex<Vec<Value>>>::default());
        let script = Path::new(env!("CARGO_MANIFEST_DIR"));
        let script = script.join("tests/support/python/collector.py");
        let mut command = Command::new(python);
        command.arg(script).arg(port.to_string()).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (printed, kept) = (BufReader::new(child.stdout.take().unwrap()), spans.clone());
        thread::spawn(move || {
            for line in printed.lines().map_while(Result::ok) {
                kept.lock().unwrap().push(serde_json::from_str(&line).unwrap());
            }
        });
        Some(Self { child, port, spans })
    }

    /// The spans of a trace with this name, once there are `count` of them.
    async fn named(&self, name: &str, count: usize) -> Vec<Value> {
        let found = async || {
            let spans = self.spans.lock().unwrap();
            spans.iter().filter(|span| span["name"] == name).cloned().collect::<Vec<_>>()
        };
        until(name, found, |found| count <= found.len()).await
    }
}

impl Drop for Collector {
    fn drop(&mut self) {
        // Err: it has ended.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Pushes an epoch with a caller's `traceparent`; returns the id of the request.
async fn pushed(doors: &Doors, session: &str, seq: u64, flags: &str) -> String {
    let request = Request::post(format!("/v1/sessions/{session}/epochs"))
        .header("content-type", "application/json")
        .header("traceparent", format!("00-{TRACE}-{CALLER}-{flags}"));
    let body = json!({"epochs": [epoch(seq)]}).to_string();
    let answer = doors.router.clone().oneshot(request.body(Body::from(body)).unwrap()).await;
    let answer = answer.unwrap();
    assert_eq!(answer.status(), StatusCode::OK);
    answer.headers()["x-request-id"].to_str().unwrap().to_owned()
}

async fn session(doors: &Doors) -> String {
    let (status, session) = doors.post("/v1/sessions", json!({"label": "traced"})).await;
    assert_eq!(status, StatusCode::CREATED, "{session}");
    session["session"].as_str().unwrap().to_owned()
}

/// The number of a counter on the page of meters.
async fn counted(doors: &Doors, name: &str) -> u64 {
    let page = doors.get("/metrics").await.1;
    let line =
        page.as_str().unwrap().lines().find(|line| line.starts_with(name)).unwrap().to_owned();
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

#[tokio::test]
async fn a_collector_receives_the_parts_of_a_request() {
    let Some(collector) = Collector::start() else { return };
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64;
    let doors = Doors::with_collector(&format!("http://127.0.0.1:{}", collector.port)).await;
    let id = session(&doors).await;
    pushed(&doors, &id, 1, "00").await; // Not sampled by its caller.
    let request_id = pushed(&doors, &id, 2, "01").await;
    let refused = doors.post(&format!("/v1/sessions/{id}/epochs"), json!({"epochs": []})).await.0;
    assert_eq!(refused, StatusCode::BAD_REQUEST);

    let [solve] = &collector.named("solve", 1).await[..] else { panic!("one is traced") };
    let [commit] = &collector.named("commit", 1).await[..] else { panic!("one is traced") };
    let [push] = &collector.named("push", 1).await[..] else { panic!("one is traced") };
    let requests = collector.named("Positioning/PushEpochs", 2).await;
    let request = requests.iter().find(|request| request["trace"] == TRACE).unwrap();
    assert_eq!(
        (&request["parent"], &request["kind"]),
        (&json!(CALLER), &json!("SPAN_KIND_SERVER"))
    );
    assert_eq!(request["attributes"]["graphfix.request_id"], json!(request_id));
    assert_eq!(request["attributes"]["graphfix.tenant"], "default");
    assert_eq!(request["attributes"]["graphfix.rest"], "POST /v1/sessions/{session}/epochs");
    assert_eq!(request["attributes"]["http.response.status_code"], "200");
    let node = doors.get("/readyz").await.1["node"].clone();
    assert_eq!(request["resource"]["service.name"], "graphfix");
    assert_eq!(request["resource"]["service.instance.id"], node);
    assert_eq!(push["parent"], request["span"]);
    assert_eq!(push["attributes"]["graphfix.session"], json!(id));
    assert_eq!(push["attributes"]["graphfix.request_id"], json!(request_id));
    assert_eq!(push["attributes"]["graphfix.epochs"], "1");
    let time = |span: &Value, end: &str| span[end].as_u64().unwrap();
    for part in [solve, commit] {
        assert_eq!((&part["parent"], &part["trace"]), (&push["span"], &json!(TRACE)));
        assert!(time(push, "begun") <= time(part, "begun"), "{part}");
        assert!(time(part, "begun") <= time(part, "ended"), "{part}");
        assert!(time(part, "ended") <= time(push, "ended"), "{part}");
    }
    // The clock's milliseconds date each message.
    assert!(since.abs_diff(time(request, "begun")) < 60_000_000_000, "{request}");
    let refused = requests.iter().find(|request| request["trace"] != TRACE).unwrap();
    assert_eq!((&refused["parent"], &refused["status"]), (&json!(""), &json!("STATUS_CODE_UNSET")));
    assert_eq!(refused["attributes"]["http.response.status_code"], "400");
    // All waiting spans are sent before the service ends.
    session(&doors).await;
    let before = collector.named("Sessions/Create", 1).await.len();
    doors.close().await;
    collector.named("Sessions/Create", before + 1).await;
}

#[tokio::test]
async fn each_push_of_a_stream_has_a_trace_of_its_own() {
    let Some(collector) = Collector::start() else { return };
    let doors = Doors::with_collector(&format!("http://127.0.0.1:{}", collector.port)).await;
    let id = session(&doors).await;
    let opening = v1::StreamOpening { session: id.clone(), ..Default::default() };
    let message = |seq| v1::StreamRequest {
        epochs: vec![serde_json::from_value(epoch(seq)).unwrap()],
        ..Default::default()
    };
    let first = v1::StreamRequest { opening: Some(opening), epochs: Vec::new() };
    let messages = futures::stream::iter([first, message(1), message(2)]);
    let mut client = PositioningClient::new(doors.router.clone());
    let mut answers = client.stream(messages).await.unwrap().into_inner();
    while answers.message().await.unwrap().is_some() {}
    let [stream] = &collector.named("Positioning/Stream", 1).await[..] else { panic!("one") };
    let pushes = collector.named("push", 1).await;
    for push in pushes {
        assert_ne!(push["trace"], stream["trace"]);
        assert_eq!(push["links"], json!([[stream["trace"], stream["span"]]]));
    }
    doors.close().await;
}

/// One collector whose port is closed, and one that accepts and never answers.
#[tokio::test]
async fn a_collector_that_is_gone_or_silent_harms_nothing() {
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let ports = [free_port(), silent.local_addr().unwrap().port()];
    for port in ports {
        let doors = Doors::with_collector(&format!("http://127.0.0.1:{port}")).await;
        let id = session(&doors).await;
        for seq in 1..=1500 {
            pushed(&doors, &id, seq, "01").await; // Four spans each: more than the queue has.
        }
        let dropped = async || counted(&doors, "graphfix_trace_spans_dropped_total").await;
        until("spans are dropped", dropped, |count| 0 < *count).await;
        assert_eq!(counted(&doors, "graphfix_trace_spans_exported_total").await, 0);
        let begun = Instant::now();
        doors.close().await;
        assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    }
}

#[tokio::test]
async fn without_a_collector_there_are_no_traces() {
    let doors = Doors::open().await;
    pushed(&doors, &session(&doors).await, 1, "01").await;
    assert_eq!(counted(&doors, "graphfix_trace_spans_exported_total").await, 0);
    assert_eq!(counted(&doors, "graphfix_trace_spans_dropped_total").await, 0);
    doors.close().await;
}

#[test]
fn an_address_that_is_none_is_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let database = format!("sqlite://{}", folder.path().join("graphfix.db").display());
    let listen = format!("127.0.0.1:{}", free_port());
    for address in ["collector:4317", "http://", "http://localhost:4318/v1/traces"] {
        let output = Command::new(env!("CARGO_BIN_EXE_graphfix"))
            .args(["serve", "--database", &database, "--listen", &listen])
            .args(["--otlp-endpoint", address])
            .output()
            .unwrap();
        let line = String::from_utf8(output.stderr).unwrap();
        assert!(line.contains("TELEMETRY_ENDPOINT_INVALID"), "{address}: {line}");
    }
}
