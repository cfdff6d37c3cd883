//! The search for the held integers without one satellite, for their confirmation.

use crate::gnss::SatelliteId;
use crate::positioning::rtk::observed::{Arcs, CarrierArc};

use super::acceptance::lambda_options;
use super::confirmation::SearchWithout;
use super::integers::{IntegerQuestion, IntegerSearch, may_be_integer};

/// Upper bound of a log ratio of evidence, so that sums stay finite: such a model outweighs all
/// others.
const LOG_EVIDENCE_MOST: f64 = 100.0;

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
            let lambda = lambda_options(options, question.noise);
            held.load(&differences.pairs, &all, &joint, &lambda)?;
        }
        Some(Separator { search: self, arcs, question })
    }
}

impl Separator<'_> {
    /// Searches without one satellite; `None` where too few ambiguities are left.
    pub(crate) fn without(&mut self, left_out: SatelliteId) -> Option<SearchWithout> {
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
        let lambda = lambda_options(options, noise);
        let held = &mut self.search.held;
        let found = held.without(entries.chain(groups.map(of)), &lambda)?;
        let log_evidence = found.log_evidence - held.log_evidence();
        let evidence = log_evidence.min(LOG_EVIDENCE_MOST).exp();
        Some(SearchWithout { probability: found.probability, evidence })
    }
}
