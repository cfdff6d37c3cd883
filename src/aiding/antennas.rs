//! Calibrations of receivers' antennas: those of the operator's ANTEX file, and the stored ones.

use std::sync::Arc;

use crate::gnss::{AntennaCalibration, AntennaCatalogue, BaseSite};
use crate::store::{AntennaName, Store};

use super::AidingError;

/// The desk for calibrations of receivers' antennas. All clones share the same calibrations.
///
/// A calibration is stored when a session or a base begins to use it. So the session continues, and
/// is replayed, without the operator's file.
#[derive(Clone)]
pub struct Antennas {
    store: Store,
    catalogue: Arc<AntennaCatalogue>,
}

impl Antennas {
    pub(super) const fn new(store: Store, catalogue: Arc<AntennaCatalogue>) -> Self {
        Self { store, catalogue }
    }

    /// Whether there is no ANTEX file, or the file has no receivers' antennas.
    pub(crate) fn is_empty(&self) -> bool {
        self.catalogue.receivers.is_empty()
    }

    /// Looks up an antenna by type and radome and stores its calibration.
    ///
    /// # Errors
    /// The ANTEX file does not have it, or the store fails.
    pub(crate) async fn keep(&self, name: &str) -> Result<AntennaName, AidingError> {
        let calibration = self.find(name)?;
        self.store.keep_calibration(calibration).await?;
        Ok(AntennaName::of(calibration))
    }

    /// The calibration of an antenna by type and radome, with its name and hash. Nothing is stored.
    ///
    /// # Errors
    /// The ANTEX file does not have it.
    pub(crate) fn named(
        &self,
        name: &str,
    ) -> Result<(AntennaName, Arc<AntennaCalibration>), AidingError> {
        let calibration = self.find(name)?;
        Ok((AntennaName::of(calibration), Arc::new(calibration.clone())))
    }

    /// The stored calibration with this hash.
    ///
    /// # Errors
    /// No stored calibration has this hash, or the store fails.
    pub(crate) async fn kept(&self, hash: &str) -> Result<Arc<AntennaCalibration>, AidingError> {
        Ok(Arc::new(self.store.calibration(hash).await?))
    }

    /// The site of a new base with the calibration of its antenna.
    ///
    /// # Errors
    /// The ANTEX file does not have the antenna that the site names.
    pub(super) fn of_new_base(&self, site: &BaseSite) -> Result<BaseSite, AidingError> {
        if !site.antenna.is_empty() && !self.is_empty() {
            self.find(&site.antenna)?;
        }
        Ok(self.calibrated(site, None))
    }

    /// The site with the calibration of its antenna: from the ANTEX file, otherwise from the site
    /// `before`, if it has the same antenna.
    pub(super) fn calibrated(&self, site: &BaseSite, before: Option<&BaseSite>) -> BaseSite {
        let same = before.filter(|before| before.antenna == site.antenna);
        let same = same.and_then(|before| before.calibration.clone());
        let calibration = match self.catalogue.receiver(&site.antenna, "") {
            Some(known) if same.as_deref() == Some(known) => same,
            Some(known) => Some(Arc::new(known.clone())),
            None => same,
        };
        BaseSite { calibration, ..site.clone() }
    }

    fn find(&self, name: &str) -> Result<&AntennaCalibration, AidingError> {
        let found = self.catalogue.receiver(name, "");
        found.ok_or_else(|| AidingError::AntennaUnknown { name: name.to_owned() })
    }
}
