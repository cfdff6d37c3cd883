//! The desk itself: the methods that the doors call.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::mem;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{Notify, mpsc, oneshot};
use tokio::task::JoinSet;

use crate::aiding::{AidingDesk, device};
use crate::clock::Clock;
use crate::store::{SessionRow, SessionSettings, Store};

use super::answers::Reply;
use super::configuration::settings;
use super::counters::Counters;
use super::live::Live;
use super::parked::{KeepsParked, ParkedState};
use super::removal::{remove_deleted, remove_expired_hourly};
use super::solvers::Solvers;
use super::task::{MailboxPermit, Message, RawSubmission, Submission, Task};
use super::tasks::{Handle, Start, Tasks};
use super::{
    NewSession, Pending, RawChunk, RawReceived, SequencedEpoch, SessionCounts, SessionError,
    SessionId, SessionInfo, SessionLimits, SessionUpdate, Submitted,
};

/// Number of locks for starting and closing sessions. A session's id selects its lock.
const STARTING_LOCKS: usize = 64;
/// Raw bytes that count as one waiting epoch in a mailbox. No receiver uses fewer bytes per epoch.
const BYTES_PER_EPOCH: usize = 256;

/// The desk for sessions. All clones share it.
///
/// A session's task is started by its first push, and holds the estimator in memory. At most
/// [`SessionLimits::active_sessions`] tasks run. To start another one, the least recently used
/// session without waiting epochs is parked: its task ends, and its next push starts a new task
/// from the store.
#[derive(Clone)]
pub struct Sessions {
    desk: Arc<Desk>,
}

struct Desk {
    store: Store,
    aiding: AidingDesk,
    limits: SessionLimits,
    solvers: Solvers,
    counters: Arc<Counters>,
    live: Arc<Live>,
    clock: Clock,
    /// Epochs that wait in all mailboxes together.
    waiting: Arc<AtomicUsize>,
    /// Locked from reading a session's row until its task is started, and while it is closed.
    starting: [tokio::sync::Mutex<()>; STARTING_LOCKS],
    tasks: Mutex<Tasks>,
    /// Wakes the task in `removal` that removes deleted sessions.
    deleted: Arc<Notify>,
    /// The tasks that remove what is deleted and what is expired. They end when the desk drains or
    /// is dropped.
    removal: Mutex<JoinSet<()>>,
}

impl Sessions {
    /// Opens the desk with the system's clock.
    pub fn open(store: Store, aiding: AidingDesk, limits: SessionLimits) -> Self {
        Self::open_at(store, aiding, limits, Clock::system())
    }

    /// The same with another clock.
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
        let expiring = remove_expired_hourly(store.clone(), clock.clone(), limits.retention_days);
        removal.spawn(expiring);
        let desk = Desk {
            store,
            aiding,
            solvers: Solvers::new(limits.solver_threads),
            live: Arc::new(Live::new(limits.live_solutions)),
            limits,
            counters: Arc::default(),
            clock,
            waiting: Arc::default(),
            starting: std::array::from_fn(|_| tokio::sync::Mutex::new(())),
            tasks: Mutex::new(tasks),
            deleted,
            removal: Mutex::new(removal),
        };
        Self { desk: Arc::new(desk) }
    }

    /// Creates a session and stores it.
    ///
    /// # Errors
    /// A configuration, base or antenna does not exist, the label is too long, or the store fails.
    pub async fn create(&self, new: NewSession) -> Result<SessionInfo, SessionError> {
        self.check_label(&new.label)?;
        self.check_retention(new.retention_days)?;
        let base = self.base_names(new.base)?;
        let antenna = self.antenna_name(&new.antenna).await?;
        let NewSession { label, mode, profile, overrides, retention_days, .. } = new;
        let settings = settings(label, mode, profile, overrides, base, antenna)?;
        let settings = SessionSettings { retention_days, ..settings };
        let id = SessionId::random();
        let row = self.desk.store.create_session(id.as_str(), &settings, self.unix_ms()).await?;
        self.info(id, row)
    }

    /// Changes the label, configuration or base of a session. Epochs sent after this call returns
    /// are positioned with the new configuration; epochs already in the mailbox may be, too.
    ///
    /// # Errors
    /// No session has this id, the session is closed, or a configuration, base or antenna does not
    /// exist.
    pub async fn update(
        &self,
        id: &SessionId,
        update: SessionUpdate,
    ) -> Result<SessionInfo, SessionError> {
        if let Some(label) = &update.label {
            self.check_label(label)?;
        }
        self.check_retention(update.retention_days)?;
        let _starting = self.starting(id).lock().await;
        let mut row = self.open_row(id).await?;
        let mut overrides = row.settings.overrides;
        overrides.retain(|name, _| !update.clear_overrides.contains(name));
        overrides.extend(update.overrides);
        let base = match update.base {
            None => row.settings.base,
            Some(base) => self.base_names(base)?,
        };
        let antenna = match update.antenna {
            None => row.settings.antenna,
            Some(antenna) => self.antenna_name(&antenna).await?,
        };
        let retention_days = update.retention_days.or(row.settings.retention_days);
        let settings = settings(
            update.label.unwrap_or(row.settings.label),
            update.mode.unwrap_or(row.settings.mode),
            update.profile.unwrap_or(row.settings.profile),
            overrides,
            base,
            antenna,
        )?;
        row.settings = SessionSettings { retention_days, ..settings };
        self.desk.store.update_session(row.key, &row.settings).await?;
        if let Some(handle) = self.tasks().handles.get(id) {
            handle.outdated.store(true, Ordering::Release);
        }
        self.info(id.clone(), row)
    }

    /// Begins a new arc of a session, after the epochs that wait: its next epoch may have any time,
    /// and its estimator starts again. Numbers go on rising.
    ///
    /// # Errors
    /// No session has this id, it is closed, or the store fails; nothing is then changed.
    pub async fn reset(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        let (reply, answer) = oneshot::channel();
        let message = Message::Reset { unix_ms: self.unix_ms(), permit: None, reply };
        self.send(id, &mut Some(message), 1).await?;
        answer.await.unwrap_or(Err(SessionError::Interrupted))?;
        self.get(id).await
    }

    /// Closes a session. It takes no more epochs, and its stored solutions stay readable. Waiting
    /// epochs are still positioned and stored, and the epochs in the window get their last
    /// revision.
    ///
    /// # Errors
    /// No session has this id, the service is stopping, or the store fails. The session then stays
    /// open.
    pub async fn close(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        let (desk, session) = (self.clone(), id.clone());
        // In its own task, so that the session is closed even if the caller disconnects.
        let closing = tokio::spawn(async move { desk.close_whole(&session).await });
        closing.await.unwrap_or(Err(SessionError::Interrupted))?;
        self.get(id).await
    }

    /// Deletes a session with all that it has stored; closes it before, if it is open. Returns it
    /// as it was. From then on it is not found; its space is freed in the background.
    ///
    /// # Errors
    /// No session has this id, the service is stopping, or the store fails; it may then be closed.
    pub async fn delete(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        let (info, row) = (self.close(id).await?, self.row(id).await?);
        self.desk.store.delete_session(row.key, self.unix_ms()).await?;
        self.desk.deleted.notify_one();
        Ok(info)
    }

    async fn close_whole(&self, id: &SessionId) -> Result<(), SessionError> {
        let _starting = self.starting(id).lock().await;
        let row = self.row(id).await?;
        if row.closed_unix_ms.is_some() {
            return Ok(());
        }
        if !self.tasks().handles.contains_key(id) {
            self.start(id, &row, Start::Closing)?;
        }
        // Removed first, so that no message follows the closing one.
        let handle = self.tasks().handles.remove(id).ok_or(SessionError::Draining)?;
        let (reply, answer) = oneshot::channel();
        let last = Message::Close { unix_ms: self.unix_ms(), reply };
        handle.mailbox.send(last).await.map_err(|_| SessionError::Interrupted)?;
        drop(handle);
        answer.await.unwrap_or(Err(SessionError::Interrupted))
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
        self.check_push(&epochs)?;
        let count = epochs.len();
        let (reply, answer) = oneshot::channel();
        let submission = Submission { epochs, permit: None, reply: Reply::Call(reply) };
        self.send(id, &mut Some(Message::Submission(submission)), count).await?;
        Ok(Pending(answer))
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
        let epochs = self.check_chunk(&chunk)?;
        let (reply, answer) = oneshot::channel();
        let reply = Reply::Call(reply);
        let submission = Box::new(RawSubmission { chunk, permit: None, reply });
        self.send(id, &mut Some(Message::Raw(submission)), epochs).await?;
        answer.await.unwrap_or(Err(SessionError::Interrupted))
    }

    /// Checks a chunk. Returns the number of epochs that it counts as in the mailbox: their true
    /// number is not known yet, so its length decides.
    pub(super) fn check_chunk(&self, chunk: &RawChunk) -> Result<usize, SessionError> {
        let (bytes, limit) = (chunk.content.len(), self.desk.limits.raw_chunk_bytes);
        if limit < bytes {
            return Err(SessionError::ChunkTooLarge { bytes, limit });
        }
        Ok((bytes / BYTES_PER_EPOCH + 1).min(self.desk.limits.epochs_per_push))
    }

    /// Puts a message into the session's mailbox, and starts its task if none runs. If it is
    /// refused, the message stays where it is.
    pub(super) async fn send(
        &self,
        id: &SessionId,
        message: &mut Option<Message>,
        epochs: usize,
    ) -> Result<(), SessionError> {
        if self.post(id, message, epochs)? {
            return Ok(());
        }
        let _starting = self.starting(id).lock().await;
        if self.post(id, message, epochs)? {
            return Ok(()); // Another call has started it meanwhile.
        }
        let row = self.open_row(id).await?;
        self.start(id, &row, Start::Epochs)?;
        if self.post(id, message, epochs)? { Ok(()) } else { Err(SessionError::Interrupted) }
    }

    /// Refuses new epochs, and waits until the accepted ones are positioned and stored.
    pub async fn drain(&self) {
        let mut running = {
            let mut tasks = self.tasks();
            tasks.draining = true;
            tasks.handles.clear();
            tasks.parked.clear();
            mem::take(&mut tasks.running)
        };
        while running.join_next().await.is_some() {}
        self.desk.removal.lock().unwrap_or_else(PoisonError::into_inner).abort_all();
    }

    /// Whether [`Self::drain`] was called.
    pub fn is_draining(&self) -> bool {
        self.tasks().draining
    }

    /// Numbers of events since the start.
    pub fn counts(&self) -> SessionCounts {
        self.desk.counters.read()
    }

    /// Whether epochs wait in a session's mailbox.
    pub(super) fn has_waiting(&self, id: &SessionId) -> bool {
        let tasks = self.tasks();
        tasks.handles.get(id).is_some_and(|handle| 0 < handle.waiting.load(Ordering::Acquire))
    }

    pub(super) fn live(&self) -> &Arc<Live> {
        &self.desk.live
    }

    /// The store.
    pub(crate) fn store(&self) -> &Store {
        &self.desk.store
    }

    pub(super) fn aiding(&self) -> &AidingDesk {
        &self.desk.aiding
    }

    pub(super) fn solvers(&self) -> &Solvers {
        &self.desk.solvers
    }

    /// The limits in force.
    pub(crate) fn limits(&self) -> &SessionLimits {
        &self.desk.limits
    }

    pub(super) async fn row(&self, id: &SessionId) -> Result<SessionRow, SessionError> {
        let row = self.desk.store.session(id.as_str()).await?;
        row.ok_or_else(|| SessionError::NotFound { id: id.to_string() })
    }

    pub(super) fn info(&self, id: SessionId, row: SessionRow) -> Result<SessionInfo, SessionError> {
        SessionInfo::of(id, row, self.desk.limits.retention_days)
    }

    pub(super) fn clock(&self) -> &Clock {
        &self.desk.clock
    }

    fn unix_ms(&self) -> i64 {
        self.desk.clock.unix_ms()
    }

    async fn open_row(&self, id: &SessionId) -> Result<SessionRow, SessionError> {
        let row = self.row(id).await?;
        match row.closed_unix_ms {
            None => Ok(row),
            Some(_) => Err(SessionError::Closed { id: id.to_string() }),
        }
    }

    fn tasks(&self) -> MutexGuard<'_, Tasks> {
        self.desk.tasks()
    }

    fn starting(&self, id: &SessionId) -> &tokio::sync::Mutex<()> {
        let mut hasher = DefaultHasher::new();
        id.hash(&mut hasher);
        &self.desk.starting[hasher.finish() as usize % STARTING_LOCKS]
    }

    /// Puts a message into the mailbox of a running task. Returns `false` and leaves it if none
    /// runs.
    fn post(
        &self,
        id: &SessionId,
        message: &mut Option<Message>,
        epochs: usize,
    ) -> Result<bool, SessionError> {
        let Desk { limits, waiting: of_all, .. } = &*self.desk;
        let retry_after = limits.retry_after;
        let mut tasks = self.tasks();
        if tasks.draining {
            return Err(SessionError::Draining);
        }
        tasks.posted += 1;
        let posted = tasks.posted;
        let Some(handle) = tasks.handles.get_mut(id) else { return Ok(false) };
        let (waiting, limit) = (handle.waiting.load(Ordering::Acquire), limits.mailbox_epochs);
        if limit < waiting + epochs {
            return Err(SessionError::MailboxFull { waiting, limit, retry_after });
        }
        let (all, limit) = (of_all.load(Ordering::Acquire), limits.waiting_epochs);
        if limit < all + epochs {
            return Err(SessionError::Overloaded { waiting: all, limit, retry_after });
        }
        let Some(mut posting) = message.take() else { return Ok(true) };
        posting.set_permit(MailboxPermit::take(epochs, &handle.waiting, of_all));
        match handle.mailbox.try_send(posting) {
            Ok(()) => {
                handle.last_used = posted;
                Ok(true)
            }
            Err(TrySendError::Full(posting)) => {
                *message = Some(posting);
                let limit = limits.mailbox_epochs;
                Err(SessionError::MailboxFull { waiting, limit, retry_after })
            }
            Err(TrySendError::Closed(posting)) => {
                *message = Some(posting);
                tasks.handles.remove(id);
                Ok(false)
            }
        }
    }

    /// Starts a session's task. If as many run as allowed, some of them are parked.
    fn start(&self, id: &SessionId, row: &SessionRow, start: Start) -> Result<(), SessionError> {
        let Desk { store, aiding, limits, solvers, counters, live, clock, .. } = &*self.desk;
        let mut tasks = self.tasks();
        if tasks.draining {
            return Err(SessionError::Draining);
        }
        let limit = limits.active_sessions;
        if limit <= tasks.handles.len() && !tasks.park_some(limit) && start == Start::Epochs {
            return Err(SessionError::TooManyActive { limit, retry_after: limits.retry_after });
        }
        let (mailbox, inbox) = mpsc::channel(limits.mailbox_epochs);
        let outdated = Arc::new(AtomicBool::new(false));
        let desk: Arc<dyn KeepsParked> = self.desk.clone();
        let task = Task {
            id: id.clone(),
            key: row.key,
            device: device(id.as_str()),
            store: store.clone(),
            aiding: aiding.clone(),
            solvers: solvers.clone(),
            epochs_per_push: limits.epochs_per_push,
            observations_per_epoch: limits.observations_per_epoch,
            future_s: limits.future_s,
            retention_days: limits.retention_days,
            clock: clock.clone(),
            outdated: outdated.clone(),
            counters: counters.clone(),
            live: live.clone(),
            parked: Mutex::new(tasks.parked.take(id, row)),
            desk: Arc::downgrade(&desk),
        };
        while tasks.running.try_join_next().is_some() {} // Forgets the tasks that have ended.
        tasks.running.spawn(task.run(inbox));
        let last_used = tasks.posted;
        let handle = Handle { mailbox, waiting: Arc::default(), outdated, last_used };
        tasks.handles.insert(id.clone(), handle);
        counters.in_memory.store(tasks.in_memory(), Ordering::Relaxed);
        Ok(())
    }
}

impl KeepsParked for Desk {
    fn is_draining(&self) -> bool {
        self.tasks().draining
    }

    fn keep_parked(&self, id: &SessionId, parked: ParkedState) {
        let mut tasks = self.tasks();
        if !tasks.draining && !tasks.handles.contains_key(id) {
            tasks.parked.insert(id, parked);
            self.counters.in_memory.store(tasks.in_memory(), Ordering::Relaxed);
        }
    }
}

impl Desk {
    fn tasks(&self) -> MutexGuard<'_, Tasks> {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
