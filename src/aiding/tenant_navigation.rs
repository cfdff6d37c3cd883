//! Navigation data as one tenant sees and adds them.

use std::sync::Arc;

use crate::gnss::{Navigation, SatelliteId};
use crate::tenant::Tenant;

use super::navigation::{NavigationBroker, NavigationPush, NavigationStatus};
use super::trust::{AGREED, UPLOAD, tenant_source};
use super::{AidingError, PushedNavigation};

/// Name of a tenant's own data in its navigation status.
const OWN: &str = "own";
/// Name of the operator's data in the navigation status of other tenants.
const OPERATOR: &str = "operator";

/// The desk for navigation data, as one tenant sees it.
#[derive(Clone)]
pub struct TenantNavigation {
    broker: NavigationBroker,
    /// The tenant as a source; `None` for the operator.
    source: Option<Arc<str>>,
}

impl NavigationBroker {
    /// The desk as a tenant sees it.
    pub fn of(&self, tenant: &Tenant) -> TenantNavigation {
        TenantNavigation { broker: self.clone(), source: tenant_source(tenant) }
    }
}

impl TenantNavigation {
    /// The data that serve all sessions of the tenant now.
    pub fn current(&self) -> PushedNavigation {
        match &self.source {
            None => self.broker.current(),
            Some(source) => self.broker.current_for(source),
        }
    }

    /// Adds uploaded data. Those of the operator serve all sessions, those of another tenant its
    /// own.
    ///
    /// # Errors
    /// The push has more ephemerides of one satellite than are kept, or the store fails.
    pub async fn push(&self, pushed: Navigation) -> Result<NavigationPush, AidingError> {
        self.broker.push(pushed, self.source.as_deref().unwrap_or(UPLOAD)).await
    }

    /// The satellites with usable ephemerides, and the time that the ephemerides cover. Other
    /// tenants do not see the addresses of the operator's sources.
    pub fn status(&self) -> NavigationStatus {
        let Some(source) = &self.source else { return self.broker.status() };
        let mut status = self.broker.status_of(&self.current().navigation);
        let own = self.broker.own_satellites(source);
        for coverage in &mut status.satellites {
            let is_own = |satellite: &SatelliteId| *satellite == coverage.satellite;
            let shown = match &*coverage.source {
                _ if own.iter().any(is_own) => OWN,
                AGREED => AGREED,
                _ => OPERATOR,
            };
            coverage.source = shown.to_owned();
        }
        status
    }
}
