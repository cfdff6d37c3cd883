//! The clock factor: the clock follows its drift, and both have noise.

use crate::config::GraphOptions;
use crate::graph::Link;
use crate::snapshot::snapshot_fields;

use super::{CLOCK, DRIFT, State};

/// Random walks of the receiver's clock and drift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClockWalk {
    /// Of the clock (m/√s).
    pub(crate) clock_m: f64,
    /// Of the drift (m/s/√s).
    pub(crate) drift_m_s: f64,
}

impl ClockWalk {
    /// The random walks of the options.
    pub(crate) fn of(options: &GraphOptions) -> Self {
        Self { clock_m: options.clock_walk_m, drift_m_s: options.drift_walk_m_s }
    }

    /// σ₁² (m²).
    pub(crate) fn link_m2(&self, interval_s: f64) -> f64 {
        let (h, q) = (self.clock_m, self.drift_m_s);
        h * h * interval_s + q * q * interval_s.powi(3) / 12.0
    }

    /// σ₂² (m²/s²).
    pub(crate) fn drift_m2_s2(&self, interval_s: f64) -> f64 {
        self.drift_m_s.powi(2) * interval_s
    }
}

/// The step of one clock against another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClockStepPrior {
    /// Expected step (m).
    pub(crate) mean_m: f64,
    /// Squared scale of Student's t of three degrees of freedom (m²).
    pub(crate) scale_m2: f64,
}

snapshot_fields!(ClockStepPrior { mean_m, scale_m2 });

/// Clock factor between two states, two rows.
///
/// r₁ = (b₊ − b − J − Δt·(d + d₊)/2) / σ₁, σ₁² = h²Δt + q²Δt³/12
/// r₂ = (d₊ − d) / σ₂, σ₂² = q²Δt
///
/// J is a clock jump found in the pseudoranges, a whole number of milliseconds (m). If a jump is
/// not a whole number of milliseconds, σ₁ is infinite.
///
/// Source: the two-state clock of Brown & Hwang (1997), *Introduction to Random Signals and Applied
/// Kalman Filtering*, with the drift's contribution as in [`super::MotionFactor`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClockFactor {
    interval_s: f64,
    jump_m: f64,
    inverse_clock: f64,
    inverse_drift: f64,
}

impl ClockFactor {
    /// Over an interval (s), with the jump J (m), or `None` if the clock starts again.
    pub(crate) fn new(walk: &ClockWalk, interval_s: f64, jump_m: Option<f64>) -> Self {
        let inverse = |_| walk.link_m2(interval_s).sqrt().recip();
        Self {
            interval_s,
            jump_m: jump_m.unwrap_or(0.0),
            inverse_clock: jump_m.map_or(0.0, inverse),
            inverse_drift: (walk.drift_m_s * interval_s.sqrt()).recip(),
        }
    }

    /// The same if the code's clock moves against the integral of the drift: the expected step is
    /// added to J, and its squared scale to σ₁².
    pub(in crate::positioning) fn with_step_prior(self, prior: ClockStepPrior) -> Self {
        let variance_m2 = self.inverse_clock.powi(-2) + prior.scale_m2;
        Self {
            jump_m: self.jump_m + prior.mean_m,
            inverse_clock: variance_m2.sqrt().recip(),
            ..self
        }
    }

    /// r₁ and its Jacobian on [b; d] and [b₊; d₊].
    #[inline]
    pub(crate) fn clock_row(&self, state: &State, next: &State) -> Link<2, 2> {
        let (w, half) = (self.inverse_clock, 0.5 * self.interval_s);
        let moved = next[CLOCK] - state[CLOCK] - self.jump_m;
        Link {
            residual: (moved - half * (state[DRIFT] + next[DRIFT])) * w,
            columns: [CLOCK, DRIFT],
            jacobian: [-w, -half * w],
            next_columns: [CLOCK, DRIFT],
            next_jacobian: [w, -half * w],
        }
    }

    /// r₂ and its Jacobian on d and d₊.
    #[inline]
    pub(crate) fn drift_row(&self, state: &State, next: &State) -> Link<1, 1> {
        let w = self.inverse_drift;
        Link {
            residual: (next[DRIFT] - state[DRIFT]) * w,
            columns: [DRIFT],
            jacobian: [-w],
            next_columns: [DRIFT],
            next_jacobian: [w],
        }
    }
}

snapshot_fields!(ClockFactor { interval_s, jump_m, inverse_clock, inverse_drift });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{check_link, next_state, state};

    const WALK: ClockWalk = ClockWalk { clock_m: 0.3, drift_m_s: 0.6 };

    /// 12 − 5 − 11.75 = −4.75 m over √(0.3² + 0.6²/12) m; −0.5 m/s over 0.6 m/s.
    #[test]
    fn residuals_worked_by_hand() {
        let factor = ClockFactor::new(&WALK, 1.0, Some(5.0));
        let clock = factor.clock_row(&state(), &next_state()).residual;
        assert!((clock + 4.75 / 0.12_f64.sqrt()).abs() < 1e-9, "{clock}");
        let drift = factor.drift_row(&state(), &next_state()).residual;
        assert!((drift + 0.5 / 0.6).abs() < 1e-12, "{drift}");
        let restarted = ClockFactor::new(&WALK, 1.0, None);
        assert_eq!(restarted.clock_row(&state(), &next_state()).residual, 0.0);
    }

    /// σ₁² = 0.3² + 0.6²/12 + 4 m²; 12 − 5 − 11.75 − 30 m over its root.
    #[test]
    fn a_step_prior_moves_and_loosens_the_clock() {
        let factor = ClockFactor::new(&WALK, 1.0, Some(5.0));
        let tied = factor.with_step_prior(ClockStepPrior { mean_m: 30.0, scale_m2: 4.0 });
        let residual = tied.clock_row(&state(), &next_state()).residual;
        assert!((residual + 34.75 / 4.12_f64.sqrt()).abs() < 1e-9, "{residual}");
        let free = ClockFactor::new(&WALK, 1.0, None);
        let free = free.with_step_prior(ClockStepPrior { mean_m: 30.0, scale_m2: 4.0 });
        assert_eq!(free.clock_row(&state(), &next_state()).residual, 0.0);
    }

    #[test]
    fn the_jacobians_are_the_derivatives() {
        let factor = ClockFactor::new(&WALK, 2.0, Some(5.0));
        check_link(|a, b| factor.clock_row(a, b));
        check_link(|a, b| factor.drift_row(a, b));
    }
}
