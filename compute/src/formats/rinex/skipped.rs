//! Why parts of a RINEX file are left out.

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

/// Counts of what a reader of RINEX left out, by reason.
pub type Skipped = crate::formats::skipped::Skipped<SkipReason>;
/// One reason, with count and first lines.
pub type SkippedEntry = crate::formats::skipped::SkippedEntry<SkipReason>;
