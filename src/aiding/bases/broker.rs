//! The desk for bases.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use crate::aiding::{AidingError, AidingLimits, NavigationBroker};
use crate::clock::unix_ms;
use crate::gnss::{BaseSite, Ecef, Epoch, GpsTime, Navigation};
use crate::positioning::BASE_LATER_S;
use crate::store::{
    BaseChange, BaseFeed, BaseKey, BaseName, BaseUse, Store, StoreError, StoredBaseEpoch,
};

use super::candidates::Candidates;
use super::check::{PositionCheck, REFUSED_M};
use super::demand::Demand;
use super::held::{Held, Reach};
use super::seekers::Seekers;
use super::{BaseEpochRefusal, BaseId, BaseInfo, BasePush, BaseView, NewBase};

/// Epochs looked at to check a position on request.
const CHECKED_EPOCHS: usize = 20;

/// The desk for base stations. Clones share it.
#[derive(Clone)]
pub struct BaseBroker {
    store: Store,
    navigation: NavigationBroker,
    limits: AidingLimits,
    bases: Arc<RwLock<BTreeMap<BaseId, Arc<Base>>>>,
    /// Held while a base is created, so that there are never more than allowed.
    creating: Arc<tokio::sync::Mutex<()>>,
    seekers: Seekers,
}

pub(super) struct Base {
    pub(super) name: BaseName,
    label: String,
    created_unix_ms: i64,
    feed: Option<BaseFeed>,
    archive: Option<String>,
    /// What rovers need of the archive.
    demand: Demand,
    /// Where a rover that is positioned against it was last.
    rover: Mutex<Option<(Ecef, i64)>>,
    /// Held while a push is built and committed: pushes follow one another.
    pushing: tokio::sync::Mutex<()>,
    held: Mutex<Held>,
}

impl Base {
    fn rover(&self) -> MutexGuard<'_, Option<(Ecef, i64)>> {
        self.rover.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// It with the epochs that a rover's epochs from `from` until `until` may need.
    pub(super) fn view(&self, from: GpsTime, until: GpsTime, span_s: f64) -> BaseView {
        if self.archive.is_some() {
            self.demand.note(from, until, unix_ms());
        }
        let held = self.held();
        let epochs = held.between_times(from - span_s - BASE_LATER_S, until + BASE_LATER_S);
        BaseView { name: self.name.clone(), sites: held.sites.clone(), epochs }
    }
}

impl BaseBroker {
    /// Opens the desk with what the store holds.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub async fn open(
        store: Store,
        navigation: NavigationBroker,
        limits: AidingLimits,
    ) -> Result<Self, AidingError> {
        let mut bases = BTreeMap::new();
        for row in store.bases().await? {
            let id = BaseId::parse(&row.id).ok_or_else(|| StoreError::CorruptText {
                what: "base id",
                why: format!("{:?} is none", row.id),
            })?;
            let (epochs, stored_unix_ms) = store.base_epochs(row.key).await?;
            let base = Base {
                name: BaseName { key: row.key, id: row.id.into() },
                label: row.label,
                created_unix_ms: row.created_unix_ms,
                feed: row.feed,
                archive: row.archive,
                demand: Demand::default(),
                rover: Mutex::default(),
                pushing: tokio::sync::Mutex::new(()),
                held: Mutex::new(Held::new(row.sites, epochs, stored_unix_ms)),
            };
            bases.insert(id, Arc::new(base));
        }
        let bases = Arc::new(RwLock::new(bases));
        let (creating, seekers) = Default::default();
        Ok(Self { store, navigation, limits, bases, creating, seekers })
    }

    /// Creates a base and stores it.
    ///
    /// # Errors
    /// As many bases as there may be, a label too long, or the store fails.
    pub async fn create(&self, new: NewBase) -> Result<BaseInfo, AidingError> {
        let (length, limit) = (new.label.chars().count(), self.limits.label_characters);
        if limit < length {
            return Err(AidingError::LabelTooLong { length, limit });
        }
        let _creating = self.creating.lock().await;
        let limit = self.limits.bases;
        if limit <= self.read().len() {
            return Err(AidingError::TooManyBases { limit });
        }
        let (id, now) = (BaseId::random(), unix_ms());
        let NewBase { label, site, feed, archive } = &new;
        let (site, feed, archive) = (site.as_ref(), feed.as_ref(), archive.as_deref());
        let stored = self.store.create_base(id.as_str(), label, site, feed, archive, now);
        let key = stored.await?;
        let sites = new.site.map(|site| (1, site)).into_iter().collect();
        let base = Arc::new(Base {
            name: BaseName { key, id: id.as_str().into() },
            label: new.label,
            created_unix_ms: now,
            feed: new.feed,
            archive: new.archive,
            demand: Demand::default(),
            rover: Mutex::default(),
            pushing: tokio::sync::Mutex::new(()),
            held: Mutex::new(Held::new(sites, Vec::new(), None)),
        });
        self.write().insert(id, base.clone());
        Ok(info(&base))
    }

    /// A base with its health.
    ///
    /// # Errors
    /// There is none of this id.
    pub async fn get(&self, id: &BaseId) -> Result<BaseInfo, AidingError> {
        let base = self.base(id)?;
        self.check_held(&base).await;
        Ok(info(&base))
    }

    /// Every base with its health, by id.
    pub async fn list(&self) -> Vec<BaseInfo> {
        let bases: Vec<Arc<Base>> = self.read().values().cloned().collect();
        let mut list = Vec::with_capacity(bases.len());
        for base in bases {
            self.check_held(&base).await;
            list.push(info(&base));
        }
        list
    }

    /// The base of an id, as sessions name it.
    ///
    /// # Errors
    /// There is none of this id.
    pub fn name(&self, id: &BaseId) -> Result<BaseName, AidingError> {
        Ok(self.base(id)?.name.clone())
    }

    /// Every base that a stream of a caster fills.
    pub fn feeds(&self) -> Vec<(BaseId, BaseFeed)> {
        let bases = self.read();
        let fed = bases.iter().filter_map(|(id, base)| Some((id.clone(), base.feed.clone()?)));
        fed.collect()
    }

    /// Every base that an archive's files fill, with the archive's address.
    pub fn archives(&self) -> Vec<(BaseId, String)> {
        let bases = self.read();
        bases.iter().filter_map(|(id, base)| Some((id.clone(), base.archive.clone()?))).collect()
    }

    /// When the quarters of an hour begin of which rovers have lately needed the base, in order.
    ///
    /// # Errors
    /// There is none of this id.
    pub fn needed(&self, id: &BaseId) -> Result<Vec<GpsTime>, AidingError> {
        Ok(self.base(id)?.demand.needed(unix_ms()))
    }

    /// Waits until a rover needs the base at a time at which none has.
    ///
    /// # Errors
    /// There is none of this id.
    pub async fn need(&self, id: &BaseId) -> Result<(), AidingError> {
        let base = self.base(id)?;
        base.demand.news().await;
        Ok(())
    }

    /// How much is held of a base from one time until before another.
    ///
    /// # Errors
    /// There is none of this id.
    pub fn reach(&self, id: &BaseId, from: GpsTime, until: GpsTime) -> Result<Reach, AidingError> {
        Ok(self.base(id)?.held().reach(from, until))
    }

    /// Most epochs that a base holds.
    pub const fn epochs_max(&self) -> usize {
        self.limits.epochs_per_base
    }

    /// Where a base stands now, as far as known.
    ///
    /// # Errors
    /// There is none of this id.
    pub fn site(&self, id: &BaseId) -> Result<Option<BaseSite>, AidingError> {
        Ok(self.base(id)?.held().site().cloned())
    }

    /// Notes where a rover of a base is, for casters that compute a stream for a place.
    pub fn note_rover(&self, base: BaseKey, place: Ecef) {
        if let Some(base) = self.of(base) {
            *base.rover() = Some((place, unix_ms()));
        }
    }

    /// Where a rover of a base was last, since the service started.
    pub fn rover(&self, id: &BaseId) -> Option<Ecef> {
        let rover = *self.base(id).ok()?.rover();
        rover.map(|(place, _)| place)
    }

    /// When a rover was positioned against a base last, since the service started
    /// (ms since 1970-01-01 UTC).
    pub fn used_unix_ms(&self, id: &BaseId) -> Option<i64> {
        let rover = *self.base(id).ok()?.rover();
        rover.map(|(_, noted_unix_ms)| noted_unix_ms)
    }

    /// Rovers that seek the nearest of all bases.
    pub const fn seekers(&self) -> &Seekers {
        &self.seekers
    }

    /// Deletes a base with its epochs.
    ///
    /// # Errors
    /// There is none of this id, an open session names it, or the store fails.
    pub async fn delete(&self, id: &BaseId) -> Result<(), AidingError> {
        let base = self.base(id)?;
        let _turn = base.pushing.lock().await;
        if !self.store.delete_base(base.name.key, unix_ms()).await? {
            return Err(AidingError::BaseInUse { id: id.to_string() });
        }
        self.write().remove(id);
        Ok(())
    }

    /// Tells where a base stands, from its next epoch on; the same place again changes nothing.
    ///
    /// # Errors
    /// There is no such base, or the store fails.
    pub async fn place(&self, id: &BaseId, site: &BaseSite) -> Result<(), AidingError> {
        self.take(id, Vec::new(), Some(site)).await.map(drop)
    }

    /// Takes epochs of a base, in order of time. What it acknowledges is durable, and later views
    /// hold it. Their odometry, which a base has none of, is left out.
    ///
    /// # Errors
    /// There is no such base, its place is not known or contradicts what it observes, the epochs
    /// exceed what a base may hold, or the store fails: nothing of the push is then kept.
    pub async fn push(&self, id: &BaseId, epochs: Vec<Epoch>) -> Result<BasePush, AidingError> {
        self.take(id, epochs, None).await
    }

    /// The same of a file's epochs. Where the base's place is not known, it is where the file says.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub async fn upload(
        &self,
        id: &BaseId,
        epochs: Vec<Epoch>,
        told: Option<&BaseSite>,
    ) -> Result<BasePush, AidingError> {
        let is_placed = self.base(id)?.held().site().is_some();
        self.take(id, epochs, told.filter(|_| !is_placed)).await
    }

    async fn take(
        &self,
        id: &BaseId,
        mut epochs: Vec<Epoch>,
        site: Option<&BaseSite>,
    ) -> Result<BasePush, AidingError> {
        let base = self.base(id)?;
        let _turn = base.pushing.lock().await;
        self.base(id)?; // Not deleted meanwhile.
        self.refresh(&base).await?;
        epochs.iter_mut().for_each(|epoch| epoch.odometry = None);
        let (new_site, in_force, mut check, mut new) = {
            let held = base.held();
            let new_site = held.new_site(site);
            let check = if new_site.is_some() { PositionCheck::new() } else { held.check };
            let in_force = new_site.map(|(_, site)| site).or(held.site()).cloned();
            (new_site, in_force, check, Vec::new())
        };
        let outcomes = self.place_epochs(&base, &epochs, &mut new);
        if !epochs.is_empty() {
            let site =
                in_force.ok_or_else(|| AidingError::BasePositionMissing { id: id.to_string() })?;
            check = self.checked(check, site, epochs).await;
        }
        if let Some(distance_m) = check.distance_m().filter(|distance_m| REFUSED_M < *distance_m) {
            return Err(AidingError::BasePositionRefused { distance_m, epochs: check.epochs });
        }
        let limits = (self.limits.epochs_per_base, self.limits.bytes_per_base);
        let first_kept = base.held().first_kept(&new, limits.0, limits.1);
        let first_kept = first_kept.ok_or(AidingError::BaseTooLarge {
            epochs: new.len(),
            epochs_max: limits.0,
            bytes: new.iter().map(StoredBaseEpoch::size).sum(),
            bytes_max: limits.1,
        })?;
        self.commit(&base, new_site, new, first_kept).await?;
        base.held().check = check;
        Ok(BasePush { outcomes, check })
    }

    fn place_epochs(
        &self,
        base: &Base,
        epochs: &[Epoch],
        new: &mut Vec<StoredBaseEpoch>,
    ) -> Vec<Result<super::HeldEpoch, BaseEpochRefusal>> {
        let limit = self.limits.observations_per_epoch;
        let held = base.held();
        let mut place = |epoch: &Epoch| {
            let (time, observations) = (epoch.time, epoch.observations.len());
            if limit < observations {
                return Err(BaseEpochRefusal::TooManyObservations { time, observations, limit });
            }
            held.place(new, epoch)
        };
        epochs.iter().map(&mut place).collect()
    }

    /// Commits what a push brings, and only then shows it.
    async fn commit(
        &self,
        base: &Base,
        site: Option<(u64, &BaseSite)>,
        epochs: Vec<StoredBaseEpoch>,
        first_kept: u64,
    ) -> Result<(), AidingError> {
        if site.is_none() && epochs.is_empty() {
            return Ok(());
        }
        let stored_unix_ms = unix_ms();
        let change = BaseChange { site, epochs: &epochs, first_kept, stored_unix_ms };
        if let Err(error) = self.store.push_base(base.name.key, &change).await {
            // A connection that breaks during the commit leaves its fate open.
            base.held().outdated = true;
            return Err(error.into());
        }
        let mut held = base.held();
        if let Some((since, site)) = site {
            held.take_site(since, site.clone());
        }
        held.take(epochs, first_kept, stored_unix_ms);
        Ok(())
    }

    /// Reads what is stored of a base, where that is not known.
    async fn refresh(&self, base: &Base) -> Result<(), AidingError> {
        if !base.held().outdated {
            return Ok(());
        }
        let rows = self.store.bases().await?;
        let sites = rows.into_iter().find(|row| row.key == base.name.key).map(|row| row.sites);
        let (epochs, stored_unix_ms) = self.store.base_epochs(base.name.key).await?;
        *base.held() = Held::new(sites.unwrap_or_default(), epochs, stored_unix_ms);
        Ok(())
    }

    /// Single-point positioning is work for a thread of its own.
    async fn checked(
        &self,
        check: PositionCheck,
        site: BaseSite,
        epochs: Vec<Epoch>,
    ) -> PositionCheck {
        if check.is_done() {
            return check;
        }
        let navigation: Arc<Navigation> = self.navigation.current().navigation;
        let work = move || check.add(&site, &epochs, &navigation);
        // Err: it panicked, and nothing is known of the position.
        tokio::task::spawn_blocking(work).await.unwrap_or(check)
    }

    /// Checks the position by what is held, where nothing has checked it yet: navigation data may
    /// have come later than the epochs.
    async fn check_held(&self, base: &Base) {
        let (site, epochs) = {
            let held = base.held();
            let (Some(site), 0) = (held.site(), held.check.epochs) else { return };
            let newest = held.epochs.iter().rev().take(CHECKED_EPOCHS);
            let epochs: Vec<Epoch> =
                newest.rev().filter_map(|stored| stored.epoch().ok()).collect();
            (site.clone(), epochs)
        };
        let check = self.checked(PositionCheck::new(), site, epochs).await;
        let mut held = base.held();
        if held.check.epochs == 0 {
            held.check = check;
        }
    }

    /// A base with the epochs that a rover's epochs tagged from `from` until `until` may need, none
    /// of them older than `span_s`.
    pub fn view(&self, name: &BaseName, from: GpsTime, until: GpsTime, span_s: f64) -> BaseView {
        match self.of(name.key) {
            Some(base) => base.view(from, until, span_s),
            None => BaseView::empty(name.clone()),
        }
    }

    /// The bases of these names, in their order, as far as there are any; all, by id, of no names.
    pub fn candidates(&self, names: Option<&[BaseName]>) -> Candidates {
        let bases = match names {
            None => self.read().values().cloned().collect(),
            Some(names) => names.iter().filter_map(|name| self.of(name.key)).collect(),
        };
        Candidates::new(bases)
    }

    /// The bases with the epochs that were used then; empty ones where they were deleted.
    pub fn used(&self, uses: &[BaseUse]) -> Vec<BaseView> {
        let mut spans: BTreeMap<BaseKey, (u64, u64)> = BTreeMap::new();
        for used in uses {
            let span = spans.entry(used.base).or_insert((used.after, used.through));
            *span = (span.0.min(used.after), span.1.max(used.through));
        }
        let view = |(key, (after, through)): (BaseKey, (u64, u64))| {
            let Some(base) = self.of(key) else {
                return BaseView::empty(BaseName { key, id: "".into() });
            };
            let held = base.held();
            let (name, sites) = (base.name.clone(), held.sites.clone());
            BaseView { name, sites, epochs: held.between_numbers(after, through) }
        };
        spans.into_iter().map(view).collect()
    }

    fn of(&self, key: BaseKey) -> Option<Arc<Base>> {
        self.read().values().find(|base| base.name.key == key).cloned()
    }

    fn base(&self, id: &BaseId) -> Result<Arc<Base>, AidingError> {
        let base = self.read().get(id).cloned();
        base.ok_or_else(|| AidingError::BaseNotFound { id: id.to_string() })
    }

    fn read(&self) -> RwLockReadGuard<'_, BTreeMap<BaseId, Arc<Base>>> {
        self.bases.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, BTreeMap<BaseId, Arc<Base>>> {
        self.bases.write().unwrap_or_else(PoisonError::into_inner)
    }
}

fn info(base: &Base) -> BaseInfo {
    let held = base.held();
    let span = held.epochs.front().zip(held.epochs.back());
    BaseInfo {
        name: base.name.clone(),
        label: base.label.clone(),
        created_unix_ms: base.created_unix_ms,
        feed: base.feed.clone(),
        archive: base.archive.clone(),
        site: held.site().cloned(),
        epochs: held.epochs.len(),
        span: span.map(|(oldest, newest)| (oldest.time, newest.time)),
        stored_unix_ms: held.stored_unix_ms,
        satellites: held.satellites,
        check: held.check,
    }
}
