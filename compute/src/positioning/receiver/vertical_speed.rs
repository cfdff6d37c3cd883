//! The prior of a receiver's vertical velocity.
//!
//! The vertical velocity has a prior of zero mean, whose variance is estimated: a car's velocity
//! stays below 0.5 m/s, a drone's does not. As in expectation maximisation, the variance is the
//! mean of v̂² + var(v̂) over the last minute. So an estimate that only repeats the prior does not
//! make it narrower. It starts at 2 m/s.

use nalgebra::SMatrix;

use crate::positioning::factors::{STATE, State, VELOCITY};
use crate::snapshot::snapshot_fields;

/// Column of the vertical velocity.
const UP: usize = VELOCITY + 2;
/// Standard deviation at the start (m/s).
const START_M_S: f64 = 2.0;
/// Time constant of the mean (s).
const MEAN_S: f64 = 60.0;
/// Time after which the vertical velocity is independent (s): closer epochs share one weight.
const INDEPENDENT_S: f64 = 1.0;

/// The variance (m²/s²).
#[derive(Clone, Debug)]
pub(super) struct VerticalSpeed {
    variance_m2_s2: f64,
}

snapshot_fields!(VerticalSpeed { variance_m2_s2 });

impl Default for VerticalSpeed {
    fn default() -> Self {
        Self { variance_m2_s2: START_M_S * START_M_S }
    }
}

impl VerticalSpeed {
    /// Standard deviation of the prior for one epoch, `spacing_s` after the last (m/s).
    pub(super) fn sigma_m_s(&self, spacing_s: f64) -> f64 {
        (self.variance_m2_s2 / (spacing_s / INDEPENDENT_S).min(1.0)).sqrt()
    }

    /// Updates with the state of an epoch and its covariance.
    pub(super) fn learn(
        &mut self,
        interval_s: f64,
        state: &State,
        covariance: &SMatrix<f64, STATE, STATE>,
    ) {
        let square = state[UP] * state[UP] + covariance[(UP, UP)];
        let new = 1.0 - (-interval_s / MEAN_S).exp();
        self.variance_m2_s2 += new * (square - self.variance_m2_s2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After many minutes at 3 ± 4 m/s the variance is 25 m²/s²; epochs 0.25 s apart have a quarter
    /// of the weight each.
    #[test]
    fn the_variance_is_that_of_what_was_seen() {
        let mut speed = VerticalSpeed::default();
        let (mut state, mut covariance) = (State::zeros(), SMatrix::zeros());
        (state[UP], covariance[(UP, UP)]) = (3.0, 16.0);
        (0..900).for_each(|_| speed.learn(1.0, &state, &covariance));
        assert!((speed.sigma_m_s(1.0) - 5.0).abs() < 1e-3);
        assert!((speed.sigma_m_s(0.25) - 10.0).abs() < 1e-3);
    }
}
