//! What a stream held, and what of it was left out.

use std::collections::BTreeMap;
use std::fmt;

use crate::formats::binary::Refusal;

/// How many places are kept for one reason.
const PLACES_LIMIT: usize = 10;
/// How many different types and reasons are kept; damaged streams could else make many.
const KINDS_LIMIT: usize = 512;
const REASONS_LIMIT: usize = 128;

/// A type of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MessageKind {
    /// RTCM 3, by number.
    Rtcm(u16),
    /// UBX, by class and id.
    Ubx {
        /// Class.
        class: u8,
        /// Identity in the class.
        id: u8,
    },
    /// NMEA sentences.
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

/// What became of the messages of a type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MessageCount {
    /// Understood; parts of them may have been left out.
    pub decoded: u64,
    /// Of a type that is not decoded.
    pub passed_over: u64,
    /// Refused as a whole.
    pub refused: u64,
}

impl MessageCount {
    /// All of them.
    pub const fn total(&self) -> u64 {
        self.decoded + self.passed_over + self.refused
    }
}

/// One reason, for one type of message: how often and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusalEntry {
    /// The type of message, where a message it is.
    pub kind: Option<MessageKind>,
    /// Why.
    pub reason: Refusal,
    /// How often.
    pub count: u64,
    /// The first places, bytes from the stream's start, at most ten.
    pub offsets: Vec<u64>,
}

/// Messages by type, what was left out by reason, and bytes of no frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    messages: BTreeMap<MessageKind, MessageCount>,
    refusals: Vec<RefusalEntry>,
    garbage_bytes: u64,
    first_garbage: Vec<u64>,
}

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    Decoded,
    PassedOver,
    Refused,
}

impl Statistics {
    /// Messages with a right checksum, by type.
    pub fn messages(&self) -> impl Iterator<Item = (MessageKind, MessageCount)> {
        self.messages.iter().map(|(kind, count)| (*kind, *count))
    }

    /// The messages of a type.
    pub fn of(&self, kind: MessageKind) -> MessageCount {
        self.messages.get(&kind).copied().unwrap_or_default()
    }

    /// What was left out, in order of first appearance.
    pub fn refusals(&self) -> &[RefusalEntry] {
        &self.refusals
    }

    /// How often a reason was met, in all types of messages.
    pub fn refused_for(&self, reason: Refusal) -> u64 {
        self.refusals.iter().filter(|e| e.reason == reason).map(|e| e.count).sum()
    }

    /// Bytes that belong to no frame.
    pub const fn garbage_bytes(&self) -> u64 {
        self.garbage_bytes
    }

    /// The first places where such bytes begin, at most ten.
    pub fn first_garbage(&self) -> &[u64] {
        &self.first_garbage
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
            if entry.offsets.len() < PLACES_LIMIT {
                entry.offsets.push(at);
            }
        } else if self.refusals.len() < REASONS_LIMIT {
            self.refusals.push(RefusalEntry { kind, reason, count: 1, offsets: vec![at] });
        }
    }

    /// `length` bytes of no frame; `begins` where the ones before were of a frame.
    pub(super) fn garbage(&mut self, at: u64, length: u64, begins: bool) {
        self.garbage_bytes += length;
        if begins && self.first_garbage.len() < PLACES_LIMIT {
            self.first_garbage.push(at);
        }
    }
}
