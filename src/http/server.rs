//! The listening port: accepts connections, serves both doors, and drains when the service stops.

use std::any::Any;
use std::convert::Infallible;
use std::future::Future;
use std::io::Write;
use std::time::Duration;

use axum::Router;
use axum::response::{IntoResponse, Response};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::contract::{Refusal, Service};
use crate::panics::words;
use crate::refusal::Code;
use crate::tls::ServerTls;

use super::connection::{ConnectionPatience, Peer, serve_connection};
use super::connection_slots::ConnectionSlots;
use super::handshake;
use super::problem::{Problem, Refused};
use super::router;

/// The delay after a connection that could not be accepted.
const ACCEPT_DELAY: Duration = Duration::from_millis(100);

/// Serves HTTP/1.1, HTTP/2 and gRPC on `listener` until `stop` is ready, then drains, and waits for
/// `closed`.
///
/// While draining, `/readyz` and the gRPC health service report not ready. After
/// `limits.drain_notice_s` the connections take no more requests, and running requests have
/// `limits.drain_s` to finish. `closed` begins after them. A client that connects before `closed`
/// is ready gets answers about the health of the service; all other calls are refused. If a
/// connection cannot be accepted, for instance because no file descriptor is free, the listener
/// tries again after a delay.
pub async fn serve(
    listener: TcpListener,
    service: &Service,
    stop: impl Future<Output = ()> + Send + 'static,
    closed: impl Future<Output = ()>,
) {
    let limits = service.limits();
    let notice = Duration::from_secs(limits.drain_notice_s);
    let patience = Duration::from_secs(limits.drain_s);
    let (stopping, is_stopping) = watch::channel(false);
    let announced = {
        let service = service.clone();
        async move {
            stop.await;
            service.drain();
            tokio::time::sleep(notice).await;
        }
    };
    let renewed = async {
        match service.tls() {
            Some(tls) => tls.follow_files().await,
            None => std::future::pending::<Infallible>().await,
        }
    };
    let port = Port::new(listener, service);
    let (mut connections, mut late) = (JoinSet::new(), JoinSet::new());
    tokio::select! {
        never = port.accept(&mut connections, &is_stopping, false) => match never {},
        () = announced => {}
        never = renewed => match never {},
    }
    stopping.send_replace(true);
    let ended = async {
        let ended = async { while connections.join_next().await.is_some() {} };
        if tokio::time::timeout(patience, ended).await.is_err() {
            tracing::warn!(seconds = limits.drain_s, "requests were still running; cut off");
        }
        connections.abort_all();
        closed.await;
    };
    // Late connections are not waited for: they end with the others.
    let (_open, is_never) = watch::channel(false);
    tokio::select! {
        never = port.accept(&mut late, &is_never, true) => match never {},
        () = ended => {}
    }
}

/// The listening port with everything that it needs to serve a connection.
struct Port<'a> {
    listener: TcpListener,
    service: &'a Service,
    router: Router,
    slots: ConnectionSlots,
    patience: ConnectionPatience,
}

impl<'a> Port<'a> {
    fn new(listener: TcpListener, service: &'a Service) -> Self {
        let limits = service.limits();
        let patience = ConnectionPatience {
            head: Duration::from_secs(limits.head_s),
            idle: Duration::from_secs(limits.idle_s),
            silence: Duration::from_secs(limits.body_silence_s),
        };
        let slots = ConnectionSlots::new(
            limits.connections,
            limits.connections_per_address,
            service.meters().connections.clone(),
        );
        Self { listener, service, router: router(service), slots, patience }
    }

    /// Accepts connections and serves each in its own task.
    async fn accept(
        &self,
        connections: &mut JoinSet<()>,
        is_stopping: &watch::Receiver<bool>,
        is_late: bool,
    ) -> Infallible {
        loop {
            let (stream, peer) = match self.listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    // The peer has ended the connection, or no file descriptor is free.
                    tracing::debug!(%error, "a connection was not accepted");
                    tokio::time::sleep(ACCEPT_DELAY).await;
                    continue;
                }
            };
            while connections.try_join_next().is_some() {} // Forgets those that have ended.
            let tls = self.service.tls().cloned();
            match self.slots.take(peer.ip()) {
                Ok(slot) => {
                    // Err: the connection is already lost.
                    stream.set_nodelay(true).ok();
                    let peer = Peer { address: peer.ip(), is_encrypted: tls.is_some(), is_late };
                    let router = self.router.clone();
                    let is_stopping = is_stopping.clone();
                    let served =
                        serve_stream((stream, peer), tls, router, self.patience, is_stopping);
                    connections.spawn(async move {
                        let _slot = slot;
                        served.await;
                    });
                }
                // A peer with TLS reads nothing before its handshake.
                Err(_) if tls.is_some() => drop(stream),
                Err(refusal) => refuse(stream, &refusal),
            }
        }
    }
}

/// Serves an accepted connection, after its handshake if the port has TLS.
async fn serve_stream(
    (stream, peer): (TcpStream, Peer),
    tls: Option<ServerTls>,
    router: Router,
    patience: ConnectionPatience,
    mut is_stopping: watch::Receiver<bool>,
) {
    let Some(tls) = tls else {
        return serve_connection((stream, peer), router, patience, is_stopping).await;
    };
    let agreed = tokio::select! {
        agreed = handshake::agree(stream, &tls, patience.head) => agreed,
        // Err: the server has ended, too.
        _ = is_stopping.wait_for(|stopping| *stopping) => None,
    };
    if let Some(stream) = agreed {
        serve_connection((stream, peer), router, patience, is_stopping).await;
    }
}

/// Answers a refused connection without waiting. Bytes that do not fit into the socket's buffer are
/// lost.
fn refuse(stream: TcpStream, refusal: &Refusal) {
    let answer = Problem::closing_answer(refusal);
    // Err: the peer has ended the connection. A peer with HTTP/2 sees only that it ends.
    stream.into_std().and_then(|mut stream| stream.write(answer.as_bytes())).ok();
}

/// The answer of the REST door to a panic.
pub(super) fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response {
    tracing::error!(panic = words(&*panic), "a request panicked");
    Refused(Refusal::new(Code::Internal, "the request failed inside the service")).into_response()
}

#[cfg(test)]
mod tests {
    use axum::body::Body;
    use axum::http::{Request, StatusCode};
    use axum::routing::get;
    use tower::ServiceExt;
    use tower_http::catch_panic::CatchPanicLayer;

    use super::*;
    use crate::http::Problem;

    #[tokio::test]
    async fn a_panic_is_answered_as_internal() {
        let panics = Router::new()
            .route("/", get(|| async { panic!("on purpose") as &'static str }))
            .layer(CatchPanicLayer::custom(panicked));
        let answer = panics.oneshot(Request::new(Body::empty())).await.unwrap();
        assert_eq!(answer.status(), StatusCode::INTERNAL_SERVER_ERROR);
        let body = axum::body::to_bytes(answer.into_body(), usize::MAX).await.unwrap();
        let problem: Problem = serde_json::from_slice(&body).unwrap();
        assert_eq!(problem.code, Code::Internal.name());
    }
}
