//! Arcs, held integers and noise from epoch to epoch, shared by the graph and the filter.

use nalgebra::Matrix3;

use crate::config::PositioningOptions;
use crate::gnss::Reason;
use crate::snapshot::state_fields;

use super::ambiguity::{
    Confirmation, FOUND_EPOCHS, FixedEpoch, FloatSolution, HoldState, IntegerQuestion,
    IntegerSearch, NEARLY_CERTAIN, PhasePosition, Resolution, position_from_fixed_phases,
    subtract_common_cycles, subtract_integers,
};
use super::observed::{Arcs, Receivers, Residuals, RowScratch, RtkEpoch, State, carrier_residuals};
use super::pause::{Pause, SolvedPhases};

/// A fix whose phase residuals exceed this rms is rejected (σ).
const MISFIT_SIGMAS: f64 = 4.0;
/// A fix with a larger horizontal error counts as wrong (m), as in `docs/judge.md`.
const RIGHT_WITHIN_M: f64 = 0.1;
/// Largest undetected shift by one faulty satellite for a fix to be accepted (m).
const UNDETECTED_SHIFT_MAX_M: f64 = RIGHT_WITHIN_M;

/// State of the carriers that rover and base both observe.
#[derive(Debug)]
pub(crate) struct Tracking {
    pub(crate) arcs: Arcs,
    pub(crate) hold: HoldState,
    pub(crate) confirmation: Confirmation,
    /// The period of held integers that `confirmation` refers to.
    pub(crate) confirmed_period: Option<u32>,
    pub(crate) receivers: Receivers,
    /// Before the newest epoch.
    pub(crate) pause: Pause,
}

state_fields!(Tracking { arcs, hold, confirmation, confirmed_period, receivers, pause });

/// An epoch that was solved.
#[derive(Clone, Copy)]
pub(crate) struct SolvedEpoch<'a> {
    pub(crate) epoch: &'a RtkEpoch,
    /// Ambiguities by variable (cycles).
    pub(crate) border: &'a [f64],
    pub(crate) float: &'a FloatSolution,
    /// The pseudoranges' residuals.
    pub(crate) residuals: Residuals,
}

/// Verdict of the phases of a fix.
enum Verdict {
    Confirmed,
    /// One faulty satellite may have moved it too far.
    Unchecked,
    /// The phases do not fit the integers.
    Contradicted,
}

impl Tracking {
    /// No arcs, a-priori noise.
    pub(crate) fn new() -> Self {
        Self {
            arcs: Arcs::default(),
            hold: HoldState::default(),
            confirmation: Confirmation::default(),
            confirmed_period: None,
            receivers: Receivers::new(),
            pause: Pause::NONE,
        }
    }

    /// Ends all arcs. Noise scales and code biases of the receivers stay.
    pub(crate) fn clear(&mut self) {
        self.arcs.clear();
        self.receivers.last_pseudoranges.clear();
        self.hold = HoldState::default();
        self.confirmation.clear();
    }

    /// Judges by the phases of a solved epoch whether the arcs have kept their ambiguities over the
    /// pause before it. Returns whether that is likelier than not.
    #[must_use]
    pub(crate) fn judge_arcs(
        &mut self,
        solved: &SolvedPhases<'_>,
        scratch: &mut RowScratch,
    ) -> bool {
        self.pause.judge(solved, &self.arcs, scratch);
        !self.pause.is_refuted()
    }

    /// Resolves the integers of a solved epoch. A fix that its phases confirm also updates noise
    /// and biases.
    pub(crate) fn resolve(
        &mut self,
        solved: &SolvedEpoch<'_>,
        options: &PositioningOptions,
        search: &mut IntegerSearch,
        scratch: &mut RowScratch,
    ) -> Resolution {
        let SolvedEpoch { epoch, border, float, residuals } = *solved;
        if !options.rtk.resolve {
            return Resolution::unresolved(self.arcs.present(epoch.time).count());
        }
        self.hold.end_with_arcs(&mut self.arcs);
        self.hold.probability = self.hold.probability.min(self.pause.kept);
        let noise = self.receivers.known_noise(&residuals);
        let question = IntegerQuestion { time: epoch.time, float, noise, options: &options.rtk };
        let is_confirmed =
            self.confirmation.is_confirmed() && self.confirmed_period == Some(self.hold.period);
        let mut resolution =
            search.resolve(&mut self.arcs, &mut self.hold, &question, is_confirmed);
        let probability = resolution.outcome.as_ref().map(|fixed| fixed.probability);
        if probability.is_ok_and(|found| !self.confirm_or_refute(found, &question, search)) {
            return resolution.refused(Reason::FixRejected);
        }
        let Ok(fixed) = &mut resolution.outcome else { return resolution };
        let noise = &self.receivers.carrier_noise;
        let factor = noise.variance_factor();
        let (start, known) = (fixed.position, fixed.by_proven.as_ref());
        let fixed_epoch = FixedEpoch { epoch, border, arcs: &self.arcs };
        let by_phases = position_from_fixed_phases(&fixed_epoch, &start, known, scratch);
        let Some(by_phases) = by_phases else { return resolution.refused(Reason::FixRejected) };
        let near = noise.probability_within(RIGHT_WITHIN_M, by_phases.horizontal_variance_m2());
        fixed.probability *= self.hold.reliability * near;
        (fixed.position, fixed.covariance) = (by_phases.position, by_phases.covariance * factor);
        let resolution = resolution.require_precise();
        if resolution.outcome.is_err() {
            return resolution;
        }
        let groups = self.fixed_residuals(solved, &by_phases, scratch);
        let verdict = judge(&by_phases, &scratch.residuals);
        if matches!(verdict, Verdict::Unchecked) {
            return resolution.refused(Reason::FixRejected);
        }
        self.receivers.carrier_noise.learn(&mut scratch.residuals, (3 + groups) as f64);
        if matches!(verdict, Verdict::Contradicted) {
            self.hold.refute(&mut self.arcs);
            return resolution.refused(Reason::FixRejected);
        }
        self.receivers.learn_biases(epoch, &by_phases.position, scratch);
        resolution
    }

    /// Tests the held integers by the searches without each satellite. Returns whether they are
    /// confirmed; if `probability` is not nearly certain, the epoch before must have found them,
    /// too. Confirmed integers are dropped if such a search finds likelier ones.
    fn confirm_or_refute(
        &mut self,
        probability: f64,
        question: &IntegerQuestion<'_>,
        search: &mut IntegerSearch,
    ) -> bool {
        let Self { arcs, hold, confirmation, .. } = self;
        hold.reliability = 1.0;
        if question.options.single_epoch {
            return true;
        }
        if self.confirmed_period != Some(hold.period) {
            confirmation.clear();
            self.confirmed_period = Some(hold.period);
        }
        let was_confirmed = confirmation.is_confirmed();
        let with_integer = arcs.present(question.time).filter(|arc| arc.held.is_some());
        let mut satellites: Vec<_> = with_integer.map(|arc| arc.satellite).collect();
        satellites.sort_unstable();
        satellites.dedup();
        let mut separator = search.separator(arcs, question);
        let test = |satellite| separator.as_mut()?.without(satellite);
        confirmation.update(&satellites, question.options.probability_min, test);
        hold.reliability = confirmation.probability();
        if was_confirmed && !confirmation.is_confirmed() {
            hold.refute(arcs);
        }
        hold.was_confirmed |= confirmation.is_confirmed();
        let is_repeated = FOUND_EPOCHS <= hold.epochs_in_a_row;
        confirmation.is_confirmed() && (is_repeated || NEARLY_CERTAIN <= probability)
    }

    /// Writes the residuals of the phases with integers at a position to the scratch; returns the
    /// number of groups.
    fn fixed_residuals(
        &self,
        solved: &SolvedEpoch<'_>,
        by_phases: &PhasePosition,
        scratch: &mut RowScratch,
    ) -> usize {
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(&by_phases.position);
        let fix = |rows: &mut Vec<_>| {
            subtract_integers(&self.arcs, solved.border, rows);
            subtract_common_cycles(rows);
        };
        carrier_residuals(solved.epoch, &state, solved.border, fix, scratch)
    }

    /// Updates the pseudorange noise from a solved epoch, with the covariance of its position.
    pub(crate) fn learn_noise(
        &mut self,
        epoch: &RtkEpoch,
        state: &State,
        covariance: &Matrix3<f64>,
        scratch: &mut RowScratch,
    ) {
        self.receivers.learn_noise(epoch, state, covariance, scratch);
    }
}

/// Whether phases with these residuals confirm a position.
fn judge(by_phases: &PhasePosition, residuals: &[f64]) -> Verdict {
    let squares: f64 = residuals.iter().map(|residual| residual * residual).sum();
    let count = residuals.len();
    if UNDETECTED_SHIFT_MAX_M < by_phases.undetected_shift_m(squares, count) {
        Verdict::Unchecked
    } else if squares <= MISFIT_SIGMAS.powi(2) * count as f64 {
        Verdict::Confirmed
    } else {
        Verdict::Contradicted
    }
}
