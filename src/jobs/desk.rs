//! The desk itself: the methods that the doors call.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::aiding::AidingDesk;
use crate::config::JobsConfiguration;
use crate::feeds::{Connector, NavigationArchives};
use crate::gnss::Geoid;
use crate::quotas::Meters;
use crate::session::{BatchLane, SessionError};
use crate::store::{Act, Author, JobRow, JobState, NewJob, Page, Store, StoreError};
use crate::tenant::Tenant;

use super::JobError;
use super::arriving::Upload;
use super::content::ResultContent;
use super::deliveries::{self, Deliveries};
use super::fetching::{self, InputUrl};
use super::files::{JobFiles, StoredFile};
use super::info::{JobId, JobInfo, JobResult};
use super::named::Named;
use super::queue;
use super::request::{JobInput, JobOptions, JobRequest, Part, SessionInput};
use super::shared;
use super::state::{Aiding, Desk, folder};
use super::webhook::Webhook;

/// A file of an upload.
pub struct UploadedFile {
    /// The part that the file is for.
    pub part: Part,
    /// Name of the file on the user's side.
    pub name: String,
    /// The file.
    pub file: StoredFile,
}

/// A request for a job: its options and inputs.
pub struct Submission {
    /// The options.
    pub options: JobOptions,
    /// The files.
    pub files: Vec<UploadedFile>,
    /// URLs in place of files.
    pub urls: Vec<InputUrl>,
    /// The webhook that is informed of its end.
    pub webhook: Option<Webhook>,
    /// Name of the request, so that a repetition creates no second job.
    pub idempotency_key: Option<String>,
}

/// The desk for batch jobs, as one tenant sees it. All clones share the desk.
#[derive(Clone)]
pub struct Jobs {
    pub(super) desk: Arc<Desk>,
    tasks: Arc<Mutex<JoinSet<()>>>,
    pub(super) tenant: Tenant,
}

impl Jobs {
    /// Opens the desk for the operator's jobs, and starts its tasks. On SQLite it queues the jobs
    /// again that an earlier process has left running.
    ///
    /// # Errors
    /// The store or the folder cannot be read, or another node of the cluster has another folder.
    pub async fn open(
        (store, aiding, meters): (Store, AidingDesk, Meters),
        (lane, connector, archives): (BatchLane, Connector, NavigationArchives),
        limits: JobsConfiguration,
        node: String,
        geoid: Option<Arc<Geoid>>,
    ) -> Result<Self, JobError> {
        let again = store.requeue_jobs().await?;
        if 0 < again {
            tracing::info!(jobs = again, "jobs are queued again");
        }
        let files = match folder(&limits, &store) {
            None => None,
            Some(folder) => {
                let named = Named::read(&store).await?;
                let is_alone = store.file().is_some();
                let files = JobFiles::open(folder, limits.clone(), &named, is_alone).await?;
                shared::join(&store, &files).await?;
                store.set_job_folder(files.id()).await?;
                Some(Arc::new(files))
            }
        };
        let mut tasks = JoinSet::new();
        let (running, is_on) = (limits.running, files.is_some());
        let stored = (store, Aiding::Service(Box::new(aiding)), meters);
        let desk = Desk::new(stored, (lane, connector), limits, files, node).with_geoid(geoid);
        let desk = Arc::new(desk.with_archives(archives));
        if is_on {
            (0..running).for_each(|_| drop(tasks.spawn(queue::work(desk.clone()))));
            tasks.spawn(queue::expire(desk.clone()));
            tasks.spawn(queue::count(desk.clone()));
            tasks.spawn(deliveries::deliver(desk.clone()));
            tasks.spawn(fetching::fetch(desk.clone()));
        }
        Ok(Self { desk, tasks: Arc::new(Mutex::new(tasks)), tenant: Tenant::operator() })
    }

    /// Bytes that the disk of the folder has left; `None` without a folder, or if unknown.
    pub(crate) fn free_bytes(&self) -> Option<u64> {
        self.desk.files().ok()?.free_bytes()
    }

    /// The desk for the jobs of a tenant.
    #[must_use]
    pub fn of(&self, tenant: &Tenant) -> Self {
        Self { tenant: tenant.clone(), ..self.clone() }
    }

    /// Begins an upload of files.
    ///
    /// # Errors
    /// The service takes no jobs, the limit of uploads or of jobs is reached, the tenant has used
    /// its quota of bytes, or the store fails.
    pub async fn upload(&self) -> Result<Upload, JobError> {
        let files = self.desk.files()?;
        self.check_waiting().await?;
        let allowance = self.desk.allowance(&self.tenant).await?;
        Upload::begin_at(files, &self.tenant, allowance)
    }

    /// Queues a job. Returns it, and whether it is new: a repetition with the same idempotency key
    /// returns the earlier job.
    ///
    /// # Errors
    /// The rover's part is missing, an option does not exist or does not fit, the tenant has no
    /// such session, a URL is not allowed, there are more files than allowed, the tenant has used
    /// its quota of bytes, another request had this idempotency key, or the store fails.
    pub async fn submit(&self, submission: Submission) -> Result<(JobInfo, bool), JobError> {
        let Submission { mut options, files, urls, webhook, idempotency_key } = submission;
        let connector = self.desk.connector.of(&self.tenant);
        if let Some(webhook) = &webhook {
            webhook.check(&connector)?;
            options.webhook = Some(webhook.url.clone());
        }
        let limit = self.desk.limits.files;
        if !urls.is_empty() && limit < files.len() + urls.len() {
            return Err(JobError::TooManyFiles { limit });
        }
        let inputs = files.iter().map(|uploaded| JobInput {
            part: uploaded.part,
            name: uploaded.name.clone(),
            hash: uploaded.file.hash.clone(),
            bytes: uploaded.file.bytes,
            is_own: false,
            url: None,
            frame: None,
        });
        let mut inputs: Vec<_> = inputs.collect();
        for url in &urls {
            inputs.push(url.input(&connector)?);
        }
        let mut request = JobRequest::new(options, inputs);
        let request_hash = request.hash(webhook.as_ref());
        if let Some(before) = self.created_by(idempotency_key.as_deref(), &request_hash).await? {
            return Ok((before, false));
        }
        request.session = self.session_input(&request).await?;
        let plan = self.desk.plan(&request)?;
        let is_unfetched = !urls.is_empty() || request.lacks_aiding(&plan.options);
        self.check_waiting().await?;
        self.desk.allowance(&self.tenant).await?; // Its result needs room, too.
        let new = NewJob {
            tenant: self.tenant.clone(),
            id: JobId::random().to_string(),
            request: request.to_json(),
            request_hash,
            idempotency_key,
            created_unix_ms: self.unix_ms(),
            is_unfetched,
            webhook_secret: webhook.map(|webhook| webhook.secret.text().to_owned()),
        };
        let (row, is_new) = self.desk.store.create_job(&new).await?;
        let job = same_request(row, &new.request_hash)?;
        let waking = if is_unfetched { &self.desk.unfetched } else { &self.desk.queued };
        waking.notify_one();
        Ok((job, is_new))
    }

    /// The job that the same request with this idempotency key has created, if it still exists. The
    /// session or other objects that the request names may no longer exist.
    async fn created_by(
        &self,
        idempotency_key: Option<&str>,
        request_hash: &str,
    ) -> Result<Option<JobInfo>, JobError> {
        let Some(key) = idempotency_key else { return Ok(None) };
        let row = self.desk.store.job_created_by(&self.tenant, key).await?;
        row.map(|row| same_request(row, request_hash)).transpose()
    }

    /// The part of a job's input that comes from its session, if it has one.
    async fn session_input(&self, request: &JobRequest) -> Result<Option<SessionInput>, JobError> {
        let Some((id, rerun)) = request.options.rerun(request.has_base())? else { return Ok(None) };
        let aiding = self.desk.aiding().await.map_err(SessionError::from)?;
        let plan = rerun.plan(&self.desk.store, &aiding, &self.tenant, &id).await?;
        Ok(Some(SessionInput::of(&plan)))
    }

    /// A job.
    ///
    /// # Errors
    /// No job has this id, or the store fails.
    pub async fn get(&self, id: &JobId) -> Result<JobInfo, JobError> {
        let row = self.desk.store.job(&self.tenant, id.as_str()).await?;
        Ok(JobInfo::of(row.ok_or_else(|| JobError::NotFound { id: id.to_string() })?)?)
    }

    /// A page of 1 to 1000 jobs: those of this state, or all; the oldest or the newest first.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub async fn list(
        &self,
        (state, oldest_first): (Option<JobState>, bool),
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<JobInfo>, JobError> {
        let filter = (state, oldest_first);
        let page = self.desk.store.jobs(&self.tenant, filter, page_size, page_token).await?;
        Ok(page.try_map(JobInfo::of)?)
    }

    /// Ends a job that waits or runs. A job that has ended stays as it is.
    ///
    /// # Errors
    /// No job has this id, or the store fails.
    pub async fn cancel(&self, id: &JobId) -> Result<JobInfo, JobError> {
        let (store, now) = (&self.desk.store, self.unix_ms());
        if store.cancel_job(&self.tenant, id.as_str(), now).await? {
            self.desk.stop(id);
        }
        self.desk.changed();
        self.get(id).await
    }

    /// Deletes a job that has ended, with its result, by a call of `author`. If its webhook still
    /// waits for the message, the message is given up. Returns the job as it was.
    ///
    /// # Errors
    /// No job has this id, it has not ended, or the store fails.
    pub(crate) async fn delete(
        &self,
        id: &JobId,
        (call, author): (&'static str, &Author),
    ) -> Result<JobInfo, JobError> {
        let job = self.ended(id).await?;
        let change = format!("state {}", job.state.name());
        let act = Act { call, tenant: &self.tenant, object: id.as_str(), change };
        let entry = author.does(act, self.unix_ms());
        if !self.desk.store.delete_job(&self.tenant, id.as_str(), &entry).await? {
            return Err(JobError::NotFound { id: id.to_string() });
        }
        // Its inputs are removed later: other jobs may name them, too.
        if let Some(JobResult { file, bytes }) = &job.result {
            self.desk.files()?.remove_result(file, *bytes).await;
        }
        self.desk.changed();
        Ok(job)
    }

    /// The number of changes of all jobs. Each change wakes the watches of jobs.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.desk.changes.subscribe()
    }

    /// The result of a job: the job, and its file from the first byte.
    ///
    /// # Errors
    /// No job has this id, it has no result, or the store, the disk or the bucket fails.
    pub async fn result(&self, id: &JobId) -> Result<(JobInfo, ResultContent), JobError> {
        let job = self.ended(id).await?;
        let Some(result) = &job.result else {
            return Err(JobError::WithoutResult { id: id.to_string(), state: job.state.name() });
        };
        let content = self.desk.files()?.open_result(&result.file, result.bytes).await?;
        Ok((job, content))
    }

    /// A job that has ended.
    ///
    /// # Errors
    /// No job has this id, it has not ended, or the store fails.
    pub async fn ended(&self, id: &JobId) -> Result<JobInfo, JobError> {
        let job = self.get(id).await?;
        match job.state.is_end() {
            true => Ok(job),
            false => Err(JobError::NotEnded { id: id.to_string(), state: job.state.name() }),
        }
    }

    /// The attempts to inform the webhook of a job.
    ///
    /// # Errors
    /// No job has this id, or the store fails.
    pub async fn deliveries(&self, id: &JobId) -> Result<Deliveries, JobError> {
        deliveries::of_job(&self.desk, &self.tenant, id.as_str()).await
    }

    /// The time of the desk (ms since 1970-01-01 UTC).
    pub fn unix_ms(&self) -> i64 {
        self.desk.arrival_time()
    }

    /// Time for which a job is kept after its end (ms).
    pub fn kept_ms(&self) -> i64 {
        i64::from(self.desk.limits.keep_hours) * 3_600_000
    }

    /// Removes jobs whose end is longer ago than they are kept, and files without a job. The desk
    /// does this every ten minutes.
    ///
    /// # Errors
    /// The store or the disk fails.
    pub async fn remove_expired(&self) -> Result<(), JobError> {
        queue::remove_expired(&self.desk).await
    }

    /// Stops the running jobs, and queues them again.
    pub async fn close(&self) {
        self.desk.stop_all();
        let mut tasks = {
            let mut tasks = self.tasks.lock().unwrap_or_else(PoisonError::into_inner);
            std::mem::take(&mut *tasks)
        };
        while tasks.join_next().await.is_some() {}
    }

    async fn check_waiting(&self) -> Result<(), JobError> {
        if self.desk.is_stopping() {
            return Err(JobError::Draining);
        }
        let limit = self.desk.limits.waiting;
        let waiting: Result<u64, StoreError> = self.desk.store.waiting_jobs().await;
        if limit as u64 <= waiting? { Err(JobError::TooMany { limit }) } else { Ok(()) }
    }
}

/// The job of a row whose request has this hash.
fn same_request(row: JobRow, request_hash: &str) -> Result<JobInfo, JobError> {
    if row.request_hash != request_hash {
        return Err(JobError::IdempotencyConflict { job: row.id });
    }
    Ok(JobInfo::of(row)?)
}
