//! Checks the stated position of a base against its own single-point positions.

use nalgebra::Vector3;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::{BaseSite, Epoch, Navigation};
use crate::positioning::{Aiding, Estimator};

/// Epochs whose single-point positions are averaged.
const EPOCHS_MAX: u32 = 10;
/// Beyond this distance a position is doubtful (m): single-point positions are wrong by some
/// metres.
const DOUBTFUL_M: f64 = 10.0;
/// Beyond this distance a position is refused (m).
pub(super) const REFUSED_M: f64 = 100.0;

/// The stated position of a base compared with the mean of its single-point positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionCheck {
    sum_m: Vector3<f64>,
    /// Epochs with a single-point position so far; zero if there is no navigation data of their
    /// time.
    pub epochs: u32,
}

impl PositionCheck {
    /// A check without epochs.
    pub(super) fn new() -> Self {
        Self { sum_m: Vector3::zeros(), epochs: 0 }
    }

    /// Distance from the stated antenna reference point to the mean single-point position (m).
    pub fn distance_m(&self) -> Option<f64> {
        (0 < self.epochs).then(|| self.sum_m.norm() / f64::from(self.epochs))
    }

    /// The distance, if it makes the stated position doubtful (m).
    pub fn doubtful_distance_m(&self) -> Option<f64> {
        self.distance_m().filter(|distance_m| DOUBTFUL_M < *distance_m)
    }

    /// The verdict as the API writes it: `UNCHECKED`, `AGREES`, `DOUBTFUL` or `REFUSED`.
    pub fn verdict(&self) -> &'static str {
        match self.distance_m() {
            None => "UNCHECKED",
            Some(distance_m) if REFUSED_M < distance_m => "REFUSED",
            Some(distance_m) if DOUBTFUL_M < distance_m => "DOUBTFUL",
            Some(_) => "AGREES",
        }
    }

    pub(super) const fn is_done(&self) -> bool {
        EPOCHS_MAX <= self.epochs
    }

    /// Adds epochs until there are enough.
    pub(super) fn add<'a>(
        mut self,
        site: &BaseSite,
        epochs: impl IntoIterator<Item = &'a Epoch>,
        navigation: &Navigation,
    ) -> Self {
        let stated = site.antenna_reference_point();
        let options = PositioningOptions::new(Mode::Spp, Profile::General);
        let mut single_point = Estimator::new(options);
        for epoch in epochs {
            if self.is_done() {
                break;
            }
            let solution = single_point.advance(epoch, &Aiding::alone(navigation));
            if let Some(estimate) = solution.estimate {
                self.sum_m += estimate.position.0 - stated.0;
                self.epochs += 1;
            }
        }
        self
    }
}
