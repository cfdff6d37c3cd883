//! States of parked sessions in memory, encoded: less than half of what a session in use takes. The
//! least recently parked make room for others.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use crate::snapshot::{SnapshotError, seal};
use crate::store::{EncodedSnapshot, SessionKey, SessionRow};
use crate::tenant::Tenant;

use super::SessionId;
use super::configuration::base_of;
use super::configurations::ActiveConfiguration;
use super::state::{Carried, State};

/// Memory of a parked state beside its content (bytes).
const OVERHEAD: usize = 3_072;
/// Spare bytes of a buffer that need not be given back: buffers pass from one state to the next, so
/// that none is allocated.
const SPARE: usize = 16 << 10;

/// Time in which a desk that stops stores the states of its sessions. The epochs of the others are
/// replayed.
const STORING_AT_STOP: Duration = Duration::from_secs(5);

/// The end of the time in which states are stored, if the desk stops now.
pub(super) fn stores_until() -> Instant {
    Instant::now() + STORING_AT_STOP
}

/// Who keeps the states of parked sessions: the desk.
pub(super) trait KeepsParked: Send + Sync {
    /// Until when the states of sessions are stored, if no session will start any more.
    fn stops(&self) -> Option<Instant>;

    /// Keeps the state of a session whose task ends, unless it has changed since the task was to
    /// end. Returns the states that make room for it. `task` is the task's mark.
    fn keep_parked(
        &self,
        id: &SessionId,
        task: &Arc<AtomicBool>,
        state: Option<ParkedState>,
    ) -> Vec<ParkedState>;
}

/// The encoded state of a session, and what goes with it.
pub(super) struct ParkedState {
    pub(super) key: SessionKey,
    pub(super) tenant: Tenant,
    pub(super) seq: u64,
    /// Without a hash: it does not leave the memory.
    content: Vec<u8>,
    configuration: Arc<ActiveConfiguration>,
    /// Hash of the configuration with which the state was computed.
    configuration_hash: Arc<str>,
    carried: Carried,
    /// Expected time of an epoch on the solver.
    pub(super) epoch_time: Option<Duration>,
}

impl ParkedState {
    /// The encoded state of a session; `None` before the first epoch, and of a state that has
    /// another configuration than the next epoch.
    pub(super) fn of(
        (key, tenant): (SessionKey, &Tenant),
        state: &State,
        configuration: Arc<ActiveConfiguration>,
        epoch_time: Option<Duration>,
        buffer: Vec<u8>,
    ) -> Option<Self> {
        if state.configuration_hash != configuration.estimation.hash {
            return None;
        }
        let (seq, mut content) = state.unsealed(buffer)?;
        if content.len() + SPARE < content.capacity() {
            content.shrink_to(content.len() + SPARE / 2);
        }
        let (configuration_hash, carried) = (state.configuration_hash.clone(), state.carried());
        Some(Self {
            key,
            tenant: tenant.clone(),
            seq,
            content,
            configuration,
            configuration_hash,
            carried,
            epoch_time,
        })
    }

    pub(super) fn configuration(&self) -> &Arc<ActiveConfiguration> {
        &self.configuration
    }

    /// Processor time that a replay of the epochs since the last stored state would take.
    pub(super) fn unsaved_time(&self) -> Duration {
        self.carried.unsaved_time()
    }

    /// The state for the store.
    pub(super) fn into_snapshot(self) -> EncodedSnapshot {
        EncodedSnapshot::new(self.seq, self.configuration_hash, seal(self.content))
    }

    /// Length of its content (bytes).
    pub(super) fn length(&self) -> usize {
        self.content.len()
    }

    /// The state, and the buffer that it was encoded in.
    pub(super) fn decoded(self) -> (Result<State, SnapshotError>, Vec<u8>) {
        let configuration = &self.configuration.estimation;
        let state = State::decode_unsealed(self.seq, &self.content, configuration);
        (state.map(|state| state.with(self.carried)), self.content)
    }

    /// Whether the settings of a session are still those of its parking.
    fn is_of(&self, row: &SessionRow) -> bool {
        let (settings, active) = (&row.settings, &self.configuration);
        let mode = active.estimation.options.mode;
        settings.configuration_hash == active.estimation.hash
            && base_of(mode, &settings.base).is_ok_and(|bases| bases == active.bases)
            && settings.retention_days == active.retention_days
            && row.last_seq == Some(self.seq)
    }

    fn bytes(&self) -> usize {
        OVERHEAD + self.content.capacity() + self.carried.bytes()
    }
}

/// The states of parked sessions, up to a limit of their bytes.
pub(super) struct ParkedStates {
    states: HashMap<SessionId, (u64, ParkedState)>,
    /// The order of parking. Entries of states that have been taken since are skipped.
    order: VecDeque<(u64, SessionId)>,
    parked: u64,
    bytes: usize,
    bytes_max: usize,
}

impl ParkedStates {
    pub(super) fn new(bytes_max: usize) -> Self {
        let (states, order) = (HashMap::new(), VecDeque::new());
        Self { states, order, parked: 0, bytes: 0, bytes_max }
    }

    /// Number of states.
    pub(super) fn len(&self) -> usize {
        self.states.len()
    }

    /// Adds a state. Returns the oldest ones, which make room for it.
    pub(super) fn insert(&mut self, id: &SessionId, state: ParkedState) -> Vec<ParkedState> {
        self.remove(id);
        self.parked += 1;
        self.bytes += state.bytes();
        self.order.push_back((self.parked, id.clone()));
        self.states.insert(id.clone(), (self.parked, state));
        let mut dropped = Vec::new();
        while self.bytes_max < self.bytes {
            let Some((number, id)) = self.order.pop_front() else { break };
            if self.states.get(&id).is_some_and(|(parked, _)| *parked == number) {
                dropped.extend(self.remove(&id));
            }
        }
        if 2 * self.states.len() < self.order.len() {
            let states = &self.states;
            self.order
                .retain(|(number, id)| states.get(id).is_some_and(|(parked, _)| parked == number));
        }
        dropped
    }

    /// Takes the state of a session, if there is one and the session is as it was.
    pub(super) fn take(&mut self, id: &SessionId, row: &SessionRow) -> Option<ParkedState> {
        self.remove(id).filter(|state| state.is_of(row))
    }

    /// Whether there is a state of a tenant's session.
    pub(super) fn has(&self, id: &SessionId, tenant: &Tenant) -> bool {
        self.states.get(id).is_some_and(|(_, state)| state.tenant == *tenant)
    }

    /// Drops all.
    pub(super) fn clear(&mut self) {
        *self = Self::new(self.bytes_max);
    }

    /// Takes the state of a session.
    pub(super) fn remove(&mut self, id: &SessionId) -> Option<ParkedState> {
        let (_, state) = self.states.remove(id)?;
        self.bytes -= state.bytes();
        Some(state)
    }
}
