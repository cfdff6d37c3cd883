//! The bytes that a tenant may still add to the files of its jobs.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::quotas::QuotaError;
use crate::tenant::Tenant;

use super::JobError;
use super::state::Desk;

/// The bytes of files that a tenant has and may have, as read when an upload begins. Bytes that
/// other uploads add meanwhile count only for later uploads.
#[derive(Debug)]
pub(super) struct Allowance {
    used: AtomicU64,
    /// Most bytes; `None` for no limit.
    limit: Option<u64>,
}

impl Desk {
    /// The bytes that the files of a tenant's jobs may still take.
    ///
    /// # Errors
    /// The tenant has used its quota, or the store fails.
    pub(super) async fn allowance(&self, tenant: &Tenant) -> Result<Allowance, JobError> {
        let Some(limit) = self.meters.of(tenant).quotas().job_bytes else {
            return Ok(Allowance::unlimited());
        };
        let used = self.store.tenant_job_bytes(tenant).await?;
        if limit <= used {
            return Err(QuotaError::JobFiles { used, limit }.into());
        }
        Ok(Allowance { used: AtomicU64::new(used), limit: Some(limit) })
    }
}

impl Allowance {
    pub(super) const fn unlimited() -> Self {
        Self { used: AtomicU64::new(0), limit: None }
    }

    /// Takes bytes of the allowance.
    ///
    /// # Errors
    /// Fewer bytes are left.
    pub(super) fn take(&self, bytes: u64) -> Result<(), JobError> {
        let Some(limit) = self.limit else { return Ok(()) };
        let add = |used: u64| used.checked_add(bytes).filter(|used| *used <= limit);
        let taken = self.used.fetch_update(Ordering::AcqRel, Ordering::Acquire, add);
        taken.map(drop).map_err(|used| QuotaError::JobFiles { used, limit }.into())
    }

    /// Gives bytes back that did not become a file.
    pub(super) fn give_back(&self, bytes: u64) {
        if self.limit.is_some() {
            self.used.fetch_sub(bytes, Ordering::AcqRel);
        }
    }
}
