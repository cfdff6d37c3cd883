//! Batch jobs as the desk sees them, and as they are read from the table.

use crate::store::StoreError;
use crate::tenant::Tenant;

/// Primary key of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct JobKey(pub(super) i64);

/// State of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobState {
    /// It waits for its run.
    Queued,
    /// It is being computed.
    Running,
    /// Its result is stored.
    Succeeded,
    /// It has no result.
    Failed,
    /// A user ended it.
    Cancelled,
}

impl JobState {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled];

    /// The name in the API and in the database.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Queued => "QUEUED",
            Self::Running => "RUNNING",
            Self::Succeeded => "SUCCEEDED",
            Self::Failed => "FAILED",
            Self::Cancelled => "CANCELLED",
        }
    }

    /// The state of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }

    /// Whether this state is final.
    pub const fn is_end(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// State of the message to a job's webhook.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WebhookState {
    /// It waits for the end of the job, or for the next attempt.
    Waiting,
    /// The host has accepted it.
    Delivered,
    /// No attempt follows.
    Failed,
}

impl WebhookState {
    const ALL: [Self; 3] = [Self::Waiting, Self::Delivered, Self::Failed];

    /// The name in the API and in the database.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Waiting => "WAITING",
            Self::Delivered => "DELIVERED",
            Self::Failed => "FAILED",
        }
    }

    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }
}

/// A job to queue. Its texts are JSON that the jobs desk writes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewJob {
    /// Tenant that owns the job.
    pub tenant: Tenant,
    /// Public id.
    pub id: String,
    /// Options and input files.
    pub request: String,
    /// Identifies the content of the request.
    pub request_hash: String,
    /// The tenant's name for this request. A repetition with this name creates no second job.
    pub idempotency_key: Option<String>,
    /// When it arrived (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// Secret that signs the messages to its webhook; `None` without a webhook.
    pub webhook_secret: Option<String>,
    /// Whether its inputs must be fetched before it can be claimed.
    pub is_unfetched: bool,
}

/// Progress of a job.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JobProgress {
    /// Number of epochs.
    pub epochs: u64,
    /// Number of epochs with a position.
    pub answered: u64,
    /// Bytes of the rover's file that have been read.
    pub read_bytes: u64,
    /// Number of epochs that the present run has taken over from an earlier run.
    pub resumed_epochs: u64,
    /// Bytes of the rover's file that these epochs take.
    pub resumed_bytes: u64,
}

/// How a job ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JobEnd {
    /// With a result.
    Succeeded {
        /// Name of the result's file.
        result: String,
        /// Its size (bytes).
        bytes: u64,
        /// The report, JSON.
        report: String,
    },
    /// Without a result.
    Failed {
        /// Why, JSON.
        failure: String,
    },
}

/// A stored job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobRow {
    /// Primary key.
    pub key: JobKey,
    /// Tenant that owns the job.
    pub tenant: Tenant,
    /// Public id.
    pub id: String,
    /// Its state.
    pub state: JobState,
    /// Options and input files.
    pub request: String,
    /// Identifies the content of the request.
    pub request_hash: String,
    /// When it arrived (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When its present or last run began.
    pub started_unix_ms: Option<i64>,
    /// When it ended.
    pub ended_unix_ms: Option<i64>,
    /// Number of claims.
    pub fence: i64,
    /// Number of claimants that vanished without ending or returning it.
    pub lost_claims: u64,
    /// Its progress.
    pub progress: JobProgress,
    /// Name and size of the result's file (bytes).
    pub result: Option<(String, u64)>,
    /// The report of a success.
    pub report: Option<String>,
    /// The reason of a failure.
    pub failure: Option<String>,
    /// State of the message to its webhook; `None` without a webhook.
    pub webhook_state: Option<WebhookState>,
}

/// The files in the folder of jobs that a job names.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub struct JobFilesRow {
    /// Public id.
    pub id: String,
    /// Options and input files.
    pub request: String,
    /// Name of the result's file.
    pub result: Option<String>,
    /// Number of claims.
    pub fence: i64,
    /// Whether the job has ended.
    pub is_ended: bool,
}

#[derive(sqlx::FromRow)]
pub(super) struct RawJob {
    pub(super) key: i64,
    tenant: String,
    pub(super) id: String,
    state: String,
    request: String,
    request_hash: String,
    created_unix_ms: i64,
    started_unix_ms: Option<i64>,
    ended_unix_ms: Option<i64>,
    fence: i64,
    lost_claims: i64,
    epochs: i64,
    answered: i64,
    read_bytes: i64,
    resumed_epochs: i64,
    resumed_bytes: i64,
    result: Option<String>,
    result_bytes: Option<i64>,
    report: Option<String>,
    failure: Option<String>,
    webhook_state: Option<String>,
}

impl RawJob {
    pub(super) fn parse(self) -> Result<JobRow, StoreError> {
        let unknown = |name: &str| StoreError::CorruptText {
            what: "job",
            why: format!("{name:?} is not a state"),
        };
        let state = JobState::from_name(&self.state).ok_or_else(|| unknown(&self.state))?;
        let webhook_state = self
            .webhook_state
            .map(|name| WebhookState::from_name(&name).ok_or_else(|| unknown(&name)));
        Ok(JobRow {
            key: JobKey(self.key),
            tenant: Tenant::stored(&self.tenant),
            id: self.id,
            state,
            request: self.request,
            request_hash: self.request_hash,
            created_unix_ms: self.created_unix_ms,
            started_unix_ms: self.started_unix_ms,
            ended_unix_ms: self.ended_unix_ms,
            fence: self.fence,
            lost_claims: self.lost_claims as u64,
            progress: JobProgress {
                epochs: self.epochs as u64,
                answered: self.answered as u64,
                read_bytes: self.read_bytes as u64,
                resumed_epochs: self.resumed_epochs as u64,
                resumed_bytes: self.resumed_bytes as u64,
            },
            result: self.result.zip(self.result_bytes.map(|bytes| bytes as u64)),
            report: self.report,
            failure: self.failure,
            webhook_state: webhook_state.transpose()?,
        })
    }
}

/// The columns of [`RawJob`].
macro_rules! columns {
    () => {
        "key, tenant, id, state, request, request_hash, created_unix_ms, started_unix_ms, \
         ended_unix_ms, fence, lost_claims, epochs, answered, read_bytes, resumed_epochs, \
         resumed_bytes, result, result_bytes, report, failure, webhook_state"
    };
}
pub(super) use columns;
