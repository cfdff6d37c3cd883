//! Why a piece of a stream is refused.

use std::sync::Arc;

use crate::formats::rinex::RinexError;

/// Why a piece of a stream is refused; nothing of it is then taken.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ReceptionError {
    /// Neither frames nor RINEX.
    #[error("the first {bytes} bytes hold no frame of RTCM 3 or UBX, nor are they RINEX")]
    Unrecognised {
        /// How many bytes were looked through.
        bytes: u64,
    },
    /// Of a format that cannot be read from the middle on.
    #[error("{format} cannot be taken in pieces")]
    Unsupported {
        /// Its name.
        format: &'static str,
    },
    /// Text without the end of an epoch.
    #[error("no whole epoch in {bytes} bytes of RINEX")]
    EpochTooLong {
        /// How many bytes were looked through.
        bytes: usize,
    },
    /// RINEX that cannot be read on.
    #[error(transparent)]
    Rinex(#[from] Arc<RinexError>),
}

impl From<RinexError> for ReceptionError {
    fn from(error: RinexError) -> Self {
        Self::Rinex(Arc::new(error))
    }
}

impl ReceptionError {
    /// Stable code, upper snake case.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Unrecognised { .. } | Self::Unsupported { .. } | Self::EpochTooLong { .. } => {
                "RAW_FORMAT_UNKNOWN"
            }
            Self::Rinex(error) => error.code(),
        }
    }

    /// What the sender can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Unrecognised { .. } | Self::Unsupported { .. } | Self::EpochTooLong { .. } => {
                "send RTCM 3, UBX or RINEX observations, not packed, from the stream's beginning"
            }
            Self::Rinex(error) => error.remedy(),
        }
    }
}
