//! Why navigation data, bases or their epochs are refused.

use crate::gnss::SatelliteId;
use crate::store::StoreError;

/// Why navigation data, bases or their epochs are refused; nothing of the push is then kept.
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
    /// No such base.
    #[error("there is no base {id:?}")]
    BaseNotFound {
        /// What was asked for.
        id: String,
    },
    /// As many bases as there may be.
    #[error("there are {limit} bases, which are all that may be")]
    TooManyBases {
        /// How many there may be.
        limit: usize,
    },
    /// The label is too long.
    #[error("the label has {length} characters, allowed are {limit}")]
    LabelTooLong {
        /// Its length.
        length: usize,
        /// The length allowed.
        limit: usize,
    },
    /// An open session names the base.
    #[error("open sessions name base {id}")]
    BaseInUse {
        /// Its id.
        id: String,
    },
    /// Nobody has told where the base stands.
    #[error("the position of base {id} is not known")]
    BasePositionMissing {
        /// Its id.
        id: String,
    },
    /// The base's position contradicts what it observes.
    #[error(
        "the base's position is {distance_m:.0} m from its own single-point position (mean of \
         {epochs} epochs)"
    )]
    BasePositionRefused {
        /// From the position stated to the one observed (m).
        distance_m: f64,
        /// Epochs that it was observed in.
        epochs: u32,
    },
    /// One push brings more than a base holds.
    #[error(
        "{epochs} epochs of {bytes} bytes in one push; a base holds {epochs_max} epochs and \
         {bytes_max} bytes"
    )]
    BaseTooLarge {
        /// Epochs it brings.
        epochs: usize,
        /// Epochs held of one base.
        epochs_max: usize,
        /// Bytes they take.
        bytes: usize,
        /// Bytes held of one base.
        bytes_max: usize,
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
            Self::BaseNotFound { .. } => "BASE_NOT_FOUND",
            Self::TooManyBases { .. } => "TOO_MANY_BASES",
            Self::LabelTooLong { .. } => "LABEL_TOO_LONG",
            Self::BaseInUse { .. } => "BASE_IN_USE",
            Self::BasePositionMissing { .. } => "BASE_POSITION_MISSING",
            Self::BasePositionRefused { .. } => "BASE_POSITION_REFUSED",
            Self::BaseTooLarge { .. } => "BASE_TOO_LARGE",
            Self::Store(error) => error.code(),
        }
    }

    /// What the user can do about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::TooManyEphemerides { .. } => "push a shorter span of time",
            Self::BaseNotFound { .. } => "create the base first, or check its id",
            Self::TooManyBases { .. } => "delete a base that is no longer used",
            Self::LabelTooLong { .. } => "shorten the label",
            Self::BaseInUse { .. } => "close these sessions, or let them use another base",
            Self::BasePositionMissing { .. } => "create the base with the position of its marker",
            Self::BasePositionRefused { .. } => "create the base anew with its right position",
            Self::BaseTooLarge { .. } => "push a shorter span of time",
            Self::Store(error) => error.remedy(),
        }
    }
}
