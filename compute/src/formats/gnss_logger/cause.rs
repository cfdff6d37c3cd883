//! Why a measurement or a part of it is left out.

/// Why a measurement, or the named part of it, is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Cause {
    /// The field is not a number.
    #[error("{column} is not a number")]
    NotANumber {
        /// Name of the column.
        column: &'static str,
    },
    /// The number cannot be one of this quantity.
    #[error("{column} is out of range")]
    OutOfRange {
        /// Name of the column.
        column: &'static str,
    },
    /// The field is blank or absent, and required.
    #[error("{column} is blank")]
    Blank {
        /// Name of the column.
        column: &'static str,
    },
    /// The last line has no end.
    #[error("the last line is cut")]
    CutLine,
    /// The phone does not know GPS time: `FullBiasNanos` is zero, positive or unset.
    #[error("GPS time is unknown (FullBiasNanos)")]
    TimeUnknown,
    /// The phone's GPS time is uncertain by more than 10 ms.
    #[error("GPS time is uncertain by more than 10 ms (BiasUncertaintyNanos)")]
    TimeUncertain,
    /// The constellation is not decoded.
    #[error("constellation type {0} is not decoded")]
    OtherConstellation(i64),
    /// The constellation has no such satellite.
    #[error("{constellation} has no satellite with Svid {svid}")]
    NoSuchSatellite {
        /// Name of the constellation.
        constellation: &'static str,
        /// The number given.
        svid: i64,
    },
    /// A GLONASS satellite is given by its frequency channel, which two satellites share.
    #[error("GLONASS satellite without slot, by frequency channel only")]
    SlotUnknown,
    /// The carrier frequency belongs to no signal of the constellation.
    #[error("CarrierFrequencyHz belongs to no signal of the constellation")]
    UnknownFrequency,
    /// The code type is not a letter.
    #[error("CodeType is not a letter")]
    UnknownCode,
    /// The code is not tracked.
    #[error("no code lock (State)")]
    NoCodeLock,
    /// The time of transmission is known modulo less than 100 ms.
    #[error("time of transmission is ambiguous (State)")]
    Ambiguous,
    /// The time of transmission is uncertain by more than 500 ns.
    #[error("time of transmission is uncertain by more than 500 ns")]
    TransmissionUncertain,
    /// The time of flight is impossible.
    #[error("impossible time of flight")]
    ImpossibleFlight,
    /// The time of measurement differs from that of the epoch, and no rate relates them.
    #[error("TimeOffsetNanos without PseudorangeRateMetersPerSecond")]
    OffsetWithoutRate,
    /// The pseudorange rate is uncertain by more than 10 m/s: only Doppler is left out.
    #[error("Doppler only: uncertain by more than 10 m/s")]
    RateUncertain,
    /// The frequency channel of a GLONASS satellite is unknown: Doppler and phase are left out.
    #[error("Doppler and phase only: GLONASS channel is unknown")]
    ChannelUnknown,
    /// The epoch already holds the signal.
    #[error("signal appears twice in the epoch")]
    DuplicateSignal,
    /// The epoch has too many measurements.
    #[error("epoch has more than 1024 measurements")]
    TooManyMeasurements,
    /// The line is neither a record nor a comment.
    #[error("line belongs to no record")]
    StrayLine,
}
