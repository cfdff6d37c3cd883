//! One session's task: the sole owner of its estimator. It handles messages in order of arrival.

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

use super::base_selection::BaseSource;
use super::batch::{BatchAiding, Plan, SolvedBatch};
use super::raw::Reception;
use super::replay::{ActiveConfiguration, Replay, ReplayWith, active_configuration, restored};
use super::solvers::Solvers;
use super::state::State;
use super::{
    Acknowledged, EpochOutcome, EpochRefusal, RawChunk, RawReceived, SequencedEpoch, SessionError,
    SessionId, Submitted,
};

/// A batch takes no further push once it has this many epochs.
const EPOCHS_PER_BATCH: usize = 1_024;
/// With fewer new epochs the state is not stored when the task ends: replaying them is as fast.
const EPOCHS_WORTH_STORING: usize = 32;

/// A message in the mailbox.
pub(super) enum Message {
    /// A push of epochs.
    Submission(Submission),
    /// A chunk of raw bytes.
    Raw(Box<RawSubmission>),
    /// The last message: closes the session at this time (ms since 1970-01-01 UTC).
    Close { unix_ms: i64, reply: oneshot::Sender<Result<(), SessionError>> },
}

/// A push in the mailbox.
pub(super) struct Submission {
    pub(super) epochs: Vec<SequencedEpoch>,
    /// Set when the message is sent.
    pub(super) permit: Option<MailboxPermit>,
    pub(super) reply: oneshot::Sender<Result<Submitted, SessionError>>,
}

/// A chunk in the mailbox.
pub(super) struct RawSubmission {
    pub(super) chunk: RawChunk,
    /// Set when the message is sent.
    pub(super) permit: Option<MailboxPermit>,
    pub(super) reply: oneshot::Sender<Result<RawReceived, SessionError>>,
}

impl Message {
    /// Attaches the permit that the message occupies while it waits.
    pub(super) fn set_permit(&mut self, permit: MailboxPermit) {
        match self {
            Self::Submission(submission) => submission.permit = Some(permit),
            Self::Raw(submission) => submission.permit = Some(permit),
            Self::Close { .. } => {}
        }
    }
}

/// The capacity that a message's epochs take while they wait. Dropping it frees the capacity.
pub(super) struct MailboxPermit {
    epochs: usize,
    of_session: Arc<AtomicUsize>,
    of_all: Arc<AtomicUsize>,
}

impl MailboxPermit {
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

impl Drop for MailboxPermit {
    fn drop(&mut self) {
        self.of_session.fetch_sub(self.epochs, Ordering::AcqRel);
        self.of_all.fetch_sub(self.epochs, Ordering::AcqRel);
    }
}

/// The data of a session's task.
pub(super) struct Task {
    pub(super) id: SessionId,
    pub(super) key: SessionKey,
    pub(super) store: Store,
    pub(super) aiding: AidingDesk,
    pub(super) solvers: Solvers,
    pub(super) epochs_per_push: usize,
    pub(super) observations_per_epoch: usize,
    /// The settings have changed and must be read before the next batch.
    pub(super) outdated: Arc<AtomicBool>,
}

/// A session in memory.
struct Active {
    committed: State,
    /// The configuration for the next epochs.
    configuration: Arc<ActiveConfiguration>,
    /// The stream of its receiver, once there are raw bytes.
    raw: Option<Box<Reception>>,
}

impl Active {
    /// Number of the last epoch.
    fn last_seq(&self) -> Option<u64> {
        self.committed.last.map(|(seq, _)| seq)
    }
}

impl Task {
    /// Runs until the mailbox is closed and empty, or the session is closed. The epochs of clients
    /// that disconnect are positioned and stored all the same.
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
                let is_full = EPOCHS_PER_BATCH <= epochs || other.is_some();
                next = if is_full { None } else { inbox.try_recv().ok() };
            }
            if !submissions.is_empty() {
                self.answer(&mut active, submissions).await;
            }
            match other {
                Some(Message::Raw(submission)) => {
                    let RawSubmission { chunk, permit, reply } = *submission;
                    // Boxed, because a task at rest needs as much memory as its largest future.
                    let answer = Box::pin(self.receive(&mut active, chunk)).await;
                    drop(permit);
                    reply.send(answer).ok(); // Err: the client hung up.
                }
                Some(Message::Close { unix_ms, reply }) => {
                    // Err: the caller has gone; the session is closed all the same.
                    reply.send(self.close(active, unix_ms).await).ok();
                    return;
                }
                Some(Message::Submission(_)) | None => {}
            }
        }
        self.park(active).await;
    }

    /// Stores the last revisions of the epochs in the window, and that the session is closed.
    async fn close(&self, active: Option<Active>, unix_ms: i64) -> Result<(), SessionError> {
        let mut state = match active {
            Some(active) => active.committed,
            None => self.restored(&self.active_configuration().await?).await?,
        };
        let revisions = self.solvers.estimate(move |scratch| state.finish(scratch)).await?;
        let revisions = revisions.iter().map(EncodedSolution::new).collect();
        let closed_unix_ms = Some(unix_ms);
        self.store.commit(Batch { revisions, closed_unix_ms, ..Batch::new(self.key) }).await?;
        Ok(())
    }

    /// Stores the state, so that the next task replays only a few epochs.
    async fn park(&self, active: Option<Active>) {
        let Some(Active { committed, .. }) = active else { return };
        if committed.unsaved < EPOCHS_WORTH_STORING {
            return;
        }
        let Ok(snapshot) = self.solvers.run(move || committed.encoded()).await else { return };
        if let Err(error) = self.store.commit(Batch { snapshot, ..Batch::new(self.key) }).await {
            // Nothing is lost, because the epochs are replayed.
            tracing::warn!(session = %self.id, %error, "a session's state was not stored");
        }
    }

    /// Positions and commits the pushes as one batch, and answers each of them.
    async fn answer(&self, active: &mut Option<Active>, mut submissions: Vec<Submission>) {
        let pushes: Vec<_> = submissions.iter_mut().map(|s| mem::take(&mut s.epochs)).collect();
        let lengths: Vec<usize> = pushes.iter().map(Vec::len).collect();
        let answers = self.advance(active, pushes.into_iter().flatten().collect()).await;
        let mut answers = answers.map(|(outcomes, through)| (outcomes.into_iter(), through));
        for (Submission { permit, reply, .. }, length) in submissions.into_iter().zip(lengths) {
            let answer = match &mut answers {
                Ok((outcomes, durable_through)) => Ok(Submitted {
                    outcomes: outcomes.take(length).collect(),
                    durable_through: *durable_through,
                }),
                Err(error) => Err(error.clone()),
            };
            drop(permit);
            reply.send(answer).ok(); // Err: the client hung up.
        }
    }

    async fn advance(
        &self,
        active: &mut Option<Active>,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<(Vec<EpochOutcome>, Option<u64>), SessionError> {
        let loaded = self.activated(active.take()).await?;
        self.process(active, loaded, epochs, None).await
    }

    /// Positions and commits epochs, together with the raw chunk that they come from. The new state
    /// is kept only after the commit. After a failure no state is kept, and the next batch starts
    /// from the store.
    async fn process(
        &self,
        active: &mut Option<Active>,
        Active { committed, configuration, raw: reception }: Active,
        epochs: Vec<SequencedEpoch>,
        raw: Option<Box<RawChange>>,
    ) -> Result<(Vec<EpochOutcome>, Option<u64>), SessionError> {
        let (batch, committed) = self.position(committed, &configuration, epochs).await?;
        let SolvedBatch { state, plans, rows, revisions, snapshot, solutions } = batch;
        let stored = self.lookup(&plans).await?;
        let batch = Batch { epochs: rows, revisions, snapshot, raw, ..Batch::new(self.key) };
        if !batch.is_empty() {
            self.store.commit(batch).await?;
        }
        let durable_through = state.last.map(|(seq, _)| seq);
        self.solvers.memory().recycle(committed);
        let newest = solutions.iter().rev().find_map(|stored| stored.solution.estimate.as_ref());
        let base = state.base().filter(|_| !configuration.bases.is_none());
        if let (Some(base), Some(estimate)) = (base, newest) {
            self.aiding.bases.record_rover(base, estimate.position);
        }
        if let (BaseChoice::Nearest, Some(estimate)) = (&configuration.bases, newest) {
            let request = NearestBaseRequest {
                position: estimate.position,
                baseline_max_m: configuration.estimation.options.rtk.baseline_max_m,
                unix_ms: unix_ms(),
            };
            self.aiding.bases.nearest_base_requests().record(self.key, request);
        }
        *active = Some(Active { committed: state, configuration, raw: reception });
        let outcome = |(seq, plan)| {
            let result = match plan {
                Plan::Refused(refusal) => Err(refusal),
                Plan::Lookup(epoch) => answer_from(&stored, &epoch, durable_through)?,
                Plan::Positioned { index, resent } => {
                    Ok(Acknowledged { solution: solutions[index].clone(), resent })
                }
            };
            Ok(EpochOutcome { seq, result })
        };
        let outcomes: Result<_, StoreError> = plans.into_iter().map(outcome).collect();
        Ok((outcomes?, durable_through))
    }

    /// The session in memory with its present configuration; restored if it was not in memory.
    async fn activated(&self, active: Option<Active>) -> Result<Active, SessionError> {
        let is_outdated = self.outdated.swap(false, Ordering::AcqRel);
        match active {
            Some(active) if !is_outdated => Ok(active),
            Some(active) => {
                Ok(Active { configuration: Arc::new(self.active_configuration().await?), ..active })
            }
            None => {
                let configuration = self.active_configuration().await?;
                let committed = self.restored(&configuration).await?;
                Ok(Active { committed, configuration: Arc::new(configuration), raw: None })
            }
        }
    }

    /// Positions a batch on the solver pool, starting from a copy of `committed`. Returns both.
    async fn position(
        &self,
        committed: State,
        configuration: &Arc<ActiveConfiguration>,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<(SolvedBatch, State), SessionError> {
        let aiding = self.aiding_for(configuration, &epochs);
        let (configuration, limit) = (configuration.clone(), self.observations_per_epoch);
        let memory = self.solvers.memory().clone();
        let work = move |scratch: &mut Scratch| {
            let state = memory.copy_of(&committed);
            let estimation = &configuration.estimation;
            (SolvedBatch::position(state, epochs, &aiding, estimation, limit, scratch), committed)
        };
        self.solvers.estimate(work).await
    }

    /// The aiding data for these epochs: everything known now.
    fn aiding_for(
        &self,
        configuration: &ActiveConfiguration,
        epochs: &[SequencedEpoch],
    ) -> BatchAiding {
        let times = || epochs.iter().map(|sequenced| sequenced.epoch.time);
        let span = times().min().zip(times().max());
        let options = &configuration.estimation.options;
        let source = BaseSource::new(&self.aiding.bases, &configuration.bases, span, options);
        BatchAiding { navigation: self.aiding.navigation.current(), source }
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

    async fn active_configuration(&self) -> Result<ActiveConfiguration, SessionError> {
        active_configuration(&self.store, &self.aiding, self.id.as_str()).await
    }

    /// The state after the last committed epoch.
    async fn restored(&self, configuration: &ActiveConfiguration) -> Result<State, SessionError> {
        let replay = Replay {
            store: self.store.clone(),
            aiding: self.aiding.clone(),
            solvers: self.solvers.clone(),
            key: self.key,
            with: ReplayWith::Stored,
            tolerates_missing: true,
        };
        restored(&replay, &configuration.estimation).await
    }
}

/// The stored answer to an earlier epoch, if it has the same content.
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
