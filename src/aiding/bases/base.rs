//! One base in memory.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::clock::unix_ms;
use crate::gnss::{CoordinateFrame, Ecef, GpsTime};
use crate::positioning::BASE_LATER_S;
use crate::store::{BaseFeed, BaseName, NamedRequest};
use crate::tenant::Tenant;

use super::archive_requests::ArchiveRequests;
use super::base_epochs::BaseEpochs;
use super::{BaseInfo, BaseView};

/// The data of a base that never change.
pub(super) struct BaseDescription {
    pub(super) name: BaseName,
    pub(super) tenant: Tenant,
    pub(super) label: String,
    pub(super) created_unix_ms: i64,
    pub(super) feed: Option<BaseFeed>,
    pub(super) archive: Option<String>,
    /// The named request that created it.
    pub(super) request: Option<NamedRequest>,
    /// The frame of its coordinates, if it is known.
    pub(super) frame: Option<CoordinateFrame>,
}

/// A base with its epochs and the requests of its rovers.
pub(super) struct Base {
    pub(super) description: BaseDescription,
    /// Times at which rovers need files of the archive.
    pub(super) archive_requests: ArchiveRequests,
    /// The last rover position computed against this base, and when (ms since 1970-01-01 UTC).
    rover: Mutex<Option<(Ecef, i64)>>,
    /// Locked while a push is checked and committed, so that pushes follow one another.
    pub(super) pushing: tokio::sync::Mutex<()>,
    stored: Mutex<BaseEpochs>,
}

impl Base {
    pub(super) fn new(description: BaseDescription, stored: BaseEpochs) -> Self {
        Self {
            description,
            archive_requests: ArchiveRequests::default(),
            rover: Mutex::default(),
            pushing: tokio::sync::Mutex::new(()),
            stored: Mutex::new(stored),
        }
    }

    pub(super) const fn name(&self) -> &BaseName {
        &self.description.name
    }

    pub(super) fn rover(&self) -> MutexGuard<'_, Option<(Ecef, i64)>> {
        self.rover.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn stored(&self) -> MutexGuard<'_, BaseEpochs> {
        self.stored.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The base with all epochs that rover epochs from `from` until `until` may need. If an archive
    /// fills the base, this also requests the archive's files of that time.
    pub(super) fn view(&self, from: GpsTime, until: GpsTime, span_s: f64) -> BaseView {
        if self.description.archive.is_some() {
            self.archive_requests.add(from, until, unix_ms());
        }
        let stored = self.stored();
        let epochs = stored.between_times(from - span_s - BASE_LATER_S, until + BASE_LATER_S);
        BaseView { name: self.name().clone(), sites: stored.sites.clone(), epochs }
    }

    pub(super) fn info(&self) -> BaseInfo {
        let BaseDescription { name, tenant, label, created_unix_ms, feed, archive, .. } =
            &self.description;
        let stored = self.stored();
        let span = stored.epochs.front().zip(stored.epochs.back());
        BaseInfo {
            name: name.clone(),
            tenant: tenant.clone(),
            label: label.clone(),
            created_unix_ms: *created_unix_ms,
            feed: feed.clone(),
            archive: archive.clone(),
            frame: self.description.frame,
            site: stored.site().cloned(),
            epochs: stored.epochs.len(),
            span: span.map(|(oldest, newest)| (oldest.time, newest.time)),
            stored_unix_ms: stored.stored_unix_ms,
            satellites: stored.satellites,
            check: stored.checks.present,
        }
    }
}
