//! The running tasks of the desk, and the states of those that were parked.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use tokio::sync::mpsc;
use tokio::task::JoinSet;

use crate::store::SessionKey;
use crate::tenant::Tenant;

use super::SessionId;
use super::parked::ParkedStates;
use super::task::Message;

/// To make room, this fraction of the allowed tasks (1/64) is parked at once. So a start does not
/// search all tasks each time.
const PARKED_PART: usize = 64;

/// The running tasks. Messages are sent while this is locked, so a task that was removed from
/// `handles` with an empty mailbox receives no further message.
pub(super) struct Tasks {
    pub(super) handles: HashMap<SessionId, Handle>,
    pub(super) parked: ParkedStates,
    /// The marks of tasks that were told to end and have not handed over their states yet.
    pub(super) parking: HashMap<SessionId, Arc<AtomicBool>>,
    pub(super) running: JoinSet<()>,
    /// Counts messages, to find the least recently used sessions.
    pub(super) posted: u64,
    /// The time until which states are stored. It is set when no session may start any more.
    pub(super) stops: Option<Instant>,
}

/// The purpose for which a task is started.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Start {
    Epochs,
    /// Allowed beyond the limit of active sessions, because the task ends at once.
    Closing,
}

/// A running task.
pub(super) struct Handle {
    pub(super) key: SessionKey,
    /// Tenant that owns the session.
    pub(super) tenant: Tenant,
    pub(super) mailbox: mpsc::Sender<Message>,
    pub(super) waiting: Arc<AtomicUsize>,
    /// Set when the settings have changed since the task read them. It also identifies the task.
    pub(super) outdated: Arc<AtomicBool>,
    pub(super) last_used: u64,
    pub(super) started: Instant,
}

impl Tasks {
    /// No tasks. Parked states may take `parked_bytes` bytes.
    pub(super) fn new(parked_bytes: usize) -> Self {
        let (handles, parked) = (HashMap::new(), ParkedStates::new(parked_bytes));
        let (parking, running) = (HashMap::new(), JoinSet::new());
        Self { handles, parked, parking, running, posted: 0, stops: None }
    }

    /// The running task of a tenant's session.
    pub(super) fn own(&self, id: &SessionId, tenant: &Tenant) -> Option<&Handle> {
        self.handles.get(id).filter(|handle| handle.tenant == *tenant)
    }

    /// Notes that the settings of a session have changed: its task reads them before its next
    /// epochs.
    pub(super) fn outdate(&mut self, id: &SessionId) {
        if let Some(handle) = self.handles.get(id) {
            handle.outdated.store(true, Ordering::Release);
        }
        self.forget_parked(id);
    }

    /// Drops the state with which a session was parked.
    pub(super) fn forget_parked(&mut self, id: &SessionId) {
        self.parking.remove(id);
        self.parked.remove(id);
    }

    /// Sessions with a state in memory.
    pub(super) fn in_memory(&self) -> usize {
        self.handles.len() + self.parked.len()
    }

    /// Ends the least recently used tasks with an empty mailbox: one, or a small fraction of
    /// `limit`. `false` if no mailbox is empty.
    pub(super) fn park_some(&mut self, limit: usize) -> bool {
        let idle = self.handles.iter().filter(|(_, h)| h.waiting.load(Ordering::Acquire) == 0);
        let mut idle: Vec<(u64, SessionId)> =
            idle.map(|(id, handle)| (handle.last_used, id.clone())).collect();
        let count = (limit / PARKED_PART).clamp(1, idle.len().max(1));
        if count < idle.len() {
            idle.select_nth_unstable(count);
            idle.truncate(count);
        }
        for (_, id) in &idle {
            if let Some(handle) = self.handles.remove(id) {
                self.parking.insert(id.clone(), handle.outdated);
            }
        }
        !idle.is_empty()
    }
}
