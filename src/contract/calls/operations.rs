//! Batch jobs as long-running operations, with the interface of `google.longrunning`.
//!
//! An operation is a job with the same id. Only gRPC has these calls; REST has `/v1/jobs`.

use std::pin::pin;
use std::time::Duration;

use tokio::time::{Instant, sleep_until};

use crate::contract::{Caller, Lease, Refusal, texts, v1};
use crate::jobs::{JobId, JobInfo};
use crate::refusal::Code;

use super::job_watch::{PAUSE, changed};
use super::jobs::{job_id, message, page, report_message};

/// Longest time that a call waits for the end of a job.
const WAIT_MAX: Duration = Duration::from_secs(60);
/// Memory of a call that waits (bytes).
const WAIT_BYTES: usize = 16 << 10;
/// Name of the call that deletes a job.
const DELETE: &str = "Operations.DeleteOperation";
/// The field that a filter compares.
const STATE: &str = "metadata.state";

/// A job and its outcome.
pub struct Operation {
    /// The job.
    pub job: v1::Job,
    /// Whether it has ended.
    pub is_done: bool,
    /// The report of a success.
    pub report: Option<v1::JobReport>,
}

impl Operation {
    fn of(caller: &Caller, job: &JobInfo) -> Self {
        let report = job.report.as_ref().map(|report| report_message(&job.id, report));
        Self { job: message(caller, job), is_done: job.state.is_end(), report }
    }
}

/// A job.
///
/// # Errors
/// The job does not exist.
pub async fn get(caller: &Caller, name: &str) -> Result<Operation, Refusal> {
    let job = caller.jobs().get(&named(name)?).await?;
    Ok(Operation::of(caller, &job))
}

/// A page of jobs, the newest first, and the token of the next page.
///
/// # Errors
/// The filter, the page token or the page size is invalid.
pub async fn list(
    caller: &Caller,
    filter: &str,
    page_size: i32,
    page_token: String,
) -> Result<(Vec<Operation>, String), Refusal> {
    let page_size = u32::try_from(page_size).map_err(|_| {
        let message = format!("{page_size} is not the size of a page");
        Refusal::new(Code::InvalidField, message).at("page_size")
    })?;
    let state = filtered_state(filter)?;
    let request = v1::ListJobsRequest { page_size, page_token, state, ..Default::default() };
    let (jobs, next_page_token) = page(caller, request).await?;
    Ok((jobs.iter().map(|job| Operation::of(caller, job)).collect(), next_page_token))
}

/// The state by which a filter selects; empty for an empty filter.
///
/// # Errors
/// The filter is not of the form `metadata.state = "RUNNING"`, quoted or not.
fn filtered_state(filter: &str) -> Result<String, Refusal> {
    if filter.trim().is_empty() {
        return Ok(String::new());
    }
    let state = filter.split_once('=').filter(|(name, _)| name.trim() == STATE);
    let state = state.map(|(_, value)| value.trim().trim_matches('"')).filter(|s| !s.is_empty());
    state.map(ToOwned::to_owned).ok_or_else(|| {
        let given = texts::brief(filter);
        let message = format!("{given:?} is not a condition such as {STATE} = \"RUNNING\"");
        Refusal::new(Code::InvalidField, message).at("filter")
    })
}

/// Ends a job that waits or runs. A job that has ended stays as it is.
///
/// # Errors
/// The job does not exist.
pub async fn cancel(caller: &Caller, name: &str) -> Result<(), Refusal> {
    caller.jobs().cancel(&named(name)?).await?;
    Ok(())
}

/// Deletes a job that has ended, with its result.
///
/// # Errors
/// The job does not exist, or has not ended.
pub async fn delete(caller: &Caller, name: &str) -> Result<(), Refusal> {
    let deleted = async {
        caller.jobs().delete(&named(name)?, (DELETE, &caller.author())).await?;
        Ok(())
    };
    caller.noted(DELETE, name, deleted.await).await
}

/// Waits until the job has ended, `timeout` has passed, or the service stops. Returns the job.
///
/// # Errors
/// The job does not exist, or the limit of open watches is reached.
pub async fn wait(
    caller: &Caller,
    name: &str,
    timeout: Option<Duration>,
) -> Result<Operation, Refusal> {
    let (id, jobs) = (named(name)?, caller.jobs());
    let until = Instant::now() + timeout.unwrap_or(WAIT_MAX).min(WAIT_MAX);
    let _place = caller.watch_place()?;
    Lease::current().map_or(Ok(()), |lease| lease.reserve(WAIT_BYTES))?;
    let mut drained = pin!(caller.drained());
    let (mut changes, mut is_over) = (jobs.changes(), caller.is_draining());
    loop {
        changes.mark_unchanged();
        let pause_ends = Instant::now() + PAUSE;
        let job = jobs.get(&id).await?;
        if job.state.is_end() || is_over || until <= Instant::now() {
            return Ok(Operation::of(caller, &job));
        }
        tokio::select! {
            () = changed(&mut changes, pause_ends) => {}
            () = sleep_until(until) => {}
            () = &mut drained => is_over = true,
        }
    }
}

/// The id of a job in the field `name`.
fn named(name: &str) -> Result<JobId, Refusal> {
    job_id(name).map_err(|refusal| refusal.at("name"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_names_a_state() {
        for (filter, state) in [
            ("", ""),
            ("  ", ""),
            ("metadata.state=RUNNING", "RUNNING"),
            (" metadata.state = \"FAILED\" ", "FAILED"),
        ] {
            assert_eq!(filtered_state(filter).unwrap(), state, "{filter:?}");
        }
        for filter in ["done=true", "RUNNING", "metadata.state=", "metadata.state", "=RUNNING"] {
            let refusal = filtered_state(filter).unwrap_err();
            assert_eq!(
                (refusal.code, refusal.field.as_deref()),
                (Code::InvalidField, Some("filter"))
            );
        }
    }
}
