//! Group commit: epochs and solutions of many sessions in one transaction.
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

use crate::gnss::{Epoch, Solution};

use super::codec::{encode_epoch, encode_solution, status_number};
use super::pool::Pool;
use super::{SessionKey, StoreError};

/// Batches that may wait while a transaction runs; those who commit wait for a place.
const QUEUE: usize = 1_024;
/// Epochs after which a transaction takes no further batch.
const EPOCHS_PER_TRANSACTION: usize = 4_096;

/// Epochs of one session with their solutions, to be committed together.
#[derive(Clone, Debug)]
pub struct Batch {
    /// The session.
    pub session: SessionKey,
    /// The epochs.
    pub epochs: Vec<EncodedEpoch>,
}

/// An epoch with its solution, in the store's form.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedEpoch {
    seq: i64,
    gps_time_ns: i64,
    content: Vec<u8>,
    status: i16,
    position_m: [Option<f64>; 3],
    solution: Vec<u8>,
}

impl EncodedEpoch {
    /// Encodes an epoch and its solution; `seq` is at most [`i64::MAX`].
    pub fn new(
        seq: u64,
        epoch: &Epoch,
        solution: &Solution,
        version: &str,
        configuration_hash: &str,
    ) -> Self {
        let axis_m = |axis: usize| solution.estimate.as_ref().map(|e| e.position.0[axis]);
        Self {
            seq: i64::try_from(seq).expect("the desk refuses numbers above i64::MAX"),
            gps_time_ns: epoch.time.as_ns(),
            content: encode_epoch(epoch),
            status: status_number(solution.status),
            position_m: [axis_m(0), axis_m(1), axis_m(2)],
            solution: encode_solution(solution, version, configuration_hash),
        }
    }

    /// Whether `epoch` is this one, bit by bit.
    pub fn is(&self, epoch: &Epoch) -> bool {
        self.content == encode_epoch(epoch)
    }
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
    let rows: Vec<(SessionKey, &EncodedEpoch)> = batches
        .iter()
        .flat_map(|batch| batch.epochs.iter().map(|epoch| (batch.session, epoch)))
        .collect();
    let written = match pool {
        Pool::Sqlite { writer, .. } => statements::write_sqlite(writer, &rows).await,
        Pool::Postgres(pool) => statements::write_postgres(pool, &rows).await,
    };
    written.map_err(|error| match error.as_database_error() {
        Some(refusal) if refusal.is_unique_violation() => StoreError::AlreadyStored,
        _ => StoreError::Database {
            operation: "committing epochs and solutions",
            source: Arc::new(error),
        },
    })
}
