//! Clients that try to exhaust the service: each is refused, and others are served meanwhile.
//!
//! `scripts/hostile` has more of the same clients, and measures memory and the delay of others.

use std::io::Write;
use std::time::Duration;

use axum::body::Body;
use axum::http::{Request, StatusCode, header};
use flate2::Compression;
use flate2::write::GzEncoder;
use futures::{StreamExt, stream};
use graphfix::config::Limits;
use graphfix::contract::v1::create_job_request::Content;
use graphfix::contract::{convert, v1};
use graphfix::grpc::code_of;
use graphfix::grpc::v1::jobs_client::JobsClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tonic::codec::CompressionEncoding;
use tower::ServiceExt;

use crate::support::doors::{Doors, code, epoch};
use crate::support::drive::DRIVE;
use crate::support::wait::until;

const OCTETS: &str = "application/octet-stream";
const JSON: &str = "application/json";

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut packer = GzEncoder::new(Vec::new(), Compression::default());
    packer.write_all(content).unwrap();
    packer.finish().unwrap()
}

/// A connection on which `text` was sent.
async fn sent(port: u16, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    stream.write_all(text.as_bytes()).await.unwrap();
    stream
}

/// All that the service sends until it closes the connection.
async fn answer(stream: &mut TcpStream) -> String {
    let mut answer = Vec::new();
    let read = stream.read_to_end(&mut answer);
    // Err: the service closed it while bytes were on their way.
    tokio::time::timeout(Duration::from_secs(30), read).await.expect("not closed").ok();
    String::from_utf8_lossy(&answer).into_owned()
}

async fn is_served(port: u16) -> bool {
    let request = "GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    answer(&mut sent(port, request).await).await.contains("200 OK")
}

#[tokio::test]
async fn half_heads_and_silent_connections_are_closed() {
    let limits = Limits { head_s: 1, idle_s: 1, ..Limits::standard() };
    let (_doors, port) = Doors::listening(limits).await;
    let mut hostile = Vec::new();
    for text in ["", "GET / HTTP/1.1\r\nhost: loc", "PRI * HTT"] {
        for _ in 0..30 {
            hostile.push(sent(port, text).await);
        }
    }
    let whole = "GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n";
    hostile.push(sent(port, whole).await);
    hostile.push(sent(port, &format!("{whole}GET /heal")).await);
    assert!(is_served(port).await);
    for mut stream in hostile {
        answer(&mut stream).await;
    }
}

#[tokio::test]
async fn half_bodies_use_bounded_memory_and_end() {
    let limits = Limits { body_silence_s: 1, request_memory_bytes: 16 << 20, ..Limits::standard() };
    let (doors, port) = Doors::listening(limits).await;
    let session = doors.session().await;
    let head = format!(
        "POST /v1/navigation HTTP/1.1\r\nhost: localhost\r\ncontent-type: {OCTETS}\r\n\
         content-length: {}\r\n\r\n",
        4 << 20
    );
    let mut hostile = Vec::new();
    for _ in 0..10 {
        hostile.push(sent(port, &head).await);
    }
    let budget = doors.service.budget();
    until("reserved", async || budget.used(), |used| 8 << 20 < *used).await;
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, solved) = doors.post(&path, json!({"epochs": [epoch(1)]})).await;
    assert_eq!(status, StatusCode::OK, "{solved}");
    let mut answers = Vec::new();
    for stream in &mut hostile {
        answers.push(answer(stream).await);
    }
    let count = |text: &str| answers.iter().filter(|answer| answer.contains(text)).count();
    // Bodies have three quarters of 16 MB, from which each request takes some more than its body:
    // two bodies of 4 MB fit, and three do not.
    assert_eq!((count("BODY_TOO_SLOW"), count("MEMORY_EXHAUSTED")), (2, 8), "{answers:?}");
    assert_eq!((count("408 Request Timeout"), count("retry-after: 1")), (2, 8), "{answers:?}");
    until("returned", async || budget.used(), |used| *used == 0).await;
}

/// A stream of files that trickles ends like a body that trickles.
#[tokio::test]
async fn a_stream_of_files_has_a_slowest_rate() {
    let limits = Limits { body_silence_s: 1, ..Limits::standard() };
    let doors = Doors::with(limits).await;
    let message = |content| v1::CreateJobRequest { content: Some(content) };
    let (part, name) = ("rover".to_owned(), "a.file".to_owned());
    let begin = message(Content::Part(v1::JobPart { part, name }));
    let ticks = tokio::time::interval(Duration::from_millis(200));
    let bytes = stream::unfold((ticks, 0), move |(mut ticks, sent)| async move {
        ticks.tick().await;
        (sent < 50).then(|| (message(Content::Chunk(vec![b'x'])), (ticks, sent + 1)))
    });
    let mut client = JobsClient::new(doors.router.clone());
    let trickle = stream::iter([begin]).chain(bytes);
    let refused = client.create(trickle).await.unwrap_err();
    assert_eq!(code_of(&refused).as_deref(), Some("BODY_TOO_SLOW"), "{refused}");
}

/// Empty epochs need few bytes: four million are 12 MB of JSON, and much less when packed.
#[tokio::test]
async fn empty_epochs_are_counted_before_they_are_decoded() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}/epochs", doors.session().await);
    let text = format!("{{\"epochs\":[{}{{}}]}}", "{},".repeat(4_000_000));
    let request =
        |body: Vec<u8>| Request::post(&path).header("content-type", JSON).body(body.into());
    let (status, refusal) = doors.ask(request(text.clone().into_bytes()).unwrap()).await;
    assert_eq!((status, code(&refusal)), (StatusCode::PAYLOAD_TOO_LARGE, "TOO_MANY_EPOCHS"));
    let packed =
        Request::post(&path).header("content-type", JSON).header("content-encoding", "gzip");
    let (_, refusal) = doors.ask(packed.body(Body::from(gzip(text.as_bytes()))).unwrap()).await;
    assert_eq!(code(&refusal), "COMPRESSED_TOO_MUCH");

    let session = doors.session().await;
    let push = |epochs: usize| v1::PushEpochsRequest {
        session: session.clone(),
        epochs: vec![v1::Epoch::default(); epochs],
    };
    let mut client = PositioningClient::new(doors.router.clone());
    let status = client.push_epochs(push(8_000)).await.unwrap_err();
    assert_eq!(code_of(&status).as_deref(), Some("TOO_MANY_EPOCHS"));
    for encoding in [CompressionEncoding::Gzip, CompressionEncoding::Zstd] {
        let mut client = client.clone().send_compressed(encoding);
        let status = client.push_epochs(push(2_000_000)).await.unwrap_err();
        let code = code_of(&status);
        assert_eq!(code.as_deref(), Some("COMPRESSED_TOO_MUCH"), "{encoding:?} {status}");
    }
    assert_eq!(doors.service.budget().used(), 0);
}

/// A RINEX line of `content` with its label.
fn line(content: &str, label: &str) -> String {
    format!("{content:<60}{label}\n")
}

/// A CRINEX file with 32 satellites of four observations each. Every epoch after the first needs
/// eight bytes a satellite.
fn compact_file(epochs: usize) -> String {
    let marker = "  4033460.7500    23538.0200  4924318.3900";
    let mut text = line("3.0                 COMPACT RINEX FORMAT", "CRINEX VERS   / TYPE")
        + &line("hostile", "CRINEX PROG / DATE")
        + &line("     3.05           OBSERVATION DATA    G", "RINEX VERSION / TYPE")
        + &line(marker, "APPROX POSITION XYZ")
        + &line("G    4 C1C L1C D1C S1C", "SYS / # / OBS TYPES")
        + &line("", "END OF HEADER");
    let satellites: String = (1..=32).map(|number| format!("G{number:02}")).collect();
    for epoch in 0..epochs {
        let (minute, second) = (epoch / 60 % 60, epoch % 60);
        let (day, hour) = (1 + epoch / 86_400 % 28, epoch / 3600 % 24);
        text +=
            &format!("> 2019 04 {day:02} {hour:02} {minute:02} {second:02}.0000000  0 32      ");
        text += &satellites;
        text += "\n\n";
        let first = "3&22000000000 3&115000000000 3&1000 3&45000\n";
        text += &if epoch == 0 { first } else { "1 1 0 0\n" }.repeat(32);
    }
    text
}

#[tokio::test]
async fn files_that_unpack_to_much_are_refused_while_they_are_read() {
    let limits =
        Limits { epochs_per_base: 100_000, bytes_per_base: 32 << 10, ..Limits::standard() };
    let doors = Doors::with(limits).await;
    let (_, base) = doors.post("/v1/bases", json!({})).await;
    let path = format!("/v1/bases/{}/observations", base["base"].as_str().unwrap());
    let file = compact_file(1_000);
    let (_, taken) = doors.upload(&path, compact_file(3).into_bytes()).await;
    assert_eq!(taken["epochs"], 3, "{taken}");
    let (_, refusal) = doors.upload(&path, file.clone().into_bytes()).await;
    assert_eq!(code(&refusal), "BASE_TOO_LARGE", "{refusal}");
    let (_, refusal) = doors.upload(&path, gzip(file.repeat(20).as_bytes())).await;
    assert!(["BASE_TOO_LARGE", "COMPRESSED_TOO_MUCH"].contains(&code(&refusal)), "{refusal}");
    let first = line("     3.05           N: GNSS NAV DATA    M", "RINEX VERSION / TYPE");
    let bomb = first + &line("", "END OF HEADER") + &(" ".repeat(69) + "\n").repeat(400_000);
    let (_, refusal) = doors.upload("/v1/navigation", gzip(bomb.as_bytes())).await;
    assert_eq!(code(&refusal), "COMPRESSED_TOO_MUCH", "{refusal}");
    assert_eq!(doors.service.budget().used(), 0);
}

/// A packed chunk of 20 kB completes thousands of epochs, which are counted.
#[tokio::test]
async fn a_packed_chunk_hides_no_epochs() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}/raw?offset=0", doors.session().await);
    let (_, refusal) = doors.upload(&path, gzip(compact_file(9_000).as_bytes())).await;
    let codes = ["TOO_MANY_EPOCHS", "DECOMPRESSED_TOO_LARGE"];
    assert!(codes.contains(&code(&refusal)), "{refusal}");
}

#[tokio::test]
async fn texts_are_short_and_printable() {
    let doors = Doors::open().await;
    let (status, refusal) = doors.post("/v1/bases", json!({"label": "x".repeat(5 << 20)})).await;
    assert_eq!((status.as_u16(), code(&refusal)), (413, "BODY_TOO_LARGE"));
    let refused: [(&str, Value, &str); 7] = [
        ("/v1/sessions", json!({"label": "a\u{0}b"}), "label"),
        ("/v1/sessions", json!({"antenna": "x".repeat(61)}), "antenna"),
        ("/v1/sessions", json!({"mode": "spp\n"}), "mode"),
        ("/v1/sessions", json!({"overrides": {"a\u{1}": "1"}}), "overrides"),
        ("/v1/bases", json!({"label": "\u{7f}"}), "label"),
        ("/v1/bases", json!({"antenna": "A\u{0}"}), "antenna"),
        ("/v1/bases", json!({"ntrip": {"caster": "x".repeat(3000)}}), "ntrip.caster"),
    ];
    for (path, body, field) in refused {
        let (_, refusal) = doors.post(path, body.clone()).await;
        let at_fault = (code(&refusal), refusal["field"].as_str());
        assert_eq!(at_fault, ("INVALID_FIELD", Some(field)), "{path} {body}: {refusal}");
    }
    let (_, refusal) = doors.get(&format!("/v1/sessions/{}", "x".repeat(9_000))).await;
    assert!(refusal["detail"].as_str().unwrap().len() < 300, "{refusal}");
}

/// A web page of somebody else can send requests to a service on this machine. It can use a host
/// name of its own, or send requests whose answers it cannot read. Neither is served.
#[tokio::test]
async fn web_pages_of_others_are_refused() {
    let doors = Doors::open().await;
    let asked = async |host: &str, origin: Option<&str>| {
        let request = Request::get("/v1/navigation").header("host", host);
        let request = origin.into_iter().fold(request, |r, origin| r.header("origin", origin));
        doors.ask(request.body(Body::empty()).unwrap()).await
    };
    for host in ["localhost:8080", "127.0.0.1", "[::1]:8080", "LOCALHOST"] {
        assert_eq!(asked(host, None).await.0, StatusCode::OK, "{host}");
    }
    for host in ["evil.example", "evil.example:8080", "localhost.evil.example", "127.0.0.1.nip.io"]
    {
        let (status, refusal) = asked(host, None).await;
        assert_eq!((status.as_u16(), code(&refusal)), (403, "HOST_REFUSED"), "{host}");
    }
    let own = asked("localhost:8080", Some("http://localhost:8080")).await;
    assert_eq!(own.0, StatusCode::OK);
    for origin in ["http://evil.example", "null", "http://localhost:3000"] {
        let (status, refusal) = asked("localhost:8080", Some(origin)).await;
        assert_eq!((status.as_u16(), code(&refusal)), (403, "ORIGIN_REFUSED"), "{origin}");
    }
    let listed = doors.service.clone().with_hosts(&["gnss.example".to_owned()]);
    let router = graphfix::http::router(&listed);
    let request = Request::get("/healthz").header("host", "gnss.example").body(Body::empty());
    assert_eq!(router.oneshot(request.unwrap()).await.unwrap().status(), StatusCode::OK);
    // Browsers let a page send these content types to other hosts without asking. No call takes
    // them.
    let session = doors.session().await;
    for path in ["/v1/navigation", "/v1/sessions", &format!("/v1/sessions/{session}/raw")] {
        for kind in ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"] {
            let request = Request::post(path).header("content-type", kind);
            let (status, refusal) = doors.ask(request.body(Body::from("{}")).unwrap()).await;
            let answered = (status.as_u16(), code(&refusal));
            assert_eq!(answered, (415, "UNSUPPORTED_MEDIA_TYPE"), "{path} {kind}");
        }
    }
    let request =
        Request::post("/graphfix.v1.Sessions/Create").header("content-type", "text/plain");
    let (status, _) = doors.ask(request.body(Body::from("\0\0\0\0\0")).unwrap()).await;
    assert_eq!(status, StatusCode::UNSUPPORTED_MEDIA_TYPE);
}

#[tokio::test]
async fn answers_are_taken_for_nothing_else() {
    let doors = Doors::open().await;
    for path in ["/", "/docs/", "/v1/navigation", "/v1/nothing"] {
        let request = Request::get(path).body(Body::empty()).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        let headers = response.headers();
        assert_eq!(headers[header::X_CONTENT_TYPE_OPTIONS], "nosniff", "{path}");
        let policy = headers[header::CONTENT_SECURITY_POLICY].to_str().unwrap();
        assert!(policy.starts_with("default-src '"), "{path}: {policy}");
    }
}

#[tokio::test]
async fn a_callers_deadline_is_kept() {
    let doors = Doors::open().await;
    doors.service.navigation().push(DRIVE.navigation.clone(), "test").await.unwrap();
    let epochs = DRIVE.epochs.iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect();
    let solve = v1::SolveOnceRequest { mode: "fgo".to_owned(), epochs, ..Default::default() };
    let mut request = tonic::Request::new(solve);
    request.set_timeout(Duration::from_millis(1));
    let mut client = PositioningClient::new(doors.router.clone());
    let status = client.solve_once(request).await.unwrap_err();
    assert_eq!(status.code(), tonic::Code::DeadlineExceeded);
    assert_eq!(code_of(&status).as_deref(), Some("DEADLINE_EXCEEDED"));
}

#[tokio::test]
async fn connections_have_a_limit_in_all_and_from_one_address() {
    let limits = Limits { connections: 5, connections_per_address: 3, ..Limits::standard() };
    let (_doors, port) = Doors::listening(limits).await;
    let mut open = Vec::new();
    for _ in 0..3 {
        let mut stream = sent(port, "GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").await;
        let mut answer = [0; 12];
        stream.read_exact(&mut answer).await.unwrap();
        assert_eq!(&answer, b"HTTP/1.1 200");
        open.push(stream);
    }
    let refused = answer(&mut sent(port, "").await).await;
    assert!(refused.starts_with("HTTP/1.1 429") && refused.contains("TOO_MANY_CONNECTIONS"));
    drop(open);
    until("served again", async || is_served(port).await, |served| *served).await;
}

/// The computation of one request is bounded by time and by the length of the window.
#[tokio::test]
async fn a_solve_has_a_largest_cost() {
    let doors = Doors::with(Limits { solve_s: 0, ..Limits::standard() }).await;
    doors.service.navigation().push(DRIVE.navigation.clone(), "test").await.unwrap();
    let epochs = |count: usize| -> Vec<Value> {
        let message = |e: &SequencedEpoch| json!(convert::epoch_message(e.seq, &e.epoch));
        DRIVE.epochs[..count].iter().map(message).collect()
    };
    let (status, solved) = doors.post("/v1/solve", json!({"epochs": epochs(1)})).await;
    assert_eq!(status, StatusCode::OK, "{solved}");
    let request = json!({"mode": "fgo", "epochs": epochs(60)});
    let (status, refusal) = doors.post("/v1/solve", request).await;
    assert_eq!((status.as_u16(), code(&refusal)), (413, "TOO_COSTLY"), "{refusal}");
    let overrides = json!({"window_epochs_max": "1000"});
    let request = json!({"mode": "fgo", "overrides": overrides, "epochs": epochs(1)});
    let (_, refusal) = doors.post("/v1/solve", request).await;
    let at_fault = (code(&refusal), refusal["field"].as_str());
    assert_eq!(at_fault, ("TOO_COSTLY", Some("overrides.window_epochs_max")), "{refusal}");
}

/// Answers are packed from a kilobyte on; packing shorter ones saves nothing.
#[tokio::test]
async fn short_answers_are_not_packed() {
    let doors = Doors::open().await;
    let flag = async |path: &str, message: Vec<u8>| {
        let content = [&[0][..], &(message.len() as u32).to_be_bytes(), &message].concat();
        let request = Request::post(path)
            .header("content-type", "application/grpc")
            .header("grpc-accept-encoding", "gzip");
        let request = request.body(Body::from(content)).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        let body = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        (body[0], body.len())
    };
    assert_eq!(flag("/graphfix.v1.Navigation/Status", Vec::new()).await.0, 0);
    // The answer has the whole configuration of the session, so it is long.
    assert_eq!(flag("/graphfix.v1.Sessions/Create", Vec::new()).await.0, 1);
}
