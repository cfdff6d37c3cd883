//! How noisy what is received is, learnt from residuals.

use crate::snapshot::snapshot_fields;

/// Epochs that the noise learnt is a mean of.
const NOISE_EPOCHS: f64 = 20.0;
/// Epochs that the stated noise counts for.
const NOISE_PRIOR_EPOCHS: f64 = 2.0;
/// Factors on the stated noise, lest few satellites or a street say nonsense.
const NOISE_SCALES: std::ops::RangeInclusive<f64> = 0.25..=4.0;
/// A normal variable's standard deviation over its median magnitude.
const NORMAL_OVER_MEDIAN: f64 = 1.482_6;

/// Standard deviations seen over those stated.
///
/// Receivers differ by a factor of five for the same C/N0. m = 1.4826·median∣s∣, s the whitened
/// residuals of all groups, widened for the numbers they have determined; the scale's square is a
/// running mean of m² that begins with one.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseScale {
    /// The factor.
    pub(super) value: f64,
    /// Epochs it was learnt from.
    learnt: f64,
}

snapshot_fields!(NoiseScale { value, learnt });

impl NoiseScale {
    /// As stated.
    pub(super) const fn stated() -> Self {
        Self { value: 1.0, learnt: 0.0 }
    }

    /// Takes the residuals of one epoch, which have determined so many numbers.
    pub(super) fn learn(&mut self, misses: &mut [f64], determined: usize) {
        let n = misses.len();
        if n < 2 * determined {
            return;
        }
        let (_, median, _) = misses.select_nth_unstable_by(n / 2, f64::total_cmp);
        let freedom = n as f64 / (n - determined) as f64;
        let stated = self.value.powi(2);
        let seen = (*median * NORMAL_OVER_MEDIAN).powi(2) * stated * freedom;
        self.learnt = (self.learnt + 1.0).min(NOISE_EPOCHS);
        let mean = stated + (seen - stated) / (self.learnt + NOISE_PRIOR_EPOCHS);
        self.value = mean.sqrt().clamp(*NOISE_SCALES.start(), *NOISE_SCALES.end());
    }
}
