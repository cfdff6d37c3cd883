//! Whether a base stands where it is said to stand: its own single-point positions tell.

use nalgebra::Vector3;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::{BaseSite, Epoch, Navigation};
use crate::positioning::{Aiding, Estimator};

/// Epochs whose single-point positions are averaged.
const EPOCHS_MAX: u32 = 10;
/// A position that is off by more is doubted (m): single points are off by some metres.
const DOUBTED_M: f64 = 10.0;
/// A position that is off by more is refused (m).
pub(super) const REFUSED_M: f64 = 100.0;

/// How far a base's stated position is from what the base observes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionCheck {
    sum_m: Vector3<f64>,
    /// Epochs whose single-point positions were averaged; none where no navigation data of their
    /// time is held.
    pub epochs: u32,
}

impl PositionCheck {
    /// Nothing checked yet.
    pub(super) fn new() -> Self {
        Self { sum_m: Vector3::zeros(), epochs: 0 }
    }

    /// From the stated antenna reference point to the mean of the single-point positions (m).
    pub fn distance_m(&self) -> Option<f64> {
        (0 < self.epochs).then(|| self.sum_m.norm() / f64::from(self.epochs))
    }

    /// How far the position is off, if that casts doubt on it.
    pub fn doubt_m(&self) -> Option<f64> {
        self.distance_m().filter(|distance_m| DOUBTED_M < *distance_m)
    }

    /// The outcome in a word: `UNCHECKED`, `AGREES`, `DOUBTFUL`, `REFUSED`.
    pub fn verdict(&self) -> &'static str {
        match self.distance_m() {
            None => "UNCHECKED",
            Some(distance_m) if REFUSED_M < distance_m => "REFUSED",
            Some(distance_m) if DOUBTED_M < distance_m => "DOUBTFUL",
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
