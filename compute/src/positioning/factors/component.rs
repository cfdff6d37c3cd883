//! The prior of one component of a state.

use nalgebra::SVector;

use crate::graph::{Estimate, Kernel, Row, System};
use crate::snapshot::snapshot_fields;

/// Component factor on one state.
///
/// r = (xᵢ − m) / σ
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ComponentFactor {
    /// i.
    pub(crate) column: usize,
    /// m, in the column's unit.
    pub(crate) mean: f64,
    /// 1/σ.
    pub(crate) inverse_sigma: f64,
}

impl ComponentFactor {
    /// Whitened residual and its Jacobian on xᵢ.
    #[inline]
    pub(crate) fn linearize<const S: usize>(&self, state: &SVector<f64, S>) -> Row<1> {
        Row {
            residual: (state[self.column] - self.mean) * self.inverse_sigma,
            columns: [self.column],
            jacobian: [self.inverse_sigma],
        }
    }

    /// Adds its row on state `k` of an estimate.
    pub(crate) fn add_to<const S: usize>(
        &self,
        k: usize,
        estimate: &Estimate<S>,
        system: &mut System<S>,
    ) {
        system.add(k, &self.linearize(&estimate.states[k]), &Kernel::QUADRATIC);
    }
}

snapshot_fields!(ComponentFactor { column, mean, inverse_sigma });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{check_row, state};

    /// Upward 0.2 m/s, expected none, over 0.5 m/s.
    #[test]
    fn worked_by_hand_with_its_derivative() {
        let factor = ComponentFactor { column: 5, mean: 0.0, inverse_sigma: 2.0 };
        assert!((factor.linearize(&state()).residual - 0.4).abs() < 1e-12);
        check_row(&state(), |state| factor.linearize(state));
    }
}
