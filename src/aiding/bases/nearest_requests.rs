//! Rovers that ask for the nearest of all bases, so that networks of casters can connect it.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::gnss::Ecef;
use crate::store::SessionKey;

/// A rover that asks for the nearest of all bases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NearestBaseRequest {
    /// Last position of the rover.
    pub position: Ecef,
    /// Longest baseline that its session allows (m).
    pub baseline_max_m: f64,
    /// Time of this position (ms since 1970-01-01 UTC).
    pub unix_ms: i64,
}

/// The last request of each session. All clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct NearestBaseRequests {
    /// Set by the first read. Requests are recorded only from then on.
    is_read: Arc<AtomicBool>,
    by_session: Arc<Mutex<HashMap<SessionKey, NearestBaseRequest>>>,
}

impl NearestBaseRequests {
    /// Records the position of a session's rover.
    pub(crate) fn record(&self, session: SessionKey, request: NearestBaseRequest) {
        if self.is_read.load(Ordering::Relaxed) {
            let mut by_session = self.by_session.lock().unwrap_or_else(PoisonError::into_inner);
            by_session.insert(session, request);
        }
    }

    /// The requests since a time (ms since 1970-01-01 UTC). Earlier ones are dropped.
    pub(crate) fn since(&self, unix_ms: i64) -> Vec<NearestBaseRequest> {
        self.is_read.store(true, Ordering::Relaxed);
        let mut by_session = self.by_session.lock().unwrap_or_else(PoisonError::into_inner);
        by_session.retain(|_, request| unix_ms <= request.unix_ms);
        by_session.values().copied().collect()
    }
}
