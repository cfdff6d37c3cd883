//! The committer's connection to SQLite, with a thread of its own.
//!
//! SQLite blocks its caller. So a thread owns the connection and the prepared statements, and
//! runs a whole transaction at once: control changes threads once per transaction, not once per
//! statement. This module has the thread and its interface; the statements are in `writer`.
//!
//! The caller may stop waiting for the thread when a deadline has passed. Nobody then confirms what
//! the thread does. So the thread does not commit, unless it has already begun to.

mod binding;
mod failure;
mod rollups;
mod writer;

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;

use rusqlite::{Connection, OpenFlags};
use tokio::sync::oneshot;

use crate::store::database::{BUSY_TIMEOUT, CHECKPOINT_PAGES};
use crate::store::health::{DatabaseSetting, SettingRisk};

use super::batch::Batch;
use super::heads::Owner;
use failure::failed;
use writer::Writer;

/// Work for the thread.
type Work = Box<dyn for<'c> FnOnce(&mut Writer<'c>) + Send>;

/// A connection on a thread. The thread ends when this is dropped.
pub(in crate::store) struct SqliteThread {
    queue: mpsc::Sender<Work>,
}

/// How far a transaction is.
struct Progress(AtomicU8);

const WRITING: u8 = 0;
const COMMITTING: u8 = 1;
const ABANDONED: u8 = 2;

impl Progress {
    const fn new() -> Self {
        Self(AtomicU8::new(WRITING))
    }

    /// Whether it may commit, because its caller still waits. Marks it as committing.
    fn begins_to_commit(&self) -> bool {
        let turn = (WRITING, COMMITTING);
        self.0.compare_exchange(turn.0, turn.1, Ordering::AcqRel, Ordering::Acquire).is_ok()
    }

    /// Marks that its caller no longer waits. Returns whether it has begun to commit.
    fn abandon(&self) -> bool {
        let turn = (WRITING, ABANDONED);
        self.0.compare_exchange(turn.0, turn.1, Ordering::AcqRel, Ordering::Acquire).is_err()
    }
}

/// The caller's side of a transaction. When this is dropped, a transaction that is not committing
/// yet is abandoned, and `committing` says whether it had begun.
struct Waiting<'a> {
    progress: Arc<Progress>,
    committing: &'a AtomicBool,
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        let has_begun = self.progress.abandon();
        self.committing.store(has_begun, Ordering::Relaxed);
    }
}

impl SqliteThread {
    /// Opens an existing file with the newest schema.
    pub(super) async fn open(file: &Path) -> Result<Self, sqlx::Error> {
        let (queue, inbox) = mpsc::channel();
        let (opened, answer) = oneshot::channel();
        let file = file.to_owned();
        let thread = thread::Builder::new().name("committer".to_owned());
        thread.spawn(move || serve(&file, opened, &inbox))?;
        answer.await.map_err(|_| sqlx::Error::WorkerCrashed)?.map_err(failed)?;
        Ok(Self { queue })
    }

    /// Commits batches in one transaction, and returns the indices of those that it left out.
    pub(super) async fn write(
        &self,
        batches: &[Arc<Batch>],
        owner: Owner,
        committing: &AtomicBool,
    ) -> Result<Vec<usize>, sqlx::Error> {
        let (batches, progress) = (batches.to_vec(), Arc::new(Progress::new()));
        let _waiting = Waiting { progress: progress.clone(), committing };
        self.run(move |writer| writer.write(&batches, &owner, || progress.begins_to_commit())).await
    }

    /// Checks that a commit can begin; with `writes`, also that it succeeds.
    pub(super) async fn probe(&self, writes: bool) -> Result<(), sqlx::Error> {
        self.run(move |writer| writer.probe(writes)).await
    }

    /// The node that has the lease or had it last, and the number of its lease.
    pub(super) async fn owner(&self) -> Result<(String, i64), sqlx::Error> {
        self.run(|writer| writer.owner()).await
    }

    /// Gives the lease its next number, for this node.
    pub(super) async fn next_fence(&self, node: &str) -> Result<i64, sqlx::Error> {
        let node = node.to_owned();
        self.run(move |writer| writer.next_fence(&node)).await
    }

    /// The settings of the connection on which durability depends.
    pub(super) async fn settings(&self) -> Result<Vec<DatabaseSetting>, sqlx::Error> {
        let (mode, synchronous) = self.run(|writer| writer.settings()).await?;
        let full = 2;
        let setting = |name, value: String, is_safe: bool| {
            let risk = (!is_safe).then_some(SettingRisk::PowerFailure);
            DatabaseSetting { name, value, risk }
        };
        Ok(vec![
            setting("journal_mode", mode.clone(), mode == "wal"),
            setting("synchronous", synchronous.to_string(), full <= synchronous),
        ])
    }

    /// Runs `work` on the thread. Its panic is passed on.
    async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Writer<'_>) -> rusqlite::Result<T> + Send + 'static,
    ) -> Result<T, sqlx::Error> {
        let (reply, answer) = oneshot::channel();
        let work: Work = Box::new(move |writer| {
            let done = catch_unwind(AssertUnwindSafe(|| work(writer)));
            reply.send(done).ok(); // Err: nobody waits any more.
        });
        self.queue.send(work).map_err(|_| sqlx::Error::WorkerCrashed)?;
        let done: Result<_, Box<dyn Any + Send>> =
            answer.await.map_err(|_| sqlx::Error::WorkerCrashed)?;
        done.unwrap_or_else(|panic| resume_unwind(panic)).map_err(failed)
    }
}

/// Runs the thread: opens the connection and does the queued work until the queue is closed.
fn serve(file: &Path, opened: oneshot::Sender<rusqlite::Result<()>>, inbox: &mpsc::Receiver<Work>) {
    let connection = match connected(file) {
        Ok(connection) => connection,
        Err(error) => return drop(opened.send(Err(error))),
    };
    let mut writer = match Writer::new(&connection) {
        Ok(writer) => writer,
        Err(error) => return drop(opened.send(Err(error))),
    };
    if opened.send(Ok(())).is_err() {
        return;
    }
    while let Ok(work) = inbox.recv() {
        work(&mut writer);
    }
}

/// Opens a connection that commits durably, with the settings of `Database`. Foreign keys are not
/// checked, because setting the head proves that the session exists.
fn connected(file: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(file, flags)?;
    connection.busy_timeout(BUSY_TIMEOUT)?;
    connection.execute_batch(
        "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = OFF; \
         PRAGMA temp_store = MEMORY",
    )?;
    connection.pragma_update(None, "wal_autocheckpoint", CHECKPOINT_PAGES)?;
    Ok(connection)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use futures::FutureExt;
    use tokio::time::timeout;

    use super::*;
    use crate::store::{SessionKey, Store};

    /// A database with an open session, number 1, that has no epochs.
    async fn database(file: &Path) -> SqliteThread {
        let url = format!("sqlite://{}", file.display());
        Store::open(&url).await.unwrap().close().await;
        let connection = Connection::open(file).unwrap();
        let head = "INSERT INTO session_heads (session, owner, fence) VALUES (1, '', 0)";
        connection.execute_batch(&format!("PRAGMA foreign_keys = OFF; {head}")).unwrap();
        SqliteThread::open(file).await.unwrap()
    }

    fn closed(file: &Path) -> Option<i64> {
        let connection = Connection::open(file).unwrap();
        let read = "SELECT closed_unix_ms FROM session_heads WHERE session = 1";
        connection.query_row(read, (), |row| row.get(0)).unwrap()
    }

    fn closing() -> [Arc<Batch>; 1] {
        [Arc::new(Batch { closed_unix_ms: Some(7), ..Batch::new(SessionKey(1), None) })]
    }

    /// A transaction that nobody waits for any more is rolled back when it gets the lock at last.
    #[tokio::test]
    async fn a_transaction_whose_deadline_has_passed_does_not_commit() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("graphfix.db");
        let thread = database(&file).await;
        let other = Connection::open(&file).unwrap();
        other.execute_batch("BEGIN IMMEDIATE").unwrap();
        let (batches, committing) = (closing(), AtomicBool::new(false));
        let write = thread.write(&batches, Owner::default(), &committing);
        assert!(timeout(Duration::from_millis(50), write).await.is_err());
        assert!(!committing.load(Ordering::Relaxed));
        other.execute_batch("ROLLBACK").unwrap();
        thread.probe(true).await.unwrap(); // Behind the transaction.
        assert_eq!(closed(&file), None);
        let left_out = thread.write(&batches, Owner::default(), &committing).await.unwrap();
        assert_eq!((left_out, closed(&file)), (Vec::new(), Some(7)));
        let left_out = thread.write(&batches, Owner::default(), &committing).await.unwrap();
        assert_eq!(left_out, [0], "it is closed");
    }

    /// If the caller stops waiting after the commit has begun, the caller learns it.
    #[test]
    fn a_commit_that_has_begun_is_reported() {
        for begins in [false, true] {
            let (progress, committing) = (Arc::new(Progress::new()), AtomicBool::new(false));
            let waiting = Waiting { progress: progress.clone(), committing: &committing };
            assert!(!begins || progress.begins_to_commit());
            drop(waiting);
            assert_eq!(committing.load(Ordering::Relaxed), begins);
            assert!(!progress.begins_to_commit(), "nobody waits");
        }
    }

    /// A panic is passed on to the caller, and the transaction is rolled back.
    #[tokio::test]
    async fn a_panic_is_passed_on() {
        let folder = tempfile::tempdir().unwrap();
        let thread = database(&folder.path().join("graphfix.db")).await;
        let panics =
            async { thread.run(|_| -> rusqlite::Result<()> { panic!("on purpose") }).await };
        let panic = AssertUnwindSafe(panics).catch_unwind().await.unwrap_err();
        assert_eq!(panic.downcast_ref::<&str>(), Some(&"on purpose"));
        thread.probe(true).await.unwrap();
    }

    /// An absent file is not created, because it would be an empty database.
    #[tokio::test]
    async fn an_absent_file_is_not_created() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("absent.db");
        assert!(SqliteThread::open(&file).await.is_err());
        assert!(!file.exists());
    }
}
