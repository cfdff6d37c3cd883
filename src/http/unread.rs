//! Bodies that a call has not read to their end when it is answered.
//!
//! If a connection of HTTP/1 is closed while its peer still sends, the peer's system discards what
//! it has received: an early refusal would be lost. So the rest of a body is read and discarded
//! while the answer is sent (RFC 9112, section 9.6). The limit is a time, as in other servers
//! (nginx's `lingering_time` and `lingering_timeout`), because a fast client sends any number of
//! bytes before it reads, and discarded bytes cost no memory. HTTP/2 does not need this: its
//! streams end without their connection.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use http_body_util::BodyExt;
use hyper::Version;
use hyper::body::{Frame, Incoming, SizeHint};
use hyper::header::EXPECT;
use tokio::runtime::Handle;
use tokio::time::timeout;

/// Longest time without a byte. After it the rest is no longer read.
const SILENCE: Duration = Duration::from_secs(2);
/// Longest time to discard a body: 375 MB at 100 Mbit/s.
const TIME_MAX: Duration = Duration::from_secs(30);

/// The body of a request. When it is dropped, its rest is read and discarded.
struct Unread {
    /// The body; `None` once it has been read to its end or has failed.
    body: Option<Incoming>,
    discards: Discards,
}

/// Number of bodies of a connection whose rest is being discarded.
#[derive(Clone, Debug, Default)]
pub(super) struct Discards(Arc<AtomicUsize>);

impl Discards {
    /// Whether there is one. Bytes that arrive meanwhile are not the head of another request.
    pub(super) fn is_any(&self) -> bool {
        0 < self.0.load(Ordering::Acquire)
    }

    /// Counts one more, until the guard is dropped.
    fn begin(&self) -> Discard {
        self.0.fetch_add(1, Ordering::AcqRel);
        Discard(self.clone())
    }
}

/// A body whose rest is discarded.
struct Discard(Discards);

impl Drop for Discard {
    fn drop(&mut self) {
        self.0.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// The body of a request for the calls. `discards` belongs to its connection.
pub(super) fn body(request: hyper::Request<Incoming>, discards: &Discards) -> hyper::Request<Body> {
    // A peer that waits for `100 Continue` has sent nothing.
    let is_sent = request.version() < Version::HTTP_2 && !request.headers().contains_key(EXPECT);
    request.map(|body| match is_sent && !body.is_end_stream() {
        true => Body::new(Unread { body: Some(body), discards: discards.clone() }),
        false => Body::new(body),
    })
}

impl HttpBody for Unread {
    type Data = Bytes;
    type Error = hyper::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, hyper::Error>>> {
        let Some(body) = &mut self.body else { return Poll::Ready(None) };
        let polled = Pin::new(body).poll_frame(context);
        if matches!(polled, Poll::Ready(None | Some(Err(_)))) {
            self.body = None;
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.as_ref().is_none_or(HttpBody::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        self.body.as_ref().map_or(SizeHint::with_exact(0), HttpBody::size_hint)
    }
}

impl Drop for Unread {
    fn drop(&mut self) {
        let Some(body) = self.body.take().filter(|body| !body.is_end_stream()) else { return };
        // Err: the runtime has ended, and with it the connection.
        if let Ok(runtime) = Handle::try_current() {
            let discard = self.discards.begin();
            runtime.spawn(async move {
                // Err: it takes too long.
                timeout(TIME_MAX, read_to_end(body)).await.ok();
                drop(discard);
            });
        }
    }
}

/// Reads a body until it ends or its peer is silent.
async fn read_to_end(mut body: Incoming) {
    while let Ok(Some(Ok(_))) = timeout(SILENCE, body.frame()).await {}
}
