//! Why a piece of a stream is refused.

use std::sync::Arc;

use crate::formats::GunzipError;
use crate::formats::rinex::RinexError;
use crate::refusal::Code;

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
    /// The stable code.
    pub fn code(&self) -> Code {
        match self {
            Self::Unrecognised { .. } | Self::PackedTwice | Self::EpochTooLong { .. } => {
                Code::RawFormatUnknown
            }
            Self::Damaged(_) => Code::RinexReadFailed,
            Self::UnpackedTooLarge { .. } => Code::DecompressedTooLarge,
            Self::StreamTooLong { .. } => Code::RawStreamTooLong,
            Self::Rinex(error) => error.code(),
        }
    }
}
