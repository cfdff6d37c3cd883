//! RINEX observation files of bases.

use crate::formats::rinex::{ObservationReader, RinexError, Skipped};
use crate::gnss::{BaseSite, Epoch, GpsTime, PositionSource};

/// The content of a base's RINEX observation file.
#[derive(Clone, Debug)]
pub struct BaseFile {
    /// In the order of the file.
    pub epochs: Vec<Epoch>,
    /// Position and antenna from the header.
    pub site: Option<BaseSite>,
    /// Records that were skipped.
    pub skipped: Skipped,
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
}

impl BaseFile {
    /// Reads an unpacked RINEX or CRINEX file.
    ///
    /// # Errors
    /// The file is not readable, or has more than `epochs_max` epochs.
    pub fn read(text: &[u8], epochs_max: usize) -> Result<Self, BaseFileError> {
        let mut reader = ObservationReader::new(text)?;
        let header = reader.header();
        let site = header.approximate_position.map(|marker| BaseSite {
            marker,
            antenna_delta_hen_m: header.antenna_delta_hen_m,
            antenna: header.antenna.clone(),
            calibration: None,
            source: PositionSource::Header,
        });
        let mut epochs = Vec::new();
        let mut epoch = Epoch::new(GpsTime::EPOCH);
        while reader.read_epoch(&mut epoch)? {
            if epochs.len() == epochs_max {
                return Err(BaseFileError::TooManyEpochs { limit: epochs_max });
            }
            epochs.push(epoch.clone());
        }
        Ok(Self { epochs, site, skipped: reader.skipped().clone() })
    }
}
