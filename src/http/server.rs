//! The listening port: binds it, serves both doors, and stops in order.

use std::any::Any;
use std::future::{Future, IntoFuture};
use std::io;
use std::time::Duration;

use axum::response::{IntoResponse, Response};
use tokio::net::TcpListener;

use crate::contract::{Refusal, Service};
use crate::refusal::Code;

use super::problem::Refused;
use super::router;

/// Why serving ended.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The listening socket failed.
    #[error("the listener failed: {0}")]
    Listener(#[from] io::Error),
}

/// Serves HTTP/1.1, HTTP/2 and gRPC on `listener` until `stop` is ready, then drains.
///
/// While draining, `/readyz` and the gRPC health service report not ready. After the notice no
/// connection is accepted, and running requests have `limits.drain_s` to finish.
///
/// # Errors
/// The listening socket fails.
pub async fn serve(
    listener: TcpListener,
    service: &Service,
    stop: impl Future<Output = ()> + Send + 'static,
) -> Result<(), ServerError> {
    let limits = service.limits();
    let notice = Duration::from_secs(limits.drain_notice_s);
    let patience = Duration::from_secs(limits.drain_s);
    let (drained, mut draining) = tokio::sync::oneshot::channel();
    let announce = {
        let service = service.clone();
        async move {
            stop.await;
            service.drain();
            tokio::time::sleep(notice).await;
            // Err: serving has already ended.
            drained.send(()).ok();
        }
    };
    let serving = axum::serve(listener, router(service)).with_graceful_shutdown(announce);
    let mut serving = std::pin::pin!(serving.into_future());
    tokio::select! {
        ended = &mut serving => return Ok(ended?),
        _ = &mut draining => {}
    }
    match tokio::time::timeout(patience, serving).await {
        Ok(ended) => Ok(ended?),
        Err(_) => {
            tracing::warn!(seconds = limits.drain_s, "requests were still running; cut off");
            Ok(())
        }
    }
}

/// The answer of the REST door to a panic.
pub(super) fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response {
    let words = panic.downcast_ref::<String>().map(String::as_str);
    let words = words.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no words");
    tracing::error!(panic = words, "a request panicked");
    Refused(Refusal::new(Code::Internal, "the request failed inside the service")).into_response()
}

#[cfg(test)]
mod tests {
    use axum::Router;
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
