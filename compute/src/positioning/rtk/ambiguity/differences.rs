//! Double differences of the arcs whose ambiguities may be integers.

use crate::gnss::Constellation;
use crate::positioning::rtk::observed::CarrierArc;

use super::float::FloatSolution;
use super::joint::Joint;

/// A double difference against the reference of its group, as indices of arcs.
#[derive(Clone, Copy, Debug)]
pub(super) struct DoubleDifference {
    pub(super) arc: usize,
    pub(super) reference: usize,
    /// Its integer, if both arcs hold one of the same datum.
    pub(super) known: Option<i64>,
    /// Whether it is known and both arcs are proven.
    pub(super) is_proven: bool,
}

/// The double differences of an epoch; their memory is used again.
#[derive(Debug, Default)]
pub(super) struct Differences {
    pub(super) pairs: Vec<DoubleDifference>,
    /// Index of each arc's ambiguity in the float solution; `None` if the arc is not eligible.
    indices: Vec<Option<usize>>,
}

impl Differences {
    /// Forms the double differences of the eligible arcs, each against the reference satellite of
    /// its group: the highest of those with a proven integer, else with an integer, else of all.
    pub(super) fn form(
        &mut self,
        arcs: &[CarrierArc],
        is_eligible: impl Fn(&CarrierArc) -> bool,
        float: &FloatSolution,
    ) {
        self.indices.clear();
        self.indices
            .extend(arcs.iter().map(|arc| float.index(arc.variable).filter(|_| is_eligible(arc))));
        self.pairs.clear();
        for (arc, own) in arcs.iter().enumerate() {
            if self.indices[arc].is_none() {
                continue;
            }
            let rank = |arc: &CarrierArc| (arc.is_proven, arc.held.is_some(), arc.elevation_rad);
            let mut reference = arc;
            for (other, candidate) in arcs.iter().enumerate() {
                let is_better = rank(&arcs[reference]) < rank(candidate);
                if is_better && self.indices[other].is_some() && candidate.group() == own.group() {
                    reference = other;
                }
            }
            if reference != arc {
                let both = own.held.zip(arcs[reference].held);
                let known = both.and_then(|(own, zero)| own.minus(zero));
                let are_proven = own.is_proven && arcs[reference].is_proven;
                let is_proven = are_proven && known.is_some();
                self.pairs.push(DoubleDifference { arc, reference, known, is_proven });
            }
        }
    }

    /// Position and double-differenced ambiguities of the float solution, with their joint
    /// covariance.
    pub(super) fn joint(&self, float: &FloatSolution) -> Joint {
        let index = |arc: usize| self.indices[arc].expect("arcs of double differences have one");
        let pairs: Vec<_> =
            self.pairs.iter().map(|pair| (index(pair.arc), index(pair.reference))).collect();
        Joint::of_differences(float, &pairs)
    }

    /// Indices of the pairs that `is_wanted` admits.
    pub(super) fn which(&self, is_wanted: impl Fn(&DoubleDifference) -> bool) -> Vec<usize> {
        (0..self.pairs.len()).filter(|&i| is_wanted(&self.pairs[i])).collect()
    }

    /// The sets of pairs to search, one after another until integers are found: groups with one
    /// wavelength, if there are others; all; and all but one group.
    ///
    /// Receivers of different makers may not agree on the phase of one signal.
    pub(super) fn subsets(&self, arcs: &[CarrierArc], fixed_min: usize) -> Vec<Vec<usize>> {
        let group = |pair: &DoubleDifference| arcs[pair.arc].group();
        let mut groups: Vec<_> = self.pairs.iter().map(group).collect();
        groups.sort_unstable();
        groups.dedup();
        let mut subsets: Vec<Vec<usize>> = Vec::new();
        let mut add = |wanted: Vec<usize>| {
            if fixed_min <= wanted.len() && !subsets.contains(&wanted) {
                subsets.push(wanted);
            }
        };
        add(self.which(|pair| has_one_wavelength(&arcs[pair.arc])));
        add(self.which(|_| true));
        groups.iter().for_each(|out| add(self.which(|pair| group(pair) != *out)));
        subsets
    }
}

/// Whether all arcs of the group have one wavelength, so that cycles common to all are an offset.
fn has_one_wavelength(arc: &CarrierArc) -> bool {
    arc.satellite.constellation != Constellation::Glonass
}
