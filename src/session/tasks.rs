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

/// To make room, this part of the allowed tasks is parked at once, so that a start does not look
/// through all of them each time.
const PARKED_PART: usize = 64;

/// The running tasks. Messages are sent while this is locked, so a task that was removed from
/// `handles` with an empty mailbox receives no further message.
pub(super) struct Tasks {
    pub(super) handles: HashMap<SessionId, Handle>,
    pub(super) parked: ParkedStates,
    pub(super) running: JoinSet<()>,
    /// Counts messages, to find the least recently used sessions.
    pub(super) posted: u64,
    pub(super) draining: bool,
}

/// What a task is started for.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Start {
    Epochs,
    /// Allowed beyond the limit of active sessions, because the task ends at once.
    Closing,
}

/// A running task.
pub(super) struct Handle {
    pub(super) key: SessionKey,
    /// To whom the session belongs.
    pub(super) tenant: Tenant,
    pub(super) mailbox: mpsc::Sender<Message>,
    pub(super) waiting: Arc<AtomicUsize>,
    pub(super) outdated: Arc<AtomicBool>,
    pub(super) last_used: u64,
    pub(super) started: Instant,
}

impl Tasks {
    /// No tasks; parked states may have `parked_bytes` bytes.
    pub(super) fn new(parked_bytes: usize) -> Self {
        let (handles, parked) = (HashMap::new(), ParkedStates::new(parked_bytes));
        Self { handles, parked, running: JoinSet::new(), posted: 0, draining: false }
    }

    /// The running task of a tenant's session.
    pub(super) fn own(&self, id: &SessionId, tenant: &Tenant) -> Option<&Handle> {
        self.handles.get(id).filter(|handle| handle.tenant == *tenant)
    }

    /// Sessions with a state in memory.
    pub(super) fn in_memory(&self) -> usize {
        self.handles.len() + self.parked.len()
    }

    /// Ends the least recently used tasks with an empty mailbox, one or a small part of `limit`;
    /// `false` if every mailbox has epochs.
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
            self.handles.remove(id);
        }
        !idle.is_empty()
    }
}
