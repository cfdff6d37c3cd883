//! What the doors open to: the desks, the limits, and whether the service is about to stop.

use std::sync::Arc;

use tokio::sync::watch;

use crate::aiding::{AidingDesk, BaseBroker, NavigationBroker};
use crate::config::Limits;
use crate::feeds::Feeds;
use crate::session::Sessions;

/// The desks behind the doors. Clones share them.
#[derive(Clone)]
pub struct Service {
    sessions: Sessions,
    aiding: AidingDesk,
    feeds: Feeds,
    limits: Arc<Limits>,
    draining: Arc<watch::Sender<bool>>,
}

impl Service {
    /// The service over its desks.
    pub fn new(sessions: Sessions, aiding: AidingDesk, feeds: Feeds, limits: Limits) -> Self {
        Self {
            sessions,
            aiding,
            feeds,
            limits: Arc::new(limits),
            draining: Arc::new(watch::Sender::new(false)),
        }
    }

    /// The desk for sessions.
    pub const fn sessions(&self) -> &Sessions {
        &self.sessions
    }

    /// The desk for ephemerides.
    pub const fn navigation(&self) -> &NavigationBroker {
        &self.aiding.navigation
    }

    /// The desk for base stations.
    pub const fn bases(&self) -> &BaseBroker {
        &self.aiding.bases
    }

    /// The desk for streams of casters.
    pub const fn feeds(&self) -> &Feeds {
        &self.feeds
    }

    /// How much the service takes.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// From now on the service is not ready.
    pub fn drain(&self) {
        self.draining.send_replace(true);
    }

    /// Whether the service is about to stop.
    pub fn is_draining(&self) -> bool {
        *self.draining.borrow()
    }

    /// Waits until the service is about to stop, or nobody holds it any more.
    pub(crate) fn drained(&self) -> impl Future<Output = ()> + use<> {
        let mut draining = self.draining.subscribe();
        async move {
            // Err: the sender is gone, and with it the service.
            draining.wait_for(|draining| *draining).await.ok();
        }
    }
}
