//! What an epoch is told of a base station.

use crate::gnss::{BaseStation, Epoch};

/// Base epochs may be tagged this much later than the rover's and still count as of its time (s):
/// receivers tag by clocks that are off by up to milliseconds.
pub const BASE_LATER_S: f64 = 0.02;

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
