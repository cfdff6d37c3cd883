//! The motion factor: the position follows the velocity, and both have noise.

use nalgebra::SVector;

use crate::config::GraphOptions;
use crate::graph::{Estimate, Kernel, Link, System};
use crate::snapshot::snapshot_fields;

use super::VELOCITY;

/// Standard deviation of the trapezoidal displacement beyond what acceleration explains (m/√s).
const LINK_WALK_M: f64 = 0.02;

/// Random walk of the velocity by axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MotionWalk {
    /// East, north, up (m/s/√s).
    pub(crate) velocity_m_s: [f64; 3],
}

impl MotionWalk {
    /// The random walks of the options.
    pub(crate) fn of(options: &GraphOptions) -> Self {
        let horizontal = options.horizontal_walk_m_s;
        Self { velocity_m_s: [horizontal, horizontal, options.vertical_walk_m_s] }
    }

    /// σ₁² of an axis (m²).
    pub(crate) fn link_m2(&self, axis: usize, interval_s: f64) -> f64 {
        let q = self.velocity_m_s[axis];
        q * q * interval_s.powi(3) / 12.0 + LINK_WALK_M.powi(2) * interval_s
    }

    /// σ₂² of an axis (m²/s²).
    pub(crate) fn velocity_m2_s2(&self, axis: usize, interval_s: f64) -> f64 {
        self.velocity_m_s[axis].powi(2) * interval_s
    }
}

/// Motion factor between two states, two rows per axis.
///
/// r₁ = (p₊ − p − Δt·(v + v₊)/2) / σ₁, σ₁² = q²Δt³/12 + (0.02 m)²·Δt
/// r₂ = (v₊ − v) / σ₂, σ₂² = q²Δt
///
/// for an acceleration that is white noise of density q² (q in m/s/√s): q²Δt³/12 is the variance
/// of the position once both velocities are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MotionFactor {
    interval_s: f64,
    inverse_position: [f64; 3],
    inverse_velocity: [f64; 3],
}

impl MotionFactor {
    /// Over an interval (s).
    pub(crate) fn new(walk: &MotionWalk, interval_s: f64) -> Self {
        let inverse_position = |axis| walk.link_m2(axis, interval_s).sqrt().recip();
        Self {
            interval_s,
            inverse_position: [0, 1, 2].map(inverse_position),
            inverse_velocity: walk.velocity_m_s.map(|q| (q * interval_s.sqrt()).recip()),
        }
    }

    /// The interval (s).
    pub(crate) const fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// r₁ of one axis and its Jacobian on that axis of [p; v] and [p₊; v₊].
    #[inline]
    pub(crate) fn position_row<const S: usize>(
        &self,
        axis: usize,
        state: &SVector<f64, S>,
        next: &SVector<f64, S>,
    ) -> Link<2, 2> {
        let (w, half) = (self.inverse_position[axis], 0.5 * self.interval_s);
        let rate = VELOCITY + axis;
        let moved = next[axis] - state[axis] - half * (state[rate] + next[rate]);
        Link {
            residual: moved * w,
            columns: [axis, rate],
            jacobian: [-w, -half * w],
            next_columns: [axis, rate],
            next_jacobian: [w, -half * w],
        }
    }

    /// r₂ of one axis and its Jacobian on that axis of v and v₊.
    #[inline]
    pub(crate) fn velocity_row<const S: usize>(
        &self,
        axis: usize,
        state: &SVector<f64, S>,
        next: &SVector<f64, S>,
    ) -> Link<1, 1> {
        let (w, rate) = (self.inverse_velocity[axis], VELOCITY + axis);
        Link {
            residual: (next[rate] - state[rate]) * w,
            columns: [rate],
            jacobian: [-w],
            next_columns: [rate],
            next_jacobian: [w],
        }
    }
}

impl MotionFactor {
    /// Adds its rows between states `k` and `k + 1` of an estimate.
    pub(crate) fn add_to<const S: usize>(
        &self,
        k: usize,
        estimate: &Estimate<S>,
        system: &mut System<S>,
    ) {
        let (state, next) = (&estimate.states[k], &estimate.states[k + 1]);
        for axis in 0..3 {
            system.add_link(k, &self.position_row(axis, state, next), &Kernel::QUADRATIC);
            system.add_link(k, &self.velocity_row(axis, state, next), &Kernel::QUADRATIC);
        }
    }
}

snapshot_fields!(MotionFactor { interval_s, inverse_position, inverse_velocity });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{check_link, next_state, state};

    const WALK: MotionWalk = MotionWalk { velocity_m_s: [1.5, 1.5, 0.3] };

    /// East: 8.5 − (8 + 8.4)/2 = 0.3 m over √(1.5²/12 + 0.02²) m; 0.4 m/s over 1.5 m/s.
    #[test]
    fn residuals_worked_by_hand() {
        let factor = MotionFactor::new(&WALK, 1.0);
        let position = factor.position_row(0, &state(), &next_state()).residual;
        assert!((position - 0.3 / 0.187_9_f64.sqrt()).abs() < 1e-9, "{position}");
        let velocity = factor.velocity_row(0, &state(), &next_state()).residual;
        assert!((velocity - 0.4 / 1.5).abs() < 1e-12, "{velocity}");
    }

    #[test]
    fn the_jacobians_are_the_derivatives() {
        let factor = MotionFactor::new(&WALK, 2.0);
        for axis in 0..3 {
            check_link(|a, b| factor.position_row(axis, a, b));
            check_link(|a, b| factor.velocity_row(axis, a, b));
        }
    }
}
