//! The queue: which job runs next, who runs it, and how its run ends.
//!
//! A claim raises the job's fence and names its node. Progress and the end of a job are written
//! only with the fence of its last claim, so a claimant that has lost its job changes nothing. A
//! claim is lost after some time without heartbeat, by the clock of the database: the clocks of
//! the claimants do not matter. Nothing here rests on the lease of the database.
//!
//! Tenants take turns. The next tenant is one with the fewest running jobs. Among these it is the
//! one whose jobs have used the least processor time while others also had jobs (`job_turns`;
//! stride scheduling, as in the solver pool). A tenant that enters with a job begins with the least
//! time of the others, so it gains nothing from the time before.

use std::time::Duration;

use crate::store::pool::{Pool, reading, writing};
use crate::store::{Store, StoreError};

use super::rows::{JobEnd, JobKey, JobProgress, JobRow, JobState, RawJob, columns};

/// The time of the database (ms since 1970-01-01 UTC).
macro_rules! sqlite_now {
    () => {
        "CAST(unixepoch('subsec') * 1000 AS INTEGER)"
    };
}
macro_rules! postgres_now {
    () => {
        "CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000 AS BIGINT)"
    };
}

/// Whether a job can be claimed. After `$1` ms without a heartbeat a claim is lost.
macro_rules! any {
    ($now:expr) => {
        concat!(
            "SELECT EXISTS (SELECT 1 FROM jobs WHERE ended_unix_ms IS NULL AND unfetched = 0 ",
            "AND (state = 'QUEUED' OR heartbeat_unix_ms < ",
            $now,
            " - $1))"
        )
    };
}

const LEAVE: &str = "DELETE FROM job_turns WHERE NOT EXISTS (SELECT 1 FROM jobs \
    WHERE jobs.tenant = job_turns.tenant AND ended_unix_ms IS NULL AND unfetched = 0)";
const ENTER: &str = "INSERT INTO job_turns (tenant, used_ms) \
    SELECT DISTINCT tenant, COALESCE((SELECT MIN(used_ms) FROM job_turns), 0) FROM jobs \
    WHERE ended_unix_ms IS NULL AND unfetched = 0 ON CONFLICT (tenant) DO NOTHING";

/// Claims the oldest job of the next tenant, for the node `$2`.
macro_rules! claim {
    ($now:expr, $lock:literal) => {
        concat!(
            "UPDATE jobs SET state = 'RUNNING', node = $2, fence = fence + 1, lost_claims = ",
            "lost_claims + CASE WHEN state = 'RUNNING' THEN 1 ELSE 0 END, started_unix_ms = ",
            $now,
            ", heartbeat_unix_ms = ",
            $now,
            ", cpu_ms = 0, epochs = 0, answered = 0, read_bytes = 0, resumed_epochs = 0, ",
            "resumed_bytes = 0 WHERE key = (",
            "SELECT key FROM jobs WHERE ended_unix_ms IS NULL AND unfetched = 0 ",
            "AND (state = 'QUEUED' OR heartbeat_unix_ms < ",
            $now,
            " - $1) AND tenant = (SELECT present.tenant FROM (SELECT tenant, ",
            "SUM(CASE WHEN state = 'QUEUED' OR heartbeat_unix_ms < ",
            $now,
            " - $1 THEN 1 ELSE 0 END) AS waiting, COUNT(*) AS unended FROM jobs ",
            "WHERE ended_unix_ms IS NULL AND unfetched = 0 GROUP BY tenant) AS present ",
            "JOIN job_turns ON job_turns.tenant = present.tenant WHERE 0 < waiting ",
            "ORDER BY unended - waiting, used_ms, present.tenant LIMIT 1) ORDER BY key LIMIT 1",
            $lock,
            ") RETURNING ",
            columns!()
        )
    };
}

/// Adds the processor time since the last heartbeat to the tenant's; `$3` is the job's total (ms).
const COUNT: &str = "UPDATE job_turns SET used_ms = used_ms + $3 - (SELECT cpu_ms FROM jobs \
    WHERE key = $1) WHERE tenant = (SELECT tenant FROM jobs \
    WHERE key = $1 AND fence = $2 AND state = 'RUNNING')";

/// Stores a heartbeat.
macro_rules! beat {
    ($now:expr) => {
        concat!(
            "UPDATE jobs SET cpu_ms = $3, epochs = $4, answered = $5, read_bytes = $6, ",
            "resumed_epochs = $7, resumed_bytes = $8, heartbeat_unix_ms = ",
            $now,
            " WHERE key = $1 AND fence = $2 AND state = 'RUNNING'"
        )
    };
}

/// A claim of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobClaim {
    /// The job.
    pub key: JobKey,
    /// Number of the claim.
    pub fence: i64,
}

impl JobRow {
    /// The claim by which this row was read.
    pub const fn claim(&self) -> JobClaim {
        JobClaim { key: self.key, fence: self.fence }
    }

    /// Whether the job has ended by this claim. A cancellation, a return and another claim raise
    /// the fence.
    pub fn was_ended_by(&self, claim: JobClaim) -> bool {
        self.state.is_end() && self.claim() == claim
    }
}

impl Store {
    /// The time of the database (ms since 1970-01-01 UTC), the same for all nodes.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn database_unix_ms(&self) -> Result<i64, StoreError> {
        let sql = match &self.pool {
            Pool::Sqlite { .. } => concat!("SELECT ", sqlite_now!()),
            Pool::Postgres { .. } => concat!("SELECT ", postgres_now!()),
        };
        let now = reading!(&self.pool, pool => sqlx::query_scalar(sql).fetch_one(pool).await);
        now.map_err(StoreError::database("reading the time of the database"))
    }

    /// Claims the next job for a node: a waiting one, or one whose claimant has sent no heartbeat
    /// for the time `silent`.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub async fn claim_job(
        &self,
        node: &str,
        silent: Duration,
    ) -> Result<Option<JobRow>, StoreError> {
        let silent_ms = silent.as_millis() as i64;
        let (any, claim) = match &self.pool {
            Pool::Sqlite { .. } => (any!(sqlite_now!()), claim!(sqlite_now!(), "")),
            Pool::Postgres { .. } => {
                (any!(postgres_now!()), claim!(postgres_now!(), " FOR UPDATE SKIP LOCKED"))
            }
        };
        let is_any: Result<bool, _> = reading!(&self.pool, pool => {
            sqlx::query_scalar(any).bind(silent_ms).fetch_one(pool).await
        });
        if !is_any.map_err(StoreError::database("reading whether jobs wait"))? {
            return Ok(None);
        }
        // No transaction: a claimant that stops between two statements blocks nobody.
        let row: Result<Option<RawJob>, sqlx::Error> = writing!(&self.pool, pool => {
            let claim = async {
                sqlx::query(LEAVE).execute(pool).await?;
                sqlx::query(ENTER).execute(pool).await?;
                sqlx::query_as(claim).bind(silent_ms).bind(node).fetch_optional(pool).await
            };
            claim.await
        });
        row.map_err(StoreError::database("claiming a job"))?.map(RawJob::parse).transpose()
    }

    /// Stores the heartbeat of a claimed job, with its progress and the processor time that the
    /// claim has used; false if the claim has ended.
    ///
    /// # Errors
    /// The database fails.
    pub async fn beat_job(
        &self,
        claim: JobClaim,
        progress: JobProgress,
        cpu: Duration,
    ) -> Result<bool, StoreError> {
        let beat = match &self.pool {
            Pool::Sqlite { .. } => beat!(sqlite_now!()),
            Pool::Postgres { .. } => beat!(postgres_now!()),
        };
        let cpu_ms = cpu.as_millis() as i64;
        let changed: Result<u64, sqlx::Error> = writing!(&self.pool, pool => {
            let beat = async {
                let mut transaction = pool.begin().await?;
                let count = sqlx::query(COUNT).bind(claim.key.0).bind(claim.fence).bind(cpu_ms);
                count.execute(&mut *transaction).await?;
                let done = sqlx::query(beat)
                    .bind(claim.key.0)
                    .bind(claim.fence)
                    .bind(cpu_ms)
                    .bind(progress.epochs as i64)
                    .bind(progress.answered as i64)
                    .bind(progress.read_bytes as i64)
                    .bind(progress.resumed_epochs as i64)
                    .bind(progress.resumed_bytes as i64)
                    .execute(&mut *transaction)
                    .await?;
                transaction.commit().await.map(|()| done.rows_affected())
            };
            beat.await
        });
        changed.map(|rows| rows == 1).map_err(StoreError::database("writing the progress of a job"))
    }

    /// Ends a claimed job; false if the claim has already ended.
    ///
    /// # Errors
    /// The database fails.
    pub async fn end_job(
        &self,
        claim: JobClaim,
        end: &JobEnd,
        now_unix_ms: i64,
    ) -> Result<bool, StoreError> {
        let (state, result, report, failure) = match end {
            JobEnd::Succeeded { result, bytes, report } => {
                (JobState::Succeeded, Some((result, *bytes as i64)), Some(report), None)
            }
            JobEnd::Failed { failure } => (JobState::Failed, None, None, Some(failure)),
        };
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET state = $3, ended_unix_ms = $4, result = $5,
                       result_bytes = $6, report = $7, failure = $8
                       WHERE key = $1 AND fence = $2 AND state = 'RUNNING'";
            sqlx::query(sql)
                .bind(claim.key.0)
                .bind(claim.fence)
                .bind(state.name())
                .bind(now_unix_ms)
                .bind(result.map(|(name, _)| name))
                .bind(result.map(|(_, bytes)| bytes))
                .bind(report)
                .bind(failure)
                .execute(pool)
                .await
                .map(|done| done.rows_affected())
        });
        changed.map(|rows| rows == 1).map_err(StoreError::database("ending a job"))
    }

    /// Queues a claimed job again because its claimant stops; false if the claim has already ended.
    ///
    /// # Errors
    /// The database fails.
    pub async fn return_job(&self, claim: JobClaim) -> Result<bool, StoreError> {
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET state = 'QUEUED', fence = fence + 1
                       WHERE key = $1 AND fence = $2 AND state = 'RUNNING'";
            let done = sqlx::query(sql).bind(claim.key.0).bind(claim.fence).execute(pool).await;
            done.map(|done| done.rows_affected())
        });
        changed.map(|rows| rows == 1).map_err(StoreError::database("returning a job"))
    }

    /// Queues running jobs again at the start of a service. On SQLite these are all, because only
    /// this service runs them and its claims are from a process that has ended. On Postgres it
    /// changes nothing, because a lost claim is detected by its missing heartbeat.
    ///
    /// # Errors
    /// The database fails.
    pub async fn requeue_jobs(&self) -> Result<u64, StoreError> {
        let Pool::Sqlite { .. } = &self.pool else { return Ok(0) };
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET state = 'QUEUED', fence = fence + 1,
                       lost_claims = lost_claims + 1
                       WHERE state = 'RUNNING' AND ended_unix_ms IS NULL";
            sqlx::query(sql).execute(pool).await.map(|done| done.rows_affected())
        });
        changed.map_err(StoreError::database("queueing jobs again"))
    }
}
