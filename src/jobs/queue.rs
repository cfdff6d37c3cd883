//! The tasks of the queue: each claims a job, runs it, writes its heartbeat, and ends it; one more
//! removes what has expired.

use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::task::spawn_blocking;
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

use crate::refusal::Code;
use crate::store::{JobEnd, JobKey, JobRow, StoreError};
use crate::tenant::Tenant;

use super::JobError;
use super::info::JobInfo;
use super::report::Failure;
use super::run::{Done, Ended, Run, failed};
use super::state::{Desk, Running, named_files};

/// Interval at which the queue is asked for jobs of which no one told.
const ASK: Duration = Duration::from_secs(5);
/// Interval of heartbeats, and time without one after which a job may be claimed by another.
const BEAT: Duration = Duration::from_secs(1);
const SILENT: Duration = Duration::from_secs(60);
/// Delay after a failure of the database.
const RETRY: Duration = Duration::from_secs(1);
/// Interval at which expired jobs are removed.
const EXPIRY: Duration = Duration::from_secs(600);
const MS_PER_HOUR: i64 = 3_600_000;

/// Runs jobs one after another until the service stops.
pub(super) async fn work(desk: Arc<Desk>) {
    while !desk.is_stopping() {
        match claimed(&desk).await {
            Ok(Some(row)) => {
                let tenant = row.tenant.clone();
                run(&desk, row).await;
                desk.turns.lock().await.end(&tenant);
            }
            Ok(None) => wait(&desk, ASK).await,
            Err(error) => {
                tracing::warn!(%error, "no job can be claimed");
                wait(&desk, RETRY).await;
            }
        }
    }
}

/// Claims the oldest job of the tenant that comes next.
async fn claimed(desk: &Desk) -> Result<Option<JobRow>, StoreError> {
    let mut turns = desk.turns.lock().await;
    let now = desk.clock.unix_ms();
    let silent = now - SILENT.as_millis() as i64;
    let waiting = desk.store.tenants_with_jobs(silent).await?;
    let used_s = |tenant: &Tenant| desk.lane.used_s(tenant);
    let Some(tenant) = turns.next(&waiting, used_s) else { return Ok(None) };
    let claimed = desk.store.claim_job(&tenant, &desk.node, now, silent).await;
    if !matches!(claimed, Ok(Some(_))) {
        turns.end(&tenant);
    }
    claimed
}

/// Waits for a new job, for the end of the service, or for `longest`.
async fn wait(desk: &Desk, longest: Duration) {
    let mut stopping = desk.stopping.subscribe();
    tokio::select! {
        () = desk.queued.notified() => {}
        // Err: the desk no longer exists.
        _ = stopping.wait_for(|stopping| *stopping) => {}
        () = sleep(longest) => {}
    }
}

/// Runs a claimed job and ends it.
async fn run(desk: &Arc<Desk>, row: JobRow) {
    let (key, id, fence) = (row.key, row.id.clone(), row.fence);
    let running = desk.begin(&id);
    desk.changed();
    let name = format!("{id}.{fence}");
    let ended = match prepared(desk, row, &running, name.clone()) {
        Ok(run) => computed(desk, run, &running, (key, fence)).await,
        Err(failure) => Err(Ended::Failed(failure)),
    };
    let (end, bytes) = match ended {
        Ok(Done { bytes, report }) => {
            let report = serde_json::to_string(&report).expect("texts and numbers are JSON");
            (JobEnd::Succeeded { result: name.clone(), bytes, report }, Some(bytes))
        }
        Err(Ended::Failed(failure)) => {
            let failure = serde_json::to_string(&failure).expect("texts are JSON");
            (JobEnd::Failed { failure }, None)
        }
        Err(Ended::Stopped) => return desk.end(&id),
    };
    let is_ended = loop {
        let (progress, now) = (running.progress(), desk.clock.unix_ms());
        match desk.store.end_job(key, fence, &end, progress, now).await {
            Ok(is_ended) => break Some(is_ended),
            Err(_) if desk.is_stopping() => break None,
            Err(error) => {
                tracing::warn!(%error, job = %id, "the end of a job is not stored yet");
                wait(desk, RETRY).await;
            }
        }
    };
    // Whoever has ended the job before does not name this file. If nobody knows, it stays until the
    // next start.
    if let (Some(false), Some(bytes), Ok(files)) = (is_ended, bytes, desk.files()) {
        files.remove_result(&name, bytes);
    }
    desk.end(&id);
    desk.changed();
}

/// The run of a claimed job.
fn prepared(
    desk: &Arc<Desk>,
    row: JobRow,
    running: &Arc<Running>,
    result: String,
) -> Result<Run, Failure> {
    let tenant = row.tenant.clone();
    let request = JobInfo::of(row).map_err(|error| failed(&error.into()))?.request;
    Ok(Run {
        plan: desk.plan(&request).map_err(|error| failed(&error))?,
        request,
        files: desk.files().map_err(|error| failed(&error))?.clone(),
        stored: (desk.store.clone(), desk.aiding.clone()),
        lane: desk.lane.clone(),
        geoid: desk.geoid.clone(),
        tenant,
        running: running.clone(),
        result,
        longest: Duration::from_secs(desk.limits.run_s),
        unpacked_bytes: desk.limits.unpacked_bytes,
    })
}

/// Computes on a blocking thread, with a heartbeat meanwhile.
async fn computed(
    desk: &Desk,
    run: Run,
    running: &Running,
    (key, fence): (JobKey, i64),
) -> Result<Done, Ended> {
    let runtime = Handle::current();
    let mut computing = spawn_blocking(move || run.compute(&runtime));
    let mut beat = interval(BEAT);
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            done = &mut computing => return done.unwrap_or_else(|error| {
                let message = format!("the computation failed: {error}");
                Err(Failure::new(Code::EstimatorFailed, message, None).into())
            }),
            _ = beat.tick() => {
                let (progress, now) = (running.progress(), desk.clock.unix_ms());
                match desk.store.beat_job(key, fence, progress, now).await {
                    Ok(true) => desk.changed(),
                    Ok(false) => running.stop(),
                    Err(_) => {} // A later beat tells.
                }
            }
        }
    }
}

/// Removes expired jobs and their files until the service stops.
pub(super) async fn expire(desk: Arc<Desk>) {
    let mut stopping = desk.stopping.subscribe();
    // Err: the time has passed, and the service is not stopping.
    while timeout(EXPIRY, stopping.wait_for(|stopping| *stopping)).await.is_err() {
        if let Err(error) = remove_expired(&desk).await {
            tracing::warn!(%error, "expired jobs are not removed yet");
        }
    }
}

/// Removes jobs that ended longer ago than they are kept, and files without a job.
///
/// # Errors
/// The store or the disk fails.
pub(super) async fn remove_expired(desk: &Desk) -> Result<(), JobError> {
    let kept = i64::from(desk.limits.keep_hours) * MS_PER_HOUR;
    desk.store.delete_jobs(desk.clock.unix_ms() - kept).await?;
    let Some(files) = desk.files.clone() else { return Ok(()) };
    let named = named_files(&desk.store).await?;
    let removed = spawn_blocking(move || files.remove_old(&named)).await;
    let removed = removed.unwrap_or_else(|error| Err(std::io::Error::other(error)));
    removed.map_err(JobError::disk("removing files of expired jobs"))
}
