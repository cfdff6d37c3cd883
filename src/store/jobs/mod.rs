//! Batch jobs as rows: the queue, and the outcome of each job.
//!
//! `queue` gives jobs to those that run them; here they are created, read and cancelled.

mod deliveries;
mod fetching;
mod folder;
mod queue;
mod rows;
mod space;
mod uploads;

use crate::tenant::Tenant;

use super::audit::note;
use super::page::rows_asked;
use super::pool::{reading, writing};
use super::{AuditEntry, Page, Store, StoreError};

pub(super) use deliveries::webhook_owner;
pub use deliveries::{DeliveryAttempt, DeliveryEnd, DueWebhook};
pub use queue::JobClaim;
pub use rows::{JobEnd, JobFilesRow, JobKey, JobProgress, JobRow, JobState, NewJob, WebhookState};
use rows::{RawJob, columns};
pub use uploads::JobUploadRow;

const PAGE_LIMIT: usize = 1_000;

macro_rules! select_jobs {
    ($condition:literal) => {
        concat!("SELECT ", columns!(), " FROM jobs ", $condition)
    };
}

const NAMED_JOB: &str = select_jobs!("WHERE tenant = $1 AND request_name = $2");

impl Store {
    /// Queues a job. Returns it, and whether it is new: if the tenant already has a job with this
    /// idempotency key, that job is returned.
    ///
    /// # Errors
    /// The database fails.
    pub async fn create_job(&self, new: &NewJob) -> Result<(JobRow, bool), StoreError> {
        // The message is due as soon as the job has ended.
        let webhook = new.webhook_secret.as_ref().map(|_| (WebhookState::Waiting, 0));
        let owner = webhook_owner(&new.id);
        let sealed = new.webhook_secret.as_ref().map(|secret| self.secrets.seal(&owner, secret));
        let (secret, secret_key) = sealed.map(|stored| (stored.text, stored.key)).unzip();
        let created: Result<Option<RawJob>, _> = writing!(&self.pool, pool => {
            let sql = concat!(
                "INSERT INTO jobs (id, state, request, request_hash, request_name, ",
                "created_unix_ms, tenant, webhook_secret, webhook_state, webhook_due_unix_ms, ",
                "unfetched, webhook_secret_key) ",
                "VALUES ($1, 'QUEUED', $2, $3, $4, $5, $6, $7, $8, $9, $10, $11) ",
                "ON CONFLICT (tenant, request_name) DO NOTHING RETURNING ",
                columns!()
            );
            sqlx::query_as(sql)
                .bind(&new.id)
                .bind(&new.request)
                .bind(&new.request_hash)
                .bind(&new.idempotency_key)
                .bind(new.created_unix_ms)
                .bind(new.tenant.name())
                .bind(&secret)
                .bind(webhook.map(|(state, _)| state.name()))
                .bind(webhook.map(|(_, due_unix_ms)| due_unix_ms))
                .bind(i64::from(new.is_unfetched))
                .bind(secret_key.as_ref().and_then(Option::as_ref))
                .fetch_optional(pool)
                .await
        });
        if let Some(row) = created.map_err(StoreError::database("queueing a job"))? {
            return Ok((row.parse()?, true));
        }
        let before: Result<RawJob, _> = writing!(&self.pool, pool => {
            let select = sqlx::query_as(NAMED_JOB).bind(new.tenant.name());
            select.bind(&new.idempotency_key).fetch_one(pool).await
        });
        Ok((before.map_err(StoreError::database("reading a job"))?.parse()?, false))
    }

    /// The job that a tenant's request with this idempotency key has created, if it still exists.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub async fn job_created_by(
        &self,
        tenant: &Tenant,
        idempotency_key: &str,
    ) -> Result<Option<JobRow>, StoreError> {
        let row: Result<Option<RawJob>, _> = reading!(&self.pool, pool => {
            let select = sqlx::query_as(NAMED_JOB).bind(tenant.name());
            select.bind(idempotency_key).fetch_optional(pool).await
        });
        row.map_err(StoreError::database("reading a job"))?.map(RawJob::parse).transpose()
    }

    /// The job of a tenant with this id.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub async fn job(&self, tenant: &Tenant, id: &str) -> Result<Option<JobRow>, StoreError> {
        let row: Result<Option<RawJob>, _> = reading!(&self.pool, pool => {
            let select = sqlx::query_as(select_jobs!("WHERE id = $1 AND tenant = $2")).bind(id);
            select.bind(tenant.name()).fetch_optional(pool).await
        });
        row.map_err(StoreError::database("reading a job"))?.map(RawJob::parse).transpose()
    }

    /// A page of the jobs of a tenant: all, or those in one state.
    ///
    /// # Errors
    /// The page token or size is invalid, or the database fails.
    pub async fn jobs(
        &self,
        tenant: &Tenant,
        (state, oldest_first): (Option<JobState>, bool),
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<JobRow>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let beside = match page_token {
            None => {
                if oldest_first {
                    i64::MIN
                } else {
                    i64::MAX
                }
            }
            Some(id) => {
                let row = self.job(tenant, id).await?;
                row.ok_or_else(|| StoreError::PageToken { token: id.to_owned() })?.key.0
            }
        };
        let rows: Result<Vec<RawJob>, _> = reading!(list &self.pool, pool => {
            let sql = match oldest_first {
                true => select_jobs!(
                    "WHERE tenant = $1 AND $2 < key AND ($4 = '' OR state = $4) \
                     ORDER BY key LIMIT $3"
                ),
                false => select_jobs!(
                    "WHERE tenant = $1 AND key < $2 AND ($4 = '' OR state = $4) \
                     ORDER BY key DESC LIMIT $3"
                ),
            };
            let select = sqlx::query_as(sql).bind(tenant.name()).bind(beside).bind(rows_asked);
            select.bind(state.map_or("", JobState::name)).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("listing jobs"))?;
        Page::of(rows, page_size, |row| row.id.clone()).try_map(RawJob::parse)
    }

    /// Number of jobs that wait or run.
    ///
    /// # Errors
    /// The database fails.
    pub async fn waiting_jobs(&self) -> Result<u64, StoreError> {
        let count: Result<i64, _> = reading!(&self.pool, pool => {
            let sql = "SELECT COUNT(*) FROM jobs WHERE ended_unix_ms IS NULL";
            sqlx::query_scalar(sql).fetch_one(pool).await
        });
        count.map(|count| count as u64).map_err(StoreError::database("counting jobs"))
    }

    /// Ends a job of a tenant that waits or runs as cancelled; false if it has ended or does not
    /// exist. Its claim ends, too.
    ///
    /// # Errors
    /// The database fails.
    pub async fn cancel_job(
        &self,
        tenant: &Tenant,
        id: &str,
        now_unix_ms: i64,
    ) -> Result<bool, StoreError> {
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET state = 'CANCELLED', ended_unix_ms = $2, fence = fence + 1
                       WHERE id = $1 AND tenant = $3 AND ended_unix_ms IS NULL";
            let cancel = sqlx::query(sql).bind(id).bind(now_unix_ms).bind(tenant.name());
            let done = cancel.execute(pool).await;
            done.map(|done| done.rows_affected())
        });
        changed.map(|rows| rows == 1).map_err(StoreError::database("cancelling a job"))
    }

    /// Deletes jobs that ended before a time.
    ///
    /// # Errors
    /// The database fails.
    pub async fn delete_jobs(&self, ended_before_unix_ms: i64) -> Result<u64, StoreError> {
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "DELETE FROM jobs WHERE ended_unix_ms < $1";
            let done = sqlx::query(sql).bind(ended_before_unix_ms).execute(pool).await;
            done.map(|done| done.rows_affected())
        });
        changed.map_err(StoreError::database("deleting jobs"))
    }

    /// Deletes a job of a tenant that has ended, and notes it with `entry`; false if there is no
    /// such job.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn delete_job(
        &self,
        tenant: &Tenant,
        id: &str,
        entry: &AuditEntry,
    ) -> Result<bool, StoreError> {
        let deleted: Result<bool, sqlx::Error> = writing!(&self.pool, pool => {
            let delete = async {
                let mut transaction = pool.begin().await?;
                let sql = "DELETE FROM jobs WHERE id = $1 AND tenant = $2
                           AND ended_unix_ms IS NOT NULL";
                let delete = sqlx::query(sql).bind(id).bind(tenant.name());
                let is_done = delete.execute(&mut *transaction).await?.rows_affected() == 1;
                if is_done {
                    note!(self, transaction, entry);
                }
                transaction.commit().await.map(|()| is_done)
            };
            delete.await
        });
        deleted.map_err(StoreError::database("deleting a job"))
    }

    /// The files in the folder of jobs that each job names.
    ///
    /// # Errors
    /// The database fails.
    pub async fn job_files(&self) -> Result<Vec<JobFilesRow>, StoreError> {
        let rows: Result<Vec<JobFilesRow>, _> = reading!(bulk &self.pool, pool => {
            let sql = "SELECT id, request, result, fence, ended_unix_ms IS NOT NULL AS is_ended
                       FROM jobs";
            sqlx::query_as(sql).fetch_all(pool).await
        });
        rows.map_err(StoreError::database("reading the files of jobs"))
    }
}
