//! The scale of the measurement noise, learnt from residuals.

use crate::lambda::KnownScale;
use crate::snapshot::snapshot_fields;

/// Length of the running mean (epochs).
const NOISE_EPOCHS: f64 = 20.0;
/// Weight of the a-priori noise in the running mean (epochs).
const NOISE_PRIOR_EPOCHS: f64 = 2.0;
/// Bounds of the learnt noise factor, so that few satellites or multipath cannot drive it.
const NOISE_SCALES: std::ops::RangeInclusive<f64> = 0.1..=4.0;
/// Standard deviation of a normal variable, divided by its median magnitude.
const NORMAL_OVER_MEDIAN: f64 = 1.482_6;

/// Lower bound of ν, the degrees of freedom of the noise scale.
pub(crate) const FREEDOM_LEAST: f64 = 4.0;
/// Upper bound of ν.
const FREEDOM_MOST: f64 = 64.0;
/// Excess variance before any epoch: ν = 5, near its lower bound.
const EXCESS_PRIOR: f64 = 2.0;
/// Weight of the a-priori mean and excess variance in their running means (epochs).
const EXCESS_PRIOR_EPOCHS: f64 = 5.0;
/// Epochs with fewer redundant residuals do not update the scale.
const LEFT_LEAST: f64 = 3.0;

/// The whitened residuals of a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Residuals {
    /// Sum of squares, each times its independent share.
    pub(crate) square: f64,
    /// Its expectation if the a-priori noise is right.
    pub(crate) freedom: f64,
}

impl Residuals {
    /// No residuals.
    pub(crate) const NONE: Self = Self { square: 0.0, freedom: 0.0 };
}

/// Ratio of observed to a-priori standard deviation, and its variance over time.
///
/// Receivers differ by a factor of five at the same C/N0. m = 1.4826·median∣s∣, with s the whitened
/// residuals of all groups, scaled up for the parameters that they determined. The square of the
/// scale is a running mean of m² that starts at one.
///
/// The uncertainty of the scale is estimated too. s² is the mean square over its degrees of freedom
/// k. It has the variance 2/k about one if the scale is right, and a larger one if the scale varies
/// or residuals have heavy tails. An inverse chi-square scale of ν degrees of freedom has an excess
/// of 2/(ν − 4).
#[derive(Clone, Copy, Debug)]
pub(crate) struct NoiseScale {
    /// The factor.
    pub(crate) value: f64,
    /// Number of epochs it was learnt from, at most [`NOISE_EPOCHS`].
    learnt: f64,
    /// Mean of s².
    mean: f64,
    /// Relative variance of s² beyond 2/k.
    excess: f64,
}

snapshot_fields!(NoiseScale { value, learnt, mean, excess });

impl NoiseScale {
    /// The a-priori noise.
    pub(crate) const fn stated() -> Self {
        Self { value: 1.0, learnt: 0.0, mean: 1.0, excess: EXCESS_PRIOR }
    }

    /// The scale, updated with the residuals of the epochs in the solution. Residuals below the
    /// a-priori noise lower it. Larger ones do not raise it: the learnt factor has already widened
    /// the variances of the float ambiguities.
    pub(crate) fn known(&self, residuals: &Residuals) -> KnownScale {
        let freedom = self.freedom() + residuals.freedom;
        let variance = (self.freedom() + residuals.square) / freedom;
        KnownScale { freedom, variance: variance.min(1.0) }
    }

    /// Degrees of freedom ν of the scale.
    fn freedom(&self) -> f64 {
        match 0.0 < self.excess {
            true => (4.0 + 2.0 / self.excess).clamp(FREEDOM_LEAST, FREEDOM_MOST),
            false => FREEDOM_MOST,
        }
    }

    /// Factor on the covariance of a position from pseudoranges of this noise. It contains the mean
    /// square of residuals above the a-priori noise, and ν/(ν − 2), the variance of a Student's t,
    /// because the scale is uncertain.
    pub(crate) fn variance_factor(&self) -> f64 {
        let freedom = self.freedom();
        self.mean.max(1.0) * freedom / (freedom - 2.0)
    }

    /// Probability that a horizontal error of this noise is within `radius` (m), given the largest
    /// variance along a horizontal direction if the learnt scale were right (m²).
    ///
    /// P = 1 − (1 + R²/(νs²σ²))^(−ν/2), R the radius: two coordinates of a Student's t, because the
    /// scale is uncertain. s² is the mean square of the residuals, at least one.
    ///
    /// Source: Kotz & Nadarajah (2004), *Multivariate t distributions and their applications*:
    /// r²/2σ² has the F distribution with 2 and ν degrees of freedom, whose tail has this form.
    pub(crate) fn probability_within(&self, radius_m: f64, variance_m2: f64) -> f64 {
        let freedom = self.freedom();
        let scaled = freedom * self.mean.max(1.0) * variance_m2;
        1.0 - (1.0 + radius_m.powi(2) / scaled).powf(-0.5 * freedom)
    }

    /// Learns from the whitened residuals of one epoch, which determined `determined` parameters.
    pub(crate) fn learn(&mut self, residuals: &mut [f64], determined: f64) {
        let n = residuals.len();
        let left = n as f64 - determined;
        if left < LEFT_LEAST {
            return;
        }
        let square = residuals.iter().map(|residual| residual * residual).sum::<f64>() / left;
        let (_, median, _) = residuals.select_nth_unstable_by(n / 2, f64::total_cmp);
        let freedom = n as f64 / left;
        let present = self.value.powi(2);
        let seen = (*median * NORMAL_OVER_MEDIAN).powi(2) * present * freedom;
        self.learnt = (self.learnt + 1.0).min(NOISE_EPOCHS);
        let epochs = self.learnt + EXCESS_PRIOR_EPOCHS;
        self.mean += (square - self.mean) / epochs;
        // Noise below the a-priori noise is harmless as long as it is steady.
        let usual = self.mean.clamp(f64::EPSILON, 1.0);
        let excess = (square / usual - 1.0).powi(2) - 2.0 / left;
        self.excess += (excess - self.excess) / epochs;
        let mean = present + (seen - present) / (self.learnt + NOISE_PRIOR_EPOCHS);
        self.value = mean.sqrt().clamp(*NOISE_SCALES.start(), *NOISE_SCALES.end());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Magnitudes of nine standard normal residuals, which have determined one number.
    fn residuals(scale: f64) -> Vec<f64> {
        let quantiles = [0.0697, 0.2104, 0.3549, 0.5062, 0.6682, 0.8463, 1.0503, 1.3013, 1.6629];
        quantiles.map(|quantile| 1.06 * scale * quantile).to_vec()
    }

    /// Prior: variance factor 1 with 5 degrees of freedom. 15 more with a sum of squares of 5 give
    /// (5 + 5)/20 = 1/2. Residuals larger than stated do not raise the factor above 1.
    #[test]
    fn residuals_tell_the_scale() {
        let noise = NoiseScale::stated();
        let known = noise.known(&Residuals { square: 5.0, freedom: 15.0 });
        assert_eq!((known.freedom, known.variance), (20.0, 0.5));
        let known = noise.known(&Residuals { square: 30.0, freedom: 15.0 });
        assert_eq!((known.freedom, known.variance), (20.0, 1.0));
        let known = noise.known(&Residuals::NONE);
        assert_eq!((known.freedom, known.variance), (5.0, 1.0));
    }

    fn learnt(scales: impl Iterator<Item = f64>) -> NoiseScale {
        let mut noise = NoiseScale::stated();
        for scale in scales {
            noise.learn(&mut residuals(scale / noise.value), 1.0);
        }
        noise
    }

    /// Noise as expected, or steadily a third of it: ν reaches its upper bound. Half of the epochs
    /// with four times the noise, or one residual of nine at 100 σ: ν is small.
    #[test]
    fn a_steady_scale_is_known_well() {
        for scale in [1.0, 1.0 / 3.0] {
            let noise = learnt(std::iter::repeat_n(scale, 200));
            assert!((noise.value / scale - 1.0).abs() < 0.15, "{noise:?}");
            assert!(40.0 < noise.freedom(), "{noise:?}");
        }
        assert_eq!(NoiseScale::stated().freedom(), 5.0);
        // ν = 5.
        assert!((NoiseScale::stated().variance_factor() - 5.0 / 3.0).abs() < 1e-12);
        // (1 + 100/(5·5))^(−5/2) = 5^(−5/2); of many degrees of freedom it would be e^(−10).
        let within = NoiseScale::stated().probability_within(0.1, 5e-4);
        assert!((within - (1.0 - 5_f64.powf(-2.5))).abs() < 1e-12, "{within}");
        let doubled = learnt(std::iter::repeat_n(2.0, 200));
        assert!((doubled.value / 2.0 - 1.0).abs() < 0.15, "{doubled:?}");
        let silent = learnt(std::iter::repeat_n(0.0, 20_000));
        assert!(silent.freedom().is_finite() && silent.excess.is_finite(), "{silent:?}");
        assert!((doubled.variance_factor() - 1.0).abs() < 0.3, "{doubled:?}");
        let uneasy = learnt((0..200).map(|k| if k % 2 == 0 { 4.0 } else { 1.0 }));
        assert!(uneasy.freedom() < 9.0 && 1.3 < uneasy.variance_factor(), "{uneasy:?}");
        let mut tailed = NoiseScale::stated();
        for _ in 0..200 {
            let mut with_one = residuals(1.0 / tailed.value);
            with_one[3] = 100.0;
            tailed.learn(&mut with_one, 1.0);
        }
        assert!(tailed.freedom() < 9.0, "{tailed:?}");
    }
}
