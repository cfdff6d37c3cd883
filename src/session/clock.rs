//! The system clock.

use std::time::{SystemTime, UNIX_EPOCH};

use crate::gnss::{GpsTime, LeapSeconds};

/// GPS time starts 1980-01-06 (ms since 1970-01-01 UTC).
const GPS_START_UNIX_MS: i64 = 315_964_800_000;

/// The time now (ms since 1970-01-01 UTC).
pub(super) fn unix_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("the clock is past 1970");
    i64::try_from(since.as_millis()).expect("the clock is not millions of years ahead")
}

/// GPS time of the system clock's time (ms since 1970-01-01 UTC).
pub(super) fn gps_time(unix_ms: i64) -> GpsTime {
    let without_leap = GpsTime::from_ns((unix_ms - GPS_START_UNIX_MS).saturating_mul(1_000_000));
    without_leap + LeapSeconds::table().at(without_leap) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gps_time_of_a_known_second() {
        // 2018-10-04T12:37:00Z: week 2021, Thursday, 18 leap seconds.
        let expected = GpsTime::from_week_seconds(2021, 4.0 * 86_400.0 + 45_420.0 + 18.0);
        assert_eq!(gps_time(1_538_656_620_000), expected);
    }
}
