//! One session's task: the sole owner of its estimator. It handles messages in order of arrival.

mod message;
mod parking;
mod positioning;
mod receive;
mod stages;

use std::collections::HashMap;
use std::mem;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::{Duration, Instant};

use tokio::sync::mpsc;

use crate::aiding::AidingDesk;
use crate::aiding::bases::{BaseChoice, NearestBaseRequest};
use crate::clock::Clock;
use crate::config::OutputOptions;
use crate::positioning::Scratch;
use crate::store::{
    ArcStart, AuditEntry, Batch, EncodedSolution, SessionKey, SessionRow, Store, StoreError,
    StoredEpoch, StoredSolution,
};
use crate::tenant::Tenant;
use crate::traces::Work;

use super::batch::{Plan, SolvedBatch, Unanswered};
use super::configurations::{ActiveConfiguration, Configurations};
use super::counters::{Counters, Stage};
use super::info::oldest_available;
use super::live::Live;
use super::parked::{KeepsParked, ParkedState};
use super::raw::Reception;
use super::solvers::{Lane, Solvers};
use super::state::State;
use super::{
    Acknowledged, EpochOutcome, EpochRefusal, SequencedEpoch, SessionError, SessionId, Submitted,
};

pub(super) use message::{Arrived, MailboxPermit, Message, RawSubmission, Submission};
pub(super) use stages::Stages;

/// A batch takes no further push once it has this many epochs.
const EPOCHS_PER_BATCH: usize = 1_024;

/// Most arcs of a session. A search for a time looks into each of them.
const ARCS: usize = 1_000;

/// The data of a session's task.
pub(super) struct Task {
    pub(super) id: SessionId,
    pub(super) key: SessionKey,
    /// Tenant that owns the session.
    pub(super) tenant: Tenant,
    /// The session's device as a source of navigation data.
    pub(super) device: Arc<str>,
    pub(super) store: Store,
    pub(super) aiding: AidingDesk,
    pub(super) solvers: Solvers,
    pub(super) epochs_per_push: usize,
    pub(super) observations_per_epoch: usize,
    /// See [`super::SessionLimits::future_s`].
    pub(super) future_s: u64,
    /// See [`super::SessionLimits::retention_days`].
    pub(super) retention_days: u32,
    pub(super) clock: Clock,
    /// The settings have changed and must be read before the next batch.
    pub(super) outdated: Arc<AtomicBool>,
    pub(super) counters: Arc<Counters>,
    /// Shows committed solutions to the watches.
    pub(super) live: Arc<Live>,
    /// The stages of the batch that is being answered.
    pub(super) stages: Stages,
    pub(super) configurations: Configurations,
    /// What is already known of the session when the task begins.
    pub(super) known: Mutex<Option<Known>>,
    /// Keeps the state when the session is parked.
    pub(super) desk: Weak<dyn KeepsParked>,
}

/// What is already known of a session when its task begins.
pub(in crate::session) enum Known {
    /// The state with which it was parked.
    State(Box<ParkedState>),
    /// Its row.
    Row(Box<SessionRow>),
}

/// A session in memory.
struct Active {
    /// The state after the last confirmed commit.
    committed: Arc<State>,
    /// The state after a later commit that the database has not confirmed. The store is asked
    /// before the next batch whether it is valid.
    unconfirmed: Option<Arc<State>>,
    /// The configuration for the next epochs.
    configuration: Arc<ActiveConfiguration>,
    /// Expected time of an epoch on the solver; unknown before the first one.
    epoch_time: Option<Duration>,
    /// The stream of its receiver, once there are raw bytes.
    raw: Option<Box<Reception>>,
    /// The last day for which a snapshot was kept for replay, if known; see `Task::kept_day`.
    kept_day: Option<i64>,
}

impl Active {
    /// Number of the last epoch.
    fn last_seq(&self) -> Option<u64> {
        self.committed.last_seq()
    }

    /// Frame and heights in which its solutions are reported.
    fn output(&self) -> OutputOptions {
        self.configuration.estimation.options.output
    }
}

impl Task {
    /// Runs until the mailbox is closed and empty, or the session is closed. The epochs of clients
    /// that have disconnected are still positioned and stored.
    pub(super) async fn run(self, mut inbox: mpsc::Receiver<Message>) {
        let mut active = None;
        while let Some(first) = inbox.recv().await {
            let (mut next, mut epochs) = (Some(first), 0);
            let (mut submissions, mut other) = (Vec::new(), None);
            while let Some(message) = next {
                if let Some(waited) = message.waited() {
                    self.counters.record(Stage::Waiting, waited);
                }
                match message {
                    // Dropped, because its stream has ended with an earlier error.
                    message if message.is_broken() => {}
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
                    let RawSubmission { chunk, mut permit, reply } = *submission;
                    self.stages.begin(std::iter::once(&permit));
                    // Boxed, because a task at rest needs as much memory as its largest future.
                    let answer = Box::pin(self.receive(&mut active, chunk, &mut permit)).await;
                    let stages = self.stages.take();
                    permit.iter_mut().for_each(|permit| permit.answered(&stages, &answer));
                    drop(permit);
                    reply.send(answer);
                }
                Some(Message::Reset { unix_ms, entry, permit, reply }) => {
                    let answer = Box::pin(self.reset(&mut active, unix_ms, entry)).await;
                    drop(permit);
                    reply.send(answer).ok(); // Err: the client hung up.
                }
                Some(Message::Close { unix_ms, entry, reply }) => {
                    // Err: the caller has gone; the session is closed anyway.
                    reply.send(self.close(&mut active, unix_ms, entry).await).ok();
                    return;
                }
                Some(Message::Submission(_)) | None => {}
            }
        }
        self.park(active).await;
    }

    /// Stores the last revisions of the epochs in the window, and the beginning of a new arc.
    async fn reset(
        &self,
        active: &mut Option<Active>,
        unix_ms: i64,
        entry: Option<Box<AuditEntry>>,
    ) -> Result<(), SessionError> {
        let current = self.activate(active).await?;
        let Some(after_seq) = current.last_seq() else { return Ok(()) };
        if ARCS <= self.store.arcs(self.key).await?.len() {
            return Err(SessionError::TooManyArcs { limit: ARCS });
        }
        let keeps_snapshot = self.keeps_snapshot(current);
        let mut state = (*current.committed).clone();
        let estimation = current.configuration.estimation.clone();
        let work = move |scratch: &mut Scratch| {
            let revised = state.begin_arc(&estimation, scratch);
            let snapshot = state.encoded();
            (state, revised, snapshot)
        };
        let (state, revised, snapshot) = self.solvers.estimate(Lane::RealTime, work).await?;
        let revisions = revised.iter().map(EncodedSolution::new).collect();
        let arc = Some(Box::new(ArcStart { after_seq, unix_ms }));
        let batch = self.batch(Some(after_seq));
        let batch = Batch { revisions, snapshot, keeps_snapshot, arc, entry, ..batch };
        let stored = self.store.commit(batch).await;
        // The last number does not show an unconfirmed arc: the next activation reads the store.
        stored.inspect_err(|_| *active = None)?;
        self.live.publish(self.key, &revised);
        if let Some(current) = active {
            current.committed = Arc::new(state);
            self.note_kept(current, keeps_snapshot);
            current.raw = None; // Restored with the date of the clock.
        }
        Ok(())
    }

    /// Stores the last revisions of the epochs in the window, and the end of the session.
    async fn close(
        &self,
        active: &mut Option<Active>,
        unix_ms: i64,
        entry: Option<Box<AuditEntry>>,
    ) -> Result<(), SessionError> {
        let mut state = (*self.activate(active).await?.committed).clone();
        let previous = state.last_seq();
        let revised =
            self.solvers.estimate(Lane::RealTime, move |scratch| state.finish(scratch)).await?;
        let revisions = revised.iter().map(EncodedSolution::new).collect();
        let closed_unix_ms = Some(unix_ms);
        let batch = self.batch(previous);
        self.store.commit(Batch { revisions, closed_unix_ms, entry, ..batch }).await?;
        self.live.publish(self.key, &revised);
        self.live.publish_closed(self.key);
        Ok(())
    }

    /// Positions and commits the pushes as one batch, and answers each of them.
    async fn answer(&self, active: &mut Option<Active>, mut submissions: Vec<Submission>) {
        let pushes: Vec<_> = submissions.iter_mut().map(|s| mem::take(&mut s.epochs)).collect();
        let lengths: Vec<usize> = pushes.iter().map(Vec::len).collect();
        let epochs = pushes.into_iter().flatten().collect();
        let is_patient = submissions.iter().all(|sent| MailboxPermit::is_of_stream(&sent.permit));
        self.stages.begin(submissions.iter().map(|submission| &submission.permit));
        let answers = self.advance(active, Arrived { epochs, raw: None, is_patient }).await;
        let stages = self.stages.take();
        let output = active.as_ref().map_or_else(OutputOptions::as_computed, Active::output);
        let mut answers = answers.map(|(outcomes, through)| (outcomes.into_iter(), through));
        for (Submission { mut permit, reply, .. }, length) in submissions.into_iter().zip(lengths) {
            let answer = match &mut answers {
                Ok((outcomes, durable_through)) => Ok(Submitted {
                    outcomes: outcomes.take(length).collect(),
                    durable_through: *durable_through,
                    output,
                }),
                Err(error) => {
                    self.counters.count_refused(length);
                    Err(error.clone())
                }
            };
            permit.iter_mut().for_each(|permit| permit.answered(&stages, &answer));
            drop(permit);
            reply.send(answer);
        }
    }

    async fn advance(
        &self,
        active: &mut Option<Active>,
        arrived: Arrived,
    ) -> Result<(Vec<EpochOutcome>, Option<u64>), SessionError> {
        self.activate(active).await?;
        self.process(active, arrived).await
    }

    /// Positions and commits epochs of an activated session, together with the raw chunk that they
    /// come from. The new state is kept only after the commit. After a failure the session
    /// continues from the state before.
    async fn process(
        &self,
        active: &mut Option<Active>,
        Arrived { epochs, raw, is_patient }: Arrived,
    ) -> Result<(Vec<EpochOutcome>, Option<u64>), SessionError> {
        let current = active.as_mut().expect("the session is activated");
        if epochs.is_empty() {
            let committed = current.committed.clone();
            let durable_through = committed.last_seq();
            if raw.is_none() {
                return Ok((Vec::new(), durable_through));
            }
            let batch = self.batch(durable_through);
            let stored = self.store.commit(Batch { raw, is_patient, ..batch }).await;
            stored.map_err(|error| failed(active, committed, error))?;
            return Ok((Vec::new(), durable_through));
        }
        let configuration = current.configuration.clone();
        let rules = self.rules(current);
        let batch = self.position(current, rules, epochs).await?;
        let SolvedBatch { state, plans, rows, revisions, revised, snapshot, solutions, panics } =
            batch;
        for (seq, panic) in panics {
            tracing::error!(session = %self.id, seq, panic, "the estimator failed on an epoch");
            self.counters.meters.quarantined.inc();
        }
        let stored = self.lookup(&plans).await?;
        let keeps_snapshot = snapshot.is_some() && rules.keeps_snapshot;
        let (arrival, epochs) = (Some(rules.arrival), rows);
        let batch = self.batch(active.as_ref().and_then(Active::last_seq));
        let batch = Batch { arrival, epochs, revisions, snapshot, keeps_snapshot, ..batch };
        let batch = Batch { raw, is_patient, ..batch };
        if !batch.is_empty() {
            let begun = Instant::now();
            let committed = self.store.commit(batch).await;
            committed.map_err(|error| failed(active, Arc::new(state.clone()), error))?;
            self.counters.record(Stage::Committing, begun.elapsed());
            self.stages.note(Work::Commit, begun);
        }
        self.live.publish(self.key, solutions.iter().chain(&revised));
        let current = active.as_mut().expect("it stays after a commit");
        let durable_through = state.last_seq();
        self.note_kept(current, keeps_snapshot);
        self.report_position(&configuration, &state, &solutions);
        if let Ok(before) = Arc::try_unwrap(mem::replace(&mut current.committed, Arc::new(state))) {
            self.solvers.memory().recycle(before);
        }
        solutions.iter().for_each(|stored| self.counters.count_epoch(stored.solution.status));
        let mut unanswered = Unanswered::new(solutions, &plans);
        let outcome = |(seq, plan)| {
            let result = match plan {
                Plan::Refused(refusal) => Err(refusal),
                Plan::Lookup(epoch) => answer_from(&stored, &epoch, durable_through)?,
                Plan::Positioned { index, resent } => {
                    Ok(Acknowledged { solution: unanswered.take(index), resent })
                }
            };
            self.counters.count_refused(usize::from(result.is_err()));
            Ok(EpochOutcome { seq, result })
        };
        let outcomes: Result<_, StoreError> = plans.into_iter().map(outcome).collect();
        Ok((outcomes?, durable_through))
    }

    /// Reports the rover's position to the streams and archives that depend on it.
    fn report_position(
        &self,
        configuration: &ActiveConfiguration,
        state: &State,
        solutions: &[StoredSolution],
    ) {
        let newest = solutions.iter().rev().find_map(|stored| stored.solution.estimate.as_ref());
        let base = state.base().filter(|_| !configuration.bases.is_none());
        if let (Some(base), Some(estimate)) = (base, newest) {
            self.aiding.bases.record_rover(base, estimate.position);
        }
        if let (BaseChoice::Nearest, Some(estimate)) = (&configuration.bases, newest) {
            let request = NearestBaseRequest {
                position: estimate.position,
                baseline_max_m: configuration.estimation.options.rtk.baseline_max_m,
                unix_ms: self.clock.unix_ms(),
            };
            self.aiding.bases.nearest_base_requests().record(self.key, request);
        }
    }

    /// The session in memory with its present configuration. It is restored if necessary.
    async fn activate<'a>(
        &self,
        active: &'a mut Option<Active>,
    ) -> Result<&'a mut Active, SessionError> {
        self.confirm(active).await?;
        let row = self.begin(active).await;
        let is_outdated = self.outdated.swap(false, Ordering::AcqRel);
        if active.is_none() {
            // A reset that is not confirmed may still be stored, and keeps the last number.
            self.store.settled()?;
        }
        if is_outdated || active.is_none() {
            let row = row.filter(|_| !is_outdated);
            // Between the read of the row and this task, nobody else writes epochs of the session.
            let is_new = row.as_ref().is_some_and(|row| row.last_seq.is_none());
            let read = self.active_configuration(row).await;
            // After a failure the next batch reads the configuration again.
            let failed = |_: &SessionError| self.outdated.store(true, Ordering::Release);
            let configuration = Arc::new(read.inspect_err(failed)?);
            if configuration.is_closed {
                *active = None;
                return Err(SessionError::Closed { id: self.id.to_string() });
            }
            if let Some(current) = active {
                current.configuration = configuration;
                current.epoch_time = None;
            } else {
                let committed = Arc::new(match is_new {
                    true => State::new(&configuration.estimation),
                    false => self.restored(&configuration).await?,
                });
                let epoch_time = committed.epoch_time();
                if committed.last_seq().is_some() {
                    self.counters.meters.restores.inc();
                }
                self.live.publish_unknown(self.key);
                *active = Some(Active {
                    committed,
                    unconfirmed: None,
                    configuration,
                    epoch_time,
                    raw: None,
                    // All of a new session can be replayed from its beginning.
                    kept_day: is_new.then(|| self.kept_day()),
                });
            }
        }
        Ok(active.as_mut().expect("it was just loaded"))
    }

    /// Asks the store whether an unconfirmed commit is stored.
    async fn confirm(&self, active: &mut Option<Active>) -> Result<(), SessionError> {
        let unconfirmed = active.as_ref().and_then(|current| current.unconfirmed.clone());
        let Some(later) = unconfirmed else { return Ok(()) };
        let stored = self.store.confirmed_last_number(self.key).await?;
        self.live.publish_unknown(self.key);
        match active {
            Some(current) if stored == later.last_seq() => {
                current.committed = later;
                current.unconfirmed = None;
            }
            Some(current) if stored == current.last_seq() => current.unconfirmed = None,
            _ => *active = None, // Another writer's epochs: restored from the store.
        }
        Ok(())
    }

    async fn lookup(&self, plans: &[(u64, Plan)]) -> Result<Earlier, StoreError> {
        let asked = plans.iter().filter(|(_, plan)| matches!(plan, Plan::Lookup(_)));
        let asked: Vec<u64> = asked.map(|(seq, _)| *seq).collect();
        if asked.is_empty() {
            return Ok(Earlier::default());
        }
        let found = self.store.epochs(self.key, &asked).await?;
        let stored: HashMap<_, _> =
            found.into_iter().map(|stored| (stored.solution.seq, stored)).collect();
        let removed_through = match asked.iter().all(|seq| stored.contains_key(seq)) {
            true => None,
            false => self.store.removed_through(self.key).await?,
        };
        Ok(Earlier { stored, removed_through })
    }

    /// The options and bases in force, according to the session's row.
    async fn active_configuration(
        &self,
        row: Option<Box<SessionRow>>,
    ) -> Result<ActiveConfiguration, SessionError> {
        let row = match row {
            Some(row) => row,
            None => {
                let row = self.store.session_of_any(self.id.as_str()).await?;
                let missing = || SessionError::NotFound { id: self.id.to_string() };
                Box::new(row.ok_or_else(missing)?)
            }
        };
        self.configurations.active(&self.aiding, &row).await
    }
}

/// Stored data about epochs that were sent again.
#[derive(Default)]
struct Earlier {
    stored: HashMap<u64, StoredEpoch>,
    /// Number of the last removed epoch, if one of the asked epochs is not stored.
    removed_through: Option<u64>,
}

/// Updates the session in memory after a failed commit. It keeps the state before the commit, and
/// the state after it if the store may have it.
fn failed(active: &mut Option<Active>, later: Arc<State>, error: StoreError) -> StoreError {
    match (&error, active.as_mut()) {
        (StoreError::AlreadyStored, _) => *active = None, // Another writer has later epochs.
        (StoreError::Unconfirmed { .. }, Some(current)) => {
            current.unconfirmed = Some(later);
        }
        _ => {}
    }
    error
}

/// The stored answer to an earlier epoch, if it has the same content.
fn answer_from(
    earlier: &Earlier,
    SequencedEpoch { seq, epoch }: &SequencedEpoch,
    last: Option<u64>,
) -> Result<Result<Acknowledged, EpochRefusal>, StoreError> {
    let seq = *seq;
    if let Some(oldest_available) = oldest_available(earlier.removed_through)
        && seq < oldest_available
    {
        return Ok(Err(EpochRefusal::AlreadyAcknowledged { seq, oldest_available }));
    }
    let Some(stored) = earlier.stored.get(&seq) else {
        return Ok(Err(EpochRefusal::Superseded { seq, last: last.unwrap_or(seq) }));
    };
    if stored.is(epoch) {
        Ok(Ok(Acknowledged { solution: stored.solution.clone(), resent: true }))
    } else {
        Ok(Err(EpochRefusal::Conflict { seq }))
    }
}
