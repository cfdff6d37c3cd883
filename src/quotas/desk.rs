//! The quotas of a service: calls use them in memory, changes go to the store.

use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Duration;

use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use crate::clock::Clock;
use crate::store::{Author, Store, StoreError, TenantRow, TenantUse};
use crate::tenant::{Quotas, Tenant};

use super::meter::Rates;
use super::{Meter, QuotaError};

/// Interval at which changed quotas are read.
const REFRESH_INTERVAL: Duration = Duration::from_millis(400);
/// Interval at which sessions and bytes are counted for tenants with such a quota.
const COUNT_INTERVAL: Duration = Duration::from_secs(10);

/// The quotas of all tenants. All clones share them.
#[derive(Clone)]
pub struct TenantQuotas(Arc<Desk>);

struct Desk {
    store: Store,
    clock: Clock,
    meters: Meters,
    upkeep: Mutex<Option<JoinHandle<()>>>,
}

/// The meters of all tenants. All clones share them.
#[derive(Clone, Debug, Default)]
pub struct Meters(Arc<Registered>);

#[derive(Debug, Default)]
struct Registered {
    by_tenant: RwLock<HashMap<Tenant, Arc<Meter>>>,
    /// Number of the last change that was read.
    changed: AtomicI64,
}

/// A tenant with its quotas and its use.
#[derive(Clone, Debug, PartialEq)]
pub struct TenantInfo {
    /// The tenant.
    pub tenant: Tenant,
    /// When its first key was made, or its quotas were set (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// Its quotas.
    pub quotas: Quotas,
    /// Its recent use.
    pub rates: Rates,
    /// The amounts that it has stored; `None` if they cannot be counted.
    pub stored: Option<StoredAmounts>,
}

/// The amounts that a tenant has stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredAmounts {
    /// Its sessions, with their epochs and solutions.
    pub of_sessions: TenantUse,
    /// Bytes of the files of its jobs and uploads.
    pub job_bytes: u64,
}

impl Meters {
    /// The meter of a tenant.
    pub fn of(&self, tenant: &Tenant) -> Arc<Meter> {
        let known = self.0.by_tenant.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(meter) = known.get(tenant) {
            return meter.clone();
        }
        drop(known);
        let mut by_tenant = self.0.by_tenant.write().unwrap_or_else(PoisonError::into_inner);
        let new = || Arc::new(Meter::new(tenant.clone()));
        by_tenant.entry(tenant.clone()).or_insert_with(new).clone()
    }

    /// The meters of tenants that have quotas, or have called since the start.
    pub(crate) fn all(&self) -> Vec<Arc<Meter>> {
        let by_tenant = self.0.by_tenant.read().unwrap_or_else(PoisonError::into_inner);
        by_tenant.values().cloned().collect()
    }

    /// Reads the quotas that were set since the last read. If the amounts of a tenant cannot be
    /// counted, its quotas are in force with the amounts that are known.
    async fn refresh(&self, store: &Store) -> Result<(), StoreError> {
        for row in store.changed_tenants(self.0.changed.load(Ordering::Acquire)).await? {
            self.of(&row.tenant).set(row.quotas);
            self.0.changed.fetch_max(row.changed, Ordering::AcqRel);
            count(store, &self.of(&row.tenant)).await;
        }
        Ok(())
    }
}

impl TenantQuotas {
    /// Reads all quotas into `meters`, and follows their changes until it is closed or the process
    /// ends.
    ///
    /// # Errors
    /// The store fails.
    pub async fn open(store: Store, meters: Meters) -> Result<Self, StoreError> {
        meters.refresh(&store).await?;
        let upkeep = tokio::spawn(keep(store.clone(), meters.clone()));
        let (clock, upkeep) = (Clock::system(), Mutex::new(Some(upkeep)));
        Ok(Self(Arc::new(Desk { store, clock, meters, upkeep })))
    }

    /// Sets the quotas of a tenant, in force at once, as an act of `author`. The tenant exists from
    /// then on. `etag` is that of the quotas that the caller has read; `None` for any.
    ///
    /// # Errors
    /// The tenant has other quotas now, or the store fails.
    pub async fn set(
        &self,
        tenant: &Tenant,
        quotas: &Quotas,
        etag: Option<&str>,
        author: &Author,
    ) -> Result<TenantInfo, QuotaError> {
        let Desk { store, clock, meters, .. } = &*self.0;
        if !store.set_quotas(tenant, quotas, clock.unix_ms(), etag, author).await? {
            return Err(QuotaError::Changed { name: tenant.to_string() });
        }
        meters.refresh(store).await?;
        self.get(tenant).await
    }

    /// A tenant.
    ///
    /// # Errors
    /// It does not exist, or the store fails.
    pub async fn get(&self, tenant: &Tenant) -> Result<TenantInfo, QuotaError> {
        let row = self.0.store.tenant(tenant).await?;
        let name = tenant.to_string();
        Ok(self.info(row.ok_or(QuotaError::NotFound { name })?).await)
    }

    /// Up to `count` tenants in order of their names, after this name.
    ///
    /// # Errors
    /// The store fails.
    pub async fn list(&self, after: &str, count: usize) -> Result<Vec<TenantInfo>, QuotaError> {
        let mut list = Vec::new();
        for row in self.0.store.tenants(after, count as i64).await? {
            list.push(self.info(row).await);
        }
        Ok(list)
    }

    async fn info(&self, row: TenantRow) -> TenantInfo {
        let TenantRow { tenant, created_unix_ms, quotas, .. } = row;
        let stored = self.stored(&tenant).await;
        let stored = stored.inspect_err(|error| uncounted(&tenant, error)).ok();
        let rates = self.0.meters.of(&tenant).rates();
        TenantInfo { tenant, created_unix_ms, quotas, rates, stored }
    }

    async fn stored(&self, tenant: &Tenant) -> Result<StoredAmounts, StoreError> {
        let of_sessions = self.0.store.tenant_use(tenant).await?;
        let job_bytes = self.0.store.tenant_job_bytes(tenant).await?;
        Ok(StoredAmounts { of_sessions, job_bytes })
    }

    /// Stops following changes. After this the desk no longer uses the store on its own.
    pub(crate) async fn close(&self) {
        let upkeep = self.0.upkeep.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(upkeep) = upkeep {
            upkeep.abort();
            // Err: it was stopped, as intended.
            upkeep.await.ok();
        }
    }
}

impl fmt::Debug for TenantQuotas {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TenantQuotas").finish_non_exhaustive()
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        if let Some(upkeep) = self.upkeep.get_mut().unwrap_or_else(PoisonError::into_inner) {
            upkeep.abort();
        }
    }
}

/// Reads changed quotas and counts bytes until it is stopped.
async fn keep(store: Store, meters: Meters) {
    let (mut counted, mut is_current) = (Instant::now(), true);
    loop {
        sleep(REFRESH_INTERVAL).await;
        let was_current = is_current;
        is_current = match meters.refresh(&store).await {
            Ok(()) => true,
            Err(error) => {
                if was_current {
                    tracing::warn!(%error, "changes of quotas are not read; those known stay");
                }
                false
            }
        };
        if is_current && COUNT_INTERVAL <= counted.elapsed() {
            counted = Instant::now();
            for meter in meters.all() {
                count(&store, &meter).await;
            }
        }
    }
}

/// Counts in the store the amounts for which a tenant has a quota. If this fails, the last amounts
/// stay.
async fn count(store: &Store, meter: &Meter) {
    let (tenant, quotas) = (meter.tenant(), meter.quotas());
    if quotas.is_of_stored() {
        match store.tenant_use(tenant).await {
            Ok(stored) => meter.set_stored(stored),
            Err(error) => uncounted(tenant, &error),
        }
    }
    if quotas.job_bytes.is_some() {
        match store.tenant_job_bytes(tenant).await {
            Ok(bytes) => meter.set_job_bytes(bytes),
            Err(error) => uncounted(tenant, &error),
        }
    }
}

fn uncounted(tenant: &Tenant, error: &StoreError) {
    tracing::warn!(%tenant, %error, "what a tenant has stored is not counted");
}
