//! The caller: who sends a request, and the desks as the caller's tenant sees them.
//!
//! Calls get a [`Caller`] and no [`Service`], so none of them reaches data of another tenant.
//! `tests/tidy` checks this.

use std::sync::Arc;

use tokio::sync::OwnedSemaphorePermit;

use crate::aiding::bases::{BaseFileLimits, TenantBases};
use crate::aiding::{AidingDesk, TenantNavigation};
use crate::clock::unix_ms;
use crate::config::Limits;
use crate::feeds::TenantFeeds;
use crate::jobs::Jobs;
use crate::keys::{Keys, Pass, Right, Rights};
use crate::quotas::TenantQuotas;
use crate::refusal::Code;
use crate::secrets::Secrets;
use crate::session::Sessions;
use crate::store::{Act, AuditEntry, AuditFilter, Author, Page, StoreError};
use crate::tenant::Tenant;
use crate::traces::Trace;

use super::audit::{ADMINISTRATIVE, author_of};
use super::places::Place;
use super::{Lease, Refusal, Service};

/// The sender of a request, and the service as the sender's tenant sees it.
#[derive(Clone)]
pub struct Caller {
    service: Service,
    pass: Pass,
    sessions: Sessions,
}

impl Service {
    /// The sender of the request that the present task serves.
    ///
    /// # Errors
    /// The sender is unknown: the call needs no key, or there is no request.
    pub(crate) fn caller(&self) -> Result<Caller, Refusal> {
        let lease = Lease::current();
        let pass = lease.as_ref().and_then(|lease| lease.pass().cloned());
        let pass = pass.ok_or_else(|| {
            Refusal::new(Code::KeyRequired, "nobody is known to have sent this request")
        })?;
        let trace = lease.as_ref().and_then(|lease| lease.trace().cloned());
        Ok(self.caller_of(pass, trace))
    }

    /// A caller within this process, while the service needs no key.
    ///
    /// # Errors
    /// The service has keys.
    pub fn without_key(&self) -> Result<Caller, Refusal> {
        Ok(self.caller_of(self.keys().admit(None, None)?, None))
    }

    fn caller_of(&self, pass: Pass, trace: Option<Arc<Trace>>) -> Caller {
        let sessions = self.sessions().of(pass.tenant()).traced(trace);
        Caller { service: self.clone(), pass, sessions }
    }
}

impl Caller {
    /// The tenant.
    pub(crate) fn tenant(&self) -> &Tenant {
        self.pass.tenant()
    }

    /// Id of the caller's key, for the log; `nobody's key` if no key is needed.
    pub(crate) fn key(&self) -> &str {
        self.pass.key().unwrap_or("nobody's key")
    }

    /// Checks that the caller is the operator.
    ///
    /// # Errors
    /// The key is of another tenant.
    pub(crate) fn check_operator(&self) -> Result<(), Refusal> {
        match self.tenant().is_operator() {
            true => Ok(()),
            false => {
                let message = "the call is for the operator, and the key is of another tenant";
                Err(Refusal::new(Code::OperatorOnly, message))
            }
        }
    }

    /// Checks that the caller's key has the right to read sessions.
    ///
    /// # Errors
    /// It does not have it.
    pub(super) fn check_reader(&self) -> Result<(), Refusal> {
        let has = self.pass.rights();
        if has.meets(Rights::of(&[Right::Read])) {
            return Ok(());
        }
        let message = format!("the key {} has {has}, and a session's epochs need read", self.key());
        Err(Refusal::new(Code::RightMissing, message))
    }

    /// Checks that a secret of the caller may be stored: it is encrypted, or the service needs no
    /// API key and so serves this machine only.
    ///
    /// # Errors
    /// The operator has given no key that encrypts secrets.
    pub(super) fn check_secret(&self, field: &'static str) -> Result<(), Refusal> {
        if self.secrets().key_id().is_some() || !self.service.keys().are_needed() {
            return Ok(());
        }
        let message = "the service has no key with which it could encrypt the secret";
        Err(Refusal::new(Code::SecretsKeyMissing, message).at(field))
    }

    /// The keys that encrypt secrets.
    pub(super) fn secrets(&self) -> &Secrets {
        self.service.sessions().store().secrets()
    }

    /// The sessions of the tenant.
    pub(crate) const fn sessions(&self) -> &Sessions {
        &self.sessions
    }

    /// The bases that the tenant sees.
    pub(crate) fn bases(&self) -> TenantBases<'_> {
        self.service.bases().of(self.tenant())
    }

    /// Limits of a file of a base.
    pub(crate) fn base_file_limits(&self) -> BaseFileLimits {
        self.service.bases().file_limits()
    }

    /// The navigation data of the tenant.
    pub(crate) fn navigation(&self) -> TenantNavigation {
        self.service.navigation().of(self.tenant())
    }

    /// The jobs of the tenant.
    pub(crate) fn jobs(&self) -> Jobs {
        self.service.jobs().of(self.tenant())
    }

    /// The API keys. Each of their calls names a tenant.
    pub(crate) fn keys(&self) -> &Keys {
        self.service.keys()
    }

    /// The quotas. Each of their calls names a tenant, except the list.
    pub(crate) fn quotas(&self) -> &TenantQuotas {
        self.service.quotas()
    }

    /// The data with which solutions are presented: frames of bases by their id, and the table of
    /// the geoid. A solution names only its own base, so this reveals nothing about other bases.
    pub(super) fn aiding(&self) -> &AidingDesk {
        self.service.aiding()
    }

    /// The streams and archives of the tenant.
    pub(crate) fn feeds(&self) -> TenantFeeds<'_> {
        self.service.feeds().of(self.tenant())
    }

    /// The limits in force.
    pub(crate) fn limits(&self) -> &Limits {
        self.service.limits()
    }

    /// Waits until another uploaded file may be read. The caller keeps the permit while it reads.
    pub(super) async fn file_reader(&self) -> OwnedSemaphorePermit {
        self.service.file_reader().await
    }

    /// The place of another stream. The stream keeps it until it ends.
    ///
    /// # Errors
    /// The limit of open streams is reached, in all or of the key.
    pub(super) fn stream_place(&self) -> Result<Place, Refusal> {
        self.service.stream_place(self.pass.key())
    }

    /// The place of another watch. The watch keeps it until it ends.
    ///
    /// # Errors
    /// The limit of open watches is reached, in all or of the key.
    pub(super) fn watch_place(&self) -> Result<Place, Refusal> {
        self.service.watch_place(self.pass.key())
    }

    /// Whether the service is about to stop.
    pub(crate) fn is_draining(&self) -> bool {
        self.service.is_draining()
    }

    /// Waits until the service is about to stop, or no longer exists.
    pub(crate) fn drained(&self) -> impl Future<Output = ()> + use<> {
        self.service.drained()
    }

    /// The caller as the author of the acts of this request.
    pub(super) fn author(&self) -> Author {
        let request = Lease::current().map(|lease| lease.request_id().to_string());
        author_of(&self.pass, request.unwrap_or_default(), self.service.node())
    }

    /// Like [`Self::author`], if the caller administers the service; `None` for a device.
    pub(super) fn administrator(&self) -> Option<Author> {
        self.pass.rights().meets(ADMINISTRATIVE).then(|| self.author())
    }

    /// The outcome of an act on this object. If it is refused, an entry is written.
    pub(super) async fn noted<T>(
        &self,
        call: &'static str,
        object: &str,
        outcome: Result<T, Refusal>,
    ) -> Result<T, Refusal> {
        if let Err(refusal) = &outcome
            && let Some(author) = self.administrator()
        {
            let entry = self.service.refused_act(author, call, object, refusal);
            self.service.note_refused(entry).await;
        }
        outcome
    }

    /// Writes the entry of an act that is done, for an act with several transactions.
    ///
    /// # Errors
    /// The store fails. The act is done, and can be repeated.
    pub(super) async fn note(&self, call: &'static str, change: String) -> Result<(), StoreError> {
        let act = Act { call, tenant: self.tenant(), object: "", change };
        self.service.sessions().store().note(&self.author().does(act, unix_ms())).await
    }

    /// A page of the audit log of the caller's tenant. The operator reads the tenant of the filter,
    /// or all tenants.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub(super) async fn audit(
        &self,
        filter: AuditFilter,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<AuditEntry>, StoreError> {
        let own = Some(self.tenant().clone()).filter(|tenant| !tenant.is_operator());
        let tenant = own.clone().or(filter.tenant);
        let filter = AuditFilter { tenant, reader: own, ..filter };
        self.service.sessions().store().audit(&filter, page_size, page_token).await
    }
}
