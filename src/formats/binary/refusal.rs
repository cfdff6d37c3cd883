//! Why something in a receiver's bytes is left out.

use crate::gnss::Constellation;

/// Why a message or a part of one is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Refusal {
    /// A frame whose checksum differs from its bytes.
    #[error("checksum differs")]
    Checksum,
    /// A message shorter than what it announces.
    #[error("message ends before its contents")]
    Truncated,
    /// A version of the message that is not decoded.
    #[error("version {0} of the message is not decoded")]
    UnknownVersion(u8),
    /// The week or the day cannot be told, because no time was known when the message came.
    #[error("no reference time tells the week or the day")]
    NoReferenceTime,
    /// A time outside its range.
    #[error("time is outside its range")]
    InvalidTime,
    /// A message with more satellites times signals than the format allows.
    #[error("more satellites and signals than a message holds")]
    TooManyCells,
    /// A signal without a place in the format's table; the other signals are taken.
    #[error("signal {index} of {} is not known", constellation.name())]
    UnknownSignal {
        /// Its constellation.
        constellation: Constellation,
        /// Its number in the message.
        index: u8,
    },
    /// A satellite number the constellation does not have.
    #[error("satellite number is not known")]
    UnknownSatellite,
    /// A satellite of a system that is not decoded.
    #[error("satellite system is not decoded")]
    OtherConstellation,
    /// A signal that the epoch already has.
    #[error("signal appears twice in the epoch")]
    DuplicateSignal,
    /// Ranges without their whole light-milliseconds.
    #[error("pseudoranges lack their whole light-milliseconds")]
    AmbiguousPseudorange,
    /// A GLONASS signal whose channel no message has told: pseudorange without carrier phase.
    #[error("no message tells the GLONASS channel: no carrier phase and Doppler")]
    UnknownChannel,
    /// A subframe, page or string that fails its parity, CRC or Hamming code.
    #[error("subframe fails its parity")]
    Parity,
    /// An ephemeris that no satellite can have.
    #[error("ephemeris is out of bounds")]
    ImplausibleEphemeris,
    /// Observations of an epoch that a better message of the same stream gives.
    #[error("observations stand better in another message of the stream")]
    Superseded,
    /// Observations of an epoch that was complete by the stream's own word.
    #[error("observations came after the end of their epoch")]
    Late,
}
