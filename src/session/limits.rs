//! Limits of the desk.

use std::num::NonZeroUsize;
use std::thread::available_parallelism;
use std::time::Duration;

/// Limits of the desk. Together they bound its memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionLimits {
    /// Epochs that may wait in one session's mailbox; at least `epochs_per_push`.
    pub mailbox_epochs: usize,
    /// Epochs that may wait in all mailboxes together; at least `epochs_per_push`.
    pub waiting_epochs: usize,
    /// Epochs in one push.
    pub epochs_per_push: usize,
    /// Bytes in one raw chunk.
    pub raw_chunk_bytes: usize,
    /// Observations in one epoch.
    pub observations_per_epoch: usize,
    /// Time that an epoch may be ahead of the service's clock (s). A receiver that counts weeks
    /// wrongly is a week ahead at least, and no clock of a server is a day behind.
    pub future_s: u64,
    /// Time for which epochs are kept if their session sets none (days); 0 for ever.
    pub retention_days: u32,
    /// Time for which entries of the audit log are kept (days); 0 for ever.
    pub audit_days: u32,
    /// Time for which the hours of the history are kept (days); 0 for ever. They outlive the
    /// epochs.
    pub history_days: u32,
    /// Most sessions with an estimator in memory. Above, the least recently used idle one is
    /// parked.
    pub active_sessions: usize,
    /// Most bytes of encoded states of parked sessions in memory. Above, the least recently parked
    /// states are dropped, and restored from the store when they are needed.
    pub parked_bytes: usize,
    /// Bases that one session may choose from.
    pub candidate_bases: usize,
    /// Epochs in the window of a computation on request.
    pub solve_window_epochs: usize,
    /// Time that a computation on request may use the solver pool.
    pub solve_time: Duration,
    /// Newly committed solutions in memory for watches. A watch that is further behind reads the
    /// store.
    pub live_solutions: usize,
    /// Characters of a label.
    pub label_characters: usize,
    /// Threads that run estimators.
    pub solver_threads: NonZeroUsize,
    /// Delay that a client is asked to wait when a mailbox is full.
    pub retry_after: Duration,
}

impl SessionLimits {
    /// Limits of a service on one machine, with one solver thread per core.
    pub fn service() -> Self {
        Self {
            mailbox_epochs: 2_048,
            waiting_epochs: 32_768,
            epochs_per_push: 1_024,
            raw_chunk_bytes: 256 << 10,
            observations_per_epoch: 512,
            future_s: 86_400,
            retention_days: 90,
            audit_days: 400,
            history_days: 400,
            active_sessions: 4_096,
            parked_bytes: 512 << 20,
            candidate_bases: 32,
            solve_window_epochs: 300,
            solve_time: Duration::from_secs(5),
            live_solutions: 4_096,
            label_characters: 200,
            solver_threads: available_parallelism().unwrap_or(NonZeroUsize::MIN),
            retry_after: Duration::from_millis(100),
        }
    }
}
