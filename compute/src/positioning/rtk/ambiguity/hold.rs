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
    /// Epochs in a row whose search of all ambiguities found the same integers. It stays while held
    /// integers are accepted without such a search.
    pub(crate) epochs_in_a_row: u32,
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
    epochs_in_a_row,
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
            arcs.record_integer(reference, zero, proven_after);
        }
        for &(arc, reference, integer) in found {
            let zero = arcs.list()[reference].held.expect("references have one now");
            let cycles = zero.cycles + integer;
            arcs.record_integer(arc, HeldInteger { cycles, ..zero }, proven_after);
        }
    }

    /// Records that a search of all ambiguities found the integers.
    pub(crate) fn found(&mut self, found: &Found) {
        self.epochs_in_a_row += 1;
        self.probability = found.probability.min(CERTAIN);
        (self.ratio, self.success_rate) = (found.ratio, Some(found.success_rate));
    }

    /// Records that a search of all ambiguities found no integers.
    pub(crate) fn missed(&mut self) {
        self.epochs_in_a_row = 0;
    }

    /// Begins a new period if the arcs with integers have ended, so that no difference of two is
    /// left: the integers found from then on are other ones.
    pub(crate) fn end_with_arcs(&mut self, arcs: &mut Arcs) {
        let held = arcs.list().iter().filter(|arc| arc.held.is_some()).count();
        if 0.0 < self.probability && held < 2 {
            self.release(arcs);
        }
    }

    /// Drops all integers as wrong: epochs of this period are not conditioned on them in
    /// retrospect.
    pub(crate) fn refute(&mut self, arcs: &mut Arcs) {
        self.refuted = Some(self.period);
        self.release(arcs);
    }

    /// Drops all integers without a verdict: too few are left, or the float solution is too far
    /// from them. A new period begins.
    pub(crate) fn release(&mut self, arcs: &mut Arcs) {
        arcs.forget_integers();
        let Self { period, refuted, datums, .. } = *self;
        *self = Self { period: period + 1, refuted, datums, ..Self::default() };
    }
}
