//! The task that fetches the inputs of jobs that are given as URLs, and adds ephemerides and a base
//! of the service. A job waits until all inputs are stored.
//!
//! Its row is not changed before all inputs are stored: after a restart, and after a failure of the
//! database, they are fetched again.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::mpsc;
use tokio::task::{Id, JoinSet};
use tokio::time::{MissedTickBehavior, interval, sleep};

use crate::feeds::{Attempts, Connector, Url, WebError, download};
use crate::refusal::Code;
use crate::store::JobRow;
use crate::tenant::Tenant;

use super::JobError;
use super::arriving::{ArrivingFile, Upload};
use super::files::StoredFile;
use super::info::JobInfo;
use super::own::Adding;
use super::report::Failure;
use super::request::{JobInput, JobRequest, Part};
use super::state::{Desk, Running, unless_stopped};

/// Interval at which the store is asked for jobs whose inputs are to be fetched.
const ASK: Duration = Duration::from_secs(1);
/// A fetch that has begun.
struct Fetch {
    tenant: Tenant,
    job: String,
    running: Arc<Running>,
}

/// Most jobs whose inputs are fetched at the same time, and most of them of one tenant.
const FETCHES: usize = 4;
const OF_TENANT: usize = 2;
/// Most chunks between the host and the disk.
const CHUNKS: usize = 4;
/// Longest name of an input (characters).
const NAME_MAX: usize = 200;

/// Fetches inputs until the service stops.
pub(super) async fn fetch(desk: Arc<Desk>) {
    let (mut fetches, mut busy) = (JoinSet::new(), HashMap::new());
    let mut look = interval(ASK);
    look.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while !desk.is_stopping() {
        tokio::select! {
            Some(ended) = fetches.join_next_with_id() => {
                let id = ended.map_or_else(|error| error.id(), |(id, ())| id);
                busy.remove(&id);
                begin(&desk, &mut fetches, &mut busy).await;
            }
            () = desk.unfetched.notified() => begin(&desk, &mut fetches, &mut busy).await,
            _ = look.tick() => begin(&desk, &mut fetches, &mut busy).await,
            () = desk.stopped() => {}
        }
    }
    while fetches.join_next().await.is_some() {}
}

/// Begins to fetch the inputs of as many jobs as allowed.
async fn begin(desk: &Arc<Desk>, fetches: &mut JoinSet<()>, busy: &mut HashMap<Id, Fetch>) {
    if !desk.store.is_leader() {
        return; // The node that leads fetches for all.
    }
    let rows = match desk.store.unfetched_jobs().await {
        Ok(rows) => rows,
        Err(error) => return tracing::warn!(%error, "inputs of jobs are not fetched yet"),
    };
    for fetch in busy.values().filter(|fetch| !rows.iter().any(|row| row.id == fetch.job)) {
        fetch.running.stop(); // Another node has cancelled it, or it is over.
    }
    for row in rows {
        let of_tenant = busy.values().filter(|fetch| fetch.tenant == row.tenant).count();
        let is_begun = busy.values().any(|fetch| fetch.job == row.id);
        if is_begun || OF_TENANT <= of_tenant || FETCHES <= busy.len() {
            continue;
        }
        let (tenant, job, running) = (row.tenant.clone(), row.id.clone(), desk.begin(&row.id));
        let fetching = fetches.spawn(of_job(desk.clone(), row, running.clone()));
        busy.insert(fetching.id(), Fetch { tenant, job, running });
    }
}

/// Fetches the inputs of a job. Then the job can be claimed, or it fails.
async fn of_job(desk: Arc<Desk>, row: JobRow, running: Arc<Running>) {
    let (key, id) = (row.key, row.id.clone());
    let fetched = inputs(&desk, row, &running).await;
    if let Err(failure) = &fetched
        && failure.is_of_database()
        && let Some(delay) = desk.retries.delay(&id)
    {
        let message = &failure.message;
        tracing::warn!(job = %id, %message, "inputs are fetched again, as the database has failed");
        // None: the job was cancelled, or the service stops.
        unless_stopped(&running, sleep(delay)).await;
        return desk.end(&id);
    }
    desk.end(&id);
    let stored = match fetched {
        Ok(Some((request, _files))) => {
            let stored = desk.store.fetched_job(key, &request.to_json()).await;
            desk.queued.notify_one();
            stored
        }
        Ok(None) => return, // Cancelled, or fetched again after the next start.
        Err(failure) => {
            let failure = serde_json::to_string(&failure).expect("texts are JSON");
            desk.store.fail_unfetched_job(key, &failure, desk.arrival_time()).await
        }
    };
    // Err: its inputs will be fetched again.
    if let Err(error) = stored {
        tracing::warn!(%error, job = %id, "that the inputs of a job are fetched is not stored");
    }
    desk.changed();
}

/// The request with the files of all inputs; `None` if the job is stopped.
async fn inputs(
    desk: &Desk,
    row: JobRow,
    running: &Arc<Running>,
) -> Result<Option<(JobRequest, Vec<StoredFile>)>, Failure> {
    let (tenant, running) = (row.tenant.clone(), running.clone());
    let (connector, allowance) = (desk.connector.of(&tenant), desk.allowance(&tenant).await);
    let refused = |error: &JobError, part| Failure::new(error.code(), error.to_string(), part);
    let mut request = JobInfo::of(row).map_err(|error| refused(&error.into(), None))?.request;
    let files = desk.files().map_err(|error| refused(&error, None))?;
    let allowance = allowance.map_err(|error| refused(&error, None))?;
    let (mut upload, mut stored) = (Upload::fetch_to(files, allowance), Vec::new());
    for input in request.inputs.iter_mut().filter(|input| input.is_unfetched()) {
        let part = Some(input.part.name());
        let fetching = tried((desk, &connector), &mut upload, input, &running);
        let failed = |error: Unfetched| Failure::of_fetching(error.code(), error.text(), part);
        match fetching.await.map_err(failed)? {
            None => return Ok(None),
            Some(file) => {
                (input.hash, input.bytes) = (file.hash.clone(), file.bytes);
                stored.push(file);
            }
        }
    }
    let adding = Adding { desk, tenant, running, upload: &mut upload };
    let Some(added) = adding.add(&mut request).await? else { return Ok(None) };
    stored.extend(added);
    Ok(Some((request, stored)))
}

/// Why a file was not fetched.
enum Unfetched {
    Web(WebError),
    Job(JobError),
}

impl Unfetched {
    fn code(&self) -> Code {
        match self {
            Self::Web(error) => error.code(),
            Self::Job(error) => error.code(),
        }
    }

    fn text(&self) -> String {
        match self {
            Self::Web(error) => error.to_string(),
            Self::Job(error) => error.to_string(),
        }
    }

    /// The delay before the next attempt; `None` after the last attempt.
    fn delay(&self, attempts: &mut Attempts) -> Option<Duration> {
        match self {
            Self::Web(error) => attempts.delay_after(error),
            Self::Job(_) => None,
        }
    }
}

/// Fetches a file, with several attempts; `None` if the job is stopped.
async fn tried(
    (desk, connector): (&Desk, &Connector),
    upload: &mut Upload,
    input: &JobInput,
    running: &Running,
) -> Result<Option<StoredFile>, Unfetched> {
    let mut attempts = Attempts::new();
    let text = input.url.as_deref().unwrap_or_default();
    let url: Url = text.parse().map_err(|error| Unfetched::Web(WebError::Fetch(error)))?;
    let longest = Duration::from_secs(desk.limits.fetch_s);
    loop {
        let file = upload.begin_again().await.map_err(Unfetched::Job)?;
        let fetching = fetched(connector, &url, longest, file);
        let error = match unless_stopped(running, fetching).await {
            None => return Ok(None),
            Some(Ok(file)) => return Ok(Some(file)),
            Some(Err(error)) => error,
        };
        let Some(delay) = error.delay(&mut attempts) else { return Err(error) };
        if unless_stopped(running, sleep(delay)).await.is_none() {
            return Ok(None);
        }
    }
}

/// Streams a file from its host to the disk.
async fn fetched(
    connector: &Connector,
    url: &Url,
    longest: Duration,
    mut file: ArrivingFile,
) -> Result<StoredFile, Unfetched> {
    let (sender, mut chunks) = mpsc::channel::<Bytes>(CHUNKS);
    let downloading = async {
        let downloaded = download(connector, url, longest, &sender).await;
        drop(sender);
        downloaded.map_err(Unfetched::Web)
    };
    let writing = async {
        let mut written = Ok(());
        while let Some(chunk) = chunks.recv().await {
            written = file.write(&chunk).await;
            if written.is_err() {
                break;
            }
        }
        drop(chunks);
        written.map(|()| file).map_err(Unfetched::Job)
    };
    let (downloaded, written) = tokio::join!(downloading, writing);
    let file = written?;
    downloaded?;
    file.finish().await.map_err(Unfetched::Job)
}

/// A URL that is given instead of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputUrl {
    /// The part that the file is for.
    pub part: Part,
    /// The URL of the file.
    pub url: String,
}

impl InputUrl {
    /// The input of a job whose file is not fetched yet.
    ///
    /// # Errors
    /// The text is not a URL, or the operator does not list its host.
    pub(super) fn input(&self, connector: &Connector) -> Result<JobInput, JobError> {
        let refused = |error| JobError::Fetch { field: "options.urls", error };
        let url: Url = self.url.parse().map_err(refused)?;
        connector.policy().check(&url.host, url.port).map_err(refused)?;
        let path = url.path.split('?').next().unwrap_or_default();
        let name = path.rsplit('/').next().unwrap_or_default().chars().take(NAME_MAX);
        let (part, url) = (self.part, Some(self.url.clone()));
        let (name, hash) = (name.collect(), String::new());
        Ok(JobInput { part, name, hash, bytes: 0, is_own: false, url, frame: None })
    }
}
