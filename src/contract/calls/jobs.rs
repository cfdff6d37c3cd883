//! Batch jobs.

use std::mem;
use std::time::Duration;

use bytes::Bytes;
use futures::{Stream, StreamExt, stream};
use tokio::time::timeout;

use crate::contract::{BodyRate, Caller, Lease, Refusal, texts, v1};
use crate::formats::result::ResultFormat;
use crate::jobs::{
    ArrivingFile, Failure, InputUrl, JobError, JobId, JobInfo, JobInput, PAGE_BYTES, Part,
    RESULT_CHUNK_BYTES, Report, ResultContent, Submission, Upload, UploadedFile,
};
use crate::refusal::Code;
use crate::store::{JobState, WebhookState};

use super::paging::{self, Pages, Reading};
use super::uploads::upload_id;
use super::{job_options, oldest_first, page_size, timestamp, typed, utc};

/// Jobs on a page if the request gives no size.
const PAGE: usize = 100;
/// Most jobs on a page.
const PAGE_LIMIT: usize = 1000;
/// Memory of a job with its report, its message and its JSON (bytes).
const JOB_BYTES: usize = 32 << 10;
const _: () = assert!(paging::PAGE_BYTES / JOB_BYTES == 256, "proto/ and docs/api.md state it");
/// Memory of the options and names of an upload (bytes).
const OPTIONS_BYTES: usize = 64 << 10;
/// Name of the call that deletes a job.
const DELETE: &str = "Jobs.Delete";
/// Longest idempotency key.
const KEY_MAX: usize = 200;

/// Files and options of a job while they arrive.
pub struct Arriving {
    upload: Upload,
    files: Vec<UploadedFile>,
    options: Option<v1::JobOptions>,
}

/// A file that arrives.
pub struct ArrivingPart {
    part: Part,
    name: String,
    file: ArrivingFile,
}

/// Begins the upload of a job.
///
/// # Errors
/// The service takes no jobs, or the limit of uploads or jobs is reached.
pub async fn begin(caller: &Caller) -> Result<Arriving, Refusal> {
    let upload = caller.jobs().upload().await?;
    Ok(Arriving { upload, files: Vec::new(), options: None })
}

impl Arriving {
    /// Begins the file of a part. `name` is the name of the file on the user's side.
    ///
    /// # Errors
    /// There is no such part, the name is too long or has a control character, the limit of files
    /// is reached, or the disk fails.
    pub async fn begin(&mut self, part: &str, name: &str) -> Result<ArrivingPart, Refusal> {
        let part = Part::from_name(part).ok_or_else(|| {
            let given = texts::brief(part);
            let message = format!(
                "there is no part {given:?}; known are rover, navigation, base and options"
            );
            Refusal::new(Code::UnknownField, message).at(given)
        })?;
        texts::check_file_name(part.name(), name)?;
        let file = self.upload.begin().await;
        let file = file.map_err(|error| Refusal::from(error).at(part.name()))?;
        Ok(ArrivingPart { part, name: name.to_owned(), file })
    }

    /// Stores a file that has arrived.
    ///
    /// # Errors
    /// The disk fails.
    pub async fn finish(&mut self, arrived: ArrivingPart) -> Result<(), Refusal> {
        let ArrivingPart { part, name, file } = arrived;
        let file = file.finish().await?;
        self.files.push(UploadedFile { part, name, file });
        Ok(())
    }

    /// Adds the options.
    ///
    /// # Errors
    /// They are given twice.
    pub fn options(&mut self, options: v1::JobOptions) -> Result<(), Refusal> {
        match self.options.replace(options) {
            None => Ok(()),
            Some(_) => {
                let message = "there is more than one part options";
                Err(Refusal::new(Code::InvalidField, message).at("options"))
            }
        }
    }

    /// Queues the job. Returns it, and whether it is new.
    ///
    /// # Errors
    /// A part is missing, an option does not exist or does not fit, the tenant has no such session,
    /// or the idempotency key was used for another request.
    pub async fn submit(
        mut self,
        caller: &Caller,
        idempotency_key: Option<&str>,
    ) -> Result<(v1::Job, bool), Refusal> {
        if let Some(key) = idempotency_key {
            texts::check("Idempotency-Key", key, KEY_MAX)?;
        }
        let mut options = self.options.take().unwrap_or_default();
        let urls = input_urls(mem::take(&mut options.urls))?;
        self.add_uploads(caller, mem::take(&mut options.uploads)).await?;
        let has_base = urls.iter().any(|url| url.part == Part::Base)
            || self.files.iter().any(|file| file.part == Part::Base);
        let webhook = job_options::webhook(options.webhook.take())?;
        if webhook.is_some() {
            caller.check_secret("options.webhook.secret")?;
        }
        let options = job_options::read(caller, options, has_base)?;
        let key = idempotency_key.map(ToOwned::to_owned);
        let files = self.files;
        let submission = Submission { options, files, urls, webhook, idempotency_key: key };
        let (job, is_new) = caller.jobs().submit(submission).await?;
        Ok((message(caller, &job), is_new))
    }
}

/// The URLs that are given instead of files.
///
/// # Errors
/// There is no such part, or a URL is too long or has a control character.
fn input_urls(urls: Vec<v1::JobUrl>) -> Result<Vec<InputUrl>, Refusal> {
    let url = |(index, v1::JobUrl { part, url })| {
        let unknown = || {
            let message = format!("{:?} is not rover, navigation or base", texts::brief(&part));
            Refusal::new(Code::InvalidField, message).at(format!("options.urls[{index}].part"))
        };
        let part = Part::from_name(&part).ok_or_else(unknown)?;
        texts::check(&format!("options.urls[{index}].url"), &url, texts::ADDRESS_MAX)?;
        Ok(InputUrl { part, url })
    };
    urls.into_iter().enumerate().map(url).collect()
}

impl Arriving {
    /// Adds the files of complete uploads.
    ///
    /// # Errors
    /// There is no such part or upload, bytes of the upload are missing, or there are more files
    /// than allowed.
    async fn add_uploads(
        &mut self,
        caller: &Caller,
        uploads: Vec<v1::JobUploadInput>,
    ) -> Result<(), Refusal> {
        for (index, v1::JobUploadInput { part, upload }) in uploads.into_iter().enumerate() {
            let field = format!("options.uploads[{index}]");
            let unknown = || {
                let message = format!("{:?} is not rover, navigation or base", texts::brief(&part));
                Refusal::new(Code::InvalidField, message).at(format!("{field}.part"))
            };
            let part = Part::from_name(&part).ok_or_else(unknown)?;
            let at_upload = |refusal: Refusal| refusal.at(format!("{field}.upload"));
            let id = upload_id(&upload).map_err(at_upload)?;
            self.upload.count()?;
            let uploaded = caller.jobs().uploaded(&id).await;
            let (name, file) = uploaded.map_err(|error| at_upload(error.into()))?;
            self.files.push(UploadedFile { part, name, file });
        }
        Ok(())
    }
}

/// Creates a job from a stream of messages.
///
/// # Errors
/// The stream ends early, is silent for too long or too slow, or bytes belong to no file; or as for
/// [`Arriving::submit`].
pub async fn create<E: From<Refusal>>(
    caller: &Caller,
    mut messages: impl Stream<Item = Result<v1::CreateJobRequest, E>> + Unpin,
) -> Result<v1::Job, E> {
    use v1::create_job_request::Content;

    let silence = Duration::from_secs(caller.limits().body_silence_s);
    let (rate, mut arrived) = (BodyRate::begin(silence), 0);
    let mut arriving = begin(caller).await?;
    let (mut open, mut key) = (None::<ArrivingPart>, None);
    loop {
        let next = timeout(silence, messages.next()).await.map_err(|_| {
            let message = format!("no message of the stream for {silence:?}");
            Refusal::new(Code::BodyTooSlow, message)
        })?;
        let Some(message) = next.transpose()? else { break };
        if let Some(Content::Chunk(bytes)) = &message.content {
            arrived += bytes.len();
        }
        rate.check(arrived)?;
        match message.content {
            Some(Content::Options(options)) => arriving.options(options)?,
            Some(Content::IdempotencyKey(text)) => key = Some(text),
            Some(Content::Part(v1::JobPart { part, name })) => {
                if let Some(file) = open.take() {
                    arriving.finish(file).await?;
                }
                open = Some(arriving.begin(&part, &name).await?);
            }
            Some(Content::Chunk(bytes)) => {
                let file = open.as_mut().ok_or_else(|| {
                    let message = "bytes before the part that they belong to";
                    Refusal::new(Code::InvalidField, message).at("chunk")
                })?;
                file.write(&bytes).await?;
            }
            None => {}
        }
        // The message is already on the disk, or takes few bytes.
        Lease::current().map_or(Ok(()), |lease| lease.settle(OPTIONS_BYTES))?;
    }
    if let Some(file) = open {
        arriving.finish(file).await?;
    }
    Ok(arriving.submit(caller, key.as_deref()).await?.0)
}

impl ArrivingPart {
    /// Appends bytes.
    ///
    /// # Errors
    /// The file, or all files together, exceed their limit, or the disk fails.
    pub async fn write(&mut self, bytes: &[u8]) -> Result<(), Refusal> {
        let written = self.file.write(bytes).await;
        written.map_err(|error| Refusal::from(error).at(self.part.name()))
    }
}

/// A job.
///
/// # Errors
/// The job does not exist.
pub async fn get(caller: &Caller, request: v1::GetJobRequest) -> Result<v1::Job, Refusal> {
    let job = caller.jobs().get(&job_id(&request.job)?).await?;
    Ok(message(caller, &job))
}

/// A page of jobs.
///
/// # Errors
/// The page token or size, the state or the order is invalid.
pub async fn list(
    caller: &Caller,
    request: v1::ListJobsRequest,
) -> Result<v1::ListJobsResponse, Refusal> {
    let (jobs, next_page_token) = page(caller, request).await?;
    let jobs = jobs.iter().map(|job| message(caller, job)).collect();
    Ok(v1::ListJobsResponse { jobs, next_page_token })
}

/// The jobs of a page, and the token of the next one.
///
/// # Errors
/// The page token or size, the state or the order is invalid.
pub(super) async fn page(
    caller: &Caller,
    mut request: v1::ListJobsRequest,
) -> Result<(Vec<JobInfo>, String), Refusal> {
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("Jobs/List", &request, &token)?;
    let filter = (state(&request.state)?, oldest_first(request.order)?);
    let mut reading = Reading::of(&pages, (size, PAGE_LIMIT), JOB_BYTES)?;
    while let Some(count) = reading.batch()? {
        let page = caller.jobs().list(filter, count, reading.after()).await?;
        reading.add(page.items, page.next_page_token);
    }
    let (jobs, next) = reading.end();
    Ok((jobs, pages.token(next)))
}

/// The state by which a list is filtered; none if the name is empty.
fn state(name: &str) -> Result<Option<JobState>, Refusal> {
    let known = || {
        JobState::from_name(name).ok_or_else(|| {
            let (given, names) = (texts::brief(name), JobState::ALL.map(JobState::name).join(", "));
            let message = format!("{given:?} is not the state of a job; known are {names}");
            Refusal::new(Code::InvalidField, message).at("state")
        })
    };
    if name.is_empty() { Ok(None) } else { known().map(Some) }
}

/// Ends a job that waits or runs.
///
/// # Errors
/// The job does not exist.
pub async fn cancel(caller: &Caller, request: v1::CancelJobRequest) -> Result<v1::Job, Refusal> {
    let job = caller.jobs().cancel(&job_id(&request.job)?).await?;
    Ok(message(caller, &job))
}

/// Deletes a job that has ended, with its result. Returns it as it was.
///
/// # Errors
/// The job does not exist, or has not ended.
pub async fn delete(caller: &Caller, request: v1::DeleteJobRequest) -> Result<v1::Job, Refusal> {
    let deleted = async {
        let (id, author) = (job_id(&request.job)?, caller.author());
        Ok(message(caller, &caller.jobs().delete(&id, (DELETE, &author)).await?))
    };
    caller.noted(DELETE, &request.job, deleted.await).await
}

/// The report of a job.
///
/// # Errors
/// The job does not exist, has not ended, or has failed or been cancelled.
pub async fn report(caller: &Caller, request: v1::GetJobRequest) -> Result<v1::JobReport, Refusal> {
    let job = caller.jobs().ended(&job_id(&request.job)?).await?;
    let without = || JobError::WithoutResult { id: job.id.to_string(), state: job.state.name() };
    Ok(report_message(&job.id, job.report.as_ref().ok_or_else(without)?))
}

/// The report of a job as an HTML page.
///
/// # Errors
/// The job does not exist, has not ended, or has failed or been cancelled.
pub async fn report_page(caller: &Caller, request: v1::GetJobRequest) -> Result<String, Refusal> {
    Lease::current().map_or(Ok(()), |lease| lease.reserve(PAGE_BYTES))?;
    Ok(caller.jobs().report_page(&job_id(&request.job)?).await?)
}

/// The result of a job.
pub struct ResultFile {
    /// Proposed name of the file for a user.
    pub name: String,
    /// Its media type.
    pub content_type: &'static str,
    /// Its size (bytes).
    pub bytes: u64,
    content: ResultContent,
}

/// Opens the result of a job.
///
/// # Errors
/// The job does not exist, has not ended, or has no result.
pub async fn result(caller: &Caller, request: v1::GetJobRequest) -> Result<ResultFile, Refusal> {
    let (job, content) = caller.jobs().result(&job_id(&request.job)?).await?;
    Lease::current().map_or(Ok(()), |lease| lease.reserve(2 * RESULT_CHUNK_BYTES))?;
    let format = ResultFormat::from_name(&job.request.options.format);
    Ok(ResultFile {
        name: format!("{}.{}", job.id, format.map_or("", ResultFormat::ending)),
        content_type: format.map_or("", ResultFormat::content_type),
        bytes: job.result.as_ref().map_or(0, |result| result.bytes),
        content,
    })
}

impl ResultFile {
    /// The bytes, read as fast as the stream is read.
    pub fn content(self) -> impl Stream<Item = Result<Bytes, Refusal>> + Send {
        stream::unfold(Some(self.content), |content| async move {
            let mut content = content?;
            match content.chunk().await {
                Ok(None) => None,
                Ok(Some(chunk)) => Some((Ok(chunk), Some(content))),
                Err(error) => Some((Err(error.into()), None)),
            }
        })
    }
}

pub(super) fn job_id(text: &str) -> Result<JobId, Refusal> {
    JobId::parse(text).ok_or_else(|| {
        let message = format!("there is no job {:?}", texts::brief(text));
        Refusal::new(Code::JobNotFound, message).at("job")
    })
}

/// A job as a message.
pub(super) fn message(caller: &Caller, job: &JobInfo) -> v1::Job {
    let now = caller.jobs().unix_ms();
    let time = |unix_ms: Option<i64>| unix_ms.map(utc).unwrap_or_default();
    let input = |input: &JobInput| v1::JobInput {
        part: input.part.name().to_owned(),
        name: input.name.clone(),
        hash: input.hash.clone(),
        bytes: input.bytes,
        own: input.is_own,
        url: input.url.clone().unwrap_or_default(),
    };
    let expires_unix_ms = job.ended_unix_ms.map(|ended| ended + caller.jobs().kept_ms());
    v1::Job {
        job: job.id.to_string(),
        state: job.state.name().to_owned(),
        options: Some(job_options::message(&job.request)),
        inputs: job.request.inputs.iter().map(input).collect(),
        created_utc: utc(job.created_unix_ms),
        started_utc: time(job.started_unix_ms),
        ended_utc: time(job.ended_unix_ms),
        expires_utc: time(expires_unix_ms),
        progress: Some(v1::JobProgress {
            percent: job.percent(),
            epochs: job.progress.epochs,
            answered: job.progress.answered,
            epochs_per_second: job.epochs_per_second(now),
            remaining_s: job.remaining_s(now),
        }),
        result_bytes: job.result.as_ref().map(|result| result.bytes),
        failure: job.failure.as_ref().map(failure_message),
        webhook_state: job.webhook_state.map_or("", WebhookState::name).to_owned(),
        job_state: typed(&format!("JOB_STATE_{}", job.state.name()), v1::JobState::from_str_name),
        delivery_state: delivery_state(job.webhook_state),
        create_time: timestamp(job.created_unix_ms),
        start_time: job.started_unix_ms.and_then(timestamp),
        end_time: job.ended_unix_ms.and_then(timestamp),
        expire_time: expires_unix_ms.and_then(timestamp),
    }
}

/// State of the message to a webhook, as an enumeration value.
pub(super) fn delivery_state(state: Option<WebhookState>) -> i32 {
    let name = state.map_or("UNSPECIFIED", WebhookState::name);
    typed(&format!("DELIVERY_STATE_{name}"), v1::DeliveryState::from_str_name)
}

fn failure_message(failure: &Failure) -> v1::Refusal {
    v1::Refusal {
        code: failure.code.clone(),
        message: failure.message.clone(),
        remedy: failure.remedy.clone(),
        field: failure.field.clone().unwrap_or_default(),
    }
}

/// The report of a job as a message.
pub(super) fn report_message(id: &JobId, report: &Report) -> v1::JobReport {
    let counts = |counts: &[(String, u64)]| {
        let count = |(name, epochs): &(String, u64)| v1::JobCount {
            name: name.clone(),
            epochs: *epochs,
            remedy: report.remedies.get(name).cloned().unwrap_or_default(),
        };
        counts.iter().map(count).collect()
    };
    v1::JobReport {
        job: id.to_string(),
        version: report.version.clone(),
        configuration_hash: report.configuration_hash.clone(),
        epochs: report.epochs,
        answered: report.answered,
        seconds: report.seconds,
        statuses: counts(&report.statuses),
        reasons: counts(&report.reasons),
        provenance: report.provenance.clone(),
        skipped: report.skipped.clone(),
    }
}
