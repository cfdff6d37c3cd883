//! Whether the best integers are good enough: ratio tests and the integers' posterior.

use std::f64::consts::PI;
use std::f64::consts::TAU;

use crate::lambda::success::bootstrapped_failure_rate;
use crate::lambda::success::log_determinant;
use crate::lambda::success::scaled_erfc;
use crate::lambda::thresholds::FailureRate;

/// Acceptance by R = ‖â − a₂‖² / ‖â − a₁‖² ≥ threshold, second best over best.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RatioTest {
    /// The same threshold for every model.
    Constant(f64),
    /// The threshold that keeps accepted wrong integers at a rate, whatever the model's strength.
    ///
    /// Source: Verhagen & Teunissen (2013); the thresholds are our own simulation, see
    /// `thresholds`.
    FixedFailureRate(FailureRate),
    /// That threshold, but no less than a constant: a guard against models that state too little
    /// error, in which the failure rate is too small.
    FixedFailureRateAtLeast(FailureRate, f64),
}

impl RatioTest {
    /// The threshold on R for a model of these conditional variances.
    pub fn threshold(self, conditional_variances: &[f64]) -> f64 {
        match self {
            Self::Constant(threshold) => threshold,
            Self::FixedFailureRate(rate) => {
                let failure_rate = bootstrapped_failure_rate(conditional_variances);
                rate.threshold(conditional_variances.len(), failure_rate)
            }
            Self::FixedFailureRateAtLeast(rate, least) => {
                Self::FixedFailureRate(rate).threshold(conditional_variances).max(least)
            }
        }
    }
}

/// Second-best over best squared norm; infinite when the best is exact.
pub(in crate::lambda) fn ratio(norms: &[f64]) -> Option<f64> {
    match norms {
        [best, second, ..] if *best == 0.0 && 0.0 < *second => Some(f64::INFINITY),
        [best, second, ..] if 0.0 < *best => Some(second / best),
        _ => None,
    }
}

/// Posterior probability of the best candidate under a flat prior over all integers.
///
/// P = e^(−q₁/2) / Σ_{z ∈ ℤⁿ} e^(−‖â−z‖²/2). The sum is over the candidates' squared norms q_i;
/// what lies beyond the last, q_m, is taken at the mean density |Q|^½ of integers in the metric:
/// (2π)^(n/2) |Q|^½ P(χ²_n > q_m). Presumes that Q is right.
///
/// Source: Betti, Crespi & Sansò (1993), Manuscripta Geodaetica 18, 317–330, for the posterior; the
/// tail is ours.
pub fn posterior_probability(norms: &[f64], conditional_variances: &[f64]) -> f64 {
    let (Some(best), Some(last)) = (norms.first(), norms.last()) else { return 0.0 };
    let found: f64 = norms.iter().map(|q| (0.5 * (best - q)).exp()).sum();
    let n = conditional_variances.len();
    let log_density = 0.5 * (n as f64 * TAU.ln() + log_determinant(conditional_variances));
    let tail = (log_density + 0.5 * best + log_chi_squared_survival(n, *last)).exp();
    1.0 / (found + tail)
}

/// ln P(χ²_n > q), by Γ(a+1, x)/Γ(a+1) = Γ(a, x)/Γ(a) + xᵃe⁻ˣ/Γ(a+1) with a = n/2, x = q/2.
fn log_chi_squared_survival(n: usize, q: f64) -> f64 {
    let x = 0.5 * q;
    // All terms carry e⁻ˣ, which underflows: it is taken out.
    let (mut a, mut sum, mut term) = if n % 2 == 1 {
        (0.5, scaled_erfc(x.sqrt()), 2.0 * (x / PI).sqrt())
    } else {
        (1.0, 1.0, x)
    };
    while a + 0.5 < 0.5 * n as f64 {
        sum += term;
        a += 1.0;
        term *= x / a;
    }
    sum.ln() - x
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The usual 95 % quantiles of χ²: n = 1, 2, 5, 10.
    #[test]
    fn chi_squared_survival_matches_the_table() {
        for (n, q) in [(1, 3.84146), (2, 5.99147), (5, 11.0705), (10, 18.3070)] {
            let survival = log_chi_squared_survival(n, q).exp();
            assert!((survival - 0.05).abs() < 1e-6, "n {n}: {survival}");
        }
    }

    #[test]
    fn constant_ratio_is_the_threshold_of_any_model() {
        assert_eq!(RatioTest::Constant(3.0).threshold(&[0.1, 0.2]), 3.0);
        let strong = RatioTest::FixedFailureRateAtLeast(FailureRate::PerMille, 2.0);
        assert_eq!(strong.threshold(&[1e-4, 1e-4]), 2.0);
        let weak = [0.05, 0.05];
        let rate = RatioTest::FixedFailureRate(FailureRate::PerMille).threshold(&weak);
        assert!(2.0 < rate && strong.threshold(&weak) == rate);
        assert_eq!(ratio(&[0.5, 2.0]), Some(4.0));
        assert_eq!(ratio(&[0.0, 2.0]), Some(f64::INFINITY));
        assert_eq!(ratio(&[0.0, 0.0]), None);
    }
}
