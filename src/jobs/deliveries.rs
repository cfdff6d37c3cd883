//! The task that informs webhooks of the ends of jobs.
//!
//! Each attempt has a row before it is made. A message is delivered at least once: if the service
//! stops during an attempt, the outcome is unknown, and another attempt follows.
//!
//! Messages are due by the clock of the database, which all nodes share. A step of this clock gives
//! no message up: its age is counted like that of all that expires. Nor does it delay one for long:
//! a message that is due later than any delay allows is due at once.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::{Id, JoinSet};
use tokio::time::{MissedTickBehavior, interval};

use crate::config::JobsConfiguration;
use crate::feeds::{Backoff, Connector, WebError, post};
use crate::refusal::Code;
use crate::store::{DeliveryAttempt, DeliveryEnd, DueWebhook, StoreError};
use crate::tenant::Tenant;

use super::JobError;
use super::info::JobInfo;
use super::message::Message;
use super::state::Desk;
use super::webhook::WebhookSecret;

/// Interval at which the store is asked for messages that are due.
const ASK: Duration = Duration::from_secs(1);
/// Most attempts at the same time, and most of them for one tenant.
const ATTEMPTS: usize = 8;
const OF_TENANT: usize = 2;
/// Longest delay between two attempts, unless the host asks for a longer one.
const DELAY_CEILING: Duration = Duration::from_secs(3600);
/// Longest delay if the host asks for one (ms): twice the longest that it can ask for
/// ([`Backoff::next`]).
const LONGEST_DELAY_MS: i64 = 2 * 3_600_000;
/// Time after which an attempt without an end is followed by another (ms). It is longer than an
/// attempt takes.
const FORGOTTEN_MS: i64 = 120_000;
const MS_PER_HOUR: i64 = 3_600_000;
/// Status of a host that wants no further attempt (RFC 9110, 15.5.11).
const GONE: u16 = 410;

/// Delivers messages until the service stops. It waits for the attempts that have begun.
pub(super) async fn deliver(desk: Arc<Desk>) {
    let (mut attempts, mut busy) = (JoinSet::new(), HashMap::new());
    let mut look = interval(ASK);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while !desk.is_stopping() {
        tokio::select! {
            Some(ended) = attempts.join_next_with_id() => forget(ended, &mut busy),
            _ = look.tick() => {
                if let Err(error) = begin(&desk, &mut attempts, &mut busy).await {
                    tracing::warn!(%error, "webhooks are not told yet");
                }
            }
            () = desk.stopped() => {}
        }
    }
    while attempts.join_next().await.is_some() {}
}

fn forget(ended: Result<(Id, ()), tokio::task::JoinError>, busy: &mut HashMap<Id, Tenant>) {
    match ended {
        Ok((id, ())) => drop(busy.remove(&id)),
        Err(error) => {
            tracing::error!(%error, "a delivery failed");
            busy.remove(&error.id());
        }
    }
}

/// Begins as many attempts as are due and allowed.
async fn begin(
    desk: &Arc<Desk>,
    attempts: &mut JoinSet<()>,
    busy: &mut HashMap<Id, Tenant>,
) -> Result<(), StoreError> {
    let (store, limits) = (&desk.store, &desk.limits);
    let now = store.database_unix_ms().await?;
    store.correct_due_webhooks(now, now + LONGEST_DELAY_MS).await?;
    let tenants = store.tenants_with_due_webhooks(now).await?;
    if tenants.is_empty() {
        return Ok(());
    }
    let ended_before = store.expiry_time(now) - i64::from(limits.webhook_hours) * MS_PER_HOUR;
    store.give_up_webhooks(now, limits.webhook_attempts, ended_before).await?;
    for tenant in tenants {
        while busy.len() < ATTEMPTS
            && busy.values().filter(|other| **other == tenant).count() < OF_TENANT
        {
            let Some(due) = store.begin_delivery(&tenant, now, now + FORGOTTEN_MS).await? else {
                break;
            };
            let attempt = attempts.spawn(attempt(desk.clone(), due, now));
            busy.insert(attempt.id(), tenant.clone());
        }
    }
    Ok(())
}

/// Makes an attempt and stores its outcome.
async fn attempt(desk: Arc<Desk>, due: DueWebhook, begun_unix_ms: i64) {
    let begun = Instant::now();
    let DueWebhook { job, secret, attempt } = due;
    let connector = desk.connector.of(&job.tenant);
    let (key, id, ended) = (job.key, job.id.clone(), job.ended_unix_ms.unwrap_or(begun_unix_ms));
    let made = match JobInfo::of(job) {
        Ok(job) => sent(&connector, &job, &secret, begun_unix_ms).await,
        Err(error) => Made::failed(error.code(), error.to_string()),
    };
    let now = begun_unix_ms + begun.elapsed().as_millis() as i64;
    let age_ms = desk.store.expiry_time(now) - ended;
    let end = made.end(attempt, &desk.limits, (age_ms, now));
    let attempt = DeliveryAttempt {
        number: attempt,
        begun_unix_ms,
        ended_unix_ms: Some(now),
        http_status: made.http_status,
        failure: made.failure.map(|(code, message)| (code.name().to_owned(), message)),
    };
    // Err: the message is due again later.
    if let Err(error) = desk.store.end_delivery(key, &attempt, end).await {
        tracing::warn!(%error, job = %id, "the end of a delivery is not stored");
    }
    desk.changed();
}

/// The outcome of an attempt.
#[derive(Debug)]
struct Made {
    http_status: Option<u16>,
    failure: Option<(Code, String)>,
    retry_after: Option<Duration>,
}

impl Made {
    fn failed(code: Code, message: String) -> Self {
        Self { http_status: None, failure: Some((code, message)), retry_after: None }
    }

    /// What follows the attempt, which ended at `now` (ms since 1970-01-01 UTC). `age_ms` is the
    /// time since the end of the job (ms).
    fn end(
        &self,
        attempt: u32,
        limits: &JobsConfiguration,
        (age_ms, now): (i64, i64),
    ) -> DeliveryEnd {
        if self.failure.is_none() {
            return DeliveryEnd::Delivered;
        }
        let first = Duration::from_secs(limits.webhook_delay_s.min(DELAY_CEILING.as_secs()));
        let doubled = first.saturating_mul(1_u32.checked_shl(attempt - 1).unwrap_or(u32::MAX));
        let mut backoff = Backoff::new(doubled.min(DELAY_CEILING), DELAY_CEILING);
        let delay_ms = backoff.next(self.retry_after).as_millis() as i64;
        let longest_ms = i64::from(limits.webhook_hours) * MS_PER_HOUR;
        let is_last = limits.webhook_attempts <= attempt || longest_ms < age_ms + delay_ms;
        match is_last || self.http_status == Some(GONE) {
            true => DeliveryEnd::GivenUp,
            false => DeliveryEnd::Again { due_unix_ms: now + delay_ms },
        }
    }
}

/// Sends the message of a job.
async fn sent(connector: &Connector, job: &JobInfo, secret: &str, unix_ms: i64) -> Made {
    let secret = match WebhookSecret::parse(secret) {
        Ok(secret) => secret,
        Err(error) => return Made::failed(error.code(), error.to_string()),
    };
    let Message { url, fields, body } = match Message::of(job, &secret, unix_ms) {
        Ok(message) => message,
        Err(error) => return Made::failed(error.code(), error.to_string()),
    };
    let posted = match post(connector, &url, &fields, body).await {
        Ok(posted) => posted,
        Err(WebError::Slow { seconds }) => {
            let message = format!("the host did not answer within {seconds} s");
            return Made::failed(Code::HostSlow, message);
        }
        Err(error) => return Made::failed(error.code(), error.to_string()),
    };
    let failure = match posted.status {
        status if status.is_success() => None,
        status if status.is_redirection() => {
            let message = format!("the host redirects with {status}, which is not followed");
            Some((Code::HostRedirects, message))
        }
        status => Some((Code::HostRefuses, format!("the host answers {status}"))),
    };
    let http_status = Some(posted.status.as_u16());
    Made { http_status, failure, retry_after: posted.retry_after }
}

/// The stored attempts to inform the webhook of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Deliveries {
    /// The job.
    pub job: JobInfo,
    /// The attempts, in order.
    pub attempts: Vec<DeliveryAttempt>,
    /// When the next one is due (ms since 1970-01-01 UTC), if one follows and the job has ended.
    pub next_unix_ms: Option<i64>,
}

/// The attempts to inform the webhook of a job of a tenant.
///
/// # Errors
/// The tenant has no such job, or the store fails.
pub(super) async fn of_job(desk: &Desk, tenant: &Tenant, id: &str) -> Result<Deliveries, JobError> {
    let row = desk.store.job(tenant, id).await?;
    let row = row.ok_or_else(|| JobError::NotFound { id: id.to_owned() })?;
    let (attempts, due) = desk.store.deliveries(row.key).await?;
    let job = JobInfo::of(row)?;
    let next_unix_ms = due.filter(|_| job.state.is_end());
    Ok(Deliveries { job, attempts, next_unix_ms })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(retry_after: Option<Duration>, http_status: Option<u16>) -> Made {
        let failure = Some((Code::HostRefuses, String::new()));
        Made { http_status, failure, retry_after }
    }

    /// The delays double up to an hour. The number of attempts and their time are bounded.
    #[test]
    fn attempts_come_later_and_later_and_end() {
        let limits = JobsConfiguration::standard();
        let made = refused(None, None);
        for (attempt, most_ms) in [(1, 10_000), (2, 20_000), (5, 160_000), (11, 3_600_000)] {
            let end = made.end(attempt, &limits, (0, 1000));
            let DeliveryEnd::Again { due_unix_ms } = end else { panic!("{end:?}") };
            let delays = 1000 + most_ms / 2..=1000 + most_ms;
            assert!(delays.contains(&due_unix_ms), "{attempt}: {due_unix_ms}");
        }
        let day = 24 * MS_PER_HOUR;
        assert_eq!(made.end(12, &limits, (0, 1000)), DeliveryEnd::GivenUp);
        assert_eq!(made.end(1, &limits, (day, day)), DeliveryEnd::GivenUp);
        let asked = refused(Some(Duration::from_secs(600)), Some(503));
        let end = asked.end(1, &limits, (0, 0));
        assert!(
            matches!(end, DeliveryEnd::Again { due_unix_ms } if 600_000 <= due_unix_ms),
            "{end:?}"
        );
        assert_eq!(refused(None, Some(GONE)).end(1, &limits, (0, 0)), DeliveryEnd::GivenUp);
    }
}
