//! One step of weighted least squares on position and one clock per constellation.
//!
//! Rows r_i = g_iᵀδp + δb_c(i) with weight w_i. Each clock appears only in the rows of its own
//! constellation, so subtracting each constellation's weighted mean reduces the normal equations to
//! three unknowns:
//!
//! N = Σ w_i (g_i − ḡ_c)(g_i − ḡ_c)ᵀ, 3×3, ḡ_c = Σ w g / Σ w over constellation c.
//!
//! The means are taken before the products (not N − Σ b bᵀ/n), which keeps all digits.

use nalgebra::{Matrix3, Vector3};

use crate::gnss::Constellation;

/// A linearised measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Row {
    /// Index of its measurement in the epoch's list.
    pub(crate) index: usize,
    /// Constellation, which determines the clock.
    pub(crate) constellation: Constellation,
    /// Gradient ∂ρ/∂p, ECEF.
    pub(crate) gradient: Vector3<f64>,
    /// Model − measured (m).
    pub(crate) residual_m: f64,
    /// Weight 1/σ² (1/m²).
    pub(crate) weight: f64,
    /// Whether the row is used.
    pub(crate) is_used: bool,
}

/// The weighted mean of one constellation's rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ConstellationMean {
    /// Number of rows in use.
    pub(crate) count: usize,
    /// Sum of weights Σ w (1/m²).
    pub(crate) weight: f64,
    /// Weighted mean of the gradients, ḡ.
    pub(crate) gradient: Vector3<f64>,
    /// Weighted mean of the residuals (m).
    pub(crate) residual_m: f64,
}

/// The solution of the normal equations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Step {
    /// Step δp, ECEF (m).
    pub(crate) position_m: Vector3<f64>,
    /// N⁻¹: covariance of the position from the rows' variances, ECEF, 3×3 (m²).
    pub(crate) covariance: Matrix3<f64>,
    /// Means by constellation; those without rows have count 0.
    pub(crate) means: [ConstellationMean; Constellation::COUNT],
}

impl Step {
    /// Solves the rows in use; `None` if they do not determine a position.
    pub(crate) fn solve(rows: &[Row]) -> Option<Self> {
        let means = means(rows);
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for row in rows.iter().filter(|row| row.is_used) {
            let mean = &means[row.constellation.index()];
            let gradient = row.gradient - mean.gradient;
            let weighted = gradient * row.weight;
            normal += weighted * gradient.transpose();
            right -= weighted * (row.residual_m - mean.residual_m);
        }
        let covariance = invert_positive(&normal)?;
        Some(Self { position_m: covariance * right, covariance, means })
    }

    /// Step δb of a constellation's clock (m); undefined without rows.
    pub(crate) fn clock_m(&self, constellation: Constellation) -> f64 {
        let mean = &self.means[constellation.index()];
        -(mean.residual_m + mean.gradient.dot(&self.position_m))
    }

    /// Residual of a row after the step (m), to first order.
    pub(crate) fn residual_after_m(&self, row: &Row) -> f64 {
        row.residual_m + row.gradient.dot(&self.position_m) + self.clock_m(row.constellation)
    }

    /// Sum of squared whitened residuals after the step.
    pub(crate) fn squares(&self, rows: &[Row]) -> f64 {
        let used = rows.iter().filter(|row| row.is_used);
        used.map(|row| row.weight * self.residual_after_m(row).powi(2)).sum()
    }

    /// Variance of the fitted value of a row in use, aᵀQa (m²).
    pub(crate) fn variance_of(&self, row: &Row) -> f64 {
        let mean = &self.means[row.constellation.index()];
        let gradient = row.gradient - mean.gradient;
        gradient.dot(&(self.covariance * gradient)) + mean.weight.recip()
    }

    /// Numbers of rows in use and of their constellations.
    pub(crate) fn counts(&self) -> (usize, usize) {
        let rows = self.means.iter().map(|mean| mean.count).sum();
        (rows, self.means.iter().filter(|mean| 0 < mean.count).count())
    }
}

fn means(rows: &[Row]) -> [ConstellationMean; Constellation::COUNT] {
    let zero =
        ConstellationMean { count: 0, weight: 0.0, gradient: Vector3::zeros(), residual_m: 0.0 };
    let mut means = [zero; Constellation::COUNT];
    for row in rows.iter().filter(|row| row.is_used) {
        let mean = &mut means[row.constellation.index()];
        mean.count += 1;
        mean.weight += row.weight;
        mean.gradient += row.gradient * row.weight;
        mean.residual_m += row.residual_m * row.weight;
    }
    for mean in means.iter_mut().filter(|mean| 0 < mean.count) {
        mean.gradient /= mean.weight;
        mean.residual_m /= mean.weight;
    }
    means
}

/// Smallest ratio of det N to (tr N/3)³ at which a geometry determines a position. Below it
/// satellites are closer than some 10⁻⁴ rad, and rounding decides.
const DETERMINANT_RATIO_MIN: f64 = 1e-12;

/// Inverse of a symmetric, positive definite matrix; `None` if it is numerically singular.
fn invert_positive(normal: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let scale = normal.trace() / 3.0;
    let is_regular = DETERMINANT_RATIO_MIN * scale.powi(3) < normal.determinant();
    if is_regular { normal.try_inverse() } else { None }
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;

    use super::*;

    fn row(constellation: Constellation, gradient: [f64; 3], residual_m: f64, weight: f64) -> Row {
        let gradient = Vector3::from(gradient).normalize();
        Row { index: 0, constellation, gradient, residual_m, weight, is_used: true }
    }

    fn rows() -> Vec<Row> {
        use Constellation::{BeiDou, Gps};
        vec![
            row(Gps, [1.0, 0.2, -0.3], 3.0, 1.0),
            row(Gps, [-0.5, 1.0, 0.4], -1.0, 0.25),
            row(Gps, [0.1, -0.9, 0.8], 0.5, 2.0),
            row(Gps, [0.3, 0.3, -1.0], 2.5, 1.5),
            row(BeiDou, [-1.0, -0.4, 0.2], 12.0, 0.5),
            row(BeiDou, [0.4, 0.7, 0.9], 9.0, 1.0),
            row(BeiDou, [0.4, -0.7, -0.9], 10.0, 0.1),
        ]
    }

    /// The reduced equations against the full normal equations of five unknowns.
    #[test]
    fn reduced_and_full_normal_equations_agree() {
        let rows = rows();
        let (mut normal, mut right) =
            (SMatrix::<f64, 5, 5>::zeros(), SMatrix::<f64, 5, 1>::zeros());
        let design = |row: &Row| {
            let clock = usize::from(row.constellation == Constellation::BeiDou);
            let mut a = SMatrix::<f64, 5, 1>::zeros();
            a.fixed_rows_mut::<3>(0).copy_from(&row.gradient);
            a[3 + clock] = 1.0;
            a
        };
        for row in &rows {
            let a = design(row);
            normal += a * a.transpose() * row.weight;
            right -= a * row.weight * row.residual_m;
        }
        let inverse = normal.try_inverse().unwrap();
        let full = inverse * right;
        let step = Step::solve(&rows).unwrap();
        assert!((step.position_m - full.fixed_rows::<3>(0)).norm() < 1e-12);
        assert!((step.clock_m(Constellation::Gps) - full[3]).abs() < 1e-12);
        assert!((step.clock_m(Constellation::BeiDou) - full[4]).abs() < 1e-12);
        assert!((step.covariance - inverse.fixed_view::<3, 3>(0, 0)).norm() < 1e-12);
        for row in &rows {
            let a = design(row);
            assert!((step.variance_of(row) - (a.transpose() * inverse * a).x).abs() < 1e-12);
        }
        assert_eq!(step.counts(), (7, 2));
    }

    #[test]
    fn satellites_in_one_direction_determine_nothing() {
        let same = [row(Constellation::Gps, [0.0, 0.6, 0.8], 1.0, 1.0); 6];
        assert_eq!(Step::solve(&same), None);
    }

    /// Removing a row lowers the sum of squares by w·r²/(1 − w·aᵀQa).
    #[test]
    fn the_gain_of_an_exclusion_is_what_the_formula_says() {
        let mut rows = rows();
        let all = Step::solve(&rows).unwrap();
        let before = all.squares(&rows);
        let out = rows[1];
        let gain = out.weight * all.residual_after_m(&out).powi(2)
            / (1.0 - out.weight * all.variance_of(&out));
        rows[1].is_used = false;
        let after = Step::solve(&rows).unwrap().squares(&rows);
        assert!((before - after - gain).abs() < 1e-9);
    }
}
