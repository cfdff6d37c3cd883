//! Meters of the committer.

use std::sync::Arc;
use std::time::Duration;

use crate::meters::{self, Counter, Histogram};

use super::batch::Batch;

/// What the committer has done since the start. Clones share it.
#[derive(Clone, Debug)]
pub(crate) struct CommitterMeters {
    /// Committed transactions.
    pub(crate) transactions: Counter,
    /// Times of these transactions (s).
    pub(crate) seconds: Histogram,
    /// Epochs of each of them.
    pub(crate) epochs: Histogram,
    /// Bytes of their epochs, solutions, states and raw chunks, as encoded.
    pub(crate) bytes: Counter,
}

impl CommitterMeters {
    pub(super) fn new() -> Self {
        let (transactions, bytes) = <(Counter, Counter)>::default();
        Self { transactions, seconds: meters::times(), epochs: meters::numbers(), bytes }
    }

    /// Counts a transaction.
    pub(super) fn count(&self, batches: &[Arc<Batch>], elapsed: Duration) {
        let epochs: usize = batches.iter().map(|batch| batch.epochs.len()).sum();
        self.transactions.inc();
        self.seconds.observe(elapsed.as_secs_f64());
        self.epochs.observe(epochs as f64);
        let bytes: usize = batches.iter().map(|batch| batch.bytes()).sum();
        self.bytes.inc_by(bytes as u64);
    }
}
