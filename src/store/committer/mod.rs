//! Group commit: epochs, solutions and snapshots of many sessions in one transaction.
//!
//! One task writes. Batches that arrive during a transaction wait in a bounded queue and form the
//! next transaction. So transactions grow with the load, and a single session waits for no other.
//! If a batch contradicts the database because another writer has stored its numbers, the batches
//! of the transaction are committed one by one, so that only this batch fails.

mod statements;

use std::sync::Arc;

use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

use crate::gnss::Epoch;

use super::codec::{encode_epoch, encode_solution, status_number};
use super::pool::Pool;
use super::{BaseUse, RawChange, SessionKey, StoreError, StoredSolution};

/// Batches that may wait during a transaction. Further ones wait for a free slot.
const QUEUE: usize = 1_024;
/// A transaction takes no further batch once it has this many epochs.
const EPOCHS_PER_TRANSACTION: usize = 4_096;

/// The changes of one session that are committed together.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Primary key of the session.
    pub session: SessionKey,
    /// Epochs with their real-time answers.
    pub epochs: Vec<EncodedEpoch>,
    /// Revisions of these and earlier epochs. A stored revision is not replaced.
    pub revisions: Vec<EncodedSolution>,
    /// The session's state after the last of the epochs.
    pub snapshot: Option<EncodedSnapshot>,
    /// The chunk of raw bytes from which the epochs were decoded.
    pub raw: Option<Box<RawChange>>,
    /// Closes the session at this time (ms since 1970-01-01 UTC), if it is open.
    pub closed_unix_ms: Option<i64>,
}

impl Batch {
    /// A batch without changes.
    pub fn new(session: SessionKey) -> Self {
        Self {
            session,
            epochs: Vec::new(),
            revisions: Vec::new(),
            snapshot: None,
            raw: None,
            closed_unix_ms: None,
        }
    }

    /// Whether there is nothing to commit.
    pub fn is_empty(&self) -> bool {
        self.epochs.is_empty()
            && self.revisions.is_empty()
            && self.snapshot.is_none()
            && self.raw.is_none()
            && self.closed_unix_ms.is_none()
    }
}

/// An encoded epoch with its real-time answer.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedEpoch {
    seq: i64,
    gps_time_ns: i64,
    navigation: i64,
    base: Option<BaseUse>,
    content: Vec<u8>,
    solution: EncodedSolution,
}

impl EncodedEpoch {
    /// Encodes an epoch and its `solution`, computed with the navigation data of push number
    /// `navigation` and with `base`.
    pub fn new(
        epoch: &Epoch,
        solution: &StoredSolution,
        navigation: u64,
        base: Option<BaseUse>,
    ) -> Self {
        Self {
            seq: number(solution.seq),
            gps_time_ns: epoch.time.as_ns(),
            navigation: number(navigation),
            base,
            content: encode_epoch(epoch),
            solution: EncodedSolution::new(solution),
        }
    }

    /// Key of the base and the numbers of [`BaseUse`], as columns.
    fn base_columns(&self) -> [Option<i64>; 3] {
        let column = |of: fn(&BaseUse) -> i64| self.base.as_ref().map(of);
        [column(|b| b.base.0), column(|b| number(b.after)), column(|b| number(b.through))]
    }

    /// Whether `epoch` is the same, bit by bit.
    pub fn is(&self, epoch: &Epoch) -> bool {
        self.content == encode_epoch(epoch)
    }
}

/// An encoded solution. Equal solutions have equal bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedSolution {
    seq: i64,
    revision: i32,
    gps_time_ns: i64,
    status: i16,
    position_m: [Option<f64>; 3],
    content: Vec<u8>,
}

impl EncodedSolution {
    /// Number of the epoch.
    pub fn seq(&self) -> u64 {
        self.seq as u64
    }

    /// Encodes a solution.
    pub fn new(stored: &StoredSolution) -> Self {
        let StoredSolution { seq, revision, solution, version, configuration_hash } = stored;
        let axis_m = |axis: usize| solution.estimate.as_ref().map(|e| e.position.0[axis]);
        Self {
            seq: number(*seq),
            revision: i32::try_from(*revision).expect("revisions are few"),
            gps_time_ns: solution.time.as_ns(),
            status: status_number(solution.status),
            position_m: [axis_m(0), axis_m(1), axis_m(2)],
            content: encode_solution(solution, version, configuration_hash),
        }
    }
}

/// An encoded state of a session after an epoch.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedSnapshot {
    pub(super) seq: i64,
    pub(super) configuration_hash: Arc<str>,
    pub(super) content: Vec<u8>,
}

impl EncodedSnapshot {
    /// The state after epoch `seq`, with the hash of its configuration.
    pub fn new(seq: u64, configuration_hash: Arc<str>, content: Vec<u8>) -> Self {
        Self { seq: number(seq), configuration_hash, content }
    }
}

fn number(value: u64) -> i64 {
    i64::try_from(value).expect("the desk refuses numbers above i64::MAX")
}

struct Request {
    batch: Batch,
    reply: oneshot::Sender<Result<(), StoreError>>,
}

enum Message {
    Commit(Request),
    Stop,
}

/// The sender to the task that writes.
#[derive(Clone)]
pub(super) struct Committer {
    queue: mpsc::Sender<Message>,
}

impl Committer {
    pub(super) fn start(pool: Pool) -> (Self, JoinHandle<()>) {
        let (queue, inbox) = mpsc::channel(QUEUE);
        (Self { queue }, tokio::spawn(run(pool, inbox)))
    }

    pub(super) async fn commit(&self, batch: Batch) -> Result<(), StoreError> {
        let (reply, answer) = oneshot::channel();
        let request = Message::Commit(Request { batch, reply });
        self.queue.send(request).await.map_err(|_| StoreError::Closed)?;
        answer.await.unwrap_or(Err(StoreError::Closed))
    }

    pub(super) async fn stop(&self) {
        // Err: it has already stopped.
        self.queue.send(Message::Stop).await.ok();
    }
}

/// Commits until told to stop, and then the batches that wait.
async fn run(pool: Pool, mut inbox: mpsc::Receiver<Message>) {
    let mut group = Vec::new();
    while let Some(message) = inbox.recv().await {
        let mut next = Some(message);
        let mut epochs = 0;
        while let Some(message) = next {
            match message {
                Message::Commit(request) => {
                    epochs += request.batch.epochs.len();
                    group.push(request);
                }
                Message::Stop => inbox.close(),
            }
            next = if epochs < EPOCHS_PER_TRANSACTION { inbox.try_recv().ok() } else { None };
        }
        commit_group(&pool, &mut group).await;
    }
}

/// Commits a group of batches and answers each of them.
async fn commit_group(pool: &Pool, group: &mut Vec<Request>) {
    let batches: Vec<&Batch> = group.iter().map(|request| &request.batch).collect();
    let whole = write(pool, &batches).await;
    if matches!(whole, Err(StoreError::AlreadyStored)) && 1 < group.len() {
        for request in group.drain(..) {
            let single = write(pool, &[&request.batch]).await;
            request.reply.send(single).ok(); // Err: the session's task is gone.
        }
        return;
    }
    for request in group.drain(..) {
        request.reply.send(whole.clone()).ok(); // Err: the session's task is gone.
    }
}

async fn write(pool: &Pool, batches: &[&Batch]) -> Result<(), StoreError> {
    let written = match pool {
        Pool::Sqlite { writer, .. } => statements::write_sqlite(writer, batches).await,
        Pool::Postgres(pool) => statements::write_postgres(pool, batches).await,
    };
    written.map_err(|error| match error.as_database_error() {
        Some(refusal) if refusal.is_unique_violation() => StoreError::AlreadyStored,
        _ => StoreError::Database {
            operation: "committing epochs and solutions",
            source: Arc::new(error),
        },
    })
}
