//! The prior of a receiver's vertical velocity.
//!
//! The vertical velocity has a prior of zero mean, whose scale is estimated: a car's velocity stays
//! below 0.5 m/s, a drone's does not.
//!
//! The prior is Student's t of three degrees of freedom, as those of Doppler and phases are. After
//! minutes on the level a lift or a drone begins to climb at hundreds of standard deviations. A
//! normal prior would then outweigh all measurements, which are rejected with a bounded loss.
//!
//! As in expectation maximisation, the square of the scale is the mean of w·(v̂² + var(v̂)) over
//! the last minute, w = 4/(3 + (v̂² + var(v̂))/σ²) (Lange, Little & Taylor 1989, *Robust
//! statistical modeling using the t distribution*, JASA 84). So an estimate that only repeats the
//! prior does not make it narrower. It starts at 2 m/s.

use nalgebra::SMatrix;

use crate::graph::{Estimate, System};
use crate::positioning::factors::{ComponentFactor, STATE, State, VELOCITY};
use crate::positioning::setup::student;
use crate::snapshot::snapshot_fields;

/// Column of the vertical velocity.
const UP: usize = VELOCITY + 2;
/// Standard deviation at the start (m/s).
const START_M_S: f64 = 2.0;
/// Time constant of the mean (s).
const MEAN_S: f64 = 60.0;
/// Time after which the vertical velocity is independent (s): closer epochs share one weight.
const INDEPENDENT_S: f64 = 1.0;

/// The prior of an epoch's vertical velocity.
#[derive(Clone, Copy, Debug)]
pub(in crate::positioning) struct VerticalPrior {
    velocity: ComponentFactor,
    /// Fraction of its information that is independent of the epoch before.
    independent_share: f64,
}

snapshot_fields!(VerticalPrior { velocity, independent_share });

impl VerticalPrior {
    /// Adds its row on state `k` of an estimate.
    pub(in crate::positioning) fn add_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        system: &mut System<STATE>,
    ) {
        let kernel = student().scaled(self.independent_share);
        system.add(k, &self.velocity.linearize(&estimate.states[k]), &kernel);
    }

    /// Whether it is of a component that a state has.
    pub(in crate::positioning) const fn is_valid(&self) -> bool {
        self.velocity.column < STATE
    }
}

/// The square of the scale (m²/s²).
#[derive(Clone, Debug)]
pub(super) struct VerticalSpeed {
    scale_m2_s2: f64,
}

snapshot_fields!(VerticalSpeed { scale_m2_s2 });

impl Default for VerticalSpeed {
    fn default() -> Self {
        Self { scale_m2_s2: START_M_S * START_M_S }
    }
}

impl VerticalSpeed {
    /// The prior of one epoch, `spacing_s` after the last.
    pub(super) fn prior(&self, spacing_s: f64) -> VerticalPrior {
        let sigma_m_s = self.scale_m2_s2.sqrt();
        VerticalPrior {
            velocity: ComponentFactor { column: UP, mean: 0.0, inverse_sigma: sigma_m_s.recip() },
            independent_share: (spacing_s / INDEPENDENT_S).min(1.0),
        }
    }

    /// Updates with the state of an epoch and its covariance.
    pub(super) fn learn(
        &mut self,
        interval_s: f64,
        state: &State,
        covariance: &SMatrix<f64, STATE, STATE>,
    ) {
        let square = state[UP] * state[UP] + covariance[(UP, UP)];
        let weight = 4.0 / (3.0 + square / self.scale_m2_s2);
        let new = 1.0 - (-interval_s / MEAN_S).exp();
        self.scale_m2_s2 += new * (weight * square - self.scale_m2_s2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After many minutes at 3 ± 4 m/s the scale is 5 m/s, as each weight is one; epochs 0.25 s
    /// apart have a quarter of the weight each. One epoch at 500 m/s adds at most 4/60 of σ².
    #[test]
    fn the_scale_is_that_of_what_was_seen() {
        let mut speed = VerticalSpeed::default();
        let (mut state, mut covariance) = (State::zeros(), SMatrix::zeros());
        (state[UP], covariance[(UP, UP)]) = (3.0, 16.0);
        (0..1800).for_each(|_| speed.learn(1.0, &state, &covariance));
        let prior = speed.prior(1.0);
        assert!((prior.velocity.inverse_sigma - 0.2).abs() < 1e-5);
        assert_eq!((prior.independent_share, speed.prior(0.25).independent_share), (1.0, 0.25));
        state[UP] = 500.0;
        speed.learn(1.0, &state, &covariance);
        assert!(speed.scale_m2_s2 < 25.0 * (1.0 + 4.0 / 60.0), "{}", speed.scale_m2_s2);
    }
}
