//! The desk for broadcast ephemerides, ionosphere coefficients and leap seconds.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use tokio::sync::{Mutex, OwnedMutexGuard};

use crate::clock::unix_ms;
use crate::gnss::{Ephemeris, GpsTime, LeapSeconds, Navigation, SatelliteId};
use crate::models::{is_usable, validity_s};
use crate::store::{NavigationChange, Store, StoreError, StoredNavigation, account_of, owner_of};

use super::devices::coefficients;
use super::past::PastStates;
use super::state::{Part, PushedNavigation, State};
use super::trust::{Trust, trust};
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
    /// Number of ephemerides of the push that are not in force for all sessions: there is no room
    /// for them, or they contradict data of higher trust.
    pub left_out: usize,
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
type Sources = BTreeMap<SatelliteId, (Arc<str>, i64)>;

/// When superseded ephemerides reach their limit, this part of them (1/16) is deleted.
const ROOM: usize = 16;
/// Attempts of a push to be the next one while other nodes also push.
const ATTEMPTS: usize = 20;

/// State that a push leaves for the next one.
#[derive(Default)]
struct Pushing {
    /// The last push failed. It may be stored although the memory does not contain it.
    is_unconfirmed: bool,
    /// Number of rows of each account that may end before the superseded ones are counted again.
    /// The database must read all of them to count.
    room: BTreeMap<String, usize>,
}

/// The desk for broadcast navigation data. All clones share the same data.
#[derive(Clone)]
pub struct NavigationBroker {
    store: Store,
    limits: AidingLimits,
    state: Arc<RwLock<State>>,
    sources: Arc<RwLock<Sources>>,
    /// Locked while a push is compared and committed, so that pushes follow one another.
    pushing: Arc<Mutex<Pushing>>,
    past: Arc<PastStates>,
}

impl NavigationBroker {
    /// Opens the desk with the stored navigation data.
    ///
    /// # Errors
    /// The store fails.
    pub async fn open(store: Store, limits: AidingLimits) -> Result<Self, AidingError> {
        let stored = store.navigation().await?;
        let sources = Arc::new(RwLock::new(sources_of(&stored)));
        let state = Arc::new(RwLock::new(State::of(stored)));
        Ok(Self { store, limits, state, sources, pushing: Arc::default(), past: Arc::default() })
    }

    /// The navigation data in force now that serve all sessions.
    pub fn current(&self) -> PushedNavigation {
        let state = self.read();
        PushedNavigation { push: state.push, navigation: state.shared.navigation.clone() }
    }

    /// The navigation data in force now for the session of a device. A device is a source.
    pub fn current_for(&self, device: &str) -> PushedNavigation {
        self.read().pushed_for(device)
    }

    /// The navigation data that were in force for the session of a device after push number `push`.
    ///
    /// # Errors
    /// Some of them are no longer stored, or the store fails.
    pub async fn after(&self, push: u64, device: &str) -> Result<PushedNavigation, StoreError> {
        let current = self.current_for(device);
        if current.push == push {
            return Ok(current);
        }
        self.past.after(push, device, &self.store, &self.state).await
    }

    /// Adds navigation data from `source`. When it returns, the data are durable, and later calls
    /// of [`Self::current`] contain them as far as the source is trusted. The operator's data
    /// replace others. Data of an [`UPLOAD`](super::UPLOAD), or of a source that begins with
    /// `OF_BASE`, are added where they contradict and replace nothing of higher trust. Data of a
    /// [`device`](super::device) serve only its own session, until another source agrees.
    ///
    /// # Errors
    /// The push has more ephemerides of one satellite than are kept, or the store fails.
    pub async fn push(
        &self,
        pushed: Navigation,
        source: &str,
    ) -> Result<NavigationPush, AidingError> {
        let limit = self.limits.ephemerides_per_satellite;
        if let Some((satellite, list)) = pushed.satellites().find(|(_, l)| limit < l.len()) {
            return Err(AidingError::TooManyEphemerides { satellite, count: list.len(), limit });
        }
        let received = pushed.len();
        let is_known = self.read().knows(&pushed, source);
        let mut counts = NavigationPush { received, new: 0, dropped: 0, left_out: 0, in_force: 0 };
        counts.in_force = self.current_len();
        if is_known {
            return Ok(counts);
        }
        let turn = self.pushing.clone().lock_owned().await;
        let (broker, source, pushed) = (self.clone(), source.into(), Arc::new(pushed));
        let content = pushed.clone();
        // In its own task: stored data must get into the memory, even if the caller has gone.
        let pushing =
            tokio::spawn(async move { broker.push_in_turn(turn, &content, source).await });
        let (new, dropped) = pushing.await.unwrap_or(Err(StoreError::Closed.into()))?;
        counts.new = new;
        counts.dropped = dropped;
        counts.left_out = self.read().shared.missing(&pushed);
        counts.in_force = self.current_len();
        Ok(counts)
    }

    /// Stores the new data of a push, in steps. Returns the numbers of new and of dropped
    /// ephemerides. After a failure, a repetition goes on where it failed.
    async fn push_in_turn(
        &self,
        mut turn: OwnedMutexGuard<Pushing>,
        pushed: &Navigation,
        source: Arc<str>,
    ) -> Result<(usize, usize), AidingError> {
        if turn.is_unconfirmed {
            self.read_again().await?;
        }
        let limit = self.limits.ephemerides_per_satellite;
        let (mut new, mut dropped) = (0, 0);
        turn.is_unconfirmed = true;
        for _ in 0..ATTEMPTS {
            let parts = self.read().parts(pushed, &source, limit, unix_ms());
            let mut continues = true;
            for part in parts.into_iter().flat_map(Part::steps) {
                let counts = (part.new.len(), part.ended.len() + part.ended_owned.len());
                continues = self.commit(part, &mut turn.room).await?;
                if !continues {
                    break;
                }
                new += counts.0;
                dropped += counts.1;
            }
            if continues {
                turn.is_unconfirmed = false;
                return Ok((new, dropped));
            }
            self.read_again().await?;
        }
        Err(AidingError::Contended)
    }

    /// Reads from the store what other nodes have pushed. Returns whether there was anything new.
    ///
    /// # Errors
    /// The store fails.
    pub(crate) async fn refresh(&self) -> Result<bool, AidingError> {
        let _turn = self.pushing.lock().await;
        if self.store.newest_navigation_push().await? == self.read().push {
            return Ok(false);
        }
        self.read_again().await?;
        Ok(true)
    }

    /// Replaces the data in memory by the stored ones, after a push with an unknown outcome.
    async fn read_again(&self) -> Result<(), AidingError> {
        let stored = self.store.navigation().await?;
        *self.sources.write().unwrap_or_else(PoisonError::into_inner) = sources_of(&stored);
        *write(&self.state) = State::of(stored);
        Ok(())
    }

    /// Stores a part of a push, and then adds it to the data in memory. Returns `false`, and stores
    /// nothing, if the store has a push after the last one in memory: of another node, or one whose
    /// commit was not confirmed.
    async fn commit(
        &self,
        part: Part,
        room: &mut BTreeMap<String, usize>,
    ) -> Result<bool, AidingError> {
        let stored_unix_ms = unix_ms();
        let new: Vec<Ephemeris> =
            part.new.satellites().flat_map(|(_, list)| list.iter().cloned()).collect();
        let shared = part.ended.iter().map(|ephemeris| ("", ephemeris));
        let owned = part.ended_owned.iter().map(|(owner, ephemeris)| (owner_of(owner), ephemeris));
        let ended: Vec<(&str, &Ephemeris)> = shared.chain(owned).collect();
        let ended_coefficients: Vec<(&str, &Navigation)> =
            part.ended_coefficients.iter().map(|(owner, ended)| (owner_of(owner), ended)).collect();
        let limit = self.limits.superseded_ephemerides;
        let ending = ending_by_account(&part, new.len());
        let is_counted =
            |account: &str, count: usize| room.get(account).copied().unwrap_or(0) < count;
        let counted = ending.iter().filter(|(account, count)| is_counted(account, **count));
        let counted: Vec<&str> = counted.map(|(account, _)| account.as_str()).collect();
        let change = NavigationChange {
            after: self.read().push,
            new: &new,
            ended: &ended,
            coefficients: &part.new,
            ended_coefficients: &ended_coefficients,
            source: &part.source,
            stored_unix_ms,
            counted_accounts: &counted,
            superseded_limit: limit - limit / ROOM,
        };
        let Some(push) = self.store.push_navigation(&change).await? else { return Ok(false) };
        for (account, count) in &ending {
            let left = room.entry(account.clone()).or_default();
            *left = left.checked_sub(*count).unwrap_or(limit / ROOM);
        }
        if trust(&part.source) != Trust::Device {
            let mut sources = self.sources.write().unwrap_or_else(PoisonError::into_inner);
            for ephemeris in &new {
                sources.insert(ephemeris.satellite(), (part.source.clone(), stored_unix_ms));
            }
        }
        write(&self.state).take_over(push, part, new, stored_unix_ms);
        Ok(true)
    }

    /// The satellites with usable ephemerides, and the time that the ephemerides cover.
    pub fn status(&self) -> NavigationStatus {
        self.status_of(&self.current().navigation)
    }

    /// The satellites for which only this source has ephemerides in force.
    pub(super) fn own_satellites(&self, source: &str) -> Vec<SatelliteId> {
        let state = self.read();
        let own = state.devices.of(source).into_iter().flat_map(Navigation::satellites);
        own.map(|(satellite, _)| satellite).collect()
    }

    /// Like [`Self::status`], for data that serve a tenant.
    pub(super) fn status_of(&self, navigation: &Navigation) -> NavigationStatus {
        let sources = self.sources.read().unwrap_or_else(PoisonError::into_inner);
        let coverage = |(satellite, list): (SatelliteId, &[Ephemeris])| {
            let (source, stored_unix_ms) = sources.get(&satellite).cloned().unwrap_or_default();
            let (source, ephemerides) = (source.to_string(), list.len());
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

    fn current_len(&self) -> usize {
        self.read().shared.navigation.len()
    }

    fn read(&self) -> RwLockReadGuard<'_, State> {
        read(&self.state)
    }
}

/// Most rows that a part supersedes, by their account.
fn ending_by_account(part: &Part, new: usize) -> BTreeMap<String, usize> {
    let kinds = |navigation: &Navigation| coefficients(navigation).iter().flatten().count();
    let ended_owned = part.ended_owned.iter().map(|(owner, _)| (&**owner, 1));
    let ended_kinds = part.ended_coefficients.iter();
    let ended_kinds = ended_kinds.map(|(owner, ended)| (&**owner, kinds(ended)));
    let replaced = (&*part.source, new + kinds(&part.new));
    let ending = [replaced, ("", part.ended.len())].into_iter().chain(ended_owned);
    let mut accounts = BTreeMap::new();
    for (owner, count) in ending.chain(ended_kinds).filter(|(_, count)| 0 < *count) {
        *accounts.entry(account_of(owner).to_owned()).or_default() += count;
    }
    accounts
}

/// The sources of each satellite's newest ephemeris that serves all sessions.
fn sources_of(stored: &StoredNavigation) -> Sources {
    let mut sources = Sources::new();
    for row in &stored.ephemerides {
        let newest = sources.entry(row.ephemeris.satellite()).or_default();
        if newest.1 < row.stored_unix_ms && trust(&row.source) != Trust::Device {
            *newest = (row.source.as_str().into(), row.stored_unix_ms);
        }
    }
    sources
}

fn read(state: &RwLock<State>) -> RwLockReadGuard<'_, State> {
    state.read().unwrap_or_else(PoisonError::into_inner)
}

fn write(state: &RwLock<State>) -> RwLockWriteGuard<'_, State> {
    state.write().unwrap_or_else(PoisonError::into_inner)
}

fn usable_span(list: &[Ephemeris]) -> Option<(GpsTime, GpsTime)> {
    let spans = list.iter().filter(|ephemeris| is_usable(ephemeris)).map(|ephemeris| {
        let validity_s = validity_s(ephemeris);
        (ephemeris.toe() - validity_s, ephemeris.toe() + validity_s)
    });
    spans.reduce(|(from, until), (start, end)| (from.min(start), until.max(end)))
}
