//! What an epoch needs beside its own observations.

use crate::gnss::{BaseStation, Epoch, Navigation};

/// Base epochs may be tagged this much later than the rover's and still count as of its time (s):
/// receivers tag by clocks that are off by up to milliseconds.
pub const BASE_LATER_S: f64 = 0.02;
/// Tolerance of time tags where the age of a base's epoch meets its limit (s).
pub(crate) const TAG_SLACK_S: f64 = 1e-3;

/// A base whose stated position changes by more than this has moved (m): messages state 0.1 mm.
pub(crate) const BASE_MOVED_M: f64 = 1e-3;

/// What an epoch needs beside its own observations.
#[derive(Clone, Copy, Debug)]
pub struct Aiding<'a> {
    /// Ephemerides and ionosphere coefficients.
    pub navigation: &'a Navigation,
    /// The base, for modes relative to one.
    pub base: Option<BaseAiding<'a>>,
}

impl<'a> Aiding<'a> {
    /// Without a base.
    pub const fn alone(navigation: &'a Navigation) -> Self {
        Self { navigation, base: None }
    }
}

/// A base station and its epochs since the last one given.
#[derive(Clone, Copy, Debug)]
pub struct BaseAiding<'a> {
    /// The station.
    pub station: &'a BaseStation,
    /// Its epochs in order of time, no later than the rover's by more than its clock may be off.
    /// Epochs given before are ignored; all since then are needed, since each may report a cycle
    /// slip.
    pub epochs: &'a [Epoch],
}
