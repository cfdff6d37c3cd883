//! A factor on an a-priori standard deviation, estimated from whitened residuals.
//!
//! The factor has a grid of half octaves from 1/4 to 128 and a log-normal prior about one with a
//! standard deviation of two octaves. Residuals have Student's t distribution of three degrees of
//! freedom, whose tails cover multipath and slips. n residuals of a solution with p unknowns are
//! multiplied by √(n/(n − p)).

use crate::positioning::log_product::log_product;
use crate::snapshot::snapshot_fields;

use super::grid::Grid;
use super::kept;

/// First value of the grid (octaves), and the step.
const FIRST_OCTAVE: f64 = -2.0;
const STEP_OCTAVES: f64 = 0.5;
const VALUES: usize = 19;
/// Standard deviation of the prior (octaves).
const PRIOR_OCTAVES: f64 = 2.0;
/// Number of unknowns p: position or velocity, and a clock or its drift.
const UNKNOWNS: usize = 4;

/// Posterior of the factor.
#[derive(Clone, Debug)]
pub(super) struct NoiseScale {
    octave: Grid<VALUES>,
}

snapshot_fields!(NoiseScale { octave });

impl Default for NoiseScale {
    fn default() -> Self {
        Self { octave: Grid::new(prior) }
    }
}

fn octaves(index: f64) -> f64 {
    FIRST_OCTAVE + STEP_OCTAVES * index
}

fn prior(index: f64) -> f64 {
    -0.5 * (octaves(index) / PRIOR_OCTAVES).powi(2)
}

impl NoiseScale {
    /// The factor: geometric mean of the posterior.
    pub(super) fn value(&self) -> f64 {
        octaves(self.octave.moments().0).exp2()
    }

    /// Updates with residuals over the standard deviations in force, which include the present
    /// factor.
    pub(super) fn learn(&mut self, interval_s: f64, whitened: &[f64]) {
        let present = self.value();
        self.octave.fade(kept(interval_s), prior);
        let count = whitened.len();
        if count <= UNKNOWNS {
            return;
        }
        let inflation = count as f64 / (count - UNKNOWNS) as f64 * present * present;
        self.octave.update(|index| {
            let variance = (2.0 * octaves(index)).exp2();
            let scale = inflation / (3.0 * variance);
            let tails = whitened.iter().map(|z| 1.0 + z * z * scale);
            -0.5 * count as f64 * variance.ln() - 2.0 * log_product(tails)
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eight residuals of ±3 a-priori standard deviations; the factor is used in the next
    /// whitening. The likeliest scale k of t₃ satisfies Σ (4z²/k²)/(3 + z²/k²) = n: z² = k²,
    /// multiplied by 8/4, so k = 3·√2.
    #[test]
    fn the_factor_becomes_that_of_the_residuals() {
        let mut scale = NoiseScale::default();
        assert!((0.9..1.6).contains(&scale.value()), "{}", scale.value());
        for _ in 0..400 {
            let z = 3.0 / scale.value();
            scale.learn(1.0, &[z, -z, z, -z, z, -z, z, -z]);
        }
        let expected = 3.0 * 2.0_f64.sqrt();
        assert!((scale.value() / expected - 1.0).abs() < 0.2, "{}", scale.value());
        // Too few residuals change nothing.
        let before = scale.value();
        scale.learn(0.0, &[100.0; 4]);
        assert_eq!(scale.value(), before);
    }
}
