//! Files of bases.

use crate::formats::rinex::{ObservationReader, RinexError, Skipped};
use crate::gnss::{BaseSite, Epoch, GpsTime, PositionSource};

/// What a RINEX observation file of a base holds.
#[derive(Clone, Debug)]
pub struct BaseFile {
    /// In the order of the file.
    pub epochs: Vec<Epoch>,
    /// Where its header says that the base stands.
    pub site: Option<BaseSite>,
    /// What was left out.
    pub skipped: Skipped,
}

/// Why a file of a base is not taken.
#[derive(Debug, thiserror::Error)]
pub enum BaseFileError {
    /// It cannot be read.
    #[error(transparent)]
    Rinex(#[from] RinexError),
    /// It has more epochs than a base may hold.
    #[error("the file holds more than {limit} epochs")]
    TooManyEpochs {
        /// How many it may hold.
        limit: usize,
    },
}

impl BaseFile {
    /// Reads a file that is unpacked, RINEX or CRINEX.
    ///
    /// # Errors
    /// It cannot be read, or has more than `epochs_max` epochs.
    pub fn read(text: &[u8], epochs_max: usize) -> Result<Self, BaseFileError> {
        let mut reader = ObservationReader::new(text)?;
        let header = reader.header();
        let site = header.approximate_position.map(|marker| BaseSite {
            marker,
            antenna_delta_hen_m: header.antenna_delta_hen_m,
            antenna: header.antenna.clone(),
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
