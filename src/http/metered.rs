//! Bodies of requests, limited while they are read; and bodies of answers that keep a value alive
//! until they are sent.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::BoxError;
use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use tokio::time::{Instant, Sleep, sleep_until};

use crate::contract::{BodyRate, Lease, Refusal};
use crate::refusal::Code;

/// Memory for a body whose length is unknown is reserved in steps of this size (bytes).
const STEP_BYTES: usize = 16 << 10;
/// Memory of a body that is written to the disk as it arrives (bytes): the parser's buffer, and
/// chunks of the network and the disk.
const PASSING_BYTES: usize = 2 << 20;

/// Longest times for a body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patience {
    /// Longest time without a byte.
    pub(super) silence: Duration,
}

/// The body of a request, whose memory is reserved before it is read.
pub(super) struct Metered {
    body: Body,
    lease: Lease,
    reserved: usize,
    /// Whether the request keeps its body in memory.
    is_kept: bool,
    arrived: usize,
    patience: Patience,
    rate: BodyRate,
    /// When the last bytes arrived.
    last: Instant,
    /// Wakes the reader once the peer has been silent for too long. Most bodies arrive at once and
    /// need no timer.
    silence: Option<Pin<Box<Sleep>>>,
    /// Converts a refusal into the error that the door expects from a body.
    fault: fn(Refusal) -> BoxError,
}

impl Metered {
    /// The body of a request that announces `length` bytes.
    ///
    /// # Errors
    /// The budget does not have this much memory.
    pub(super) fn new(
        body: Body,
        length: usize,
        lease: Lease,
        patience: Patience,
        fault: fn(Refusal) -> BoxError,
    ) -> Result<Self, Refusal> {
        lease.reserve(length)?;
        Ok(Self {
            body,
            lease,
            reserved: length,
            is_kept: true,
            arrived: 0,
            patience,
            rate: BodyRate::begin(patience.silence),
            last: Instant::now(),
            silence: None,
            fault,
        })
    }

    /// The body of a request that keeps nothing of it in memory. Memory is reserved once, for the
    /// bytes between the network and the disk.
    ///
    /// # Errors
    /// The budget does not have this much memory.
    pub(super) fn passing(
        body: Body,
        lease: Lease,
        patience: Patience,
        fault: fn(Refusal) -> BoxError,
    ) -> Result<Self, Refusal> {
        let passing = Self::new(body, PASSING_BYTES, lease, patience, fault)?;
        Ok(Self { is_kept: false, ..passing })
    }

    /// Reserves memory for the next bytes.
    fn reserve_next(&mut self) -> Result<(), Refusal> {
        if !self.is_kept || self.body.is_end_stream() || self.arrived < self.reserved {
            return Ok(());
        }
        self.lease.reserve(STEP_BYTES)?;
        self.reserved += STEP_BYTES;
        Ok(())
    }

    fn take(&mut self, frame: &Frame<Bytes>) -> Result<(), Refusal> {
        let bytes = frame.data_ref().map_or(0, Bytes::len);
        self.arrived += bytes;
        self.lease.arrive(bytes);
        if let Some(surplus) = self.arrived.checked_sub(self.reserved).filter(|_| self.is_kept) {
            self.lease.reserve(surplus)?;
            self.reserved = self.arrived;
        }
        self.rate.check(self.arrived)?;
        self.last = Instant::now();
        Ok(())
    }

    /// Ready once the peer has sent nothing for too long.
    fn poll_silence(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let end = self.last + self.patience.silence;
        let silence = self.silence.get_or_insert_with(|| Box::pin(sleep_until(end)));
        if silence.deadline() < end {
            silence.as_mut().reset(end);
        }
        silence.as_mut().poll(context)
    }
}

impl HttpBody for Metered {
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let this = &mut *self;
        if let Err(refusal) = this.reserve_next() {
            return Poll::Ready(Some(Err((this.fault)(refusal))));
        }
        match Pin::new(&mut this.body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                let taken = this.take(&frame).map(|()| frame);
                Poll::Ready(Some(taken.map_err(this.fault)))
            }
            Poll::Ready(Some(Err(error))) => {
                let refusal = Refusal::new(Code::MalformedBody, error.to_string());
                Poll::Ready(Some(Err((this.fault)(refusal))))
            }
            Poll::Ready(None) => Poll::Ready(None),
            Poll::Pending => {
                if this.poll_silence(context).is_pending() {
                    return Poll::Pending;
                }
                let message = format!("no byte of the body for {:?}", this.patience.silence);
                let refusal = Refusal::new(Code::BodyTooSlow, message);
                Poll::Ready(Some(Err((this.fault)(refusal))))
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A body that keeps a value alive until the body is dropped.
pub(super) struct Keeping<K> {
    body: Body,
    _kept: K,
}

impl<K: Send + Unpin + 'static> Keeping<K> {
    /// `body`, keeping `kept` alive.
    pub(super) fn body(body: Body, kept: K) -> Body {
        Body::new(Self { body, _kept: kept })
    }
}

impl<K: Unpin> HttpBody for Keeping<K> {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
