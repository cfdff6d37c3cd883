//! One step of weighted least squares on position and one clock per constellation.
//!
//! Rows r_i = g_iᵀδp + δb_c(i) with weight w_i. Each clock appears only in the rows of its own
//! constellation, so subtracting each constellation's weighted mean reduces the normal equations to
//! three unknowns:
//!
//! N = Σ w_i (g_i − ḡ_c)(g_i − ḡ_c)ᵀ, 3×3, ḡ_c = Σ w g / Σ w over constellation c.
//!
//! The means are subtracted before the products are formed (not N − Σ b bᵀ/n), to keep all digits.
//!
//! Clocks may be tied to each other: δb_c = δB + η_c with η_c of a known variance p_c. Then
//!
//! N = Σ w a aᵀ − Σ_c s_c s_cᵀ/(Σ w + 1/p_c), a = (g; 1), s_c = Σ w a over constellation c, 4×4,
//!
//! from which δB is eliminated in turn. With p_c → ∞ these are the equations above.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

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

/// A constellation's clock by one epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Clock {
    pub(crate) constellation: Constellation,
    /// Clock (m).
    pub(crate) value_m: f64,
    /// Variance (m²).
    pub(crate) variance_m2: f64,
    /// Whether it is determined by one satellite only, without redundancy.
    pub(crate) is_alone: bool,
}

/// Prior of a constellation's clock: the common clock plus a bias.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClockPrior {
    /// o_c (m).
    pub(crate) bias_m: f64,
    /// p_c (m²).
    pub(crate) variance_m2: f64,
    /// Whether the bias was estimated in earlier epochs.
    pub(crate) is_known: bool,
}

/// Contribution of priors to a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PriorPart {
    /// Fraction of each clock that its own rows determine.
    own: [f64; Constellation::COUNT],
    /// Sum of the designs with the common clock, and its information.
    cross: Vector3<f64>,
    common: f64,
    /// Squares of their residuals over their variances.
    squares: f64,
    /// Number of differences of clocks known from earlier epochs.
    known: usize,
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
    /// Steps δb of the clocks by constellation (m).
    clocks_m: [f64; Constellation::COUNT],
    /// Contribution of the priors, if clocks are tied.
    tied: Option<PriorPart>,
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
        let position_m = covariance * right;
        let clocks_m = means.map(|mean| -(mean.residual_m + mean.gradient.dot(&position_m)));
        Some(Self { position_m, covariance, means, clocks_m, tied: None })
    }

    /// Solves the rows in use with tied clocks; `None` if they do not determine a position.
    pub(crate) fn solve_with_priors(
        rows: &[Row],
        priors: &[ClockPrior; Constellation::COUNT],
    ) -> Option<Self> {
        let means = means(rows);
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for row in rows.iter().filter(|row| row.is_used) {
            let design = row.gradient.push(1.0);
            let residual_m = row.residual_m + priors[row.constellation.index()].bias_m;
            normal += design * design.transpose() * row.weight;
            right -= design * (row.weight * residual_m);
        }
        for (mean, prior) in present(&means, priors) {
            let total = mean.weight + prior.variance_m2.recip();
            let sum = mean.gradient.push(1.0) * mean.weight;
            normal -= sum * sum.transpose() / total;
            right += sum * (mean.weight * (mean.residual_m + prior.bias_m) / total);
        }
        let (cross, common) = (normal.fixed_view::<3, 1>(0, 3).into_owned(), normal[(3, 3)]);
        let reduced = normal.fixed_view::<3, 3>(0, 0) - cross * cross.transpose() / common;
        let covariance = invert_positive(&reduced)?;
        let position_m = covariance * (right.xyz() - cross * (right.w / common));
        let common_m = (right.w - cross.dot(&position_m)) / common;
        let mut clocks_m = [0.0; Constellation::COUNT];
        let (mut squares, mut own) = (0.0, [0.0; Constellation::COUNT]);
        for (index, (mean, prior)) in means.iter().zip(priors).enumerate() {
            if mean.count == 0 {
                continue;
            }
            let known_m = common_m + prior.bias_m;
            let alone_m = -(mean.residual_m + mean.gradient.dot(&position_m));
            let information = prior.variance_m2.recip();
            own[index] = mean.weight / (mean.weight + information);
            clocks_m[index] = own[index] * alone_m + (1.0 - own[index]) * known_m;
            squares += information * (clocks_m[index] - known_m).powi(2);
        }
        let known = present(&means, priors).filter(|(_, prior)| prior.is_known).count();
        let tied = PriorPart { own, cross, common, squares, known: known.saturating_sub(1) };
        Some(Self { position_m, covariance, means, clocks_m, tied: Some(tied) })
    }

    /// Step δb of a constellation's clock (m); undefined without rows.
    pub(crate) fn clock_m(&self, constellation: Constellation) -> f64 {
        self.clocks_m[constellation.index()]
    }

    /// Whether a constellation has rows in use.
    pub(crate) fn has_clock(&self, constellation: Constellation) -> bool {
        0 < self.means[constellation.index()].count
    }

    /// Variance of a clock that its own rows determine (m²).
    pub(crate) fn clock_variance_m2(&self, constellation: Constellation) -> f64 {
        let mean = &self.means[constellation.index()];
        mean.weight.recip() + mean.gradient.dot(&(self.covariance * mean.gradient))
    }

    /// All clocks with their variances, also of satellites alone in their constellation, by
    /// constellation.
    pub(crate) fn clocks(&self, rows: &[Row]) -> Vec<Clock> {
        let used = Constellation::ALL.into_iter().filter(|c| self.has_clock(*c)).map(|c| Clock {
            constellation: c,
            value_m: self.clock_m(c),
            variance_m2: self.clock_variance_m2(c),
            is_alone: false,
        });
        let alone = rows.iter().filter(|row| !row.is_used).map(|row| Clock {
            constellation: row.constellation,
            value_m: -(row.residual_m + row.gradient.dot(&self.position_m)),
            variance_m2: row.weight.recip() + row.gradient.dot(&(self.covariance * row.gradient)),
            is_alone: true,
        });
        let mut clocks: Vec<Clock> = used.chain(alone).collect();
        clocks.sort_by_key(|clock| clock.constellation.index());
        clocks
    }

    /// Number of measurements minus number of unknowns.
    pub(crate) fn degrees(&self) -> usize {
        let (rows, clocks) = self.counts();
        let known = self.tied.map_or(0, |tied| tied.known);
        (rows + known).saturating_sub(3 + clocks)
    }

    /// Whether the clocks are tied to each other.
    pub(crate) fn is_tied(&self) -> bool {
        self.tied.is_some()
    }

    /// Residual of a row after the step (m), to first order.
    pub(crate) fn residual_after_m(&self, row: &Row) -> f64 {
        row.residual_m + row.gradient.dot(&self.position_m) + self.clock_m(row.constellation)
    }

    /// Sum of squared whitened residuals after the step.
    pub(crate) fn squares(&self, rows: &[Row]) -> f64 {
        let used = rows.iter().filter(|row| row.is_used);
        let squares: f64 = used.map(|row| row.weight * self.residual_after_m(row).powi(2)).sum();
        squares + self.tied.map_or(0.0, |tied| tied.squares)
    }

    /// Change of the position per error of a row in use, −∂δp/∂r.
    pub(crate) fn gain(&self, row: &Row) -> Vector3<f64> {
        let mean = self.means[row.constellation.index()].gradient;
        let offset = match &self.tied {
            None => mean,
            Some(tied) => {
                let own = tied.own[row.constellation.index()];
                mean * own + tied.cross * ((1.0 - own) / tied.common)
            }
        };
        self.covariance * (row.gradient - offset) * row.weight
    }

    /// Fraction of a row's error that stays in its residual, 1 − w·aᵀQa.
    pub(crate) fn redundancy(&self, row: &Row) -> f64 {
        let Some(tied) = &self.tied else { return 1.0 - row.weight * self.variance_of(row) };
        let index = row.constellation.index();
        let (own, mean) = (tied.own[index], &self.means[index]);
        let gain = self.gain(row);
        // Changes of the clocks per error of the row.
        let common = (row.weight * (1.0 - own) - tied.cross.dot(&gain)) / tied.common;
        let alone = row.weight / mean.weight - mean.gradient.dot(&gain);
        1.0 - row.gradient.dot(&gain) - own * alone - (1.0 - own) * common
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

/// The means that have rows, with their priors.
fn present<'a>(
    means: &'a [ConstellationMean],
    priors: &'a [ClockPrior],
) -> impl Iterator<Item = (&'a ConstellationMean, &'a ClockPrior)> {
    means.iter().zip(priors).filter(|(mean, _)| 0 < mean.count)
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

/// Smallest ratio of det N to (tr N/3)³ for which a geometry determines a position. Below it the
/// lines of sight differ by less than some 10⁻⁴ rad, and rounding errors dominate.
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

    /// Clocks with priors against the full equations of position, common clock and two biases.
    #[test]
    fn tied_clocks_agree_with_the_full_normal_equations() {
        let rows = rows();
        let mut priors =
            [ClockPrior { bias_m: 0.0, variance_m2: 1e6, is_known: false }; Constellation::COUNT];
        priors[Constellation::Gps.index()] =
            ClockPrior { bias_m: 0.0, variance_m2: 0.5, is_known: true };
        priors[Constellation::BeiDou.index()] =
            ClockPrior { bias_m: -8.0, variance_m2: 4.0, is_known: true };
        let (mut normal, mut right) =
            (SMatrix::<f64, 6, 6>::zeros(), SMatrix::<f64, 6, 1>::zeros());
        for (at, prior) in [(4, Constellation::Gps), (5, Constellation::BeiDou)] {
            normal[(at, at)] += priors[prior.index()].variance_m2.recip();
        }
        for row in &rows {
            let mut a = SMatrix::<f64, 6, 1>::zeros();
            a.fixed_rows_mut::<3>(0).copy_from(&row.gradient);
            a[3] = 1.0;
            a[4 + usize::from(row.constellation == Constellation::BeiDou)] = 1.0;
            let residual_m = row.residual_m + priors[row.constellation.index()].bias_m;
            normal += a * a.transpose() * row.weight;
            right -= a * row.weight * residual_m;
        }
        let inverse = normal.try_inverse().unwrap();
        let full = inverse * right;
        let step = Step::solve_with_priors(&rows, &priors).unwrap();
        assert!((step.position_m - full.fixed_rows::<3>(0)).norm() < 1e-9);
        assert!((step.covariance - inverse.fixed_view::<3, 3>(0, 0)).norm() < 1e-9);
        assert!((step.clock_m(Constellation::Gps) - full[3] - full[4]).abs() < 1e-9);
        assert!((step.clock_m(Constellation::BeiDou) - full[3] - full[5] + 8.0).abs() < 1e-9);
        assert_eq!(step.degrees(), 3);
        let own = rows.iter().map(|row| row.weight * step.residual_after_m(row).powi(2));
        let squares = own.sum::<f64>() + full[4].powi(2) / 0.5 + full[5].powi(2) / 4.0;
        assert!((step.squares(&rows) - squares).abs() < 1e-9);
    }

    /// Gain and redundancy are the effects of a changed residual, with free and tied clocks.
    #[test]
    fn gain_and_redundancy_are_derivatives() {
        let rows = rows();
        let mut priors =
            [ClockPrior { bias_m: 3.0, variance_m2: 2.0, is_known: true }; Constellation::COUNT];
        priors[Constellation::BeiDou.index()].variance_m2 = 0.3;
        for is_tied in [false, true] {
            let solve = |rows: &[Row]| match is_tied {
                true => Step::solve_with_priors(rows, &priors).unwrap(),
                false => Step::solve(rows).unwrap(),
            };
            let before = solve(&rows);
            for index in 0..rows.len() {
                let mut later = rows.clone();
                later[index].residual_m -= 1.0;
                let after = solve(&later);
                let moved_m = after.position_m - before.position_m;
                assert!((moved_m - before.gain(&rows[index])).norm() < 1e-9);
                let stays_m =
                    before.residual_after_m(&rows[index]) - after.residual_after_m(&later[index]);
                assert!((stays_m - before.redundancy(&rows[index])).abs() < 1e-9);
            }
        }
    }

    /// Ties of infinite variance change nothing.
    #[test]
    fn loose_ties_are_free_clocks() {
        let rows = rows();
        let loose = [ClockPrior { bias_m: 100.0, variance_m2: 1e12, is_known: false };
            Constellation::COUNT];
        let (free, tied) =
            (Step::solve(&rows).unwrap(), Step::solve_with_priors(&rows, &loose).unwrap());
        assert!((free.position_m - tied.position_m).norm() < 1e-6);
        assert!((free.covariance - tied.covariance).norm() < 1e-6);
        assert_eq!(free.degrees(), tied.degrees());
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
