//! Why navigation data are refused.

use crate::gnss::SatelliteId;
use crate::store::StoreError;

/// Why navigation data are refused; nothing of the push is then kept.
#[derive(Clone, Debug, thiserror::Error)]
pub enum AidingError {
    /// One push brings more ephemerides of a satellite than are held.
    #[error("{count} ephemerides of {satellite} in one push, held are at most {limit}")]
    TooManyEphemerides {
        /// The satellite.
        satellite: SatelliteId,
        /// How many it brings.
        count: usize,
        /// How many are held of one satellite.
        limit: usize,
    },
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl AidingError {
    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::TooManyEphemerides { .. } => "TOO_MANY_EPHEMERIDES",
            Self::Store(error) => error.code(),
        }
    }

    /// What the user can do about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::TooManyEphemerides { .. } => "push a shorter span of time",
            Self::Store(error) => error.remedy(),
        }
    }
}
