//! GPS time and its relation to the other time scales.
//!
//! [`GpsTime`] counts nanoseconds since the GPS epoch, 1980-01-06T00:00:00 UTC, without leap
//! seconds. Galileo system time runs with it (week numbers differ by 1024); BeiDou time is 14 s
//! behind; GLONASS time is UTC + 3 h and therefore needs [`LeapSeconds`], as UTC does.
//!
//! Sources: IS-GPS-200N 20.3.3.5.2.4; Galileo OS SIS ICD 2.1, 5.1.2; BDS-SIS-ICD-B1I-3.0, 3.3;
//! GLONASS ICD 5.1, 3.3.3; leap seconds: IERS Bulletin C.

use std::fmt;
use std::ops::{Add, Sub};

use super::constants::{
    BEIDOU_FIRST_WEEK, BEIDOU_LAG_S, GLONASS_AHEAD_OF_UTC_S, NS_PER_SECOND, SECONDS_PER_DAY,
    SECONDS_PER_HOUR, SECONDS_PER_WEEK,
};

const NS_PER_MS: i64 = NS_PER_SECOND / 1_000;
const NS_PER_WEEK: i64 = SECONDS_PER_WEEK as i64 * NS_PER_SECOND;
const DAY_S: i64 = SECONDS_PER_DAY as i64;
const HOUR_S: i64 = SECONDS_PER_HOUR as i64;
/// Days from 1970-01-01 to 1980-01-06.
const GPS_EPOCH_UNIX_DAYS: i64 = 3_657;
const BEIDOU_LAG_NS: i64 = BEIDOU_LAG_S as i64 * NS_PER_SECOND;
/// GLONASS time is Moscow time.
const MOSCOW_AHEAD_S: i64 = GLONASS_AHEAD_OF_UTC_S as i64;

/// An instant of GPS time, to the nanosecond.
///
/// Spans 1980 ± 292 years. Displays as `week:seconds`, as in `2051:46701.000000000`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GpsTime(i64);

impl GpsTime {
    /// The start of GPS time, 1980-01-06T00:00:00 UTC.
    pub const EPOCH: Self = Self(0);

    /// The instant `ns` nanoseconds after the GPS epoch.
    pub const fn from_ns(ns: i64) -> Self {
        Self(ns)
    }

    /// Nanoseconds since the GPS epoch.
    pub const fn as_ns(self) -> i64 {
        self.0
    }

    /// The instant of a GPS week (without roll-over) and nanoseconds of week.
    ///
    /// `None` outside weeks −15 000 … 15 000, or if the nanoseconds exceed one week.
    pub fn from_week_ns(week: i32, ns_of_week: i64) -> Option<Self> {
        let sane = (-15_000..=15_000).contains(&week) && (0..NS_PER_WEEK).contains(&ns_of_week);
        sane.then(|| Self(i64::from(week) * NS_PER_WEEK + ns_of_week))
    }

    /// The instant of a GPS week and seconds of week (s), rounded to the nanosecond. Seconds may be
    /// negative or exceed one week.
    pub fn from_week_seconds(week: i32, seconds: f64) -> Self {
        Self(i64::from(week) * NS_PER_WEEK) + seconds
    }

    /// The instant of BeiDou time: week since 2006-01-01 and seconds of week (s).
    pub fn from_beidou(week: i32, seconds: f64) -> Self {
        let same_label = Self::from_week_seconds(week + BEIDOU_FIRST_WEEK, seconds);
        Self(same_label.0 + BEIDOU_LAG_NS)
    }

    /// The instant of a calendar date and time of day in `scale`; `None` for a date that does not
    /// exist.
    ///
    /// `leap` is used for UTC and GLONASS only.
    pub fn from_civil(civil: &CivilTime, scale: TimeScale, leap: &LeapSeconds) -> Option<Self> {
        let label = civil.ns_since_gps_epoch_label()?;
        Some(match scale {
            TimeScale::Gps | TimeScale::Galileo | TimeScale::Qzss => Self(label),
            TimeScale::BeiDou => Self(label + BEIDOU_LAG_NS),
            TimeScale::Utc => leap.gps_from_utc_label(label),
            TimeScale::Glonass => leap.gps_from_utc_label(label - MOSCOW_AHEAD_S * NS_PER_SECOND),
        })
    }

    /// The instant of a system clock's time (ms since 1970-01-01 UTC, leap seconds not counted).
    pub fn from_unix_ms(unix_ms: i64, leap: &LeapSeconds) -> Self {
        let since_epoch_ms = unix_ms.saturating_sub(GPS_EPOCH_UNIX_DAYS * DAY_S * 1000);
        let without_leap = Self(since_epoch_ms.saturating_mul(NS_PER_SECOND / 1000));
        without_leap + leap.at(without_leap) as f64
    }

    /// The system clock's time of this instant (ms since 1970-01-01 UTC, leap seconds not counted).
    pub fn to_unix_ms(self, leap: &LeapSeconds) -> i64 {
        let since_epoch_ms = self.0.div_euclid(NS_PER_SECOND / 1000) - 1000 * leap.at(self);
        since_epoch_ms + GPS_EPOCH_UNIX_DAYS * DAY_S * 1000
    }

    /// GPS week, without roll-over.
    pub const fn week(self) -> i32 {
        self.0.div_euclid(NS_PER_WEEK) as i32
    }

    /// Nanoseconds of the GPS week.
    pub const fn ns_of_week(self) -> i64 {
        self.0.rem_euclid(NS_PER_WEEK)
    }

    /// Seconds of the GPS week (s).
    pub fn seconds_of_week(self) -> f64 {
        self.ns_of_week() as f64 * 1e-9
    }

    /// BeiDou week and seconds of week (s).
    pub fn to_beidou(self) -> (i32, f64) {
        let label = Self(self.0 - BEIDOU_LAG_NS);
        (label.week() - BEIDOU_FIRST_WEEK, label.seconds_of_week())
    }

    /// Calendar date and time of day in `scale`; a leap second shows as second 60 of UTC.
    pub fn to_civil(self, scale: TimeScale, leap: &LeapSeconds) -> CivilTime {
        match scale {
            TimeScale::Gps | TimeScale::Galileo | TimeScale::Qzss => CivilTime::from_label(self.0),
            TimeScale::BeiDou => CivilTime::from_label(self.0 - BEIDOU_LAG_NS),
            TimeScale::Utc => leap.utc_civil(self, 0),
            TimeScale::Glonass => leap.utc_civil(self, MOSCOW_AHEAD_S),
        }
    }

    /// Year and its part that has passed, as epochs of coordinates are written.
    pub(crate) fn decimal_year(self) -> f64 {
        let year = CivilTime::from_label(self.0).year;
        let start_ns =
            |year: i32| (days_from_civil(year, 1, 1) - GPS_EPOCH_UNIX_DAYS) * DAY_S * NS_PER_SECOND;
        let (start, end) = (start_ns(year), start_ns(year + 1));
        f64::from(year) + (self.0 - start) as f64 / (end - start) as f64
    }

    /// The nearest whole millisecond.
    pub(crate) const fn to_nearest_ms(self) -> Self {
        Self((self.0 + NS_PER_MS / 2).div_euclid(NS_PER_MS) * NS_PER_MS)
    }

    /// UTC as RFC 3339, rounded to milliseconds, `2019-04-28T12:58:03.000Z`.
    pub fn to_rfc3339(self, leap: &LeapSeconds) -> String {
        let c = self.to_nearest_ms().to_civil(TimeScale::Utc, leap);
        format!(
            "{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:03}Z",
            c.year,
            c.month,
            c.day,
            c.hour,
            c.minute,
            c.second,
            i64::from(c.nanosecond) / NS_PER_MS
        )
    }
}

impl fmt::Display for GpsTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ns = self.ns_of_week();
        write!(f, "{}:{}.{:09}", self.week(), ns / NS_PER_SECOND, ns % NS_PER_SECOND)
    }
}

/// The instant `seconds` later, rounded to the nanosecond.
impl Add<f64> for GpsTime {
    type Output = Self;

    fn add(self, seconds: f64) -> Self {
        Self(self.0.saturating_add(nanoseconds(seconds)))
    }
}

/// The instant `seconds` earlier, rounded to the nanosecond.
impl Sub<f64> for GpsTime {
    type Output = Self;

    fn sub(self, seconds: f64) -> Self {
        self + -seconds
    }
}

/// Seconds from the right-hand instant to the left-hand one (s).
impl Sub for GpsTime {
    type Output = f64;

    fn sub(self, earlier: Self) -> f64 {
        seconds(self.0.saturating_sub(earlier.0))
    }
}

fn nanoseconds(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

fn seconds(nanoseconds: i64) -> f64 {
    nanoseconds as f64 * 1e-9
}

/// The time scale of a calendar date.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TimeScale {
    /// GPS time.
    Gps,
    /// Galileo system time; its calendar equals GPS time's.
    Galileo,
    /// BeiDou time, 14 s behind GPS time.
    BeiDou,
    /// QZSS time; its calendar equals GPS time's.
    Qzss,
    /// GLONASS time, UTC(SU) + 3 h.
    Glonass,
    /// Coordinated universal time.
    Utc,
}

/// A calendar date and time of day, in a scale that the caller names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CivilTime {
    /// Year of the proleptic Gregorian calendar.
    pub year: i32,
    /// Month, 1 … 12.
    pub month: u8,
    /// Day of month, from 1.
    pub day: u8,
    /// Hour, 0 … 23.
    pub hour: u8,
    /// Minute, 0 … 59.
    pub minute: u8,
    /// Second, 0 … 59, or 60 in a leap second.
    pub second: u8,
    /// Nanosecond of the second.
    pub nanosecond: u32,
}

impl CivilTime {
    /// Nanoseconds this date would be after 1980-01-06T00:00:00 if no day had a leap second.
    fn ns_since_gps_epoch_label(&self) -> Option<i64> {
        let plausible = (1..=12).contains(&self.month)
            && (1..=days_in_month(self.year, self.month)).contains(&self.day)
            && self.hour < 24
            && self.minute < 60
            && self.second <= 60
            && self.nanosecond < 1_000_000_000
            && (1700..=2260).contains(&self.year);
        plausible.then(|| {
            let days = days_from_civil(self.year, self.month, self.day) - GPS_EPOCH_UNIX_DAYS;
            let of_day = i64::from(self.hour) * HOUR_S
                + i64::from(self.minute) * 60
                + i64::from(self.second);
            (days * DAY_S + of_day) * NS_PER_SECOND + i64::from(self.nanosecond)
        })
    }

    fn from_label(ns: i64) -> Self {
        let seconds = ns.div_euclid(NS_PER_SECOND);
        let (days, of_day) = (seconds.div_euclid(DAY_S), seconds.rem_euclid(DAY_S));
        let (year, month, day) = civil_from_days(days + GPS_EPOCH_UNIX_DAYS);
        Self {
            year,
            month,
            day,
            hour: (of_day / HOUR_S) as u8,
            minute: (of_day / 60 % 60) as u8,
            second: (of_day % 60) as u8,
            nanosecond: ns.rem_euclid(NS_PER_SECOND) as u32,
        }
    }
}

/// Leap seconds between GPS time and UTC: the IERS table, then the broadcast value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeapSeconds {
    /// Broadcast leap seconds, valid after the table's last entry.
    broadcast: Option<i64>,
}

/// First UTC second with this number of leap seconds (year, month, day, leap seconds).
const LEAP_TABLE: [(i32, u8, u8, i64); 18] = [
    (1981, 7, 1, 1),
    (1982, 7, 1, 2),
    (1983, 7, 1, 3),
    (1985, 7, 1, 4),
    (1988, 1, 1, 5),
    (1990, 1, 1, 6),
    (1991, 1, 1, 7),
    (1992, 7, 1, 8),
    (1993, 7, 1, 9),
    (1994, 7, 1, 10),
    (1996, 1, 1, 11),
    (1997, 7, 1, 12),
    (1999, 1, 1, 13),
    (2006, 1, 1, 14),
    (2009, 1, 1, 15),
    (2012, 7, 1, 16),
    (2015, 7, 1, 17),
    (2017, 1, 1, 18),
];

impl LeapSeconds {
    /// The IERS table alone, valid as long as no leap second follows that of 2016-12-31.
    pub const fn table() -> Self {
        Self { broadcast: None }
    }

    /// The IERS table, and a broadcast value for the time after its last entry.
    ///
    /// A value below the table's last one is older than the table and has no effect.
    pub fn with_broadcast(leap_seconds: i64) -> Self {
        let newest = LEAP_TABLE[LEAP_TABLE.len() - 1].3;
        Self { broadcast: (newest < leap_seconds).then_some(leap_seconds) }
    }

    /// GPS time minus UTC at `time` (s).
    pub fn at(&self, time: GpsTime) -> i64 {
        self.lookup(|label_s, before| (label_s + before) * NS_PER_SECOND <= time.0, time.0)
    }

    /// The last entry whose start satisfies `started(start label in s, leap seconds before it)`.
    fn lookup(&self, started: impl Fn(i64, i64) -> bool, ns: i64) -> i64 {
        let mut leap = 0;
        for (index, &(year, month, day, value)) in LEAP_TABLE.iter().enumerate().rev() {
            let days = days_from_civil(year, month, day) - GPS_EPOCH_UNIX_DAYS;
            let before = if index == 0 { 0 } else { LEAP_TABLE[index - 1].3 };
            // The new value holds from one second (the leap second itself) after the old label.
            if started(days * DAY_S, before + 1) {
                leap = value;
                break;
            }
        }
        let newest = LEAP_TABLE[LEAP_TABLE.len() - 1].3;
        match self.broadcast {
            Some(broadcast) if leap == newest && 0 < ns => broadcast,
            _ => leap,
        }
    }

    fn gps_from_utc_label(&self, label: i64) -> GpsTime {
        let leap = self.lookup(|label_s, _| label_s * NS_PER_SECOND <= label, label);
        GpsTime(label + leap * NS_PER_SECOND)
    }

    /// UTC calendar moved `ahead_s` seconds, with second 60 where a leap second is running.
    fn utc_civil(&self, time: GpsTime, ahead_s: i64) -> CivilTime {
        let leap = self.at(time);
        let after = self.at(GpsTime(time.0 + NS_PER_SECOND));
        let inside_leap_second = leap < after;
        let back = leap + i64::from(inside_leap_second);
        let mut civil = CivilTime::from_label(time.0 - (back - ahead_s) * NS_PER_SECOND);
        if inside_leap_second {
            civil.second += 1;
        }
        civil
    }
}

/// Days from 1970-01-01 in the proleptic Gregorian calendar (Hinnant 2013, `days_from_civil`).
fn days_from_civil(year: i32, month: u8, day: u8) -> i64 {
    let shifted_year = i64::from(year) - i64::from(month <= 2);
    let era = shifted_year.div_euclid(400);
    let year_of_era = shifted_year.rem_euclid(400);
    let month_from_march = (i64::from(month) + 9) % 12;
    let day_of_year = (153 * month_from_march + 2) / 5 + i64::from(day) - 1;
    era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468
}

/// Inverse of [`days_from_civil`] (Hinnant 2013, `civil_from_days`).
fn civil_from_days(days: i64) -> (i32, u8, u8) {
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = (day_of_year - (153 * month_from_march + 2) / 5 + 1) as u8;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    (year as i32, month as u8, day)
}

fn days_in_month(year: i32, month: u8) -> u8 {
    match month {
        2 if year % 4 == 0 && (year % 100 != 0 || year % 400 == 0) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

/// Difference of two times of week, wrapped to half a week around zero (s).
///
/// IS-GPS-200N, 20.3.3.4.3.
pub(crate) fn wrap_half_week(seconds: f64) -> f64 {
    seconds - SECONDS_PER_WEEK * (seconds / SECONDS_PER_WEEK).round()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn civil(year: i32, month: u8, day: u8, hour: u8, minute: u8, second: u8) -> CivilTime {
        CivilTime { year, month, day, hour, minute, second, nanosecond: 0 }
    }

    #[test]
    fn a_system_clock_tells_gps_time() {
        // 2018-10-04T12:37:00Z: Thursday of week 2021, 18 leap seconds.
        let expected = GpsTime::from_week_seconds(2021, 4.0 * 86_400.0 + 45_420.0 + 18.0);
        let leap = LeapSeconds::table();
        assert_eq!(GpsTime::from_unix_ms(1_538_656_620_000, &leap), expected);
        assert_eq!(expected.to_unix_ms(&leap), 1_538_656_620_000);
        assert!(GpsTime::from_unix_ms(i64::MAX, &leap) > expected);
    }

    #[test]
    fn calendar_of_the_paper_gives_its_week() {
        let leap = LeapSeconds::table();
        let time =
            GpsTime::from_civil(&civil(2019, 4, 28, 12, 58, 21), TimeScale::Gps, &leap).unwrap();
        assert_eq!((time.week(), time.seconds_of_week()), (2051, 46_701.0));
        assert_eq!(time.to_rfc3339(&leap), "2019-04-28T12:58:03.000Z");
        assert_eq!((time + -2e-7).to_rfc3339(&leap), "2019-04-28T12:58:03.000Z");
        assert_eq!(time.to_string(), "2051:46701.000000000");
    }

    #[test]
    fn beidou_weeks() {
        // BDT zero is 2006-01-01T00:00:00 UTC, 14 s into GPS week 1356 (BDS-SIS-ICD-B1I-3.0, 3.3).
        assert_eq!(GpsTime::from_beidou(0, 0.0), GpsTime::from_week_seconds(1356, 14.0));
        assert_eq!(GpsTime::from_week_seconds(1356, 13.0).to_beidou(), (-1, 604_799.0));
    }

    #[test]
    fn the_leap_second_of_2016_has_a_second_60() {
        let leap = LeapSeconds::table();
        let utc = |c| GpsTime::from_civil(&c, TimeScale::Utc, &leap).unwrap();
        let before = utc(civil(2016, 12, 31, 23, 59, 59));
        let after = utc(civil(2017, 1, 1, 0, 0, 0));
        assert_eq!(after - before, 2.0);
        assert_eq!((leap.at(before), leap.at(before + 1.0), leap.at(after)), (17, 17, 18));
        assert_eq!((before + 1.0).to_rfc3339(&leap), "2016-12-31T23:59:60.000Z");
        assert_eq!((before + 1.999_4).to_rfc3339(&leap), "2016-12-31T23:59:60.999Z");
        for time in [before + 1.999_6, after] {
            assert_eq!(time.to_rfc3339(&leap), "2017-01-01T00:00:00.000Z");
        }
    }

    #[test]
    fn glonass_is_three_hours_ahead_of_utc() {
        let leap = LeapSeconds::table();
        let utc = GpsTime::from_civil(&civil(2021, 1, 1, 0, 0, 0), TimeScale::Utc, &leap);
        let glonass = GpsTime::from_civil(&civil(2021, 1, 1, 3, 0, 0), TimeScale::Glonass, &leap);
        assert_eq!(utc, glonass);
        assert_eq!(utc.unwrap().seconds_of_week() % 60.0, 18.0);
    }

    #[test]
    fn a_broadcast_leap_second_counts_only_beyond_the_table() {
        let time = GpsTime::from_week_seconds(3000, 0.0);
        assert_eq!(LeapSeconds::with_broadcast(19).at(time), 19);
        assert_eq!(LeapSeconds::with_broadcast(17).at(time), 18);
        assert_eq!(LeapSeconds::with_broadcast(19).at(GpsTime::from_week_seconds(1900, 0.0)), 17);
    }

    #[test]
    fn dates_that_do_not_exist_are_refused() {
        let leap = LeapSeconds::table();
        for wrong in [civil(2021, 2, 29, 0, 0, 0), civil(2021, 13, 1, 0, 0, 0)] {
            assert_eq!(GpsTime::from_civil(&wrong, TimeScale::Gps, &leap), None);
        }
        assert_eq!(GpsTime::from_week_ns(2000, NS_PER_WEEK), None);
    }

    proptest! {
        /// Calendar and GPS time undo one another in every scale, outside leap seconds.
        #[test]
        fn civil_round_trip(seconds in 0_i64..2_500_000_000, scale in 0_usize..6) {
            let scale = [
                TimeScale::Gps, TimeScale::Galileo, TimeScale::BeiDou, TimeScale::Qzss,
                TimeScale::Glonass, TimeScale::Utc,
            ][scale];
            let leap = LeapSeconds::table();
            let time = GpsTime::from_ns(seconds * NS_PER_SECOND + 123);
            let civil = time.to_civil(scale, &leap);
            prop_assume!(civil.second < 60);
            prop_assert_eq!(GpsTime::from_civil(&civil, scale, &leap), Some(time));
        }
    }
}
