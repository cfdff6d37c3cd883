//! What a session is to its users: its id, its configuration, how far it is stored.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use uuid::Uuid;

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::config::OptionEntry;

/// The name of a session: `ses_` and 122 random bits, so that nobody guesses another's.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionId(Arc<str>);

impl SessionId {
    const PREFIX: &str = "ses_";

    /// A new random id.
    pub(super) fn random() -> Self {
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

impl fmt::Display for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for SessionId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_parsed_by_their_form() {
        let id = SessionId::random();
        assert_eq!(SessionId::parse(id.as_str()), Some(id.clone()));
        assert_ne!(SessionId::random(), id);
        let upper = id.as_str().to_uppercase();
        for wrong in ["", "ses_", "ses_12", &id.as_str()[4..], upper.as_str()] {
            assert_eq!(SessionId::parse(wrong), None, "{wrong}");
        }
    }
}
