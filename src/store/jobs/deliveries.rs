//! Messages to the webhooks of jobs: which messages are due, and the outcome of each attempt.
//!
//! An attempt is written before it is made, together with the time of the next one. So if the
//! service stops during an attempt, the message becomes due again.

use crate::secrets::StoredSecret;
use crate::store::pool::{Pool, reading, writing};
use crate::store::{Store, StoreError};
use crate::tenant::Tenant;

use super::rows::{JobKey, JobRow, RawJob, WebhookState, columns};

/// A message whose attempt has begun.
#[derive(Clone, Debug)]
pub struct DueWebhook {
    /// The job, which has ended.
    pub job: JobRow,
    /// Secret that signs the message.
    pub secret: String,
    /// Number of the attempt, from 1.
    pub attempt: u32,
}

/// An attempt to deliver a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeliveryAttempt {
    /// Its number, from 1.
    pub number: u32,
    /// When it began (ms since 1970-01-01 UTC).
    pub begun_unix_ms: i64,
    /// When it ended; `None` while it is being made, or if the service stopped during it.
    pub ended_unix_ms: Option<i64>,
    /// Status of the host's answer, if there was one.
    pub http_status: Option<u16>,
    /// Stable code and message of its failure.
    pub failure: Option<(String, String)>,
}

/// What follows an attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeliveryEnd {
    /// Nothing: the host has taken the message.
    Delivered,
    /// Another attempt follows.
    Again {
        /// When the next attempt is due (ms since 1970-01-01 UTC).
        due_unix_ms: i64,
    },
    /// Nothing: the number of attempts is used up.
    GivenUp,
}

#[derive(sqlx::FromRow)]
struct RawDue {
    #[sqlx(flatten)]
    job: RawJob,
    webhook_secret: String,
    webhook_secret_key: Option<String>,
    webhook_attempts: i64,
}

#[derive(sqlx::FromRow)]
struct RawAttempt {
    number: i64,
    begun_unix_ms: i64,
    ended_unix_ms: Option<i64>,
    http_status: Option<i64>,
    code: Option<String>,
    message: Option<String>,
}

impl From<RawAttempt> for DeliveryAttempt {
    fn from(raw: RawAttempt) -> Self {
        Self {
            number: raw.number as u32,
            begun_unix_ms: raw.begun_unix_ms,
            ended_unix_ms: raw.ended_unix_ms,
            http_status: raw.http_status.map(|status| status as u16),
            failure: raw.code.zip(raw.message),
        }
    }
}

/// Name of the owner of a webhook's secret, so that it can be opened for this job only.
pub(in crate::store) fn webhook_owner(job: &str) -> String {
    format!("job {job}")
}

/// Attempts, and when the next one is due.
type Deliveries = (Vec<RawAttempt>, Option<Option<i64>>);

/// Takes the message of a tenant that has been due for longest.
macro_rules! take {
    ($lock:literal) => {
        concat!(
            "UPDATE jobs SET webhook_attempts = webhook_attempts + 1, webhook_due_unix_ms = $3 ",
            "WHERE key = (SELECT key FROM jobs WHERE webhook_due_unix_ms <= $2 AND tenant = $1 ",
            "AND ended_unix_ms IS NOT NULL ORDER BY webhook_due_unix_ms, key LIMIT 1",
            $lock,
            ") RETURNING webhook_secret, webhook_secret_key, webhook_attempts, ",
            columns!()
        )
    };
}

impl Store {
    /// The tenants with messages that are due, the one whose message has been due for longest
    /// first.
    ///
    /// # Errors
    /// The database fails.
    pub async fn tenants_with_due_webhooks(
        &self,
        now_unix_ms: i64,
    ) -> Result<Vec<Tenant>, StoreError> {
        let names: Result<Vec<String>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT tenant FROM jobs
                       WHERE webhook_due_unix_ms <= $1 AND ended_unix_ms IS NOT NULL
                       GROUP BY tenant ORDER BY MIN(webhook_due_unix_ms), tenant";
            sqlx::query_scalar(sql).bind(now_unix_ms).fetch_all(pool).await
        });
        let names = names.map_err(StoreError::database("reading whose webhooks are due"))?;
        Ok(names.iter().map(|name| Tenant::stored(name)).collect())
    }

    /// Begins an attempt to deliver that message of a tenant that has been due for longest. If the
    /// attempt is never ended, the message is due again at `again_unix_ms`.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub async fn begin_delivery(
        &self,
        tenant: &Tenant,
        now_unix_ms: i64,
        again_unix_ms: i64,
    ) -> Result<Option<DueWebhook>, StoreError> {
        let sql = match &self.pool {
            Pool::Sqlite { .. } => take!(""),
            Pool::Postgres { .. } => take!(" FOR UPDATE SKIP LOCKED"),
        };
        let begun: Result<Option<RawDue>, sqlx::Error> = writing!(&self.pool, pool => {
            let begin = async {
                let mut transaction = pool.begin().await?;
                let take = sqlx::query_as(sql).bind(tenant.name()).bind(now_unix_ms);
                let due = take.bind(again_unix_ms).fetch_optional(&mut *transaction).await?;
                if let Some(RawDue { job, webhook_attempts, .. }) = &due {
                    let sql = "INSERT INTO job_deliveries (job, number, begun_unix_ms)
                               VALUES ($1, $2, $3)";
                    let insert = sqlx::query(sql).bind(job.key).bind(webhook_attempts);
                    insert.bind(now_unix_ms).execute(&mut *transaction).await?;
                }
                transaction.commit().await.map(|()| due)
            };
            begin.await
        });
        let begun = begun.map_err(StoreError::database("beginning a delivery"))?;
        let Some(due) = begun else { return Ok(None) };
        let stored = StoredSecret { text: due.webhook_secret, key: due.webhook_secret_key };
        let (job, attempt) = (due.job.parse()?, due.webhook_attempts as u32);
        let secret = self.secrets.unseal(&webhook_owner(&job.id), &stored)?;
        Ok(Some(DueWebhook { job, secret, attempt }))
    }

    /// Ends an attempt. It changes the message only if no further attempt has begun.
    ///
    /// # Errors
    /// The database fails.
    pub async fn end_delivery(
        &self,
        key: JobKey,
        attempt: &DeliveryAttempt,
        end: DeliveryEnd,
    ) -> Result<(), StoreError> {
        let number = i64::from(attempt.number);
        let (state, due_unix_ms) = match end {
            DeliveryEnd::Delivered => (WebhookState::Delivered, None),
            DeliveryEnd::Again { due_unix_ms } => (WebhookState::Waiting, Some(due_unix_ms)),
            DeliveryEnd::GivenUp => (WebhookState::Failed, None),
        };
        let ended: Result<(), sqlx::Error> = writing!(&self.pool, pool => {
            let end = async {
                let mut transaction = pool.begin().await?;
                let sql = "UPDATE job_deliveries SET ended_unix_ms = $3, http_status = $4,
                           code = $5, message = $6 WHERE job = $1 AND number = $2";
                sqlx::query(sql)
                    .bind(key.0)
                    .bind(number)
                    .bind(attempt.ended_unix_ms)
                    .bind(attempt.http_status.map(i64::from))
                    .bind(attempt.failure.as_ref().map(|(code, _)| code))
                    .bind(attempt.failure.as_ref().map(|(_, message)| message))
                    .execute(&mut *transaction)
                    .await?;
                let sql = "UPDATE jobs SET webhook_state = $3, webhook_due_unix_ms = $4
                           WHERE key = $1 AND webhook_attempts = $2";
                let change = sqlx::query(sql).bind(key.0).bind(number).bind(state.name());
                change.bind(due_unix_ms).execute(&mut *transaction).await?;
                transaction.commit().await
            };
            end.await
        });
        ended.map_err(StoreError::database("ending a delivery"))
    }

    /// Gives up due messages that have had `attempts` attempts, or at least one attempt and whose
    /// job ended before `ended_before_unix_ms`. Returns their number.
    ///
    /// # Errors
    /// The database fails.
    pub async fn give_up_webhooks(
        &self,
        now_unix_ms: i64,
        attempts: u32,
        ended_before_unix_ms: i64,
    ) -> Result<u64, StoreError> {
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET webhook_state = 'FAILED', webhook_due_unix_ms = NULL
                       WHERE webhook_due_unix_ms <= $1 AND (webhook_attempts >= $2
                       OR webhook_attempts > 0 AND ended_unix_ms < $3)";
            let give_up = sqlx::query(sql).bind(now_unix_ms).bind(i64::from(attempts));
            let done = give_up.bind(ended_before_unix_ms).execute(pool).await;
            done.map(|done| done.rows_affected())
        });
        changed.map_err(StoreError::database("giving messages to webhooks up"))
    }

    /// Makes messages due now that are due after `latest_unix_ms`, because the clock was ahead when
    /// their times were stored. Returns their number.
    ///
    /// # Errors
    /// The database fails.
    pub async fn correct_due_webhooks(
        &self,
        now_unix_ms: i64,
        latest_unix_ms: i64,
    ) -> Result<u64, StoreError> {
        let is_any: Result<bool, _> = reading!(&self.pool, pool => {
            let sql = "SELECT EXISTS (SELECT 1 FROM jobs WHERE webhook_due_unix_ms > $1)";
            sqlx::query_scalar(sql).bind(latest_unix_ms).fetch_one(pool).await
        });
        if !is_any.map_err(StoreError::database("reading when webhooks are due"))? {
            return Ok(0);
        }
        let changed: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "UPDATE jobs SET webhook_due_unix_ms = $1 WHERE webhook_due_unix_ms > $2";
            let correct = sqlx::query(sql).bind(now_unix_ms).bind(latest_unix_ms);
            correct.execute(pool).await.map(|done| done.rows_affected())
        });
        changed.map_err(StoreError::database("correcting when webhooks are due"))
    }

    /// The attempts to deliver the message of a job, in order, and when the next one is due (ms
    /// since 1970-01-01 UTC).
    ///
    /// # Errors
    /// The database fails.
    pub async fn deliveries(
        &self,
        key: JobKey,
    ) -> Result<(Vec<DeliveryAttempt>, Option<i64>), StoreError> {
        let read: Result<Deliveries, sqlx::Error> = reading!(&self.pool, pool => {
            let sql = "SELECT number, begun_unix_ms, ended_unix_ms, http_status, code, message
                       FROM job_deliveries WHERE job = $1 ORDER BY number";
            let attempts = sqlx::query_as(sql).bind(key.0).fetch_all(pool).await;
            let sql = "SELECT webhook_due_unix_ms FROM jobs WHERE key = $1";
            let due = sqlx::query_scalar(sql).bind(key.0).fetch_optional(pool).await;
            attempts.and_then(|attempts| Ok((attempts, due?)))
        });
        let (attempts, due) = read.map_err(StoreError::database("reading deliveries"))?;
        Ok((attempts.into_iter().map(DeliveryAttempt::from).collect(), due.flatten()))
    }
}
