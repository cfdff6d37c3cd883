//! The service as the doors see it: desks, limits, and whether it is about to stop.

use std::sync::Arc;

use tokio::sync::watch;

use crate::aiding::{AidingDesk, BaseBroker, NavigationBroker};
use crate::config::Limits;
use crate::feeds::Feeds;
use crate::session::Sessions;

/// The desks behind the doors. All clones share them.
#[derive(Clone)]
pub struct Service {
    sessions: Sessions,
    aiding: AidingDesk,
    feeds: Feeds,
    limits: Arc<Limits>,
    draining: Arc<watch::Sender<bool>>,
    node: Arc<str>,
}

impl Service {
    /// The service over these desks.
    pub fn new(sessions: Sessions, aiding: AidingDesk, feeds: Feeds, limits: Limits) -> Self {
        Self {
            sessions,
            aiding,
            feeds,
            limits: Arc::new(limits),
            draining: Arc::new(watch::Sender::new(false)),
            node: "".into(),
        }
    }

    /// The service as the node of this name.
    #[must_use]
    pub fn named(mut self, node: String) -> Self {
        self.node = node.into();
        self
    }

    /// Name of the node.
    pub fn node(&self) -> &str {
        &self.node
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

    /// The desk for streams and archives.
    pub const fn feeds(&self) -> &Feeds {
        &self.feeds
    }

    /// The limits in force.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Makes the service not ready, because it is about to stop.
    pub fn drain(&self) {
        self.draining.send_replace(true);
    }

    /// Whether the service is about to stop.
    pub fn is_draining(&self) -> bool {
        *self.draining.borrow()
    }

    /// Waits until the service is about to stop, or no longer exists.
    pub(crate) fn drained(&self) -> impl Future<Output = ()> + use<> {
        let mut draining = self.draining.subscribe();
        async move {
            // Err: the service no longer exists.
            draining.wait_for(|draining| *draining).await.ok();
        }
    }
}
