//! Limits of the desk.

use std::num::NonZeroUsize;
use std::thread::available_parallelism;
use std::time::Duration;

/// Limits of the desk; together they bound its memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionLimits {
    /// Epochs that may wait in one session's mailbox; never below `epochs_per_batch`.
    pub mailbox_epochs: usize,
    /// Epochs that may wait in all mailboxes together; never below `epochs_per_batch`.
    pub waiting_epochs: usize,
    /// Epochs of one batch.
    pub epochs_per_batch: usize,
    /// Bytes of one piece of a receiver's stream.
    pub raw_piece_bytes: usize,
    /// Observations of one epoch.
    pub observations_per_epoch: usize,
    /// Sessions that hold an estimator in memory; the least recently used idle one is parked.
    pub active_sessions: usize,
    /// Bases of which one session takes the nearest.
    pub candidate_bases: usize,
    /// Characters of a label.
    pub label_characters: usize,
    /// Threads that estimate at the same time.
    pub solver_threads: NonZeroUsize,
    /// The delay that a full mailbox asks for.
    pub retry_after: Duration,
}

impl SessionLimits {
    /// Limits of a service on one machine: as many solver threads as it has cores.
    pub fn service() -> Self {
        Self {
            mailbox_epochs: 2_048,
            waiting_epochs: 32_768,
            epochs_per_batch: 1_024,
            raw_piece_bytes: 256 << 10,
            observations_per_epoch: 512,
            active_sessions: 4_096,
            candidate_bases: 32,
            label_characters: 200,
            solver_threads: available_parallelism().unwrap_or(NonZeroUsize::MIN),
            retry_after: Duration::from_millis(100),
        }
    }
}
