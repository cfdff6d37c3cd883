//! The part of a session's work that computes: what runs on the solver pool.

use std::sync::Arc;

use crate::gnss::{GpsTime, Navigation};
use crate::positioning::{Aiding, Estimator};
use crate::store::{EncodedEpoch, StoredSolution};

use super::{EpochRefusal, SequencedEpoch};

/// Version of this program, which each solution names.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// A session's estimator after its last epoch.
#[derive(Clone)]
pub(super) struct State {
    pub(super) estimator: Estimator,
    /// Number and time of the last epoch.
    pub(super) last: Option<(u64, GpsTime)>,
}

/// What names the origin of a solution.
#[derive(Clone)]
pub(super) struct Origin {
    pub(super) version: Arc<str>,
    pub(super) configuration_hash: Arc<str>,
}

/// What is to become of an epoch.
pub(super) enum Plan {
    /// Answered by the solution of that place, once it is committed.
    Positioned { place: usize, resent: bool },
    /// Numbered below the last committed one: the store knows the answer.
    Lookup(SequencedEpoch),
    /// Not taken.
    Refused(EpochRefusal),
}

/// A piece of work done, not committed.
pub(super) struct Piece {
    /// The state after it.
    pub(super) state: State,
    /// One for each epoch, in their order.
    pub(super) plans: Vec<(u64, Plan)>,
    /// The new epochs with their solutions, for the store.
    pub(super) rows: Vec<EncodedEpoch>,
    /// The solutions of the same places, for the answer.
    pub(super) solutions: Vec<StoredSolution>,
}

impl Piece {
    /// Positions `epochs` one after the other, from `state`.
    pub(super) fn position(
        state: State,
        epochs: impl IntoIterator<Item = SequencedEpoch>,
        navigation: &Navigation,
        origin: &Origin,
        observations_per_epoch: usize,
    ) -> Self {
        let mut piece = Self { state, plans: Vec::new(), rows: Vec::new(), solutions: Vec::new() };
        for epoch in epochs {
            let seq = epoch.seq;
            let plan = match piece.refusal(&epoch, observations_per_epoch) {
                Some(refusal) => Plan::Refused(refusal),
                None if piece.is_after_last(seq) => piece.advance(&epoch, navigation, origin),
                None => piece.resent(epoch),
            };
            piece.plans.push((seq, plan));
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
        navigation: &Navigation,
        Origin { version, configuration_hash }: &Origin,
    ) -> Plan {
        let solution = self.state.estimator.advance(epoch, &Aiding::alone(navigation));
        self.rows.push(EncodedEpoch::new(*seq, epoch, &solution, version, configuration_hash));
        self.solutions.push(StoredSolution {
            seq: *seq,
            revision: 0,
            solution,
            version: version.clone(),
            configuration_hash: configuration_hash.clone(),
        });
        self.state.last = Some((*seq, epoch.time));
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
