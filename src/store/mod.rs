//! The only module with SQL: sessions, bases, epochs, raw bytes, solutions, navigation data, keys
//! and the audit log, in SQLite or Postgres.
//!
//! [`Store`] has the pool of either database. Where possible, one text of SQL with `$1` serves
//! both, and both give the same answers. The schema is in `migrations/`, embedded in the program,
//! and brought up to date at the start. A database with a newer schema is refused.
//!
//! # Durability
//! SQLite runs in WAL mode with `synchronous=FULL`: a commit returns when it is on the disk. On
//! Postgres a connection sets `synchronous_commit` where it is off. [`Store::settings`] lists the
//! other settings of the server that matter. [`Store::commit`] passes epochs and solutions to the
//! committer. The committer writes those of many sessions in one transaction, and answers each
//! session when the transaction is committed.

mod antennas;
mod audit;
mod base_deletion;
mod base_epochs;
mod bases;
mod chain;
mod codec;
mod committer;
mod database;
mod days;
mod deadline;
mod deletion;
mod epochs;
mod error;
mod expiry_clock;
mod feeds;
mod heads;
mod health;
mod history;
mod jobs;
mod joined;
mod keys;
mod lease;
mod named_requests;
mod navigation;
mod navigation_accounts;
mod nodes;
mod notices;
mod page;
mod pool;
mod raw;
mod resealing;
mod retention;
mod rollup;
#[cfg(test)]
mod sample;
mod session_filter;
mod session_rows;
mod sessions;
mod sign_ins;
mod snapshots;
mod solutions;
mod tenants;
mod times;

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::sync::Mutex;
use tokio::task::JoinHandle;
use tokio::time::timeout;

use crate::secrets::Secrets;

pub use antennas::AntennaName;
pub use audit::{
    Act, AuditEntry, AuditFilter, Author, BY_OPERATOR, COMMAND_LINE, DONE, LOOPBACK, UNKNOWN,
};
pub(crate) use bases::NewBaseRow;
pub use bases::{BaseChange, BaseChoice, BaseKey, BaseName, BaseRow, BaseUse, StoredBaseEpoch};
pub use codec::CodecError;
pub(crate) use committer::CommitterMeters;
pub use committer::{
    ArcStart, Batch, EncodedEpoch, EncodedSnapshot, EncodedSolution, EpochReference, FirstAnswer,
};
pub use epochs::StoredEpoch;
pub use error::StoreError;
pub use feeds::BaseFeed;
pub(crate) use heads::SCANNED_HEADS;
pub use heads::SessionHead;
pub use health::{CommitterHealth, CommitterState, DatabaseSetting, SettingRisk};
pub use history::{FleetHour, HistoryFilter, SessionSummary};
pub use jobs::{
    DeliveryAttempt, DeliveryEnd, DueWebhook, JobClaim, JobEnd, JobFilesRow, JobKey, JobProgress,
    JobRow, JobState, JobUploadRow, NewJob, WebhookState,
};
pub use keys::{KeyRow, NewKeyRow};
pub(crate) use named_requests::Created;
pub use named_requests::NamedRequest;
pub(crate) use navigation::owner_of;
pub use navigation::{
    NavigationChange, NavigationDifference, NavigationRows, StoredCoefficients, StoredEphemeris,
    StoredNavigation,
};
pub(crate) use navigation_accounts::{OWNER_PREFIX, TENANT_PREFIX, account_of};
pub use nodes::NodeRow;
pub(crate) use nodes::{Claim, NODE_LEASE};
pub(crate) use notices::{Change, Notices};
pub use page::Page;
pub use raw::{RawChange, RawChunkSpan, RawPosition};
pub use resealing::SecretsUnder;
pub use retention::Expired;
pub use rollup::{Bounds, Rollup, Spread, StatusCounts};
pub(crate) use rollup::{HOUR_S, MINUTE_S};
pub use session_filter::SessionFilter;
pub use sessions::{SessionKey, SessionRow, SessionSettings, StoredConfiguration};
pub use sign_ins::SignInRow;
pub use snapshots::StoredSnapshot;
pub(crate) use snapshots::StoredState;
pub use solutions::{Revisions, SolutionQuery, StoredSolution};
pub use tenants::{TenantRow, TenantUse};

use committer::{Committer, Connector, Member, Timing};
use database::Database;
pub use days::Arrival;
use days::Days;
use deadline::DEADLINE;
use expiry_clock::Counted;
use lease::FileLease;
use pool::{Pool, reading};
use session_rows::JoinedRows;
use snapshots::JoinedStates;

/// The database and its committer. All clones share both.
#[derive(Clone)]
pub struct Store {
    pool: Pool,
    /// A connection that reads changed keys and nothing else.
    key_pool: Pool,
    /// Reads of the rows and states of sessions, which are joined on Postgres.
    rows: Option<Arc<JoinedRows>>,
    states: Option<Arc<JoinedStates>>,
    committer: Committer,
    task: Arc<Mutex<Option<JoinHandle<()>>>>,
    settings: Arc<[DatabaseSetting]>,
    folder: Option<Arc<Path>>,
    file: Option<Arc<Path>>,
    lease: Option<Arc<FileLease>>,
    days: Arc<Days>,
    counted: Arc<Counted>,
    /// This service as a node of a cluster.
    member: Option<Arc<Member>>,
    /// Name of the node.
    node: Arc<str>,
    secrets: Arc<Secrets>,
}

/// Bytes that the disk of a folder has left; `None` if unknown.
pub(crate) fn disk_free_bytes(folder: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(folder).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

impl Store {
    /// Opens the database of `url`, either `sqlite://FILE` (created if absent) or `postgres://…`,
    /// and brings its schema up to date.
    ///
    /// # Errors
    /// The URL is invalid, the database cannot be reached, or its schema is newer.
    pub async fn open(url: &str) -> Result<Self, StoreError> {
        Self::open_for(url, None, None).await
    }

    /// Opens the database for a service that writes alone. It has the lease of the database until
    /// it closes the store or ends.
    ///
    /// # Errors
    /// As for [`Self::open`]; or another service has the lease ([`StoreError::InUse`] names it).
    pub async fn open_alone(url: &str, node: &str) -> Result<Self, StoreError> {
        Self::open_for(url, Some(node), None).await
    }

    /// Opens the database for the node of a cluster, which other nodes reach at `address`. Each
    /// node has a lease of its own.
    ///
    /// # Errors
    /// As for [`Self::open`]; or the database is not on Postgres, a service outside the cluster
    /// uses it, or a live node has this name.
    pub async fn open_in_cluster(url: &str, node: &str, address: &str) -> Result<Self, StoreError> {
        Self::open_for(url, Some(node), Some(address)).await
    }

    async fn open_for(
        url: &str,
        node: Option<&str>,
        address: Option<&str>,
    ) -> Result<Self, StoreError> {
        let database = Database::parse(url)?;
        if address.is_some() && database.file().is_some() {
            return Err(StoreError::ClusterOfFile);
        }
        let member = node.zip(address).map(|(node, address)| Member::new(node, address));
        let member = member.map(Arc::new);
        let leased = database.file().zip(node);
        let lease = leased.map(|(file, node)| FileLease::take(&file, node)).transpose()?;
        let (pool, key_pool) = (Pool::new(&database), Pool::of_one(&database));
        let folder = database.folder().map(Into::into);
        let file = database.file().map(Into::into);
        let connector = Connector::new(database.clone(), pool.turn(), node);
        // This comes before any change of the schema that a running service uses. Nodes with the
        // same schema may start while others run; to bring the schema up to date, no node may run.
        if member.is_none() || database.check_schema().await.is_err() {
            connector.check_lease().await?;
            database.migrate().await?;
        }
        let connector = connector.with_member(member.clone());
        let settings = connector.settings().await?.into();
        let days = connector.days();
        let (committer, task) = Committer::start(connector, Timing::service()).await?;
        let task = Arc::new(Mutex::new(Some(task)));
        let lease = lease.map(Arc::new);
        let node = node.unwrap_or_default().into();
        let postgres = pool.postgres();
        let store = Self {
            rows: postgres.map(JoinedRows::of),
            states: postgres.map(JoinedStates::of),
            pool,
            key_pool,
            committer,
            task,
            settings,
            folder,
            file,
            lease,
            days,
            counted: Arc::default(),
            member,
            node,
            secrets: Arc::default(),
        };
        store.read_expiry_clock().await?;
        Ok(store)
    }

    /// Opens the database of `url` for changes that a service reads from the database, such as
    /// keys; a service may use it at the same time. Commits fail with [`StoreError::Closed`].
    /// Without a service the database is created if absent, and its schema brought up to date.
    ///
    /// # Errors
    /// The URL is invalid, the database cannot be reached, or a service uses it with another
    /// schema.
    pub async fn open_beside(url: &str, node: &str) -> Result<Self, StoreError> {
        let database = Database::parse(url)?;
        if let Err(error) = database.check_schema().await {
            if matches!(error, StoreError::NewerSchema { .. }) {
                return Err(error);
            }
            Self::open_alone(url, node).await?.close().await;
        }
        Ok(Self::without_committer(&database))
    }

    /// The file of the database of `url`; `None` for a server.
    ///
    /// # Errors
    /// The URL is invalid.
    pub fn file_of(url: &str) -> Result<Option<PathBuf>, StoreError> {
        Ok(Database::parse(url)?.file())
    }

    /// Opens an existing database of a service, to write rows that belong to the caller alone, such
    /// as claimed jobs. Commits fail with [`StoreError::Closed`].
    ///
    /// # Errors
    /// The URL is invalid, the database cannot be reached, or it has another schema.
    pub async fn open_existing(url: &str) -> Result<Self, StoreError> {
        let database = Database::parse(url)?;
        database.check_schema().await?;
        Ok(Self::without_committer(&database))
    }

    /// Opens the database of `url` for reading. It changes nothing, not even the schema; a service
    /// may use it at the same time. Commits fail with [`StoreError::Closed`].
    ///
    /// # Errors
    /// The URL is invalid, the database cannot be reached, or it has another schema.
    pub async fn open_read_only(url: &str) -> Result<Self, StoreError> {
        let database = Database::parse(url)?;
        database.check_schema().await?;
        Ok(Self::without_committer(&database.read_only()))
    }

    fn without_committer(database: &Database) -> Self {
        let (pool, key_pool) = (Pool::new(database), Pool::of_one(database));
        let folder = database.folder().map(Into::into);
        let file = database.file().map(Into::into);
        let (committer, task) = (Committer::stopped(), Arc::default());
        let (settings, lease, days) = (Arc::new([]), None, Arc::default());
        let (member, node) = (None, "".into());
        let postgres = pool.postgres();
        Self {
            rows: postgres.map(JoinedRows::of),
            states: postgres.map(JoinedStates::of),
            pool,
            key_pool,
            committer,
            task,
            settings,
            folder,
            file,
            lease,
            days,
            counted: Arc::default(),
            member,
            node,
            secrets: Arc::default(),
        }
    }

    /// Name of the node; empty without a lease.
    pub(crate) fn node(&self) -> &str {
        &self.node
    }

    /// The store with the keys that encrypt its secrets. Without keys it stores secrets in plain
    /// text, and cannot read encrypted ones.
    #[must_use]
    pub fn with_secrets(mut self, secrets: Secrets) -> Self {
        self.secrets = Arc::new(secrets);
        self
    }

    /// The keys that encrypt stored secrets.
    pub(crate) fn secrets(&self) -> &Secrets {
        &self.secrets
    }

    /// The settings of the database on which durability and size depend, as read at the start.
    pub fn settings(&self) -> &[DatabaseSetting] {
        &self.settings
    }

    /// State and counts of the committer.
    pub fn committer_health(&self) -> CommitterHealth {
        self.committer.health()
    }

    /// Waits until it is known that another service had the lease of the database since this one
    /// last committed. Returns the error with which this service must end, to start again.
    pub async fn lease_lost(&self) -> StoreError {
        self.committer.lease_lost().await
    }

    /// Meters of the committer since the start.
    pub(crate) const fn committer_meters(&self) -> &CommitterMeters {
        self.committer.meters()
    }

    /// Number of batches that wait for the next transaction.
    pub(crate) fn waiting_batches(&self) -> usize {
        self.committer.waiting()
    }

    /// Checks that the database answers a read.
    ///
    /// # Errors
    /// It does not answer within the deadline of a statement.
    pub(crate) async fn check_reads(&self) -> Result<(), StoreError> {
        let read: Result<i32, _> = reading!(&self.pool, pool => {
            sqlx::query_scalar("SELECT 1").fetch_one(pool).await
        });
        read.map(drop).map_err(StoreError::database("reading from the database"))
    }

    /// Bytes that the disk of the database file has left; `None` for a server, or if unknown.
    pub(crate) fn free_bytes(&self) -> Option<u64> {
        disk_free_bytes(self.folder.as_ref()?)
    }

    /// The database file; `None` for a server.
    pub(crate) fn file(&self) -> Option<PathBuf> {
        self.file.as_deref().map(Path::to_owned)
    }

    /// Commits a batch, all of it or nothing. Returns when it is durable.
    ///
    /// # Errors
    /// Nothing of the batch is stored, unless the error is [`StoreError::Unconfirmed`]. In that
    /// case the connection failed during the commit: ask `confirmed_last_number`.
    pub async fn commit(&self, batch: Batch) -> Result<(), StoreError> {
        self.committer.commit(batch).await
    }

    /// Checks that commits work, and that no earlier commit that failed can still end. What is read
    /// afterwards contains each commit of this service that was answered with
    /// [`StoreError::Unconfirmed`], or never will.
    ///
    /// # Errors
    /// Commits fail. They are refused until the database answers again.
    pub(crate) fn settled(&self) -> Result<(), StoreError> {
        self.committer.check()
    }

    /// Number of a session's last epoch, when no earlier commit is pending.
    ///
    /// # Errors
    /// Commits fail, or the database does.
    pub(crate) async fn confirmed_last_number(
        &self,
        session: SessionKey,
    ) -> Result<Option<u64>, StoreError> {
        self.settled()?;
        let number: Result<Option<i64>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT last_seq FROM session_heads WHERE session = $1";
            sqlx::query_scalar(sql).bind(session.0).fetch_one(pool).await
        });
        let number = number.map_err(StoreError::database("reading a session's last number"))?;
        Ok(number.map(|seq| seq as u64))
    }

    /// Commits the waiting batches, then closes the database. Later calls fail. A connection that
    /// is not returned within the deadline of a statement stays open until the process ends.
    pub async fn close(&self) {
        self.committer.stop().await;
        if let Some(task) = self.task.lock().await.take() {
            // A panic of the committer has already failed the calls that waited for it.
            task.await.ok();
        }
        self.leave().await;
        let closing = async {
            self.key_pool.close().await;
            self.pool.close().await;
        };
        if timeout(DEADLINE, closing).await.is_err() {
            tracing::warn!("connections to the database were still in use; left open");
        }
        if let Some(lease) = &self.lease {
            lease.end();
        }
    }
}

impl fmt::Debug for Store {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Store").field("pool", &self.pool).finish_non_exhaustive()
    }
}
