//! Broadcast ephemerides, ionosphere coefficients and leap seconds, for every session.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, PoisonError, RwLock};

use tokio::sync::Mutex;

use crate::clock::unix_ms;
use crate::gnss::{Ephemeris, GpsTime, LeapSeconds, Navigation, SatelliteId};
use crate::models::{is_usable, validity_s};
use crate::store::{NavigationChange, Store, StoreError};

use super::{AidingError, AidingLimits};

/// What a push changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NavigationPush {
    /// Ephemerides that it brought.
    pub received: usize,
    /// Those that were not held before; committed.
    pub new: usize,
    /// Older ones that made room for them.
    pub dropped: usize,
    /// Ephemerides held now.
    pub held: usize,
}

/// What is known of one satellite.
#[derive(Clone, Debug, PartialEq)]
pub struct SatelliteCoverage {
    /// The satellite.
    pub satellite: SatelliteId,
    /// Ephemerides held.
    pub ephemerides: usize,
    /// From when until when a usable ephemeris is held, gaps included; `None` if none is usable.
    pub usable: Option<(GpsTime, GpsTime)>,
    /// Who brought the last of them.
    pub source: String,
    /// When the last of them came (ms since 1970-01-01 UTC).
    pub stored_unix_ms: i64,
}

/// What is known of all satellites.
#[derive(Clone, Debug, PartialEq)]
pub struct NavigationStatus {
    /// By satellite.
    pub satellites: Vec<SatelliteCoverage>,
    /// Ephemerides held.
    pub ephemerides: usize,
    /// Whether GPS's Klobuchar coefficients are held.
    pub klobuchar_gps: bool,
    /// Whether BeiDou's Klobuchar coefficients are held.
    pub klobuchar_beidou: bool,
    /// Whether QZSS's Klobuchar coefficients are held.
    pub klobuchar_qzss: bool,
    /// Whether Galileo's NeQuick-G coefficients are held.
    pub nequick: bool,
    /// Leap seconds, as far as broadcast.
    pub leap_seconds: LeapSeconds,
}

/// Who last brought an ephemeris of a satellite, and when (ms since 1970-01-01 UTC).
type Sources = BTreeMap<SatelliteId, (String, i64)>;

/// Navigation data that replay has asked for, by push.
const PAST_KEPT: usize = 4;

/// Navigation data as they were after one push; they do not change under their reader.
#[derive(Clone, Debug, Default)]
pub struct PushedNavigation {
    /// Number of the push; zero before the first.
    pub push: u64,
    /// Everything in force.
    pub navigation: Arc<Navigation>,
}

#[derive(Clone, Default)]
struct Snapshot {
    push: u64,
    navigation: Arc<Navigation>,
    sources: Arc<Sources>,
}

/// The desk for broadcast navigation data. Clones share it.
#[derive(Clone)]
pub struct NavigationBroker {
    store: Store,
    limits: AidingLimits,
    snapshot: Arc<RwLock<Snapshot>>,
    /// Held while a push is built and committed: pushes follow one another.
    pushing: Arc<Mutex<()>>,
    /// What replay last asked for, the newest last.
    past: Arc<Mutex<VecDeque<PushedNavigation>>>,
}

impl NavigationBroker {
    /// Opens the desk with what the store holds.
    ///
    /// # Errors
    /// The store fails.
    pub async fn open(store: Store, limits: AidingLimits) -> Result<Self, AidingError> {
        let stored = store.navigation().await?;
        let mut navigation = stored.coefficients;
        let mut sources = Sources::new();
        for row in stored.ephemerides {
            let entry = sources.entry(row.ephemeris.satellite());
            let newest = entry.or_insert_with(|| (String::new(), i64::MIN));
            if newest.1 < row.stored_unix_ms {
                *newest = (row.source, row.stored_unix_ms);
            }
            navigation.insert(row.ephemeris);
        }
        let (navigation, sources) = (Arc::new(navigation), Arc::new(sources));
        let snapshot = Snapshot { push: stored.push, navigation, sources };
        let snapshot = Arc::new(RwLock::new(snapshot));
        Ok(Self { store, limits, snapshot, pushing: Arc::default(), past: Arc::default() })
    }

    /// What is held at this moment.
    pub fn current(&self) -> PushedNavigation {
        let Snapshot { push, navigation, .. } = self.read();
        PushedNavigation { push, navigation }
    }

    /// What was held after the push number `push`.
    ///
    /// # Errors
    /// Some of it has been forgotten since, or the store fails.
    pub async fn after(&self, push: u64) -> Result<PushedNavigation, StoreError> {
        let current = self.current();
        if current.push == push {
            return Ok(current);
        }
        // Held while the store is read: many sessions restored at once ask for the same.
        let mut past = self.past.lock().await;
        if let Some(known) = past.iter().find(|known| known.push == push) {
            return Ok(known.clone());
        }
        let navigation = Arc::new(self.store.navigation_after(push).await?);
        let found = PushedNavigation { push, navigation };
        if past.len() == PAST_KEPT {
            past.pop_front();
        }
        past.push_back(found.clone());
        Ok(found)
    }

    /// Takes over navigation data from `source`. What it returns is durable, and later
    /// [`Self::current`] snapshots hold it.
    ///
    /// # Errors
    /// More ephemerides of a satellite than are held, or the store fails.
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
        let new = novelties(&before.navigation, &pushed);
        let coefficients = new_coefficients(&before.navigation, &pushed);
        if new.is_empty() && coefficients == Navigation::default() {
            let (received, held) = (pushed.len(), before.navigation.len());
            return Ok(NavigationPush { received, new: 0, dropped: 0, held });
        }
        let mut navigation = (*before.navigation).clone();
        navigation.merge(pushed.clone());
        let surplus = surplus(&navigation, &pushed, limit);
        navigation.retain(|ephemeris| !surplus.contains(ephemeris));

        let now = unix_ms();
        let dropped: Vec<&Ephemeris> = surplus.iter().collect();
        let change = NavigationChange {
            new: &new,
            dropped: &dropped,
            coefficients: &coefficients,
            source,
            stored_unix_ms: now,
            superseded_limit: self.limits.superseded_ephemerides,
        };
        let push = self.store.push_navigation(&change).await?;

        let mut sources = (*before.sources).clone();
        for ephemeris in &new {
            sources.insert(ephemeris.satellite(), (source.to_owned(), now));
        }
        let counts = NavigationPush {
            received: pushed.len(),
            new: new.len(),
            dropped: surplus.len(),
            held: navigation.len(),
        };
        let (navigation, sources) = (Arc::new(navigation), Arc::new(sources));
        let after = Snapshot { push, navigation, sources };
        *self.snapshot.write().unwrap_or_else(PoisonError::into_inner) = after;
        Ok(counts)
    }

    /// Which satellites are covered, from when until when.
    pub fn status(&self) -> NavigationStatus {
        let Snapshot { navigation, sources, .. } = self.read();
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

    fn read(&self) -> Snapshot {
        self.snapshot.read().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// What of `pushed` is not held just so.
fn novelties<'a>(held: &Navigation, pushed: &'a Navigation) -> Vec<&'a Ephemeris> {
    let all = pushed.satellites().flat_map(|(_, list)| list);
    all.filter(|ephemeris| !held.of(ephemeris.satellite()).contains(ephemeris)).collect()
}

/// What of `pushed`'s coefficients is not held just so.
fn new_coefficients(held: &Navigation, pushed: &Navigation) -> Navigation {
    fn news<T: PartialEq>(held: Option<T>, pushed: Option<T>) -> Option<T> {
        pushed.filter(|value| held.as_ref() != Some(value))
    }
    let mut new = Navigation::default();
    new.klobuchar_gps = news(held.klobuchar_gps, pushed.klobuchar_gps);
    new.klobuchar_beidou = news(held.klobuchar_beidou, pushed.klobuchar_beidou);
    new.klobuchar_qzss = news(held.klobuchar_qzss, pushed.klobuchar_qzss);
    new.nequick = news(held.nequick, pushed.nequick);
    if held.leap_seconds != pushed.leap_seconds {
        new.leap_seconds = pushed.leap_seconds;
    }
    new
}

/// Of each satellite the oldest ephemerides beyond `limit` that did not come with `pushed`.
fn surplus(merged: &Navigation, pushed: &Navigation, limit: usize) -> Vec<Ephemeris> {
    let mut surplus = Vec::new();
    for (satellite, brought) in pushed.satellites() {
        let list = merged.of(satellite);
        let older = list.iter().filter(|ephemeris| !brought.contains(ephemeris));
        surplus.extend(older.take(list.len().saturating_sub(limit)).cloned());
    }
    surplus
}

fn usable_span(list: &[Ephemeris]) -> Option<(GpsTime, GpsTime)> {
    let spans = list.iter().filter(|ephemeris| is_usable(ephemeris)).map(|ephemeris| {
        let validity_s = validity_s(ephemeris);
        (ephemeris.toe() - validity_s, ephemeris.toe() + validity_s)
    });
    spans.reduce(|(from, until), (start, end)| (from.min(start), until.max(end)))
}
