//! Protection levels of a single point.
//!
//! It is unknown which satellites are wrong, so each hypothesis has its own bound (Pervan, Pullen &
//! Christie 1998, *A multiple hypothesis approach to satellite navigation integrity*, Navigation
//! 45; Blanch et al. 2015, *Baseline advanced RAIM user algorithm and possible improvements*, IEEE
//! Trans. Aerosp. Electron. Syst. 51; Joerger, Chan & Pervan 2014, *Solution separation versus
//! residual-based RAIM*, Navigation 61). With S_i = ∂p/∂s_i, the position's change per error of
//! satellite i:
//!
//! - none is wrong, but each may be reflected, with the probability π_i of its C/N0 and an extra
//!   path of mean λ: Σ₀ = Σ_stated + f·Σ S_i S_iᵀ·2λ²π_i, level k(P/2)·σ₀, with f ≥ 1 the ratio of
//!   the residuals to their expectation;
//! - satellite i alone is wrong, with probability ε: |p − p₋ᵢ| + k(P/(2nε))·σ₋ᵢ, with p₋ᵢ and Σ₋ᵢ
//!   the solution without it, or |S_i|·W + k(P/(2nε))·σ₀ if that is smaller or the others cannot
//!   replace satellite i.
//!
//! The level is the largest of these, each with its part of the risk P. π, λ and ε are those of the
//! pseudoranges' likelihood; W is the largest error that multipath can cause. σ is the horizontal
//! ellipse's semi-major axis, or that of the height. k(p)σ is exceeded with probability p at most:
//! horizontally by the length of a bivariate normal vector, k = √(−2·ln p), which is exact for a
//! circle; vertically by a normal variable, of both signs, or of that of the wrong satellite.

use nalgebra::Vector3;

use crate::gnss::{LocalFrame, Protection};
use crate::positioning::Measurement;
use crate::positioning::integrity::{bivariate_normal, major_m2, normal_one_sided};
use crate::positioning::pseudorange_error::{FAULT_SHARE, WILD_M, extra_path_m};
use crate::positioning::receiver::reflected_before_learning;

use super::exclusion::REDUNDANCY_MIN;
use super::{Fit, SinglePoint};

/// Least λ here (m), the width of a street: a level is a bound, and one epoch does not show how
/// high the surrounding walls are.
const STREET_M: f64 = 40.0;

/// Influence of a row on the position.
#[derive(Clone, Copy, Debug)]
pub(super) struct Influence {
    /// S_i, local.
    gain: Vector3<f64>,
    /// Residual after the fit (m).
    residual_m: f64,
    /// Fraction of an error that stays in the residual.
    redundancy: f64,
    /// 1/w (m²).
    variance_m2: f64,
}

/// The elements of a local covariance that the levels depend on (m²).
#[derive(Clone, Copy)]
struct Spread {
    east: f64,
    north: f64,
    cross: f64,
    up: f64,
}

impl Spread {
    /// The covariance plus that of an error of variance `variance_m2` along `direction`.
    fn with(self, direction: &Vector3<f64>, variance_m2: f64) -> Self {
        Self {
            east: self.east + direction.x * direction.x * variance_m2,
            north: self.north + direction.y * direction.y * variance_m2,
            cross: self.cross + direction.x * direction.y * variance_m2,
            up: self.up + direction.z * direction.z * variance_m2,
        }
    }

    /// Standard deviations: the largest horizontal one, and the vertical one (m).
    fn deviations_m(&self) -> (f64, f64) {
        (major_m2(self.east, self.north, self.cross).sqrt(), self.up.sqrt())
    }
}

impl SinglePoint {
    /// Protection levels of a fit for the probability `risk`; `frame` is that of the position.
    pub(super) fn protection(
        &mut self,
        frame: &LocalFrame,
        fit: &Fit,
        risk: f64,
    ) -> Option<Protection> {
        let stated = self.influences(frame, fit);
        let (spread, count) = (self.spread(stated), self.influences.len() as f64);
        let fault_risk = risk / (2.0 * count * FAULT_SHARE);
        let across_fault = bivariate_normal(fault_risk.min(1.0));
        let up_fault = normal_one_sided(fault_risk.min(0.5));
        let (across_m, up_m) = spread.deviations_m();
        let mut levels = Protection {
            horizontal_m: bivariate_normal(0.5 * risk) * across_m,
            vertical_m: normal_one_sided(0.25 * risk) * up_m,
        };
        for influence in &self.influences {
            let Influence { gain, residual_m, redundancy, variance_m2 } = influence;
            let reach_m = gain.xy().norm();
            let of_error = |error_m: f64, (across_m, up_m): (f64, f64)| {
                let horizontal_m = reach_m * error_m + across_fault * across_m;
                (horizontal_m, gain.z.abs() * error_m + up_fault * up_m)
            };
            let mut bound = of_error(WILD_M, (across_m, up_m));
            if REDUNDANCY_MIN < *redundancy {
                let shift = (residual_m / redundancy).abs();
                let without = spread.with(gain, variance_m2 / redundancy);
                let replaced = of_error(shift, without.deviations_m());
                bound = (bound.0.min(replaced.0), bound.1.min(replaced.1));
            }
            levels.horizontal_m = levels.horizontal_m.max(bound.0);
            levels.vertical_m = levels.vertical_m.max(bound.1);
        }
        (levels.horizontal_m.is_finite() && levels.vertical_m.is_finite()).then_some(levels)
    }

    /// Collects the influences of the rows in use; returns the formal covariance, local.
    fn influences(&mut self, frame: &LocalFrame, fit: &Fit) -> Spread {
        self.influences.clear();
        for row in self.rows.iter().filter(|row| row.is_used) {
            self.influences.push(Influence {
                gain: frame.rotation * fit.step.gain(row),
                residual_m: fit.step.residual_after_m(row),
                redundancy: fit.step.redundancy(row),
                variance_m2: row.weight.recip(),
            });
        }
        let enu = frame.covariance_to_enu(&fit.step.covariance) * fit.variance_factor;
        Spread { east: enu[(0, 0)], north: enu[(1, 1)], cross: enu[(0, 1)], up: enu[(2, 2)] }
    }

    /// Σ₀ from the formal covariance.
    fn spread(&self, stated: Spread) -> Spread {
        let used = self.rows.iter().filter(|row| row.is_used);
        let late_m2 = |index: usize| {
            let Measurement { cn0_db_hz, look, .. } = &self.measurements.list[index];
            let path_m = extra_path_m(look.elevation_rad.sin()).max(STREET_M);
            2.0 * path_m * path_m * reflected_before_learning(*cn0_db_hz)
        };
        let zero = Spread { east: 0.0, north: 0.0, cross: 0.0, up: 0.0 };
        let (mut reflections, mut late, mut squares, mut expected) = (zero, 0.0, 0.0, 0.0);
        for (row, influence) in used.zip(&self.influences) {
            let late_m2 = late_m2(row.index);
            reflections = reflections.with(&influence.gain, late_m2);
            late += late_m2;
            squares += influence.residual_m * influence.residual_m;
            expected += (influence.variance_m2 + late_m2) * influence.redundancy;
        }
        // Residuals larger than C/N0 predicts raise the factor. Smaller ones do not lower it, since
        // reflections may agree. One pseudorange of the expected variance is added as a prior.
        let one = late / self.influences.len() as f64;
        let shown = ((squares + one) / (expected + one)).max(1.0);
        Spread {
            east: stated.east + reflections.east * shown,
            north: stated.north + reflections.north * shown,
            cross: stated.cross + reflections.cross * shown,
            up: stated.up + reflections.up * shown,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without C/N0 as at 38 dB-Hz: 1/(1 + exp(6/4.81)) = 0.2232; half at 32 dB-Hz.
    #[test]
    fn the_probability_of_a_reflection_worked_by_hand() {
        assert!(
            (reflected_before_learning(None) - 0.223_2).abs() < 1e-4,
            "{}",
            reflected_before_learning(None)
        );
        assert!((reflected_before_learning(Some(32.0)) - 0.5).abs() < 1e-12);
    }
}
