//! The use of one tenant, compared with its quotas.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::store::TenantUse;
use crate::tenant::{Quotas, Tenant};

use super::QuotaError;
use super::window::{Excess, Window};

/// Time over which the rate of epochs is averaged (s). The epochs of this time may come at once.
pub(super) const EPOCHS_WINDOW_S: f64 = 10.0;
/// Time over which the processor time of the solvers is summed (s).
pub(super) const CPU_WINDOW_S: f64 = 60.0;
/// Delay before a retry: sessions may be deleted, or their epochs expire, meanwhile.
const STORED_DELAY: Duration = Duration::from_secs(60);

/// The use of a tenant and its quotas. All desks that work for the tenant share it.
#[derive(Debug)]
pub struct Meter {
    tenant: Tenant,
    begun: Instant,
    inner: Mutex<Inner>,
    /// Locked while a session is created, so that their number never exceeds the quota.
    creating: tokio::sync::Mutex<()>,
}

#[derive(Debug)]
struct Inner {
    quotas: Quotas,
    epochs: Window,
    cpu_s: Window,
    /// The amount that it had stored at the last count.
    stored: Option<TenantUse>,
    /// Bytes of the files of its jobs at the last count.
    job_bytes: Option<u64>,
}

/// The recent use of a tenant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Epochs a second, over ten seconds.
    pub epochs_per_s: f64,
    /// Processor time of the solvers in the last minute (s).
    pub cpu_s_per_minute: f64,
}

impl Meter {
    pub(super) fn new(tenant: Tenant) -> Self {
        let (epochs, cpu_s) = (Window::new(EPOCHS_WINDOW_S), Window::new(CPU_WINDOW_S));
        let (quotas, stored, job_bytes) = (Quotas::default(), None, None);
        Self {
            tenant,
            begun: Instant::now(),
            inner: Mutex::new(Inner { quotas, epochs, cpu_s, stored, job_bytes }),
            creating: tokio::sync::Mutex::new(()),
        }
    }

    /// The tenant.
    pub const fn tenant(&self) -> &Tenant {
        &self.tenant
    }

    /// Its quotas.
    pub fn quotas(&self) -> Quotas {
        self.lock().quotas
    }

    pub(super) fn set(&self, quotas: Quotas) {
        let (mut inner, now_s) = (self.lock(), self.now_s());
        inner.quotas = quotas;
        let in_window = |rate: f64| rate * EPOCHS_WINDOW_S;
        inner.epochs.allow(quotas.epochs_per_s.map(in_window), now_s);
        let in_window = |rate: f64| rate * (CPU_WINDOW_S / 60.0);
        inner.cpu_s.allow(quotas.cpu_s_per_minute.map(in_window), now_s);
    }

    pub(super) fn set_stored(&self, stored: TenantUse) {
        self.lock().stored = Some(stored);
    }

    /// The amount that it had stored at the last count, at most ten seconds ago; `None` if it has
    /// no quota of sessions or bytes.
    pub(crate) fn stored(&self) -> Option<TenantUse> {
        let inner = self.lock();
        inner.stored.filter(|_| inner.quotas.is_of_stored())
    }

    pub(super) fn set_job_bytes(&self, bytes: u64) {
        self.lock().job_bytes = Some(bytes);
    }

    /// Bytes of the files of its jobs and uploads at the last count, at most ten seconds ago;
    /// `None` if it has no quota of them.
    pub(crate) fn job_bytes(&self) -> Option<u64> {
        let inner = self.lock();
        inner.job_bytes.filter(|_| inner.quotas.job_bytes.is_some())
    }

    /// Its recent use.
    pub fn rates(&self) -> Rates {
        let (mut inner, now_s) = (self.lock(), self.now_s());
        Rates {
            epochs_per_s: inner.epochs.used(now_s) / EPOCHS_WINDOW_S,
            cpu_s_per_minute: inner.cpu_s.used(now_s) * (60.0 / CPU_WINDOW_S),
        }
    }

    /// Checks whether new epochs would be admitted now.
    ///
    /// # Errors
    /// The tenant has used up a quota.
    pub fn check_epochs(&self) -> Result<(), QuotaError> {
        let (mut inner, now_s) = (self.lock(), self.now_s());
        inner.check_epochs(now_s)
    }

    /// Admits and counts new epochs if the tenant is within its quotas. Their number may exceed
    /// what is left; the next epochs then have to wait longer.
    ///
    /// # Errors
    /// The tenant has used up a quota. Nothing is counted.
    pub fn admit_epochs(&self, epochs: usize) -> Result<(), QuotaError> {
        let (mut inner, now_s) = (self.lock(), self.now_s());
        inner.check_epochs(now_s)?;
        inner.epochs.add(epochs as f64, now_s);
        Ok(())
    }

    /// Counts epochs that are taken after a check.
    pub fn count_epochs(&self, epochs: usize) {
        let (mut inner, now_s) = (self.lock(), self.now_s());
        inner.epochs.add(epochs as f64, now_s);
    }

    /// Admits a computation that is not stored.
    ///
    /// # Errors
    /// The tenant has used up its processor time of the solvers.
    pub fn admit_computation(&self) -> Result<(), QuotaError> {
        let (mut inner, now_s) = (self.lock(), self.now_s());
        inner.check_cpu(now_s)
    }

    /// The delay until the tenant may use solvers again; zero if it may now.
    pub fn computation_delay(&self) -> Duration {
        match self.admit_computation() {
            Err(QuotaError::Cpu { retry_after, .. }) => retry_after,
            _ => Duration::ZERO,
        }
    }

    /// Waits until no other session of the tenant is being created. Returns a guard and the most
    /// sessions allowed, or `None` without a limit. The next caller waits until the guard is
    /// dropped.
    pub async fn creating_session(&self) -> Option<(tokio::sync::MutexGuard<'_, ()>, u64)> {
        let limit = self.quotas().sessions?;
        Some((self.creating.lock().await, limit))
    }

    /// Counts processor time of the solvers.
    pub fn count_cpu(&self, time: Duration) {
        let (mut inner, now_s) = (self.lock(), self.now_s());
        inner.cpu_s.add(time.as_secs_f64(), now_s);
    }

    fn now_s(&self) -> f64 {
        self.begun.elapsed().as_secs_f64()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn check_epochs(&mut self, now_s: f64) -> Result<(), QuotaError> {
        if let (Some(limit), Some(Excess { beyond, delay })) =
            (self.quotas.epochs_per_s, self.epochs.excess(now_s))
        {
            return Err(QuotaError::Epochs { beyond, limit, retry_after: delay });
        }
        if let Some(limit) = self.quotas.stored_bytes {
            let used = self.stored.map_or(0, |stored| stored.stored_bytes);
            if limit <= used {
                return Err(QuotaError::Stored { used, limit, retry_after: STORED_DELAY });
            }
        }
        self.check_cpu(now_s)
    }

    fn check_cpu(&mut self, now_s: f64) -> Result<(), QuotaError> {
        match (self.quotas.cpu_s_per_minute, self.cpu_s.excess(now_s)) {
            (Some(limit), Some(Excess { beyond, delay })) => {
                Err(QuotaError::Cpu { beyond, limit, retry_after: delay })
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    fn meter(quotas: Quotas) -> Meter {
        let meter = Meter::new(Tenant::operator());
        meter.set(quotas);
        meter
    }

    #[test]
    fn without_quotas_everything_is_admitted() {
        let meter = meter(Quotas::default());
        meter.admit_epochs(1_000_000).unwrap();
        meter.count_cpu(Duration::from_secs(1_000_000));
        meter.set_stored(TenantUse { sessions: 1, stored_bytes: u64::MAX });
        meter.check_epochs().unwrap();
        assert_eq!(meter.computation_delay(), Duration::ZERO);
    }

    #[test]
    fn each_quota_is_named_with_limit_and_delay() {
        let refused = |quotas: Quotas| {
            let meter = meter(quotas);
            meter.admit_epochs(1000).unwrap();
            meter.count_cpu(Duration::from_secs(90));
            meter.set_stored(TenantUse { sessions: 1, stored_bytes: 1000 });
            meter.check_epochs().unwrap_err();
            meter.admit_epochs(1).unwrap_err()
        };
        let none = Quotas::default();
        for (quotas, code, longest_s) in [
            (Quotas { epochs_per_s: Some(10.0), ..none }, Code::EpochQuotaExceeded, 90),
            (Quotas { cpu_s_per_minute: Some(30.0), ..none }, Code::CpuQuotaExceeded, 120),
            (Quotas { stored_bytes: Some(1000), ..none }, Code::StorageQuotaExceeded, 60),
        ] {
            let error = refused(quotas);
            assert_eq!(error.code(), code);
            let delay = error.retry_after();
            assert!(!delay.is_zero() && delay <= Duration::from_secs(longest_s), "{delay:?}");
        }
        // A quota that is set later counts at once, and so does its removal.
        let meter = meter(none);
        meter.admit_epochs(1000).unwrap();
        meter.set(Quotas { epochs_per_s: Some(10.0), ..none });
        meter.check_epochs().unwrap_err();
        meter.set(none);
        meter.check_epochs().unwrap();
    }
}
