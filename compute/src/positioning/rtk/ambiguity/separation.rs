//! The search for the held integers without one satellite, for their confirmation.

use crate::gnss::SatelliteId;
use crate::lambda::{KnownScale, odds_at_scale};
use crate::positioning::rtk::observed::{Arcs, CarrierArc};

use super::acceptance::{any_integers, lambda_options};
use super::confirmation::{Separated, Verdict};
use super::integers::{IntegerQuestion, IntegerSearch, may_be_integer};
use super::joint::{Joint, bonferroni, condition, scale_odds};

/// Integers found without one satellite count if they are more likely right than wrong.
const LIKELY: f64 = 0.5;

impl IntegerSearch {
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
        let IntegerQuestion { time, float, noise, options } = *question;
        let list = arcs.list();
        let is_eligible = |arc: &CarrierArc| {
            let remains = arc.last == time && arc.satellite != left_out && arc.held.is_some();
            remains && may_be_integer(arc, options)
        };
        self.differences.form(list, is_eligible, float);
        self.differences.pairs.retain(|pair| pair.known.is_some());
        if self.differences.pairs.len() < options.fixed_min {
            return None;
        }
        let (joint, all) = (self.differences.joint(float), self.differences.which(|_| true));
        let lambda = any_integers(&lambda_options(options, noise.scale), all.len());
        let found = self.search(list, &joint, &all, &all, &lambda)?;
        let stated = bonferroni(noise.odds_divisor, found.probability?);
        let agrees = self.compare_with_known(&all)[1] == 0;
        let odds = match agrees {
            true => 1.0,
            false => self.odds_of_known(&joint, &all, found.squared_norm?, noise.scale)?,
        };
        let verdict = if stated < LIKELY {
            Verdict::Silent
        } else if agrees {
            Verdict::Agrees
        } else if scale_odds(odds, prior) < LIKELY {
            Verdict::Contradicts
        } else {
            Verdict::Silent
        };
        Some(Separated { verdict, probability: stated * odds })
    }

    /// Odds of the known integers of the pairs `all` against others of the squared norm `best`.
    fn odds_of_known(
        &self,
        joint: &Joint,
        all: &[usize],
        best: f64,
        scale: KnownScale,
    ) -> Option<f64> {
        let (_, own) = condition(joint, all, &self.known_values(all), &[])?;
        Some(odds_at_scale([own, best.min(own)], all.len(), scale))
    }
}
