//! Counts of a stream's messages, and of what was left out.

use std::collections::BTreeMap;
use std::fmt;

use crate::formats::binary::Refusal;
use crate::formats::skipped::note_position;

/// Number of types and reasons stored; a damaged stream could produce many.
const KINDS_LIMIT: usize = 512;
const REASONS_LIMIT: usize = 128;

/// Type of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MessageKind {
    /// RTCM 3 message by number.
    Rtcm(u16),
    /// UBX message by class and id.
    Ubx {
        /// Message class.
        class: u8,
        /// Message id within the class.
        id: u8,
    },
    /// Any NMEA sentence.
    Nmea,
}

impl fmt::Display for MessageKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rtcm(number) => write!(f, "RTCM {number}"),
            Self::Ubx { class, id } => write!(f, "UBX {class:02X}-{id:02X}"),
            Self::Nmea => f.write_str("NMEA"),
        }
    }
}

/// Counts of the messages of one type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MessageCount {
    /// Messages decoded, possibly with parts left out.
    pub decoded: u64,
    /// Messages of a type that is not decoded.
    pub passed_over: u64,
    /// Messages refused as a whole.
    pub refused: u64,
}

impl MessageCount {
    /// Number of all messages of the type.
    pub const fn total(&self) -> u64 {
        self.decoded + self.passed_over + self.refused
    }
}

/// One reason for leaving out data of one message type, with count and positions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusalEntry {
    /// The message type; `None` for bytes outside messages.
    pub kind: Option<MessageKind>,
    /// Why the data was left out.
    pub reason: Refusal,
    /// How often this happened.
    pub count: u64,
    /// The frames of the first ones, at most ten, each once: offsets from the stream's start
    /// (bytes).
    pub offsets: Vec<u64>,
    /// Whether there are frames besides those.
    pub has_more: bool,
}

/// Counts of messages by type, of refusals by reason, and of bytes outside frames.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    messages: BTreeMap<MessageKind, MessageCount>,
    refusals: Vec<RefusalEntry>,
    garbage_bytes: u64,
    first_garbage: Vec<u64>,
    has_more_garbage: bool,
}

/// The result of decoding a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    Decoded,
    PassedOver,
    Refused,
}

impl Statistics {
    /// Messages with a valid checksum, by type.
    pub fn messages(&self) -> impl Iterator<Item = (MessageKind, MessageCount)> {
        self.messages.iter().map(|(kind, count)| (*kind, *count))
    }

    /// The counts of one message type.
    pub fn of(&self, kind: MessageKind) -> MessageCount {
        self.messages.get(&kind).copied().unwrap_or_default()
    }

    /// Refusals by message type and reason, in order of first appearance.
    pub fn refusals(&self) -> &[RefusalEntry] {
        &self.refusals
    }

    /// Number of refusals for a reason, over all message types.
    pub fn refused_for(&self, reason: Refusal) -> u64 {
        self.refusals.iter().filter(|e| e.reason == reason).map(|e| e.count).sum()
    }

    /// Number of bytes outside frames.
    pub const fn garbage_bytes(&self) -> u64 {
        self.garbage_bytes
    }

    /// The first positions of such bytes, at most ten.
    pub(crate) fn first_garbage(&self) -> &[u64] {
        &self.first_garbage
    }

    /// Whether there are such bytes after those.
    pub(crate) const fn has_more_garbage(&self) -> bool {
        self.has_more_garbage
    }

    pub(super) fn count(&mut self, kind: MessageKind, outcome: Outcome) {
        if KINDS_LIMIT <= self.messages.len() && !self.messages.contains_key(&kind) {
            return;
        }
        let count = self.messages.entry(kind).or_default();
        match outcome {
            Outcome::Decoded => count.decoded += 1,
            Outcome::PassedOver => count.passed_over += 1,
            Outcome::Refused => count.refused += 1,
        }
    }

    pub(super) fn refuse(&mut self, kind: Option<MessageKind>, reason: Refusal, at: u64) {
        let known = self.refusals.iter_mut().find(|e| e.kind == kind && e.reason == reason);
        if let Some(entry) = known {
            entry.count += 1;
            entry.has_more |= !note_position(&mut entry.offsets, at);
        } else if self.refusals.len() < REASONS_LIMIT {
            let offsets = vec![at];
            self.refusals.push(RefusalEntry { kind, reason, count: 1, offsets, has_more: false });
        }
    }

    /// Counts `length` bytes outside frames; `begins` if the bytes before them belong to a frame.
    pub(super) fn garbage(&mut self, at: u64, length: u64, begins: bool) {
        self.garbage_bytes += length;
        if begins {
            self.has_more_garbage |= !note_position(&mut self.first_garbage, at);
        }
    }
}
