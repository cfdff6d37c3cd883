//! Why a configuration is refused.

/// Why a configuration is refused, with what would be accepted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// No option has this name.
    #[error("no option is called {key:?}; the nearest is {nearest:?}")]
    UnknownKey {
        /// What was asked for.
        key: String,
        /// The option whose name differs least.
        nearest: &'static str,
    },
    /// The option does not take this value.
    #[error("option {key:?} cannot be {value:?}; allowed: {allowed}")]
    InvalidValue {
        /// The option.
        key: &'static str,
        /// What was asked for.
        value: String,
        /// What it takes.
        allowed: &'static str,
    },
    /// The option takes this value only where a Cargo feature is built in.
    #[error("option {key:?} can be {value:?} only in a build with the feature {feature:?}")]
    FeatureNotBuilt {
        /// The option.
        key: &'static str,
        /// What was asked for.
        value: String,
        /// The feature, as `cargo build --features` takes it.
        feature: &'static str,
    },
    /// No mode has this name.
    #[error("mode {name:?} is not available; allowed: {allowed}")]
    UnknownMode {
        /// What was asked for.
        name: String,
        /// The modes there are.
        allowed: String,
    },
    /// No profile has this name.
    #[error("profile {name:?} is not available; allowed: {allowed}")]
    UnknownProfile {
        /// What was asked for.
        name: String,
        /// The profiles there are.
        allowed: String,
    },
}

impl ConfigError {
    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::UnknownKey { .. } => "UNKNOWN_OPTION",
            Self::InvalidValue { .. } => "INVALID_OPTION_VALUE",
            Self::FeatureNotBuilt { .. } => "FEATURE_NOT_BUILT",
            Self::UnknownMode { .. } => "UNKNOWN_MODE",
            Self::UnknownProfile { .. } => "UNKNOWN_PROFILE",
        }
    }
}
