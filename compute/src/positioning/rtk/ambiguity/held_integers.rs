//! The held integers of an epoch, decorrelated once for all searches of the epoch.

use nalgebra::DMatrix;

use crate::lambda::{Options, Separated, Separation};

use super::differences::DoubleDifference;
use super::joint::Joint;

/// Held integers of an epoch, decorrelated, with the search among all of them. Its memory is used
/// again.
#[derive(Debug)]
pub(super) struct HeldIntegers {
    separation: Separation,
    /// Arc, reference and integer of each entry; empty while nothing is decorrelated.
    entries: Vec<(usize, usize, Option<i64>)>,
    of_all: Separated,
}

impl HeldIntegers {
    /// Room for `size` integers; it grows for more.
    pub(super) fn with_capacity(size: usize) -> Self {
        let of_all = Separated { probability: 0.0, odds: 0.0, log_evidence: 0.0 };
        let separation = Separation::with_capacity(size);
        Self { separation, entries: Vec::with_capacity(size), of_all }
    }

    /// Forgets the integers: they are of another epoch.
    pub(super) fn forget(&mut self) {
        self.entries.clear();
    }

    /// Whether these are the integers of `pairs`.
    pub(super) fn are_of<'a>(&self, pairs: impl Iterator<Item = &'a DoubleDifference>) -> bool {
        !self.entries.is_empty() && pairs.map(entry).eq(self.entries.iter().copied())
    }

    /// Decorrelates the integers of the pairs `held`, whose ambiguities are those of `joint`, and
    /// searches among all of them. `None` where the search fails.
    pub(super) fn load(
        &mut self,
        pairs: &[DoubleDifference],
        held: &[usize],
        joint: &Joint,
        options: &Options,
    ) -> Option<Separated> {
        self.forget();
        let off = held.iter().map(|&i| Some(joint.estimate[3 + i] - pairs[i].known? as f64));
        let off: Vec<f64> = off.collect::<Option<_>>()?;
        let between = |i: usize, j: usize| joint.covariance[(3 + held[i], 3 + held[j])];
        let covariance = DMatrix::from_fn(held.len(), held.len(), between);
        self.separation.load(off.into_iter(), &covariance).ok()?;
        self.of_all = self.separation.with_all(options)?;
        self.entries.extend(held.iter().map(|&i| entry(&pairs[i])));
        Some(self.of_all)
    }

    /// ln of the density of all floats.
    pub(super) fn log_evidence(&self) -> f64 {
        self.of_all.log_evidence
    }

    /// Searches without the entries that `left_out` contains, see [`Separation::without`].
    pub(super) fn without(
        &mut self,
        left_out: impl Iterator<Item = Vec<usize>>,
        options: &Options,
    ) -> Option<Separated> {
        self.separation.without(left_out, options)
    }
}

fn entry(pair: &DoubleDifference) -> (usize, usize, Option<i64>) {
    (pair.arc, pair.reference, pair.known)
}
