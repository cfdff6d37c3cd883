//! The system clock. Nothing that computes asks it.

use std::time::{SystemTime, UNIX_EPOCH};

use crate::gnss::{GpsTime, LeapSeconds};

/// The time now (ms since 1970-01-01 UTC).
pub(crate) fn unix_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("the clock is past 1970");
    i64::try_from(since.as_millis()).expect("the clock is not millions of years ahead")
}

/// GPS time of the system clock's time (ms since 1970-01-01 UTC).
pub(crate) fn gps_time(unix_ms: i64) -> GpsTime {
    GpsTime::from_unix_ms(unix_ms, &LeapSeconds::table())
}
