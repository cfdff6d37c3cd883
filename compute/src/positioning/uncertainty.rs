//! The covariance of a position whose pseudorange errors are correlated.
//!
//! The estimators assume errors of pseudoranges that are independent from epoch to epoch and have
//! the variance of the error model. In truth multipath lasts for tens of seconds, and errors of
//! orbit, clock and atmosphere for hours; and the model's variances are upper bounds. With C the
//! estimator's covariance of the position, Λ the information of the epoch's own pseudoranges on it
//! (every clock free), g their slopes and w/σ² their weights, the reported covariance is
//!
//! Σ = s²·(Λ + C⁻¹/n)⁻¹ + K·Kᵀ·σ² + (K·i)(K·i)ᵀ + (K·t)(K·t)ᵀ,
//! K = (Λ + C⁻¹/1000)⁻¹·[(g − ḡ)·w/σ²]
//!
//! - n = κ·(1 + ρ)/(1 − ρ), at least one, ρ = e^(−Δt/τ): an average of a first-order Gauss–Markov
//!   process, sampled every Δt and of correlation time τ, has (1 + ρ)/(1 − ρ) times the variance of
//!   one of white noise (Bartlett 1946). The estimator has already multiplied the weights by κ. The
//!   epoch itself has its full weight, all others 1/n. This is right for an estimator with a long
//!   memory and for one without memory.
//! - s² = (Σw/Σψ′)·max(1, Σψ²/Σψ′) over the pseudoranges near the epoch, with the influence
//!   function ψ and the weights w of C. An M-estimator has the covariance Σψ²/(Σψ′)²·(GᵀG)⁻¹ (Huber
//!   1981, *Robust Statistics*, section 7.6), and C is (GᵀG)⁻¹/Σw. Σw exceeds Σψ′ because weights
//!   treat it as known which signals are reflected (Louis 1982). If the errors have the modelled
//!   variance, Σψ² = Σψ′. Larger residuals widen Σ; smaller ones do not narrow it, because they
//!   do not contain the errors that satellites have in common. One pseudorange of the modelled
//!   variance is added for each epoch as a prior, and Σψ′ is at least 0.2·Σw.
//! - σ is the standard deviation of broadcast orbit and clock, independent between satellites. i
//!   and t are those of the ionosphere's and the troposphere's models, with one error for all
//!   satellites: such a model errs in its zenith delay, and the common part goes into clocks and
//!   height. K is the gain of the epoch's own pseudoranges; the small part of C matters only if
//!   these determine no position.

use nalgebra::{Matrix3, Vector3};

use crate::gnss::Constellation;
use crate::snapshot::snapshot_fields;

use super::factors::Line;
use super::ranging::{Influence, Ranging};

/// Weight of the prior of s², as a number of pseudoranges of the modelled variance in each epoch.
const PRIOR_RANGES: f64 = 1.0;
/// Minimum redundancy without rejected pseudoranges: agreement on a wrong position by chance is
/// then very rare.
const AGREEING: f64 = 4.0;
/// Maximum fraction of rejected pseudoranges: a majority for another position is then impossible.
const DISSENTING: f64 = 0.2;
/// Fraction of the estimator's information in the gain of correlated errors.
const MEMORY_SHARE: f64 = 1e-3;
/// Lower bound of Σψ′/Σw, which is small if most pseudoranges are rejected.
const SLOPE_MIN: f64 = 0.2;

/// Number n of epochs, one every `spacing_s`, that have the same error.
pub(super) fn repetition(spacing_s: f64, correlation_s: f64) -> f64 {
    // (1 + ρ)/(1 − ρ).
    (0.5 * spacing_s / correlation_s).tanh().recip()
}

/// Sums over the residuals of pseudoranges.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Residuals {
    /// Σψ².
    squares: f64,
    /// Σw.
    weights: f64,
    /// Σψ′.
    slopes: f64,
    /// m.
    count: f64,
    /// m − p.
    redundancy: f64,
    /// Number of pseudoranges that are not rejected.
    accepted: f64,
    epochs: f64,
}

snapshot_fields!(Residuals { squares, weights, slopes, count, redundancy, accepted, epochs });

impl Residuals {
    /// Sums over one epoch's pseudoranges.
    pub(super) fn of(rows: impl Iterator<Item = Influence>) -> Self {
        let mut sum = Self { epochs: 1.0, ..Self::default() };
        let mut present = [false; Constellation::COUNT];
        for row in rows {
            sum.squares += row.pull * row.pull;
            sum.weights += row.weight;
            sum.slopes += row.slope;
            sum.count += 1.0;
            sum.accepted += f64::from(u8::from(row.is_accepted));
            present[row.constellation.index()] = true;
        }
        let clocks = present.iter().filter(|present| **present).count();
        sum.redundancy = (sum.count - (3 + clocks) as f64).max(0.0);
        sum
    }

    /// Adds the sums of other epochs.
    pub(super) fn add(&mut self, other: &Self) {
        self.squares += other.squares;
        self.weights += other.weights;
        self.slopes += other.slopes;
        self.count += other.count;
        self.redundancy += other.redundancy;
        self.accepted += other.accepted;
        self.epochs += other.epochs;
    }

    /// Whether the pseudoranges of one epoch agree: redundancy ≥ 4 without the rejected ones, and
    /// at most 20 % rejected. A wrong position is then very unlikely.
    pub(super) fn agree(&self) -> bool {
        let rejected = self.count - self.accepted;
        AGREEING <= self.redundancy - rejected && rejected <= DISSENTING * self.count
    }

    /// Whether most pseudoranges of one epoch are rejected, although they could determine a
    /// position.
    pub(super) fn lacks_redundancy(&self) -> bool {
        1.0 <= self.redundancy && self.redundancy <= self.count - self.accepted
    }

    /// The sums of an epoch whose own pseudoranges determine its position. Its residuals are
    /// smaller than its errors, so Σψ² is multiplied by (m + 1)/(m − p + 1).
    pub(super) fn of_own_position(mut self) -> Self {
        self.squares *= (self.count + 1.0) / (self.redundancy + 1.0);
        self
    }

    /// s².
    pub(super) fn variance_factor(&self) -> f64 {
        let prior = PRIOR_RANGES * self.epochs;
        let weights = self.weights + prior;
        if weights == 0.0 {
            return 1.0;
        }
        let slopes = (self.slopes + prior).max(SLOPE_MIN * weights);
        weights / slopes * ((self.squares + prior) / slopes).max(1.0)
    }
}

/// Error model of an epoch's pseudoranges, beyond their variances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ErrorModel {
    /// n.
    pub(super) repetition: f64,
    /// s².
    pub(super) variance_factor: f64,
    /// σ² (m²).
    pub(super) orbit_clock_m2: f64,
}

/// Sums over the pseudoranges of one constellation, whose clock is free.
#[derive(Clone, Copy, Default)]
struct Group {
    information: f64,
    slope: Vector3<f64>,
}

impl ErrorModel {
    /// Σ (m²) of a local position with covariance `formal`, from weighted pseudoranges.
    pub(super) fn covariance<'a>(
        &self,
        formal: &Matrix3<f64>,
        lines: &[Line],
        weighted: impl Iterator<Item = (&'a Ranging, f64)> + Clone,
    ) -> Matrix3<f64> {
        let Some(window) = formal.try_inverse() else { return *formal };
        let rows = weighted.map(|(range, weight)| {
            let slope = lines[usize::from(range.sight)].1;
            (range, slope, weight * range.factor.inverse_sigma.powi(2))
        });
        let mut groups = [Group::default(); Constellation::COUNT];
        let mut epoch = Matrix3::zeros();
        for (range, slope, information) in rows.clone() {
            let group = &mut groups[range.satellite.constellation.index()];
            group.information += information;
            group.slope += slope * information;
            epoch += slope * slope.transpose() * information;
        }
        for group in groups.iter().filter(|group| 0.0 < group.information) {
            epoch -= group.slope * group.slope.transpose() / group.information;
        }
        let noise = (epoch + window / self.repetition).try_inverse().unwrap_or(*formal);
        let gain = (epoch + window * MEMORY_SHARE).try_inverse().unwrap_or(*formal);
        let mut stated = noise * self.variance_factor;
        let (mut ionosphere, mut troposphere) = (Vector3::zeros(), Vector3::zeros());
        for (range, slope, information) in rows {
            let group = &groups[range.satellite.constellation.index()];
            if group.information == 0.0 {
                continue;
            }
            let pull = gain * (slope - group.slope / group.information) * information;
            stated += pull * pull.transpose() * self.orbit_clock_m2;
            ionosphere += pull * range.ionosphere_m;
            troposphere += pull * range.troposphere_m;
        }
        stated + ionosphere * ionosphere.transpose() + troposphere * troposphere.transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Ecef, GpsTime, LocalFrame};
    use crate::graph::Kernel;
    use crate::positioning::factors::{PseudorangeFactor, Sight};

    const RADIUS_M: f64 = 6_378_137.0;

    fn influence(pull: f64, slope: f64, is_accepted: bool) -> Influence {
        Influence { constellation: Constellation::Gps, pull, weight: 1.0, slope, is_accepted }
    }

    /// Satellites in four directions at 45° and one overhead, one clock, σ = 2 m.
    fn ranges() -> (Vec<Line>, Vec<Ranging>) {
        let frame = LocalFrame::at(Ecef::new(RADIUS_M, 0.0, 0.0));
        let far = 2e7 / 2_f64.sqrt();
        let directions =
            [(far, 0.0, far), (-far, 0.0, far), (0.0, far, far), (0.0, -far, far), (0.0, 0.0, 2e7)];
        let line = |(east, north, up): (f64, f64, f64)| {
            Sight::new(&frame, Ecef::new(RADIUS_M + up, east, north)).range(&Vector3::zeros())
        };
        let range = |sight| {
            let satellite = "G01".parse().unwrap();
            Ranging {
                factor: PseudorangeFactor { corrected_range_m: 0.0, inverse_sigma: 0.5 },
                sight,
                satellite,
                toe: GpsTime::EPOCH,
                issue: 1,
                bias: None,
                ionosphere_m: 3.0,
                troposphere_m: 0.0,
                reflection: None,
            }
        };
        (directions.map(line).to_vec(), (0..5).map(range).collect())
    }

    /// Under Huber's kernel of width 1 a residual of four standard deviations has the weight ¼, the
    /// least of a pseudorange that is used.
    #[test]
    fn a_pseudorange_is_rejected_below_the_weight_of_a_used_one() {
        let (_, ranges) = ranges();
        let is_accepted = |s| ranges[0].influence(s, &Kernel::huber(1.0)).is_accepted;
        assert!(is_accepted(3.99) && is_accepted(-3.99) && !is_accepted(4.01));
    }

    fn stated(formal_m2: f64, errors: ErrorModel) -> Matrix3<f64> {
        let (lines, ranges) = ranges();
        let weighted = ranges.iter().map(|range| (range, 1.0));
        errors.covariance(&(Matrix3::identity() * formal_m2), &lines, weighted)
    }

    const ERRORS: ErrorModel =
        ErrorModel { repetition: 60.0, variance_factor: 1.0, orbit_clock_m2: 0.0 };

    /// East: four slopes of ±1/√2 and 0, Λ = 2·0.5/4 = 0.25 1/m². A window of white noise with
    /// C = 0.01 m² adds 100/60 1/m²: 1/(0.25 + 1.667) m².
    #[test]
    fn a_windows_information_is_divided_by_its_repetition() {
        let east_m2 = stated(0.01, ERRORS)[(0, 0)];
        assert!((east_m2 - 1.0 / (0.25 + 100.0 / 60.0)).abs() < 1e-3, "{east_m2}");
        // A solution without memory reports the covariance of its own epoch.
        let alone_m2 = stated(4.0, ERRORS)[(0, 0)];
        assert!((alone_m2 - 4.0).abs() < 0.1, "{alone_m2}");
        let doubled = stated(4.0, ErrorModel { variance_factor: 2.0, ..ERRORS })[(0, 0)];
        assert!((doubled / alone_m2 - 2.0).abs() < 1e-9, "{doubled}");
    }

    /// East K·Kᵀ = Σ(g/4)²/(Λ + C⁻¹/1000)² = 0.25·0.25/(0.25 + 0.01)²: an orbit error of one metre
    /// moves the position by nearly a metre. An ionospheric error common to all satellites goes
    /// into the clock.
    #[test]
    fn what_lasts_is_not_averaged() {
        let with = stated(0.1, ErrorModel { orbit_clock_m2: 9.0, ..ERRORS })[(0, 0)];
        let without = stated(0.1, ERRORS)[(0, 0)];
        let expected = 9.0 * (0.25_f64 / 0.26).powi(2);
        assert!((with - without - expected).abs() < 1e-6, "{with} {without}");
    }

    /// τ = 30 s: 60 epochs of one second, 2.16 of 30 s, one of ten minutes.
    #[test]
    fn repetition_is_bartletts() {
        assert!((repetition(1.0, 30.0) - 60.0).abs() < 0.01);
        let rho = (-1_f64).exp();
        assert!((repetition(30.0, 30.0) - (1.0 + rho) / (1.0 - rho)).abs() < 1e-12);
        assert!((repetition(600.0, 30.0) - 1.0).abs() < 1e-6);
    }

    /// Nine pseudoranges of one constellation have redundancy five. With one rejected, four others
    /// agree, which is enough; with two rejected it is not.
    #[test]
    fn agreement_needs_redundancy_and_few_rejected() {
        let of =
            |rejected: usize| Residuals::of((0..9).map(|i| influence(0.5, 1.0, rejected <= i)));
        assert!(of(0).agree() && of(1).agree() && !of(2).agree());
    }

    /// Nine pseudoranges of one constellation determine four unknowns. With five rejected four are
    /// left, which always agree. Four pseudoranges have no redundancy.
    #[test]
    fn an_epoch_is_lost_with_as_many_left_as_unknowns() {
        let of = |count: usize, rejected: usize| {
            Residuals::of((0..count).map(|i| influence(0.5, 1.0, rejected <= i)))
        };
        assert!(
            of(9, 5).lacks_redundancy()
                && !of(9, 4).lacks_redundancy()
                && !of(4, 4).lacks_redundancy()
        );
    }

    /// Seven pseudoranges of weight one, ψ = ±2: (28 + 1)/(7 + 1). With ψ′ = ½, Σψ′ = 3.5:
    /// 8/4.5·29/4.5. With ψ = ½ the residuals are smaller than modelled, and only 8/4.5 remains.
    #[test]
    fn the_variance_factor_worked_by_hand() {
        let of = |pull: f64, slope: f64| {
            let sign = |i| if i % 2 == 0 { pull } else { -pull };
            Residuals::of((0..7).map(|i| influence(sign(i), slope, true)))
        };
        let is = |residuals: &Residuals, factor: f64| {
            assert!((residuals.variance_factor() - factor).abs() < 1e-12, "{residuals:?}");
        };
        is(&of(2.0, 1.0), 29.0 / 8.0);
        is(&of(2.0, 0.5), 8.0 / 4.5 * 29.0 / 4.5);
        is(&of(0.5, 0.5), 8.0 / 4.5);
        // The same residuals again do not change it.
        let mut twice = of(2.0, 1.0);
        twice.add(&of(2.0, 1.0));
        is(&twice, 29.0 / 8.0);
        is(&Residuals::default(), 1.0);
    }
}
