//! Losses of lock that the receivers report.

use crate::gnss::{ObservationCode, SatelliteId};

/// Carriers on which either receiver may have slipped since the last epoch.
#[derive(Debug, Default)]
pub(crate) struct Losses {
    /// All carriers: a receiver lost power, the base moved, or each epoch is solved alone.
    pub(crate) all: bool,
    pub(crate) rover: Vec<(SatelliteId, ObservationCode)>,
    pub(crate) base: Vec<(SatelliteId, ObservationCode)>,
}

impl Losses {
    /// Whether the carrier with these codes at rover and base is among them.
    pub(crate) fn has(&self, satellite: SatelliteId, codes: [ObservationCode; 2]) -> bool {
        self.all
            || self.rover.contains(&(satellite, codes[0]))
            || self.base.contains(&(satellite, codes[1]))
    }
}
