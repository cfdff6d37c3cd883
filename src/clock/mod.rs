//! The system clock. Computations do not use it.

mod stopwatch;

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crate::gnss::{CivilTime, GpsTime, LeapSeconds, TimeScale};

pub(crate) use stopwatch::Stopwatch;

pub(crate) const MS_PER_DAY: i64 = 86_400_000;

/// The time now (ms since 1970-01-01 UTC).
pub(crate) fn unix_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("the clock is past 1970");
    i64::try_from(since.as_millis()).expect("the clock is not millions of years ahead")
}

/// The clock of a desk: that of the system, or one that is set.
#[derive(Clone, Debug)]
pub struct Clock {
    /// The time of a clock for tests; `None` for the system's clock.
    set: Option<Arc<Hands>>,
}

/// The time of a clock for tests.
#[derive(Debug)]
struct Hands {
    /// Its time (ms since 1970-01-01 UTC).
    unix_ms: AtomicI64,
    /// The time that has passed for its owner (ms).
    elapsed_ms: AtomicI64,
}

impl Clock {
    /// The system's clock.
    pub const fn system() -> Self {
        Self { set: None }
    }

    /// A clock that shows this time (ms since 1970-01-01 UTC) until it is set again.
    pub fn at(unix_ms: i64) -> Self {
        let (unix_ms, elapsed_ms) = (AtomicI64::new(unix_ms), AtomicI64::new(0));
        Self { set: Some(Arc::new(Hands { unix_ms, elapsed_ms })) }
    }

    /// Lets time pass on this clock and its clones until `unix_ms`. Does nothing to the system's
    /// clock.
    pub fn set(&self, unix_ms: i64) {
        if let Some(hands) = &self.set {
            let before = hands.unix_ms.swap(unix_ms, Ordering::Relaxed);
            hands.elapsed_ms.fetch_add((unix_ms - before).max(0), Ordering::Relaxed);
        }
    }

    /// Sets this clock and its clones to another time, without time passing. Does nothing to the
    /// system's clock.
    pub fn step(&self, unix_ms: i64) {
        if let Some(hands) = &self.set {
            hands.unix_ms.store(unix_ms, Ordering::Relaxed);
        }
    }

    /// The time now (ms since 1970-01-01 UTC).
    pub fn unix_ms(&self) -> i64 {
        self.set.as_ref().map_or_else(unix_ms, |hands| hands.unix_ms.load(Ordering::Relaxed))
    }

    /// The time that has passed since a fixed moment of this process (ms). Setting the clock does
    /// not change it.
    pub fn elapsed_ms(&self) -> i64 {
        static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);
        match &self.set {
            Some(hands) => hands.elapsed_ms.load(Ordering::Relaxed),
            None => BEGUN.elapsed().as_millis() as i64,
        }
    }
}

/// The day of a time (ms since 1970-01-01 UTC), as a number of days since 1970-01-01 UTC.
pub(crate) const fn day_of(unix_ms: i64) -> i64 {
    unix_ms.div_euclid(MS_PER_DAY)
}

/// GPS time of the system clock's time (ms since 1970-01-01 UTC).
pub(crate) fn gps_time(unix_ms: i64) -> GpsTime {
    GpsTime::from_unix_ms(unix_ms, &LeapSeconds::table())
}

/// A system time (ms since 1970-01-01 UTC, without leap seconds) as RFC 3339.
pub(crate) fn utc(unix_ms: i64) -> String {
    let start = unix_epoch();
    let civil = GpsTime::from_ns(start.as_ns().saturating_add(unix_ms.saturating_mul(1_000_000)))
        .to_civil(TimeScale::Gps, &LeapSeconds::table());
    let CivilTime { year, month, day, hour, minute, second, nanosecond } = civil;
    let ms = nanosecond / 1_000_000;
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

/// 1970-01-01 as a GPS time. The system clock has no leap seconds, and neither has GPS time.
pub(crate) fn unix_epoch() -> GpsTime {
    const EPOCH: CivilTime =
        CivilTime { year: 1970, month: 1, day: 1, hour: 0, minute: 0, second: 0, nanosecond: 0 };
    let start = GpsTime::from_civil(&EPOCH, TimeScale::Gps, &LeapSeconds::table());
    start.expect("the date exists")
}
