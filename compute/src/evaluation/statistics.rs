//! Statistics of a sample of error magnitudes.

use serde::Serialize;

/// Moments and percentiles of error magnitudes (m).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// Number of values.
    pub n: usize,
    /// Mean (m).
    pub mean: f64,
    /// Sample standard deviation with n − 1 (m); 0 for a single value.
    pub std: f64,
    /// Root mean square (m).
    pub rms: f64,
    /// Median (m).
    pub p50: f64,
    /// 68th percentile (m).
    pub p68: f64,
    /// 95th percentile (m).
    pub p95: f64,
    /// Largest value (m).
    pub max: f64,
}

impl ErrorStatistics {
    /// Statistics of a sample; `None` if it is empty.
    pub fn of(values: &[f64]) -> Option<Self> {
        let sorted = sorted(values);
        let n = values.len();
        let max = *sorted.last()?;
        let mean = values.iter().sum::<f64>() / n as f64;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Some(Self {
            n,
            mean,
            std: if n == 1 { 0.0 } else { (squares / (n - 1) as f64).sqrt() },
            rms: root_mean_square(values),
            p50: percentile(&sorted, 50.0),
            p68: percentile(&sorted, 68.0),
            p95: percentile(&sorted, 95.0),
            max,
        })
    }
}

/// Root mean square √(Σx²/n).
pub(super) fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// A sorted copy.
pub(super) fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted
}

/// Percentile (0 … 100) of a sorted sample that is not empty, linear between values: definition 7
/// of Hyndman & Fan (1996), rank p/100·(n − 1).
pub(super) fn percentile(sorted: &[f64], percent: f64) -> f64 {
    let rank = percent / 100.0 * (sorted.len() - 1) as f64;
    let below = rank.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (sorted[above] - sorted[below]) * (rank - below as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn five_values_worked_by_hand() {
        let s = ErrorStatistics::of(&[4.0, 1.0, 2.0, 5.0, 3.0]).unwrap();
        assert_eq!((s.n, s.mean, s.p50, s.max), (5, 3.0, 3.0, 5.0));
        // Deviations −2 … 2: variance 10/4; squares 55/5; ranks 2.72 and 3.8.
        assert!((s.std - 2.5_f64.sqrt()).abs() < 1e-12);
        assert!((s.rms - 11_f64.sqrt()).abs() < 1e-12);
        assert!((s.p68 - 3.72).abs() < 1e-12 && (s.p95 - 4.8).abs() < 1e-12);
    }

    #[test]
    fn one_value_and_none() {
        let s = ErrorStatistics::of(&[2.0]).unwrap();
        assert_eq!((s.std, s.p95, s.rms), (0.0, 2.0, 2.0));
        assert_eq!(ErrorStatistics::of(&[]), None);
    }
}
