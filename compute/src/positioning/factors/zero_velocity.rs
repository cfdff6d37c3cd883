//! The zero-velocity factor: a receiver at rest.

use crate::graph::{Link, Row};
use crate::snapshot::snapshot_fields;

use super::{State, VELOCITY};

/// Standard deviation of the velocity of a receiver at rest, per axis (m/s): engine, wind,
/// passengers.
const STANDING_M_S: f64 = 0.02;

/// Zero-velocity factor on two states between which the receiver was at rest, two rows per axis.
///
/// r₁ = (p₊ − p) / (σ·Δt), r₂ = v₊ / σ
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ZeroVelocityFactor {
    inverse_position: f64,
    inverse_velocity: f64,
}

impl ZeroVelocityFactor {
    /// Over an interval (s).
    pub(crate) fn new(interval_s: f64) -> Self {
        let inverse_velocity = STANDING_M_S.recip();
        Self { inverse_position: inverse_velocity / interval_s, inverse_velocity }
    }

    /// r₁ of one axis and its Jacobian on that axis of p and p₊.
    #[inline]
    pub(crate) fn position_row(&self, axis: usize, state: &State, next: &State) -> Link<1, 1> {
        let w = self.inverse_position;
        Link {
            residual: (next[axis] - state[axis]) * w,
            columns: [axis],
            jacobian: [-w],
            next_columns: [axis],
            next_jacobian: [w],
        }
    }

    /// r₂ of one axis and its Jacobian on that axis of v₊.
    #[inline]
    pub(crate) fn velocity_row(&self, axis: usize, next: &State) -> Row<1> {
        let rate = VELOCITY + axis;
        Row {
            residual: next[rate] * self.inverse_velocity,
            columns: [rate],
            jacobian: [self.inverse_velocity],
        }
    }
}

snapshot_fields!(ZeroVelocityFactor { inverse_position, inverse_velocity });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{check_link, check_row, next_state, state};

    /// North −3 m in 2 s over 0.02 m/s: −75; north −2.5 m/s over 0.02 m/s: −125.
    #[test]
    fn residuals_worked_by_hand() {
        let factor = ZeroVelocityFactor::new(2.0);
        let position = factor.position_row(1, &state(), &next_state()).residual;
        assert!((position + 75.0).abs() < 1e-9, "{position}");
        let velocity = factor.velocity_row(1, &next_state()).residual;
        assert!((velocity + 125.0).abs() < 1e-9, "{velocity}");
    }

    #[test]
    fn the_jacobians_are_the_derivatives() {
        let factor = ZeroVelocityFactor::new(2.0);
        for axis in 0..3 {
            check_link(|a, b| factor.position_row(axis, a, b));
            check_row(&next_state(), |next| factor.velocity_row(axis, next));
        }
    }
}
