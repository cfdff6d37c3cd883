//! Epochs that are pushed, and the answers to them.

use std::ops::RangeInclusive;

use tokio::sync::oneshot;

use crate::config::OutputOptions;
use crate::gnss::{Epoch, GpsTime};
use crate::refusal::Code;
use crate::store::StoredSolution;

use super::SessionError;

/// The allowed epoch numbers. Every JSON reader keeps integers up to the last one exactly.
pub const SEQUENCES: RangeInclusive<u64> = 1..=(1 << 53) - 1;

/// An epoch with its client's number.
#[derive(Clone, Debug, PartialEq)]
pub struct SequencedEpoch {
    /// The client's number. Numbers rise, and may have gaps.
    pub seq: u64,
    /// The observations.
    pub epoch: Epoch,
}

/// The answer to a push.
#[derive(Clone, Debug, PartialEq)]
pub struct Submitted {
    /// The outcome of each epoch, in the order of the push.
    pub outcomes: Vec<EpochOutcome>,
    /// Number of the session's last committed epoch. A device may delete its epochs up to this one.
    pub durable_through: Option<u64>,
    /// Frame and heights in which the session's solutions are reported.
    pub output: OutputOptions,
}

/// The outcome of one epoch.
#[derive(Clone, Debug, PartialEq)]
pub struct EpochOutcome {
    /// The client's number.
    pub seq: u64,
    /// The committed solution, or why the epoch is refused.
    pub result: Result<Acknowledged, EpochRefusal>,
}

/// A committed epoch and its solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Acknowledged {
    /// The solution, revision 0.
    pub solution: StoredSolution,
    /// The epoch had been committed before, and is answered from the store.
    pub resent: bool,
}

/// Why an epoch is refused. Other epochs of the push are not affected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EpochRefusal {
    /// An epoch with other content is stored under this number.
    #[error("epoch {seq} is stored with other content")]
    Conflict {
        /// Number of the epoch.
        seq: u64,
    },
    /// The number is below the last one, and no epoch is stored under it.
    #[error("epoch {seq} arrives after epoch {last} and was never stored")]
    Superseded {
        /// Number of the epoch.
        seq: u64,
        /// The session's last number.
        last: u64,
    },
    /// The number is among those whose epochs are removed, as they are older than the retention.
    #[error(
        "epoch {seq} is older than the session's retention; epochs below {oldest_available} are \
         removed"
    )]
    AlreadyAcknowledged {
        /// Number of the epoch.
        seq: u64,
        /// The number below which all epochs are removed.
        oldest_available: u64,
    },
    /// The number is above the last one, but the time is not after the last epoch's.
    #[error("epoch {seq} at {time} is not after the session's last epoch at {last}")]
    OutOfOrder {
        /// Number of the epoch.
        seq: u64,
        /// Time of the epoch.
        time: GpsTime,
        /// Time of the session's last epoch.
        last: GpsTime,
    },
    /// The time is far ahead of the service's clock. If it were stored, the session would refuse
    /// all epochs until that time.
    #[error("epoch {seq} at {time} is more than {ahead_s} s ahead of the service's clock")]
    TimeImplausible {
        /// Number of the epoch.
        seq: u64,
        /// Time of the epoch.
        time: GpsTime,
        /// The time that an epoch may be ahead of the clock (s).
        ahead_s: u64,
    },
    /// The time is before GPS time begins, which no receiver has measured.
    #[error("epoch {seq} at {time} is before GPS time begins, 1980-01-06")]
    TimeBeforeGps {
        /// Number of the epoch.
        seq: u64,
        /// Time of the epoch.
        time: GpsTime,
    },
    /// The epoch has more observations than allowed.
    #[error("epoch {seq} has {observations} observations, at most {limit} are allowed")]
    TooManyObservations {
        /// Number of the epoch.
        seq: u64,
        /// Number of its observations.
        observations: usize,
        /// Number of observations allowed.
        limit: usize,
    },
    /// The number is out of range.
    #[error("epoch number {seq} is not in {} to {}", SEQUENCES.start(), SEQUENCES.end())]
    SequenceOutOfRange {
        /// Number of the epoch.
        seq: u64,
    },
}

impl EpochRefusal {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Conflict { .. } => Code::SequenceConflict,
            Self::Superseded { .. } => Code::SequenceSuperseded,
            Self::AlreadyAcknowledged { .. } => Code::AlreadyAcknowledged,
            Self::OutOfOrder { .. } => Code::OutOfOrder,
            Self::TimeImplausible { .. } | Self::TimeBeforeGps { .. } => Code::TimeImplausible,
            Self::TooManyObservations { .. } => Code::TooManyObservations,
            Self::SequenceOutOfRange { .. } => Code::InvalidSequence,
        }
    }

    /// The field of the epoch that is at fault.
    pub const fn field(&self) -> &'static str {
        match self {
            Self::Conflict { .. }
            | Self::Superseded { .. }
            | Self::AlreadyAcknowledged { .. }
            | Self::SequenceOutOfRange { .. } => "seq",
            Self::OutOfOrder { .. } | Self::TimeImplausible { .. } | Self::TimeBeforeGps { .. } => {
                "time"
            }
            Self::TooManyObservations { .. } => "observations",
        }
    }
}

/// A push in the mailbox. Dropping this loses the answer, but not the epochs.
#[derive(Debug)]
pub struct Pending(pub(super) oneshot::Receiver<Result<Submitted, SessionError>>);

impl Pending {
    /// Waits until the push is committed.
    ///
    /// # Errors
    /// The store failed: nothing of the push is acknowledged.
    pub async fn answer(self) -> Result<Submitted, SessionError> {
        self.0.await.unwrap_or(Err(SessionError::Interrupted))
    }
}
