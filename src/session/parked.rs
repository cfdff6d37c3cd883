//! States of parked sessions in memory, encoded: less than half of what a session in use takes. The
//! least recently parked make room for others.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use crate::snapshot::SnapshotError;
use crate::store::{EncodedSnapshot, SessionRow};

use super::SessionId;
use super::configuration::base_of;
use super::replay::ActiveConfiguration;
use super::state::{Carried, State};

/// Memory of a parked state beside its content (bytes).
const OVERHEAD: usize = 3_072;

/// Who keeps the states of parked sessions: the desk.
pub(super) trait KeepsParked: Send + Sync {
    /// Whether no session will start any more.
    fn is_draining(&self) -> bool;

    /// Keeps the state of a session whose task ends, unless another task has begun.
    fn keep_parked(&self, id: &SessionId, parked: ParkedState);
}

/// The encoded state of a session, and what goes with it.
pub(super) struct ParkedState {
    seq: u64,
    content: Vec<u8>,
    configuration: Arc<ActiveConfiguration>,
    /// Hash of the configuration with which the state was computed.
    configuration_hash: Arc<str>,
    carried: Carried,
}

impl ParkedState {
    /// A state with its encoded content after epoch `seq`.
    pub(super) fn new(
        state: Arc<State>,
        configuration: Arc<ActiveConfiguration>,
        (seq, content): (u64, Vec<u8>),
    ) -> Self {
        let (configuration_hash, carried) = (state.configuration_hash.clone(), state.carried());
        Self { seq, content, configuration, configuration_hash, carried }
    }

    pub(super) fn configuration(&self) -> &Arc<ActiveConfiguration> {
        &self.configuration
    }

    /// The state for the store.
    pub(super) fn snapshot(&self) -> EncodedSnapshot {
        let hash = self.configuration_hash.clone();
        EncodedSnapshot::new(self.seq, hash, self.content.clone())
    }

    /// Notes that the state is stored. If it is kept for replay, retention may remove the epochs
    /// before it, and the next epoch is stored whole.
    pub(super) fn note_stored(&mut self, is_kept: bool) {
        self.carried.note_stored(is_kept);
    }

    /// The state.
    pub(super) fn decoded(self) -> Result<State, SnapshotError> {
        let state = State::decode(self.seq, &self.content, &self.configuration.estimation)?;
        Ok(state.with(self.carried))
    }

    /// Whether the settings of a session are still those of its parking.
    fn is_of(&self, row: &SessionRow) -> bool {
        let (settings, active) = (&row.settings, &self.configuration);
        let mode = active.estimation.options.mode;
        settings.configuration_hash == active.estimation.hash
            && self.configuration_hash == active.estimation.hash
            && base_of(mode, &settings.base).is_ok_and(|bases| bases == active.bases)
            && settings.retention_days == active.retention_days
            && row.last_seq == Some(self.seq)
    }

    fn bytes(&self) -> usize {
        OVERHEAD + self.content.len() + self.carried.bytes()
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

    /// Adds a state. The oldest ones make room for it.
    pub(super) fn insert(&mut self, id: &SessionId, state: ParkedState) {
        self.remove(id);
        self.parked += 1;
        self.bytes += state.bytes();
        self.order.push_back((self.parked, id.clone()));
        self.states.insert(id.clone(), (self.parked, state));
        while self.bytes_max < self.bytes || 2 * self.states.len() < self.order.len() {
            let Some((number, id)) = self.order.pop_front() else { return };
            if self.states.get(&id).is_some_and(|(parked, _)| *parked == number) {
                if self.bytes <= self.bytes_max {
                    self.order.push_front((number, id)); // Only skipped entries had to go.
                    self.order.retain(|(number, id)| {
                        self.states.get(id).is_some_and(|(parked, _)| parked == number)
                    });
                    return;
                }
                self.remove(&id);
            }
        }
    }

    /// Takes the state of a session, if there is one and the session is as it was.
    pub(super) fn take(&mut self, id: &SessionId, row: &SessionRow) -> Option<ParkedState> {
        self.remove(id).filter(|state| state.is_of(row))
    }

    /// Drops all.
    pub(super) fn clear(&mut self) {
        *self = Self::new(self.bytes_max);
    }

    fn remove(&mut self, id: &SessionId) -> Option<ParkedState> {
        let (_, state) = self.states.remove(id)?;
        self.bytes -= state.bytes();
        Some(state)
    }
}
