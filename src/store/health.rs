//! State of the store: whether commits succeed, and how durable they are.

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
    /// Another service has had the lease meanwhile. The committer commits nothing any more, so the
    /// service must start again.
    LeaseLost {
        /// Name of the other node.
        holder: Arc<str>,
    },
    /// It was stopped.
    Stopped,
}

/// State and counts of the committer.
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

    /// Whether it has ended and commits nothing any more.
    pub(super) const fn has_ended(&self) -> bool {
        matches!(self.state, CommitterState::Stopped | CommitterState::LeaseLost { .. })
    }

    /// Time since the last confirmation.
    pub(crate) fn silence(&self) -> Duration {
        self.confirmed.elapsed()
    }
}

/// A setting of the database on which durability or size depends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DatabaseSetting {
    /// Its name in the database.
    pub name: &'static str,
    /// Its value on the committer's connection.
    pub value: String,
    /// What may happen with this value; `None` if it is right.
    pub risk: Option<SettingRisk>,
}

/// What may happen with a wrong setting of the database.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingRisk {
    /// A power failure loses or damages acknowledged data.
    PowerFailure,
    /// The database grows for ever.
    Growth,
}

impl SettingRisk {
    /// The risk in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::PowerFailure => "a power failure may lose acknowledged data",
            Self::Growth => "the space of removed rows is not used again",
        }
    }
}
