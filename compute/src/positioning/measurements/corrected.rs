//! Pseudoranges that a base corrected.

use crate::gnss::{ObservationCode, SatelliteId};

/// The corrected pseudoranges of an epoch; the memory is reused.
#[derive(Clone, Debug, Default)]
pub(crate) struct CorrectedRanges {
    list: Vec<(SatelliteId, ObservationCode, f64)>,
}

impl CorrectedRanges {
    /// Removes all.
    pub(crate) fn clear(&mut self) {
        self.list.clear();
    }

    /// Adds the pseudorange of a signal (m): ρ + c·δt_r.
    pub(crate) fn push(&mut self, satellite: SatelliteId, code: ObservationCode, range_m: f64) {
        self.list.push((satellite, code, range_m));
    }

    /// The pseudorange of a signal (m).
    pub(crate) fn range_m(&self, satellite: SatelliteId, code: ObservationCode) -> Option<f64> {
        let is_it = |entry: &&(SatelliteId, _, _)| (entry.0, entry.1) == (satellite, code);
        self.list.iter().find(is_it).map(|entry| entry.2)
    }
}
