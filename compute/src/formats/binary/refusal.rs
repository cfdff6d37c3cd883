//! Reasons for refusing a part of a receiver's data.

use crate::gnss::Constellation;

/// Why a message, or a part of one, is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Refusal {
    /// The checksum of a frame differs from its bytes.
    #[error("checksum differs")]
    Checksum,
    /// The message is shorter than its header states.
    #[error("message ends before its contents")]
    Truncated,
    /// The version of the message is not decoded.
    #[error("version {0} of the message is not decoded")]
    UnknownVersion(u8),
    /// No reference time was known, so week or day are ambiguous.
    #[error("week or day unknown: no reference time")]
    NoReferenceTime,
    /// A time is outside its range.
    #[error("time is outside its range")]
    InvalidTime,
    /// The message states more satellites times signals than the format allows.
    #[error("more satellites and signals than a message holds")]
    TooManyCells,
    /// A signal number is not in the format's table; the other signals are used.
    #[error("signal {index} of {} is not known", constellation.name())]
    UnknownSignal {
        /// The constellation of the signal.
        constellation: Constellation,
        /// The number of the signal in the message.
        index: u8,
    },
    /// The constellation has no satellite with this number.
    #[error("satellite number is not known")]
    UnknownSatellite,
    /// The satellite system is not decoded.
    #[error("satellite system is not decoded")]
    OtherConstellation,
    /// The epoch already holds this signal.
    #[error("signal appears twice in the epoch")]
    DuplicateSignal,
    /// The whole light-milliseconds of the ranges are missing.
    #[error("pseudoranges lack their whole light-milliseconds")]
    AmbiguousPseudorange,
    /// The GLONASS channel is unknown, so the signal has a pseudorange but no carrier phase.
    #[error("GLONASS channel unknown: no carrier phase and Doppler")]
    UnknownChannel,
    /// A subframe, page or string fails its parity, CRC or Hamming code.
    #[error("subframe fails its parity")]
    Parity,
    /// The orbit is not one of a navigation satellite.
    #[error("ephemeris is out of bounds")]
    ImplausibleEphemeris,
    /// Another message type of the same stream has better observations of the epoch.
    #[error("another message of the stream has better observations")]
    Superseded,
    /// The stream had declared the epoch complete.
    #[error("observations came after the end of their epoch")]
    Late,
}
