//! A posterior on a grid of one parameter.

use crate::snapshot::snapshot_fields;

/// Unnormalised log probabilities of `N` equally spaced values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid<const N: usize> {
    log: [f64; N],
}

snapshot_fields!(generic [const N: usize] Grid<N> { log });

impl<const N: usize> Grid<N> {
    /// The prior, by index.
    pub(super) fn new(prior: impl Fn(f64) -> f64) -> Self {
        Self { log: std::array::from_fn(|index| prior(index as f64)) }
    }

    /// Lets the evidence fade towards the prior: the fraction `kept` of it stays.
    pub(super) fn fade(&mut self, kept: f64, prior: impl Fn(f64) -> f64) {
        for (index, log) in self.log.iter_mut().enumerate() {
            *log = kept * *log + (1.0 - kept) * prior(index as f64);
        }
    }

    /// Adds the log likelihood of each index.
    pub(super) fn update(&mut self, log_likelihood: impl Fn(f64) -> f64) {
        for (index, log) in self.log.iter_mut().enumerate() {
            *log += log_likelihood(index as f64);
        }
    }

    /// The likelihoods, the largest of which is one.
    pub(super) fn relative(&self) -> [f64; N] {
        let top = self.log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        self.log.map(|log| (log - top).exp())
    }

    /// Mean and standard deviation of the index.
    pub(super) fn moments(&self) -> (f64, f64) {
        let top = self.log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
        for (index, log) in self.log.iter().enumerate() {
            let (index, probability) = (index as f64, (log - top).exp());
            sum += probability;
            first += probability * index;
            second += probability * index * index;
        }
        let mean = first / sum;
        (mean, (second / sum - mean * mean).max(0.0).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three equal values have mean 1 and variance 2/3. With evidence for the last one they are 2
    /// and 0, and after complete fading the prior's again.
    #[test]
    fn moments_follow_the_evidence_and_fade() {
        let flat = |_: f64| 0.0;
        let mut grid = Grid::<3>::new(flat);
        let (mean, deviation) = grid.moments();
        assert!((mean - 1.0).abs() < 1e-12 && (deviation - (2.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        grid.update(|index| 100.0 * index);
        assert!((grid.moments().0 - 2.0).abs() < 1e-12);
        grid.fade(0.0, flat);
        assert!((grid.moments().0 - 1.0).abs() < 1e-12);
    }
}
