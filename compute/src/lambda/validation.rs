//! Reliability of the best integers: their ratio to the second best, and their posterior.

use std::f64::consts::PI;
use std::f64::consts::TAU;

use crate::lambda::success::log_determinant;
use crate::lambda::success::scaled_erfc;

/// Most terms of the continued fraction of an incomplete beta function. For a up to 50 and b up to
/// 30 it converges in 60 where it is used.
const FRACTION_TERMS: i32 = 200;
/// Relative change at which that continued fraction has converged.
const FRACTION_PRECISION: f64 = 1e-14;

/// Ratio of second-best to best squared norm; infinite if the best is zero.
pub(in crate::lambda) fn ratio(norms: &[f64]) -> Option<f64> {
    match norms {
        [best, second, ..] if *best == 0.0 && 0.0 < *second => Some(f64::INFINITY),
        [best, second, ..] if 0.0 < *best => Some(second / best),
        _ => None,
    }
}

/// Posterior probability of the best candidate under a flat prior over all integers.
///
/// P = e^(−q₁/2) / Σ_{z ∈ ℤⁿ} e^(−‖â−z‖²/2). The candidates' squared norms q_i enter the sum one by
/// one. The integers beyond the last one, q_m, enter with their mean density |Q|^½: (2π)^(n/2)
/// |Q|^½ P(χ²_n > q_m). Presumes that Q is right.
///
/// Source: Betti, Crespi & Sansò (1993), Manuscripta Geodaetica 18, 317–330, for the posterior; the
/// tail is ours.
fn posterior_probability(norms: &[f64], conditional_variances: &[f64]) -> f64 {
    let (Some(best), Some(last)) = (norms.first(), norms.last()) else { return 0.0 };
    let found: f64 = norms.iter().map(|q| (0.5 * (best - q)).exp()).sum();
    let n = conditional_variances.len();
    let log_density = 0.5 * (n as f64 * TAU.ln() + log_determinant(conditional_variances));
    let tail = (log_density + 0.5 * best + log_chi_squared_survival(n, *last)).exp();
    1.0 / (found + tail)
}

/// Prior of the variance factor σ² by which the covariance is scaled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownScale {
    /// ν: degrees of freedom of the scaled inverse-χ² prior.
    pub freedom: f64,
    /// s²: scale of the prior, the mean square of residuals whitened by the covariance.
    pub variance: f64,
}

/// Posterior probability of the best candidate, with the prior of the covariance's scale; `None`:
/// the scale is exact.
pub(in crate::lambda) fn posterior(
    norms: &[f64],
    conditional_variances: &[f64],
    scale: Option<KnownScale>,
) -> f64 {
    match scale {
        Some(scale) => scaled_posterior_probability(norms, conditional_variances, scale),
        None => posterior_probability(norms, conditional_variances),
    }
}

/// Odds of integers with the first squared norm against those with the second, both of `entries`
/// entries, under the density of [`scaled_posterior_probability`].
pub(crate) fn odds_at_scale(norms: [f64; 2], entries: usize, scale: KnownScale) -> f64 {
    let [own, other] = norms.map(|norm| scale.freedom * scale.variance + norm);
    (0.5 * (scale.freedom + entries as f64) * (other / own).ln()).exp()
}

/// Posterior probability of the best candidate when the covariance has an unknown scale σ².
///
/// P = (νs² + q₁)^−(ν+n)/2 / Σ_{z ∈ ℤⁿ} (νs² + ‖â−z‖²)^−(ν+n)/2: σ² is integrated out under the
/// scaled inverse-χ² density with ν degrees of freedom and scale s². A best candidate that fits
/// poorly (q₁ ≫ n) suggests a large σ² and so a lower probability. The tail beyond q_m again has
/// the integers' mean density: with t = νs²/(νs² + q), π^(n/2)/Γ(n/2) |Q|^½ (νs²)^−ν/2 ∫ t^(ν/2−1)
/// (1−t)^(n/2−1) dt from zero to t_m.
///
/// Source: Betti, Crespi & Sansò (1993) for the integration; the tail is ours.
fn scaled_posterior_probability(
    norms: &[f64],
    conditional_variances: &[f64],
    KnownScale { freedom, variance }: KnownScale,
) -> f64 {
    let (Some(best), Some(last)) = (norms.first(), norms.last()) else { return 0.0 };
    let half = 0.5 * conditional_variances.len() as f64;
    let (power, known) = (0.5 * freedom + half, freedom * variance);
    let found: f64 =
        norms.iter().map(|q| (power * ((known + best) / (known + q)).ln()).exp()).sum();
    let log_integral = log_incomplete_beta(known / (known + last), 0.5 * freedom, half);
    let log_factor = half * PI.ln() - log_gamma_of_half(conditional_variances.len())
        + 0.5 * log_determinant(conditional_variances)
        - 0.5 * freedom * known.ln()
        + power * (known + best).ln();
    1.0 / (found + (log_factor + log_integral).exp())
}

/// ln Σ_{z ∈ ℤⁿ} f(‖â−z‖²): the density of the n floats under a flat prior over all integers, given
/// the best squared norm q₁ and the posterior P of the best integers, f(q₁)/P.
///
/// f is normal where the scale is exact, else Γ((ν+n)/2)/Γ(ν/2)·(πνs²)^−n/2 |Q|^−½
/// (1 + q/νs²)^−(ν+n)/2, the density of [`scaled_posterior_probability`] with its constants.
pub(in crate::lambda) fn log_evidence(
    best: f64,
    probability: f64,
    conditional_variances: &[f64],
    scale: Option<KnownScale>,
) -> f64 {
    let n = conditional_variances.len() as f64;
    let log_of_best = match scale {
        Some(KnownScale { freedom, variance }) => {
            let (power, known) = (0.5 * (freedom + n), freedom * variance);
            let constant =
                log_gamma(power) - log_gamma(0.5 * freedom) - 0.5 * n * (PI * known).ln();
            constant - power * (best / known).ln_1p()
        }
        None => -0.5 * (n * TAU.ln() + best),
    };
    log_of_best - 0.5 * log_determinant(conditional_variances) - probability.ln()
}

/// ln Γ(x) for x > 0, to 10⁻⁹: Stirling's series beyond 8, below by Γ(x + 1) = x·Γ(x).
///
/// Source: Abramowitz & Stegun (1964), *Handbook of Mathematical Functions*, 6.1.41.
fn log_gamma(x: f64) -> f64 {
    let (mut a, mut steps) = (x, 0.0);
    while a < 8.0 {
        steps += a.ln();
        a += 1.0;
    }
    let series = 1.0 / (12.0 * a) - 1.0 / (360.0 * a.powi(3)) + 1.0 / (1260.0 * a.powi(5));
    (a - 0.5) * a.ln() - a + 0.5 * TAU.ln() + series - steps
}

/// ln ∫ t^(a−1) (1−t)^(b−1) dt from zero to `x`, for 0 < x ≤ 1 and a, b > 0.
///
/// Above (a + 1)/(a + b + 2), where the continued fraction converges slowly, it is the complement
/// of the integral from `x` to one.
///
/// Source: DLMF 8.17.4 and 8.17.22 (<https://dlmf.nist.gov/8.17>).
fn log_incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    let log_part = |x: f64, a: f64, b: f64| {
        a * x.ln() + b * (-x).ln_1p() - a.ln() + beta_fraction(x, a, b).ln()
    };
    if x * (a + b + 2.0) < a + 1.0 {
        return log_part(x, a, b);
    }
    let log_whole = log_gamma(a) + log_gamma(b) - log_gamma(a + b);
    let complement = (log_part(1.0 - x, b, a) - log_whole).exp();
    log_whole + (-complement).ln_1p()
}

/// The continued fraction 1/(1 + d₁/(1 + d₂/(1 + …))) of an incomplete beta function, by the
/// products of Lentz (1976), *Applied Optics* 15, 668–671.
fn beta_fraction(x: f64, a: f64, b: f64) -> f64 {
    let (mut value, mut c, mut d) = (1.0, f64::INFINITY, 1.0);
    for k in 1..FRACTION_TERMS {
        let m = f64::from(k / 2);
        let term = match k % 2 {
            1 => -(a + m) * (a + b + m) / ((a + 2.0 * m) * (a + 2.0 * m + 1.0)) * x,
            _ => m * (b - m) / ((a + 2.0 * m - 1.0) * (a + 2.0 * m)) * x,
        };
        d = (1.0 + term * d).recip();
        c = 1.0 + term / c;
        let factor = c * d;
        value *= factor;
        if (factor - 1.0).abs() < FRACTION_PRECISION {
            break;
        }
    }
    value
}

/// ln Γ(n/2) for n of at least one, by Γ(a + 1) = a·Γ(a).
fn log_gamma_of_half(n: usize) -> f64 {
    let (mut a, mut log) = if n % 2 == 1 { (0.5, 0.5 * PI.ln()) } else { (1.0, 0.0) };
    while a + 0.5 < 0.5 * n as f64 {
        log += f64::ln(a);
        a += 1.0;
    }
    log
}

/// ln P(χ²_n > q), by Γ(a+1, x)/Γ(a+1) = Γ(a, x)/Γ(a) + xᵃe⁻ˣ/Γ(a+1) with a = n/2, x = q/2.
fn log_chi_squared_survival(n: usize, q: f64) -> f64 {
    let x = 0.5 * q;
    // All terms have the factor e⁻ˣ, which underflows, so it is left out.
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

    /// With ν = 4 and s² = 1, two entries of squared norm 8 have the odds ((4 + 2)/(4 + 8))^3 = 1/8
    /// against those of squared norm 2. With an exact scale the odds would be e^−3.
    #[test]
    fn odds_worked_by_hand() {
        let scale = |freedom| KnownScale { freedom, variance: 1.0 };
        assert!((odds_at_scale([8.0, 2.0], 2, scale(4.0)) - 0.125).abs() < 1e-15);
        assert!((odds_at_scale([8.0, 2.0], 2, scale(1e9)) - (-3_f64).exp()).abs() < 1e-6);
        assert_eq!(odds_at_scale([5.0, 5.0], 7, scale(4.0)), 1.0);
    }

    /// Γ(½) = √π, Γ(5) = 24, Γ(10.5) = 1133278.388949 (Abramowitz & Stegun 1964, table 6.1, by its
    /// recurrence).
    #[test]
    fn gamma_at_known_places() {
        for (x, gamma) in [(0.5, PI.sqrt()), (5.0, 24.0), (10.5, 1_133_278.388_948_785)] {
            assert!((log_gamma(x) - f64::ln(gamma)).abs() < 1e-9, "{x}");
            let twice = (2.0 * x) as usize;
            assert!((log_gamma(x) - log_gamma_of_half(twice)).abs() < 1e-9, "{x}");
        }
    }

    /// The density of one float of variance 0.04, summed over all integers, integrates to one over
    /// a cycle. Where one integer alone is likely, the density is that of a normal.
    #[test]
    fn the_evidence_is_a_density_of_the_fraction() {
        let scales = [None, Some(KnownScale { freedom: 8.0, variance: 0.7 })];
        for scale in scales {
            let steps = 400;
            let density = |k: i32| {
                let fraction = (f64::from(k) + 0.5) / f64::from(steps) - 0.5;
                let mut norms: Vec<f64> =
                    (-6..=6).map(|z| (fraction - f64::from(z)).powi(2) / 0.04).collect();
                norms.sort_unstable_by(f64::total_cmp);
                let probability = posterior(&norms, &[0.04], scale);
                log_evidence(norms[0], probability, &[0.04], scale).exp()
            };
            let mean = (0..steps).map(density).sum::<f64>() / f64::from(steps);
            assert!((mean - 1.0).abs() < 2e-3, "{mean}");
        }
        let sharp = log_evidence(4.0, 1.0, &[1e-4], None);
        assert!((sharp - (-2.0 - 0.5 * (TAU * 1e-4).ln())).abs() < 1e-12);
    }

    /// The usual 95 % quantiles of χ²: n = 1, 2, 5, 10.
    #[test]
    fn chi_squared_survival_matches_the_table() {
        for (n, q) in [(1, 3.84146), (2, 5.99147), (5, 11.0705), (10, 18.3070)] {
            let survival = log_chi_squared_survival(n, q).exp();
            assert!((survival - 0.05).abs() < 1e-6, "n {n}: {survival}");
        }
    }

    /// B_x(2, 3) = x²/2 − 2x³/3 + x⁴/4, B_x(½, ½) = 2·arcsin √x, B_x(½, 1) = 2√x; on both sides of the
    /// mean.
    #[test]
    fn incomplete_beta_at_known_places() {
        for x in [1e-9_f64, 0.05, 0.3, 0.41, 0.6, 0.97] {
            let polynomial = x.powi(2) / 2.0 - 2.0 * x.powi(3) / 3.0 + x.powi(4) / 4.0;
            let root = x.sqrt();
            let known =
                [(2.0, 3.0, polynomial), (0.5, 0.5, 2.0 * root.asin()), (0.5, 1.0, 2.0 * root)];
            for (a, b, expected) in known {
                let found = log_incomplete_beta(x, a, b);
                assert!((found - f64::ln(expected)).abs() < 2e-9, "{x} {a} {b}: {found}");
            }
        }
    }

    fn about_one(freedom: f64) -> KnownScale {
        KnownScale { freedom, variance: 1.0 }
    }

    /// A well known scale of ¼ gives the same posterior as a covariance a quarter as large.
    #[test]
    fn a_known_scale_is_a_covariance() {
        let (norms, variances) = ([0.4, 2.0, 3.0, 3.5], [2e-2, 5e-2, 1e-2]);
        let known = KnownScale { freedom: 9.0, variance: 0.25 };
        let found = scaled_posterior_probability(&norms, &variances, known);
        let quarter = (norms.map(|q| q * 4.0), variances.map(|v| v * 0.25));
        let expected = scaled_posterior_probability(&quarter.0, &quarter.1, about_one(9.0));
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        assert!(scaled_posterior_probability(&norms, &variances, about_one(9.0)) + 0.05 < found);
    }

    /// One entry of unit variance: Student's density over all integers, summed here one by one.
    /// With many degrees of freedom it is the normal posterior.
    #[test]
    fn scaled_posterior_is_the_sum_over_all_integers() {
        let (float, freedom): (f64, f64) = (0.2, 6.0);
        let weight = |z: i32| (freedom + (float - f64::from(z)).powi(2)).powf(-3.5);
        let sum: f64 = (-2000..=2000).map(weight).sum();
        let mut norms: Vec<f64> = (-4..=4).map(|z: i32| (float - f64::from(z)).powi(2)).collect();
        norms.sort_by(f64::total_cmp);
        let found = scaled_posterior_probability(&norms, &[1.0], about_one(freedom));
        // The tail approximates a sum by an integral.
        assert!((found - weight(0) / sum).abs() < 2e-3, "{found} {}", weight(0) / sum);
        let normal = posterior_probability(&norms, &[1.0]);
        let certain = scaled_posterior_probability(&norms, &[1.0], about_one(1e4));
        assert!((certain - normal).abs() < 1e-3);
        // The same difference of squared norms, but a best candidate that fits worse.
        let near = scaled_posterior_probability(&[1.0, 15.0], &[1e-3; 4], about_one(10.0));
        let poor = scaled_posterior_probability(&[20.0, 34.0], &[1e-3; 4], about_one(10.0));
        assert!(0.99 < near && poor < 0.97, "{near} {poor}");
    }

    #[test]
    fn ratio_is_second_best_over_best() {
        assert_eq!(ratio(&[0.5, 2.0]), Some(4.0));
        assert_eq!(ratio(&[0.0, 2.0]), Some(f64::INFINITY));
        assert_eq!(ratio(&[0.0, 0.0]), None);
    }
}
