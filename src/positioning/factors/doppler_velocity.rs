//! The Doppler-velocity factor of Wen & Hsu (2021).

use nalgebra::Vector3;

use crate::graph::Link;
use crate::snapshot::snapshot_fields;

use super::State;

/// Doppler-velocity factor between two states, one row an axis.
///
/// r = ((p₊ − p)/Δt − v) / σ
///
/// v is the velocity solved from the Doppler of the earlier epoch, local (m/s), and σ one fixed
/// deviation (m/s).
///
/// Source: Wen & Hsu (2021), equations (11) and (12).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DopplerVelocityFactor {
    /// v (m/s).
    pub(crate) velocity_m_s: Vector3<f64>,
    /// Δt (s).
    pub(crate) interval_s: f64,
    /// 1/σ (s/m).
    pub(crate) inverse_sigma: f64,
}

impl DopplerVelocityFactor {
    /// Whitened residual of one axis and its Jacobian on that axis of p and p₊.
    #[inline]
    pub(crate) fn linearize(&self, axis: usize, state: &State, next: &State) -> Link<1, 1> {
        let pace = self.inverse_sigma / self.interval_s;
        let moved = (next[axis] - state[axis]) * pace;
        Link {
            residual: moved - self.velocity_m_s[axis] * self.inverse_sigma,
            columns: [axis],
            jacobian: [-pace],
            next_columns: [axis],
            next_jacobian: [pace],
        }
    }
}

snapshot_fields!(DopplerVelocityFactor { velocity_m_s, interval_s, inverse_sigma });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{check_link, next_state, state};

    fn factor() -> DopplerVelocityFactor {
        let velocity_m_s = Vector3::new(4.0, -2.0, 0.5);
        DopplerVelocityFactor { velocity_m_s, interval_s: 2.0, inverse_sigma: 10.0 }
    }

    /// East 8.5 m in 2 s against 4 m/s, over 0.1 m/s: 2.5.
    #[test]
    fn a_residual_worked_by_hand() {
        assert!((factor().linearize(0, &state(), &next_state()).residual - 2.5).abs() < 1e-12);
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        (0..3).for_each(|axis| check_link(|a, b| factor().linearize(axis, a, b)));
    }
}
