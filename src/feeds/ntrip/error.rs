//! Why a caster does not send a stream.

use std::time::Duration;

use crate::feeds::FetchError;
use crate::refusal::Code;

/// Why a caster does not send a stream, or why the stream ended.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NtripError {
    /// The caster is not contacted, or cannot be reached.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// The caster asks for a user and password, or refuses those given.
    #[error("the caster refuses the name and password: {answer}")]
    Unauthorised {
        /// Status line of the answer.
        answer: String,
    },
    /// The caster does not have this mountpoint.
    #[error("the caster has no such mountpoint: {answer}")]
    NoSuchMountpoint {
        /// Status line of the answer.
        answer: String,
    },
    /// The caster cannot serve now.
    #[error("the caster cannot serve now: {answer}")]
    TryLater {
        /// Status line of the answer.
        answer: String,
        /// The delay that the caster asks for.
        retry_after: Option<Duration>,
    },
    /// The caster redirects to another address. Redirections are not followed.
    #[error("the caster redirects, which is not followed: {answer}")]
    Redirected {
        /// Status line of the answer.
        answer: String,
    },
    /// The answer does not follow the NTRIP protocol.
    #[error("the answer does not follow NTRIP: {why}")]
    Protocol {
        /// What is wrong with it.
        why: String,
    },
    /// The caster sent nothing for too long.
    #[error("the caster was silent for {seconds} s")]
    Silent {
        /// How long the service waited (s).
        seconds: u64,
    },
    /// The stream has bytes, but no epochs.
    #[error("no epoch of observations in {seconds} s of the stream")]
    NoEpochs {
        /// How long the service waited (s).
        seconds: u64,
    },
    /// The caster ended the stream.
    #[error("the caster ended the stream: {why}")]
    Closed {
        /// How it ended.
        why: String,
    },
}

impl NtripError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Fetch(error) => error.code(),
            Self::Unauthorised { .. } => Code::CasterUnauthorised,
            Self::NoSuchMountpoint { .. } => Code::NoSuchMountpoint,
            Self::TryLater { .. } => Code::CasterTryLater,
            Self::Redirected { .. } => Code::CasterRedirects,
            Self::Protocol { .. } => Code::CasterProtocol,
            Self::Silent { .. } => Code::CasterSilent,
            Self::NoEpochs { .. } => Code::CasterNoEpochs,
            Self::Closed { .. } => Code::CasterClosed,
        }
    }

    /// Whether somebody must change something before the stream can succeed. The delays are then
    /// longer.
    pub(crate) const fn is_lasting(&self) -> bool {
        match self {
            Self::Fetch(error) => {
                !matches!(error, FetchError::Unresolved { .. } | FetchError::Unreachable { .. })
            }
            Self::Unauthorised { .. }
            | Self::NoSuchMountpoint { .. }
            | Self::Redirected { .. }
            | Self::Protocol { .. } => true,
            Self::TryLater { .. }
            | Self::Silent { .. }
            | Self::NoEpochs { .. }
            | Self::Closed { .. } => false,
        }
    }

    /// The delay that the caster asks for, if any.
    pub(crate) const fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::TryLater { retry_after, .. } => *retry_after,
            _ => None,
        }
    }
}
