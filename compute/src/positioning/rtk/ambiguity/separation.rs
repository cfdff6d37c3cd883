//! The search for the held integers without one satellite, for their confirmation.

use nalgebra::DMatrix;

use crate::gnss::SatelliteId;
use crate::positioning::rtk::observed::{Arcs, CarrierArc};

use super::acceptance::lambda_options;
use super::confirmation::{Separated, Verdict};
use super::integers::{IntegerQuestion, IntegerSearch, may_be_integer};
use super::joint::{bonferroni, scale_odds};

/// Integers found without one satellite count if they are more likely right than wrong.
const LIKELY: f64 = 0.5;

impl IntegerSearch {
    /// Decorrelates the ambiguities of the held integers, for [`Self::separate`]. Returns whether
    /// there are enough of them.
    pub(crate) fn prepare_separation(
        &mut self,
        arcs: &Arcs,
        question: &IntegerQuestion<'_>,
    ) -> bool {
        let IntegerQuestion { time, float, options, .. } = *question;
        let is_eligible = |arc: &CarrierArc| {
            arc.last == time && arc.held.is_some() && may_be_integer(arc, options)
        };
        self.differences.form(arcs.list(), is_eligible, float);
        self.differences.pairs.retain(|pair| pair.known.is_some());
        let n = self.differences.pairs.len();
        if n < options.fixed_min {
            return false;
        }
        let joint = self.differences.joint(float);
        let known = self.differences.pairs.iter().filter_map(|pair| pair.known);
        let off = known.enumerate().map(|(i, known)| joint.estimate[3 + i] - known as f64);
        let covariance = DMatrix::from_fn(n, n, |i, j| joint.covariance[(3 + i, 3 + j)]);
        self.separation.load(off, &covariance).is_ok()
    }

    /// Searches without one satellite: its verdict on the held integers, whose probability is
    /// `prior`, and the probability that it gives to them. `None` where too few are left.
    ///
    /// It agrees if it finds them again. It contradicts them if other integers are likely, and
    /// likelier than the held ones in spite of their prior odds.
    pub(crate) fn separate(
        &mut self,
        arcs: &Arcs,
        (left_out, prior): (SatelliteId, f64),
        question: &IntegerQuestion<'_>,
    ) -> Option<Separated> {
        let IntegerQuestion { noise, options, .. } = *question;
        let (list, pairs) = (arcs.list(), &self.differences.pairs);
        let is_left_out = |arc: usize| list[arc].satellite == left_out;
        let entries = (0..pairs.len()).filter(|&i| is_left_out(pairs[i].arc)).map(|i| vec![i]);
        let mut references: Vec<usize> = pairs.iter().map(|pair| pair.reference).collect();
        references.sort_unstable();
        references.dedup();
        let groups = references.into_iter().filter(|&reference| is_left_out(reference));
        let of =
            |reference| (0..pairs.len()).filter(|&i| pairs[i].reference == reference).collect();
        let lambda = lambda_options(options, noise.scale);
        let found = self.separation.without(entries.chain(groups.map(of)), &lambda)?;
        let stated = bonferroni(noise.odds_divisor, found.probability);
        let verdict = if stated < LIKELY {
            Verdict::Silent
        } else if found.agrees {
            Verdict::Agrees
        } else if scale_odds(found.odds, prior) < LIKELY {
            Verdict::Contradicts
        } else {
            Verdict::Silent
        };
        Some(Separated { verdict, probability: stated * found.odds })
    }
}
