//! The motion factor: velocity moves the position and wanders.

use nalgebra::SVector;

use crate::config::GraphOptions;
use crate::graph::Link;
use crate::snapshot::snapshot_fields;

use super::VELOCITY;

/// Deviation of the trapezoid beside what acceleration explains (m/√s).
const LINK_WALK_M: f64 = 0.02;

/// How far the velocity wanders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::positioning) struct MotionWalk {
    /// East, north, up (m/s/√s).
    pub(in crate::positioning) velocity_m_s: [f64; 3],
}

impl MotionWalk {
    /// The walks that options ask for.
    pub(in crate::positioning) fn of(options: &GraphOptions) -> Self {
        let horizontal = options.horizontal_walk_m_s;
        Self { velocity_m_s: [horizontal, horizontal, options.vertical_walk_m_s] }
    }

    /// σ₁² of an axis (m²).
    pub(in crate::positioning) fn link_m2(&self, axis: usize, interval_s: f64) -> f64 {
        let q = self.velocity_m_s[axis];
        q * q * interval_s.powi(3) / 12.0 + LINK_WALK_M.powi(2) * interval_s
    }

    /// σ₂² of an axis (m²/s²).
    pub(in crate::positioning) fn pace_m2_s2(&self, axis: usize, interval_s: f64) -> f64 {
        self.velocity_m_s[axis].powi(2) * interval_s
    }
}

/// Motion factor between two states, two rows an axis.
///
/// r₁ = (p₊ − p − Δt·(v + v₊)/2) / σ₁, σ₁² = q²Δt³/12 + (0.02 m)²·Δt
/// r₂ = (v₊ − v) / σ₂, σ₂² = q²Δt
///
/// for an acceleration that is white noise of density q² (q in m/s/√s): q²Δt³/12 is what is left of
/// the position's variance once both velocities are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::positioning) struct MotionFactor {
    interval_s: f64,
    inverse_place: [f64; 3],
    inverse_pace: [f64; 3],
}

impl MotionFactor {
    /// Over an interval (s).
    pub(in crate::positioning) fn new(walk: &MotionWalk, interval_s: f64) -> Self {
        let inverse_place = |axis| walk.link_m2(axis, interval_s).sqrt().recip();
        Self {
            interval_s,
            inverse_place: [0, 1, 2].map(inverse_place),
            inverse_pace: walk.velocity_m_s.map(|q| (q * interval_s.sqrt()).recip()),
        }
    }

    /// The interval (s).
    pub(in crate::positioning) const fn interval_s(&self) -> f64 {
        self.interval_s
    }

    /// r₁ of one axis and its Jacobian on that axis of [p; v] and [p₊; v₊].
    #[inline]
    pub(in crate::positioning) fn place<const S: usize>(
        &self,
        axis: usize,
        state: &SVector<f64, S>,
        next: &SVector<f64, S>,
    ) -> Link<2, 2> {
        let (w, half) = (self.inverse_place[axis], 0.5 * self.interval_s);
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
    pub(in crate::positioning) fn pace<const S: usize>(
        &self,
        axis: usize,
        state: &SVector<f64, S>,
        next: &SVector<f64, S>,
    ) -> Link<1, 1> {
        let (w, rate) = (self.inverse_pace[axis], VELOCITY + axis);
        Link {
            residual: (next[rate] - state[rate]) * w,
            columns: [rate],
            jacobian: [-w],
            next_columns: [rate],
            next_jacobian: [w],
        }
    }
}

snapshot_fields!(MotionFactor { interval_s, inverse_place, inverse_pace });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{check_link, next_state, state};

    const WALK: MotionWalk = MotionWalk { velocity_m_s: [1.5, 1.5, 0.3] };

    /// East: 8.5 − (8 + 8.4)/2 = 0.3 m over √(1.5²/12 + 0.02²) m; 0.4 m/s over 1.5 m/s.
    #[test]
    fn residuals_worked_by_hand() {
        let factor = MotionFactor::new(&WALK, 1.0);
        let place = factor.place(0, &state(), &next_state()).residual;
        assert!((place - 0.3 / 0.187_9_f64.sqrt()).abs() < 1e-9, "{place}");
        let pace = factor.pace(0, &state(), &next_state()).residual;
        assert!((pace - 0.4 / 1.5).abs() < 1e-12, "{pace}");
    }

    #[test]
    fn the_jacobians_are_the_derivatives() {
        let factor = MotionFactor::new(&WALK, 2.0);
        for axis in 0..3 {
            check_link(|a, b| factor.place(axis, a, b));
            check_link(|a, b| factor.pace(axis, a, b));
        }
    }
}
