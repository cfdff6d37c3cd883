//! The likelihood of a pseudorange error: direct signal, reflection, or fault.
//!
//! With s = measured − modelled (m), so that late signals are positive:
//!
//! p(s) = (1 − ε)·[(1 − π)·N(s; 0, σ²) + π·E(s; σ, λ)] + ε/W
//!
//! N is the noise of a direct signal. E is that noise plus an exponential extra path of mean λ, the
//! exponentially modified Gaussian E = (1/λ)·exp(σ²/2λ² − s/λ)·Φ(u), u = s/σ − σ/λ. The uniform
//! density ε/W bounds the influence of a fault. J = −ln p is minimised by expectation maximisation:
//! with the responsibilities γ_D and γ_R of the direct and the reflected signal, and h = φ(u)/Φ(u),
//!
//! dJ/ds = γ_D·s/σ² + γ_R·(1/λ − h/σ), curvature γ_D/σ² + γ_R·h·(u + h)/σ² ≥ 0:
//!
//! E is log-concave, so each step solves a convex problem.
//!
//! Sources: Grushka (1972), *Characterization of exponentially modified Gaussian peaks in
//! chromatography*, Anal. Chem. 44; Dempster, Laird & Rubin (1977), *Maximum likelihood from
//! incomplete data via the EM algorithm*, J. R. Stat. Soc. B 39.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_2_SQRT_PI};

use crate::snapshot::snapshot_fields;

/// The largest error that multipath can cause (m): 1.5 chips of 1/1.023 MHz. A reflection with a
/// longer delay does not correlate with the signal (Van Nee 1993).
pub(super) const WILD_M: f64 = 1.5 * 293.052_256;
/// H (m): height of walls above the antenna, as of houses of a dozen floors.
const WALL_M: f64 = 40.0;
/// Least λ (m): diffraction at a roof, and reflectors beside the antenna, delay the signals of high
/// satellites, too.
const EXTRA_PATH_MIN_M: f64 = 10.0;
/// Sine of 6°, below the elevation masks.
pub(super) const LOWEST_SINE: f64 = 0.1;
/// ε: fraction of pseudoranges that are neither direct nor reflected signals, but faults.
pub(super) const FAULT_SHARE: f64 = 0.02;
/// W (m): longer than nearly all extra paths.
const FAULT_WIDTH_M: f64 = 400.0;
/// ε/W (1/m).
const FAULT_DENSITY: f64 = FAULT_SHARE / FAULT_WIDTH_M;

/// φ(0) = 1/√(2π).
const NORMAL_PEAK: f64 = 0.5 * FRAC_2_SQRT_PI * FRAC_1_SQRT_2;
/// Standard deviations beyond which the normal density is below 10⁻¹³ of its peak.
const FAR: f64 = 8.0;

/// Error model of one pseudorange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PseudorangeError {
    /// σ (m).
    pub(super) sigma_m: f64,
    /// π: probability that the signal is a reflection.
    pub(super) reflected: f64,
    /// λ: mean extra path of a reflection (m).
    pub(super) extra_path_m: f64,
}

snapshot_fields!(PseudorangeError { sigma_m, reflected, extra_path_m });

/// λ at the elevation E with this sine (m): H/2·cos²E/sin E.
///
/// A vertical wall at the horizontal distance d, whose normal is α away from the satellite's
/// azimuth, reflects with the extra path 2d·cos E·cos α at the height d·tan E/cos α. The wall is no
/// higher than H, so d is at most H·cos α/tan E. λ is the mean over all such d and over α. So
/// signals of high satellites are reflected by near walls only.
pub(super) fn extra_path_m(sin_elevation: f64) -> f64 {
    let cos2 = 1.0 - sin_elevation * sin_elevation;
    (0.5 * WALL_M * cos2 / sin_elevation.max(LOWEST_SINE)).max(EXTRA_PATH_MIN_M)
}

/// The likelihood at one residual s, with the derivatives of J by s (m), or by z = s/σ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LikelihoodAt {
    /// p(s) (1/m).
    pub(super) density: f64,
    /// J′.
    pub(super) slope: f64,
    /// Curvature of the bound of J in expectation maximisation.
    pub(super) curvature: f64,
    /// J″, negative where direct and reflected are about equally likely.
    pub(super) information: f64,
    /// γ_D: probability that the signal is direct, given its residual.
    pub(super) direct: f64,
}

/// The likelihood of one pseudorange, prepared for many residuals.
#[derive(Clone, Copy, Debug)]
pub(super) struct Likelihood {
    /// 1/σ (1/m).
    per_sigma_m: f64,
    /// σ/λ.
    ratio: f64,
    /// (1 − ε)·(1 − π)·N(0; 0, σ²) (1/m).
    direct: f64,
    /// (1 − ε)·π/λ (1/m).
    late: f64,
}

impl PseudorangeError {
    /// The likelihood with the constants of this error model.
    pub(super) fn likelihood(&self) -> Likelihood {
        Likelihood::new(self.sigma_m.recip(), self.reflected, self.extra_path_m)
    }

    /// See [`Likelihood::evaluate`].
    #[cfg(test)]
    fn evaluate(&self, s_m: f64) -> LikelihoodAt {
        self.likelihood().evaluate(s_m)
    }

    /// See [`Likelihood::density`].
    pub(super) fn density(&self, s_m: f64) -> f64 {
        self.likelihood().density(s_m)
    }
}

impl Likelihood {
    /// With 1/σ (1/m), π and λ (m).
    pub(super) fn new(per_sigma_m: f64, reflected: f64, extra_path_m: f64) -> Self {
        let (known, ratio) = (1.0 - FAULT_SHARE, (per_sigma_m * extra_path_m).recip());
        Self {
            per_sigma_m,
            ratio,
            direct: known * (1.0 - reflected) * per_sigma_m * NORMAL_PEAK,
            late: known * reflected * ratio * per_sigma_m,
        }
    }

    /// The likelihood at s = measured − modelled (m), with the derivatives of J by s.
    pub(super) fn evaluate(&self, s_m: f64) -> LikelihoodAt {
        let per_m = self.per_sigma_m;
        let at = self.evaluate_whitened(s_m * per_m);
        let per_m2 = per_m * per_m;
        LikelihoodAt {
            slope: at.slope * per_m,
            curvature: at.curvature * per_m2,
            information: at.information * per_m2,
            ..at
        }
    }

    /// The likelihood at z = s/σ, with the derivatives of J by z.
    ///
    /// `curvature` is that of the bound in expectation maximisation, which treats γ_D and γ_R as
    /// known. The curvature of J is smaller by the missing information: Louis (1982), *Finding the
    /// observed information matrix when using the EM algorithm*, (3.2).
    #[inline]
    pub(super) fn evaluate_whitened(&self, z: f64) -> LikelihoodAt {
        let (direct, late, hazard) = self.joint_densities(z);
        let density = direct + late + FAULT_DENSITY;
        let per_density = density.recip();
        let (direct, late) = (direct * per_density, late * per_density);
        let u = z - self.ratio;
        let on_late = self.ratio - hazard;
        let slope = direct * z + late * on_late;
        let curvature = direct + late * hazard * (u + hazard);
        // The missing information is the variance of the slope over direct, reflected and fault.
        let missing = direct * z * z + late * on_late * on_late - slope * slope;
        LikelihoodAt { density, slope, curvature, information: curvature - missing, direct }
    }

    /// p(s) alone (1/m), at s = measured − modelled (m).
    pub(super) fn density(&self, s_m: f64) -> f64 {
        let (direct, late, _) = self.joint_densities(s_m * self.per_sigma_m);
        direct + late + FAULT_DENSITY
    }

    /// An upper bound of p (1/m): N has its peak at zero, and E is below 1/λ.
    pub(super) fn density_bound(&self) -> f64 {
        self.direct + self.late + FAULT_DENSITY
    }

    /// (1 − ε)·(1 − π)·N and (1 − ε)·π·E (1/m), and h; at z = s/σ.
    fn joint_densities(&self, z: f64) -> (f64, f64, f64) {
        let (normal, late, hazard) = parts(z, self.ratio);
        (self.direct * normal, self.late * late, hazard)
    }
}

/// φ(z)/φ(0), λ·E and h at z = s/σ, with r = σ/λ.
///
/// The exponential of E is φ(z)/φ(u), u = z − r. With erfcx(x) = exp(x²)·erfc(x), the side u ≤ 0
/// needs φ(z) only: λ·E = ½·exp(−z²/2)·erfcx(−u/√2), h = √(2/π)/erfcx(−u/√2). The side u > 0 needs
/// exp(−u²/2) and exp(−r·(u + r/2)).
fn parts(z: f64, ratio: f64) -> (f64, f64, f64) {
    let u = z - ratio;
    if u <= 0.0 {
        let (normal, scaled) = ((-0.5 * z * z).exp(), erfcx(-u * FRAC_1_SQRT_2));
        return (normal, 0.5 * normal * scaled, 2.0 * NORMAL_PEAK / scaled);
    }
    let falling = (-ratio * (u + 0.5 * ratio)).exp();
    if FAR < u {
        return (0.0, falling, 0.0);
    }
    let tail = (-0.5 * u * u).exp();
    let cdf = 1.0 - 0.5 * tail * erfcx(u * FRAC_1_SQRT_2);
    (tail * falling, falling * cdf, tail * NORMAL_PEAK / cdf)
}

/// exp(x²)·erfc(x) for x ≥ 0, with a relative error below 10⁻⁴.
///
/// Below 2 by Abramowitz & Stegun (1964), *Handbook of Mathematical Functions*, 7.1.26; beyond by
/// the continued fraction 7.1.14.
fn erfcx(x: f64) -> f64 {
    if x < 2.0 {
        const A: [f64; 5] =
            [0.254_829_592, -0.284_496_736, 1.421_413_741, -1.453_152_027, 1.061_405_429];
        let t = (1.0 + 0.327_591_1 * x).recip();
        return t * (A[0] + t * (A[1] + t * (A[2] + t * (A[3] + t * A[4]))));
    }
    // The first six terms of the fraction, as one quotient.
    let y = x * x;
    let above = y * (y * (y + 10.0) + 21.75) + 6.0;
    let below = y * (y * (y + 10.5) + 26.25) + 13.125;
    FRAC_2_SQRT_PI * 0.5 * above / (x * below)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TYPICAL: PseudorangeError =
        PseudorangeError { sigma_m: 4.0, reflected: 0.3, extra_path_m: 40.0 };

    /// ∫ p ds over ±2 km is above one: the direct and reflected parts sum to 1 − ε, and the uniform
    /// density extends beyond its width W.
    #[test]
    fn the_density_sums_to_one() {
        let step_m = 0.05;
        let mass: f64 = (-40_000..40_000)
            .map(|k| TYPICAL.evaluate(f64::from(k) * step_m).density * step_m)
            .sum();
        let uniform = FAULT_SHARE / FAULT_WIDTH_M * 4_000.0;
        assert!((mass - uniform - (1.0 - FAULT_SHARE)).abs() < 1e-6, "{mass}");
    }

    /// A normal density of σ = 4 m at zero is 0.0997356 1/m; E there is
    /// exp(0.005)/40·Φ(−0.1) = 0.0251253·0.4601722 = 0.0115620 1/m; so
    /// p = 0.98·(0.7·0.0997356 + 0.3·0.0115620) + 0.00005 = 0.0718678.
    #[test]
    fn a_density_worked_by_hand() {
        let density = TYPICAL.evaluate(0.0).density;
        assert!((density - 0.071_867_8).abs() < 1e-6, "{density}");
    }

    /// λ at 30°, 20 m·0.75/0.5 = 30 m; near the zenith and below the mask its bounds, 10 m and
    /// 20 m·0.99/0.1 = 198 m at 5.7°.
    #[test]
    fn the_extra_path_worked_by_hand() {
        for (sine, expected_m) in [(0.5, 30.0), (0.99, 10.0), (0.1, 198.0)] {
            let path_m = extra_path_m(sine);
            assert!((path_m - expected_m).abs() < 1e-9, "{path_m} {expected_m}");
        }
    }

    #[test]
    fn late_signals_are_reflections_and_early_ones_are_not_excused() {
        let [early, on_time, late, wild] = [-40.0, 0.0, 40.0, 1e7].map(|s_m| TYPICAL.evaluate(s_m));
        assert!(0.9 < on_time.direct && late.direct < 0.01 && wild.direct < 1e-9);
        assert!(early.density < late.density, "{late:?} {early:?}");
        assert!(0.0 < late.slope && late.slope <= TYPICAL.extra_path_m.recip(), "{late:?}");
        assert_eq!((wild.slope, wild.curvature), (0.0, 0.0));
    }

    /// erfc of Abramowitz & Stegun, table 7.1, at ½, 1 and 2; for large x erfcx tends to 1/(x·√π).
    #[test]
    fn the_scaled_error_function_worked_apart() {
        for (x, erfc) in [(0.5, 0.479_500_122_2), (1.0, 0.157_299_207_1), (2.0, 0.004_677_734_98)] {
            let expected = erfc * f64::exp(x * x);
            assert!((erfcx(x) / expected - 1.0).abs() < 1e-4, "{} {expected}", erfcx(x));
        }
        assert!((erfcx(2.0 - 1e-12) / erfcx(2.0) - 1.0).abs() < 1e-4);
        assert!((erfcx(1e4) * 1e4 * std::f64::consts::PI.sqrt() - 1.0).abs() < 1e-8);
    }

    proptest! {
        #[test]
        fn the_slope_is_the_derivative(s_m in -60.0..200.0, sigma_m in 0.8..20.0) {
            let error = PseudorangeError { sigma_m, reflected: 0.4, extra_path_m: 25.0 };
            let h = 1e-4;
            let loss = |s_m: f64| -error.evaluate(s_m).density.ln();
            let central = (loss(s_m + h) - loss(s_m - h)) / (2.0 * h);
            let slope = error.evaluate(s_m).slope;
            prop_assert!((slope - central).abs() < 1e-4 + 2e-3 * slope.abs(), "{slope} {central}");
        }

        #[test]
        fn the_information_is_the_second_derivative(s_m in -60.0..200.0, sigma_m in 0.8..20.0) {
            let error = PseudorangeError { sigma_m, reflected: 0.4, extra_path_m: 25.0 };
            let h = 1e-3;
            let slope = |s_m: f64| error.evaluate(s_m).slope;
            let central = (slope(s_m + h) - slope(s_m - h)) / (2.0 * h);
            let at = error.evaluate(s_m);
            prop_assert!((at.information - central).abs() < 1e-3 + 5e-3 * central.abs());
            prop_assert!(at.information <= at.curvature + 1e-12);
        }

        #[test]
        fn the_density_alone_is_the_same(s_m in -60.0..200.0, sigma_m in 0.8..20.0) {
            let error = PseudorangeError { sigma_m, reflected: 0.4, extra_path_m: 25.0 };
            let ratio = error.density(s_m) / error.evaluate(s_m).density;
            prop_assert!((ratio - 1.0).abs() < 1e-14, "{ratio}");
        }

        #[test]
        fn the_curvature_is_never_negative(
            s_m in -1e4..1e4,
            sigma_m in 0.8..50.0,
            extra_path_m in EXTRA_PATH_MIN_M..120.0,
        ) {
            let at = PseudorangeError { sigma_m, reflected: 0.5, extra_path_m }.evaluate(s_m);
            prop_assert!(0.0 <= at.curvature && at.slope.is_finite() && 0.0 < at.density);
        }
    }
}
