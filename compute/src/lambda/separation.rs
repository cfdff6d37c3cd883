//! Known integers, tested by searches without some of the entries.
//!
//! All entries are decorrelated once. Each search leaves out some of these.

use nalgebra::DMatrix;

use crate::lambda::LambdaError;
use crate::lambda::reduction::Reduction;
use crate::lambda::resolver::Options;
use crate::lambda::search::{Search, SearchLimits, SearchOutcome};
use crate::lambda::validation::{log_evidence, odds_at_scale, posterior, ratio};

/// The result of a search without some of the entries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Separated {
    /// Posterior probability of the known integers.
    pub(crate) probability: f64,
    /// Odds of the known integers against the best ones: at most one.
    pub(crate) odds: f64,
    /// ln of the density of the floats that are left, summed over all integers.
    pub(crate) log_evidence: f64,
}

/// A decorrelated estimate with known integers. Its buffers are used again.
#[derive(Clone, Debug)]
pub(crate) struct Separation {
    whole: Reduction,
    part: Reduction,
    search: Search,
    weights: Vec<f64>,
}

impl Separation {
    /// Room for `size` entries; it grows for more.
    pub(crate) fn with_capacity(size: usize) -> Self {
        Self {
            whole: Reduction::with_capacity(size),
            part: Reduction::with_capacity(size),
            search: Search::with_capacity(size),
            weights: Vec::with_capacity(size),
        }
    }

    /// Decorrelates n floats minus their known integers, with a covariance of n×n.
    ///
    /// # Errors
    /// No entry, a covariance that is not positive definite, or one that is badly conditioned.
    pub(crate) fn load(
        &mut self,
        off: impl Iterator<Item = f64>,
        covariance: &DMatrix<f64>,
    ) -> Result<(), LambdaError> {
        self.whole.reduce(off, covariance.iter().copied())
    }

    /// Searches without the entries that `left_out` contains: an entry by its index, or a common
    /// reference of differences by the indices of all of these. `None` if fewer than
    /// `options.fixed_min` entries are left, or the search does not end.
    pub(crate) fn without(
        &mut self,
        left_out: impl Iterator<Item = impl IntoIterator<Item = usize>>,
        options: &Options,
    ) -> Option<Separated> {
        self.part.copy_from(&self.whole);
        for indices in left_out {
            self.weights.clear();
            self.weights.resize(self.whole.size(), 0.0);
            indices.into_iter().for_each(|i| self.weights[i] = 1.0);
            self.part.leave_out(&mut self.weights).ok()?;
        }
        separated(&self.part, &mut self.search, options)
    }

    /// Searches among all entries. `None` as for [`Self::without`].
    pub(crate) fn with_all(&mut self, options: &Options) -> Option<Separated> {
        separated(&self.whole, &mut self.search, options)
    }
}

/// Searches among the entries of a reduction.
fn separated(entries: &Reduction, search: &mut Search, options: &Options) -> Option<Separated> {
    if entries.size() < options.fixed_min.max(1) {
        return None;
    }
    let limits = SearchLimits { candidates: options.candidates.max(2), nodes: options.nodes_max };
    let outcome = search.run(entries, limits);
    let norms = search.norms();
    if matches!(outcome, SearchOutcome::LimitReached { .. }) || ratio(norms).is_none() {
        return None;
    }
    let variances = entries.variances();
    let of_best = posterior(norms, variances, options.scale);
    let log_evidence = log_evidence(norms[0], of_best, variances, options.scale);
    let own = entries.squared_norm();
    let best = norms[0].min(own);
    let odds = match options.scale {
        Some(scale) => odds_at_scale([own, best], entries.size(), scale),
        None => (0.5 * (best - own)).exp(),
    };
    Some(Separated { probability: of_best * odds, odds, log_evidence })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lambda::tests::{Random, options, squared_norm};
    use crate::lambda::{Partial, Resolver};

    /// Entries left out one at a time, two at a time, and as the reference of differences. The
    /// probability and evidence are those of a search among the entries that remain, differenced
    /// again.
    #[test]
    fn as_if_the_entries_had_never_been() {
        let mut random = Random(23);
        let (size, limits) = (9, Options { probability_min: 0.0, ..options() });
        for _ in 0..20 {
            let covariance = random.covariance(size, 0.08, 30.0);
            let float = random.float(&covariance);
            let mut separation = Separation::with_capacity(size);
            separation.load(float.iter().copied(), &covariance).unwrap();
            for left_out in [vec![vec![0]], vec![vec![3], vec![7]], vec![(2..size).collect()]] {
                let found = separation.without(left_out.iter().cloned(), &limits).unwrap();
                let alone = |i: &usize| !left_out.contains(&vec![*i]);
                let kept: Vec<usize> = (0..size).filter(alone).collect();
                // Without their reference the others are differences from entry 2.
                let is_reference = 1 < left_out[0].len();
                let rows = DMatrix::from_fn(size, size, |i, j| {
                    let minus = is_reference && 2 < i && j == 2;
                    f64::from(u8::from(i == j)) - f64::from(u8::from(minus))
                });
                let kept: Vec<usize> =
                    kept.into_iter().filter(|i| !(is_reference && *i == 2)).collect();
                let all = &rows * &covariance * rows.transpose();
                let moved = &rows * nalgebra::DVector::from_column_slice(&float);
                let n = kept.len();
                let part = DMatrix::from_fn(n, n, |i, j| all[(kept[i], kept[j])]);
                let floats: Vec<f64> = kept.iter().map(|&i| moved[i]).collect();
                let mut resolver = Resolver::with_capacity(size);
                let direct = resolver.resolve(&floats, &part, Partial::None, &limits).unwrap();
                let (best, norm) = (direct.probability.unwrap(), direct.squared_norm.unwrap());
                let own = squared_norm(&floats, &vec![0.0; n], &part);
                let known = best * (0.5 * (norm - own)).exp();
                assert!((found.probability - known).abs() < 1e-9, "{left_out:?}");
                let log_scale = n as f64 * std::f64::consts::TAU.ln() + part.determinant().ln();
                let log_evidence = -0.5 * (norm + log_scale) - best.ln();
                assert!((found.log_evidence - log_evidence).abs() < 1e-6, "{left_out:?}");
            }
        }
    }

    /// Known integers that are not the best have e^−7.5 of the probability of the best ones.
    #[test]
    fn a_probability_worked_by_hand() {
        let mut separation = Separation::with_capacity(2);
        let covariance = DMatrix::from_diagonal_element(2, 2, 0.04);
        // One entry is left, 0.8 off the known integer and −0.2 off the best one: norms 16 and 1.
        separation.load([0.1, 0.8].into_iter(), &covariance).unwrap();
        let found = separation.without([[0]].into_iter(), &options()).unwrap();
        let all: f64 = [0.2_f64, 0.8, 1.2].map(|off| (-12.5 * off * off).exp()).iter().sum();
        assert!((found.probability - (-8_f64).exp() / all).abs() < 1e-6, "{found:?}");
        let density = all / (std::f64::consts::TAU * 0.04).sqrt();
        assert!((found.log_evidence - density.ln()).abs() < 1e-3, "{found:?}");
        assert!((found.odds - (-7.5_f64).exp()).abs() < 1e-12, "{found:?}");
        let strict = Options { fixed_min: 2, ..options() };
        assert_eq!(separation.without([[0]].into_iter(), &strict), None);
        // The first entry is nearest to its known integer, so the odds are those of the second.
        let of_both = separation.with_all(&strict).unwrap();
        assert!((of_both.odds - found.odds).abs() < 1e-12, "{of_both:?}");
        assert!(of_both.probability < 0.5);
    }
}
