//! Numbers of events of all sessions since the start.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// The counters, which all tasks share.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) restores: AtomicU64,
    pub(super) quarantined: AtomicU64,
    /// Sessions with a state in memory.
    pub(super) in_memory: AtomicUsize,
}

/// Numbers of events of all sessions since the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionCounts {
    /// States loaded from the store.
    pub restores: u64,
    /// Epochs on which an estimator panicked.
    pub quarantined: u64,
}

impl Counters {
    pub(super) fn read(&self) -> SessionCounts {
        SessionCounts {
            restores: self.restores.load(Ordering::Relaxed),
            quarantined: self.quarantined.load(Ordering::Relaxed),
        }
    }
}
