//! A session's raw bytes: chunks of its receiver's stream become numbered epochs.
//!
//! A chunk's offset counts from the first byte that the device ever sent to the session. The bytes
//! of a chunk are stored in the same transaction as the epochs that they complete. So the
//! acknowledged bytes are durable, and the device continues after the last of them, also after a
//! crash of the service. Repeated bytes are recognised by their offsets. The last chunk, if
//! repeated, is answered again from the store; earlier chunks are acknowledged without their
//! epochs.

use bytes::Bytes;

use crate::clock::gps_time;
use crate::config::OutputOptions;
use crate::gnss::{GpsTime, Navigation};
use crate::reception::{Needed, Received, ReceptionError, Stream};
use crate::store::{RawChunkSpan, RawPosition};

use super::EpochOutcome;

/// After a silence of this long, a live stream takes its date from the clock again (ms).
const SILENCE_MS: i64 = 3_600_000;
/// A stream is live if its epochs are within this time of the clock (s).
const LIVE_S: f64 = 43_200.0;

/// In unit tests decoders panic on chunks that end with these bytes.
#[cfg(test)]
pub(super) const PANICS_AFTER: &[u8] = b"a decoder panics here";

/// A chunk of a receiver's stream.
#[derive(Clone, Debug)]
pub struct RawChunk {
    /// Number of bytes that the device sent to the session before this chunk.
    pub offset: u64,
    /// The bytes of the chunk.
    pub content: Bytes,
    /// Whether the stream ends with this chunk. Incomplete data at its end is decoded as it is, and
    /// the next chunk begins another stream, perhaps of another format.
    pub is_end: bool,
    /// A time within half a day of the stream's first message, for messages without a week number;
    /// the clock's time if absent. Only the first chunk of a stream uses it.
    pub near: Option<GpsTime>,
}

/// The answer to a chunk.
#[derive(Clone, Debug, PartialEq)]
pub struct RawReceived {
    /// The epochs that the chunk completed, in their order. For a repeated chunk: the stored
    /// answers.
    pub outcomes: Vec<EpochOutcome>,
    /// Number of the session's last committed epoch.
    pub durable_through: Option<u64>,
    /// Number of stored bytes: the offset at which the device continues.
    pub raw_through: u64,
    /// The decoded content of the new bytes. Its epochs are in `outcomes`.
    pub received: Received,
    /// All bytes of the chunk were stored already.
    pub resent: bool,
    /// Frame and heights in which the session's solutions are reported.
    pub output: OutputOptions,
}

/// The stream's decoder and its position.
pub(super) struct Reception {
    pub(super) stream: Stream,
    pub(super) position: RawPosition,
}

/// How a chunk relates to the stored bytes.
pub(super) enum Order {
    /// The chunk has new bytes; this many at its beginning are known.
    New(usize),
    Resent,
    Gap,
}

impl Reception {
    pub(super) fn fresh(now_unix_ms: i64) -> Self {
        let time = gps_time(now_unix_ms);
        let last_chunk = RawChunkSpan { start: 0, is_end: false, first_seq: 1, last_seq: 0 };
        let position = RawPosition {
            stream: 0,
            header_end: 0,
            tail: 0,
            through: 0,
            time,
            received_unix_ms: now_unix_ms,
            last_chunk,
        };
        Self { stream: Stream::new(0, time), position }
    }

    pub(super) fn order(&self, chunk: &RawChunk) -> Order {
        let through = self.position.through;
        let end = chunk.offset + chunk.content.len() as u64;
        let last = self.position.last_chunk;
        let is_last =
            chunk.offset == last.start && end == through && chunk.is_end == last.is_end && 0 < end;
        if through < chunk.offset {
            Order::Gap
        } else if is_last || end < through || (end == through && !chunk.is_end) {
            Order::Resent
        } else {
            Order::New((through - chunk.offset) as usize)
        }
    }

    /// Sets the date of a stream before one of its chunks.
    pub(super) fn date(&mut self, chunk: &RawChunk, now_unix_ms: i64) {
        let Self { stream, position } = self;
        let is_first = stream.through() == stream.start();
        let was_live = (position.time - gps_time(position.received_unix_ms)).abs() < LIVE_S;
        let was_silent = SILENCE_MS < now_unix_ms - position.received_unix_ms;
        match chunk.near {
            Some(near) if is_first => stream.date(near),
            None if is_first || (was_live && was_silent) => stream.date(gps_time(now_unix_ms)),
            _ => {}
        }
    }

    /// Decodes the new bytes of a chunk. After a panic another stream must
    /// [begin after it](Self::begin_after).
    pub(super) fn take(
        &mut self,
        chunk: &RawChunk,
        known: usize,
        navigation: &Navigation,
    ) -> Result<Received, ReceptionError> {
        #[cfg(test)]
        assert!(!chunk.content.ends_with(PANICS_AFTER), "on purpose");
        let mut received = Received::default();
        self.stream.push(&chunk.content[known..], navigation, &mut received)?;
        if chunk.is_end {
            self.stream.finish(&mut received);
        }
        Ok(received)
    }

    /// Begins another stream after a chunk.
    pub(super) fn begin_after(&mut self, chunk: &RawChunk) {
        let through = chunk.offset + chunk.content.len() as u64;
        self.stream = Stream::new(through, self.position.time);
    }

    /// Updates the position after a chunk that completed `epochs` epochs, numbered from
    /// `first_seq`.
    pub(super) fn advance(
        &mut self,
        chunk: &RawChunk,
        first_seq: u64,
        epochs: usize,
        now_unix_ms: i64,
    ) {
        let (time, through) = (self.stream.time(), self.stream.through());
        if chunk.is_end {
            self.stream = Stream::new(through, time);
        }
        let Needed { header, tail } = self.stream.needed();
        let last_seq = first_seq + epochs as u64 - 1;
        self.position = RawPosition {
            stream: header.start,
            header_end: header.end,
            tail: tail.start,
            through,
            time,
            received_unix_ms: now_unix_ms,
            last_chunk: RawChunkSpan {
                start: chunk.offset,
                is_end: chunk.is_end,
                first_seq,
                last_seq,
            },
        };
    }
}
