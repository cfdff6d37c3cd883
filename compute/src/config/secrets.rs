//! Options of the secrets that the service stores: passwords at casters and secrets of webhooks.

use std::fmt;
use std::path::PathBuf;

use serde::Deserialize;

/// Keys that encrypt stored secrets. Without one they are stored as they are, and once the service
/// has API keys none are taken.
#[derive(Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SecretsConfiguration {
    /// File of the key: 64 hexadecimal digits.
    pub key_file: Option<PathBuf>,
    /// Files of former keys, under which secrets may still be stored. At the start they are
    /// encrypted again with the key.
    pub former_key_files: Vec<PathBuf>,
    /// The key itself, in place of a file; from the environment only.
    #[serde(skip)]
    pub key: Option<String>,
}

impl fmt::Debug for SecretsConfiguration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key_file, former_key_files, .. } = self;
        f.debug_struct("SecretsConfiguration")
            .field("key_file", key_file)
            .field("former_key_files", former_key_files)
            .finish_non_exhaustive()
    }
}

impl SecretsConfiguration {
    /// What contradicts itself; `None` if nothing does.
    pub(super) fn wrong(&self) -> Option<&'static str> {
        let is_given = self.key_file.is_some() || self.key.is_some();
        if self.key_file.is_some() && self.key.is_some() {
            return Some("the key of secrets is given by a file and by GRAPHFIX_SECRETS_KEY");
        }
        (!is_given && !self.former_key_files.is_empty())
            .then_some("secrets.former_key_files needs secrets.key_file, the key in force")
    }
}
