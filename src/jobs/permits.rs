//! The rights to upload files: a number in all, of which one tenant leaves a quarter to the others.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::tenant::Tenant;

use super::JobError;

/// The rights to upload. All clones share them.
#[derive(Clone)]
pub(super) struct Permits {
    most: usize,
    taken: Arc<Mutex<HashMap<Tenant, usize>>>,
}

/// One right to upload, until it is dropped.
pub(super) struct Permit {
    permits: Permits,
    tenant: Tenant,
}

impl Permits {
    /// This many rights.
    pub(super) fn new(most: usize) -> Self {
        Self { most, taken: Arc::default() }
    }

    /// Takes a right for a tenant.
    ///
    /// # Errors
    /// All are taken, or the tenant has as many as one may have.
    pub(super) fn take(&self, tenant: &Tenant) -> Result<Permit, JobError> {
        let mut taken = self.taken();
        let (all, of_tenant) = (taken.values().sum::<usize>(), taken.get(tenant).copied());
        if self.most <= all {
            return Err(JobError::TooManyArriving { limit: self.most });
        }
        let limit = self.of_tenant();
        if limit <= of_tenant.unwrap_or_default() {
            return Err(JobError::TooManyArrivingOfTenant { limit });
        }
        *taken.entry(tenant.clone()).or_default() += 1;
        Ok(Permit { permits: self.clone(), tenant: tenant.clone() })
    }

    /// Most rights of one tenant: one at least.
    const fn of_tenant(&self) -> usize {
        self.most - self.most / 4
    }

    fn taken(&self) -> MutexGuard<'_, HashMap<Tenant, usize>> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut taken = self.permits.taken();
        if let Some(count) = taken.get_mut(&self.tenant) {
            *count -= 1;
            if *count == 0 {
                taken.remove(&self.tenant);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_tenant_leaves_rights_to_others() {
        let (a, b) = (Tenant::parse("a").unwrap(), Tenant::parse("b").unwrap());
        let permits = Permits::new(8);
        let of_a: Vec<Permit> = (0..6).map(|_| permits.take(&a).ok().unwrap()).collect();
        let refused = permits.take(&a).err().unwrap();
        assert!(matches!(refused, JobError::TooManyArrivingOfTenant { limit: 6 }), "{refused}");
        let of_b: Vec<Permit> = (0..2).map(|_| permits.take(&b).ok().unwrap()).collect();
        let refused = permits.take(&b).err().unwrap();
        assert!(matches!(refused, JobError::TooManyArriving { limit: 8 }), "{refused}");
        drop(of_a);
        assert!(permits.take(&b).is_ok());
        drop(of_b);
        assert!(permits.taken().is_empty());
        let one = Permits::new(1);
        let taken = one.take(&a).ok().unwrap();
        assert!(one.take(&b).is_err());
        drop(taken);
    }
}
