//! A node of a cluster, on the committer's connection: how it enters, and how it renews its lease.
//!
//! A node is alive while `nodes` has its row. Another node may remove the row only after the lease
//! has ended by the server's clock. So each transaction checks that the row exists: it renews the
//! lease from time to time, and otherwise reads that the lease has not ended. The head of a session
//! decides in the end: if another node has claimed the session, its fence is another one.

use std::sync::atomic::{AtomicBool, AtomicI32, AtomicI64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use sqlx::{Connection, PgConnection};
use tokio::time::sleep;
use uuid::Uuid;

/// Duration of a lease after a renewal. It is longer than the deadline of a commit, because the
/// lease cannot be renewed during a commit.
pub(in crate::store) const LEASE: Duration = Duration::from_secs(8);
/// Age of the last renewal from which a transaction renews the lease again.
const RENEWAL: Duration = Duration::from_secs(1);
/// Time within which the lease of an earlier process with this name ends.
const NAME_PATIENCE: Duration = LEASE.saturating_add(Duration::from_secs(2));
const PAUSE: Duration = Duration::from_millis(100);

const NEXT_FENCE: &str = "UPDATE committer SET node = $1, fence = fence + 1 RETURNING fence";
const ENTER: &str = "INSERT INTO nodes (fence, name, address, secret, process, expires_at) \
    VALUES ($1, $2, $3, $4, $5, clock_timestamp() + make_interval(secs => $6)) \
    ON CONFLICT (name) DO NOTHING";
const REMOVE_FORMER: &str = "DELETE FROM nodes WHERE name = $1 AND expires_at < clock_timestamp()";
const RENEW: &str = "UPDATE nodes SET process = $2, \
    expires_at = clock_timestamp() + make_interval(secs => $3) WHERE fence = $1";
const IS_VALID: &str =
    "SELECT EXISTS (SELECT 1 FROM nodes WHERE fence = $1 AND clock_timestamp() < expires_at)";
/// The lease of the schema, shared by nodes. A service without a cluster takes it alone.
pub(super) const TAKE_SHARED: &str = "SELECT pg_try_advisory_lock_shared(\
    hashtextextended('graphfix lease ' || current_schema(), 0))";

/// This node.
#[derive(Debug)]
pub(in crate::store) struct Member {
    name: String,
    address: String,
    secret: String,
    /// The number of its lease; 0 before it has entered.
    fence: AtomicI64,
    /// Server process of its connection.
    process: AtomicI32,
    /// A time just before the last committed renewal, by the local clock.
    renewed: Mutex<Option<Instant>>,
    /// Whether it leads, and has read everything that the former leader stored.
    pub(in crate::store) is_leader: AtomicBool,
}

impl Member {
    /// The node `name`, which others reach at `address`.
    pub(in crate::store) fn new(name: &str, address: &str) -> Self {
        let secret = format!("{}{}", Uuid::new_v4().simple(), Uuid::new_v4().simple());
        Self {
            name: name.to_owned(),
            address: address.to_owned(),
            secret,
            fence: AtomicI64::new(0),
            process: AtomicI32::new(0),
            renewed: Mutex::default(),
            is_leader: AtomicBool::new(false),
        }
    }

    /// The number of its lease.
    pub(in crate::store) fn fence(&self) -> i64 {
        self.fence.load(Ordering::Acquire)
    }

    /// Enters the cluster, or renews its lease after a lost connection. Returns the name of what
    /// prevents it: a live node with the same name, or a node that has ended its lease.
    pub(super) async fn enter(
        &self,
        connection: &mut PgConnection,
        process: i32,
    ) -> Result<Option<String>, sqlx::Error> {
        self.process.store(process, Ordering::Release);
        let begun = Instant::now();
        if self.fence() != 0 {
            return match self.renew(connection).await? {
                true => {
                    self.note_renewed(begun);
                    Ok(None)
                }
                false => {
                    self.is_leader.store(false, Ordering::Release);
                    Ok(Some(format!("a node that has ended the lease of {}", self.name)))
                }
            };
        }
        loop {
            let renewed = Instant::now();
            if let Some(fence) = self.insert(connection, process).await? {
                self.fence.store(fence, Ordering::Release);
                self.note_renewed(renewed);
                return Ok(None);
            }
            if NAME_PATIENCE < begun.elapsed() {
                return Ok(Some(format!("{} (a node of this name is alive)", self.name)));
            }
            sleep(PAUSE).await;
        }
    }

    /// Inserts the row of this node with a new fence; `None` if a live node has its name.
    async fn insert(
        &self,
        connection: &mut PgConnection,
        process: i32,
    ) -> Result<Option<i64>, sqlx::Error> {
        let mut transaction = connection.begin().await?;
        sqlx::query(REMOVE_FORMER).bind(&self.name).execute(&mut *transaction).await?;
        let named = format!("{} (a node of a cluster)", self.name);
        let fence = sqlx::query_scalar(NEXT_FENCE).bind(named);
        let fence: i64 = fence.fetch_one(&mut *transaction).await?;
        let enter = sqlx::query(ENTER).bind(fence).bind(&self.name).bind(&self.address);
        let enter = enter.bind(&self.secret).bind(process).bind(LEASE.as_secs_f64());
        let is_in = enter.execute(&mut *transaction).await?.rows_affected() == 1;
        if !is_in {
            transaction.rollback().await?;
            return Ok(None);
        }
        transaction.commit().await?;
        Ok(Some(fence))
    }

    /// Checks within a transaction that the lease has not ended, and renews it if necessary.
    /// Returns the time of a renewal, to be passed to [`Self::note_renewed`] after the commit.
    pub(super) async fn confirm(
        &self,
        connection: &mut PgConnection,
    ) -> Result<Option<Instant>, sqlx::Error> {
        let begun = Instant::now();
        if self.since_renewal() < RENEWAL {
            let valid = sqlx::query_scalar(IS_VALID).bind(self.fence());
            if valid.fetch_one(&mut *connection).await? {
                return Ok(None);
            }
        }
        match self.renew(connection).await? {
            true => Ok(Some(begun)),
            false => Err(sqlx::Error::Protocol("another node has ended the lease".to_owned())),
        }
    }

    /// Renews the lease; `false` if another node has ended it.
    async fn renew(&self, connection: &mut PgConnection) -> Result<bool, sqlx::Error> {
        let renew = sqlx::query(RENEW).bind(self.fence());
        let renew = renew.bind(self.process.load(Ordering::Acquire)).bind(LEASE.as_secs_f64());
        Ok(renew.execute(connection).await?.rows_affected() == 1)
    }

    /// Remembers a committed renewal that began at this time.
    pub(super) fn note_renewed(&self, begun: Instant) {
        *self.renewed.lock().unwrap_or_else(PoisonError::into_inner) = Some(begun);
    }

    /// Checks by the local clock that the lease has not ended. This clock also runs while the
    /// process is suspended. A commit is acknowledged only after this check.
    pub(super) fn check(&self) -> Result<(), sqlx::Error> {
        if self.since_renewal() < LEASE {
            return Ok(());
        }
        Err(sqlx::Error::Protocol("the lease of this node may have ended meanwhile".to_owned()))
    }

    fn since_renewal(&self) -> Duration {
        let renewed = *self.renewed.lock().unwrap_or_else(PoisonError::into_inner);
        renewed.map_or(Duration::MAX, |renewed| renewed.elapsed())
    }
}
