//! Base stations: where they stand and what they observe, for every session.
//!
//! # How a base is filled
//! [`BaseBroker::create`] names a base. Its place is given then, or brought by the header of the
//! first file ([`BaseBroker::upload`]), or by a feed's messages 1005 and 1006
//! ([`BaseBroker::place`]); until it is known, epochs are refused with
//! [`BasePositionMissing`](crate::aiding::AidingError). [`BaseBroker::push`] takes epochs, one or
//! many, in order of time; what it acknowledges is committed, and sessions that ask from then on
//! see it.
//!
//! A feed, such as a client of a caster, so calls `place` whenever its stream tells a position
//! (the same one again changes nothing) and `push` with what its decoder gave since the last call;
//! each push is one transaction, so a burst belongs into one. It may push what it pushed before
//! (after it has connected anew): epochs held just so are acknowledged as resent. Refusals of
//! single epochs are in the answer and need no reaction beyond counting them.
//!
//! An archive's files are pushed as uploads are, each when sessions need it: the times of the views
//! that they take are noted ([`BaseBroker::needed`]), and how much of a file's time is held says
//! whether it is to be fetched ([`BaseBroker::reach`]).
//!
//! # How sessions use it
//! A session takes a [`BaseView`] of its base for the span of the epochs that it positions and
//! stores with each which base epochs its estimator was given, by their numbers: replay gives it
//! just these. What is pushed later changes nothing that was solved before.
//!
//! A session that takes the nearest of several bases asks its [`Candidates`] for each epoch. What
//! they choose is stored as what was given is, so that replay has not to choose again.
//!
//! # Memory
//! All that is stored of a base is held, encoded; limits bound it. What comes beyond them pushes
//! out the oldest epochs, in the store too.

mod broker;
mod candidates;
mod check;
mod demand;
mod file;
mod held;
mod seekers;
mod view;

use std::fmt;
use std::sync::Arc;

use uuid::Uuid;

use crate::gnss::{BaseSite, GpsTime};
use crate::store::BaseName;

pub use broker::BaseBroker;
pub use candidates::Candidates;
pub use check::PositionCheck;
pub use file::{BaseFile, BaseFileError};
pub use held::Reach;
pub use seekers::{Seeker, Seekers};
pub use view::{BaseGiven, BaseView};

pub use crate::store::{BaseChoice, BaseFeed};

/// The name of a base: `bas_` and 122 random bits.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BaseId(Arc<str>);

impl BaseId {
    const PREFIX: &str = "bas_";

    fn random() -> Self {
        Self(format!("{}{}", Self::PREFIX, Uuid::new_v4().simple()).into())
    }

    /// The id of a text, if it has an id's form.
    pub fn parse(text: &str) -> Option<Self> {
        let digits = text.strip_prefix(Self::PREFIX)?;
        let lower_hex = |b: u8| matches!(b, b'0'..=b'9' | b'a'..=b'f');
        (digits.len() == 32 && digits.bytes().all(lower_hex)).then(|| Self(text.into()))
    }

    /// The id as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for BaseId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for BaseId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A base to be created.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NewBase {
    /// A name for people; may be empty.
    pub label: String,
    /// Where it stands; `None` where its files or messages will tell.
    pub site: Option<BaseSite>,
    /// The stream of a caster that fills it.
    pub feed: Option<BaseFeed>,
    /// The address of the archive whose files fill it, with placeholders for their times.
    pub archive: Option<String>,
}

/// A base with its health.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseInfo {
    /// The base.
    pub name: BaseName,
    /// A name for people.
    pub label: String,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// The stream of a caster that fills it.
    pub feed: Option<BaseFeed>,
    /// The address of the archive whose files fill it.
    pub archive: Option<String>,
    /// Where it stands, as far as known.
    pub site: Option<BaseSite>,
    /// Epochs held.
    pub epochs: usize,
    /// Time of the oldest and of the newest epoch held.
    pub span: Option<(GpsTime, GpsTime)>,
    /// When the newest was stored (ms since 1970-01-01 UTC).
    pub stored_unix_ms: Option<i64>,
    /// Satellites of the newest epoch.
    pub satellites: usize,
    /// Whether it stands where it is said to.
    pub check: PositionCheck,
}

/// What became of a push.
#[derive(Clone, Debug, PartialEq)]
pub struct BasePush {
    /// One for each epoch, in their order.
    pub outcomes: Vec<Result<HeldEpoch, BaseEpochRefusal>>,
    /// Whether the base stands where it is said to.
    pub check: PositionCheck,
}

/// An epoch of a base that is committed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldEpoch {
    /// Its number.
    pub number: u64,
    /// It was held just so before.
    pub resent: bool,
}

/// Why an epoch of a base is not taken. It stops no other.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BaseEpochRefusal {
    /// Other content is held of this time.
    #[error("the base's epoch of {time} is held with other content")]
    Conflict {
        /// Its time.
        time: GpsTime,
    },
    /// It is not after the newest, and not held.
    #[error("epoch {time} is not after the base's newest epoch at {last}")]
    OutOfOrder {
        /// Its time.
        time: GpsTime,
        /// Time of the newest.
        last: GpsTime,
    },
    /// More observations than one epoch may carry.
    #[error("epoch {time} has {observations} observations, allowed are {limit}")]
    TooManyObservations {
        /// Its time.
        time: GpsTime,
        /// How many it has.
        observations: usize,
        /// How many it may have.
        limit: usize,
    },
}

impl BaseEpochRefusal {
    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Conflict { .. } => "BASE_EPOCH_CONFLICT",
            Self::OutOfOrder { .. } => "BASE_OUT_OF_ORDER",
            Self::TooManyObservations { .. } => "TOO_MANY_OBSERVATIONS",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_parsed_by_their_form() {
        let id = BaseId::random();
        assert_eq!(BaseId::parse(id.as_str()), Some(id.clone()));
        assert_ne!(BaseId::random(), id);
        for wrong in ["", "bas_", "bas_12", &id.as_str()[4..], &id.as_str().to_uppercase()] {
            assert_eq!(BaseId::parse(wrong), None, "{wrong}");
        }
    }
}
