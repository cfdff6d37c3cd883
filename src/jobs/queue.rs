//! The tasks of the queue. One kind claims a job, runs it, writes its heartbeat, and ends it;
//! others remove what has expired, and count the files.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::task::spawn_blocking;
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};

use crate::refusal::Code;
use crate::session::SessionError;
use crate::store::{JobClaim, JobEnd, JobRow, StoreError};
use crate::tenant::Tenant;

use super::JobError;
use super::error::EXPIRY;
use super::info::JobInfo;
use super::named::{Named, result_name};
use super::report::Failure;
use super::run::{Done, Ended, Run, failed};
use super::state::{Desk, Running};

/// Interval at which the queue is read, for jobs that another process has queued.
const ASK: Duration = Duration::from_secs(1);
/// Interval of heartbeats.
const BEAT: Duration = Duration::from_secs(1);
/// Number of lost claims after which a job fails, because the job itself may end the processes.
const LOST_CLAIMS: u64 = 5;
/// Interval at which the files are counted again, because other processes write them, too.
const COUNT: Duration = Duration::from_secs(30);
/// Delay after a failure of the database.
const RETRY: Duration = Duration::from_secs(1);
const MS_PER_HOUR: i64 = 3_600_000;

/// Runs jobs one after another until the process stops.
pub(super) async fn work(desk: Arc<Desk>) {
    let silent = Duration::from_secs(desk.limits.silent_s);
    while !desk.is_stopping() {
        match desk.store.claim_job(&desk.node, silent).await {
            Ok(Some(row)) => run(&desk, row).await,
            Ok(None) => wait(&desk, ASK).await,
            Err(error) => {
                tracing::warn!(%error, "no job can be claimed");
                wait(&desk, RETRY).await;
            }
        }
    }
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
    let (tenant, id) = (row.tenant.clone(), row.id.clone());
    let (claim, lost_claims) = (row.claim(), row.lost_claims);
    let running = desk.begin(&id);
    desk.changed();
    let name = result_name(&id, claim.fence);
    if let Ok(files) = desk.files() {
        files.remove_results_of_lost_claims(&id, claim.fence);
    }
    let ended = match lost_claims {
        LOST_CLAIMS.. => Err(Ended::Failed(Failure::of_lost_claims(lost_claims))),
        _ => match prepared(desk, row, &running, name.clone()).await {
            Ok(run) => computed(desk, run, &running, claim).await,
            Err(failure) => Err(Ended::Failed(failure)),
        },
    };
    if let Err(Ended::Failed(failure)) = &ended
        && failure.is_of_database()
        && let Some(delay) = desk.retries.delay(&id)
    {
        let message = &failure.message;
        tracing::warn!(job = %id, %message, "a job is queued again, as the database has failed");
        give_back(desk, (&id, claim)).await;
        desk.end(&id);
        desk.changed();
        // Err: the time has passed, and the process is not stopping.
        timeout(delay, desk.stopped()).await.ok();
        return;
    }
    let (end, bytes) = match ended {
        Ok(Done { bytes, report }) => {
            let report = serde_json::to_string(&report).expect("texts and numbers are JSON");
            (JobEnd::Succeeded { result: name.clone(), bytes, report }, Some(bytes))
        }
        Err(Ended::Failed(failure)) => {
            let failure = serde_json::to_string(&failure).expect("texts are JSON");
            (JobEnd::Failed { failure }, None)
        }
        Err(Ended::Stopped) => {
            // A claim that has ended cannot be returned. Err: the claim is lost by its missing
            // heartbeat.
            desk.store.return_job(claim).await.ok();
            return desk.end(&id);
        }
    };
    let is_ended = end_claim(desk, (&tenant, &id, claim), &end, &running).await;
    if let (Some(true), Ok(files)) = (is_ended, desk.files()) {
        files.remove_checkpoints(&id).await;
    }
    // If the claim was lost, the row of the job does not name this file. If that is unknown, the
    // file is removed once it is old.
    if let (Some(false), Some(bytes), Ok(files)) = (is_ended, bytes, desk.files()) {
        files.remove_result(&name, bytes).await;
    }
    desk.end(&id);
    desk.changed();
}

/// Queues a claimed job again; repeats until the database accepts it or the process stops.
async fn give_back(desk: &Desk, (id, claim): (&str, JobClaim)) {
    while let Err(error) = desk.store.return_job(claim).await {
        if desk.is_stopping() {
            return; // The claim is lost by its missing heartbeat.
        }
        tracing::warn!(%error, job = %id, "a job is not queued again yet");
        wait(desk, RETRY).await;
    }
}

/// Ends a claim; repeats until the database accepts it. Returns whether the claim has ended the
/// job; `None` if this is unknown, because the process stops.
async fn end_claim(
    desk: &Desk,
    (tenant, id, claim): (&Tenant, &str, JobClaim),
    end: &JobEnd,
    running: &Running,
) -> Option<bool> {
    let store = &desk.store;
    loop {
        let ending = async {
            let is_ended = store.beat_job(claim, running.progress(), running.cpu()).await?
                && store.end_job(claim, end, desk.arrival_time()).await?;
            // An earlier attempt may have ended the job although its answer was lost.
            Ok::<_, StoreError>(
                is_ended || store.job(tenant, id).await?.is_some_and(|job| job.was_ended_by(claim)),
            )
        };
        match ending.await {
            Ok(is_ended) => return Some(is_ended),
            Err(_) if desk.is_stopping() => return None,
            Err(error) => {
                tracing::warn!(%error, job = %id, "the end of a job is not stored yet");
                wait(desk, RETRY).await;
            }
        }
    }
}

/// The run of a claimed job.
async fn prepared(
    desk: &Arc<Desk>,
    row: JobRow,
    running: &Arc<Running>,
    result: String,
) -> Result<Run, Failure> {
    let (tenant, job) = (row.tenant.clone(), row.id.clone());
    let request = JobInfo::of(row).map_err(|error| failed(&error.into()))?.request;
    let stored = match &request.options.session {
        None => None,
        Some(_) => {
            let aiding = desk.aiding().await.map_err(SessionError::from);
            Some((desk.store.clone(), aiding.map_err(|error| Failure::of_session(&error))?))
        }
    };
    Ok(Run {
        plan: desk.plan(&request).map_err(|error| failed(&error))?,
        request,
        files: desk.files().map_err(|error| failed(&error))?.clone(),
        inputs: HashMap::new(),
        stored,
        lane: desk.lane.clone(),
        geoid: desk.geoid.clone(),
        tenant,
        running: running.clone(),
        job,
        result,
        longest: Duration::from_secs(desk.limits.run_s),
        checkpoint_interval: Duration::from_secs(desk.limits.checkpoint_s),
        unpacked_bytes: desk.limits.unpacked_bytes,
    })
}

/// Computes on a blocking thread, and writes heartbeats meanwhile.
async fn computed(
    desk: &Desk,
    run: Run,
    running: &Running,
    claim: JobClaim,
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
                match desk.store.beat_job(claim, running.progress(), running.cpu()).await {
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
    loop {
        // In a cluster only the leader does it.
        if desk.store.is_leader()
            && let Err(error) = remove_expired(&desk).await
        {
            tracing::warn!(%error, "expired jobs are not removed yet");
        }
        // Err: the time has passed, and the service is not stopping.
        if timeout(EXPIRY, stopping.wait_for(|stopping| *stopping)).await.is_ok() {
            return;
        }
    }
}

/// Counts the files at an interval until the process stops.
pub(super) async fn count(desk: Arc<Desk>) {
    let mut stopping = desk.stopping.subscribe();
    // Err: the time has passed, and the process is not stopping.
    while timeout(COUNT, stopping.wait_for(|stopping| *stopping)).await.is_err() {
        let Some(files) = desk.files.clone() else { return };
        if let Err(error) = files.count().await {
            tracing::warn!(%error, "the files of jobs cannot be counted");
        }
    }
}

/// Removes jobs that ended longer ago than they are kept, and files without a job.
///
/// # Errors
/// The store or the disk fails.
pub(super) async fn remove_expired(desk: &Desk) -> Result<(), JobError> {
    let kept = i64::from(desk.limits.keep_hours) * MS_PER_HOUR;
    let now = desk.store.expiry_time(desk.clock.unix_ms());
    desk.store.delete_jobs(now - kept).await?;
    desk.store.delete_expired_uploads(now).await?;
    let Some(files) = desk.files.clone() else { return Ok(()) };
    let named = Named::read(&desk.store).await?;
    files.remove_old(&named).await
}
