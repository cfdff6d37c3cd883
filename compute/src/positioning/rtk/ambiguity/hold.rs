//! Held integers: the only file that sets and drops them.

use crate::positioning::rtk::observed::{Arcs, HeldInteger};
use crate::snapshot::snapshot_fields;

/// Upper bound of the probability of held integers: a cycle slip may be undetected.
const CERTAIN: f64 = 1.0 - 1e-6;

/// Number of epochs in a row that prove an integer if the search of the last one is nearly certain.
/// Multipath of phases changes within seconds, and integers do not.
pub(crate) const FOUND_EPOCHS: u32 = 2;
/// From this probability on, a search is nearly certain.
pub(crate) const NEARLY_CERTAIN: f64 = 0.9999;

/// The history of the held integers.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HoldState {
    /// Consecutive epochs that found the same integers.
    pub(crate) consecutive_epochs: u32,
    pub(crate) probability: f64,
    /// Factor on `probability`, from the searches without one satellite.
    pub(crate) reliability: f64,
    pub(crate) ratio: Option<f64>,
    pub(crate) success_rate: Option<f64>,
    /// Number of the current period: how many times all integers have been dropped.
    pub(crate) period: u32,
    /// The last period whose integers were found to be wrong.
    pub(crate) refuted: Option<u32>,
    /// Whether the integers have been confirmed in this period.
    pub(crate) was_confirmed: bool,
    /// Number of datums so far.
    pub(crate) datums: u32,
}

snapshot_fields!(HoldState {
    consecutive_epochs,
    probability,
    reliability,
    ratio,
    success_rate,
    period,
    refuted,
    was_confirmed,
    datums,
});

/// The integers that a search found.
pub(crate) struct Found {
    pub(crate) probability: f64,
    pub(crate) ratio: Option<f64>,
    pub(crate) success_rate: f64,
}

impl HoldState {
    /// Holds the integers that the search of this epoch found: arc, reference and difference of
    /// each. A reference without an integer begins a datum.
    pub(crate) fn hold(
        &mut self,
        arcs: &mut Arcs,
        found: &[(usize, usize, i64)],
        proven_after: u32,
    ) {
        let mut references: Vec<usize> = found.iter().map(|(_, reference, _)| *reference).collect();
        references.sort_unstable();
        references.dedup();
        for reference in references {
            let zero = arcs.list()[reference].held.unwrap_or_else(|| {
                self.datums += 1;
                HeldInteger { datum: self.datums, cycles: 0 }
            });
            arcs.find(reference, zero, proven_after);
        }
        for &(arc, reference, integer) in found {
            let zero = arcs.list()[reference].held.expect("references have one now");
            let cycles = zero.cycles + integer;
            arcs.find(arc, HeldInteger { cycles, ..zero }, proven_after);
        }
    }

    /// Records that a search of all ambiguities found the integers.
    pub(crate) fn found(&mut self, found: &Found) {
        self.consecutive_epochs += 1;
        self.probability = found.probability.min(CERTAIN);
        (self.ratio, self.success_rate) = (found.ratio, Some(found.success_rate));
    }

    /// Records that a search of all ambiguities found no integers.
    pub(crate) fn missed(&mut self) {
        self.consecutive_epochs = 0;
    }

    /// Drops all integers, because they are wrong or because too few are left.
    pub(crate) fn drop_all(&mut self, arcs: &mut Arcs, are_wrong: bool) {
        arcs.drop_held();
        let refuted = if are_wrong { Some(self.period) } else { self.refuted };
        let (period, datums) = (self.period + 1, self.datums);
        *self = Self { period, refuted, datums, ..Self::default() };
    }
}
