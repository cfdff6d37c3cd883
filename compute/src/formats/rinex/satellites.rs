//! The satellites of one epoch: how many there may be, and which were read already.

use crate::gnss::{Constellation, SatelliteId};

/// Largest number of satellites in an epoch, above the number in orbit.
pub(super) const SATELLITES_LIMIT: usize = 300;

/// The satellites of an epoch read so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SeenSatellites([u128; Constellation::COUNT]);

impl SeenSatellites {
    /// Adds a satellite; returns whether it is new.
    pub(super) fn insert(&mut self, satellite: SatelliteId) -> bool {
        let bit = 1_u128 << satellite.number;
        let set = &mut self.0[satellite.constellation.index()];
        let new = *set & bit == 0;
        *set |= bit;
        new
    }
}
