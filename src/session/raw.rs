//! A session's raw bytes: pieces of its receiver's stream become numbered epochs.
//!
//! Offsets count from the first byte that the device ever sent to the session; a piece says where
//! it begins. All bytes of a piece are stored in the transaction of the epochs that they complete,
//! so what is acknowledged is durable to the byte: a device goes on after the last byte
//! acknowledged, whatever has become of the service. Bytes sent again are known by their offsets;
//! the last piece is answered again from the store, of earlier ones nothing is said twice.

use bytes::Bytes;

use crate::clock::gps_time;
use crate::gnss::{GpsTime, Navigation};
use crate::reception::{Needed, Received, ReceptionError, Stream};
use crate::store::{RawPiecePlace, RawPosition};

use super::EpochOutcome;

/// A stream that is silent so long is dated anew (ms), if it came as it was observed.
const SILENCE_MS: i64 = 3_600_000;
/// A stream came as it was observed if its times were so near to the clock's (s).
const LIVE_S: f64 = 43_200.0;
/// A piece of a receiver's stream.
#[derive(Clone, Debug)]
pub struct RawPiece {
    /// Bytes that the device sent to the session before it.
    pub offset: u64,
    /// The bytes.
    pub content: Bytes,
    /// Whether the stream ends with it: what is incomplete is taken as it is, and what follows
    /// begins another stream, perhaps of another format.
    pub is_end: bool,
    /// Within half a day of the stream's first message, for those that tell no week; the clock's
    /// time if not given. Of the first piece of a stream.
    pub near: Option<GpsTime>,
}

/// The answer to a piece.
#[derive(Clone, Debug, PartialEq)]
pub struct RawReceived {
    /// The epochs that it completed, in their order. For a piece sent again: those that are stored.
    pub outcomes: Vec<EpochOutcome>,
    /// The session's last committed epoch.
    pub durable_through: Option<u64>,
    /// All bytes before this offset are stored: there the device goes on.
    pub raw_through: u64,
    /// What the new bytes held; its epochs are those of `outcomes`.
    pub received: Received,
    /// All bytes had come before.
    pub resent: bool,
}

/// The stream in memory.
pub(super) struct Reception {
    pub(super) stream: Stream,
    pub(super) position: RawPosition,
}

/// Where a piece stands to what is stored.
pub(super) enum Order {
    /// So many of its bytes are known.
    New(usize),
    Resent,
    Gap,
}

impl Reception {
    pub(super) fn fresh(now_unix_ms: i64) -> Self {
        let time = gps_time(now_unix_ms);
        let piece = RawPiecePlace { start: 0, is_end: false, first_seq: 1, last_seq: 0 };
        let position = RawPosition {
            stream: 0,
            header_end: 0,
            tail: 0,
            through: 0,
            time,
            received_unix_ms: now_unix_ms,
            piece,
        };
        Self { stream: Stream::new(0, time), position }
    }

    pub(super) fn order(&self, piece: &RawPiece) -> Order {
        let through = self.position.through;
        let end = piece.offset + piece.content.len() as u64;
        let last = self.position.piece;
        let is_last =
            piece.offset == last.start && end == through && piece.is_end == last.is_end && 0 < end;
        if through < piece.offset {
            Order::Gap
        } else if is_last || end < through || (end == through && !piece.is_end) {
            Order::Resent
        } else {
            Order::New((through - piece.offset) as usize)
        }
    }

    /// Dates a stream before a piece of it.
    pub(super) fn date(&mut self, piece: &RawPiece, now_unix_ms: i64) {
        let Self { stream, position } = self;
        let is_first = stream.through() == stream.start();
        let was_live = (position.time - gps_time(position.received_unix_ms)).abs() < LIVE_S;
        let was_silent = SILENCE_MS < now_unix_ms - position.received_unix_ms;
        match piece.near {
            Some(near) if is_first => stream.date(near),
            None if is_first || (was_live && was_silent) => stream.date(gps_time(now_unix_ms)),
            _ => {}
        }
    }

    /// Decodes the bytes of a piece that are new.
    pub(super) fn take(
        &mut self,
        piece: &RawPiece,
        known: usize,
        navigation: &Navigation,
    ) -> Result<Received, ReceptionError> {
        let mut received = Received::default();
        self.stream.push(&piece.content[known..], navigation, &mut received)?;
        if piece.is_end {
            self.stream.finish(&mut received);
        }
        Ok(received)
    }

    /// The place after a piece that completed `epochs` epochs, numbered from `first_seq`.
    pub(super) fn advance(
        &mut self,
        piece: &RawPiece,
        first_seq: u64,
        epochs: usize,
        now_unix_ms: i64,
    ) {
        let (time, through) = (self.stream.time(), self.stream.through());
        if piece.is_end {
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
            piece: RawPiecePlace { start: piece.offset, is_end: piece.is_end, first_seq, last_seq },
        };
    }
}
