//! Why a stored secret cannot be used.

use crate::refusal::Code;

/// Why a stored secret, or the key of secrets, cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SecretsError {
    /// A text or file is not a key.
    #[error("{what}: {why}")]
    Key {
        /// The file.
        what: String,
        /// What is wrong with it.
        why: String,
    },
    /// A secret is encrypted with a key that the service does not have.
    #[error("stored secrets are encrypted with the key {key}, which is not given")]
    KeyUnknown {
        /// Id of the key.
        key: String,
    },
    /// A secret was changed, or was encrypted for another owner.
    #[error("the stored secret of {owner} has been changed")]
    Damaged {
        /// Its owner.
        owner: String,
    },
}

impl SecretsError {
    /// The stable code.
    pub(crate) const fn code(&self) -> Code {
        match self {
            Self::Key { .. } => Code::SecretsKeyInvalid,
            Self::KeyUnknown { .. } => Code::SecretsKeyUnknown,
            Self::Damaged { .. } => Code::StoredDataCorrupt,
        }
    }
}
