//! The attempts to inform the webhook of a batch job of its end.

use crate::contract::{Caller, Refusal, v1};
use crate::store::{DeliveryAttempt, WebhookState};

use super::jobs::{delivery_state, job_id};
use super::{timestamp, utc};

/// The attempts to inform the webhook of a job of its end.
///
/// # Errors
/// The job does not exist.
pub async fn list(
    caller: &Caller,
    request: v1::GetJobRequest,
) -> Result<v1::JobDeliveries, Refusal> {
    let deliveries = caller.jobs().deliveries(&job_id(&request.job)?).await?;
    Ok(v1::JobDeliveries {
        job: deliveries.job.id.to_string(),
        url: deliveries.job.request.options.webhook.unwrap_or_default(),
        state: deliveries.job.webhook_state.map_or("", WebhookState::name).to_owned(),
        deliveries: deliveries.attempts.iter().map(delivery).collect(),
        next_utc: deliveries.next_unix_ms.map(utc).unwrap_or_default(),
        delivery_state: delivery_state(deliveries.job.webhook_state),
        next_time: deliveries.next_unix_ms.and_then(timestamp),
    })
}

fn delivery(attempt: &DeliveryAttempt) -> v1::JobDelivery {
    let (code, message) = attempt.failure.clone().unwrap_or_default();
    v1::JobDelivery {
        attempt: attempt.number,
        begun_utc: utc(attempt.begun_unix_ms),
        ended_utc: attempt.ended_unix_ms.map(utc).unwrap_or_default(),
        http_status: attempt.http_status.map(u32::from),
        code,
        message,
        begin_time: timestamp(attempt.begun_unix_ms),
        end_time: attempt.ended_unix_ms.and_then(timestamp),
    }
}
