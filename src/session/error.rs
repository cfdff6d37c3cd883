//! Why the desk refuses a call.

use std::time::Duration;

use crate::aiding::AidingError;
use crate::config::ConfigError;
use crate::reception::ReceptionError;
use crate::refusal::Code;
use crate::store::StoreError;

/// Why the desk refuses a call. Refusals of single epochs are [`super::EpochRefusal`].
#[derive(Clone, Debug, thiserror::Error)]
pub enum SessionError {
    /// No such session.
    #[error("there is no session {id:?}")]
    NotFound {
        /// What was asked for.
        id: String,
    },
    /// The session takes no more epochs.
    #[error("session {id} is closed")]
    Closed {
        /// Its id.
        id: String,
    },
    /// The configuration asked for does not exist.
    #[error(transparent)]
    Configuration(#[from] ConfigError),
    /// The mode needs a base, and none is named.
    #[error("mode {mode} needs a base")]
    BaseRequired {
        /// The mode.
        mode: &'static str,
    },
    /// More bases are named than one session chooses from.
    #[error("{bases} bases are named, allowed are {limit}")]
    TooManyCandidates {
        /// How many are named.
        bases: usize,
        /// How many may be.
        limit: usize,
    },
    /// A list of bases names one twice.
    #[error("base {index} of the list is named before")]
    BaseNamedTwice {
        /// Its place, from 0.
        index: usize,
    },
    /// Base or navigation data are refused.
    #[error(transparent)]
    Aiding(#[from] AidingError),
    /// The label is too long.
    #[error("the label has {length} characters, allowed are {limit}")]
    LabelTooLong {
        /// Its length.
        length: usize,
        /// The length allowed.
        limit: usize,
    },
    /// A batch without epochs.
    #[error("the batch holds no epoch")]
    NoEpochs,
    /// More epochs at once than allowed.
    #[error("the batch holds {epochs} epochs, allowed are {limit}")]
    TooManyEpochs {
        /// How many it holds.
        epochs: usize,
        /// How many it may hold.
        limit: usize,
    },
    /// Epochs of a burst are not in order of time.
    #[error("epoch {index} of the burst is not after the one before it")]
    BurstOutOfOrder {
        /// Its place, from 0.
        index: usize,
    },
    /// An epoch of a burst has more observations than allowed.
    #[error("epoch {index} of the burst has {observations} observations, allowed are {limit}")]
    TooManyObservations {
        /// Its place, from 0.
        index: usize,
        /// How many it has.
        observations: usize,
        /// How many it may have.
        limit: usize,
    },
    /// The session has as many epochs waiting as it may.
    #[error("{waiting} epochs of this session wait, allowed are {limit}")]
    MailboxFull {
        /// Epochs waiting.
        waiting: usize,
        /// Epochs that may wait.
        limit: usize,
        /// When to try again.
        retry_after: Duration,
    },
    /// All sessions together have as many epochs waiting as the service holds.
    #[error("{waiting} epochs of all sessions wait, allowed are {limit}")]
    Overloaded {
        /// Epochs waiting.
        waiting: usize,
        /// Epochs that may wait.
        limit: usize,
        /// When to try again.
        retry_after: Duration,
    },
    /// Every session that may be active has epochs waiting.
    #[error("{limit} sessions are active, which are all that may be")]
    TooManyActive {
        /// Sessions that may be active.
        limit: usize,
        /// When to try again.
        retry_after: Duration,
    },
    /// The session has no epoch to solve yet.
    #[error("session {id} has no epoch yet")]
    Empty {
        /// Its id.
        id: String,
    },
    /// The service is shutting down and takes no more epochs.
    #[error("the service is shutting down")]
    Draining,
    /// The estimator failed; the session continues from its last committed epoch.
    #[error("the estimator failed on this batch: {message}")]
    EstimatorFailed {
        /// What it said.
        message: String,
    },
    /// A piece of raw bytes is larger than allowed.
    #[error("a piece of {bytes} bytes, allowed are {limit}")]
    PieceTooLarge {
        /// Its length.
        bytes: usize,
        /// The length allowed.
        limit: usize,
    },
    /// Bytes are missing before a piece.
    #[error("the piece begins at byte {offset}, stored are {through} bytes")]
    RawGap {
        /// Where it begins.
        offset: u64,
        /// Where the stream goes on.
        through: u64,
    },
    /// Other bytes are stored at the place of a piece.
    #[error("other bytes are stored at the place of bytes {offset} to {end}")]
    RawConflict {
        /// Where the piece begins.
        offset: u64,
        /// Where it ends.
        end: u64,
    },
    /// Raw bytes that cannot be decoded.
    #[error(transparent)]
    Raw(ReceptionError),
    /// The session's task ended before it answered; nothing of the batch is acknowledged.
    #[error("the session was interrupted before the batch was committed")]
    Interrupted,
    /// The store failed; nothing of the batch is acknowledged.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl SessionError {
    /// The stable code.
    pub fn code(&self) -> Code {
        match self {
            Self::NotFound { .. } => Code::SessionNotFound,
            Self::Closed { .. } => Code::SessionClosed,
            Self::Configuration(error) => error.code(),
            Self::BaseRequired { .. } => Code::BaseRequired,
            Self::TooManyCandidates { .. } | Self::BaseNamedTwice { .. } => Code::InvalidField,
            Self::Aiding(error) => error.code(),
            Self::LabelTooLong { .. } => Code::LabelTooLong,
            Self::NoEpochs => Code::NoEpochs,
            Self::TooManyEpochs { .. } => Code::TooManyEpochs,
            Self::BurstOutOfOrder { .. } => Code::OutOfOrder,
            Self::TooManyObservations { .. } => Code::TooManyObservations,
            Self::MailboxFull { .. } => Code::MailboxFull,
            Self::Overloaded { .. } => Code::Overloaded,
            Self::TooManyActive { .. } => Code::TooManyActiveSessions,
            Self::Empty { .. } => Code::SessionEmpty,
            Self::Draining => Code::Draining,
            Self::EstimatorFailed { .. } => Code::EstimatorFailed,
            Self::PieceTooLarge { .. } => Code::PieceTooLarge,
            Self::RawGap { .. } => Code::RawGap,
            Self::RawConflict { .. } => Code::RawConflict,
            Self::Raw(error) => error.code(),
            Self::Interrupted => Code::Interrupted,
            Self::Store(error) => error.code(),
        }
    }

    /// When to try again, for refusals that time cures.
    pub const fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::MailboxFull { retry_after, .. }
            | Self::Overloaded { retry_after, .. }
            | Self::TooManyActive { retry_after, .. } => Some(*retry_after),
            _ => None,
        }
    }
}
