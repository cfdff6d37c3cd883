//! Why a key is refused.

use std::time::Duration;

use crate::refusal::Code;
use crate::store::StoreError;

/// Why a key, or a change of one, is refused.
#[derive(Clone, Debug, thiserror::Error)]
pub enum KeyError {
    /// The call needs a key.
    #[error("this service has keys, and the request brings none")]
    Required,
    /// The text is not a key of this service.
    #[error("the key of the request is not one of this service")]
    Invalid,
    /// The key has expired.
    #[error("the key {id} has expired")]
    Expired {
        /// Id of the key.
        id: String,
    },
    /// The key is revoked.
    #[error("the key {id} is revoked")]
    Revoked {
        /// Id of the key.
        id: String,
    },
    /// The cookie does not belong to a sign-in, or its sign-in has ended.
    #[error("the sign-in of this browser has ended")]
    SignInEnded,
    /// A change by a cookie does not have the token of its sign-in.
    #[error("the change does not bring the token of the sign-in")]
    CsrfTokenInvalid,
    /// Too many requests from one address had a wrong key.
    #[error("too many requests from this address had a wrong key")]
    TooManyAttempts {
        /// The delay before the next attempt.
        retry_after: Duration,
    },
    /// No key has this id.
    #[error("there is no key {id:?}")]
    NotFound {
        /// The id as given.
        id: String,
    },
    /// The database has as many keys as allowed.
    #[error("there are {limit} keys, as many as allowed")]
    TooMany {
        /// The limit.
        limit: i64,
    },
    /// A tenant has created as many keys within a day as allowed.
    #[error("tenant {tenant} has created {limit} keys within a day, as many as allowed")]
    TooManyCreated {
        /// The tenant.
        tenant: String,
        /// The limit.
        limit: i64,
    },
    /// A name is not the name of a right.
    #[error("{name:?} is not a right; the rights are device, read, operate, admin")]
    UnknownRight {
        /// Position of the name, from 0.
        index: usize,
        /// The name as given.
        name: String,
    },
    /// No right is named.
    #[error("a key needs a right: device, read, operate, admin")]
    NoRights,
    /// The name for people is too long.
    #[error("a label of {characters} characters, at most {limit} are taken")]
    LabelTooLong {
        /// Its length.
        characters: usize,
        /// The limit.
        limit: usize,
    },
    /// The name for people is not one line of text.
    #[error("character {at} of the label is a control character")]
    LabelControl {
        /// Its place, from 1.
        at: usize,
    },
    /// The key has ended and cannot be rotated.
    #[error("the key {id} has expired or is revoked")]
    Ended {
        /// Id of the key.
        id: String,
    },
    /// The system has no random bits.
    #[error("the system gives no random bits: {0}")]
    NoRandomness(String),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl KeyError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Required => Code::KeyRequired,
            Self::Invalid => Code::KeyInvalid,
            Self::Expired { .. } => Code::KeyExpired,
            Self::Revoked { .. } => Code::KeyRevoked,
            Self::SignInEnded => Code::SignInEnded,
            Self::CsrfTokenInvalid => Code::CsrfTokenInvalid,
            Self::TooManyAttempts { .. } => Code::TooManyAttempts,
            Self::NotFound { .. } => Code::KeyNotFound,
            Self::TooMany { .. } | Self::TooManyCreated { .. } => Code::TooManyKeys,
            Self::UnknownRight { .. } | Self::NoRights | Self::LabelControl { .. } => {
                Code::InvalidField
            }
            Self::LabelTooLong { .. } => Code::LabelTooLong,
            Self::Ended { .. } => Code::KeyEnded,
            Self::NoRandomness(_) => Code::Internal,
            Self::Store(error) => error.code(),
        }
    }
}
