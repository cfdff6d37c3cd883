//! Group commit: epochs, solutions and snapshots of many sessions in one transaction.
//!
//! One task writes. Batches that arrive during a transaction wait in a bounded queue and form the
//! next transaction. So transactions grow with the load, and a single session waits for no other.
//! A transaction that follows one of several batches begins 20 ms after the beginning of that one,
//! or later, so that the disk syncs once for more batches. It begins 40 ms after, if all waiting
//! batches are of streams, which send further epochs without waiting for their answers.
//! A batch that does not continue its session, because another writer has stored epochs or has
//! closed it, is left out of the transaction; see `heads`.
//!
//! # Failures
//! The task owns its connection; on SQLite a thread has the connection (`sqlite`). After an error,
//! a missed deadline or a panic, the task drops the connection, opens another, and probes it before
//! it takes the next batches. Until then it refuses all batches at once. If the failure fell into
//! `COMMIT`, the batches may be stored. Each is then answered with [`StoreError::Unconfirmed`], and
//! its owner asks the store when commits work again. A new connection is used only when the old one
//! can no longer commit, so that the store's answer is final.

mod batch;
mod heads;
mod lease_row;
mod link;
mod member;
mod meters;
mod origins;
mod raw;
mod rollups;
mod sqlite;
mod statements;

use std::any::Any;
use std::future::Future;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use futures::FutureExt;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};

use crate::panics::words;

use super::StoreError;
use super::deadline::{DEADLINE, within};
use super::health::{CommitterHealth, CommitterState};

pub use batch::{
    ArcStart, Batch, EncodedEpoch, EncodedSnapshot, EncodedSolution, EpochReference, FirstAnswer,
};
pub(super) use link::Connector;
pub(super) use member::{LEASE, Member};
pub(crate) use meters::CommitterMeters;

/// Batches that may wait during a transaction. Further ones wait for a free slot.
const QUEUE: usize = 1_024;
/// A transaction takes no further batch once it has this many epochs or bytes, so that a slow disk
/// writes it within the deadline.
const EPOCHS_PER_TRANSACTION: usize = 4_096;
const BYTES_PER_TRANSACTION: usize = 8 << 20;
/// A transaction of this many batches indicates that others will follow soon.
const SEVERAL: usize = 4;

/// Times that a committer keeps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timing {
    /// For a transaction, and for opening a connection.
    pub(super) deadline: Duration,
    /// Between probes of an idle connection.
    pub(super) heartbeat: Duration,
    /// Between attempts to connect.
    pub(super) retry: Duration,
    /// From the beginning of a transaction of several batches to that of the next.
    pub(super) spacing: Duration,
    /// The same for a transaction that nobody waits for ([`Batch::is_patient`]).
    pub(super) patient_spacing: Duration,
}

impl Timing {
    /// The times of a service.
    pub(super) const fn service() -> Self {
        Self {
            deadline: DEADLINE,
            heartbeat: Duration::from_secs(2),
            retry: Duration::from_millis(250),
            // Several times a sync of the disk, and short compared with the delays of a network.
            spacing: Duration::from_millis(20),
            patient_spacing: Duration::from_millis(40),
        }
    }

    /// Moves waiting messages into the group of the next transaction. `last` is the beginning of
    /// the last transaction, if that had several batches; the group then waits for further
    /// messages.
    async fn gather(
        self,
        first: Message,
        last: Option<Instant>,
        inbox: &mut mpsc::Receiver<Message>,
        group: &mut Vec<Request>,
    ) {
        let mut next = Some(first);
        for spacing in [self.spacing, self.patient_spacing] {
            if let Some(last) = last {
                sleep((last + spacing).saturating_duration_since(Instant::now())).await;
            }
            next = next.or_else(|| inbox.try_recv().ok());
            let has_room = next.is_none_or(|message| collect(message, inbox, group));
            let is_patient = group.iter().all(|request| request.batch.is_patient);
            if last.is_none() || !has_room || !is_patient || inbox.is_closed() {
                return;
            }
            next = None;
        }
    }
}

/// A database to which batches are committed: the real one, or a test's that fails on demand.
pub(super) trait Connect: Send + Sync + 'static {
    /// A connection.
    type Link: Send;

    /// Opens a connection. Returns when nothing of an earlier connection can still be committed.
    fn connect(&self) -> impl Future<Output = Result<Self::Link, StoreError>> + Send;

    /// Checks that the connection can commit. Also writes if `after_failure`.
    fn probe(
        &self,
        link: &mut Self::Link,
        after_failure: bool,
    ) -> impl Future<Output = Result<(), sqlx::Error>> + Send;

    /// Commits batches in one transaction. Returns the indices of those that it left out because
    /// they do not continue their sessions. Sets `committing` before it sends `COMMIT`.
    fn write(
        &self,
        link: &mut Self::Link,
        batches: &[Arc<Batch>],
        committing: &AtomicBool,
    ) -> impl Future<Output = Result<Vec<usize>, sqlx::Error>> + Send;
}

struct Request {
    batch: Arc<Batch>,
    reply: oneshot::Sender<Result<(), StoreError>>,
}

enum Message {
    Commit(Request),
    Stop,
}

/// The sender to the task that commits.
#[derive(Clone)]
pub(super) struct Committer {
    queue: mpsc::Sender<Message>,
    health: watch::Receiver<CommitterHealth>,
    meters: CommitterMeters,
}

impl Committer {
    /// Connects, and starts the task.
    ///
    /// # Errors
    /// The connection cannot be opened.
    pub(super) async fn start<C: Connect>(
        connector: C,
        timing: Timing,
    ) -> Result<(Self, JoinHandle<()>), StoreError> {
        let link = connector.connect().await?;
        let (queue, inbox) = mpsc::channel(QUEUE);
        let (sender, health) = watch::channel(CommitterHealth::new());
        let meters = CommitterMeters::new();
        let running =
            Running { connector, timing, link: Some(link), health: sender, meters: meters.clone() };
        Ok((Self { queue, health, meters }, tokio::spawn(running.run(inbox))))
    }

    /// The committer of a store that does not commit.
    pub(super) fn stopped() -> Self {
        let (queue, _) = mpsc::channel(1);
        let (sender, health) = watch::channel(CommitterHealth::new());
        sender.send_modify(|health| health.state = CommitterState::Stopped);
        Self { queue, health, meters: CommitterMeters::new() }
    }

    pub(super) async fn commit(&self, batch: Batch) -> Result<(), StoreError> {
        let (reply, answer) = oneshot::channel();
        let request = Message::Commit(Request { batch: Arc::new(batch), reply });
        let ended = || refusal(&self.health());
        self.queue.send(request).await.map_err(|_| ended())?;
        answer.await.unwrap_or_else(|_| Err(ended()))
    }

    pub(super) async fn stop(&self) {
        // Err: it has already stopped.
        self.queue.send(Message::Stop).await.ok();
    }

    pub(super) const fn meters(&self) -> &CommitterMeters {
        &self.meters
    }

    /// Number of batches that wait for the next transaction.
    pub(super) fn waiting(&self) -> usize {
        self.queue.max_capacity() - self.queue.capacity()
    }

    pub(super) fn health(&self) -> CommitterHealth {
        let mut health = self.health.borrow().clone();
        if self.queue.is_closed() && !health.has_ended() {
            health.state = CommitterState::Stopped;
        }
        health
    }

    /// Waits until it is known that another service has had the lease. Returns the error.
    pub(super) async fn lease_lost(&self) -> StoreError {
        let mut health = self.health.clone();
        let is_lost =
            |health: &CommitterHealth| matches!(health.state, CommitterState::LeaseLost { .. });
        if let Ok(lost) = health.wait_for(is_lost).await
            && let CommitterState::LeaseLost { holder } = &lost.state
        {
            return StoreError::LeaseLost { holder: holder.to_string() };
        }
        std::future::pending().await // It was stopped.
    }

    /// Checks that commits work. After a failure they do not until another connection is probed.
    ///
    /// # Errors
    /// They do not. A batch would be refused now.
    pub(super) fn check(&self) -> Result<(), StoreError> {
        match self.health() {
            CommitterHealth { state: CommitterState::Working, .. } => Ok(()),
            failing => Err(refusal(&failing)),
        }
    }
}

/// The refusal of a batch while commits fail.
fn refusal(health: &CommitterHealth) -> StoreError {
    match &health.state {
        CommitterState::Stopped => StoreError::Closed,
        CommitterState::LeaseLost { holder } => {
            let why = format!("node {holder} had it meanwhile, and this one starts again").into();
            StoreError::Down { why }
        }
        CommitterState::Failed { why } => StoreError::Down { why: why.clone() },
        CommitterState::Working => StoreError::Down { why: "it is slow".into() },
    }
}

/// The task that commits.
struct Running<C: Connect> {
    connector: C,
    timing: Timing,
    link: Option<C::Link>,
    health: watch::Sender<CommitterHealth>,
    meters: CommitterMeters,
}

impl<C: Connect> Running<C> {
    /// Commits until it is stopped, then commits the waiting batches and ends.
    async fn run(mut self, mut inbox: mpsc::Receiver<Message>) {
        let mut group = Vec::new();
        let mut last_of_several = None;
        while self.reconnected(&mut inbox).await {
            match timeout(self.timing.heartbeat, inbox.recv()).await {
                Err(_) => self.probe().await,
                Ok(None) => break,
                Ok(Some(message)) => {
                    self.timing.gather(message, last_of_several, &mut inbox, &mut group).await;
                    last_of_several = (SEVERAL <= group.len()).then(Instant::now);
                    self.commit_group(&mut group).await;
                }
            }
        }
        self.health.send_if_modified(|health| {
            let ends = !health.has_ended();
            if ends {
                health.state = CommitterState::Stopped;
            }
            ends
        });
    }

    /// Commits a group of batches and answers each of them.
    async fn commit_group(&mut self, group: &mut Vec<Request>) {
        let batches: Vec<_> = group.iter().map(|request| request.batch.clone()).collect();
        if batches.is_empty() {
            return;
        }
        let written = self.write(&batches).await;
        let is_single = batches.len() == 1;
        for (index, request) in group.drain(..).enumerate() {
            let answer = match &written {
                // A stored row contradicts the head of its session. Only this session must fail.
                Err(StoreError::AlreadyStored) if !is_single => {
                    self.write(&[request.batch]).await.and_then(accepted)
                }
                Ok(left_out) if left_out.contains(&index) => Err(StoreError::AlreadyStored),
                Ok(_) => Ok(()),
                Err(error) => Err(error.clone()),
            };
            request.reply.send(answer).ok(); // Err: the session's task is gone.
        }
    }

    /// Commits batches, and returns the indices of those that were left out.
    async fn write(&mut self, batches: &[Arc<Batch>]) -> Result<Vec<usize>, StoreError> {
        let Some(link) = &mut self.link else { return Err(refusal(&self.health.borrow())) };
        let (begun, committing) = (Instant::now(), AtomicBool::new(false));
        let writing =
            within(self.timing.deadline, self.connector.write(link, batches, &committing));
        let error = match AssertUnwindSafe(writing).catch_unwind().await {
            Ok(Ok(left_out)) => {
                self.confirm();
                self.meters.count(batches, begun.elapsed());
                return Ok(left_out);
            }
            Ok(Err(error)) => error,
            Err(panic) => panicked(&*panic, &self.health),
        };
        if error.as_database_error().is_some_and(|refused| refused.is_unique_violation()) {
            return Err(StoreError::AlreadyStored); // Rolled back; the connection is sound.
        }
        self.fail(&error);
        let source = Arc::new(error);
        Err(match committing.into_inner() {
            true => StoreError::Unconfirmed { source },
            false => StoreError::Database { operation: "committing epochs and solutions", source },
        })
    }

    /// Checks an idle connection.
    async fn probe(&mut self) {
        let Some(link) = &mut self.link else { return };
        let probing = within(self.timing.deadline, self.connector.probe(link, false));
        match AssertUnwindSafe(probing).catch_unwind().await {
            Ok(Ok(())) => self.confirm(),
            Ok(Err(error)) => self.fail(&error),
            Err(panic) => self.fail(&panicked(&*panic, &self.health)),
        }
    }

    /// Opens and probes a connection if the committer has lost its own. Meanwhile all batches are
    /// refused. Returns `false` if the committer is stopped before, or if the lease is lost.
    async fn reconnected(&mut self, inbox: &mut mpsc::Receiver<Message>) -> bool {
        while self.link.is_none() {
            let connecting = connected(&self.connector, self.timing.deadline, &self.health);
            let Some(attempt) = refusing(connecting, &self.health, inbox).await else {
                return false;
            };
            match attempt {
                Ok(link) => {
                    self.link = Some(link);
                    self.confirm();
                    tracing::info!("the database is connected again");
                }
                Err(StoreError::LeaseLost { holder }) => {
                    tracing::error!(holder, "another service had the database meanwhile");
                    let lost = CommitterState::LeaseLost { holder: holder.into() };
                    self.health.send_modify(|health| health.state = lost);
                    return false;
                }
                Err(error) => {
                    let why = error.to_string().into();
                    let failed = CommitterState::Failed { why };
                    self.health.send_modify(|health| health.state = failed);
                    let pause = sleep(self.timing.retry);
                    if refusing(pause, &self.health, inbox).await.is_none() {
                        return false;
                    }
                }
            }
        }
        true
    }

    fn confirm(&self) {
        self.health.send_modify(|health| {
            health.state = CommitterState::Working;
            health.confirmed = Instant::now();
        });
    }

    /// Drops the connection. It is never used again.
    fn fail(&mut self, error: &sqlx::Error) {
        tracing::error!(%error, "a commit failed; the connection is opened again");
        self.link = None;
        self.health.send_modify(|health| {
            health.state = CommitterState::Failed { why: error.to_string().into() };
            health.failures += 1;
        });
    }
}

/// Opens and probes a connection.
async fn connected<C: Connect>(
    connector: &C,
    deadline: Duration,
    health: &watch::Sender<CommitterHealth>,
) -> Result<C::Link, StoreError> {
    let work = async {
        let mut link = connector.connect().await?;
        let probed = connector.probe(&mut link, true).await;
        probed.map_err(StoreError::database("probing the database"))?;
        Ok(link)
    };
    match timeout(deadline, AssertUnwindSafe(work).catch_unwind()).await {
        Ok(Ok(connected)) => connected,
        Ok(Err(panic)) => {
            let why = panicked(&*panic, health).to_string().into();
            Err(StoreError::Down { why })
        }
        Err(_) => Err(StoreError::Down { why: "no connection within the deadline".into() }),
    }
}

fn panicked(panic: &(dyn Any + Send), health: &watch::Sender<CommitterHealth>) -> sqlx::Error {
    let words = words(panic);
    tracing::error!(panic = words, "the committer panicked");
    health.send_modify(|health| health.panics += 1);
    sqlx::Error::Protocol(format!("the committer panicked: {words}"))
}

/// The answer to a batch that was written alone.
fn accepted(left_out: Vec<usize>) -> Result<(), StoreError> {
    if left_out.is_empty() { Ok(()) } else { Err(StoreError::AlreadyStored) }
}

/// Moves waiting messages into the group. Returns whether the group has room for more.
fn collect(first: Message, inbox: &mut mpsc::Receiver<Message>, group: &mut Vec<Request>) -> bool {
    let mut next = Some(first);
    let mut epochs: usize = group.iter().map(|request| request.batch.epochs.len()).sum();
    let mut bytes: usize = group.iter().map(|request| request.batch.bytes()).sum();
    while let Some(message) = next {
        match message {
            Message::Commit(request) => {
                epochs += request.batch.epochs.len();
                bytes += request.batch.bytes();
                group.push(request);
            }
            Message::Stop => inbox.close(),
        }
        let has_room = epochs < EPOCHS_PER_TRANSACTION && bytes < BYTES_PER_TRANSACTION;
        if !has_room {
            return false;
        }
        next = inbox.try_recv().ok();
    }
    true
}

/// Runs `work`, and refuses all batches meanwhile. `None` if the committer is stopped.
async fn refusing<T>(
    work: impl Future<Output = T>,
    health: &watch::Sender<CommitterHealth>,
    inbox: &mut mpsc::Receiver<Message>,
) -> Option<T> {
    let mut work = std::pin::pin!(work);
    loop {
        tokio::select! {
            biased;
            done = &mut work => return Some(done),
            message = inbox.recv() => match message {
                Some(Message::Commit(Request { reply, .. })) => {
                    let refused = refusal(&health.borrow());
                    reply.send(Err(refused)).ok(); // Err: the session's task is gone.
                }
                Some(Message::Stop) | None => return None,
            },
        }
    }
}

#[cfg(test)]
mod tests;
