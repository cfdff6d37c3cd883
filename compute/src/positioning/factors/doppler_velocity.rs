//! The Doppler-velocity factor of Wen & Hsu (2021).

use nalgebra::{SVector, Vector3};

use crate::graph::{Estimate, Kernel, Link, System};
use crate::snapshot::snapshot_fields;

/// Kernel on the norm of the three rows (GraphGNSSLib).
const KERNEL: Kernel = Kernel::huber(1.0);

/// Doppler-velocity factor between two states, one row per axis.
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
    fn linearize<const S: usize>(
        &self,
        axis: usize,
        state: &SVector<f64, S>,
        next: &SVector<f64, S>,
    ) -> Link<1, 1> {
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

    /// Adds its rows between states `k` and `k + 1` of an estimate, whose first three numbers are
    /// the position.
    pub(crate) fn add_to<const S: usize>(
        &self,
        k: usize,
        estimate: &Estimate<S>,
        system: &mut System<S>,
    ) {
        let (state, next) = (&estimate.states[k], &estimate.states[k + 1]);
        let links = [0, 1, 2].map(|axis| self.linearize(axis, state, next));
        let norm = links.iter().map(|link| link.residual * link.residual).sum::<f64>().sqrt();
        let weight = system.weigh(norm, &KERNEL);
        links.iter().for_each(|link| system.add_link_weighted(k, link, weight));
    }
}

snapshot_fields!(DopplerVelocityFactor { velocity_m_s, interval_s, inverse_sigma });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::BorderLife;
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

    /// East 3 m in 2 s against 1 m/s over 0.5 m/s: 1; its derivative −1 and 1.
    #[test]
    fn a_tie_worked_by_hand() {
        let factor = DopplerVelocityFactor {
            velocity_m_s: Vector3::x(),
            interval_s: 2.0,
            inverse_sigma: 2.0,
        };
        let mut estimate = Estimate::<3>::new();
        estimate.states = vec![Vector3::zeros(), Vector3::new(3.0, 0.0, 0.0)];
        let mut system = System::new(BorderLife::WholeChain);
        system.reset(2, 0);
        factor.add_to(0, &estimate, &mut system);
        assert!((system.cost() - 0.5).abs() < 1e-12, "{}", system.cost());
        assert_eq!(system.diagonal[0][(0, 0)], 1.0);
        assert_eq!(system.coupling[0][(0, 0)], -1.0);
        assert_eq!(system.gradient[1][0], 1.0);
    }
}
