//! The committer against a database that fails on demand.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::refusal::Code;
use crate::store::SessionKey;

use super::*;

/// What the database does with the next transaction.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Next {
    Commits,
    FailsBefore,
    FailsDuring,
    HangsDuring,
    Panics,
}

#[derive(Default)]
struct Shared {
    next: Mutex<Vec<Next>>,
    is_down: AtomicBool,
    probe_panics: AtomicBool,
    written: Mutex<Vec<i64>>,
    /// Number of batches of each transaction.
    sizes: Mutex<Vec<usize>>,
    connections: AtomicU64,
}

/// The number of a connection: one that has failed must not be used again.
struct Fake(Arc<Shared>);

impl Connect for Fake {
    type Link = bool;

    async fn connect(&self) -> Result<bool, StoreError> {
        if self.0.is_down.load(Ordering::SeqCst) {
            return Err(StoreError::Down { why: "switched off".into() });
        }
        self.0.connections.fetch_add(1, Ordering::SeqCst);
        Ok(true)
    }

    async fn probe(&self, link: &mut bool, _: bool) -> Result<(), sqlx::Error> {
        assert!(*link, "a failed connection is used again");
        assert!(!self.0.probe_panics.swap(false, Ordering::SeqCst), "on purpose");
        Ok(())
    }

    async fn write(
        &self,
        link: &mut bool,
        batches: &[Arc<Batch>],
        committing: &AtomicBool,
    ) -> Result<Vec<usize>, sqlx::Error> {
        assert!(*link, "a failed connection is used again");
        let next = self.0.next.lock().unwrap().pop().unwrap_or(Next::Commits);
        *link = next == Next::Commits;
        if next == Next::FailsBefore {
            return Err(sqlx::Error::WorkerCrashed);
        }
        assert!(next != Next::Panics, "on purpose");
        committing.store(true, Ordering::SeqCst);
        match next {
            Next::FailsDuring => Err(sqlx::Error::WorkerCrashed),
            Next::HangsDuring => std::future::pending().await,
            _ => {
                let mut written = self.0.written.lock().unwrap();
                written.extend(batches.iter().map(|batch| batch.session.0));
                self.0.sizes.lock().unwrap().push(batches.len());
                Ok(Vec::new())
            }
        }
    }
}

const TIMING: Timing = Timing {
    deadline: Duration::from_millis(100),
    heartbeat: Duration::from_millis(20),
    retry: Duration::from_millis(5),
    spacing: Duration::from_millis(50),
    patient_spacing: Duration::from_millis(500),
};

async fn started() -> (Committer, Arc<Shared>) {
    let shared = Arc::new(Shared::default());
    let (committer, _) = Committer::start(Fake(shared.clone()), TIMING).await.unwrap();
    (committer, shared)
}

async fn works_again(committer: &Committer) {
    let mut health = committer.health.clone();
    let works = health.wait_for(|health| health.state == CommitterState::Working);
    timeout(Duration::from_secs(5), works).await.unwrap().unwrap();
    committer.check().unwrap();
}

fn batch(session: i64) -> Batch {
    Batch::new(SessionKey(session), None)
}

/// After each kind of failure the next batch is committed on another connection.
#[tokio::test]
async fn a_failure_is_answered_and_the_next_batch_is_committed() {
    let (committer, shared) = started().await;
    let kinds = [Next::FailsBefore, Next::FailsDuring, Next::HangsDuring, Next::Panics];
    for (failures, next) in kinds.into_iter().enumerate() {
        shared.next.lock().unwrap().push(next);
        let error = committer.commit(batch(-1)).await.unwrap_err();
        let is_unconfirmed = matches!(error, StoreError::Unconfirmed { .. });
        let reached_commit = matches!(next, Next::FailsDuring | Next::HangsDuring);
        assert_eq!(is_unconfirmed, reached_commit, "{next:?}: {error}");
        assert_eq!(error.code(), Code::DatabaseFailed);
        works_again(&committer).await;
        committer.commit(batch(failures as i64)).await.unwrap();
        assert_eq!(committer.health().failures, failures as u64 + 1);
    }
    assert_eq!(*shared.written.lock().unwrap(), [0, 1, 2, 3]);
    assert_eq!(shared.connections.load(Ordering::SeqCst), 5);
    assert_eq!(committer.health().panics, 1);
}

/// A panic while an idle connection is checked costs this connection only.
#[tokio::test]
async fn a_probe_that_panics_does_not_end_the_committer() {
    let (committer, shared) = started().await;
    shared.probe_panics.store(true, Ordering::SeqCst);
    let opened_again = async {
        while shared.connections.load(Ordering::SeqCst) < 2 {
            sleep(Duration::from_millis(1)).await;
        }
    };
    timeout(Duration::from_secs(5), opened_again).await.unwrap();
    works_again(&committer).await;
    committer.commit(batch(1)).await.unwrap();
    assert_eq!((committer.health().panics, committer.health().failures), (1, 1));
}

/// Batches 2 ms apart are in two transactions, but are in one soon after a transaction of several.
#[tokio::test]
async fn batches_wait_for_others_under_load() {
    let (committer, shared) = started().await;
    let apart = async |first| {
        let second = async {
            sleep(Duration::from_millis(2)).await;
            committer.commit(batch(first + 1)).await
        };
        let (first, second) = tokio::join!(committer.commit(batch(first)), second);
        first.and(second).unwrap();
    };
    apart(1).await;
    let several = (3..8).map(|session| committer.commit(batch(session)));
    futures::future::try_join_all(several).await.unwrap();
    apart(8).await;
    assert_eq!(*shared.sizes.lock().unwrap(), [1, 1, 5, 2]);
}

/// Batches whose answers nobody awaits wait longer, unless one in the group is awaited.
#[tokio::test]
async fn batches_that_nobody_awaits_wait_longer() {
    let (committer, shared) = started().await;
    let patient = |session| committer.commit(Batch { is_patient: true, ..batch(session) });
    let later = async |session| {
        sleep(Duration::from_millis(100)).await;
        patient(session).await
    };
    futures::future::try_join_all((1..6).map(patient)).await.unwrap();
    let (first, second) = tokio::join!(patient(6), later(7));
    first.and(second).unwrap();
    futures::future::try_join_all((8..13).map(patient)).await.unwrap();
    let awaited = committer.commit(batch(13));
    let (first, second, third) = tokio::join!(awaited, patient(14), later(15));
    first.and(second).and(third).unwrap();
    assert_eq!(*shared.sizes.lock().unwrap(), [5, 2, 5, 2, 1]);
}

/// Batches that wait form transactions of some megabytes.
#[tokio::test]
async fn a_transaction_has_a_limit_of_bytes() {
    let (sender, mut inbox) = mpsc::channel(QUEUE);
    let large = |session| {
        let content = vec![0; BYTES_PER_TRANSACTION / 4];
        let snapshot = Some(EncodedSnapshot::new(1, "c0ffee".into(), content, None));
        Message::Commit(Request {
            batch: Arc::new(Batch { snapshot, ..batch(session) }),
            reply: oneshot::channel().0,
        })
    };
    for session in 1..10 {
        sender.try_send(large(session)).ok().unwrap();
    }
    let mut sizes = Vec::new();
    while let Ok(first) = inbox.try_recv() {
        let mut group = Vec::new();
        collect(first, &mut inbox, &mut group);
        sizes.push(group.len());
    }
    assert_eq!(sizes, [4, 4, 1]);
}

/// While the database is away, batches are refused at once, and the state reports it.
#[tokio::test]
async fn batches_are_refused_at_once_while_the_database_is_away() {
    let (committer, shared) = started().await;
    shared.is_down.store(true, Ordering::SeqCst);
    shared.next.lock().unwrap().push(Next::FailsBefore);
    committer.commit(batch(1)).await.unwrap_err();
    let began = Instant::now();
    for _ in 0..100 {
        let error = committer.commit(batch(2)).await.unwrap_err();
        assert!(matches!(error, StoreError::Down { .. }), "{error}");
        committer.check().unwrap_err();
    }
    assert!(began.elapsed() < Duration::from_secs(1), "{:?}", began.elapsed());
    assert!(matches!(committer.health().state, CommitterState::Failed { .. }));
    shared.is_down.store(false, Ordering::SeqCst);
    works_again(&committer).await;
    committer.commit(batch(3)).await.unwrap();
    assert_eq!(*shared.written.lock().unwrap(), [3]);
}

/// An idle committer probes the database. It stops on request, also while the database is away.
#[tokio::test]
async fn an_idle_committer_probes_and_stops_when_told() {
    let shared = Arc::new(Shared::default());
    let (committer, task) = Committer::start(Fake(shared.clone()), TIMING).await.unwrap();
    let began = committer.health().confirmed;
    let mut health = committer.health.clone();
    health.wait_for(|health| began < health.confirmed).await.unwrap();
    shared.is_down.store(true, Ordering::SeqCst);
    shared.next.lock().unwrap().push(Next::FailsDuring);
    committer.commit(batch(1)).await.unwrap_err();
    committer.stop().await;
    task.await.unwrap();
    assert_eq!(committer.health().state, CommitterState::Stopped);
    assert!(matches!(committer.commit(batch(2)).await, Err(StoreError::Closed)));
}
