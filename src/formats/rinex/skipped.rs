//! Counts of what a reader left out, with the first lines.

/// Number of line numbers stored for one reason.
const PLACES_LIMIT: usize = 10;
/// Number of reasons stored; unknown system letters could produce many.
const REASONS_LIMIT: usize = 64;

/// Why a part of a file was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SkipReason {
    /// The satellite system is not decoded.
    #[error("satellite system {0:?} is not decoded")]
    OtherConstellation(char),
    /// An observation type is unknown; its column is skipped.
    #[error("unknown observation type, its column is skipped")]
    UnknownObservationType,
    /// A field is not a number.
    #[error("field is not a number")]
    MalformedValue,
    /// The satellite of a record cannot be read.
    #[error("record without a valid satellite")]
    MalformedSatellite,
    /// The epoch already holds the satellite.
    #[error("satellite appears twice in the epoch")]
    DuplicateSatellite,
    /// The header declares no observation types for the satellite's system.
    #[error("no observation types are declared for the satellite's system")]
    UndeclaredConstellation,
    /// An epoch line cannot be read.
    #[error("malformed epoch line")]
    MalformedEpoch,
    /// An epoch states more satellites than exist.
    #[error("epoch states too many satellites")]
    TooManySatellites,
    /// The number of satellites differs from the stated one; those present are used.
    #[error("number of satellites differs from the epoch line")]
    WrongSatelliteCount,
    /// The file ends inside the epoch.
    #[error("file ends inside the epoch")]
    TruncatedEpoch,
    /// An event without observations (flags 2 to 5). Its header records are applied.
    #[error("event record, flag {0}")]
    Event(u8),
    /// Records of repaired cycle slips (flag 6).
    #[error("cycle slip records, flag 6")]
    CycleSlipRecords,
    /// A header record cannot be read and is not required.
    #[error("malformed header record")]
    MalformedHeaderRecord,
    /// A line belongs to no epoch or record.
    #[error("line belongs to no record")]
    StrayLine,
    /// A compact epoch refers to a previous one that is missing.
    #[error("compact record refers to missing data")]
    BrokenDifferences,
    /// A navigation record is incomplete or implausible.
    #[error("malformed navigation record")]
    MalformedEphemeris,
    /// The navigation message is not decoded.
    #[error("navigation message is not decoded")]
    OtherMessage,
}

/// One reason, with count and first lines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SkippedEntry {
    /// Why parts were left out.
    pub reason: SkipReason,
    /// How often this happened.
    pub count: u64,
    /// The first lines (from 1), at most ten.
    pub lines: Vec<u64>,
}

/// Counts of what a reader left out, by reason.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    entries: Vec<SkippedEntry>,
}

impl Skipped {
    /// All reasons, in order of first appearance.
    pub fn entries(&self) -> &[SkippedEntry] {
        &self.entries
    }

    /// How often parts were left out for this reason.
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
