//! Why navigation data, bases or their epochs are refused.

use crate::gnss::SatelliteId;
use crate::refusal::Code;
use crate::store::StoreError;

/// Why navigation data, bases or their epochs are refused. Nothing of the push is then kept.
#[derive(Clone, Debug, thiserror::Error)]
pub enum AidingError {
    /// One push has more ephemerides of one satellite than are kept.
    #[error("one push has {count} ephemerides of {satellite}, at most {limit} are kept")]
    TooManyEphemerides {
        /// The satellite.
        satellite: SatelliteId,
        /// Its ephemerides in the push.
        count: usize,
        /// Number of ephemerides that are kept of one satellite.
        limit: usize,
    },
    /// No base has this id.
    #[error("there is no base {id:?}")]
    BaseNotFound {
        /// The id as given.
        id: String,
    },
    /// There are as many bases as allowed.
    #[error("there are {limit} bases already, as many as allowed")]
    TooManyBases {
        /// Number of bases allowed.
        limit: usize,
    },
    /// The label is too long.
    #[error("the label has {length} characters, at most {limit} are allowed")]
    LabelTooLong {
        /// Length of the label (characters).
        length: usize,
        /// Length allowed (characters).
        limit: usize,
    },
    /// An open session uses the base.
    #[error("an open session uses base {id}")]
    BaseInUse {
        /// Id of the base.
        id: String,
    },
    /// Another request had the same name.
    #[error("a request of this name has created base {id}, and had another content")]
    RequestConflict {
        /// Id of the base.
        id: String,
    },
    /// The base is the operator's, and another tenant wants to change it.
    #[error("base {id} is the operator's")]
    BaseOfOperator {
        /// Id of the base.
        id: String,
    },
    /// The position of the base is unknown.
    #[error("the position of base {id} is unknown")]
    BasePositionMissing {
        /// Id of the base.
        id: String,
    },
    /// The stated position of the base contradicts its observations.
    #[error(
        "the base's position is {distance_m:.0} m from its own single-point position (mean of \
         {epochs} epochs)"
    )]
    BasePositionRefused {
        /// Distance from the stated position to the mean single-point position (m).
        distance_m: f64,
        /// Number of epochs in the mean.
        epochs: u32,
    },
    /// There is no calibration of a named antenna.
    #[error("antenna {name:?} is not calibrated")]
    AntennaUnknown {
        /// Type and radome, as named.
        name: String,
    },
    /// One push has more than a base may store.
    #[error(
        "one push has {epochs} epochs of {bytes} bytes; a base takes at most \
         {epochs_max} epochs and {bytes_max} bytes"
    )]
    BaseTooLarge {
        /// Number of epochs in the push.
        epochs: usize,
        /// Number of epochs allowed in one base.
        epochs_max: usize,
        /// Size of the encoded epochs (bytes).
        bytes: usize,
        /// Size allowed for one base (bytes).
        bytes_max: usize,
    },
    /// At each attempt another node has pushed first.
    #[error("other nodes push navigation data all the time; this push found no turn")]
    Contended,
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl AidingError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::TooManyEphemerides { .. } => Code::TooManyEphemerides,
            Self::BaseNotFound { .. } => Code::BaseNotFound,
            Self::TooManyBases { .. } => Code::TooManyBases,
            Self::LabelTooLong { .. } => Code::LabelTooLong,
            Self::BaseInUse { .. } => Code::BaseInUse,
            Self::RequestConflict { .. } => Code::IdempotencyConflict,
            Self::BaseOfOperator { .. } => Code::BaseOfOperator,
            Self::BasePositionMissing { .. } => Code::BasePositionMissing,
            Self::BasePositionRefused { .. } => Code::BasePositionRefused,
            Self::AntennaUnknown { .. } => Code::AntennaUnknown,
            Self::BaseTooLarge { .. } => Code::BaseTooLarge,
            Self::Contended => Code::DatabaseFailed,
            Self::Store(error) => error.code(),
        }
    }
}
