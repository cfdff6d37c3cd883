//! The bodies of answers while they are sent to a reader, who may read nothing.
//!
//! A peer of HTTP/1 that reads nothing blocks its connection. A peer of HTTP/2 may read its
//! connection but never open the flow-control window of one answer. That answer then waits, with
//! all memory that it has reserved. So a connection records since when each of its answers has
//! waited for its reader. A body that has nothing to send, such as that of a watch, is not waiting.

use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use tokio::time::Instant;

/// Largest part of a body that is passed on at once (bytes), because then it is no longer counted.
pub(super) const PART_BYTES: usize = 64 << 10;

/// The answers of a connection that wait for their reader: number of the answer, and since when.
/// There are at most as many as there are requests.
#[derive(Debug, Default)]
pub(super) struct WaitingAnswers(Mutex<Vec<(u64, Instant)>>);

impl WaitingAnswers {
    /// The time since which the longest waiting answer has waited.
    pub(super) fn since(&self) -> Option<Instant> {
        self.known().iter().map(|(_, since)| *since).min()
    }

    fn begin(&self, number: u64) {
        let mut known = self.known();
        match known.iter_mut().find(|(answer, _)| *answer == number) {
            Some((_, since)) => *since = Instant::now(),
            None => known.push((number, Instant::now())),
        }
    }

    fn end(&self, number: u64) {
        self.known().retain(|(answer, _)| *answer != number);
    }

    fn known(&self) -> MutexGuard<'_, Vec<(u64, Instant)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The body of an answer, keeping a value alive until it is dropped.
pub(super) struct Answer<K> {
    body: Body,
    /// Data that the body has produced and that are not passed on yet.
    rest: Bytes,
    number: u64,
    waiting: Arc<WaitingAnswers>,
    _kept: K,
}

impl<K: Send + Unpin + 'static> Answer<K> {
    /// The body of the connection's answer with this number. From now on it waits for its reader.
    pub(super) fn body(body: Body, (number, waiting): (u64, Arc<WaitingAnswers>), kept: K) -> Body {
        waiting.begin(number);
        Body::new(Self { body, rest: Bytes::new(), number, waiting, _kept: kept })
    }
}

impl<K: Unpin> HttpBody for Answer<K> {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        if this.rest.is_empty() {
            match Pin::new(&mut this.body).poll_frame(context) {
                Poll::Ready(Some(Ok(frame))) => match frame.into_data() {
                    Ok(data) => this.rest = data,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                none => {
                    this.waiting.end(this.number);
                    return none;
                }
            }
        }
        // It waits until the next part is asked for.
        this.waiting.begin(this.number);
        let part = this.rest.split_to(this.rest.len().min(PART_BYTES));
        Poll::Ready(Some(Ok(Frame::data(part))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (inner, rest) = (self.body.size_hint(), self.rest.len() as u64);
        let mut hint = SizeHint::new();
        hint.set_lower(inner.lower() + rest);
        if let Some(upper) = inner.upper() {
            hint.set_upper(upper + rest);
        }
        hint
    }
}

impl<K> Drop for Answer<K> {
    fn drop(&mut self) {
        self.waiting.end(self.number);
    }
}

#[cfg(test)]
mod tests {
    use http_body_util::BodyExt;

    use super::*;

    #[tokio::test]
    async fn a_large_body_comes_in_parts_and_whole() {
        let content: Vec<u8> = (0..3 * PART_BYTES + 7).map(|index| index as u8).collect();
        let waiting = Arc::new(WaitingAnswers::default());
        let body = Body::from(content.clone());
        let mut body = Answer::body(body, (1, waiting.clone()), ());
        assert_eq!(body.size_hint().exact(), Some(content.len() as u64));
        assert!(waiting.since().is_some(), "nobody has asked for it yet");
        let mut received = Vec::new();
        while let Some(frame) = body.frame().await {
            let data = frame.unwrap().into_data().unwrap();
            assert!(data.len() <= PART_BYTES);
            received.extend_from_slice(&data);
            assert_eq!(body.size_hint().exact(), Some((content.len() - received.len()) as u64));
        }
        assert_eq!(received, content);
        assert_eq!(waiting.since(), None);
    }

    #[test]
    fn a_body_with_nothing_to_send_waits_for_nobody() {
        let waiting = Arc::new(WaitingAnswers::default());
        let silent = futures::stream::pending::<Result<Bytes, std::io::Error>>();
        let body = Body::from_stream(silent);
        let mut body = Answer::body(body, (1, waiting.clone()), ());
        let mut context = Context::from_waker(futures::task::noop_waker_ref());
        assert!(Pin::new(&mut body).poll_frame(&mut context).is_pending());
        assert_eq!(waiting.since(), None);
    }
}
