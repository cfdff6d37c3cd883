//! The data decoded from a chunk.

use std::collections::BTreeMap;
use std::fmt;

use crate::formats::receiver::{Event, MessageCount, MessageKind, Statistics};
use crate::formats::skipped::Skipped;
use crate::gnss::{Epoch, Navigation};

use super::ReceptionError;

/// Most epochs that one chunk of RINEX completes.
const EPOCHS_MAX: usize = 4096;
/// Most observations of these epochs: a thousand epochs of 256 signals.
const OBSERVATIONS_MAX: usize = 1 << 18;

/// The format of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamFormat {
    /// Frames of RTCM 3 and UBX.
    Receiver,
    /// RINEX observations.
    Rinex,
    /// An Android GnssLogger log.
    GnssLogger,
}

impl StreamFormat {
    /// The name as users see it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Receiver => "receiver",
            Self::Rinex => "rinex",
            Self::GnssLogger => "gnss-logger",
        }
    }
}

/// The count of one type of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageTotal {
    /// Type of the message.
    pub kind: MessageKind,
    /// How many were decoded, skipped and refused.
    pub count: MessageCount,
}

/// One kind of content that was skipped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// Type of the message, if it was one.
    pub kind: Option<MessageKind>,
    /// Why it was skipped.
    pub why: String,
    /// How often it was skipped.
    pub count: u64,
    /// Where it was first skipped: offset in the stream (in the unpacked data, if it is packed), or
    /// line number of a RINEX file or a GnssLogger log, from 1.
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

/// The data decoded from a chunk: epochs, navigation data, and what was skipped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Received {
    /// Complete epochs in the order of the stream.
    pub epochs: Vec<Epoch>,
    /// Ephemerides, ionosphere coefficients and leap seconds.
    pub navigation: Navigation,
    /// The stream's format, once recognised.
    pub format: Option<StreamFormat>,
    /// Counts of messages by type.
    pub messages: Vec<MessageTotal>,
    /// Content that was skipped.
    pub left_out: Vec<LeftOut>,
    /// Number of bytes outside frames.
    pub garbage_bytes: u64,
}

impl Received {
    /// What is known of bytes on which the decoder failed. `at` is the offset of the first one.
    pub fn of_failed_decoder(at: u64) -> Self {
        let why = "the decoder failed, a fault of the service: the bytes are stored, not decoded";
        let left_out = LeftOut { kind: None, why: why.to_owned(), count: 1, first: at };
        Self { left_out: vec![left_out], ..Self::default() }
    }

    /// Adds an epoch.
    ///
    /// # Errors
    /// The chunk has brought as many as it may: packed, a few bytes hide thousands.
    pub(super) fn add(&mut self, epoch: Epoch) -> Result<(), ReceptionError> {
        let observations = self.epochs.iter().map(|epoch| epoch.observations.len()).sum::<usize>();
        if self.epochs.len() == EPOCHS_MAX
            || OBSERVATIONS_MAX < observations + epoch.observations.len()
        {
            let (epochs, observations) = (EPOCHS_MAX, OBSERVATIONS_MAX);
            return Err(ReceptionError::TooManyEpochs { epochs, observations });
        }
        self.epochs.push(epoch);
        Ok(())
    }

    pub(super) fn take(&mut self, events: Vec<Event>) -> Result<(), ReceptionError> {
        for event in events {
            match event {
                Event::Epoch(epoch) => self.add(epoch)?,
                event => {
                    event.apply_to(&mut self.navigation);
                }
            }
        }
        Ok(())
    }

    /// Adds the counts of a decoder that began at byte `from` of the stream.
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

    pub(super) fn skip<R: Copy + PartialEq + fmt::Display>(&mut self, skipped: &Skipped<R>) {
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
