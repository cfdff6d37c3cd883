//! Why the desk refuses a call.

use std::time::Duration;

use uuid::Uuid;

use crate::aiding::AidingError;
use crate::config::ConfigError;
use crate::gnss::FrameRefusal;
use crate::quotas::QuotaError;
use crate::reception::ReceptionError;
use crate::refusal::{Class, Code};
use crate::store::StoreError;

/// Base of the delay while the service or its database is away.
const UNAVAILABLE: Duration = Duration::from_secs(1);

/// Why the desk refuses a call. [`super::EpochRefusal`] is the refusal of a single epoch.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SessionError {
    /// No session has this id.
    #[error("there is no session {id:?}")]
    NotFound {
        /// The id as given.
        id: String,
    },
    /// Another request had the same name.
    #[error("a request of this name has created session {id}, and had another content")]
    RequestConflict {
        /// Id of the session.
        id: String,
    },
    /// The session has changed since the caller read it.
    #[error("session {id} has another etag: somebody has changed it")]
    Changed {
        /// Id of the session.
        id: String,
    },
    /// The session is closed and takes no more epochs.
    #[error("session {id} is closed")]
    Closed {
        /// Id of the session.
        id: String,
    },
    /// A mode, profile, option or value does not exist.
    #[error(transparent)]
    Configuration(#[from] ConfigError),
    /// The request clears an override of an option that does not exist.
    #[error(transparent)]
    UnknownCleared(ConfigError),
    /// The mode needs a base, and none is named.
    #[error("mode {mode} needs a base")]
    BaseRequired {
        /// Name of the mode.
        mode: &'static str,
    },
    /// Positions relative to the base cannot be given in the frame that is asked for.
    #[error("positions cannot be given in the ETRS89: {0}")]
    Frame(FrameRefusal),
    /// Heights above the geoid are asked for, and the service has no table.
    #[error("the service has no table of the geoid")]
    GeoidMissing,
    /// The request names more bases than one session may choose from.
    #[error("{bases} bases are named, at most {limit} are allowed")]
    TooManyCandidates {
        /// Number of bases named.
        bases: usize,
        /// Number of bases allowed.
        limit: usize,
    },
    /// The request names a base twice.
    #[error("base {index} of the list is a repetition")]
    BaseNamedTwice {
        /// Index of the repetition, from 0.
        index: usize,
    },
    /// The brokers refuse base or navigation data.
    #[error(transparent)]
    Aiding(#[from] AidingError),
    /// The label is too long.
    #[error("the label has {length} characters, at most {limit} are allowed")]
    LabelTooLong {
        /// Length of the label (characters).
        length: usize,
        /// Length allowed (characters).
        limit: usize,
    },
    /// The retention is longer than allowed.
    #[error("epochs are to be kept for {days} days, at most {limit} are allowed")]
    RetentionTooLong {
        /// The retention as given (days).
        days: u32,
        /// The longest one allowed (days).
        limit: u32,
    },
    /// Epochs are removed, and no state from which the others could be replayed can be read.
    #[error(
        "epochs through {removed_through} were removed by the session's retention, and no later \
         snapshot can be read by this version"
    )]
    ReplayStartMissing {
        /// Number of the last removed epoch.
        removed_through: u64,
    },
    /// The push has no epoch.
    #[error("the push has no epoch")]
    NoEpochs,
    /// The push, or a raw chunk, has more epochs than allowed.
    #[error("the push has {epochs} epochs, at most {limit} are allowed")]
    TooManyEpochs {
        /// Number of epochs.
        epochs: usize,
        /// Number of epochs allowed.
        limit: usize,
    },
    /// The epochs of a burst are not in order of time.
    #[error("epoch {index} of the burst is not after the previous one")]
    BurstOutOfOrder {
        /// Index of the epoch that is not after the previous one, from 0.
        index: usize,
    },
    /// An epoch of a burst is before GPS time begins.
    #[error("epoch {index} of the burst is before GPS time begins, 1980-01-06")]
    BurstBeforeGps {
        /// Index of the epoch, from 0.
        index: usize,
    },
    /// An epoch of a burst has more observations than allowed.
    #[error(
        "epoch {index} of the burst has {observations} observations, at most {limit} are allowed"
    )]
    TooManyObservations {
        /// Index of the epoch, from 0.
        index: usize,
        /// Number of its observations.
        observations: usize,
        /// Number of observations allowed.
        limit: usize,
    },
    /// The session's mailbox is full.
    #[error("{waiting} epochs of this session wait, at most {limit} may")]
    MailboxFull {
        /// Number of waiting epochs.
        waiting: usize,
        /// Number of epochs that may wait.
        limit: usize,
        /// The delay before the next attempt.
        retry_after: Duration,
    },
    /// The mailboxes of all sessions together are full.
    #[error("{waiting} epochs of all sessions wait, at most {limit} may")]
    Overloaded {
        /// Number of waiting epochs.
        waiting: usize,
        /// Number of epochs that may wait.
        limit: usize,
        /// The delay before the next attempt.
        retry_after: Duration,
    },
    /// As many sessions are active as allowed, and all of them have waiting epochs.
    #[error("{limit} sessions are active and have epochs waiting, no more may be")]
    TooManyActive {
        /// Number of sessions that may be active.
        limit: usize,
        /// The delay before the next attempt.
        retry_after: Duration,
    },
    /// The settings of the session have changed too often.
    #[error("the settings of the session may change {limit} times at once, and then more slowly")]
    TooManyUpdates {
        /// Number of changes allowed at once.
        limit: u32,
        /// The delay before the next attempt.
        retry_after: Duration,
    },
    /// The tenant has used a quota.
    #[error(transparent)]
    Quota(#[from] QuotaError),
    /// The session has as many arcs as allowed.
    #[error("the session has been reset {limit} times, no more is allowed")]
    TooManyArcs {
        /// Number of resets allowed.
        limit: usize,
    },
    /// The window of a computation on request is longer than allowed.
    #[error("the window has {epochs} epochs, at most {limit} are computed on request")]
    WindowTooLong {
        /// Number of epochs in the window.
        epochs: usize,
        /// Number of epochs allowed.
        limit: usize,
    },
    /// A computation on request takes longer than allowed.
    #[error("{done} of {epochs} epochs were computed within the {} s allowed", limit.as_secs_f64())]
    TooCostly {
        /// Number of epochs computed in time.
        done: usize,
        /// Number of epochs asked for.
        epochs: usize,
        /// Time allowed on the solver pool.
        limit: Duration,
    },
    /// The session has no epoch to solve yet.
    #[error("session {id} has no epoch yet")]
    Empty {
        /// Id of the session.
        id: String,
    },
    /// The session has no epoch in a span of time.
    #[error("session {id} has no epoch of these times")]
    NoEpochInSpan {
        /// Id of the session.
        id: String,
    },
    /// The session has no epoch of this number.
    #[error("session {id} has no epoch {seq}")]
    NoSuchEpoch {
        /// Id of the session.
        id: String,
        /// The number as given.
        seq: u64,
    },
    /// A time series is asked for with no point, or more than allowed.
    #[error("a series of {points} points is not from 1 to {limit}")]
    TooManyPoints {
        /// Number of points.
        points: usize,
        /// Number of points allowed.
        limit: usize,
    },
    /// A history is asked for over a longer span of time than allowed.
    #[error("a history spans at most {limit_days} days")]
    SpanTooLong {
        /// Longest span (days).
        limit_days: i64,
    },
    /// The service is stopping and takes no more epochs.
    #[error("the service is shutting down")]
    Draining,
    /// The estimator failed. The session continues from its last committed epoch.
    #[error("the estimator failed on these epochs: {message}")]
    EstimatorFailed {
        /// Message of the failure.
        message: String,
    },
    /// A raw chunk is larger than allowed.
    #[error("the chunk has {bytes} bytes, at most {limit} are allowed")]
    ChunkTooLarge {
        /// Size of the chunk (bytes).
        bytes: usize,
        /// Size allowed (bytes).
        limit: usize,
    },
    /// Bytes are missing between the stored stream and the chunk.
    #[error("the chunk begins at byte {offset}, but only {through} bytes are stored")]
    RawGap {
        /// Offset of the chunk's first byte.
        offset: u64,
        /// Number of stored bytes: the offset at which the stream continues.
        through: u64,
    },
    /// Other bytes are stored at the chunk's offset.
    #[error("other bytes are stored at offsets {offset} to {end}")]
    RawConflict {
        /// Offset of the chunk's first byte.
        offset: u64,
        /// Offset after the compared bytes.
        end: u64,
    },
    /// The raw bytes cannot be decoded.
    #[error(transparent)]
    Raw(ReceptionError),
    /// The session's task ended before it answered. Nothing of the push is acknowledged.
    #[error("the session was interrupted before the epochs were committed")]
    Interrupted,
    /// The store failed. Nothing of the push is acknowledged.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl SessionError {
    /// The stable code.
    pub fn code(&self) -> Code {
        match self {
            Self::NotFound { .. } => Code::SessionNotFound,
            Self::RequestConflict { .. } => Code::IdempotencyConflict,
            Self::Changed { .. } => Code::EtagMismatch,
            Self::Closed { .. } => Code::SessionClosed,
            Self::Configuration(error) | Self::UnknownCleared(error) => error.code(),
            Self::BaseRequired { .. } => Code::BaseRequired,
            Self::Frame(_) => Code::FrameUnavailable,
            Self::GeoidMissing => Code::GeoidMissing,
            Self::TooManyCandidates { .. } | Self::BaseNamedTwice { .. } => Code::InvalidField,
            Self::Aiding(error) => error.code(),
            Self::LabelTooLong { .. } => Code::LabelTooLong,
            Self::RetentionTooLong { .. } => Code::InvalidField,
            Self::ReplayStartMissing { .. } => Code::ReplayStartMissing,
            Self::NoEpochs => Code::NoEpochs,
            Self::TooManyEpochs { .. } => Code::TooManyEpochs,
            Self::BurstOutOfOrder { .. } => Code::OutOfOrder,
            Self::BurstBeforeGps { .. } => Code::TimeImplausible,
            Self::TooManyObservations { .. } => Code::TooManyObservations,
            Self::MailboxFull { .. } => Code::MailboxFull,
            Self::Overloaded { .. } => Code::Overloaded,
            Self::TooManyActive { .. } => Code::TooManyActiveSessions,
            Self::TooManyUpdates { .. } => Code::TooManyUpdates,
            Self::TooManyArcs { .. } => Code::TooManyArcs,
            Self::WindowTooLong { .. } | Self::TooCostly { .. } => Code::TooCostly,
            Self::Empty { .. } => Code::SessionEmpty,
            Self::NoEpochInSpan { .. } | Self::NoSuchEpoch { .. } => Code::EpochNotFound,
            Self::TooManyPoints { .. } | Self::SpanTooLong { .. } => Code::InvalidField,
            Self::Draining => Code::Draining,
            Self::EstimatorFailed { .. } => Code::EstimatorFailed,
            Self::ChunkTooLarge { .. } => Code::PieceTooLarge,
            Self::RawGap { .. } => Code::RawGap,
            Self::RawConflict { .. } => Code::RawConflict,
            Self::Raw(error) => error.code(),
            Self::Interrupted => Code::Interrupted,
            Self::Quota(error) => error.code(),
            Self::Store(error) => error.code(),
        }
    }

    /// The delay before the next attempt, for refusals that pass by themselves. It is random up to
    /// twice its base, so that devices that were refused together do not come back together.
    pub fn retry_after(&self) -> Option<Duration> {
        let base = match self {
            Self::MailboxFull { retry_after, .. }
            | Self::Overloaded { retry_after, .. }
            | Self::TooManyActive { retry_after, .. }
            | Self::TooManyUpdates { retry_after, .. } => *retry_after,
            // A quota says when it allows more.
            Self::Quota(error) => error.retry_after(),
            Self::Draining | Self::Interrupted => UNAVAILABLE,
            Self::Store(error) if matches!(error.code().class(), Class::Unavailable) => UNAVAILABLE,
            _ => return None,
        };
        let random = Uuid::new_v4().as_u128() as u32;
        Some(base.mul_f64(1.0 + f64::from(random) / f64::from(u32::MAX)))
    }
}
