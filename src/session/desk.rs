//! The desk itself: the methods that the doors call.

use std::collections::HashSet;
use std::mem;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{Notify, oneshot};
use tokio::task::JoinSet;

use crate::aiding::AidingDesk;
use crate::clock::Clock;
use crate::quotas::{Meter, Meters};
use crate::store::{Author, Claim, SessionKey, SessionRow, Store};
use crate::tenant::Tenant;
use crate::traces::{Trace, TraceSpan};

use super::answers::Reply;
use super::configurations::Configurations;
use super::counters::Counters;
use super::live::Live;
use super::locks::{SessionLock, SessionLocks};
use super::parked::stores_until;
use super::removal::{Expiry, remove_deleted};
use super::solvers::Solvers;
use super::task::{MailboxPermit, Message, RawSubmission, Submission};
use super::tasks::{Handle, Start, Tasks};
use super::update_rates::UpdateRates;
use super::updates_to_confirm::UpdatesToConfirm;
use super::{
    Pending, RawChunk, RawReceived, SequencedEpoch, SessionError, SessionId, SessionInfo,
    SessionLimits, Submitted,
};

/// The desk for sessions, as one tenant sees it. All clones share the desk.
///
/// A handle reads and changes the sessions of its tenant. It does not find other sessions.
///
/// A session's first push starts its task, which has the estimator in memory. At most
/// [`SessionLimits::active_sessions`] tasks run. To start another task, the least recently used
/// session without waiting epochs is parked: its task ends, and its next push starts a new task
/// from the parked or stored state.
#[derive(Clone)]
pub struct Sessions {
    desk: Arc<Desk>,
    meter: Arc<Meter>,
    /// The trace of the request that this handle serves.
    trace: Option<Arc<Trace>>,
}

pub(super) struct Desk {
    pub(super) store: Store,
    pub(super) aiding: AidingDesk,
    pub(super) limits: SessionLimits,
    solvers: Solvers,
    meters: Meters,
    pub(super) counters: Arc<Counters>,
    pub(super) live: Arc<Live>,
    pub(super) clock: Clock,
    pub(super) configurations: Configurations,
    /// Locked from the read of a session's row until its task has started, and while it is closed.
    starting: SessionLocks,
    pub(super) update_rates: UpdateRates,
    pub(super) updates_to_confirm: UpdatesToConfirm,
    tasks: Mutex<Tasks>,
    /// Wakes the task in `removal` that removes deleted sessions.
    deleted: Arc<Notify>,
    expiry: Arc<Expiry>,
    /// The tasks that remove deleted and expired rows. They end when the desk drains or is dropped.
    removal: Mutex<JoinSet<()>>,
}

impl Sessions {
    /// Opens the desk with the system's clock, for the operator's sessions.
    pub fn open(store: Store, aiding: AidingDesk, limits: SessionLimits) -> Self {
        Self::open_at(store, aiding, limits, Clock::system())
    }

    /// Like [`Self::open`], with another clock.
    pub fn open_at(
        store: Store,
        aiding: AidingDesk,
        mut limits: SessionLimits,
        clock: Clock,
    ) -> Self {
        limits.mailbox_epochs = limits.mailbox_epochs.max(limits.epochs_per_push);
        limits.waiting_epochs = limits.waiting_epochs.max(limits.epochs_per_push);
        let tasks = Tasks::new(limits.parked_bytes);
        let (deleted, mut removal) = (Arc::new(Notify::new()), JoinSet::new());
        removal.spawn(remove_deleted(store.clone(), deleted.clone()));
        let expiry = Expiry::new(store.clone(), clock.clone(), &limits);
        let expiry = Arc::new(expiry);
        removal.spawn(expiry.clone().remove_hourly());
        let desk = Desk {
            configurations: Configurations::stored_in(store.clone()),
            store,
            aiding,
            solvers: Solvers::new(limits.solver_threads),
            meters: Meters::default(),
            live: Arc::new(Live::new(limits.live_solutions)),
            limits,
            counters: Arc::new(Counters::new()),
            clock,
            starting: SessionLocks::default(),
            update_rates: UpdateRates::default(),
            updates_to_confirm: UpdatesToConfirm::default(),
            tasks: Mutex::new(tasks),
            deleted,
            expiry,
            removal: Mutex::new(removal),
        };
        let meter = desk.meters.of(&Tenant::operator());
        Self { desk: Arc::new(desk), meter, trace: None }
    }

    /// The desk for the sessions of a tenant.
    #[must_use]
    pub fn of(&self, tenant: &Tenant) -> Self {
        Self { desk: self.desk.clone(), meter: self.desk.meters.of(tenant), trace: None }
    }

    /// The desk for a request; pushes are part of its trace, if it has one.
    #[must_use]
    pub(crate) fn traced(self, trace: Option<Arc<Trace>>) -> Self {
        Self { trace, ..self }
    }

    /// Begins a new arc of a session, after the epochs that wait. The estimator starts again. The
    /// time of the next epoch may be earlier than the last one's, unless it is implausible; its
    /// number must still be higher.
    ///
    /// # Errors
    /// No session has this id, it is closed, or the store fails; nothing is then changed.
    pub async fn reset(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        self.reset_by(id, None).await
    }

    /// Like [`Self::reset`], as an act of `author`.
    ///
    /// # Errors
    /// As for [`Self::reset`].
    pub(crate) async fn reset_by(
        &self,
        id: &SessionId,
        author: Option<&Author>,
    ) -> Result<SessionInfo, SessionError> {
        let entry = author.map(|author| self.entry(author, "Sessions.Reset", id, String::new()));
        let (reply, answer) = oneshot::channel();
        let message = Message::Reset { unix_ms: self.unix_ms(), entry, permit: None, reply };
        self.send(id, &mut Some(message), 1).await?;
        answer.await.unwrap_or(Err(SessionError::Interrupted))?;
        self.get(id).await
    }

    /// Positions and commits the epochs of one push; returns when they are durable.
    ///
    /// # Errors
    /// The push is refused or could not be committed: nothing of it is acknowledged.
    pub async fn submit(
        &self,
        id: &SessionId,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<Submitted, SessionError> {
        self.enqueue(id, epochs).await?.answer().await
    }

    /// Puts the epochs of one push into the session's mailbox. Pushes of consecutive calls are
    /// positioned in that order, and their answers can be awaited later.
    ///
    /// # Errors
    /// No session has this id, the session is closed, the push is too large, or the mailbox is
    /// full. Nothing is accepted.
    pub async fn enqueue(
        &self,
        id: &SessionId,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<Pending, SessionError> {
        let count = epochs.len();
        let posting = async {
            self.admit_push(&epochs)?;
            let (reply, answer) = oneshot::channel();
            let submission = Submission { epochs, permit: None, reply: Reply::Call(reply) };
            self.send(id, &mut Some(Message::Submission(submission)), count).await?;
            self.meter().count_epochs(count);
            Ok(Pending(answer))
        };
        posting.await.inspect_err(|_| self.counts().count_refused(count))
    }

    /// Takes a chunk of a receiver's stream. Returns when its bytes, and the epochs that they
    /// complete, are durable. Chunks of consecutive calls are taken in that order.
    ///
    /// # Errors
    /// The chunk is refused or could not be committed: nothing of it is acknowledged.
    pub async fn receive(
        &self,
        id: &SessionId,
        chunk: RawChunk,
    ) -> Result<RawReceived, SessionError> {
        let epochs = self.admit_chunk(&chunk)?;
        let (reply, answer) = oneshot::channel();
        let reply = Reply::Call(reply);
        let submission = Box::new(RawSubmission { chunk, permit: None, reply });
        self.send(id, &mut Some(Message::Raw(submission)), epochs).await?;
        answer.await.unwrap_or(Err(SessionError::Interrupted))
    }

    /// Puts a message into the session's mailbox, and starts its task if none runs. If the mailbox
    /// refuses it, `message` still contains it.
    pub(super) async fn send(
        &self,
        id: &SessionId,
        message: &mut Option<Message>,
        epochs: usize,
    ) -> Result<(), SessionError> {
        if self.post(id, message, epochs)? {
            return Ok(());
        }
        let _starting = self.starting(id).await;
        if self.post(id, message, epochs)? {
            return Ok(()); // Another call has started it meanwhile.
        }
        if !self.resume(id)? {
            // While commits fail, reads may take as long as their deadline.
            self.store().settled()?;
            let row = self.claimed(self.open_row(id).await?, id).await?;
            self.start(id, row, Start::Epochs)?;
        }
        if self.post(id, message, epochs)? { Ok(()) } else { Err(SessionError::Interrupted) }
    }

    /// Counts the time by which ages are counted until now.
    pub(crate) async fn count_time(&self) {
        self.desk.expiry.count().await;
    }

    /// Refuses new epochs, and waits until the accepted ones are positioned and stored.
    pub async fn drain(&self) {
        let mut running = {
            let mut tasks = self.tasks();
            tasks.stops.get_or_insert_with(stores_until);
            tasks.handles.clear();
            tasks.parking.clear();
            tasks.parked.clear();
            mem::take(&mut tasks.running)
        };
        while running.join_next().await.is_some() {}
        self.count_time().await;
        self.desk.removal.lock().unwrap_or_else(PoisonError::into_inner).abort_all();
    }

    /// Whether [`Self::drain`] was called.
    pub fn is_draining(&self) -> bool {
        self.tasks().stops.is_some()
    }

    /// Counts of all sessions since the start.
    pub fn counts(&self) -> &Counters {
        &self.desk.counters
    }

    /// Whether epochs wait in a session's mailbox.
    pub(super) fn has_waiting(&self, id: &SessionId) -> bool {
        let tasks = self.tasks();
        let own = tasks.own(id, self.tenant());
        own.is_some_and(|handle| 0 < handle.waiting.load(Ordering::Acquire))
    }

    pub(super) fn live(&self) -> &Arc<Live> {
        &self.desk.live
    }

    /// Wakes the task that removes deleted sessions.
    pub(super) fn deleted(&self) -> &Notify {
        &self.desk.deleted
    }

    pub(super) fn expiry(&self) -> &Expiry {
        &self.desk.expiry
    }

    /// The store.
    pub(crate) fn store(&self) -> &Store {
        &self.desk.store
    }

    pub(super) fn aiding(&self) -> &AidingDesk {
        &self.desk.aiding
    }

    /// The solver pool, for the tenant.
    pub(super) fn solvers(&self) -> Solvers {
        self.desk.solvers.of(self.meter.clone())
    }

    /// The limits in force.
    pub(crate) fn limits(&self) -> &SessionLimits {
        &self.desk.limits
    }

    pub(super) async fn row(&self, id: &SessionId) -> Result<SessionRow, SessionError> {
        let row = self.desk.store.session(self.tenant(), id.as_str()).await?;
        row.ok_or_else(|| SessionError::NotFound { id: id.to_string() })
    }

    pub(super) fn info(&self, id: SessionId, row: SessionRow) -> Result<SessionInfo, SessionError> {
        SessionInfo::of(id, row, self.desk.limits.retention_days)
    }

    /// The tenant whose sessions this handle serves.
    pub(super) fn tenant(&self) -> &Tenant {
        self.meter.tenant()
    }

    /// The meter of the tenant.
    pub(super) fn meter(&self) -> &Meter {
        &self.meter
    }

    /// The meters of all tenants.
    pub(crate) fn meters(&self) -> &Meters {
        &self.desk.meters
    }

    pub(super) fn clock(&self) -> &Clock {
        &self.desk.clock
    }

    pub(super) fn unix_ms(&self) -> i64 {
        self.desk.clock.unix_ms()
    }

    pub(super) async fn open_row(&self, id: &SessionId) -> Result<SessionRow, SessionError> {
        let row = self.row(id).await?;
        match row.closed_unix_ms {
            None => Ok(row),
            Some(_) => Err(SessionError::Closed { id: id.to_string() }),
        }
    }

    /// The row of a session, read after this node has claimed it.
    ///
    /// # Errors
    /// The session belongs to another node, or the store fails.
    pub(super) async fn claimed(
        &self,
        row: SessionRow,
        id: &SessionId,
    ) -> Result<SessionRow, SessionError> {
        match self.desk.store.claim(row.key).await? {
            Claim::Own => Ok(row),
            Claim::Taken => {
                self.tasks().forget_parked(id); // It is another node's work from now on.
                if !row.settings.base.is_none() {
                    // Base epochs that its former node has received must be known before the
                    // session is replayed.
                    self.desk.aiding.bases.follow().await?;
                }
                self.row(id).await
            }
        }
    }

    /// Whether the task of a session runs here. The session then belongs to this node.
    pub(crate) fn runs(&self, id: &SessionId) -> bool {
        self.tasks().handles.contains_key(id)
    }

    /// Makes watches of sessions of other nodes read the store again.
    pub(crate) fn wake_watches(&self) {
        if !self.live().has_watches() {
            return;
        }
        let here: HashSet<SessionKey> = self.tasks().handles.values().map(|h| h.key).collect();
        self.live().publish_elsewhere(|key| here.contains(&key));
    }

    pub(super) fn desk(&self) -> &Arc<Desk> {
        &self.desk
    }

    pub(super) fn tasks(&self) -> MutexGuard<'_, Tasks> {
        self.desk.tasks()
    }

    /// Waits until no other call starts, changes or closes this session.
    pub(super) async fn starting(&self, id: &SessionId) -> SessionLock<'_> {
        self.desk.starting.lock(id).await
    }

    /// Puts a message into the mailbox of a running task. Returns `false` if no task runs;
    /// `message` then still contains it.
    fn post(
        &self,
        id: &SessionId,
        message: &mut Option<Message>,
        epochs: usize,
    ) -> Result<bool, SessionError> {
        let (limits, of_all) = (&self.desk.limits, &self.desk.counters.waiting);
        let retry_after = limits.retry_after;
        let mut tasks = self.tasks();
        if tasks.stops.is_some() {
            return Err(SessionError::Draining);
        }
        tasks.posted += 1;
        let posted = tasks.posted;
        let own = |handle: &&mut Handle| handle.tenant == *self.tenant();
        let Some(handle) = tasks.handles.get_mut(id).filter(own) else { return Ok(false) };
        let (waiting, limit) = (handle.waiting.load(Ordering::Acquire), limits.mailbox_epochs);
        if limit < waiting + epochs {
            return Err(SessionError::MailboxFull { waiting, limit, retry_after });
        }
        let (all, limit) = (of_all.load(Ordering::Acquire), limits.waiting_epochs);
        if limit < all + epochs {
            return Err(SessionError::Overloaded { waiting: all, limit, retry_after });
        }
        let Some(mut posting) = message.take() else { return Ok(true) };
        let mut permit = MailboxPermit::take(epochs, &handle.waiting, of_all);
        permit.is_streamed = posting.is_streamed();
        permit.trace = self.span(id, epochs, &posting);
        posting.set_permit(permit);
        match handle.mailbox.try_send(posting) {
            Ok(()) => {
                handle.last_used = posted;
                Ok(true)
            }
            Err(TrySendError::Full(mut posting)) => {
                posting.forget_trace();
                *message = Some(posting);
                let limit = limits.mailbox_epochs;
                Err(SessionError::MailboxFull { waiting, limit, retry_after })
            }
            Err(TrySendError::Closed(mut posting)) => {
                posting.forget_trace();
                *message = Some(posting);
                tasks.handles.remove(id);
                Ok(false)
            }
        }
    }

    /// The span of a push, if its request is traced.
    fn span(&self, id: &SessionId, epochs: usize, push: &Message) -> Option<TraceSpan> {
        let mut span = self.trace.as_ref()?.push(push.is_streamed())?;
        span.set("graphfix.session", id);
        span.set("graphfix.tenant", self.tenant());
        span.set("graphfix.epochs", epochs);
        Some(span)
    }
}

impl Desk {
    pub(super) fn tasks(&self) -> MutexGuard<'_, Tasks> {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
