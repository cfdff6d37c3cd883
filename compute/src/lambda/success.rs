//! Success rates of integers from their covariance, before any data.
//!
//! P_s = Π_i (2Φ(1/(2σ_i)) − 1) with the conditional standard deviations σ_i of the decorrelated
//! entries: exact for bootstrapping, a lower bound for integer least squares.
//!
//! Source: Teunissen (1998), on the success probability of rounding and bootstrapping.

use std::f64::consts::FRAC_2_SQRT_PI;
use std::f64::consts::SQRT_2;

/// Argument above which erf is computed by the continued fraction of erfc.
const SERIES_MAX: f64 = 2.0;
/// Argument above which 1 − erfc is one in double precision: erfc(6) = 2·10⁻¹⁷.
const CERTAIN: f64 = 6.0;

/// Bootstrapped success rate from conditional variances.
pub(crate) fn bootstrapped_success_rate(conditional_variances: &[f64]) -> f64 {
    log_success_rate(conditional_variances).exp()
}

/// Ambiguity dilution of precision |Q|^(1/2n), in the unit of the entries; |Q| = Π d_i.
///
/// Source: Teunissen (1997), J. Geodesy 71, 513–525.
pub(crate) fn adop(conditional_variances: &[f64]) -> f64 {
    (log_determinant(conditional_variances) / (2.0 * conditional_variances.len() as f64)).exp()
}

pub(in crate::lambda) fn log_determinant(conditional_variances: &[f64]) -> f64 {
    conditional_variances.iter().map(|d| d.ln()).sum()
}

fn log_success_rate(conditional_variances: &[f64]) -> f64 {
    conditional_variances.iter().map(|d| log_rounding_success(*d)).sum()
}

/// ln(2Φ(1/(2σ)) − 1) = ln erf(1/(2√2 σ)).
fn log_rounding_success(variance: f64) -> f64 {
    let x = 1.0 / (2.0 * SQRT_2 * variance.sqrt());
    if CERTAIN < x {
        return 0.0;
    }
    if x < SERIES_MAX { erf_series(x).ln() } else { (-erfc_fraction(x)).ln_1p() }
}

/// e^(x²) erfc(x), which does not underflow.
pub(in crate::lambda) fn scaled_erfc(x: f64) -> f64 {
    let scale = (x * x).exp();
    if x < SERIES_MAX { (1.0 - erf_series(x)) * scale } else { fraction(x) }
}

/// erf(x) = 2/√π · e^(−x²) · Σ 2^k x^(2k+1) / (1·3·…·(2k+1)).
fn erf_series(x: f64) -> f64 {
    let (mut term, mut sum, mut odd) = (x, x, 1.0);
    while f64::EPSILON * sum < term {
        odd += 2.0;
        term *= 2.0 * x * x / odd;
        sum += term;
    }
    FRAC_2_SQRT_PI * (-x * x).exp() * sum
}

fn erfc_fraction(x: f64) -> f64 {
    (-x * x).exp() * fraction(x)
}

/// √π e^(x²) erfc(x) = 1/(x + ½/(x + 1/(x + 3⁄2/(x + …)))), over √π.
///
/// Evaluated upwards from the first level that has no effect in double precision: the 53rd at x =
/// 2, the 28th at 3, the 9th at 10.
fn fraction(x: f64) -> f64 {
    let levels = 12 + (200.0 / (x * x)) as u32;
    let tail = (1..=levels).rev().fold(x, |tail, k| x + 0.5 * f64::from(k) / tail);
    FRAC_2_SQRT_PI / 2.0 / tail
}

#[cfg(test)]
mod tests {
    use super::*;

    /// erf(0.5), erf(1) and erf(2) to ten digits; the two branches meet.
    #[test]
    fn error_function_matches_the_table() {
        assert!((erf_series(0.5) - 0.520_499_877_8).abs() < 1e-10);
        assert!((erf_series(1.0) - 0.842_700_792_9).abs() < 1e-10);
        assert!((erf_series(2.0) - 0.995_322_265_0).abs() < 1e-10);
        assert!((1.0 - erfc_fraction(2.0) - erf_series(2.0)).abs() < 1e-15);
    }

    /// Compared with 400 levels of the continued fraction.
    #[test]
    fn more_levels_change_nothing() {
        for x in (0..560).map(|i| 2.0 + 0.05 * f64::from(i)) {
            let tail = (1..=400).rev().fold(x, |tail, k| x + 0.5 * f64::from(k) / tail);
            let whole = FRAC_2_SQRT_PI / 2.0 / tail;
            assert!((fraction(x) / whole - 1.0).abs() < 4.0 * f64::EPSILON, "{x}");
        }
    }

    /// σ = ½: each entry is right when a standard normal stays within ±1, 0.682 689 492.
    #[test]
    fn success_rate_of_half_a_unit_is_one_sigma() {
        assert!((bootstrapped_success_rate(&[0.25]) - 0.682_689_492).abs() < 1e-9);
        assert!((bootstrapped_success_rate(&[0.25; 3]) - 0.682_689_492_f64.powi(3)).abs() < 1e-9);
    }

    /// Both tails beyond 7.07σ have 1.54e-12. Computed as 1 − P, its digits would be lost.
    #[test]
    fn tiny_failure_rates_keep_their_digits() {
        let rate = -log_success_rate(&[0.005]).exp_m1();
        assert!((rate / erfc_fraction(5.0) - 1.0).abs() < 1e-9 && 1.5e-12 < rate && rate < 1.6e-12);
    }

    #[test]
    fn adop_is_the_geometric_mean_of_standard_deviations() {
        assert!((adop(&[0.01, 0.04]) - 0.02_f64.sqrt()).abs() < 1e-15);
    }
}
