//! Why a caster gives no stream.

use std::time::Duration;

use crate::feeds::FetchError;

/// Why a caster gives no stream, or none any more.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NtripError {
    /// It is not asked, or does not answer.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// It asks for a name and password, or refuses those given.
    #[error("the caster refuses the name and password: {answer}")]
    Unauthorised {
        /// Its answer.
        answer: String,
    },
    /// It has no such stream.
    #[error("the caster has no such mountpoint: {answer}")]
    NoSuchMountpoint {
        /// Its answer.
        answer: String,
    },
    /// It cannot serve now.
    #[error("the caster cannot serve now: {answer}")]
    TryLater {
        /// Its answer.
        answer: String,
        /// When it asks to come back.
        retry_after: Option<Duration>,
    },
    /// It sends elsewhere, where nobody follows.
    #[error("the caster sends elsewhere, which is not followed: {answer}")]
    Redirected {
        /// Its answer.
        answer: String,
    },
    /// It says what no caster says.
    #[error("the answer is not a caster's: {why}")]
    Protocol {
        /// What is wrong.
        why: String,
    },
    /// It says nothing.
    #[error("the caster was silent for {seconds} s")]
    Silent {
        /// For how long it was waited.
        seconds: u64,
    },
    /// It sends bytes, and no epoch in them.
    #[error("no epoch of observations in {seconds} s of the stream")]
    NoEpochs {
        /// For how long it was listened to.
        seconds: u64,
    },
    /// It ended the stream.
    #[error("the caster ended the stream: {why}")]
    Closed {
        /// How.
        why: String,
    },
}

impl NtripError {
    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Fetch(error) => error.code(),
            Self::Unauthorised { .. } => "CASTER_UNAUTHORISED",
            Self::NoSuchMountpoint { .. } => "NO_SUCH_MOUNTPOINT",
            Self::TryLater { .. } => "CASTER_TRY_LATER",
            Self::Redirected { .. } => "CASTER_REDIRECTS",
            Self::Protocol { .. } => "CASTER_PROTOCOL",
            Self::Silent { .. } => "CASTER_SILENT",
            Self::NoEpochs { .. } => "CASTER_NO_EPOCHS",
            Self::Closed { .. } => "CASTER_CLOSED",
        }
    }

    /// What can be done about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::Fetch(error) => error.remedy(),
            Self::Unauthorised { .. } => "create the base anew with the name and password in force",
            Self::NoSuchMountpoint { .. } => "choose a mountpoint of the caster's sourcetable",
            Self::Redirected { .. } => "name the caster that the answer names, if it is trusted",
            Self::Protocol { .. } => "check that the address is a caster's",
            Self::NoEpochs { .. } => "choose a mountpoint of RTCM 3 observations (MSM4 to MSM7)",
            Self::TryLater { .. } | Self::Silent { .. } | Self::Closed { .. } => {
                "nothing: it is tried again"
            }
        }
    }

    /// Whether somebody must change something before it can succeed: it is then tried seldom.
    pub const fn is_lasting(&self) -> bool {
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

    /// When the caster asks to come back, if it does.
    pub const fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::TryLater { retry_after, .. } => *retry_after,
            _ => None,
        }
    }
}
