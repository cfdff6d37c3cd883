//! The prior of an inter-system bias.

use crate::graph::Row;
use crate::snapshot::snapshot_fields;

/// Bias factor on one border variable.
///
/// r = (β − β₀) / σ, ∂r/∂β = 1/σ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BiasFactor {
    /// The border variable.
    pub(crate) variable: usize,
    /// β₀ (m).
    pub(crate) mean_m: f64,
    /// 1/σ (1/m).
    pub(crate) inverse_sigma: f64,
}

impl BiasFactor {
    /// Whitened residual, and its Jacobian on the bias.
    #[inline]
    pub(crate) fn linearize(&self, bias_m: f64) -> (Row<0>, f64) {
        let residual = (bias_m - self.mean_m) * self.inverse_sigma;
        (Row { residual, columns: [], jacobian: [] }, self.inverse_sigma)
    }
}

snapshot_fields!(BiasFactor { variable, mean_m, inverse_sigma });

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worked_by_hand_with_its_derivative() {
        let factor = BiasFactor { variable: 3, mean_m: 40.0, inverse_sigma: 0.1 };
        let (row, slope) = factor.linearize(45.0);
        assert!((row.residual - 0.5).abs() < 1e-12);
        let difference = factor.linearize(46.0).0.residual - factor.linearize(44.0).0.residual;
        assert!((difference / 2.0 - slope).abs() < 1e-12);
    }
}
