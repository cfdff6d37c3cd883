//! Double differences of the arcs whose ambiguities may be integers.

use crate::gnss::Constellation;
use crate::positioning::differencing::DifferenceGroup;
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
    /// The reference of each group.
    references: Vec<(DifferenceGroup, usize)>,
}

impl Differences {
    /// Forms the double differences of the eligible arcs, each against the reference satellite of
    /// its group. That is the highest satellite with a proven integer, else the highest with an
    /// integer, else the highest of all.
    pub(super) fn form(
        &mut self,
        arcs: &[CarrierArc],
        is_eligible: impl Fn(&CarrierArc) -> bool,
        float: &FloatSolution,
    ) {
        self.indices.clear();
        self.indices
            .extend(arcs.iter().map(|arc| float.index(arc.variable).filter(|_| is_eligible(arc))));
        let eligible = || (0..arcs.len()).filter(|&arc| self.indices[arc].is_some());
        let rank = |arc: &CarrierArc| (arc.is_proven, arc.held.is_some(), arc.elevation_rad);
        self.references.clear();
        for arc in eligible() {
            let group = arcs[arc].group();
            match self.references.iter_mut().find(|(known, _)| *known == group) {
                Some((_, best)) if rank(&arcs[*best]) < rank(&arcs[arc]) => *best = arc,
                Some(_) => {}
                None => self.references.push((group, arc)),
            }
        }
        self.pairs.clear();
        for arc in eligible() {
            let (own, group) = (&arcs[arc], arcs[arc].group());
            let of_group = self.references.iter().find(|(known, _)| *known == group);
            let &(_, reference) = of_group.expect("each eligible arc has put its group there");
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

    /// The sets of pairs to search, in this order, until integers are found: the groups with one
    /// wavelength, if there are others; all groups; then all groups but one, for each group.
    ///
    /// Receivers of different manufacturers may disagree about the phase of one signal.
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

/// Whether all arcs of this arc's group have one wavelength: common cycles are then an offset.
fn has_one_wavelength(arc: &CarrierArc) -> bool {
    arc.satellite.constellation != Constellation::Glonass
}
