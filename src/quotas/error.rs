//! Why a tenant's request is refused, and why a change of its quotas is.

use std::time::Duration;

use crate::refusal::Code;
use crate::store::StoreError;

/// Delay after which jobs may have been deleted, or have expired.
const JOB_FILES_DELAY: Duration = Duration::from_secs(60);

/// A quota that a tenant has used.
#[derive(Clone, Debug, thiserror::Error)]
pub enum QuotaError {
    /// As many sessions as allowed are stored.
    #[error("the tenant has {used} sessions, its quota is {limit}")]
    Sessions {
        /// Number of stored sessions.
        used: u64,
        /// Number allowed.
        limit: u64,
        /// The delay before another attempt makes sense.
        retry_after: Duration,
    },
    /// As many epochs have come as allowed.
    #[error("the tenant sends {used:.1} epochs a second, its quota is {limit}")]
    Epochs {
        /// Epochs a second.
        used: f64,
        /// Epochs a second that are allowed.
        limit: f64,
        /// The delay until epochs are taken again.
        retry_after: Duration,
    },
    /// As much time of solvers is used as allowed.
    #[error(
        "the tenant has used {used:.1} s of processor time in a minute, its quota is {limit} s"
    )]
    Cpu {
        /// Time used within a minute (s).
        used: f64,
        /// Time allowed within a minute (s).
        limit: f64,
        /// The delay until solvers are used again.
        retry_after: Duration,
    },
    /// As much is stored as allowed.
    #[error("the tenant has some {used} bytes stored, its quota is {limit}")]
    Stored {
        /// Bytes stored, approximately.
        used: u64,
        /// Bytes allowed.
        limit: u64,
        /// The delay before another attempt makes sense.
        retry_after: Duration,
    },
    /// The files of jobs take as many bytes as allowed, or would take more.
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

    /// The delay before the next attempt; zero where time changes nothing.
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
