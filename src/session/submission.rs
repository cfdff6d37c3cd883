//! Epochs on their way in, and what became of them.

use tokio::sync::oneshot;

use crate::gnss::{Epoch, GpsTime};
use crate::refusal::Code;
use crate::store::StoredSolution;

use super::SessionError;

/// An epoch under its client's number.
#[derive(Clone, Debug, PartialEq)]
pub struct SequencedEpoch {
    /// The client's number: rising, gaps allowed.
    pub seq: u64,
    /// What was observed.
    pub epoch: Epoch,
}

/// The answer to a batch of epochs.
#[derive(Clone, Debug, PartialEq)]
pub struct Submitted {
    /// One for each epoch, in their order.
    pub outcomes: Vec<EpochOutcome>,
    /// The session's last committed epoch: a device may forget what was acknowledged up to it.
    pub durable_through: Option<u64>,
}

/// What became of one epoch.
#[derive(Clone, Debug, PartialEq)]
pub struct EpochOutcome {
    /// The client's number.
    pub seq: u64,
    /// The committed solution, or why the epoch was not taken.
    pub result: Result<Acknowledged, EpochRefusal>,
}

/// An epoch that is committed with its solution.
#[derive(Clone, Debug, PartialEq)]
pub struct Acknowledged {
    /// The answer, revision 0.
    pub solution: StoredSolution,
    /// The epoch had been committed before and is answered from the store.
    pub resent: bool,
}

/// Why an epoch was not taken. The session goes on without it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EpochRefusal {
    /// Other content is stored under this number.
    #[error("epoch {seq} is stored with other content")]
    Conflict {
        /// The number.
        seq: u64,
    },
    /// The number is below the last one and nothing is stored under it.
    #[error("epoch {seq} comes after epoch {last} and was never stored")]
    Superseded {
        /// The number.
        seq: u64,
        /// The session's last number.
        last: u64,
    },
    /// The number is above the last one but its time is not.
    #[error("epoch {seq} at {time} is not after the session's last epoch at {last}")]
    OutOfOrder {
        /// The number.
        seq: u64,
        /// Its time.
        time: GpsTime,
        /// Time of the session's last epoch.
        last: GpsTime,
    },
    /// More observations than one epoch may carry.
    #[error("epoch {seq} has {observations} observations, allowed are {limit}")]
    TooManyObservations {
        /// The number.
        seq: u64,
        /// How many it has.
        observations: usize,
        /// How many it may have.
        limit: usize,
    },
    /// The number does not fit the store.
    #[error("epoch number {seq} is above {}", i64::MAX)]
    SequenceTooLarge {
        /// The number.
        seq: u64,
    },
}

impl EpochRefusal {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Conflict { .. } => Code::SequenceConflict,
            Self::Superseded { .. } => Code::SequenceSuperseded,
            Self::OutOfOrder { .. } => Code::OutOfOrder,
            Self::TooManyObservations { .. } => Code::TooManyObservations,
            Self::SequenceTooLarge { .. } => Code::InvalidSequence,
        }
    }

    /// The field of the epoch at fault.
    pub const fn field(&self) -> &'static str {
        match self {
            Self::Conflict { .. } | Self::Superseded { .. } | Self::SequenceTooLarge { .. } => {
                "seq"
            }
            Self::OutOfOrder { .. } => "time",
            Self::TooManyObservations { .. } => "observations",
        }
    }
}

/// An accepted batch whose answer is on its way. Dropping it loses the answer, not the epochs.
#[derive(Debug)]
pub struct Pending(pub(super) oneshot::Receiver<Result<Submitted, SessionError>>);

impl Pending {
    /// Waits until the batch is committed.
    ///
    /// # Errors
    /// The store failed, and nothing of the batch is acknowledged.
    pub async fn answer(self) -> Result<Submitted, SessionError> {
        self.0.await.unwrap_or(Err(SessionError::Interrupted))
    }
}
