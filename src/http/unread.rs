//! Bodies that a call has not read to their end when it is answered.
//!
//! If a connection of HTTP/1 is closed while its peer still sends, the peer's system discards what
//! it has received: an early refusal would be lost. So what is left of a body is read and discarded
//! while the answer is sent (RFC 9112, section 9.6), within limits. HTTP/2 needs none of this: its
//! streams end without their connection.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use http_body_util::BodyExt;
use hyper::Version;
use hyper::body::{Frame, Incoming, SizeHint};
use hyper::header::EXPECT;
use tokio::runtime::Handle;
use tokio::time::timeout;

/// Most bytes that are discarded.
const BYTES_MAX: usize = 64 << 20;
/// Longest time without a byte, after which the rest is given up.
const SILENCE: Duration = Duration::from_secs(2);
/// Longest time in all.
const TIME_MAX: Duration = Duration::from_secs(10);

/// The body of a request, of which the rest is discarded when it is dropped.
struct Unread {
    /// `None` once it has been read to its end or has failed.
    body: Option<Incoming>,
}

/// The body of a request as calls read it.
pub(super) fn body(request: hyper::Request<Incoming>) -> hyper::Request<Body> {
    // A peer that waits for leave has sent nothing.
    let is_sent = request.version() < Version::HTTP_2 && !request.headers().contains_key(EXPECT);
    request.map(|body| match is_sent && !body.is_end_stream() {
        true => Body::new(Unread { body: Some(body) }),
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
            runtime.spawn(async move {
                // Err: it takes too long.
                timeout(TIME_MAX, discard(body)).await.ok();
            });
        }
    }
}

/// Reads a body until it ends, its peer is silent, or there is too much of it.
async fn discard(mut body: Incoming) {
    let mut left = BYTES_MAX;
    while let Ok(Some(Ok(frame))) = timeout(SILENCE, body.frame()).await {
        let bytes = frame.data_ref().map_or(0, Bytes::len);
        let Some(rest) = left.checked_sub(bytes) else { return };
        left = rest;
    }
}
