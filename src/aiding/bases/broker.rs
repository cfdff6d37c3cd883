//! The desk for base stations: creates them, takes their epochs, and gives sessions views of them.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use crate::aiding::{AidingError, AidingLimits, Antennas, NavigationBroker};
use crate::clock::unix_ms;
use crate::gnss::{BaseSite, CoordinateFrame, Ecef, GpsTime};
use crate::store::{
    Act, Author, BaseFeed, BaseKey, BaseName, BaseRow, BaseUse, NamedRequest, NewBaseRow, Store,
    StoreError, StoredBaseEpoch,
};
use crate::tenant::Tenant;

use super::base::{Base, BaseDescription};
use super::base_epochs::BaseEpochs;
use super::candidates::Candidates;
use super::check::PositionChecks;
use super::nearest_requests::NearestBaseRequests;
use super::{BaseFileLimits, BaseId, BaseInfo, BaseView, Coverage, NewBase};

/// Number of the newest epochs with which a position is checked on request.
const CHECKED_EPOCHS: usize = 20;

/// The desk for base stations. All clones share the same bases.
#[derive(Clone)]
pub struct BaseBroker {
    pub(super) store: Store,
    pub(super) navigation: NavigationBroker,
    pub(super) antennas: Antennas,
    pub(super) limits: AidingLimits,
    bases: Arc<RwLock<BTreeMap<BaseId, Arc<Base>>>>,
    /// Locked while a base is created, so that the number of bases never exceeds the limit, and
    /// while this node reads the bases that another node has stored.
    pub(super) creating: Arc<tokio::sync::Mutex<Creating>>,
    nearest_base_requests: NearestBaseRequests,
}

/// State that a creation leaves for the next one.
#[derive(Default)]
pub(super) struct Creating {
    /// The last creation did not end well. Its base may be stored although the memory does not
    /// contain it.
    is_unconfirmed: bool,
}

impl BaseBroker {
    /// Opens the desk with the stored bases and all their epochs.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub(crate) async fn open(
        store: Store,
        navigation: NavigationBroker,
        antennas: Antennas,
        limits: AidingLimits,
    ) -> Result<Self, AidingError> {
        let mut bases = BTreeMap::new();
        for row in store.bases().await? {
            let id = stored_id(&row)?;
            let (epochs, stored_unix_ms) = store.base_epochs(row.key).await?;
            bases.insert(id, Arc::new(stored_base(row, epochs, stored_unix_ms)));
        }
        let bases = Arc::new(RwLock::new(bases));
        let (creating, nearest_base_requests) = Default::default();
        Ok(Self { store, navigation, antennas, limits, bases, creating, nearest_base_requests })
    }

    /// Creates a base of the operator and stores it.
    ///
    /// # Errors
    /// There are as many bases as allowed, the label is too long, the antenna is not calibrated, or
    /// the store fails.
    pub async fn create(&self, new: NewBase) -> Result<BaseInfo, AidingError> {
        Ok(self.create_for(&Tenant::operator(), new, None, None).await?.0)
    }

    /// Creates a base of a tenant, as an act of `author`. Returns the base, and whether it is new:
    /// a repetition of a named request returns the base that the first one has created.
    ///
    /// # Errors
    /// As for [`Self::create`]; or a request with this name had other content.
    pub(super) async fn create_for(
        &self,
        tenant: &Tenant,
        mut new: NewBase,
        request: Option<NamedRequest>,
        author: Option<&Author>,
    ) -> Result<(BaseInfo, bool), AidingError> {
        let mut creating = self.creating.lock().await;
        if creating.is_unconfirmed {
            self.read_created().await?;
            creating.is_unconfirmed = false;
        }
        if let Some(request) = &request
            && let Some(base) = self.created_by(tenant, &request.name)
        {
            let is_same = base.description.request.as_ref() == Some(request);
            let id = base.name().id.to_string();
            return match is_same {
                true => Ok((base.info(), false)),
                false => Err(AidingError::RequestConflict { id }),
            };
        }
        self.check_new(&new)?;
        new.site = new.site.map(|site| self.antennas.of_new_base(&site)).transpose()?;
        let (id, now) = (BaseId::random(), unix_ms());
        let row = NewBaseRow {
            tenant,
            id: id.as_str(),
            label: &new.label,
            site: new.site.as_ref(),
            feed: new.feed.as_ref(),
            archive: new.archive.as_deref(),
            created_unix_ms: now,
            request: request.as_ref(),
            frame: new.frame,
        };
        let entry = author.map(|author| {
            let (object, change) = (id.as_str(), described(&row));
            author.does(Act { call: "Bases.Create", tenant, object, change }, now)
        });
        creating.is_unconfirmed = true;
        let key = match self.store.create_base(&row, entry.as_ref()).await {
            Ok(key) => key,
            Err(error) => {
                // If only the answer to the commit was lost, the base is stored.
                self.read_created().await.map_err(|_| error.clone())?;
                let stored = self.base(&id).map_err(|_| error)?;
                creating.is_unconfirmed = false;
                return Ok((stored.info(), true));
            }
        };
        creating.is_unconfirmed = false;
        let sites = new.site.map(|site| (1, site)).into_iter().collect();
        let description = BaseDescription {
            name: BaseName { key, id: id.as_str().into() },
            tenant: tenant.clone(),
            label: new.label,
            created_unix_ms: now,
            feed: new.feed,
            archive: new.archive,
            request,
            frame: new.frame,
        };
        let base = Arc::new(Base::new(description, BaseEpochs::new(sites, Vec::new(), None)));
        self.write().insert(id, base.clone());
        Ok((base.info(), true))
    }

    /// Checks that a base may be created.
    fn check_new(&self, new: &NewBase) -> Result<(), AidingError> {
        let (length, limit) = (new.label.chars().count(), self.limits.label_characters);
        if limit < length {
            return Err(AidingError::LabelTooLong { length, limit });
        }
        let limit = self.limits.bases;
        if limit <= self.read().len() {
            return Err(AidingError::TooManyBases { limit });
        }
        Ok(())
    }

    /// Reads bases that are stored and not in memory, after a creation with an unknown outcome.
    async fn read_created(&self) -> Result<(), AidingError> {
        // A base that is deleted meanwhile is known here, so it is not added again.
        let known = self.ids();
        for row in self.store.bases().await? {
            let id = stored_id(&row)?;
            if known.binary_search(&id).is_err() {
                self.write().insert(id, Arc::new(stored_base(row, Vec::new(), None)));
            }
        }
        Ok(())
    }

    /// The base that a tenant's request with this name has created.
    fn created_by(&self, tenant: &Tenant, request: &str) -> Option<Arc<Base>> {
        let is_it = |base: &&Arc<Base>| {
            let BaseDescription { tenant: of, request: by, .. } = &base.description;
            of == tenant && by.as_ref().is_some_and(|by| by.name == request)
        };
        self.read().values().find(is_it).cloned()
    }

    /// A base with its health.
    ///
    /// # Errors
    /// No base has this id.
    pub async fn get(&self, id: &BaseId) -> Result<BaseInfo, AidingError> {
        let base = self.base(id)?;
        self.check_stored(&base).await;
        Ok(base.info())
    }

    /// Every base with its health, in order of id.
    pub async fn list(&self) -> Vec<BaseInfo> {
        self.infos(|_| true).await
    }

    /// The bases for which `is_asked` is true, with their health.
    pub(super) async fn infos(&self, is_asked: impl Fn(&Base) -> bool + Send) -> Vec<BaseInfo> {
        let bases: Vec<Arc<Base>> = {
            let bases = self.read();
            bases.values().filter(|base| is_asked(base)).cloned().collect()
        };
        let mut list = Vec::with_capacity(bases.len());
        for base in bases {
            self.check_stored(&base).await;
            list.push(base.info());
        }
        list
    }

    /// The name under which sessions store the base of this id.
    ///
    /// # Errors
    /// No base has this id.
    pub(crate) fn name(&self, id: &BaseId) -> Result<BaseName, AidingError> {
        Ok(self.base(id)?.name().clone())
    }

    /// The id of the base of this key, if it still exists.
    pub(crate) fn id_of(&self, key: BaseKey) -> Option<Arc<str>> {
        Some(self.of_key(key)?.name().id.clone())
    }

    /// The frame of the coordinates of the base of this id, if both are known.
    pub(crate) fn frame(&self, id: &str) -> Option<CoordinateFrame> {
        self.base(&BaseId::parse(id)?).ok()?.description.frame
    }

    /// Every base, by id.
    pub(crate) fn ids(&self) -> Vec<BaseId> {
        self.read().keys().cloned().collect()
    }

    /// Every base that is filled by a caster's stream, with the tenant that owns it.
    pub(crate) fn feeds(&self) -> Vec<(BaseId, Tenant, BaseFeed)> {
        let bases = self.read();
        let fed = bases
            .iter()
            .filter_map(|(id, base)| Some((id.clone(), base, base.description.feed.clone()?)));
        fed.map(|(id, base, feed)| (id, base.description.tenant.clone(), feed)).collect()
    }

    /// Every base that is filled from an archive, with the tenant that owns it and the template of
    /// the archive's file addresses.
    pub(crate) fn archives(&self) -> Vec<(BaseId, Tenant, String)> {
        let bases = self.read();
        let filled = bases
            .iter()
            .filter_map(|(id, base)| Some((id.clone(), base, base.description.archive.clone()?)));
        filled.map(|(id, base, of)| (id, base.description.tenant.clone(), of)).collect()
    }

    /// The start of every quarter of an hour for which a rover has needed the base within a day, in
    /// order of time.
    ///
    /// # Errors
    /// No base has this id.
    pub(crate) fn requested_times(&self, id: &BaseId) -> Result<Vec<GpsTime>, AidingError> {
        Ok(self.base(id)?.archive_requests.starts(unix_ms()))
    }

    /// Waits until a rover needs the base at a time that was not yet requested.
    ///
    /// # Errors
    /// No base has this id.
    pub(crate) async fn wait_for_request(&self, id: &BaseId) -> Result<(), AidingError> {
        let base = self.base(id)?;
        base.archive_requests.wait_for_new().await;
        Ok(())
    }

    /// Whether the epochs of the span from `from` until before `until` are stored.
    ///
    /// # Errors
    /// No base has this id.
    pub(crate) fn coverage(
        &self,
        id: &BaseId,
        from: GpsTime,
        until: GpsTime,
    ) -> Result<Coverage, AidingError> {
        Ok(self.base(id)?.stored().coverage(from, until))
    }

    /// Limits of a file of a base.
    pub(crate) const fn file_limits(&self) -> BaseFileLimits {
        BaseFileLimits {
            epochs: self.limits.epochs_per_base,
            bytes: self.limits.bytes_per_base,
            observations_per_epoch: self.limits.observations_per_epoch,
        }
    }

    /// Position and antenna of a base at its newest epoch; `None` while unknown.
    ///
    /// # Errors
    /// No base has this id.
    pub fn site(&self, id: &BaseId) -> Result<Option<BaseSite>, AidingError> {
        Ok(self.base(id)?.stored().site().cloned())
    }

    /// Records where a rover is, for casters that compute a stream for the rover's position.
    pub(crate) fn record_rover(&self, base: BaseKey, position: Ecef) {
        if let Some(base) = self.of_key(base) {
            *base.rover() = Some((position, unix_ms()));
        }
    }

    /// The last position of a rover that used this base since the service started.
    pub(crate) fn rover(&self, id: &BaseId) -> Option<Ecef> {
        let rover = *self.base(id).ok()?.rover();
        rover.map(|(position, _)| position)
    }

    /// When a rover was last positioned against this base since the service started (ms since
    /// 1970-01-01 UTC).
    pub(crate) fn used_unix_ms(&self, id: &BaseId) -> Option<i64> {
        let rover = *self.base(id).ok()?.rover();
        rover.map(|(_, unix_ms)| unix_ms)
    }

    /// The rovers that ask for the nearest of all bases.
    pub(crate) const fn nearest_base_requests(&self) -> &NearestBaseRequests {
        &self.nearest_base_requests
    }

    /// Deletes a base with its epochs.
    ///
    /// # Errors
    /// No base has this id, an open session uses it, or the store fails.
    pub async fn delete(&self, id: &BaseId) -> Result<(), AidingError> {
        self.delete_by(id, None).await
    }

    /// Like [`Self::delete`], as an act of `author`.
    ///
    /// # Errors
    /// As for [`Self::delete`].
    pub(super) async fn delete_by(
        &self,
        id: &BaseId,
        author: Option<&Author>,
    ) -> Result<(), AidingError> {
        let base = self.base(id)?;
        let _turn = base.pushing.lock().await;
        let BaseDescription { tenant, label, .. } = &base.description;
        let now = unix_ms();
        let entry = author.map(|author| {
            let (object, change) = (id.as_str(), format!("label {label:?}"));
            author.does(Act { call: "Bases.Delete", tenant, object, change }, now)
        });
        let key = base.name().key;
        match self.store.delete_base(key, now, entry.as_ref()).await {
            Ok(true) => {}
            Ok(false) => return Err(AidingError::BaseInUse { id: id.to_string() }),
            Err(error) => {
                // If only the answer to the commit was lost, the base is no longer stored.
                base.stored().outdated = true;
                let stored = self.store.bases().await.map_err(|_| error.clone())?;
                if stored.iter().any(|row| row.key == key) {
                    return Err(error.into());
                }
            }
        }
        self.write().remove(id);
        Ok(())
    }

    /// Checks the position with stored epochs if no epoch has checked it yet, because navigation
    /// data may have arrived after the epochs. A check with the same data is not repeated.
    async fn check_stored(&self, base: &Base) {
        let push = self.navigation.current().push;
        let (site, epochs) = {
            let mut stored = base.stored();
            let tried = Some((push, stored.next_number()));
            if 0 < stored.checks.present.epochs || stored.check_tried == tried {
                return;
            }
            stored.check_tried = tried;
            let Some(site) = stored.site().cloned() else { return };
            let newest = stored.epochs.iter().rev().take(CHECKED_EPOCHS);
            (site, newest.rev().cloned().collect())
        };
        let checks = self.checked(base, PositionChecks::new(), site, epochs).await;
        let mut stored = base.stored();
        if stored.checks.present.epochs == 0 {
            stored.checks = checks;
        }
    }

    /// A base with the epochs that rover epochs from `from` until `until` may need, none of them
    /// older than `span_s`. An empty view if the base was deleted.
    pub(crate) fn view(
        &self,
        name: &BaseName,
        from: GpsTime,
        until: GpsTime,
        span_s: f64,
    ) -> BaseView {
        match self.of_key(name.key) {
            Some(base) => base.view(from, until, span_s),
            None => BaseView::empty(name.clone()),
        }
    }

    /// The bases with these names that still exist, in the order of the names.
    pub(crate) fn candidates(&self, names: &[BaseName]) -> Candidates {
        Candidates::new(names.iter().filter_map(|name| self.of_key(name.key)).collect())
    }

    /// Views that contain the base epochs of earlier solutions, one view for each base. A deleted
    /// base has an empty view.
    pub fn used(&self, uses: &[BaseUse]) -> Vec<BaseView> {
        let mut spans: BTreeMap<BaseKey, (u64, u64)> = BTreeMap::new();
        for used in uses {
            let span = spans.entry(used.base).or_insert((used.after, used.through));
            *span = (span.0.min(used.after), span.1.max(used.through));
        }
        let view = |(key, (after, through)): (BaseKey, (u64, u64))| {
            let Some(base) = self.of_key(key) else {
                return BaseView::empty(BaseName { key, id: "".into() });
            };
            let stored = base.stored();
            let (name, sites) = (base.name().clone(), stored.sites.clone());
            BaseView { name, sites, epochs: stored.between_numbers(after, through) }
        };
        spans.into_iter().map(view).collect()
    }

    fn of_key(&self, key: BaseKey) -> Option<Arc<Base>> {
        self.read().values().find(|base| base.name().key == key).cloned()
    }

    pub(super) fn base(&self, id: &BaseId) -> Result<Arc<Base>, AidingError> {
        let base = self.read().get(id).cloned();
        base.ok_or_else(|| AidingError::BaseNotFound { id: id.to_string() })
    }

    pub(super) fn read(&self) -> RwLockReadGuard<'_, BTreeMap<BaseId, Arc<Base>>> {
        self.bases.read().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn write(&self) -> RwLockWriteGuard<'_, BTreeMap<BaseId, Arc<Base>>> {
        self.bases.write().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The id of a stored base.
pub(super) fn stored_id(row: &BaseRow) -> Result<BaseId, StoreError> {
    BaseId::parse(&row.id).ok_or_else(|| StoreError::CorruptText {
        what: "base id",
        why: format!("{:?} is not the id of a base", row.id),
    })
}

/// A base read from the store, with its epochs.
pub(super) fn stored_base(
    row: BaseRow,
    epochs: Vec<StoredBaseEpoch>,
    stored_unix_ms: Option<i64>,
) -> Base {
    let description = BaseDescription {
        name: BaseName { key: row.key, id: row.id.into() },
        tenant: row.tenant,
        label: row.label,
        created_unix_ms: row.created_unix_ms,
        feed: row.feed,
        archive: row.archive,
        request: row.request,
        frame: row.frame,
    };
    Base::new(description, BaseEpochs::new(row.sites, epochs, stored_unix_ms))
}

/// A new base as text for the audit log. It omits the user and password at a caster, and the path
/// of an archive, which may contain a token.
fn described(new: &NewBaseRow<'_>) -> String {
    let mut text = format!("label {:?}", new.label);
    if let Some(BaseFeed { caster, mountpoint, .. }) = new.feed {
        text += &format!(", caster {} stream {mountpoint:?}", host_of(caster));
    }
    if let Some(template) = new.archive {
        text += &format!(", archive {}", host_of(template));
    }
    text
}

/// Scheme, host and port of an address.
fn host_of(address: &str) -> String {
    let (scheme, rest) = address.split_once("://").unwrap_or(("", address));
    let authority = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let host = authority.rsplit('@').next().unwrap_or_default();
    if scheme.is_empty() { host.to_owned() } else { format!("{scheme}://{host}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_shown_without_what_may_be_secret() {
        for (address, shown) in [
            ("ntrip://caster.example.org:2101", "ntrip://caster.example.org:2101"),
            ("https://user:word@files.example.org/{yyyy}?token=x", "https://files.example.org"),
            ("https://[2001:db8::1]:8443?token=x@y", "https://[2001:db8::1]:8443"),
            ("caster.example.org", "caster.example.org"),
        ] {
            assert_eq!(host_of(address), shown);
        }
    }
}
