//! Why a piece of a stream is refused.

use std::sync::Arc;

use crate::formats::GunzipError;
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
    /// Gzip within gzip.
    #[error("what gzip holds is packed by gzip again")]
    PackedTwice,
    /// Packed bytes that cannot be unpacked.
    #[error(transparent)]
    Damaged(#[from] GunzipError),
    /// Too much comes out of packed bytes.
    #[error("unpacked, the {what} exceeds {limit} bytes")]
    UnpackedTooLarge {
        /// The piece, or the stream up to it.
        what: &'static str,
        /// How many may come out.
        limit: u64,
    },
    /// A stream that can be read from its beginning alone has become too long.
    #[error("a stream of {format} is longer than {limit} bytes")]
    StreamTooLong {
        /// Its name.
        format: &'static str,
        /// How long it may be.
        limit: u64,
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
            Self::Unrecognised { .. } | Self::PackedTwice | Self::EpochTooLong { .. } => {
                "RAW_FORMAT_UNKNOWN"
            }
            Self::Damaged(_) => "RINEX_READ_FAILED",
            Self::UnpackedTooLarge { .. } => "DECOMPRESSED_TOO_LARGE",
            Self::StreamTooLong { .. } => "RAW_STREAM_TOO_LONG",
            Self::Rinex(error) => error.code(),
        }
    }

    /// What the sender can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Unrecognised { .. } | Self::PackedTwice | Self::EpochTooLong { .. } => {
                "send RTCM 3, UBX or RINEX observations, plain or gzip, from the stream's beginning"
            }
            Self::Damaged(_) => "pack the stream again: it could not be read to its end",
            Self::UnpackedTooLarge { .. } => "send smaller pieces, or end the stream",
            Self::StreamTooLong { .. } => "end the stream, and begin another file",
            Self::Rinex(error) => error.remedy(),
        }
    }
}
