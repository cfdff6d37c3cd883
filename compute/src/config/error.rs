//! Why a configuration is refused.

use crate::refusal::Code;

/// Why a configuration is refused, with what would be accepted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// No option has this name.
    #[error("no option is called {key:?}; the nearest is {nearest:?}")]
    UnknownKey {
        /// The option name as given.
        key: String,
        /// The option whose name is the fewest edits away.
        nearest: &'static str,
    },
    /// The option does not take this value.
    #[error("option {key:?} cannot be {value:?}; allowed: {allowed}")]
    InvalidValue {
        /// Name of the option that was to be set.
        key: &'static str,
        /// The value as given.
        value: String,
        /// The values that the option accepts.
        allowed: &'static str,
    },
    /// The option takes this value only where a Cargo feature is built in.
    #[error("option {key:?} can be {value:?} only in a build with the feature {feature:?}")]
    FeatureNotBuilt {
        /// Name of the option that was to be set.
        key: &'static str,
        /// The value as given.
        value: String,
        /// The feature's name, as `cargo build --features` takes it.
        feature: &'static str,
    },
    /// No mode has this name.
    #[error("mode {name:?} is not available; allowed: {allowed}")]
    UnknownMode {
        /// The mode name as given.
        name: String,
        /// The names of all modes, separated by commas.
        allowed: String,
    },
    /// No profile has this name.
    #[error("profile {name:?} is not available; allowed: {allowed}")]
    UnknownProfile {
        /// The profile name as given.
        name: String,
        /// The names of all profiles, separated by commas.
        allowed: String,
    },
}

impl ConfigError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::UnknownKey { .. } => Code::UnknownOption,
            Self::InvalidValue { .. } => Code::InvalidOptionValue,
            Self::FeatureNotBuilt { .. } => Code::FeatureNotBuilt,
            Self::UnknownMode { .. } => Code::UnknownMode,
            Self::UnknownProfile { .. } => Code::UnknownProfile,
        }
    }
}
