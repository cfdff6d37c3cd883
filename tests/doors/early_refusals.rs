//! Refusals that are sent while the body of their request still arrives.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use graphfix::config::Limits;

use crate::support::doors::Doors;
use crate::support::jobs::BOUNDARY;

/// Far more than the buffers of a connection take.
const BYTES: usize = 20_000_000;

/// A service that listens, and its port.
async fn listening() -> (Doors, u16) {
    Doors::listening(Limits { head_s: 60, ..Limits::standard() }).await
}

/// The head of a request that announces a body of this many bytes.
fn head(path: &str, kind: &str, bytes: usize) -> String {
    format!(
        "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {kind}\r\n\
         content-length: {bytes}\r\n\r\n"
    )
}

/// Reads answers until they contain this text. Returns everything that has been read.
fn answered(stream: &mut TcpStream, text: &str) -> String {
    let (mut answer, mut some) = (String::new(), [0; 4096]);
    while !answer.contains(text) {
        let bytes = stream.read(&mut some).unwrap();
        assert!(0 < bytes, "closed after {answer:?}");
        answer.push_str(&String::from_utf8_lossy(&some[..bytes]));
    }
    answer
}

/// A client that sends the whole body before it reads gets the refusal, and can use its connection
/// again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_refusal_arrives_although_the_body_is_still_sent() {
    let (_doors, port) = listening().await;
    let part = format!(
        "--{BOUNDARY}\r\nContent-Disposition: form-data; name=\"sky\"; filename=\"a\"\r\n\r\n"
    );
    let form = format!("multipart/form-data; boundary={BOUNDARY}");
    for (path, kind, code) in [
        ("/v1/jobs", &*form, "UNKNOWN_FIELD"),
        ("/v1/nothing", "text/plain", "ROUTE_NOT_FOUND"),
        ("/v1/navigation", "application/octet-stream", "BODY_TOO_LARGE"),
    ] {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let mut body = part.clone().into_bytes();
        body.resize(BYTES, b'x');
        stream.write_all(head(path, kind, BYTES).as_bytes()).unwrap();
        stream.write_all(&body).unwrap();
        answered(&mut stream, code);
        stream.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
        answered(&mut stream, "ok\n");
    }
}

/// The refusal also arrives for a large body: 400 MB, as a recording of a day can have.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_refusal_of_a_large_body_arrives() {
    let (doors, port) = listening().await;
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let chunk = vec![b'x'; 1_000_000];
    let request = head("/v1/nothing", "text/plain", 400 * chunk.len());
    stream.write_all(request.as_bytes()).unwrap();
    (0..400).for_each(|_| stream.write_all(&chunk).unwrap());
    answered(&mut stream, "ROUTE_NOT_FOUND");
    stream.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    answered(&mut stream, "ok\n");
    assert_eq!(doors.service.budget().used(), 0);
}

/// The rest of a slow body may take longer than the limit for the head of a request.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_refusal_of_a_slow_body_arrives() {
    let (_doors, port) = Doors::listening(Limits { head_s: 1, ..Limits::standard() }).await;
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let (chunk, chunks) = (vec![b'x'; 10_000], 30);
    let request = head("/v1/nothing", "text/plain", chunks * chunk.len());
    stream.write_all(request.as_bytes()).unwrap();
    for _ in 0..chunks {
        std::thread::sleep(Duration::from_millis(100)); // A slow network.
        stream.write_all(&chunk).unwrap();
    }
    answered(&mut stream, "ROUTE_NOT_FOUND");
    stream.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    answered(&mut stream, "ok\n");
}

/// If a client sends no more after a refusal, its connection is closed within seconds.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_body_that_never_comes_ends_with_its_refusal() {
    let (doors, port) = listening().await;
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.write_all(head("/v1/nothing", "text/plain", BYTES).as_bytes()).unwrap();
    let (begun, mut answer) = (Instant::now(), String::new());
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.contains("ROUTE_NOT_FOUND"), "{answer}");
    assert!(begun.elapsed() < Duration::from_secs(30), "{:?}", begun.elapsed());
    assert_eq!(doors.service.budget().used(), 0);
}
