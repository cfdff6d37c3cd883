//! What a job states of the addresses of archives. They may contain the tokens of their owner.

use crate::feeds::{Url, WebError};
use crate::tenant::Tenant;

/// Whether a job may state the address of an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Addresses {
    /// The job and the archive belong to the same tenant.
    Shown,
    /// They belong to different tenants.
    Hidden,
}

impl Addresses {
    /// For a job of one tenant and an archive of another, or of the same.
    pub(super) fn of(archive: &Tenant, job: &Tenant) -> Self {
        if archive == job { Self::Shown } else { Self::Hidden }
    }

    /// Why an archive gives no file. Messages of hosts contain their addresses.
    pub(super) fn failure(self, archive: &str, error: &WebError) -> String {
        match self {
            Self::Shown => format!("{archive}: {error}"),
            Self::Hidden => format!("{archive} gives no file: {}", error.code()),
        }
    }

    /// The name of a file in a message.
    pub(super) fn file(self, url: &Url, name: &str) -> String {
        match self {
            Self::Shown => url.without_query(),
            Self::Hidden => name.to_owned(),
        }
    }
}
