//! RINEX observation files of bases.

use std::io::BufRead;

use crate::formats::rinex::{ObservationReader, RinexError, Skipped};
use crate::gnss::{BaseSite, Epoch, GpsTime, PositionSource};
use crate::refusal::Code;
use crate::store::StoredBaseEpoch;

/// The content of a base's RINEX observation file.
#[derive(Clone, Debug)]
pub struct BaseFile {
    /// In the order of the file, without numbers.
    pub epochs: Vec<StoredBaseEpoch>,
    /// Position and antenna from the header.
    pub site: Option<BaseSite>,
    /// Records that were skipped.
    pub skipped: Skipped,
}

/// Limits of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BaseFileLimits {
    /// Epochs of the file.
    pub epochs: usize,
    /// Bytes of the encoded epochs.
    pub bytes: usize,
    /// Observations in one epoch.
    pub observations_per_epoch: usize,
}

/// Why a base's file is refused.
#[derive(Debug, thiserror::Error)]
pub enum BaseFileError {
    /// The file is not readable RINEX.
    #[error(transparent)]
    Rinex(#[from] RinexError),
    /// The file has more epochs than a base may have.
    #[error("the file holds more than {limit} epochs")]
    TooManyEpochs {
        /// Number of epochs allowed.
        limit: usize,
    },
    /// The epochs of the file are larger than a base may be.
    #[error("the epochs of the file need more than {limit} bytes")]
    TooLarge {
        /// Size allowed (bytes).
        limit: usize,
    },
    /// An epoch has more observations than allowed.
    #[error("epoch {time} has {observations} observations, at most {limit} are allowed")]
    TooManyObservations {
        /// Time of the epoch.
        time: GpsTime,
        /// Number of its observations.
        observations: usize,
        /// Number of observations allowed.
        limit: usize,
    },
}

impl BaseFileError {
    /// The stable code.
    pub(crate) const fn code(&self) -> Code {
        match self {
            Self::Rinex(error) => error.code(),
            Self::TooManyEpochs { .. } | Self::TooLarge { .. } => Code::BaseTooLarge,
            Self::TooManyObservations { .. } => Code::TooManyObservations,
        }
    }
}

impl BaseFile {
    /// Reads an unpacked RINEX or CRINEX file. Its epochs are kept encoded, so that the limits also
    /// bound the memory.
    ///
    /// # Errors
    /// The file is not readable, or exceeds a limit.
    pub fn read(input: impl BufRead, limits: &BaseFileLimits) -> Result<Self, BaseFileError> {
        let mut reader = ObservationReader::new(input)?;
        let header = reader.header();
        let site = header.approximate_position.map(|marker| BaseSite {
            marker,
            antenna_delta_hen_m: header.antenna_delta_hen_m,
            antenna: header.antenna.clone(),
            calibration: None,
            source: PositionSource::Header,
        });
        let (mut epochs, mut bytes) = (Vec::new(), 0);
        let mut epoch = Epoch::new(GpsTime::EPOCH);
        while reader.read_epoch(&mut epoch)? {
            let (time, observations) = (epoch.time, epoch.observations.len());
            let limit = limits.observations_per_epoch;
            if limit < observations {
                return Err(BaseFileError::TooManyObservations { time, observations, limit });
            }
            if epochs.len() == limits.epochs {
                return Err(BaseFileError::TooManyEpochs { limit: limits.epochs });
            }
            let encoded = StoredBaseEpoch::new(0, &epoch);
            bytes += encoded.size();
            if limits.bytes < bytes {
                return Err(BaseFileError::TooLarge { limit: limits.bytes });
            }
            epochs.push(encoded);
        }
        Ok(Self { epochs, site, skipped: reader.skipped().clone() })
    }
}
