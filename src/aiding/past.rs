//! Past states of the navigation data, for replay.
//!
//! A state is made from the nearest known one, by the difference between the two. Sessions that are
//! restored after a restart need many states, which differ by few ephemerides. States share the
//! lists of satellites that are the same. A limit bounds the memory of the lists that differ.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::mem::size_of;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};

use crate::gnss::{Ephemeris, Navigation, SatelliteId};
use crate::store::{
    NavigationDifference, Store, StoreError, StoredCoefficients, StoredEphemeris, account_of,
};

use super::devices::remove_coefficients;
use super::shared::Shared;
use super::state::{PushedNavigation, State};
use super::trust::{Trust, trust};

/// Most memory of the lists that past states do not share (bytes).
const BYTES_MAX: usize = 64 << 20;
/// Memory of a state besides its lists (bytes).
const OVERHEAD: usize = 16 << 10;
/// Memory of an ephemeris, and that of a device's entry in its map (bytes).
const EPHEMERIS: usize = size_of::<Ephemeris>();
const ENTRY: usize = 128;
/// Number of maps into which devices are divided, so that a change of one device copies few others.
const MAPS: usize = 64;

/// Reads of the store at a time. Each may read the changes of many pushes.
const READS: usize = 2;

/// The states that replay asked for recently.
#[derive(Default)]
pub(super) struct PastStates {
    known: Mutex<Known>,
    /// Each is locked while the store is read for one of its pushes, because many sessions restored
    /// at once need the same push.
    reading: [tokio::sync::Mutex<()>; READS],
}

#[derive(Default)]
struct Known {
    /// States by push, each with the memory that it does not share.
    states: BTreeMap<u64, (Arc<PastState>, usize)>,
    /// The pushes in the order in which their states were made.
    order: VecDeque<u64>,
    bytes: usize,
}

/// The navigation data after a push.
#[derive(Clone)]
struct PastState {
    push: u64,
    shared: Shared,
    /// The data that serve only the session of each device.
    devices: [Arc<BTreeMap<Arc<str>, Navigation>>; MAPS],
    /// Accounts of which some data are unknown, because they are no longer stored.
    incomplete: BTreeSet<String>,
}

impl PastStates {
    /// The data that served the session of a device after a push. `current` is the present state.
    ///
    /// # Errors
    /// Some of it is no longer stored, or the store fails.
    pub(super) async fn after(
        &self,
        push: u64,
        device: &str,
        store: &Store,
        current: &RwLock<State>,
    ) -> Result<PushedNavigation, StoreError> {
        let account = account_of(device);
        if let Some(state) = self.known().state(push, account) {
            return Ok(state.pushed_for(device));
        }
        let _reading = self.reading[push as usize % READS].lock().await;
        if let Some(state) = self.known().state(push, account) {
            return Ok(state.pushed_for(device)); // Another session has needed it, too.
        }
        let nearest = self.known().nearest(push, account, current);
        let difference = store.navigation_difference(nearest.push, push, account).await?;
        let (state, bytes) = match difference {
            Some(difference) => nearest.changed(push, difference),
            // Some rows of the difference are no longer stored.
            None => {
                let (stored, incomplete) = store.navigation_after(push, account).await?;
                let mut state = PastState::of(&State::of(stored));
                state.incomplete.extend(incomplete);
                let ephemerides = state.shared.navigation.len();
                let bytes = ephemerides * EPHEMERIS + state.bytes_of_maps();
                (state, bytes)
            }
        };
        let state = Arc::new(state);
        self.known().insert(state.clone(), bytes);
        Ok(state.pushed_for(device))
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Known {
    /// The state after a push, if it is known and complete for sessions of an account.
    fn state(&self, push: u64, account: &str) -> Option<Arc<PastState>> {
        let state = self.states.get(&push).map(|(state, _)| state);
        state.filter(|state| state.is_complete_for(account)).cloned()
    }

    /// The known state, or the present one, that is nearest to a push, of those that are complete
    /// for sessions of an account.
    fn nearest(&mut self, push: u64, account: &str, current: &RwLock<State>) -> Arc<PastState> {
        let is_complete =
            |(_, (state, _)): &(&u64, &(Arc<PastState>, usize))| state.is_complete_for(account);
        let before = self.states.range(..push).rev().find(is_complete);
        let after = self.states.range(push..).find(is_complete);
        let distance = |state: &Arc<PastState>| state.push.abs_diff(push);
        let near = before.into_iter().chain(after).map(|(_, (state, _))| state);
        let near = near.min_by_key(|state| distance(state)).cloned();
        let current = current.read().unwrap_or_else(PoisonError::into_inner);
        match near.filter(|near| distance(near) <= current.push.abs_diff(push)) {
            Some(near) => near,
            None => {
                let present = Arc::new(PastState::of(&current));
                // It shares its lists with the present state, and has maps of its own.
                self.insert(present.clone(), present.bytes_of_maps());
                present
            }
        }
    }

    /// Adds a state. The oldest states are removed to make room.
    fn insert(&mut self, state: Arc<PastState>, bytes: usize) {
        let (push, bytes) = (state.push, OVERHEAD + bytes);
        self.bytes += bytes;
        match self.states.insert(push, (state, bytes)) {
            None => self.order.push_back(push),
            Some((_, replaced)) => self.bytes -= replaced,
        }
        while BYTES_MAX < self.bytes && 1 < self.order.len() {
            let oldest = self.order.pop_front().and_then(|push| self.states.remove(&push));
            self.bytes -= oldest.map_or(0, |(_, bytes)| bytes);
        }
    }
}

impl PastState {
    fn of(state: &State) -> Self {
        let mut past = Self {
            push: state.push,
            shared: state.shared.clone(),
            devices: std::array::from_fn(|_| Arc::default()),
            incomplete: BTreeSet::new(),
        };
        for (device, own) in state.devices.all() {
            let map = Arc::make_mut(&mut past.devices[map_of(device)]);
            map.insert(device.clone(), own.clone());
        }
        past
    }

    /// Whether all data for sessions of an account are known.
    fn is_complete_for(&self, account: &str) -> bool {
        !self.incomplete.contains(account)
    }

    fn pushed_for(&self, device: &str) -> PushedNavigation {
        let own = self.devices[map_of(device)].get(device);
        let shared = || self.shared.navigation.clone();
        let navigation = own.map_or_else(shared, |own| Arc::new(self.shared.view(own)));
        PushedNavigation { push: self.push, navigation }
    }

    /// The state after another push, and the memory that it does not share with this one.
    fn changed(&self, push: u64, difference: NavigationDifference) -> (Self, usize) {
        let NavigationDifference { ended, begun, incomplete } = difference;
        let mut state = Self { push, ..self.clone() };
        state.incomplete.extend(incomplete);
        let (mut satellites, mut devices) = (BTreeSet::new(), BTreeSet::new());
        for row in ended.ephemerides.iter().chain(&begun.ephemerides) {
            match trust(&row.source) {
                Trust::Device => drop(devices.insert(row.source.clone())),
                _ => drop(satellites.insert(row.ephemeris.satellite())),
            }
        }
        for StoredEphemeris { ephemeris, source, .. } in ended.ephemerides {
            match state.own(&source) {
                Some(own) => drop(own.remove(&ephemeris)),
                None => state.shared.remove(&[ephemeris]),
            }
        }
        for StoredCoefficients { coefficients, source } in ended.coefficients {
            match state.own(&source) {
                Some(own) => remove_coefficients(own, &coefficients),
                None => state.shared.remove_coefficients(&coefficients),
            }
        }
        for StoredEphemeris { ephemeris, source, stored_unix_ms } in begun.ephemerides {
            match state.own(&source) {
                Some(own) => drop(own.insert(ephemeris)),
                None => state.shared.insert(ephemeris, &source.into(), stored_unix_ms),
            }
        }
        for StoredCoefficients { coefficients, source } in begun.coefficients {
            match state.own(&source) {
                Some(own) => drop(own.merge(coefficients)),
                None => state.shared.insert_coefficients(&coefficients, &source.into()),
            }
        }
        let bytes = state.bytes_of(&satellites, &devices);
        (state, bytes)
    }

    /// The data of a device; `None` if the source is not one.
    fn own(&mut self, source: &str) -> Option<&mut Navigation> {
        (trust(source) == Trust::Device).then(|| {
            let map = Arc::make_mut(&mut self.devices[map_of(source)]);
            map.entry(source.into()).or_default()
        })
    }

    /// The memory of the maps of devices, without their lists.
    fn bytes_of_maps(&self) -> usize {
        self.devices.iter().map(|map| map.len() * ENTRY).sum()
    }

    /// The memory of the lists of these satellites and devices.
    fn bytes_of(&self, satellites: &BTreeSet<SatelliteId>, devices: &BTreeSet<String>) -> usize {
        let of_shared = satellites.iter().map(|satellite| self.shared.navigation.of(*satellite));
        let of_devices = devices.iter().map(|device| {
            let map = &self.devices[map_of(device)];
            map.len() * ENTRY + map.get(&**device).map_or(0, Navigation::len) * EPHEMERIS
        });
        of_shared.map(|list| list.len() * EPHEMERIS).chain(of_devices).sum()
    }
}

fn map_of(device: &str) -> usize {
    let mut hasher = DefaultHasher::new();
    device.hash(&mut hasher);
    hasher.finish() as usize % MAPS
}
