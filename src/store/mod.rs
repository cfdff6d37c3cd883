//! The only room with SQL: sessions, bases, epochs, raw bytes, solutions and navigation data, in
//! SQLite or Postgres.
//!
//! [`Store`] has the pool of either database. Where possible, one text of SQL with `$1` serves
//! both, and both give the same answers. The schema is in `migrations/`, embedded in the program,
//! and brought up to date at the start. A database with a newer schema is refused.
//!
//! # Durability
//! SQLite runs in WAL mode with `synchronous=FULL`: a commit returns when it is on the disk.
//! [`Store::commit`] passes epochs and solutions to the committer. It writes those of many sessions
//! in one transaction, and answers each session when the transaction is committed.

mod antennas;
mod bases;
mod codec;
mod committer;
mod error;
mod feeds;
mod navigation;
mod page;
mod pool;
mod raw;
mod sessions;
mod snapshots;
mod solutions;

use std::fmt;
use std::sync::Arc;

use tokio::sync::Mutex;
use tokio::task::JoinHandle;

pub use antennas::AntennaName;
pub use bases::{BaseChange, BaseChoice, BaseKey, BaseName, BaseRow, BaseUse, StoredBaseEpoch};
pub use codec::CodecError;
pub use committer::{Batch, EncodedEpoch, EncodedSnapshot, EncodedSolution};
pub use error::StoreError;
pub use feeds::BaseFeed;
pub use navigation::{NavigationChange, StoredEphemeris, StoredNavigation};
pub use page::Page;
pub use raw::{RawChange, RawChunkSpan, RawPosition};
pub use sessions::{SessionKey, SessionRow, SessionSettings, StoredConfiguration};
pub use snapshots::StoredSnapshot;
pub use solutions::{Revisions, SolutionQuery, StoredEpoch, StoredSolution};

use committer::Committer;
use pool::Pool;

/// The database and its committer. All clones share both.
#[derive(Clone)]
pub struct Store {
    pool: Pool,
    committer: Committer,
    task: Arc<Mutex<Option<JoinHandle<()>>>>,
}

impl Store {
    /// Opens the database of `url`, either `sqlite://FILE` (created if absent) or `postgres://…`,
    /// and brings its schema up to date.
    ///
    /// # Errors
    /// The URL is invalid, the database cannot be reached, or its schema is newer.
    pub async fn open(url: &str) -> Result<Self, StoreError> {
        let pool = Pool::open(url).await?;
        let (committer, task) = Committer::start(pool.clone());
        Ok(Self { pool, committer, task: Arc::new(Mutex::new(Some(task))) })
    }

    /// Commits a batch, all of it or nothing. Returns when it is durable.
    ///
    /// # Errors
    /// Nothing of the batch may be considered stored. After [`StoreError::Database`] it may have
    /// been stored all the same, because the connection may break during the commit: read before
    /// writing again.
    pub async fn commit(&self, batch: Batch) -> Result<(), StoreError> {
        self.committer.commit(batch).await
    }

    /// Commits the batches that wait, then closes the database. Later calls fail.
    pub async fn close(&self) {
        self.committer.stop().await;
        if let Some(task) = self.task.lock().await.take() {
            // A panic of the committer has already failed the calls that waited for it.
            task.await.ok();
        }
        self.pool.close().await;
    }
}

impl fmt::Debug for Store {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Store").field("pool", &self.pool).finish_non_exhaustive()
    }
}
