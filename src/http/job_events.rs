//! `/v1/jobs/{job}/events`: server-sent events.

use std::convert::Infallible;

use axum::extract::Path;
use axum::response::Sse;
use axum::response::sse::Event;
use futures::Stream;

use crate::contract::{Caller, calls, v1};

use super::problem::Refused;
use super::watch;

/// Sends a job as it changes, as server-sent events.
///
/// Each event `job` has the job, the first one at once. The last event is `ended` with the job if
/// it has ended, or `end` with a problem document that says why the events end before.
#[utoipa::path(get, operation_id = "jobsWatch",
    path = "/v1/jobs/{job}/events", tag = "Jobs",
    params(("job" = String, Path, description = "Its id")),
    responses((status = 200, description = "Events with the job",
        body = v1::Job, content_type = "text/event-stream"),
        Refused))]
pub(super) async fn events(
    caller: Caller,
    Path(job): Path<String>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Refused> {
    let messages = calls::job_watch::watch(&caller, v1::GetJobRequest { job }).await?;
    Ok(watch::events(messages, |job| {
        let name = if job.ended_utc.is_empty() { "job" } else { "ended" };
        watch::named(name, &job)
    }))
}
