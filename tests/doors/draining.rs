//! A service that is stopping reports this on every new connection, until it has stopped.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use graphfix::config::Limits;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tonic::transport::Endpoint;

use crate::support::doors::{Doors, code};
use crate::support::server::{ask, status_of};
use crate::support::wait::until;

/// New connections are accepted while running requests finish and the desks close. These
/// connections do not delay the end of the service.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_connects_while_a_service_stops_is_told_so() {
    let doors = Doors::with(Limits { drain_s: 600, ..Limits::standard() }).await;
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    let (stop, stopped) = oneshot::channel::<()>();
    let (close, closed) = oneshot::channel::<()>();
    let service = doors.service.clone();
    let serving = tokio::spawn(async move {
        let (stop, closed) = (async { drop(stopped.await) }, async { drop(closed.await) });
        graphfix::http::serve(listener, &service, stop, closed).await;
    });
    let get = async |path: &str| ask(port, ("GET", path), &[], "").unwrap();
    assert_eq!(get("/readyz").await.status, 200);
    // This request runs until its client has sent the rest of it.
    let mut running = TcpStream::connect(("127.0.0.1", port)).unwrap();
    let head = "POST /v1/sessions HTTP/1.1\r\nhost: localhost\r\n\
                content-type: application/json\r\ncontent-length: 2\r\n\r\n{";
    running.write_all(head.as_bytes()).unwrap();
    until("running", async || doors.service.budget().used(), |used| 0 < *used).await;
    stop.send(()).unwrap();

    // A connection that is accepted just before may be closed before its request is read.
    let told = async || ask(port, ("GET", "/readyz"), &[], "").ok().filter(|a| a.status != 200);
    let told = until("told", told, Option::is_some).await.unwrap();
    assert_eq!((told.status, told.header("retry-after")), (503, "1"), "{told:?}");
    assert_eq!(told.json()["draining"], true);
    let post = ("POST", "/v1/sessions");
    let refused = async || ask(port, post, &[], "{}").ok().filter(|a| a.status != 201);
    let refused = until("refused", refused, Option::is_some).await.unwrap();
    assert_eq!((refused.status, code(&refused.json())), (503, "DRAINING"), "{refused:?}");
    assert_eq!(refused.header("retry-after"), "1");
    assert!(
        get("/metrics")
            .await
            .body
            .lines()
            .any(|line| { line.starts_with("graphfix_draining{") && line.ends_with("} 1.0") })
    );
    assert_eq!(get("/healthz").await.status, 200);
    let channel = Endpoint::from_shared(format!("http://127.0.0.1:{port}")).unwrap();
    let mut client = SessionsClient::new(channel.connect_lazy());
    let status = client.create(graphfix::contract::v1::CreateSessionRequest::default()).await;
    assert_eq!(code_of(&status.unwrap_err()).as_deref(), Some("DRAINING"));

    running.write_all(b"}").unwrap();
    let mut answer = String::new();
    running.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 201"), "{answer}");
    assert_eq!(status_of(port, "/readyz"), 503, "the desks close");
    let mut idle = TcpStream::connect(("127.0.0.1", port)).unwrap();
    idle.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    idle.read_exact(&mut [0; 12]).unwrap();
    close.send(()).unwrap();
    tokio::time::timeout(Duration::from_secs(60), serving).await.unwrap().unwrap();
    assert!(TcpStream::connect(("127.0.0.1", port)).is_err());
}
