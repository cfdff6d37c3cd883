//! The system clock. Nothing that computes asks it.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::gnss::{GpsTime, LeapSeconds};

const MS_PER_DAY: i64 = 86_400_000;

/// The time now (ms since 1970-01-01 UTC).
pub(crate) fn unix_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("the clock is past 1970");
    i64::try_from(since.as_millis()).expect("the clock is not millions of years ahead")
}

/// The clock of a desk: that of the system, or one that is set.
#[derive(Clone, Debug)]
pub struct Clock {
    /// The time of a clock that is set (ms since 1970-01-01 UTC).
    set: Option<Arc<AtomicI64>>,
}

impl Clock {
    /// The system's clock.
    pub const fn system() -> Self {
        Self { set: None }
    }

    /// A clock that stands at this time (ms since 1970-01-01 UTC) until it is set again.
    pub fn at(unix_ms: i64) -> Self {
        Self { set: Some(Arc::new(AtomicI64::new(unix_ms))) }
    }

    /// Sets this clock and its clones. The system's clock is not changed.
    pub fn set(&self, unix_ms: i64) {
        if let Some(set) = &self.set {
            set.store(unix_ms, Ordering::Relaxed);
        }
    }

    /// The time now (ms since 1970-01-01 UTC).
    pub fn unix_ms(&self) -> i64 {
        self.set.as_ref().map_or_else(unix_ms, |set| set.load(Ordering::Relaxed))
    }

    /// The day now, since 1970-01-01 UTC.
    pub fn day(&self) -> i64 {
        self.unix_ms().div_euclid(MS_PER_DAY)
    }
}

/// GPS time of the system clock's time (ms since 1970-01-01 UTC).
pub(crate) fn gps_time(unix_ms: i64) -> GpsTime {
    GpsTime::from_unix_ms(unix_ms, &LeapSeconds::table())
}
