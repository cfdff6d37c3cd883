//! Limits how often the settings of a session change. Each change is an entry of the audit log,
//! which is kept for long and counts towards no quota.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::{SessionError, SessionId};

/// Changes of a session that may follow one another at once.
const AT_ONCE: u32 = 60;
/// Further changes are allowed at this interval.
const INTERVAL: Duration = Duration::from_secs(10);
/// Sessions in memory beyond which those without recent changes are forgotten.
const REMEMBERED: usize = 10_000;

/// When each recently changed session has made up for its changes, at one change per interval.
#[derive(Default)]
pub(super) struct UpdateRates(Mutex<HashMap<SessionId, Instant>>);

impl UpdateRates {
    /// Counts a change of a session.
    ///
    /// # Errors
    /// The session has changed too often.
    pub(super) fn admit(&self, id: &SessionId, now: Instant) -> Result<(), SessionError> {
        let mut sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if REMEMBERED <= sessions.len() {
            sessions.retain(|_, even| now < *even);
        }
        let before = sessions.get(id).map_or(now, |even| now.max(*even));
        let owed = before + INTERVAL - now;
        let most = AT_ONCE * INTERVAL;
        if most < owed {
            let (limit, retry_after) = (AT_ONCE, owed - most);
            return Err(SessionError::TooManyUpdates { limit, retry_after });
        }
        sessions.insert(id.clone(), now + owed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_that_changes_often_waits() {
        let (rates, id, now) = (UpdateRates::default(), SessionId::random(), Instant::now());
        for _ in 0..AT_ONCE {
            rates.admit(&id, now).unwrap();
        }
        let refused = rates.admit(&id, now + Duration::from_secs(4)).unwrap_err();
        assert_eq!(refused.code().name(), "TOO_MANY_UPDATES");
        let SessionError::TooManyUpdates { retry_after, .. } = refused else { panic!("{refused}") };
        assert_eq!(retry_after, Duration::from_secs(6));
        rates.admit(&SessionId::random(), now).unwrap();
        rates.admit(&id, now + INTERVAL).unwrap();
        rates.admit(&id, now + INTERVAL).unwrap_err();
    }

    #[test]
    fn sessions_without_recent_changes_are_forgotten() {
        let (rates, now) = (UpdateRates::default(), Instant::now());
        for _ in 0..REMEMBERED {
            rates.admit(&SessionId::random(), now).unwrap();
        }
        rates.admit(&SessionId::random(), now + 2 * INTERVAL).unwrap();
        assert_eq!(rates.0.lock().unwrap().len(), 1);
    }
}
