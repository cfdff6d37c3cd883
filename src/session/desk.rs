//! The desk itself: what the doors call.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::mem;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;

use crate::aiding::AidingDesk;
use crate::aiding::bases::{BaseChoice, BaseId};
use crate::clock::unix_ms;
use crate::store::{
    Page, SessionKey, SessionRow, SolutionQuery, Store, StoreError, StoredSolution,
};

use super::configuration::{settings, stored_options};
use super::solvers::Solvers;
use super::task::{Message, Place, RawSubmission, Submission, Task};
use super::{
    NewSession, Pending, RawPiece, RawReceived, SequencedEpoch, SessionError, SessionId,
    SessionInfo, SessionLimits, SessionUpdate, Submitted,
};

/// Locks that starting and closing a session share, by its id.
const STARTING_LOCKS: usize = 64;
/// What raw bytes take of the room for epochs: no receiver says less of an epoch.
const BYTES_PER_EPOCH: usize = 256;

/// The desk for sessions. Clones share it.
///
/// A session's task is started by its first batch of epochs and holds the estimator in memory. When
/// [`SessionLimits::active_sessions`] have one, the least recently used session without waiting
/// epochs is parked: its task ends, and a later batch starts a new one from the store.
#[derive(Clone)]
pub struct Sessions {
    desk: Arc<Desk>,
}

struct Desk {
    store: Store,
    aiding: AidingDesk,
    limits: SessionLimits,
    solvers: Solvers,
    /// Epochs waiting in all mailboxes.
    waiting: Arc<AtomicUsize>,
    /// Held from reading a session's row until its task is started, and while it is closed.
    starting: [tokio::sync::Mutex<()>; STARTING_LOCKS],
    tasks: Mutex<Tasks>,
}

/// The tasks that run. Batches are posted under its lock, so a task taken out of `handles` with
/// nothing waiting never gets another one.
struct Tasks {
    handles: HashMap<SessionId, Handle>,
    running: JoinSet<()>,
    /// Counts batches, to tell who was used least recently.
    posted: u64,
    draining: bool,
}

struct Handle {
    mailbox: mpsc::Sender<Message>,
    waiting: Arc<AtomicUsize>,
    outdated: Arc<AtomicBool>,
    last_used: u64,
}

impl Sessions {
    /// Opens the desk.
    pub fn open(store: Store, aiding: AidingDesk, mut limits: SessionLimits) -> Self {
        limits.mailbox_epochs = limits.mailbox_epochs.max(limits.epochs_per_batch);
        limits.waiting_epochs = limits.waiting_epochs.max(limits.epochs_per_batch);
        let tasks =
            Tasks { handles: HashMap::new(), running: JoinSet::new(), posted: 0, draining: false };
        let desk = Desk {
            store,
            aiding,
            solvers: Solvers::new(limits.solver_threads),
            limits,
            waiting: Arc::default(),
            starting: std::array::from_fn(|_| tokio::sync::Mutex::new(())),
            tasks: Mutex::new(tasks),
        };
        Self { desk: Arc::new(desk) }
    }

    /// Creates a session and stores it.
    ///
    /// # Errors
    /// A configuration or a base that does not exist, a label too long, or the store fails.
    pub async fn create(&self, new: NewSession) -> Result<SessionInfo, SessionError> {
        self.check_label(&new.label)?;
        let base = self.base_names(new.base)?;
        let settings = settings(new.label, new.mode, new.profile, new.overrides, base)?;
        let id = SessionId::random();
        let row = self.desk.store.create_session(id.as_str(), &settings, unix_ms()).await?;
        info(id, row)
    }

    /// A session, open or closed.
    ///
    /// # Errors
    /// There is none of this id, or the store fails.
    pub async fn get(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        info(id.clone(), self.row(id).await?)
    }

    /// Sessions, the newest first; 1 to 1000 on a page.
    ///
    /// # Errors
    /// A page token or size that is refused, or the store fails.
    pub async fn list(
        &self,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionInfo>, SessionError> {
        let page = self.desk.store.sessions(page_size, page_token).await?;
        page.try_map(|row| {
            let id = SessionId::parse(&row.id).ok_or_else(|| StoreError::CorruptText {
                what: "session id",
                why: format!("{:?} is not an id of a session", row.id),
            })?;
            info(id, row)
        })
    }

    /// Changes a session's label and configuration. Epochs sent after it returns are positioned by
    /// the new configuration; those that wait may be, too.
    ///
    /// # Errors
    /// No such session, one that is closed, a configuration or a base that does not exist.
    pub async fn update(
        &self,
        id: &SessionId,
        update: SessionUpdate,
    ) -> Result<SessionInfo, SessionError> {
        if let Some(label) = &update.label {
            self.check_label(label)?;
        }
        let _starting = self.starting(id).lock().await;
        let mut row = self.open_row(id).await?;
        let mut overrides = row.settings.overrides;
        overrides.retain(|name, _| !update.clear_overrides.contains(name));
        overrides.extend(update.overrides);
        let base = match update.base {
            None => row.settings.base,
            Some(base) => self.base_names(base)?,
        };
        row.settings = settings(
            update.label.unwrap_or(row.settings.label),
            update.mode.unwrap_or(row.settings.mode),
            update.profile.unwrap_or(row.settings.profile),
            overrides,
            base,
        )?;
        self.desk.store.update_session(row.key, &row.settings).await?;
        if let Some(handle) = self.tasks().handles.get(id) {
            handle.outdated.store(true, Ordering::Release);
        }
        info(id.clone(), row)
    }

    /// Closes a session: it takes no more epochs, what it stored stays readable. Epochs that wait
    /// are still positioned and stored, and what the window holds is answered for the last time.
    ///
    /// # Errors
    /// No such session, the service is shutting down, or the store fails: it is then still open.
    pub async fn close(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        let (desk, of) = (self.clone(), id.clone());
        // A task of its own: a caller that hangs up leaves no session half closed.
        let closing = tokio::spawn(async move { desk.close_whole(&of).await });
        closing.await.unwrap_or(Err(SessionError::Interrupted))?;
        self.get(id).await
    }

    async fn close_whole(&self, id: &SessionId) -> Result<(), SessionError> {
        let _starting = self.starting(id).lock().await;
        let row = self.row(id).await?;
        if row.closed_unix_ms.is_some() {
            return Ok(());
        }
        if !self.tasks().handles.contains_key(id) {
            self.start(id, row.key)?;
        }
        // Taken out: nothing is posted behind the last message.
        let handle = self.tasks().handles.remove(id).ok_or(SessionError::Draining)?;
        let (reply, answer) = oneshot::channel();
        let last = Message::Close { unix_ms: unix_ms(), reply };
        handle.mailbox.send(last).await.map_err(|_| SessionError::Interrupted)?;
        drop(handle);
        answer.await.unwrap_or(Err(SessionError::Interrupted))
    }

    /// Positions and commits a batch of epochs; returns when it is durable.
    ///
    /// # Errors
    /// The batch was refused, or could not be committed: nothing of it is acknowledged.
    pub async fn submit(
        &self,
        id: &SessionId,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<Submitted, SessionError> {
        self.enqueue(id, epochs).await?.answer().await
    }

    /// Puts a batch of epochs into the session's mailbox. Batches of calls that follow one another
    /// are positioned in that order, and their answers may be awaited later.
    ///
    /// # Errors
    /// No such session, one that is closed, a batch too large, a full mailbox: nothing is accepted.
    pub async fn enqueue(
        &self,
        id: &SessionId,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<Pending, SessionError> {
        self.check_batch(&epochs)?;
        let count = epochs.len();
        let (reply, answer) = oneshot::channel();
        let submission = Submission { epochs, place: None, reply };
        self.send(id, Message::Submission(submission), count).await?;
        Ok(Pending(answer))
    }

    /// Takes a piece of a receiver's stream; returns when its bytes, and the epochs that they
    /// complete, are durable. Pieces of calls that follow one another are taken in that order.
    ///
    /// # Errors
    /// The piece was refused, or could not be committed: nothing of it is acknowledged.
    pub async fn receive(
        &self,
        id: &SessionId,
        piece: RawPiece,
    ) -> Result<RawReceived, SessionError> {
        let (bytes, limit) = (piece.content.len(), self.desk.limits.raw_piece_bytes);
        if limit < bytes {
            return Err(SessionError::PieceTooLarge { bytes, limit });
        }
        // How many epochs it holds is not known yet: it takes room by its length.
        let room = (bytes / BYTES_PER_EPOCH + 1).min(self.desk.limits.epochs_per_batch);
        let (reply, answer) = oneshot::channel();
        let submission = Box::new(RawSubmission { piece, place: None, reply });
        self.send(id, Message::Raw(submission), room).await?;
        answer.await.unwrap_or(Err(SessionError::Interrupted))
    }

    /// Puts a message into the session's mailbox, whose task is started if none runs.
    async fn send(
        &self,
        id: &SessionId,
        message: Message,
        room: usize,
    ) -> Result<(), SessionError> {
        let mut message = Some(message);
        if self.post(id, &mut message, room)? {
            return Ok(());
        }
        let _starting = self.starting(id).lock().await;
        if self.post(id, &mut message, room)? {
            return Ok(()); // Another call has started it meanwhile.
        }
        let row = self.open_row(id).await?;
        self.start(id, row.key)?;
        if self.post(id, &mut message, room)? { Ok(()) } else { Err(SessionError::Interrupted) }
    }

    /// Stored solutions of a session, open or closed, in order of number and revision.
    ///
    /// # Errors
    /// No such session, a page token or size that is refused, or the store fails.
    pub async fn solutions(
        &self,
        id: &SessionId,
        query: &SolutionQuery,
    ) -> Result<Page<StoredSolution>, SessionError> {
        let row = self.row(id).await?;
        Ok(self.desk.store.solutions(row.key, query).await?)
    }

    /// Refuses further epochs and waits until those accepted are positioned and stored.
    pub async fn drain(&self) {
        let mut running = {
            let mut tasks = self.tasks();
            tasks.draining = true;
            tasks.handles.clear();
            mem::take(&mut tasks.running)
        };
        while running.join_next().await.is_some() {}
    }

    /// Whether [`Self::drain`] was called.
    pub fn is_draining(&self) -> bool {
        self.tasks().draining
    }

    /// The bases of a choice, as the store names them.
    pub(super) fn base_names(
        &self,
        choice: BaseChoice<BaseId>,
    ) -> Result<BaseChoice, SessionError> {
        if let BaseChoice::NearestOf(ids) = &choice {
            let (bases, limit) = (ids.len(), self.desk.limits.candidate_bases);
            if limit < bases {
                return Err(SessionError::TooManyCandidates { bases, limit });
            }
            let is_again = |index: &usize| ids[..*index].contains(&ids[*index]);
            if let Some(index) = (0..ids.len()).find(is_again) {
                return Err(SessionError::BaseNamedTwice { index });
            }
            if ids.is_empty() {
                return Ok(BaseChoice::None);
            }
        }
        Ok(choice.try_map(|id| self.desk.aiding.bases.name(&id))?)
    }

    pub(super) fn store(&self) -> &Store {
        &self.desk.store
    }

    pub(super) fn aiding(&self) -> &AidingDesk {
        &self.desk.aiding
    }

    pub(super) fn solvers(&self) -> &Solvers {
        &self.desk.solvers
    }

    /// The limits in force.
    pub fn limits(&self) -> &SessionLimits {
        &self.desk.limits
    }

    pub(super) async fn row(&self, id: &SessionId) -> Result<SessionRow, SessionError> {
        let row = self.desk.store.session(id.as_str()).await?;
        row.ok_or_else(|| SessionError::NotFound { id: id.to_string() })
    }

    async fn open_row(&self, id: &SessionId) -> Result<SessionRow, SessionError> {
        let row = self.row(id).await?;
        match row.closed_unix_ms {
            None => Ok(row),
            Some(_) => Err(SessionError::Closed { id: id.to_string() }),
        }
    }

    pub(super) fn check_batch(&self, epochs: &[SequencedEpoch]) -> Result<(), SessionError> {
        let (epochs, limit) = (epochs.len(), self.desk.limits.epochs_per_batch);
        match epochs {
            0 => Err(SessionError::NoEpochs),
            _ if limit < epochs => Err(SessionError::TooManyEpochs { epochs, limit }),
            _ => Ok(()),
        }
    }

    fn check_label(&self, label: &str) -> Result<(), SessionError> {
        let (length, limit) = (label.chars().count(), self.desk.limits.label_characters);
        if limit < length { Err(SessionError::LabelTooLong { length, limit }) } else { Ok(()) }
    }

    fn tasks(&self) -> MutexGuard<'_, Tasks> {
        self.desk.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn starting(&self, id: &SessionId) -> &tokio::sync::Mutex<()> {
        let mut hasher = DefaultHasher::new();
        id.hash(&mut hasher);
        &self.desk.starting[hasher.finish() as usize % STARTING_LOCKS]
    }

    /// Puts a message into the mailbox of a running task; `false` leaves it, for none runs.
    fn post(
        &self,
        id: &SessionId,
        message: &mut Option<Message>,
        room: usize,
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
        if limit < waiting + room {
            return Err(SessionError::MailboxFull { waiting, limit, retry_after });
        }
        let (all, limit) = (of_all.load(Ordering::Acquire), limits.waiting_epochs);
        if limit < all + room {
            return Err(SessionError::Overloaded { waiting: all, limit, retry_after });
        }
        let Some(mut posting) = message.take() else { return Ok(true) };
        posting.put(Place::take(room, &handle.waiting, of_all));
        match handle.mailbox.try_send(posting) {
            Ok(()) => {
                handle.last_used = posted;
                Ok(true)
            }
            Err(TrySendError::Full(_)) => {
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

    /// Starts a session's task, parking another where as many run as may.
    fn start(&self, id: &SessionId, key: SessionKey) -> Result<(), SessionError> {
        let Desk { store, aiding, limits, solvers, .. } = &*self.desk;
        let mut tasks = self.tasks();
        if tasks.draining {
            return Err(SessionError::Draining);
        }
        let limit = limits.active_sessions;
        if limit <= tasks.handles.len() && !tasks.park_one() {
            return Err(SessionError::TooManyActive { limit, retry_after: limits.retry_after });
        }
        let (mailbox, inbox) = mpsc::channel(limits.mailbox_epochs);
        let outdated = Arc::new(AtomicBool::new(false));
        let task = Task {
            id: id.clone(),
            key,
            store: store.clone(),
            aiding: aiding.clone(),
            solvers: solvers.clone(),
            epochs_per_batch: limits.epochs_per_batch,
            observations_per_epoch: limits.observations_per_epoch,
            outdated: outdated.clone(),
        };
        while tasks.running.try_join_next().is_some() {} // Tasks that ended are forgotten.
        tasks.running.spawn(task.run(inbox));
        let last_used = tasks.posted;
        let handle = Handle { mailbox, waiting: Arc::default(), outdated, last_used };
        tasks.handles.insert(id.clone(), handle);
        Ok(())
    }
}

impl Tasks {
    /// Ends the least recently used task that nothing waits for; `false` if there is none.
    fn park_one(&mut self) -> bool {
        let idle = self.handles.iter().filter(|(_, h)| h.waiting.load(Ordering::Acquire) == 0);
        let least = idle.min_by_key(|(_, handle)| handle.last_used).map(|(id, _)| id.clone());
        least.and_then(|id| self.handles.remove(&id)).is_some()
    }
}

fn info(id: SessionId, row: SessionRow) -> Result<SessionInfo, SessionError> {
    let configuration = stored_options(&row.settings)?.entries();
    Ok(SessionInfo {
        id,
        label: row.settings.label,
        mode: row.settings.mode,
        profile: row.settings.profile,
        overrides: row.settings.overrides,
        configuration,
        configuration_hash: row.settings.configuration_hash,
        created_unix_ms: row.created_unix_ms,
        closed_unix_ms: row.closed_unix_ms,
        durable_through: row.last_seq,
        raw_through: row.raw_through,
        base: row.settings.base.try_map(|base| Ok::<_, SessionError>(base.id))?,
    })
}
