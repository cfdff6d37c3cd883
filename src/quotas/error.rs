//! Why a quota refuses a tenant's request, and why a change of quotas is refused.

use std::time::Duration;

use crate::refusal::Code;
use crate::store::StoreError;

/// Delay before a retry: jobs may be deleted or expire meanwhile.
const JOB_FILES_DELAY: Duration = Duration::from_secs(60);

/// A quota that is used up, or a change of quotas that is refused.
#[derive(Clone, Debug, thiserror::Error)]
pub enum QuotaError {
    /// The tenant stores as many sessions as its quota allows.
    #[error("sessions of the tenant: {used}, its quota is {limit}")]
    Sessions {
        /// Number of stored sessions.
        used: u64,
        /// Number allowed.
        limit: u64,
        /// The delay before another attempt makes sense.
        retry_after: Duration,
    },
    /// The tenant sends as many epochs a second as its quota allows.
    #[error("the tenant has sent {beyond:.0} epochs beyond its quota of {limit} a second")]
    Epochs {
        /// Epochs for which the quota has not made up.
        beyond: f64,
        /// Epochs a second that are allowed.
        limit: f64,
        /// The delay until epochs are taken again.
        retry_after: Duration,
    },
    /// The tenant has used as much processor time of the solvers as its quota allows.
    #[error(
        "the tenant has used {beyond:.1} s of processor time beyond its quota of {limit} s a minute"
    )]
    Cpu {
        /// Time for which the quota has not made up (s).
        beyond: f64,
        /// Time allowed within a minute (s).
        limit: f64,
        /// The delay until solvers are used again.
        retry_after: Duration,
    },
    /// The tenant stores as many bytes as its quota allows.
    #[error("the tenant has some {used} bytes stored, its quota is {limit}")]
    Stored {
        /// Bytes stored, approximately.
        used: u64,
        /// Bytes allowed.
        limit: u64,
        /// The delay before another attempt makes sense.
        retry_after: Duration,
    },
    /// The files of the tenant's jobs have as many bytes as its quota allows, or would have more.
    #[error("the files of the tenant's jobs have {used} bytes, its quota is {limit}")]
    JobFiles {
        /// Bytes of files, without those that are refused.
        used: u64,
        /// Bytes allowed.
        limit: u64,
    },
    /// No tenant has this name.
    #[error("there is no tenant {name:?}")]
    NotFound {
        /// The name as given.
        name: String,
    },
    /// The quotas have changed since the caller read them.
    #[error("tenant {name} has another etag: somebody has set its quotas")]
    Changed {
        /// Its name.
        name: String,
    },
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl QuotaError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Sessions { .. } => Code::SessionQuotaExceeded,
            Self::Epochs { .. } => Code::EpochQuotaExceeded,
            Self::Cpu { .. } => Code::CpuQuotaExceeded,
            Self::Stored { .. } => Code::StorageQuotaExceeded,
            Self::JobFiles { .. } => Code::JobStorageQuotaExceeded,
            Self::NotFound { .. } => Code::TenantNotFound,
            Self::Changed { .. } => Code::EtagMismatch,
            Self::Store(error) => error.code(),
        }
    }

    /// The delay before the next attempt; zero if waiting does not help.
    pub const fn retry_after(&self) -> Duration {
        match self {
            Self::Sessions { retry_after, .. }
            | Self::Epochs { retry_after, .. }
            | Self::Cpu { retry_after, .. }
            | Self::Stored { retry_after, .. } => *retry_after,
            Self::JobFiles { .. } => JOB_FILES_DELAY,
            Self::NotFound { .. } | Self::Changed { .. } | Self::Store(_) => Duration::ZERO,
        }
    }
}
