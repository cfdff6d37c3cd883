//! Encoded states of parked sessions in memory: each takes less than half the memory of an active
//! session. The least recently parked states are dropped to make room.

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

/// Memory of a parked state besides its content (bytes).
const OVERHEAD: usize = 3_072;
/// Spare capacity of a buffer that is not given back (bytes). Buffers are used again for the next
/// states, so that none is allocated.
const SPARE: usize = 16 << 10;

/// Time in which a desk that stops stores the states of its sessions. Sessions whose state is not
/// stored by then replay their epochs after the restart.
const STORING_AT_STOP: Duration = Duration::from_secs(5);

/// The time until which states are stored, if the desk stops now.
pub(super) fn stores_until() -> Instant {
    Instant::now() + STORING_AT_STOP
}

/// The keeper of the states of parked sessions, which is the desk.
pub(super) trait KeepsParked: Send + Sync {
    /// The time until which states are stored; `None` while the desk does not stop.
    fn stops(&self) -> Option<Instant>;

    /// Keeps the state of a session whose task has ended, unless the session has changed since the
    /// task was told to end. Returns the states that were dropped to make room. `task` is the mark
    /// of the task, as in `Tasks::parking`.
    fn keep_parked(
        &self,
        id: &SessionId,
        task: &Arc<AtomicBool>,
        state: Option<ParkedState>,
    ) -> Vec<ParkedState>;
}

/// The encoded state of a session, with its configuration and the values that it carries.
pub(super) struct ParkedState {
    pub(super) key: SessionKey,
    pub(super) tenant: Tenant,
    pub(super) seq: u64,
    /// The bytes of the state. They have no hash, because they do not leave the memory.
    content: Vec<u8>,
    configuration: Arc<ActiveConfiguration>,
    /// Hash of the configuration with which the state was computed.
    configuration_hash: Arc<str>,
    carried: Carried,
    /// Expected time of an epoch on the solver.
    pub(super) epoch_time: Option<Duration>,
    /// The last day for which a snapshot is kept, if it is known.
    pub(super) kept_day: Option<i64>,
}

impl ParkedState {
    /// The encoded state of a session; `None` before the first epoch, and if the next epoch would
    /// start a new estimator because the configuration has changed.
    pub(super) fn of(
        (key, tenant): (SessionKey, &Tenant),
        state: &State,
        configuration: Arc<ActiveConfiguration>,
        (epoch_time, kept_day): (Option<Duration>, Option<i64>),
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
            kept_day,
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
        let (hash, since_day) = (self.configuration_hash, self.carried.since_day());
        EncodedSnapshot::new(self.seq, hash, seal(self.content), since_day)
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

    /// Whether the session has the same settings and last epoch as when it was parked.
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
    /// The order of parking. It may have entries of states that are no longer there; they are
    /// skipped.
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

    /// Adds a state. Returns the oldest states, which were dropped to make room.
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

    /// Takes the state of a session, if there is one and the session has not changed since.
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
