//! One session's task: sole owner of its estimator, in order of arrival.

use std::collections::HashMap;
use std::mem;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use tokio::sync::{mpsc, oneshot};

use crate::aiding::NavigationBroker;
use crate::gnss::Navigation;
use crate::positioning::Estimator;
use crate::store::{Batch, SessionKey, Store, StoreError, StoredEpoch};

use super::configuration::stored_options;
use super::piece::{Origin, Piece, Plan, State, VERSION};
use super::solvers::Solvers;
use super::{
    Acknowledged, EpochOutcome, EpochRefusal, SequencedEpoch, SessionError, SessionId, Submitted,
};

/// Epochs after which a piece takes no further batch.
const EPOCHS_PER_PIECE: usize = 1_024;

/// A batch in the mailbox.
pub(super) struct Submission {
    pub(super) epochs: Vec<SequencedEpoch>,
    pub(super) place: Place,
    pub(super) reply: oneshot::Sender<Result<Submitted, SessionError>>,
}

/// The room that epochs take while they wait; dropping it gives the room back.
pub(super) struct Place {
    epochs: usize,
    of_session: Arc<AtomicUsize>,
    of_all: Arc<AtomicUsize>,
}

impl Place {
    pub(super) fn take(
        epochs: usize,
        of_session: &Arc<AtomicUsize>,
        of_all: &Arc<AtomicUsize>,
    ) -> Self {
        of_session.fetch_add(epochs, Ordering::AcqRel);
        of_all.fetch_add(epochs, Ordering::AcqRel);
        Self { epochs, of_session: of_session.clone(), of_all: of_all.clone() }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.of_session.fetch_sub(self.epochs, Ordering::AcqRel);
        self.of_all.fetch_sub(self.epochs, Ordering::AcqRel);
    }
}

/// What a session's task works with.
pub(super) struct Task {
    pub(super) id: SessionId,
    pub(super) key: SessionKey,
    pub(super) store: Store,
    pub(super) aiding: NavigationBroker,
    pub(super) solvers: Solvers,
    pub(super) observations_per_epoch: usize,
    /// The settings have changed: restore before the next piece.
    pub(super) outdated: Arc<AtomicBool>,
}

/// The estimator in memory, and a second one whose memory the next piece works in.
struct Active {
    committed: State,
    spare: State,
    origin: Origin,
}

impl Task {
    /// Runs until the mailbox is closed and empty. Clients that hang up stop nothing: their epochs
    /// are positioned and stored all the same.
    pub(super) async fn run(self, mut inbox: mpsc::Receiver<Submission>) {
        let mut active = None;
        while let Some(first) = inbox.recv().await {
            let mut epochs = first.epochs.len();
            let mut submissions = vec![first];
            while epochs < EPOCHS_PER_PIECE {
                let Ok(next) = inbox.try_recv() else { break };
                epochs += next.epochs.len();
                submissions.push(next);
            }
            self.answer(&mut active, submissions).await;
        }
    }

    /// Positions and commits the batches in one piece and answers each.
    async fn answer(&self, active: &mut Option<Active>, mut submissions: Vec<Submission>) {
        let batches: Vec<_> = submissions.iter_mut().map(|s| mem::take(&mut s.epochs)).collect();
        let lengths: Vec<usize> = batches.iter().map(Vec::len).collect();
        let answers = self.process(active, batches.into_iter().flatten().collect()).await;
        let mut answers = answers.map(|(outcomes, through)| (outcomes.into_iter(), through));
        for (Submission { place, reply, .. }, length) in submissions.into_iter().zip(lengths) {
            let answer = match &mut answers {
                Ok((outcomes, durable_through)) => Ok(Submitted {
                    outcomes: outcomes.take(length).collect(),
                    durable_through: *durable_through,
                }),
                Err(error) => Err(error.clone()),
            };
            drop(place);
            reply.send(answer).ok(); // Err: the client hung up.
        }
    }

    /// Positions and commits epochs. Only then is the new state kept; after a failure none is, and
    /// the next piece starts from what the store holds.
    async fn process(
        &self,
        active: &mut Option<Active>,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<(Vec<EpochOutcome>, Option<u64>), SessionError> {
        let outdated = self.outdated.swap(false, Ordering::AcqRel);
        let Active { committed, spare, origin } = match active.take() {
            Some(active) if !outdated => active,
            _ => self.restore().await?,
        };
        let (piece, committed) = self.position(committed, spare, &origin, epochs).await?;
        let Piece { state, plans, rows, solutions } = piece;
        let stored = self.lookup(&plans).await?;
        if !rows.is_empty() {
            self.store.commit(Batch { session: self.key, epochs: rows }).await?;
        }
        let durable_through = state.last.map(|(seq, _)| seq);
        *active = Some(Active { committed: state, spare: committed, origin });
        let outcome = |(seq, plan)| {
            let result = match plan {
                Plan::Refused(refusal) => Err(refusal),
                Plan::Lookup(epoch) => answer_from(&stored, &epoch, durable_through)?,
                Plan::Positioned { place, resent } => {
                    Ok(Acknowledged { solution: solutions[place].clone(), resent })
                }
            };
            Ok(EpochOutcome { seq, result })
        };
        let outcomes: Result<_, StoreError> = plans.into_iter().map(outcome).collect();
        Ok((outcomes?, durable_through))
    }

    /// Runs a piece on the solver pool, in the memory of `spare`; returns it and `committed`.
    async fn position(
        &self,
        committed: State,
        mut spare: State,
        origin: &Origin,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<(Piece, State), SessionError> {
        let navigation: Arc<Navigation> = self.aiding.current();
        let (origin, limit) = (origin.clone(), self.observations_per_epoch);
        let work = move || {
            spare.estimator.clone_from(&committed.estimator);
            spare.last = committed.last;
            (Piece::position(spare, epochs, &navigation, &origin, limit), committed)
        };
        self.solvers.run(work).await
    }

    async fn lookup(&self, plans: &[(u64, Plan)]) -> Result<HashMap<u64, StoredEpoch>, StoreError> {
        let asked = plans.iter().filter(|(_, plan)| matches!(plan, Plan::Lookup(_)));
        let asked: Vec<u64> = asked.map(|(seq, _)| *seq).collect();
        if asked.is_empty() {
            return Ok(HashMap::new());
        }
        let found = self.store.epochs(self.key, &asked).await?;
        Ok(found.into_iter().map(|stored| (stored.solution.seq, stored)).collect())
    }

    /// The state after the last committed epoch, by the settings in force.
    async fn restore(&self) -> Result<Active, SessionError> {
        let row = self.store.session(self.id.as_str()).await?;
        let row = row.ok_or_else(|| SessionError::NotFound { id: self.id.to_string() })?;
        let mut estimator = Estimator::new(stored_options(&row.settings)?);
        let last = self.store.last_epochs(self.key, 1).await?.pop();
        if let Some(last) = &last {
            estimator.resume(&last.solution.solution);
        }
        let last = last.map(|last| (last.solution.seq, last.solution.solution.time));
        let committed = State { estimator, last };
        let origin =
            Origin { version: VERSION.into(), configuration_hash: row.settings.configuration_hash };
        Ok(Active { spare: committed.clone(), committed, origin })
    }
}

/// The stored answer to an epoch that came before, if it is the same one.
fn answer_from(
    stored: &HashMap<u64, StoredEpoch>,
    SequencedEpoch { seq, epoch }: &SequencedEpoch,
    last: Option<u64>,
) -> Result<Result<Acknowledged, EpochRefusal>, StoreError> {
    let seq = *seq;
    let Some(stored) = stored.get(&seq) else {
        return Ok(Err(EpochRefusal::Superseded { seq, last: last.unwrap_or(seq) }));
    };
    if stored.is(epoch)? {
        Ok(Ok(Acknowledged { solution: stored.solution.clone(), resent: true }))
    } else {
        Ok(Err(EpochRefusal::Conflict { seq }))
    }
}
