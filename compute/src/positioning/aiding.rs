//! Input of an epoch besides its own observations.

use crate::gnss::{BaseStation, Epoch, Navigation};

/// Base epochs tagged up to this much later than the rover's count as simultaneous (s): receivers'
/// clocks are off by up to milliseconds.
pub const BASE_LATER_S: f64 = 0.02;
/// Tolerance of time tags when the age of a base epoch is compared with its limit (s).
pub const TAG_SLACK_S: f64 = 1e-3;

/// A base whose stated position changes by more than this has moved (m). Less is a correction of
/// its coordinates: a twentieth of a cycle on L1, so that all integers stay the same.
pub(crate) const BASE_MOVED_M: f64 = 0.01;

/// Input of an epoch besides its own observations.
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

/// A base station, and its epochs since the previous input.
#[derive(Clone, Copy, Debug)]
pub struct BaseAiding<'a> {
    /// The station.
    pub station: &'a BaseStation,
    /// Its epochs in order of time, none later than the rover's by more than the tolerance of time
    /// tags. Epochs of earlier inputs are ignored. All epochs since then are required, because each
    /// may report a cycle slip.
    pub epochs: &'a [Epoch],
}
