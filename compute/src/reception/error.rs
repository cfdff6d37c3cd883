//! Why a chunk of a stream is refused.

use std::sync::Arc;

use crate::formats::GunzipError;
use crate::formats::gnss_logger::GnssLoggerError;
use crate::formats::rinex::RinexError;
use crate::refusal::Code;

/// Why a chunk of a stream is refused. Nothing of the chunk is then taken.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ReceptionError {
    /// The stream has neither frames nor RINEX nor a GnssLogger log at its beginning.
    #[error(
        "the first {bytes} bytes hold no frame of RTCM 3 or UBX, nor are they RINEX or a \
         GnssLogger log"
    )]
    Unrecognised {
        /// Number of bytes searched.
        bytes: u64,
    },
    /// The unpacked data is gzip again.
    #[error("what gzip holds is packed by gzip again")]
    PackedTwice,
    /// The gzip data cannot be unpacked.
    #[error(transparent)]
    Damaged(#[from] GunzipError),
    /// The unpacked data is larger than allowed.
    #[error("unpacked, the {what} exceeds {limit} bytes")]
    UnpackedTooLarge {
        /// What is too large: the chunk, or the stream up to its end.
        what: &'static str,
        /// Size allowed (bytes).
        limit: u64,
    },
    /// A stream that can only be read from its beginning has become too long.
    #[error("a stream of {format} is longer than {limit} bytes")]
    StreamTooLong {
        /// Name of the stream's format.
        format: &'static str,
        /// Length allowed (bytes).
        limit: u64,
    },
    /// The chunk completes more epochs than allowed, or larger ones.
    #[error("the chunk completes more than {epochs} epochs or {observations} observations")]
    TooManyEpochs {
        /// Number of epochs allowed.
        epochs: usize,
        /// Number of observations allowed.
        observations: usize,
    },
    /// The RINEX text has no end of an epoch.
    #[error("no whole epoch in {bytes} bytes of RINEX")]
    EpochTooLong {
        /// Number of bytes searched.
        bytes: usize,
    },
    /// The RINEX data is not readable.
    #[error(transparent)]
    Rinex(#[from] Arc<RinexError>),
    /// The GnssLogger log cannot be decoded.
    #[error(transparent)]
    GnssLogger(#[from] GnssLoggerError),
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
            Self::TooManyEpochs { .. } => Code::TooManyEpochs,
            Self::Damaged(_) => Code::RinexReadFailed,
            Self::UnpackedTooLarge { .. } => Code::DecompressedTooLarge,
            Self::StreamTooLong { .. } => Code::RawStreamTooLong,
            Self::Rinex(error) => error.code(),
            Self::GnssLogger(error) => error.code(),
        }
    }
}
