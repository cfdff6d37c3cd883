//! The search for the held integers without one satellite, for their confirmation.

use nalgebra::DMatrix;

use crate::gnss::SatelliteId;
use crate::lambda::{Options, Separated as Found, Separation};
use crate::positioning::rtk::observed::{Arcs, CarrierArc};

use super::acceptance::lambda_options;
use super::confirmation::Separated;
use super::differences::DoubleDifference;
use super::integers::{IntegerQuestion, IntegerSearch, may_be_integer};
use super::joint::Joint;

/// Upper bound of a log ratio of evidence, so that sums stay finite: such a model outweighs all
/// others.
const LOG_EVIDENCE_MOST: f64 = 100.0;

/// Held integers of an epoch, decorrelated, with the search among all of them. Its memory is used
/// again.
#[derive(Debug)]
pub(super) struct HeldIntegers {
    separation: Separation,
    /// Arc, reference and integer of each entry; empty while nothing is decorrelated.
    entries: Vec<(usize, usize, Option<i64>)>,
    of_all: Found,
}

impl HeldIntegers {
    /// Room for `size` integers; it grows for more.
    pub(super) fn with_capacity(size: usize) -> Self {
        let of_all = Found { probability: 0.0, odds: 0.0, log_evidence: 0.0 };
        let separation = Separation::with_capacity(size);
        Self { separation, entries: Vec::with_capacity(size), of_all }
    }

    /// Forgets the integers: they are of another epoch.
    pub(super) fn forget(&mut self) {
        self.entries.clear();
    }

    /// Whether these are the integers of `pairs`.
    fn are_of<'a>(&self, pairs: impl Iterator<Item = &'a DoubleDifference>) -> bool {
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
    ) -> Option<Found> {
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
}

fn entry(pair: &DoubleDifference) -> (usize, usize, Option<i64>) {
    (pair.arc, pair.reference, pair.known)
}

/// Searches for the held integers of an epoch without one satellite, after one decorrelation.
pub(crate) struct Separator<'a> {
    search: &'a mut IntegerSearch,
    arcs: &'a Arcs,
    question: &'a IntegerQuestion<'a>,
}

impl IntegerSearch {
    /// Decorrelates the ambiguities of the held integers, unless the search of this epoch has done
    /// so. `None` where there are too few of them.
    pub(crate) fn separator<'a>(
        &'a mut self,
        arcs: &'a Arcs,
        question: &'a IntegerQuestion<'a>,
    ) -> Option<Separator<'a>> {
        let IntegerQuestion { time, float, options, .. } = *question;
        let is_eligible = |arc: &CarrierArc| {
            arc.last == time && arc.held.is_some() && may_be_integer(arc, options)
        };
        let Self { differences, held, .. } = &mut *self;
        differences.form(arcs.list(), is_eligible, float);
        differences.pairs.retain(|pair| pair.known.is_some());
        if differences.pairs.len() < options.fixed_min {
            return None;
        }
        if !held.are_of(differences.pairs.iter()) {
            let (joint, all) = (differences.joint(float), differences.which(|_| true));
            let lambda = lambda_options(options, question.noise.scale);
            held.load(&differences.pairs, &all, &joint, &lambda)?;
        }
        Some(Separator { search: self, arcs, question })
    }
}

impl Separator<'_> {
    /// Searches without one satellite; `None` where too few ambiguities are left.
    pub(crate) fn without(&mut self, left_out: SatelliteId) -> Option<Separated> {
        let IntegerQuestion { noise, options, .. } = *self.question;
        let (list, pairs) = (self.arcs.list(), &self.search.differences.pairs);
        let is_left_out = |arc: usize| list[arc].satellite == left_out;
        let entries = (0..pairs.len()).filter(|&i| is_left_out(pairs[i].arc)).map(|i| vec![i]);
        let mut references: Vec<usize> = pairs.iter().map(|pair| pair.reference).collect();
        references.sort_unstable();
        references.dedup();
        let groups = references.into_iter().filter(|&reference| is_left_out(reference));
        let of =
            |reference| (0..pairs.len()).filter(|&i| pairs[i].reference == reference).collect();
        let lambda = lambda_options(options, noise.scale);
        let held = &mut self.search.held;
        let found = held.separation.without(entries.chain(groups.map(of)), &lambda)?;
        let log_evidence = found.log_evidence - held.of_all.log_evidence;
        let evidence = log_evidence.min(LOG_EVIDENCE_MOST).exp();
        Some(Separated { probability: found.probability, evidence })
    }
}
