//! Streams and archives as one tenant sees them.

use crate::aiding::bases::{BaseFeed, BaseId};
use crate::tenant::Tenant;

use super::desk::Feeds;
use super::{BaseArchiveHealth, FeedHealth, FetchError, NetworkHealth, SourceStatus};

/// The desk for streams and archives, as one tenant sees it. Its calls take ids of bases that
/// belong to the tenant.
#[derive(Clone, Copy)]
pub(crate) struct TenantFeeds<'a> {
    feeds: &'a Feeds,
    tenant: &'a Tenant,
}

impl Feeds {
    /// The desk as a tenant sees it.
    pub(crate) const fn of<'a>(&'a self, tenant: &'a Tenant) -> TenantFeeds<'a> {
        TenantFeeds { feeds: self, tenant }
    }
}

impl TenantFeeds<'_> {
    /// Checks whether a stream may be requested.
    ///
    /// # Errors
    /// The caster's address or the mountpoint is invalid, or the operator does not list the host.
    pub(crate) fn check(&self, feed: &BaseFeed) -> Result<(), FetchError> {
        self.feeds.check(self.tenant, feed)
    }

    /// Checks whether an archive's host may be contacted for a base's files.
    ///
    /// # Errors
    /// The address is invalid or has no day, or the operator does not list the host.
    pub(crate) fn check_archive(&self, template: &str) -> Result<(), FetchError> {
        self.feeds.check_archive(self.tenant, template)
    }

    /// Starts to fill a base of the tenant from a stream.
    ///
    /// # Errors
    /// The caster's address or the mountpoint is invalid.
    pub(crate) fn start(&self, base: &BaseId, feed: &BaseFeed) -> Result<(), FetchError> {
        self.feeds.start(self.tenant, base, feed)
    }

    /// Starts to fill a base of the tenant from an archive's files.
    ///
    /// # Errors
    /// The address is invalid.
    pub(crate) fn fill(&self, base: &BaseId, template: &str) -> Result<(), FetchError> {
        self.feeds.fill(self.tenant, base, template)
    }

    /// Stops filling a base of the tenant.
    pub(crate) fn stop(&self, base: &BaseId) {
        self.feeds.stop(base);
    }

    /// The health of the stream that fills a base of the tenant.
    pub(crate) fn health(&self, base: &BaseId) -> Option<FeedHealth> {
        self.feeds.health(base)
    }

    /// The health of the archive that fills a base of the tenant.
    pub(crate) fn archive_health(&self, base: &BaseId) -> Option<BaseArchiveHealth> {
        self.feeds.archive_health(base)
    }

    /// The operator's networks. Another tenant gets none, because they show where rovers are.
    pub(crate) fn networks(&self) -> Vec<NetworkHealth> {
        if self.tenant.is_operator() { self.feeds.networks() } else { Vec::new() }
    }

    /// The operator's sources of ephemerides. Another tenant gets none.
    pub(crate) fn navigation_sources(&self) -> Vec<(String, SourceStatus)> {
        if self.tenant.is_operator() { self.feeds.navigation_sources() } else { Vec::new() }
    }
}
