//! The computing part of a session's work, which runs on the solver pool.

use std::sync::Arc;
use std::time::Duration;

use crate::aiding::PushedNavigation;
use crate::gnss::GpsTime;
use crate::positioning::Scratch;
use crate::store::{Arrival, EncodedEpoch, EncodedSnapshot, EncodedSolution, StoredSolution};

use super::base_selection::BaseSource;
use super::panics::caught;
use super::state::{Advanced, Configuration, State};
use super::{EpochRefusal, SEQUENCES, SequencedEpoch};

/// Number of epochs after which the state is stored again. It is stored earlier if computing the
/// epochs again would take too long. A state takes as much space as some 30 epochs with their
/// solutions (docs/accuracy.md, docs/operations.md).
const EPOCHS_PER_SNAPSHOT: usize = 256;

/// Limits for the epochs of a batch, and when its state is stored.
#[derive(Clone, Copy, Debug)]
pub(super) struct EpochRules {
    /// Most observations in one epoch.
    pub(super) observations_max: usize,
    /// The present time.
    pub(super) now: GpsTime,
    /// The present day, with which the epochs are stored.
    pub(super) arrival: Arrival,
    /// Time that an epoch may be ahead of `now` (s).
    pub(super) future_s: u64,
    /// Processor time that a replay may take. The state is stored when the epochs since take more.
    pub(super) replay_max: Duration,
    /// Whether the next snapshot is the first of the session's day and therefore kept for replay.
    pub(super) keeps_snapshot: bool,
    /// Whether the last kept snapshot is of another day. The state is then stored.
    pub(super) is_new_day: bool,
}

/// What to do with an epoch.
pub(super) enum Plan {
    /// Answer with the solution of this index, once it is committed.
    Positioned { index: usize, resent: bool },
    /// Look the answer up in the store: the number is not above the last committed one.
    Lookup(SequencedEpoch),
    /// Refuse it.
    Refused(EpochRefusal),
}

/// The solutions of a batch that have not been put into answers yet.
pub(super) struct Unanswered {
    solutions: Vec<Option<StoredSolution>>,
    /// Whether one solution answers several epochs, because an epoch was sent again.
    has_resent: bool,
}

impl Unanswered {
    /// The solutions for these plans.
    pub(super) fn new(solutions: Vec<StoredSolution>, plans: &[(u64, Plan)]) -> Self {
        let is_resent =
            |(_, plan): &(u64, Plan)| matches!(plan, Plan::Positioned { resent: true, .. });
        let has_resent = plans.iter().any(is_resent);
        Self { solutions: solutions.into_iter().map(Some).collect(), has_resent }
    }

    /// The solution of this index.
    pub(super) fn take(&mut self, index: usize) -> StoredSolution {
        let solution = &mut self.solutions[index];
        let solution = if self.has_resent { solution.clone() } else { solution.take() };
        solution.expect("only an epoch that was sent again shares a solution")
    }
}

/// The aiding data for the epochs of a batch.
pub(super) struct BatchAiding {
    pub(super) navigation: PushedNavigation,
    /// The bases, if the session's mode is relative to one.
    pub(super) source: BaseSource,
}

/// A batch that is computed but not committed.
pub(super) struct SolvedBatch {
    /// The state after the batch.
    pub(super) state: State,
    /// The number and plan of each epoch, in their order.
    pub(super) plans: Vec<(u64, Plan)>,
    /// The new epochs with their solutions, encoded for the store.
    pub(super) rows: Vec<EncodedEpoch>,
    /// Revisions of these and earlier epochs, encoded for the store.
    pub(super) revisions: Vec<EncodedSolution>,
    /// The same revisions, for the watches of the session.
    pub(super) revised: Vec<StoredSolution>,
    /// The encoded state for the store, if it is to be stored.
    pub(super) snapshot: Option<EncodedSnapshot>,
    /// The solutions of `rows`, with the same indices.
    pub(super) solutions: Vec<StoredSolution>,
    /// Numbers of the epochs on which the estimator panicked, with its messages.
    pub(super) panics: Vec<(u64, String)>,
}

impl SolvedBatch {
    /// A batch without epochs, which starts from `state`.
    pub(super) fn new(state: State) -> Self {
        Self {
            state,
            plans: Vec::new(),
            rows: Vec::new(),
            revisions: Vec::new(),
            revised: Vec::new(),
            snapshot: None,
            solutions: Vec::new(),
            panics: Vec::new(),
        }
    }

    /// Positions the next epoch. The caller adds its time to [`State::unsaved_time`].
    pub(super) fn position(
        &mut self,
        epoch: SequencedEpoch,
        aiding: &BatchAiding,
        configuration: &Configuration,
        rules: &EpochRules,
        scratch: &mut Scratch,
    ) {
        let seq = epoch.seq;
        let plan = match self.refusal(&epoch, rules) {
            Some(refusal) => Plan::Refused(refusal),
            None if self.is_after_last(seq) => self.advance(epoch, aiding, configuration, scratch),
            None => self.repeated(epoch),
        };
        self.plans.push((seq, plan));
    }

    /// Encodes the state after the last epoch, if it is to be stored.
    pub(super) fn finish(&mut self, rules: &EpochRules) {
        let (state, has_rows) = (&mut self.state, !self.rows.is_empty());
        let is_long = EPOCHS_PER_SNAPSHOT <= state.unsaved || rules.replay_max < state.unsaved_time;
        let partition = rules.arrival.partition;
        // The clock was set back, or the service's retention is longer than before.
        let is_earlier = state.since_day.is_some_and(|day| partition < day);
        if is_long || has_rows && (rules.is_new_day || is_earlier) {
            state.since_day = Some(partition);
            self.snapshot = state.encoded();
            state.note_stored();
        } else if state.since_day.is_none() && has_rows && state.unsaved == self.rows.len() {
            state.since_day = Some(partition);
        }
    }

    fn is_after_last(&self, seq: u64) -> bool {
        self.state.last.is_none_or(|(last, _)| last < seq)
    }

    fn refusal(&self, epoch: &SequencedEpoch, rules: &EpochRules) -> Option<EpochRefusal> {
        let SequencedEpoch { seq, epoch } = epoch;
        let (seq, observations) = (*seq, epoch.observations.len());
        let (limit, ahead_s) = (rules.observations_max, rules.future_s);
        if !SEQUENCES.contains(&seq) {
            return Some(EpochRefusal::SequenceOutOfRange { seq });
        }
        if limit < observations {
            return Some(EpochRefusal::TooManyObservations { seq, observations, limit });
        }
        let is_new = self.is_after_last(seq);
        if is_new && (ahead_s as f64) < epoch.time - rules.now {
            return Some(EpochRefusal::TimeImplausible { seq, time: epoch.time, ahead_s });
        }
        if is_new && epoch.time < GpsTime::EPOCH {
            return Some(EpochRefusal::TimeBeforeGps { seq, time: epoch.time });
        }
        let (last_seq, last) = self.state.last?;
        let out_of_order = last_seq < seq && epoch.time <= last;
        out_of_order.then_some(EpochRefusal::OutOfOrder { seq, time: epoch.time, last })
    }

    fn advance(
        &mut self,
        SequencedEpoch { seq, epoch }: SequencedEpoch,
        BatchAiding { navigation: PushedNavigation { push, navigation }, source }: &BatchAiding,
        configuration: &Configuration,
        scratch: &mut Scratch,
    ) -> Plan {
        let state = &mut self.state;
        let advanced = caught(|| {
            let base = state.base_for(source, &epoch, navigation, configuration);
            let base = base.as_ref();
            let advanced = state.advance(seq, &epoch, navigation, base, configuration, scratch);
            (advanced, base.map(|input| input.used))
        });
        let (Advanced { solution, revisions }, used) = advanced.unwrap_or_else(|panic| {
            *scratch = Scratch::default();
            self.panics.push((seq, panic));
            (self.state.quarantine(seq, &epoch, configuration), None)
        });
        let last = self.state.reference.as_ref();
        let row = EncodedEpoch::new(Arc::new(epoch), &solution, *push, used, last);
        self.state.remember(&row);
        self.rows.push(row);
        self.revisions.extend(self.state.encoded_revisions(&revisions));
        self.revised.extend(revisions);
        self.solutions.push(solution);
        Plan::Positioned { index: self.rows.len() - 1, resent: false }
    }

    /// The plan for an epoch whose number is not above the last one.
    fn repeated(&self, epoch: SequencedEpoch) -> Plan {
        let seq = epoch.seq;
        match self.solutions.binary_search_by_key(&seq, |solution| solution.seq) {
            Ok(index) if self.rows[index].is(&epoch.epoch) => {
                Plan::Positioned { index, resent: true }
            }
            Ok(_) => Plan::Refused(EpochRefusal::Conflict { seq }),
            Err(0) => Plan::Lookup(epoch),
            Err(_) => {
                let last = self.state.last.map_or(seq, |(last, _)| last);
                Plan::Refused(EpochRefusal::Superseded { seq, last })
            }
        }
    }
}
