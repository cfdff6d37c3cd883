//! Rovers that seek the nearest of all bases, for those who can bring more.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::gnss::Ecef;
use crate::store::SessionKey;

/// A rover that seeks the nearest of all bases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seeker {
    /// Where it was last.
    pub place: Ecef,
    /// A base further away is not used (m).
    pub reach_m: f64,
    /// When it was there (ms since 1970-01-01 UTC).
    pub noted_unix_ms: i64,
}

/// All of them, each session's last. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Seekers {
    /// Nothing is noted where nobody asks.
    is_asked: Arc<AtomicBool>,
    known: Arc<Mutex<HashMap<SessionKey, Seeker>>>,
}

impl Seekers {
    /// Notes where a session's rover is.
    pub fn note(&self, session: SessionKey, seeker: Seeker) {
        if self.is_asked.load(Ordering::Relaxed) {
            let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
            known.insert(session, seeker);
        }
    }

    /// Those noted since a time (ms since 1970-01-01 UTC); earlier ones are forgotten.
    pub fn since(&self, unix_ms: i64) -> Vec<Seeker> {
        self.is_asked.store(true, Ordering::Relaxed);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.retain(|_, seeker| unix_ms <= seeker.noted_unix_ms);
        known.values().copied().collect()
    }
}
