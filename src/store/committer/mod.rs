//! Group commit: epochs, solutions and snapshots of many sessions in one transaction.
//!
//! One task writes. While a transaction runs, the batches that arrive wait in a bounded queue, and
//! all of them form the next one: the busier the service, the larger its transactions, and a
//! session alone waits for nobody. A batch that contradicts the database (another writer has stored
//! its numbers) is found by committing the batches of its transaction singly, so that it fails
//! alone.

mod statements;

use std::sync::Arc;

use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

use crate::gnss::Epoch;

use super::codec::{encode_epoch, encode_solution, status_number};
use super::pool::Pool;
use super::{BaseUse, RawChange, SessionKey, StoreError, StoredSolution};

/// Batches that may wait while a transaction runs; those who commit wait for a place.
const QUEUE: usize = 1_024;
/// Epochs after which a transaction takes no further batch.
const EPOCHS_PER_TRANSACTION: usize = 4_096;

/// What happened in one session, to be committed together.
#[derive(Clone, Debug)]
pub struct Batch {
    /// The session.
    pub session: SessionKey,
    /// Epochs with their real-time answers.
    pub epochs: Vec<EncodedEpoch>,
    /// Later answers to these and earlier epochs. One that is stored already stays as it is.
    pub revisions: Vec<EncodedSolution>,
    /// The estimator's state after the last of the epochs.
    pub snapshot: Option<EncodedSnapshot>,
    /// A piece of raw bytes, from which the epochs were decoded.
    pub raw: Option<Box<RawChange>>,
    /// Closes the session (ms since 1970-01-01 UTC), if it is open.
    pub closed_unix_ms: Option<i64>,
}

impl Batch {
    /// Nothing of a session yet.
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

/// An epoch with its real-time answer, in the store's form.
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
    /// Encodes an epoch that was answered by `solution` with the navigation data in force after the
    /// push number `navigation`, and with `base`.
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

    /// Whether `epoch` is this one, bit by bit.
    pub fn is(&self, epoch: &Epoch) -> bool {
        self.content == encode_epoch(epoch)
    }
}

/// A solution in the store's form: equal solutions have equal ones, bit by bit.
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
    /// The epoch's number.
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

/// The estimator's state of a session after an epoch, in the session's own form.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedSnapshot {
    pub(super) seq: i64,
    pub(super) configuration_hash: Arc<str>,
    pub(super) content: Vec<u8>,
}

impl EncodedSnapshot {
    /// The state after the epoch `seq`, by the configuration of that hash.
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

/// The way to the task that writes.
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
        // Err: it has stopped already.
        self.queue.send(Message::Stop).await.ok();
    }
}

/// Commits until told to stop, then what was handed over before that.
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

/// Commits a group and tells each batch how it ended.
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
