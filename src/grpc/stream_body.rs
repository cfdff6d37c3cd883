//! Bodies of streams, checked while they are read: the memory of the bytes that have arrived, the
//! length of each message, and that no message is packed.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::BoxError;
use axum::body::{Body, Bytes, HttpBody};
use hyper::body::Frame;

use crate::contract::{Lease, Refusal};
use crate::refusal::Code;

use super::status::to_status;

/// Length of the flag and the message length before each message (gRPC over HTTP/2).
pub(crate) const PREFIX_BYTES: usize = 5;

/// The refusal of a message that is too long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TooLong {
    /// It exceeds the largest possible credit of a device's stream.
    Credit,
    /// It exceeds the limit for a chunk of a file. Its call has no credit.
    Chunk,
}

/// The body of a stream.
pub(super) struct StreamBody {
    body: Body,
    lease: Option<Lease>,
    prefixes: Prefixes,
    /// The refusal with which the stream ends, once the earlier messages are read.
    fault: Option<Refusal>,
}

/// Finds the messages in the bytes of a stream.
struct Prefixes {
    /// Longest message (bytes).
    limit: usize,
    /// Code and field for the refusal of a longer message.
    too_long: TooLong,
    prefix: [u8; PREFIX_BYTES],
    /// Bytes of the next prefix that have arrived.
    begun: usize,
    /// Bytes of the present message that have not arrived.
    rest: usize,
}

impl StreamBody {
    /// The body of a stream with messages of at most `limit` bytes.
    pub(super) fn new(body: Body, limit: usize, too_long: TooLong) -> Self {
        let prefixes = Prefixes { limit, too_long, prefix: [0; PREFIX_BYTES], begun: 0, rest: 0 };
        Self { body, lease: Lease::current(), prefixes, fault: None }
    }

    /// The bytes before the first message that is refused.
    fn take(&mut self, mut bytes: Bytes) -> Result<Bytes, Refusal> {
        if let Some(lease) = &self.lease {
            lease.arrive_undecoded(bytes.len())?;
        }
        let (good, refused) = self.prefixes.take(&bytes);
        self.fault = refused.err();
        bytes.truncate(good);
        Ok(bytes)
    }
}

impl Prefixes {
    /// Reads the prefixes in `bytes`. If a prefix is refused, returns the number of bytes before
    /// it.
    fn take(&mut self, all: &[u8]) -> (usize, Result<(), Refusal>) {
        let mut bytes = all;
        while !bytes.is_empty() {
            let of_message = self.rest.min(bytes.len());
            self.rest -= of_message;
            bytes = &bytes[of_message..];
            if self.rest != 0 {
                continue;
            }
            let good = all.len() - bytes.len();
            let of_prefix = (PREFIX_BYTES - self.begun).min(bytes.len());
            self.prefix[self.begun..self.begun + of_prefix].copy_from_slice(&bytes[..of_prefix]);
            self.begun += of_prefix;
            bytes = &bytes[of_prefix..];
            if self.begun == PREFIX_BYTES
                && let Err(refusal) = self.begin()
            {
                return (good, Err(refusal));
            }
        }
        (all.len(), Ok(()))
    }

    /// Begins a message whose prefix is complete.
    fn begin(&mut self) -> Result<(), Refusal> {
        let [packed, length @ ..] = self.prefix;
        let length = u32::from_be_bytes(length) as usize;
        if packed != 0 {
            let message = "the messages of a stream are not packed";
            return Err(Refusal::new(Code::UnsupportedMediaType, message));
        }
        if self.limit < length {
            let limit = self.limit;
            let message = format!("a message of {length} bytes, at most {limit} are taken");
            let (code, field) = match self.too_long {
                TooLong::Credit => (Code::CreditExceeded, "credit.bytes"),
                TooLong::Chunk => (Code::PieceTooLarge, "chunk"),
            };
            return Err(Refusal::new(code, message).at(field));
        }
        (self.begun, self.rest) = (0, length);
        Ok(())
    }
}

impl HttpBody for StreamBody {
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let this = &mut *self;
        if let Some(refusal) = this.fault.take() {
            return Poll::Ready(Some(Err(to_status(&refusal).into())));
        }
        let polled = Pin::new(&mut this.body).poll_frame(context);
        polled.map(|frame| match frame? {
            Ok(frame) => match frame.into_data() {
                Ok(bytes) => {
                    let taken = this.take(bytes).map(Frame::data);
                    Some(taken.map_err(|refusal| to_status(&refusal).into()))
                }
                Err(other) => Some(Ok(other)),
            },
            Err(error) => {
                let refusal = Refusal::new(Code::MalformedBody, error.to_string());
                Some(Err(to_status(&refusal).into()))
            }
        })
    }

    fn is_end_stream(&self) -> bool {
        self.fault.is_none() && self.body.is_end_stream()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(packed: u8, length: u32) -> Vec<u8> {
        let content = vec![7; length as usize];
        [&[packed][..], &length.to_be_bytes(), &content].concat()
    }

    fn taken(bytes: &[u8], chunk: usize) -> Result<(), Code> {
        taken_by(TooLong::Credit, bytes, chunk)
    }

    fn taken_by(too_long: TooLong, bytes: &[u8], chunk: usize) -> Result<(), Code> {
        let prefix = [0; PREFIX_BYTES];
        let mut prefixes = Prefixes { limit: 50, too_long, prefix, begun: 0, rest: 0 };
        let mut chunks = bytes.chunks(chunk);
        chunks.try_for_each(|chunk| prefixes.take(chunk).1).map_err(|refusal| refusal.code)
    }

    /// The messages are found wherever the bytes are split.
    #[test]
    fn a_message_too_long_or_packed_is_refused_by_its_prefix() {
        let good = [message(0, 50), message(0, 0), message(0, 3)].concat();
        let long = [&good[..], &message(0, 51)].concat();
        let packed = [&good[..], &message(1, 5)].concat();
        for chunk in 1..=good.len() {
            assert_eq!(taken(&good, chunk), Ok(()));
            assert_eq!(taken(&long, chunk), Err(Code::CreditExceeded));
            assert_eq!(taken(&packed, chunk), Err(Code::UnsupportedMediaType));
            assert_eq!(taken_by(TooLong::Chunk, &long, chunk), Err(Code::PieceTooLarge));
        }
    }
}
