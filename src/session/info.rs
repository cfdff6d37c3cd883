//! What a session is to its users: its id, its configuration, how far it is stored.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::config::OptionEntry;
use crate::id::{Id, Kind};

/// The kind of [`SessionId`].
pub enum SessionKind {}

impl Kind for SessionKind {
    const PREFIX: &str = "ses_";
}

/// The id of a session.
pub type SessionId = Id<SessionKind>;

/// A session to be created.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewSession {
    /// A name for people; may be empty.
    pub label: String,
    /// Estimator, as users write it.
    pub mode: String,
    /// Profile, as users write it.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// Which base modes relative to one are given.
    pub base: BaseChoice<BaseId>,
}

/// What to change of a session; what is `None` or empty stays.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionUpdate {
    /// A new name for people.
    pub label: Option<String>,
    /// Another estimator.
    pub mode: Option<String>,
    /// Another profile.
    pub profile: Option<String>,
    /// Overrides that replace or join those in force.
    pub overrides: BTreeMap<String, String>,
    /// Overrides to drop, so that the profile's value holds again.
    pub clear_overrides: Vec<String>,
    /// Another base, or none.
    pub base: Option<BaseChoice<BaseId>>,
}

/// A session as it is stored.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionInfo {
    /// Its id.
    pub id: SessionId,
    /// A name for people; may be empty.
    pub label: String,
    /// Estimator.
    pub mode: String,
    /// Profile.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// Every option with its value in force.
    pub configuration: Vec<OptionEntry>,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When it was closed (ms since 1970-01-01 UTC); it takes epochs as long as this is `None`.
    pub closed_unix_ms: Option<i64>,
    /// The last committed epoch: all acknowledged ones up to it are durable.
    pub durable_through: Option<u64>,
    /// Raw bytes of the receiver that are stored: at this offset its device goes on.
    pub raw_through: Option<u64>,
    /// Which base modes relative to one are given, by its id.
    pub base: BaseChoice<Arc<str>>,
}
