//! Base stations: their positions and epochs, shared by all sessions.
//!
//! # How a base is filled
//! [`BaseBroker::create`] creates a base. Its position is given then, or taken from the header of
//! its first file ([`BaseBroker::upload`]) or from a stream's messages 1005 and 1006
//! ([`BaseBroker::set_site`]). While it is unknown, epochs are refused with
//! [`BasePositionMissing`](crate::aiding::AidingError). [`BaseBroker::push`] takes epochs in order
//! of time. When it returns they are committed, and sessions see them.
//!
//! A feed, such as the client of a caster, calls `set_site` whenever its stream reports a position,
//! and `push` with the epochs decoded since its last call. Each push is one transaction, so epochs
//! that arrive together should be pushed together. After a reconnection a feed may push epochs
//! again: those stored with the same content are acknowledged as resent. Refusals of single epochs
//! are part of the answer; a feed only counts them.
//!
//! An archive's files are uploaded when sessions need them. The broker records the times for which
//! sessions need the base (`BaseBroker::requested_times`), and reports whether the epochs of a
//! file are stored already (`BaseBroker::coverage`).
//!
//! # How sessions use it
//! A session takes a [`BaseView`] for the time of the epochs that it positions. With each solution
//! it stores the numbers of the base epochs that the estimator received, so that replay gives it
//! the same ones. Epochs that are pushed later change no earlier solution.
//!
//! A session that uses the nearest of several bases asks its `Candidates` at each epoch. The
//! choice is stored with the solution, so replay does not choose again.
//!
//! A batch job takes the stored epochs of its recording's time as a file (`PastBase`).
//!
//! # Memory
//! All stored epochs of a base are also in memory, encoded. Limits bound them: beyond these the
//! oldest epochs are deleted, in memory and in the store.

mod archive_requests;
mod base;
mod base_epochs;
mod broker;
mod candidates;
mod check;
mod file;
mod following;
mod nearest_requests;
mod past;
mod pushing;
mod tenant_bases;
mod view;

use crate::gnss::{BaseSite, CoordinateFrame, GpsTime};
use crate::id::{Id, Kind};
use crate::refusal::Code;
use crate::store::BaseName;
use crate::tenant::Tenant;

pub use crate::positioning::{BasePositionCheck, BasePositionVerdict};
pub(crate) use base_epochs::Coverage;
pub use broker::BaseBroker;
pub(crate) use candidates::Candidates;
pub use file::BaseFileError;
pub use file::{BaseFile, BaseFileLimits};
pub(crate) use nearest_requests::NearestBaseRequest;
pub(crate) use past::PastBase;
pub use tenant_bases::TenantBases;
pub use view::{BaseInput, BaseView};

pub use crate::store::{BaseChoice, BaseFeed};

/// The kind of a [`BaseId`].
pub enum BaseKind {}

impl Kind for BaseKind {
    const PREFIX: &str = "bas_";
}

/// The id of a base.
pub type BaseId = Id<BaseKind>;

/// The properties of a new base.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NewBase {
    /// A name for people; may be empty.
    pub label: String,
    /// Position and antenna; `None` if its files or messages will give them.
    pub site: Option<BaseSite>,
    /// The caster's stream that fills it.
    pub feed: Option<BaseFeed>,
    /// The address of the archive's files that fill it, with placeholders for their time.
    pub archive: Option<String>,
    /// The frame of its coordinates, if it is known.
    pub frame: Option<CoordinateFrame>,
}

/// A base with its health.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseInfo {
    /// The id and key of the base.
    pub name: BaseName,
    /// Tenant that owns the base.
    pub tenant: Tenant,
    /// A name for people.
    pub label: String,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// The caster's stream that fills it.
    pub feed: Option<BaseFeed>,
    /// The address of the archive's files that fill it.
    pub archive: Option<String>,
    /// The frame of its coordinates, if it is known.
    pub frame: Option<CoordinateFrame>,
    /// Position and antenna at the newest epoch; `None` while unknown.
    pub site: Option<BaseSite>,
    /// Number of stored epochs.
    pub epochs: usize,
    /// Times of the oldest and the newest stored epoch.
    pub span: Option<(GpsTime, GpsTime)>,
    /// When the newest epoch was stored (ms since 1970-01-01 UTC).
    pub stored_unix_ms: Option<i64>,
    /// Number of satellites in the newest epoch.
    pub satellites: usize,
    /// The stated position compared with the base's own single-point positions.
    pub check: BasePositionCheck,
}

/// The answer to a push.
#[derive(Clone, Debug, PartialEq)]
pub struct BasePush {
    /// The outcome of each epoch, in the order of the push.
    pub outcomes: Vec<Result<CommittedEpoch, BaseEpochRefusal>>,
    /// The stated position compared with the base's own single-point positions.
    pub check: BasePositionCheck,
}

/// A committed epoch of a base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommittedEpoch {
    /// Its number: epochs of a base are numbered in order of time.
    pub number: u64,
    /// The epoch was already stored with the same content.
    pub resent: bool,
}

/// Why an epoch of a base is refused. Other epochs of the push are not affected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BaseEpochRefusal {
    /// An epoch of the same time is stored with other content.
    #[error("the base has an epoch of {time} with other content")]
    Conflict {
        /// Time of the epoch.
        time: GpsTime,
    },
    /// The epoch is older than the newest one, and not stored.
    #[error("epoch {time} is not after the base's newest epoch at {last}")]
    OutOfOrder {
        /// Time of the epoch.
        time: GpsTime,
        /// Time of the newest epoch.
        last: GpsTime,
    },
    /// The epoch has more observations than allowed.
    #[error("epoch {time} has {observations} observations, at most {limit} are allowed")]
    TooManyObservations {
        /// Time of the epoch.
        time: GpsTime,
        /// Number of its observations.
        observations: usize,
        /// Number of observations allowed.
        limit: usize,
    },
}

impl BaseEpochRefusal {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Conflict { .. } => Code::BaseEpochConflict,
            Self::OutOfOrder { .. } => Code::BaseOutOfOrder,
            Self::TooManyObservations { .. } => Code::TooManyObservations,
        }
    }
}
