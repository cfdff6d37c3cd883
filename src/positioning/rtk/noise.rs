//! How noisy what is received is, learnt from residuals.

use crate::lambda::KnownScale;
use crate::snapshot::snapshot_fields;

/// Epochs that the noise learnt is a mean of.
const NOISE_EPOCHS: f64 = 20.0;
/// Epochs that the stated noise counts for.
const NOISE_PRIOR_EPOCHS: f64 = 2.0;
/// Factors on the stated noise, lest few satellites or a street say nonsense.
const NOISE_SCALES: std::ops::RangeInclusive<f64> = 0.1..=4.0;
/// A normal variable's standard deviation over its median magnitude.
const NORMAL_OVER_MEDIAN: f64 = 1.482_6;

/// Residuals that would tell as much of the scale as is known of it, at the least.
pub(super) const FREEDOM_LEAST: f64 = 4.0;
/// At the most.
const FREEDOM_MOST: f64 = 64.0;
/// What the excess is before anything is seen: about that of the least freedom; and the epochs it
/// counts for.
const EXCESS_PRIOR: f64 = 2.0;
const EXCESS_PRIOR_EPOCHS: f64 = 5.0;
/// Degrees of freedom with less of which an epoch says nothing of its noise.
const LEFT_LEAST: f64 = 3.0;

/// The whitened residuals of a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Residuals {
    /// Sum of squares, each by its share of information.
    pub(super) square: f64,
    /// What the sum would be, were all as stated.
    pub(super) freedom: f64,
}

impl Residuals {
    /// Of nothing.
    pub(super) const NONE: Self = Self { square: 0.0, freedom: 0.0 };
}

/// What integers are judged by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct KnownNoise {
    pub(super) scale: KnownScale,
    /// What their odds are divided by.
    pub(super) doubt: f64,
}

/// Standard deviations seen over those stated, and how steady their factor is.
///
/// Receivers differ by a factor of five for the same C/N0. m = 1.4826·median∣s∣, s the whitened
/// residuals of all groups, widened for the numbers they have determined; the scale's square is a
/// running mean of m² that begins with one.
///
/// How well it is known is seen too: s², the mean square over its degrees of freedom k, has
/// variance 2/k about one where the scale is right, and more by an excess where it comes and goes,
/// or where residuals have tails. A scale that is inverse chi-square of ν degrees has an excess of
/// 2/(ν − 4).
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseScale {
    /// The factor.
    pub(super) value: f64,
    /// Epochs it was learnt from.
    learnt: f64,
    /// Mean of s².
    mean: f64,
    /// Relative variance of s² beyond 2/k.
    excess: f64,
}

snapshot_fields!(NoiseScale { value, learnt, mean, excess });

impl NoiseScale {
    /// As stated.
    pub(super) const fn stated() -> Self {
        Self { value: 1.0, learnt: 0.0, mean: 1.0, excess: EXCESS_PRIOR }
    }

    /// What the odds of integers are divided by: noise beyond the stated is no noise but
    /// reflections, whose errors are neither normal nor new at each epoch.
    ///
    /// Of what is stated at 80 to 90, 90 to 95 and 95 to 98 % in the simulated canyon, 38, 30 and
    /// 28 % are wrong without it; 21, 13 and 11 % with the fifth power.
    fn doubt(&self) -> f64 {
        self.value.powi(5).max(1.0)
    }

    /// What is known of the scale with the residuals of the epochs that the solution is made of.
    ///
    /// That they are less than stated counts; that they are more is no noise, see [`Self::doubt`].
    pub(super) fn known(&self, residuals: &Residuals) -> KnownNoise {
        let freedom = self.freedom() + residuals.freedom;
        let variance = (self.freedom() + residuals.square) / freedom;
        let scale = KnownScale { freedom, variance: variance.min(1.0) };
        KnownNoise { scale, doubt: self.doubt() }
    }

    /// ν: the residuals that would tell as much of the scale as is known of it.
    fn freedom(&self) -> f64 {
        match 0.0 < self.excess {
            true => (4.0 + 2.0 / self.excess).clamp(FREEDOM_LEAST, FREEDOM_MOST),
            false => FREEDOM_MOST,
        }
    }

    /// Takes the residuals of one epoch, which have determined so many numbers.
    pub(super) fn learn(&mut self, misses: &mut [f64], determined: f64) {
        let n = misses.len();
        let left = n as f64 - determined;
        if left < LEFT_LEAST {
            return;
        }
        let square = misses.iter().map(|miss| miss * miss).sum::<f64>() / left;
        let (_, median, _) = misses.select_nth_unstable_by(n / 2, f64::total_cmp);
        let freedom = n as f64 / left;
        let stated = self.value.powi(2);
        let seen = (*median * NORMAL_OVER_MEDIAN).powi(2) * stated * freedom;
        self.learnt = (self.learnt + 1.0).min(NOISE_EPOCHS);
        let epochs = self.learnt + EXCESS_PRIOR_EPOCHS;
        self.mean += (square - self.mean) / epochs;
        // What is less than stated does no harm, if only it is steady.
        let usual = self.mean.clamp(f64::EPSILON, 1.0);
        let excess = (square / usual - 1.0).powi(2) - 2.0 / left;
        self.excess += (excess - self.excess) / epochs;
        let mean = stated + (seen - stated) / (self.learnt + NOISE_PRIOR_EPOCHS);
        self.value = mean.sqrt().clamp(*NOISE_SCALES.start(), *NOISE_SCALES.end());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Magnitudes of nine standard normal residuals, which have determined one number.
    fn misses(scale: f64) -> Vec<f64> {
        let quantiles = [0.0697, 0.2104, 0.3549, 0.5062, 0.6682, 0.8463, 1.0503, 1.3013, 1.6629];
        quantiles.map(|quantile| 1.06 * scale * quantile).to_vec()
    }

    /// Five residuals' worth of one and fifteen of a third: twenty of a half. Residuals beyond the
    /// stated widen nothing.
    #[test]
    fn residuals_tell_the_scale() {
        let noise = NoiseScale::stated();
        let known = noise.known(&Residuals { square: 5.0, freedom: 15.0 }).scale;
        assert_eq!((known.freedom, known.variance), (20.0, 0.5));
        let known = noise.known(&Residuals { square: 30.0, freedom: 15.0 }).scale;
        assert_eq!((known.freedom, known.variance), (20.0, 1.0));
        let known = noise.known(&Residuals::NONE).scale;
        assert_eq!((known.freedom, known.variance), (5.0, 1.0));
    }

    fn learnt(scales: impl Iterator<Item = f64>) -> NoiseScale {
        let mut noise = NoiseScale::stated();
        for scale in scales {
            noise.learn(&mut misses(scale / noise.value), 1.0);
        }
        noise
    }

    /// As stated, or steadily a third of it: the scale is known as well as can be. Half of the epochs
    /// at four times the rest, or one residual of nine a hundred sigmas: little.
    #[test]
    fn a_steady_scale_is_known_well() {
        for scale in [1.0, 1.0 / 3.0] {
            let noise = learnt(std::iter::repeat_n(scale, 200));
            assert!((noise.value / scale - 1.0).abs() < 0.15, "{noise:?}");
            assert!(40.0 < noise.freedom(), "{noise:?}");
        }
        assert_eq!(NoiseScale::stated().freedom(), 5.0);
        assert_eq!(NoiseScale::stated().doubt(), 1.0);
        let doubled = learnt(std::iter::repeat_n(2.0, 200));
        assert!((doubled.value / 2.0 - 1.0).abs() < 0.15, "{doubled:?}");
        assert_eq!(doubled.doubt(), doubled.value.powi(5));
        let silent = learnt(std::iter::repeat_n(0.0, 20_000));
        assert!(silent.freedom().is_finite() && silent.excess.is_finite(), "{silent:?}");
        let uneasy = learnt((0..200).map(|k| if k % 2 == 0 { 4.0 } else { 1.0 }));
        assert!(uneasy.freedom() < 9.0, "{uneasy:?}");
        let mut tailed = NoiseScale::stated();
        for _ in 0..200 {
            let mut with_one = misses(1.0 / tailed.value);
            with_one[3] = 100.0;
            tailed.learn(&mut with_one, 1.0);
        }
        assert!(tailed.freedom() < 9.0, "{tailed:?}");
    }
}
