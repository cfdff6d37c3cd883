//! One session's task: sole owner of its estimator, in order of arrival.

mod receive;

use std::collections::HashMap;
use std::mem;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use tokio::sync::{mpsc, oneshot};

use crate::aiding::AidingDesk;
use crate::aiding::bases::{BaseChoice, NearestBaseRequest};
use crate::clock::unix_ms;
use crate::positioning::Scratch;
use crate::store::{Batch, EncodedSolution, RawChange, SessionKey, Store, StoreError, StoredEpoch};

use super::course::Against;
use super::piece::{Piece, PieceAiding, Plan};
use super::raw::Reception;
use super::replay::{By, Course, InForce, in_force, restored};
use super::solvers::Solvers;
use super::state::State;
use super::{
    Acknowledged, EpochOutcome, EpochRefusal, RawPiece, RawReceived, SequencedEpoch, SessionError,
    SessionId, Submitted,
};

/// Epochs after which a piece takes no further batch.
const EPOCHS_PER_PIECE: usize = 1_024;
/// Epochs that are worth storing the state for when the task ends: fewer are replayed as quickly.
const EPOCHS_WORTH_STORING: usize = 32;

/// What waits in the mailbox.
pub(super) enum Message {
    /// Epochs to be positioned.
    Submission(Submission),
    /// A piece of raw bytes.
    Raw(Box<RawSubmission>),
    /// The last message: closes the session at a time (ms since 1970-01-01 UTC).
    Close { unix_ms: i64, reply: oneshot::Sender<Result<(), SessionError>> },
}

/// A batch in the mailbox.
pub(super) struct Submission {
    pub(super) epochs: Vec<SequencedEpoch>,
    /// Taken when it is posted.
    pub(super) place: Option<Place>,
    pub(super) reply: oneshot::Sender<Result<Submitted, SessionError>>,
}

/// A piece in the mailbox.
pub(super) struct RawSubmission {
    pub(super) piece: RawPiece,
    /// Taken when it is posted.
    pub(super) place: Option<Place>,
    pub(super) reply: oneshot::Sender<Result<RawReceived, SessionError>>,
}

impl Message {
    /// Gives it the room that it takes while it waits.
    pub(super) fn put(&mut self, taken: Place) {
        match self {
            Self::Submission(submission) => submission.place = Some(taken),
            Self::Raw(submission) => submission.place = Some(taken),
            Self::Close { .. } => {}
        }
    }
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
    pub(super) aiding: AidingDesk,
    pub(super) solvers: Solvers,
    pub(super) epochs_per_batch: usize,
    pub(super) observations_per_epoch: usize,
    /// The settings have changed: read them before the next piece.
    pub(super) outdated: Arc<AtomicBool>,
}

/// What of the session is in memory.
struct Active {
    committed: State,
    /// What the next epochs are computed with.
    force: Arc<InForce>,
    /// The stream of its receiver, once raw bytes have come.
    raw: Option<Box<Reception>>,
}

impl Active {
    /// Number of the last epoch.
    fn last_seq(&self) -> Option<u64> {
        self.committed.last.map(|(seq, _)| seq)
    }
}

impl Task {
    /// Runs until the mailbox is closed and empty, or the session is. Clients that hang up stop
    /// nothing: their epochs are positioned and stored all the same.
    pub(super) async fn run(self, mut inbox: mpsc::Receiver<Message>) {
        let mut active = None;
        while let Some(first) = inbox.recv().await {
            let (mut next, mut epochs) = (Some(first), 0);
            let (mut submissions, mut other) = (Vec::new(), None);
            while let Some(message) = next {
                match message {
                    Message::Submission(submission) => {
                        epochs += submission.epochs.len();
                        submissions.push(submission);
                    }
                    message => other = Some(message),
                }
                let is_full = EPOCHS_PER_PIECE <= epochs || other.is_some();
                next = if is_full { None } else { inbox.try_recv().ok() };
            }
            if !submissions.is_empty() {
                self.answer(&mut active, submissions).await;
            }
            match other {
                Some(Message::Raw(submission)) => {
                    let RawSubmission { piece, place, reply } = *submission;
                    // Boxed: a task at rest is as large as the largest of its waits.
                    let answer = Box::pin(self.receive(&mut active, piece)).await;
                    drop(place);
                    reply.send(answer).ok(); // Err: the client hung up.
                }
                Some(Message::Close { unix_ms, reply }) => {
                    // Err: who closes has gone; the session is closed all the same.
                    reply.send(self.close(active, unix_ms).await).ok();
                    return;
                }
                Some(Message::Submission(_)) | None => {}
            }
        }
        self.park(active).await;
    }

    /// Stores the last answers to what the window holds, and that the session is closed.
    async fn close(&self, active: Option<Active>, unix_ms: i64) -> Result<(), SessionError> {
        let mut state = match active {
            Some(active) => active.committed,
            None => self.restored(&self.in_force().await?).await?,
        };
        let revisions = self.solvers.estimate(move |scratch| state.finish(scratch)).await?;
        let revisions = revisions.iter().map(EncodedSolution::new).collect();
        let closed_unix_ms = Some(unix_ms);
        self.store.commit(Batch { revisions, closed_unix_ms, ..Batch::new(self.key) }).await?;
        Ok(())
    }

    /// Stores the state, so that the next task need not replay much.
    async fn park(&self, active: Option<Active>) {
        let Some(Active { committed, .. }) = active else { return };
        if committed.unsaved < EPOCHS_WORTH_STORING {
            return;
        }
        let Ok(snapshot) = self.solvers.run(move || committed.encoded()).await else { return };
        if let Err(error) = self.store.commit(Batch { snapshot, ..Batch::new(self.key) }).await {
            // Nothing is lost: it is replayed.
            tracing::warn!(session = %self.id, %error, "a session's state was not stored");
        }
    }

    /// Positions and commits the batches in one piece and answers each.
    async fn answer(&self, active: &mut Option<Active>, mut submissions: Vec<Submission>) {
        let batches: Vec<_> = submissions.iter_mut().map(|s| mem::take(&mut s.epochs)).collect();
        let lengths: Vec<usize> = batches.iter().map(Vec::len).collect();
        let answers = self.advance(active, batches.into_iter().flatten().collect()).await;
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

    async fn advance(
        &self,
        active: &mut Option<Active>,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<(Vec<EpochOutcome>, Option<u64>), SessionError> {
        let held = self.activated(active.take()).await?;
        self.process(active, held, epochs, None).await
    }

    /// Positions and commits epochs, and the piece of raw bytes that they are from. Only then is
    /// the new state kept; after a failure none is, and the next piece starts from what the store
    /// holds.
    async fn process(
        &self,
        active: &mut Option<Active>,
        Active { committed, force, raw: reception }: Active,
        epochs: Vec<SequencedEpoch>,
        raw: Option<Box<RawChange>>,
    ) -> Result<(Vec<EpochOutcome>, Option<u64>), SessionError> {
        let (piece, committed) = self.position(committed, &force, epochs).await?;
        let Piece { state, plans, rows, revisions, snapshot, solutions } = piece;
        let stored = self.lookup(&plans).await?;
        let batch = Batch { epochs: rows, revisions, snapshot, raw, ..Batch::new(self.key) };
        if !batch.is_empty() {
            self.store.commit(batch).await?;
        }
        let durable_through = state.last.map(|(seq, _)| seq);
        self.solvers.spares().keep(committed);
        let newest = solutions.iter().rev().find_map(|stored| stored.solution.estimate.as_ref());
        let base = state.base().filter(|_| !force.base.is_none());
        if let (Some(base), Some(estimate)) = (base, newest) {
            self.aiding.bases.record_rover(base, estimate.position);
        }
        if let (BaseChoice::Nearest, Some(estimate)) = (&force.base, newest) {
            let request = NearestBaseRequest {
                position: estimate.position,
                baseline_max_m: force.origin.options.rtk.baseline_max_m,
                unix_ms: unix_ms(),
            };
            self.aiding.bases.nearest_base_requests().record(self.key, request);
        }
        *active = Some(Active { committed: state, force, raw: reception });
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

    /// The estimator in memory, or else restored, with the settings in force.
    async fn activated(&self, active: Option<Active>) -> Result<Active, SessionError> {
        let is_outdated = self.outdated.swap(false, Ordering::AcqRel);
        match active {
            Some(active) if !is_outdated => Ok(active),
            Some(active) => Ok(Active { force: Arc::new(self.in_force().await?), ..active }),
            None => {
                let force = self.in_force().await?;
                let committed = self.restored(&force).await?;
                Ok(Active { committed, force: Arc::new(force), raw: None })
            }
        }
    }

    /// Runs a piece on the solver pool from a copy of `committed`; returns it and `committed`.
    async fn position(
        &self,
        committed: State,
        force: &Arc<InForce>,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<(Piece, State), SessionError> {
        let aiding = self.aiding_for(force, &epochs);
        let (force, limit) = (force.clone(), self.observations_per_epoch);
        let spares = self.solvers.spares().clone();
        let work = move |scratch: &mut Scratch| {
            let state = spares.copy_of(&committed);
            let origin = &force.origin;
            (Piece::position(state, epochs, &aiding, origin, limit, scratch), committed)
        };
        self.solvers.estimate(work).await
    }

    /// What the epochs are positioned with: all that is held now and may serve them.
    fn aiding_for(&self, force: &InForce, epochs: &[SequencedEpoch]) -> PieceAiding {
        let times = || epochs.iter().map(|sequenced| sequenced.epoch.time);
        let span = times().min().zip(times().max());
        let options = &force.origin.options;
        let against = Against::new(&self.aiding.bases, &force.base, span, options);
        PieceAiding { navigation: self.aiding.navigation.current(), against }
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

    async fn in_force(&self) -> Result<InForce, SessionError> {
        in_force(&self.store, self.id.as_str()).await
    }

    /// The state after the last committed epoch.
    async fn restored(&self, force: &InForce) -> Result<State, SessionError> {
        let course = Course {
            store: self.store.clone(),
            aiding: self.aiding.clone(),
            solvers: self.solvers.clone(),
            key: self.key,
            by: By::Stored,
            may_differ: true,
        };
        restored(&course, &force.origin).await
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
