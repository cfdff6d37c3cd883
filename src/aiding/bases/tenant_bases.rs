//! Bases as one tenant sees and changes them.
//!
//! A tenant has its own bases. It also sees and uses the operator's, but cannot change them. Two
//! kinds of the operator's bases would reveal where rovers of others are, so they are hidden. Bases
//! that follow their rovers serve only the operator's sessions. Bases that a network connects on
//! demand are used as the nearest base, but neither listed nor named.

use std::sync::Arc;

use crate::aiding::AidingError;
use crate::gnss::{BaseSite, Epoch};
use crate::store::{Author, BaseChoice, BaseName, NamedRequest, StoredBaseEpoch};
use crate::tenant::Tenant;

use super::base::Base;
use super::broker::BaseBroker;
use super::candidates::Candidates;
use super::{BaseId, BaseInfo, BasePush, NewBase};

/// The desk for base stations, as one tenant sees it.
#[derive(Clone, Copy)]
pub struct TenantBases<'a> {
    broker: &'a BaseBroker,
    tenant: &'a Tenant,
}

impl BaseBroker {
    /// The desk as a tenant sees it.
    pub const fn of<'a>(&'a self, tenant: &'a Tenant) -> TenantBases<'a> {
        TenantBases { broker: self, tenant }
    }
}

impl TenantBases<'_> {
    /// Creates a base of the tenant, as an act of `author`. Returns the base, and whether it is
    /// new: a repetition of a named request returns the base that the first one has created.
    ///
    /// # Errors
    /// As for [`BaseBroker::create`]; or a request with this name had other content.
    pub async fn create(
        &self,
        new: NewBase,
        request: Option<NamedRequest>,
        author: &Author,
    ) -> Result<(BaseInfo, bool), AidingError> {
        self.broker.create_for(self.tenant, new, request, Some(author)).await
    }

    /// A base with its health.
    ///
    /// # Errors
    /// The tenant sees no base with this id.
    pub async fn get(&self, id: &BaseId) -> Result<BaseInfo, AidingError> {
        self.visible(id)?;
        self.broker.get(id).await
    }

    /// Every base that the tenant sees, with its health, in order of id.
    pub async fn list(&self) -> Vec<BaseInfo> {
        self.broker.infos(|base| self.sees(base)).await
    }

    /// The name under which sessions store the base of this id.
    ///
    /// # Errors
    /// The tenant sees no base with this id.
    pub(crate) fn name(&self, id: &BaseId) -> Result<BaseName, AidingError> {
        Ok(self.visible(id)?.name().clone())
    }

    /// Whether one of the bases of a session states the frame of its coordinates.
    pub(crate) fn states_frame(&self, choice: &BaseChoice) -> bool {
        let states = |base: &BaseName| self.broker.frame(&base.id).is_some();
        match choice {
            BaseChoice::None => false,
            BaseChoice::One(base) => states(base),
            BaseChoice::NearestOf(bases) => bases.iter().any(states),
            BaseChoice::Nearest => {
                self.usable().iter().any(|base| base.description.frame.is_some())
            }
        }
    }

    /// All bases from which the tenant's sessions may choose the nearest.
    pub(crate) fn candidates(&self) -> Candidates {
        Candidates::new(self.usable())
    }

    /// Deletes a base of the tenant, as an act of `author`.
    ///
    /// # Errors
    /// The tenant has no base with this id, an open session uses it, or the store fails.
    pub async fn delete(&self, id: &BaseId, author: &Author) -> Result<(), AidingError> {
        self.check_own(id)?;
        self.broker.delete_by(id, Some(author)).await
    }

    /// Stores epochs of a base of the tenant.
    ///
    /// # Errors
    /// The tenant has no base with this id, or as of [`BaseBroker::push`].
    pub async fn push(&self, id: &BaseId, epochs: Vec<Epoch>) -> Result<BasePush, AidingError> {
        self.check_own(id)?;
        self.broker.push(id, epochs).await
    }

    /// Stores the epochs of a file of a base of the tenant.
    ///
    /// # Errors
    /// The tenant has no base with this id, or as of [`BaseBroker::upload`].
    pub async fn upload(
        &self,
        id: &BaseId,
        epochs: Vec<StoredBaseEpoch>,
        header_site: Option<&BaseSite>,
    ) -> Result<BasePush, AidingError> {
        self.check_own(id)?;
        self.broker.upload(id, epochs, header_site).await
    }

    /// Checks that a base may be changed by the tenant.
    ///
    /// # Errors
    /// The tenant sees no base with this id, or it is the operator's.
    pub fn check_own(&self, id: &BaseId) -> Result<(), AidingError> {
        match self.visible(id)?.description.tenant == *self.tenant {
            true => Ok(()),
            false => Err(AidingError::BaseOfOperator { id: id.to_string() }),
        }
    }

    /// Whether there is a base that the tenant's sessions may choose as the nearest.
    pub(crate) fn has_usable(&self) -> bool {
        self.broker.read().values().any(|base| self.may_use(base))
    }

    /// All bases that the tenant's sessions may choose as the nearest.
    pub(super) fn usable(&self) -> Vec<Arc<Base>> {
        self.broker.read().values().filter(|base| self.may_use(base)).cloned().collect()
    }

    pub(super) fn visible(&self, id: &BaseId) -> Result<Arc<Base>, AidingError> {
        let base = self.broker.base(id).ok().filter(|base| self.sees(base));
        base.ok_or_else(|| AidingError::BaseNotFound { id: id.to_string() })
    }

    fn sees(&self, base: &Base) -> bool {
        let feed = base.description.feed.as_ref();
        let is_own = base.description.tenant == *self.tenant;
        is_own || (self.may_use(base) && !feed.is_some_and(|feed| feed.is_on_demand))
    }

    fn may_use(&self, base: &Base) -> bool {
        let owner = &base.description.tenant;
        let feed = base.description.feed.as_ref();
        let is_shared = owner.is_operator() && !feed.is_some_and(|feed| feed.follows_rover);
        owner == self.tenant || is_shared
    }
}
