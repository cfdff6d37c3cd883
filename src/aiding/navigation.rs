//! The desk for broadcast ephemerides, ionosphere coefficients and leap seconds.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, PoisonError, RwLock};

use tokio::sync::Mutex;

use crate::clock::unix_ms;
use crate::gnss::{Ephemeris, GpsTime, LeapSeconds, Navigation, SatelliteId};
use crate::models::{is_usable, validity_s};
use crate::store::{NavigationChange, Store, StoreError};

use super::trust::{Offered, is_of_operator};
use super::{AidingError, AidingLimits};

/// The effect of a push.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NavigationPush {
    /// Number of ephemerides in the push.
    pub received: usize,
    /// Number of ephemerides that were not stored before. They are committed.
    pub new: usize,
    /// Number of older ephemerides that were dropped because of the limit.
    pub dropped: usize,
    /// Number of ephemerides in force after the push.
    pub in_force: usize,
}

/// The ephemerides of one satellite.
#[derive(Clone, Debug, PartialEq)]
pub struct SatelliteCoverage {
    /// The satellite.
    pub satellite: SatelliteId,
    /// Number of ephemerides in force.
    pub ephemerides: usize,
    /// First and last time with a usable ephemeris, gaps included; `None` if none is usable.
    pub usable: Option<(GpsTime, GpsTime)>,
    /// Source of the newest ephemeris, such as `upload` or a caster's address.
    pub source: String,
    /// When the newest ephemeris was stored (ms since 1970-01-01 UTC).
    pub stored_unix_ms: i64,
}

/// The navigation data in force.
#[derive(Clone, Debug, PartialEq)]
pub struct NavigationStatus {
    /// One entry for each satellite, in order.
    pub satellites: Vec<SatelliteCoverage>,
    /// Number of ephemerides in force.
    pub ephemerides: usize,
    /// Whether GPS Klobuchar coefficients are known.
    pub klobuchar_gps: bool,
    /// Whether BeiDou Klobuchar coefficients are known.
    pub klobuchar_beidou: bool,
    /// Whether QZSS Klobuchar coefficients are known.
    pub klobuchar_qzss: bool,
    /// Whether Galileo NeQuick-G coefficients are known.
    pub nequick: bool,
    /// Leap seconds, as far as broadcast.
    pub leap_seconds: LeapSeconds,
}

/// Source of each satellite's newest ephemeris, and when it was stored (ms since 1970-01-01 UTC).
type Sources = BTreeMap<SatelliteId, (String, i64)>;

/// Past states of the navigation data that are cached for replay.
const PAST_CACHED: usize = 4;

/// The navigation data after one push. They never change.
#[derive(Clone, Debug, Default)]
pub struct PushedNavigation {
    /// Number of the push; zero before the first.
    pub push: u64,
    /// All navigation data in force.
    pub navigation: Arc<Navigation>,
}

#[derive(Clone, Default)]
struct Current {
    push: u64,
    navigation: Arc<Navigation>,
    sources: Arc<Sources>,
    /// The ephemerides in force that are not the operator's.
    offered: Arc<Offered>,
}

/// The desk for broadcast navigation data. All clones share the same data.
#[derive(Clone)]
pub struct NavigationBroker {
    store: Store,
    limits: AidingLimits,
    current: Arc<RwLock<Current>>,
    /// Locked while a push is compared and committed, so that pushes follow one another.
    pushing: Arc<Mutex<()>>,
    /// Past states that replay requested recently, the newest last.
    past: Arc<Mutex<VecDeque<PushedNavigation>>>,
}

impl NavigationBroker {
    /// Opens the desk with the stored navigation data.
    ///
    /// # Errors
    /// The store fails.
    pub async fn open(store: Store, limits: AidingLimits) -> Result<Self, AidingError> {
        let stored = store.navigation().await?;
        let mut navigation = stored.coefficients;
        let (mut sources, mut offered) = (Sources::new(), Offered::default());
        for row in stored.ephemerides {
            offered.note(&row.ephemeris, &row.source, row.stored_unix_ms);
            let entry = sources.entry(row.ephemeris.satellite());
            let newest = entry.or_insert_with(|| (String::new(), i64::MIN));
            if newest.1 < row.stored_unix_ms {
                *newest = (row.source, row.stored_unix_ms);
            }
            navigation.insert(row.ephemeris);
        }
        let (navigation, sources) = (Arc::new(navigation), Arc::new(sources));
        let offered = Arc::new(offered);
        let current = Current { push: stored.push, navigation, sources, offered };
        let current = Arc::new(RwLock::new(current));
        Ok(Self { store, limits, current, pushing: Arc::default(), past: Arc::default() })
    }

    /// The navigation data in force now.
    pub fn current(&self) -> PushedNavigation {
        let Current { push, navigation, .. } = self.read();
        PushedNavigation { push, navigation }
    }

    /// The navigation data that were in force after push number `push`.
    ///
    /// # Errors
    /// Some of them are no longer stored, or the store fails.
    pub async fn after(&self, push: u64) -> Result<PushedNavigation, StoreError> {
        let current = self.current();
        if current.push == push {
            return Ok(current);
        }
        // Locked while the store is read: many sessions restored at once ask for the same push.
        let mut past = self.past.lock().await;
        if let Some(known) = past.iter().find(|known| known.push == push) {
            return Ok(known.clone());
        }
        let navigation = Arc::new(self.store.navigation_after(push).await?);
        let found = PushedNavigation { push, navigation };
        if past.len() == PAST_CACHED {
            past.pop_front();
        }
        past.push_back(found.clone());
        Ok(found)
    }

    /// Adds navigation data from `source`. When it returns, the data are durable, and later calls
    /// of [`Self::current`] contain them. The operator's data replace others; data from the sources
    /// [`UPLOAD`](super::UPLOAD), [`DEVICE`](super::DEVICE) and those that begin with
    /// `OF_BASE` are added as far as they contradict and replace nothing.
    ///
    /// # Errors
    /// The push has more ephemerides of one satellite than are kept, or the store fails.
    pub async fn push(
        &self,
        pushed: Navigation,
        source: &str,
    ) -> Result<NavigationPush, AidingError> {
        let _turn = self.pushing.lock().await;
        let before = self.read();
        let limit = self.limits.ephemerides_per_satellite;
        if let Some((satellite, list)) = pushed.satellites().find(|(_, l)| limit < l.len()) {
            return Err(AidingError::TooManyEphemerides { satellite, count: list.len(), limit });
        }
        let received = pushed.len();
        let (pushed, mut ended) = before.accept(pushed, source, limit);
        let new = before.new_ephemerides(&pushed, source);
        let coefficients = new_coefficients(&before.navigation, &pushed);
        if new.is_empty() && coefficients == Navigation::default() {
            let in_force = before.navigation.len();
            return Ok(NavigationPush { received, new: 0, dropped: 0, in_force });
        }
        let mut navigation = (*before.navigation).clone();
        navigation.merge(pushed.clone());
        navigation.retain(|ephemeris| !ended.contains(ephemeris));
        let excess = excess(&navigation, &pushed, limit, &before.offered);
        navigation.retain(|ephemeris| !excess.contains(ephemeris));
        ended.extend(excess);
        let dropped: Vec<&Ephemeris> = ended.iter().collect();
        let change = NavigationChange {
            new: &new,
            dropped: &dropped,
            coefficients: &coefficients,
            source,
            stored_unix_ms: unix_ms(),
            superseded_limit: self.limits.superseded_ephemerides,
        };
        let push = self.store.push_navigation(&change).await?;
        let counts = NavigationPush {
            received,
            new: new.len(),
            dropped: ended.len(),
            in_force: navigation.len(),
        };
        let after = before.after(push, navigation, &change);
        *self.current.write().unwrap_or_else(PoisonError::into_inner) = after;
        Ok(counts)
    }

    /// The satellites with usable ephemerides, and the time that these cover.
    pub fn status(&self) -> NavigationStatus {
        let Current { navigation, sources, .. } = self.read();
        let coverage = |(satellite, list): (SatelliteId, &[Ephemeris])| {
            let (source, stored_unix_ms) = sources.get(&satellite).cloned().unwrap_or_default();
            let ephemerides = list.len();
            let usable = usable_span(list);
            SatelliteCoverage { satellite, ephemerides, usable, source, stored_unix_ms }
        };
        NavigationStatus {
            satellites: navigation.satellites().map(coverage).collect(),
            ephemerides: navigation.len(),
            klobuchar_gps: navigation.klobuchar_gps.is_some(),
            klobuchar_beidou: navigation.klobuchar_beidou.is_some(),
            klobuchar_qzss: navigation.klobuchar_qzss.is_some(),
            nequick: navigation.nequick.is_some(),
            leap_seconds: navigation.leap_seconds,
        }
    }

    fn read(&self) -> Current {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Current {
    /// The part of a push that is accepted, and the ephemerides in force that end because of it.
    fn accept(
        &self,
        pushed: Navigation,
        source: &str,
        limit: usize,
    ) -> (Navigation, Vec<Ephemeris>) {
        if is_of_operator(source) {
            let contradicted = self.offered.contradicted(&self.navigation, &pushed);
            return (pushed, contradicted);
        }
        let accepted = self.offered.accept(&self.navigation, &pushed, limit, unix_ms());
        (accepted.navigation, accepted.dropped)
    }

    /// The ephemerides of `pushed` to store: those that are not known yet, and those that were
    /// offered before and are now the operator's.
    fn new_ephemerides<'a>(&self, pushed: &'a Navigation, source: &str) -> Vec<&'a Ephemeris> {
        let all = || pushed.satellites().flat_map(|(_, list)| list);
        let is_new = |e: &&Ephemeris| !self.navigation.of(e.satellite()).contains(e);
        let mut new: Vec<&Ephemeris> = all().filter(is_new).collect();
        if is_of_operator(source) {
            let is_taken_over = |e: &&Ephemeris| self.offered.contains(e) && !new.contains(e);
            let taken_over: Vec<&Ephemeris> = all().filter(is_taken_over).collect();
            new.extend(taken_over);
        }
        new
    }

    /// The state after `change` is stored as push number `push`.
    fn after(&self, push: u64, navigation: Navigation, change: &NavigationChange<'_>) -> Self {
        let (source, now) = (change.source, change.stored_unix_ms);
        let mut sources = (*self.sources).clone();
        let mut offered = (*self.offered).clone();
        change.dropped.iter().for_each(|ephemeris| offered.forget(ephemeris));
        for ephemeris in change.new {
            offered.note(ephemeris, source, now);
            sources.insert(ephemeris.satellite(), (source.to_owned(), now));
        }
        let (navigation, sources) = (Arc::new(navigation), Arc::new(sources));
        Self { push, navigation, sources, offered: Arc::new(offered) }
    }
}

/// The coefficients of `pushed` that differ from the known ones.
fn new_coefficients(known: &Navigation, pushed: &Navigation) -> Navigation {
    fn changed<T: PartialEq>(known: Option<T>, pushed: Option<T>) -> Option<T> {
        pushed.filter(|value| known.as_ref() != Some(value))
    }
    let mut new = Navigation::default();
    new.klobuchar_gps = changed(known.klobuchar_gps, pushed.klobuchar_gps);
    new.klobuchar_beidou = changed(known.klobuchar_beidou, pushed.klobuchar_beidou);
    new.klobuchar_qzss = changed(known.klobuchar_qzss, pushed.klobuchar_qzss);
    new.nequick = changed(known.nequick, pushed.nequick);
    if known.leap_seconds != pushed.leap_seconds {
        new.leap_seconds = pushed.leap_seconds;
    }
    new
}

/// The ephemerides of each satellite beyond `limit`, except those that came with `pushed`: offered
/// ones first, and of these the oldest.
fn excess(
    merged: &Navigation,
    pushed: &Navigation,
    limit: usize,
    offered: &Offered,
) -> Vec<Ephemeris> {
    let mut excess = Vec::new();
    for (satellite, brought) in pushed.satellites() {
        let list = merged.of(satellite);
        let older = list.iter().filter(|ephemeris| !brought.contains(ephemeris));
        let mut older: Vec<&Ephemeris> = older.collect();
        older.sort_by_key(|ephemeris| !offered.contains(ephemeris));
        let surplus = list.len().saturating_sub(limit);
        excess.extend(older.into_iter().take(surplus).cloned());
    }
    excess
}

fn usable_span(list: &[Ephemeris]) -> Option<(GpsTime, GpsTime)> {
    let spans = list.iter().filter(|ephemeris| is_usable(ephemeris)).map(|ephemeris| {
        let validity_s = validity_s(ephemeris);
        (ephemeris.toe() - validity_s, ephemeris.toe() + validity_s)
    });
    spans.reduce(|(from, until), (start, end)| (from.min(start), until.max(end)))
}
