//! What an epoch is told of a base station.

use crate::gnss::{BaseStation, Epoch};

/// A base station and what it observed of late.
#[derive(Clone, Copy, Debug)]
pub struct BaseAiding<'a> {
    /// The station.
    pub station: &'a BaseStation,
    /// Its epochs in order of time, no later than the rover's by more than its clock may be off.
    /// Those given before are passed over; all since then are wanted, because each may tell of a
    /// cycle slip.
    pub epochs: &'a [Epoch],
}
