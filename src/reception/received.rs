//! What came out of a piece.

use std::collections::BTreeMap;
use std::fmt;

use crate::formats::receiver::{Event, MessageCount, MessageKind, Statistics};
use crate::formats::rinex::Skipped;
use crate::gnss::{Epoch, Navigation};

/// The format of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamFormat {
    /// Frames of RTCM 3 and UBX.
    Receiver,
    /// RINEX observations.
    Rinex,
}

impl StreamFormat {
    /// The name as users read it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Receiver => "receiver",
            Self::Rinex => "rinex",
        }
    }
}

/// Messages of a type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageTotal {
    /// The type.
    pub kind: MessageKind,
    /// What became of them.
    pub count: MessageCount,
}

/// One kind of content that was left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// The type of message, where a message it is.
    pub kind: Option<MessageKind>,
    /// Why.
    pub why: String,
    /// How often.
    pub count: u64,
    /// Where first: the byte of the session's stream (of what is unpacked of a packed one), or the
    /// line of a RINEX file from 1.
    pub first: u64,
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            Some(kind) => write!(f, "{kind}: {}", self.why),
            None => f.write_str(&self.why),
        }
    }
}

/// What came out of a piece: whole epochs, navigation data, and an account of the bytes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Received {
    /// In the order of the stream.
    pub epochs: Vec<Epoch>,
    /// Ephemerides, ionosphere coefficients, leap seconds.
    pub navigation: Navigation,
    /// The stream's format, once it is known.
    pub format: Option<StreamFormat>,
    /// Messages by type.
    pub messages: Vec<MessageTotal>,
    /// What was left out.
    pub left_out: Vec<LeftOut>,
    /// Bytes of no frame.
    pub garbage_bytes: u64,
}

impl Received {
    pub(super) fn take(&mut self, events: Vec<Event>) {
        for event in events {
            match event {
                Event::Epoch(epoch) => self.epochs.push(epoch),
                event => {
                    event.apply_to(&mut self.navigation);
                }
            }
        }
    }

    /// Takes over what a decoder counted that began at byte `from` of the stream.
    pub(super) fn count(&mut self, statistics: &Statistics, from: u64) {
        let mut totals: BTreeMap<MessageKind, MessageCount> =
            self.messages.iter().map(|total| (total.kind, total.count)).collect();
        for (kind, count) in statistics.messages() {
            let total = totals.entry(kind).or_default();
            total.decoded += count.decoded;
            total.passed_over += count.passed_over;
            total.refused += count.refused;
        }
        self.messages =
            totals.into_iter().map(|(kind, count)| MessageTotal { kind, count }).collect();
        self.garbage_bytes += statistics.garbage_bytes();
        for entry in statistics.refusals() {
            let first = from + entry.offsets.first().copied().unwrap_or_default();
            self.leave_out(entry.kind, entry.reason.to_string(), entry.count, first);
        }
    }

    pub(super) fn skip(&mut self, skipped: &Skipped) {
        for entry in skipped.entries() {
            let first = entry.lines.first().copied().unwrap_or_default();
            self.leave_out(None, entry.reason.to_string(), entry.count, first);
        }
    }

    pub(super) fn leave_out(
        &mut self,
        kind: Option<MessageKind>,
        why: String,
        count: u64,
        first: u64,
    ) {
        match self.left_out.iter_mut().find(|known| known.kind == kind && known.why == why) {
            Some(known) => known.count += count,
            None => self.left_out.push(LeftOut { kind, why, count, first }),
        }
    }
}
