//! The part of a session's work that computes: what runs on the solver pool.

use crate::aiding::PushedNavigation;
use crate::positioning::Scratch;
use crate::store::{EncodedEpoch, EncodedSnapshot, EncodedSolution, StoredSolution};

use super::course::Against;
use super::state::{Advanced, Origin, State};
use super::{EpochRefusal, SequencedEpoch};

/// Epochs after which the state is stored again. A state takes as much room as 20 to 40 epochs with
/// their solutions (docs/accuracy.md), and a crash costs the computation of this many epochs.
const EPOCHS_PER_SNAPSHOT: usize = 256;

/// What is to become of an epoch.
pub(super) enum Plan {
    /// Answered by the solution of that place, once it is committed.
    Positioned { place: usize, resent: bool },
    /// Numbered below the last committed one: the store knows the answer.
    Lookup(SequencedEpoch),
    /// Not taken.
    Refused(EpochRefusal),
}

/// What the epochs of a piece are positioned with.
pub(super) struct PieceAiding {
    pub(super) navigation: PushedNavigation,
    /// Bases, where the session's mode is relative to one.
    pub(super) against: Against,
}

/// A piece of work done, not committed.
pub(super) struct Piece {
    /// The state after it.
    pub(super) state: State,
    /// One for each epoch, in their order.
    pub(super) plans: Vec<(u64, Plan)>,
    /// The new epochs with their solutions, for the store.
    pub(super) rows: Vec<EncodedEpoch>,
    /// Later answers that they brought to these and earlier epochs, for the store.
    pub(super) revisions: Vec<EncodedSolution>,
    /// The state for the store, where it is due.
    pub(super) snapshot: Option<EncodedSnapshot>,
    /// The solutions of the same places as `rows`, for the answer.
    pub(super) solutions: Vec<StoredSolution>,
}

impl Piece {
    /// Positions `epochs` one after the other, from `state`.
    pub(super) fn position(
        state: State,
        epochs: impl IntoIterator<Item = SequencedEpoch>,
        aiding: &PieceAiding,
        origin: &Origin,
        observations_per_epoch: usize,
        scratch: &mut Scratch,
    ) -> Self {
        let mut piece = Self {
            state,
            plans: Vec::new(),
            rows: Vec::new(),
            revisions: Vec::new(),
            snapshot: None,
            solutions: Vec::new(),
        };
        for epoch in epochs {
            let seq = epoch.seq;
            let plan = match piece.refusal(&epoch, observations_per_epoch) {
                Some(refusal) => Plan::Refused(refusal),
                None if piece.is_after_last(seq) => piece.advance(&epoch, aiding, origin, scratch),
                None => piece.resent(epoch),
            };
            piece.plans.push((seq, plan));
        }
        if EPOCHS_PER_SNAPSHOT <= piece.state.unsaved {
            piece.snapshot = piece.state.encoded();
            piece.state.unsaved = 0;
        }
        piece
    }

    fn is_after_last(&self, seq: u64) -> bool {
        self.state.last.is_none_or(|(last, _)| last < seq)
    }

    fn refusal(&self, epoch: &SequencedEpoch, limit: usize) -> Option<EpochRefusal> {
        let SequencedEpoch { seq, epoch } = epoch;
        let (seq, observations) = (*seq, epoch.observations.len());
        if i64::try_from(seq).is_err() {
            return Some(EpochRefusal::SequenceTooLarge { seq });
        }
        if limit < observations {
            return Some(EpochRefusal::TooManyObservations { seq, observations, limit });
        }
        let (last_seq, last) = self.state.last?;
        let out_of_order = last_seq < seq && epoch.time <= last;
        out_of_order.then_some(EpochRefusal::OutOfOrder { seq, time: epoch.time, last })
    }

    fn advance(
        &mut self,
        SequencedEpoch { seq, epoch }: &SequencedEpoch,
        PieceAiding { navigation: PushedNavigation { push, navigation }, against }: &PieceAiding,
        origin: &Origin,
        scratch: &mut Scratch,
    ) -> Plan {
        let base = self.state.base_for(against, epoch, navigation, origin);
        let advanced = self.state.advance(*seq, epoch, navigation, base.as_ref(), origin, scratch);
        let Advanced { solution, revisions } = advanced;
        let used = base.map(|given| given.used);
        self.rows.push(EncodedEpoch::new(epoch, &solution, *push, used));
        self.revisions.extend(revisions.iter().map(EncodedSolution::new));
        self.solutions.push(solution);
        Plan::Positioned { place: self.rows.len() - 1, resent: false }
    }

    /// An epoch that is not after the last: this piece knows it, or else the store.
    fn resent(&self, epoch: SequencedEpoch) -> Plan {
        let seq = epoch.seq;
        match self.solutions.binary_search_by_key(&seq, |solution| solution.seq) {
            Ok(place) if self.rows[place].is(&epoch.epoch) => {
                Plan::Positioned { place, resent: true }
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
