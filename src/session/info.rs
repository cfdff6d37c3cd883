//! A session as its users see it: id, configuration, and the number of its last stored epoch.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::config::{OptionEntry, OutputOptions};
use crate::id::{Id, Kind};
use crate::store::{AntennaName, Page, SessionRow, SessionSettings, StoredSolution};

use super::SessionError;
use super::configuration::entries;

/// Hexadecimal digits of an etag: 64 bits.
const ETAG_DIGITS: usize = 16;

/// Marks an [`Id`] as a session's; its text begins with `ses_`.
pub enum SessionKind {}

impl Kind for SessionKind {
    const PREFIX: &str = "ses_";
}

/// The id of a session.
pub type SessionId = Id<SessionKind>;

/// The properties of a new session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewSession {
    /// A name for people; may be empty.
    pub label: String,
    /// Name of the mode.
    pub mode: String,
    /// Name of the profile.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// The bases of a mode relative to one.
    pub base: BaseChoice<BaseId>,
    /// Type and radome of the rover's antenna; empty: no antenna corrections.
    pub antenna: String,
    /// Time for which epochs are kept (days); 0 for ever, `None` for the service's setting.
    pub retention_days: Option<u32>,
}

/// The changes of a session. Fields that are `None` or empty change nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionUpdate {
    /// New name for people.
    pub label: Option<String>,
    /// Name of the new mode.
    pub mode: Option<String>,
    /// Name of the new profile.
    pub profile: Option<String>,
    /// Overrides to set.
    pub overrides: BTreeMap<String, String>,
    /// Names of the overrides to remove, so that the profile's values apply again.
    pub clear_overrides: Vec<String>,
    /// New bases, or none.
    pub base: Option<BaseChoice<BaseId>>,
    /// New type and radome of the rover's antenna; empty: no antenna corrections.
    pub antenna: Option<String>,
    /// Time for which epochs are kept from now on (days); 0 for ever.
    pub retention_days: Option<u32>,
    /// The etag of the session that the caller has read; `None` for any.
    pub etag: Option<String>,
}

/// A stored session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionInfo {
    /// The session's id.
    pub id: SessionId,
    /// A name for people; may be empty.
    pub label: String,
    /// Name of the mode.
    pub mode: String,
    /// Name of the profile.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// All options with their values in force, as far as this version knows them.
    pub configuration: Vec<OptionEntry>,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
    /// Identifies the present settings. It changes with them.
    pub etag: String,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When it was closed (ms since 1970-01-01 UTC); `None` while it is open.
    pub closed_unix_ms: Option<i64>,
    /// Number of the last committed epoch. Every acknowledged epoch up to it is durable.
    pub durable_through: Option<u64>,
    /// Number of stored raw bytes: the offset at which the device continues.
    pub raw_through: Option<u64>,
    /// Ids of the bases of a mode relative to one.
    pub base: BaseChoice<Arc<str>>,
    /// The rover's antenna, if the session corrects for antennas.
    pub antenna: Option<AntennaName>,
    /// Time for which epochs are kept (days); 0 for ever.
    pub retention_days: u32,
    /// Epochs below this number are removed because they are older than the retention; `None` while
    /// all are stored.
    pub oldest_available: Option<u64>,
}

impl SessionInfo {
    /// The session of a stored row. Without a retention of its own it has `retention_days`.
    pub(super) fn of(
        id: SessionId,
        row: SessionRow,
        retention_days: u32,
    ) -> Result<Self, SessionError> {
        let configuration = entries(&row.settings);
        let etag = etag_of(&row.settings);
        Ok(Self {
            etag,
            id,
            label: row.settings.label,
            mode: row.settings.mode,
            profile: row.settings.profile,
            overrides: row.settings.overrides,
            configuration,
            configuration_hash: row.settings.configuration_hash,
            created_unix_ms: row.created_unix_ms,
            closed_unix_ms: row.closed_unix_ms,
            durable_through: row.last_seq,
            raw_through: row.raw_through,
            base: row.settings.base.try_map(|base| Ok::<_, SessionError>(base.id))?,
            antenna: row.settings.antenna,
            retention_days: row.settings.retention_days.unwrap_or(retention_days),
            oldest_available: oldest_available(row.removed_through),
        })
    }
}

/// The etag of settings. Other settings have another etag.
pub(super) fn etag_of(settings: &SessionSettings) -> String {
    let SessionSettings { label, mode, profile, overrides, base, antenna, .. } = settings;
    let ids: Vec<&str> = match base {
        BaseChoice::None | BaseChoice::Nearest => Vec::new(),
        BaseChoice::One(base) => vec![&base.id],
        BaseChoice::NearestOf(bases) => bases.iter().map(|base| &*base.id).collect(),
    };
    let choice = (ids, matches!(base, BaseChoice::Nearest), matches!(base, BaseChoice::One(_)));
    let antenna = antenna.as_ref().map(|antenna| (&antenna.name, &*antenna.calibration));
    let all = (label, mode, profile, overrides, choice, antenna, settings.retention_days);
    let text = serde_json::to_string(&all).expect("texts and numbers are JSON");
    blake3::hash(text.as_bytes()).to_hex()[..ETAG_DIGITS].to_owned()
}

/// The number below which all epochs are removed.
pub(super) fn oldest_available(removed_through: Option<u64>) -> Option<u64> {
    removed_through.map(|seq| seq + 1)
}

/// A page of a session's solutions.
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionPage {
    /// The solutions.
    pub page: Page<StoredSolution>,
    /// Epochs below this number are removed; `None` while all are stored.
    pub oldest_available: Option<u64>,
    /// Frame and heights in which the solutions are reported.
    pub output: OutputOptions,
    /// The bases of the session.
    pub bases: BaseChoice,
}
