//! The time by which the ages of epochs are counted. It follows the clock of the service, but not a
//! step of the clock: a clock that is wrong by more than the retention must not remove anything.
//!
//! The time is stored. It advances by the time that the service has run, or a tenth more if the
//! clock is ahead. It also advances to the newest epoch that is not ahead of the clock, because
//! observations of satellites confirm the clock. It never passes the clock.
//!
//! A clock that is behind must not remove anything either, once it is right again: what arrives
//! meanwhile has the counted time.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::gnss::{GpsTime, LeapSeconds};

use super::pool::{reading, writing};
use super::{Store, StoreError};

const READ: &str = "SELECT unix_ms, (SELECT MAX(last_gps_time_ns) FROM session_heads \
    WHERE last_gps_time_ns <= $1) FROM expiry_clock";
const SET: &str = "UPDATE expiry_clock SET unix_ms = $1 WHERE unix_ms IS NULL OR unix_ms < $1";

/// The latest counted time that this process knows (ms since 1970-01-01 UTC), and when it was
/// counted; `None` before it is known.
#[derive(Debug, Default)]
pub(super) struct Counted(Mutex<Option<(i64, Instant)>>);

impl Counted {
    fn learn(&self, counted_ms: i64) {
        let mut known = self.known();
        if known.is_none_or(|(before_ms, _)| before_ms <= counted_ms) {
            *known = Some((counted_ms, Instant::now()));
        }
    }

    fn known(&self) -> MutexGuard<'_, Option<(i64, Instant)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The counted time.
    fn last(&self) -> Option<i64> {
        self.known().map(|(counted_ms, _)| counted_ms)
    }

    /// The counted time now.
    fn now(&self) -> Option<i64> {
        let known = *self.known();
        known.map(|(counted_ms, at)| counted_ms + at.elapsed().as_millis() as i64)
    }
}

impl Store {
    /// Reads the counted time: at the start, and again where another node counts it.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn read_expiry_clock(&self) -> Result<(), StoreError> {
        let read: Result<Option<i64>, _> = reading!(&self.pool, pool => {
            sqlx::query_scalar("SELECT unix_ms FROM expiry_clock").fetch_one(pool).await
        });
        let known = read.map_err(StoreError::database("reading the time of expiry"))?;
        known.into_iter().for_each(|counted_ms| self.counted.learn(counted_ms));
        Ok(())
    }

    /// The time by which to remove what is older than a number of hours, of a clock that shows
    /// `now_unix_ms` (ms since 1970-01-01 UTC).
    pub(crate) fn expiry_time(&self, now_unix_ms: i64) -> i64 {
        self.counted.now().map_or(now_unix_ms, |counted_ms| counted_ms.min(now_unix_ms))
    }

    /// The time to store for what arrives or ends at `now_unix_ms` of the clock.
    pub(crate) fn arrival_time(&self, now_unix_ms: i64) -> i64 {
        self.counted.last().map_or(now_unix_ms, |counted_ms| counted_ms.max(now_unix_ms))
    }

    /// Time by which a clock that shows `now_unix_ms` is behind the counted time (ms); negative if
    /// it is ahead.
    pub(crate) fn clock_behind_ms(&self, now_unix_ms: i64) -> i64 {
        self.counted.last().map_or(0, |counted_ms| counted_ms - now_unix_ms)
    }

    /// Advances the time by which ages are counted, and returns it (ms since 1970-01-01 UTC).
    /// `elapsed_ms` is the time that the service has run since the last call.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn advance_expiry_clock(
        &self,
        now_unix_ms: i64,
        elapsed_ms: i64,
    ) -> Result<i64, StoreError> {
        let leap = LeapSeconds::table();
        let now = GpsTime::from_unix_ms(now_unix_ms, &leap);
        let known: Result<(Option<i64>, Option<i64>), _> = reading!(&self.pool, pool => {
            sqlx::query_as(READ).bind(now.as_ns()).fetch_one(pool).await
        });
        let (counted, newest) =
            known.map_err(StoreError::database("reading the time of expiry"))?;
        let newest = newest.map(|ns| GpsTime::from_ns(ns).to_unix_ms(&leap));
        let counted = advanced(counted.unwrap_or(now_unix_ms), newest, now_unix_ms, elapsed_ms);
        let set = writing!(&self.pool, pool => {
            sqlx::query(SET).bind(counted).execute(pool).await.map(drop)
        });
        set.map_err(StoreError::database("storing the time of expiry"))?;
        self.counted.learn(counted);
        Ok(counted)
    }
}

/// The advanced time. All times are in ms since 1970-01-01 UTC.
fn advanced(counted: i64, newest_epoch: Option<i64>, now: i64, elapsed_ms: i64) -> i64 {
    let run = counted.saturating_add(elapsed_ms + elapsed_ms / 10);
    now.min(newest_epoch.map_or(run, |epoch| run.max(epoch)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_of_the_clock_is_not_followed() {
        assert_eq!(advanced(1_000, None, 1_500, 500), 1_500);
        assert_eq!(advanced(1_000, None, 900_000, 500), 1_550, "a tenth faster than it runs");
        assert_eq!(advanced(1_000, None, 900, 500), 900, "never ahead of the clock");
        assert_eq!(advanced(1_000, Some(700_000), 900_000, 0), 700_000, "an epoch is a witness");
        assert_eq!(
            advanced(1_000, Some(10), 900_000, 0),
            1_000,
            "an old file's epochs are not a witness"
        );
    }
}
