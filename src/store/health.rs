//! What the store reports of itself: whether commits succeed, and how durable they are.

use std::sync::Arc;
use std::time::{Duration, Instant};

/// Whether the committer can commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CommitterState {
    /// The last commit or probe succeeded.
    Working,
    /// The last one failed, and no connection has been probed since. Commits are refused.
    Failed {
        /// Message of the failure.
        why: Arc<str>,
    },
    /// Another service had the lease meanwhile. It commits nothing any more: the service must start
    /// again.
    LeaseLost {
        /// Name of the other node.
        holder: Arc<str>,
    },
    /// It was stopped.
    Stopped,
}

/// What the committer reports of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommitterHealth {
    /// Whether it can commit.
    pub state: CommitterState,
    /// When the database last confirmed a commit or a probe. An idle committer probes every two
    /// seconds.
    pub confirmed: Instant,
    /// Number of groups of batches that failed.
    pub failures: u64,
    /// Number of panics in the committer.
    pub panics: u64,
}

impl CommitterHealth {
    pub(super) fn new() -> Self {
        let confirmed = Instant::now();
        Self { state: CommitterState::Working, confirmed, failures: 0, panics: 0 }
    }

    /// Whether it will commit nothing any more.
    pub(super) const fn has_ended(&self) -> bool {
        matches!(self.state, CommitterState::Stopped | CommitterState::LeaseLost { .. })
    }

    /// Time since the last confirmation.
    pub(crate) fn silence(&self) -> Duration {
        self.confirmed.elapsed()
    }
}

/// A setting of the database on which durability depends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DurabilitySetting {
    /// Its name in the database.
    pub name: &'static str,
    /// Its value on the committer's connection.
    pub value: String,
    /// Whether a power failure may lose or damage acknowledged data with this value.
    pub is_safe: bool,
}
