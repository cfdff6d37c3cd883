//! Peers of HTTP/2 that read their connection but never open the flow-control window of an answer.

use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::http::Request;
use graphfix::config::Limits;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;

use crate::support::doors::Doors;
use crate::support::wait::until;

/// Number of requests of the peer. Each reserves memory for its answer.
const REQUESTS: usize = 50;

async fn connected(port: u16, window: u32) -> h2::client::SendRequest<Bytes> {
    let stream = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    let mut builder = h2::client::Builder::new();
    builder.initial_window_size(window);
    let (sender, connection) = builder.handshake(stream).await.unwrap();
    // Err: the service has ended the connection.
    tokio::spawn(async move { connection.await.ok() });
    sender.ready().await.unwrap()
}

fn get(port: u16, path: &str) -> Request<()> {
    Request::get(format!("http://localhost:{port}{path}")).body(()).unwrap()
}

/// The memory of such answers is free again after the time that a reader has. Other clients are
/// served meanwhile, also a watch that has nothing to send.
#[tokio::test]
async fn a_window_that_stays_closed_keeps_no_memory() {
    let doors = Doors::with(Limits { body_silence_s: 1, ..Limits::standard() }).await;
    let session = doors.session().await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let (stop, stopped) = oneshot::channel::<()>();
    let service = doors.service.clone();
    let serving = tokio::spawn(async move {
        let (stop, closed) = (async { drop(stopped.await) }, std::future::ready(()));
        graphfix::http::serve(listener, &service, stop, closed).await;
    });
    let mut reader = connected(port, 1 << 16).await;
    let watch = get(port, &format!("/v1/sessions/{session}/solutions:watch"));
    let (watch, _) = reader.send_request(watch, true).unwrap();
    let watch = watch.await.unwrap();
    assert_eq!(watch.status(), 200);
    let used = doors.service.budget().used();

    let mut closed = connected(port, 0).await;
    let mut answers = Vec::new();
    for _ in 0..REQUESTS {
        let (answer, _) = closed.send_request(get(port, "/v1/sessions"), true).unwrap();
        answers.push(answer.await.unwrap());
        closed = closed.ready().await.unwrap();
    }
    let begun = Instant::now();
    assert!(used + REQUESTS * 1024 < doors.service.budget().used(), "they reserve memory");
    let budget = async || doors.service.budget().used();
    until("the memory is free", budget, |now| *now <= used).await;
    let taken = begun.elapsed();
    assert!(Duration::from_secs(3) < taken && taken < Duration::from_secs(25), "{taken:?}");
    for answer in answers {
        let end = answer.into_body().data().await;
        assert!(end.is_none_or(|data| data.is_err()), "its connection has ended");
    }

    // The watch had nothing to send during the same time, and its connection still works.
    let (listed, _) = reader.send_request(get(port, "/v1/sessions"), true).unwrap();
    assert_eq!(listed.await.unwrap().status(), 200);
    assert!(!watch.body().is_end_stream());
    drop((stop, reader, closed));
    tokio::time::timeout(Duration::from_secs(60), serving).await.unwrap().unwrap();
    doors.close().await;
}
