//! Jobs whose inputs are still to be fetched. They cannot be claimed before.

use crate::store::pool::{reading, writing};
use crate::store::{Store, StoreError};

use super::rows::{JobKey, JobRow, RawJob, columns};

impl Store {
    /// The jobs whose inputs are to be fetched, the oldest first. The limit of waiting jobs bounds
    /// their number.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn unfetched_jobs(&self) -> Result<Vec<JobRow>, StoreError> {
        let rows: Result<Vec<RawJob>, _> = reading!(&self.pool, pool => {
            let sql = concat!(
                "SELECT ",
                columns!(),
                " FROM jobs WHERE unfetched = 1 AND ended_unix_ms IS NULL ORDER BY key"
            );
            sqlx::query_as(sql).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading jobs to fetch"))?;
        rows.into_iter().map(RawJob::parse).collect()
    }

    /// Makes a job claimable whose inputs are fetched, and stores the request that names them.
    /// False if the job has ended meanwhile.
    ///
    /// # Errors
    /// The database fails.
    pub async fn fetched_job(&self, key: JobKey, request: &str) -> Result<bool, StoreError> {
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET request = $2, unfetched = 0
                       WHERE key = $1 AND unfetched = 1 AND ended_unix_ms IS NULL";
            let done = sqlx::query(sql).bind(key.0).bind(request).execute(pool).await;
            done.map(|done| done.rows_affected())
        });
        changed.map(|rows| rows == 1).map_err(StoreError::database("storing fetched inputs"))
    }

    /// Ends a job whose inputs cannot be fetched. False if it has ended before.
    ///
    /// # Errors
    /// The database fails.
    pub async fn fail_unfetched_job(
        &self,
        key: JobKey,
        failure: &str,
        now_unix_ms: i64,
    ) -> Result<bool, StoreError> {
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET state = 'FAILED', failure = $2, ended_unix_ms = $3
                       WHERE key = $1 AND unfetched = 1 AND ended_unix_ms IS NULL";
            let fail = sqlx::query(sql).bind(key.0).bind(failure).bind(now_unix_ms);
            fail.execute(pool).await.map(|done| done.rows_affected())
        });
        changed.map(|rows| rows == 1).map_err(StoreError::database("ending a job to fetch"))
    }
}
