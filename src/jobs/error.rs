//! Why the desk refuses a call.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use crate::config::ConfigError;
use crate::feeds::FetchError;
use crate::gnss::FrameRefusal;
use crate::quotas::QuotaError;
use crate::refusal::Code;
use crate::session::SessionError;
use crate::store::StoreError;

use super::bucket::BucketError;

/// Interval at which expired jobs and uploads are removed.
pub(super) const EXPIRY: Duration = Duration::from_secs(600);

/// Why the desk refuses a call. [`super::Failure`] is why a job has no result.
#[derive(Clone, Debug, thiserror::Error)]
pub enum JobError {
    /// The service has no folder for the files of jobs.
    #[error("this service has no folder for jobs")]
    Off,
    /// No job has this id.
    #[error("there is no job {id:?}")]
    NotFound {
        /// The id as given.
        id: String,
    },
    /// As many jobs wait as allowed.
    #[error("{limit} jobs wait or run, as many as allowed")]
    TooMany {
        /// Number allowed.
        limit: usize,
    },
    /// As many jobs arrive as allowed.
    #[error("the files of {limit} jobs arrive, as many as allowed")]
    TooManyArriving {
        /// Number allowed.
        limit: usize,
    },
    /// As many jobs of the tenant arrive as one tenant may have, so that others can upload, too.
    #[error("the files of {limit} jobs of the tenant arrive, as many as one tenant may have")]
    TooManyArrivingOfTenant {
        /// Number allowed.
        limit: usize,
    },
    /// The tenant has begun as many uploads as allowed.
    #[error("{limit} uploads are begun, as many as allowed")]
    TooManyUploads {
        /// Number allowed.
        limit: usize,
    },
    /// A file is larger than allowed.
    #[error("the file exceeds {limit} bytes")]
    FileTooLarge {
        /// Size allowed (bytes).
        limit: u64,
    },
    /// The upload has more files than allowed.
    #[error("the upload has more than {limit} files")]
    TooManyFiles {
        /// Number allowed.
        limit: usize,
    },
    /// The files of all jobs would exceed their space.
    #[error("the files of all jobs would exceed {limit} bytes")]
    SpaceExhausted {
        /// Size allowed (bytes).
        limit: u64,
    },
    /// The tenant has used its quota.
    #[error(transparent)]
    Quota(#[from] QuotaError),
    /// An option of the request is missing or wrong.
    #[error("{message}")]
    InvalidOption {
        /// The option.
        field: &'static str,
        /// What is wrong.
        message: String,
    },
    /// The mode, profile or an override does not exist.
    #[error(transparent)]
    Configuration(#[from] ConfigError),
    /// Positions relative to the base cannot be given in the frame that is asked for.
    #[error("positions cannot be given in the ETRS89: {0}; the override base_frame states a frame")]
    Frame(FrameRefusal),
    /// The format of the result is not in this program.
    #[error("{message}")]
    FormatNotBuilt {
        /// What is missing.
        message: String,
    },
    /// Heights above the geoid are asked for, and the service has no table.
    #[error("the service has no table of the geoid")]
    GeoidMissing,
    /// The session cannot be positioned as asked.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The text is not a URL, or the operator does not allow its host.
    #[error("{error}")]
    Fetch {
        /// The field with the URL.
        field: &'static str,
        /// What is wrong.
        error: FetchError,
    },
    /// Another request had the same idempotency key.
    #[error("job {job} had the same Idempotency-Key and another content")]
    IdempotencyConflict {
        /// Id of that request's job.
        job: String,
    },
    /// The job has not ended.
    #[error("job {id} is {state}")]
    NotEnded {
        /// Id of the job.
        id: String,
        /// Name of its state.
        state: &'static str,
    },
    /// The job has ended without a result.
    #[error("job {id} is {state} and has no result")]
    WithoutResult {
        /// Id of the job.
        id: String,
        /// Name of its state.
        state: &'static str,
    },
    /// A file of a job cannot be read or written.
    #[error("{what}: {source}")]
    Disk {
        /// What was done.
        what: &'static str,
        /// What the system reports.
        source: Arc<io::Error>,
    },
    /// The bucket of the files fails.
    #[error(transparent)]
    Bucket(#[from] BucketError),
    /// No upload has this id.
    #[error("there is no upload {id:?}")]
    UploadNotFound {
        /// The id as given.
        id: String,
    },
    /// Another request appends to the upload.
    #[error("another request appends to upload {id}")]
    UploadBusy {
        /// Id of the upload.
        id: String,
    },
    /// The bytes of a request do not begin at the end of the upload.
    #[error("{offset} bytes of the upload are stored")]
    UploadOffset {
        /// Number of bytes that are stored.
        offset: u64,
    },
    /// The request has more bytes than the upload still needs. None of them is stored.
    #[error("the bytes go beyond the {length} bytes with which the upload began")]
    UploadTooLong {
        /// Size of the file (bytes).
        length: u64,
    },
    /// A job names an upload whose bytes are not all there.
    #[error("{offset} of {length} bytes of upload {id} are stored")]
    UploadIncomplete {
        /// Id of the upload.
        id: String,
        /// Number of bytes that are stored.
        offset: u64,
        /// Size of the file (bytes).
        length: u64,
    },
    /// A worker cannot use a SQLite database, because only one process writes to it.
    #[error("a worker takes no jobs from SQLite, whose file one process writes to")]
    WorkerOnSqlite,
    /// The folder of a worker is not the service's folder of jobs.
    #[error("{folder} is not the service's folder of jobs")]
    FolderDiffers {
        /// The worker's folder.
        folder: String,
    },
    /// The folder of a node is not the one of another node.
    #[error("{folder} is not the folder of jobs of node {node}, whose file is not there")]
    FolderNotShared {
        /// The folder of this node.
        folder: String,
        /// The other node.
        node: String,
    },
    /// The service is stopping.
    #[error("the service is stopping")]
    Draining,
    /// The store fails.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl JobError {
    /// Turns an error of the disk into one of the desk.
    pub(super) fn disk(what: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Disk { what, source: Arc::new(source) }
    }

    /// The stable code.
    pub fn code(&self) -> Code {
        match self {
            Self::Off => Code::JobsOff,
            Self::NotFound { .. } => Code::JobNotFound,
            Self::TooMany { .. }
            | Self::TooManyArriving { .. }
            | Self::TooManyArrivingOfTenant { .. } => Code::TooManyJobs,
            Self::TooManyUploads { .. } => Code::TooManyUploads,
            Self::FileTooLarge { .. } | Self::TooManyFiles { .. } => Code::JobTooLarge,
            Self::SpaceExhausted { .. } => Code::JobSpaceExhausted,
            Self::Quota(error) => error.code(),
            Self::InvalidOption { .. } => Code::InvalidField,
            Self::Configuration(error) => error.code(),
            Self::Frame(_) => Code::FrameUnavailable,
            Self::FormatNotBuilt { .. } => Code::FeatureNotBuilt,
            Self::GeoidMissing => Code::GeoidMissing,
            Self::Session(error) => error.code(),
            Self::Fetch { error, .. } => error.code(),
            Self::IdempotencyConflict { .. } => Code::IdempotencyConflict,
            Self::NotEnded { .. } => Code::JobNotEnded,
            Self::WithoutResult { .. } => Code::JobWithoutResult,
            Self::Disk { .. } => Code::JobFilesFailed,
            Self::Bucket(error) => error.code(),
            Self::UploadNotFound { .. } => Code::UploadNotFound,
            Self::UploadBusy { .. } => Code::UploadBusy,
            Self::UploadOffset { .. } => Code::UploadOffsetDiffers,
            Self::UploadTooLong { .. } => Code::UploadTooLong,
            Self::UploadIncomplete { .. } => Code::UploadIncomplete,
            Self::WorkerOnSqlite => Code::WorkerNeedsPostgres,
            Self::FolderDiffers { .. } | Self::FolderNotShared { .. } => Code::JobFolderDiffers,
            Self::Draining => Code::Draining,
            Self::Store(error) => error.code(),
        }
    }

    /// The delay before another attempt can succeed, where only time or a deletion helps: what
    /// has expired is removed every ten minutes.
    pub const fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::TooManyUploads { .. } | Self::SpaceExhausted { .. } => Some(EXPIRY),
            _ => None,
        }
    }

    /// The option at fault.
    pub const fn field(&self) -> Option<&'static str> {
        match self {
            Self::InvalidOption { field, .. } | Self::Fetch { field, .. } => Some(field),
            Self::UploadNotFound { .. } => Some("upload"),
            Self::Frame(_) => Some("options.overrides.frame"),
            Self::FormatNotBuilt { .. } => Some("options.format"),
            Self::GeoidMissing => Some("options.overrides.geoid"),
            _ => None,
        }
    }
}
