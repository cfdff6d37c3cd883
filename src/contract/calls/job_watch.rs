//! Watches of batch jobs: a job is sent at once and after each change, until it has ended.
//!
//! The desk wakes a watch when this process changes any job. Changes by other processes are read
//! from the store at an interval.

use std::time::Duration;

use futures::Stream;
use tokio::sync::watch;
use tokio::time::{Instant, sleep, sleep_until};

use crate::contract::places::Place;
use crate::contract::{Caller, Lease, Refusal, v1};
use crate::jobs::{JobError, JobId};

use super::jobs::{job_id, message};
use super::outlet::{Outlet, outlet};

/// Memory of a watch: its waiting messages (bytes).
const WATCH_BYTES: usize = 32 << 10;
/// Interval at which the store is read for changes by other processes.
const ASK: Duration = Duration::from_secs(1);
/// Shortest interval between two reads of the store.
pub(super) const PAUSE: Duration = Duration::from_millis(200);
/// Time after which an unchanged job is sent again, so that no proxy closes the watch as idle.
const KEEPALIVE: Duration = Duration::from_secs(15);

/// Watches a job. The first message is sent at once, the last one when the job has ended.
///
/// # Errors
/// The job does not exist, the service is stopping, or the limit of open watches is reached.
pub async fn watch(
    caller: &Caller,
    request: v1::GetJobRequest,
) -> Result<impl Stream<Item = Result<v1::Job, Refusal>> + Send + use<>, Refusal> {
    let id = job_id(&request.job)?;
    if caller.is_draining() {
        return Err(JobError::Draining.into());
    }
    let place = caller.watch_place()?;
    Lease::current().map_or(Ok(()), |lease| lease.reserve(WATCH_BYTES))?;
    caller.jobs().get(&id).await?;
    let (outlet, reader) = outlet(caller);
    Ok(reader.read(run(caller.clone(), id, outlet, place)))
}

/// Sends the job until it has ended or the reader disconnects.
async fn run(
    caller: Caller,
    id: JobId,
    outlet: Outlet<v1::Job>,
    _place: Place,
) -> Result<(), Refusal> {
    let mut drained = Box::pin(caller.drained());
    let mut changes = caller.jobs().changes();
    let (mut sent, mut sent_at) = (None, Instant::now());
    loop {
        changes.mark_unchanged();
        let pause_ends = Instant::now() + PAUSE;
        let job = caller.jobs().get(&id).await?;
        let message = message(&caller, &job);
        if job.state.is_end() {
            return outlet.send(message).await;
        }
        if sent.as_ref() != Some(&message) || KEEPALIVE <= sent_at.elapsed() {
            outlet.send(message.clone()).await?;
            (sent, sent_at) = (Some(message), Instant::now());
        }
        tokio::select! {
            () = changed(&mut changes, pause_ends) => {}
            () = &mut drained => return Err(JobError::Draining.into()),
            () = outlet.closed() => return Ok(()),
        }
    }
}

/// Waits until a job may have changed, but at least for the pause between two reads.
pub(super) async fn changed(changes: &mut watch::Receiver<u64>, pause_ends: Instant) {
    tokio::select! {
        // Err: the desk no longer exists, and the service drains.
        _ = changes.changed() => {}
        () = sleep(ASK) => {}
    }
    sleep_until(pause_ends).await;
}
