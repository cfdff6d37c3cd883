//! What a reader left out, counted, with the first places.

/// How many line numbers are kept for one reason.
const PLACES_LIMIT: usize = 10;
/// How many different reasons are kept; system letters could otherwise make many.
const REASONS_LIMIT: usize = 64;

/// Why something was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SkipReason {
    /// A satellite of a system that is not decoded.
    #[error("satellite system {0:?} is not decoded")]
    OtherConstellation(char),
    /// A declared observation type that is unknown; its column is passed over.
    #[error("unknown observation type, its column is passed over")]
    UnknownObservationType,
    /// A field that is no number.
    #[error("field is not a number")]
    MalformedValue,
    /// A record whose satellite cannot be read.
    #[error("record names no satellite")]
    MalformedSatellite,
    /// A satellite that the epoch already has.
    #[error("satellite appears twice in the epoch")]
    DuplicateSatellite,
    /// A satellite of a system for which the header declares no observation types.
    #[error("no observation types are declared for the satellite's system")]
    UndeclaredConstellation,
    /// An epoch line that cannot be read.
    #[error("malformed epoch line")]
    MalformedEpoch,
    /// An epoch that states more satellites than there are.
    #[error("epoch states too many satellites")]
    TooManySatellites,
    /// The number of satellites differs from the stated one; those present are used.
    #[error("number of satellites differs from the epoch line")]
    WrongSatelliteCount,
    /// The file ends inside the epoch.
    #[error("file ends inside the epoch")]
    TruncatedEpoch,
    /// An event without observations (flags 2 to 5); its header records are applied.
    #[error("event record, flag {0}")]
    Event(u8),
    /// Records of repaired cycle slips (flag 6).
    #[error("cycle slip records, flag 6")]
    CycleSlipRecords,
    /// A header record that cannot be read and is not needed to go on.
    #[error("malformed header record")]
    MalformedHeaderRecord,
    /// A line that belongs to no epoch or record.
    #[error("line belongs to no record")]
    StrayLine,
    /// A compact epoch whose differences lack what they refer to.
    #[error("compact record refers to data that is not there")]
    BrokenDifferences,
    /// A navigation record that is incomplete or implausible.
    #[error("malformed navigation record")]
    MalformedEphemeris,
    /// A navigation message that is not decoded.
    #[error("navigation message is not decoded")]
    OtherMessage,
}

/// One reason, how often and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SkippedEntry {
    /// Why.
    pub reason: SkipReason,
    /// How often.
    pub count: u64,
    /// The first lines (from 1), at most ten.
    pub lines: Vec<u64>,
}

/// What a reader left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    entries: Vec<SkippedEntry>,
}

impl Skipped {
    /// All reasons met, in order of first appearance.
    pub fn entries(&self) -> &[SkippedEntry] {
        &self.entries
    }

    /// How often a reason was met.
    pub fn count(&self, reason: SkipReason) -> u64 {
        self.entries.iter().find(|e| e.reason == reason).map_or(0, |e| e.count)
    }

    /// Whether nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    pub(super) fn note(&mut self, reason: SkipReason, line: u64) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.reason == reason) {
            entry.count += 1;
            if entry.lines.len() < PLACES_LIMIT {
                entry.lines.push(line);
            }
        } else if self.entries.len() < REASONS_LIMIT {
            self.entries.push(SkippedEntry { reason, count: 1, lines: vec![line] });
        }
    }
}
