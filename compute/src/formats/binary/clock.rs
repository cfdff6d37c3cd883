//! Completes truncated times.
//!
//! RTCM 3 gives milliseconds of the week or of the GLONASS day, broadcast messages give weeks
//! modulo 1024. The missing part is that nearest to the newest known time; each decoded epoch
//! becomes the newest.

use super::Refusal;
use crate::gnss::constants::{
    GLONASS_AHEAD_OF_UTC_S, NS_PER_SECOND, SECONDS_PER_DAY, SECONDS_PER_WEEK,
};
use crate::gnss::{GpsTime, LeapSeconds};

const NS_PER_MS: i64 = NS_PER_SECOND / 1000;
const NS_PER_DAY: i64 = SECONDS_PER_DAY as i64 * NS_PER_SECOND;
const NS_PER_WEEK: i64 = SECONDS_PER_WEEK as i64 * NS_PER_SECOND;
const MS_PER_WEEK: u64 = SECONDS_PER_WEEK as u64 * 1000;
/// Milliseconds of a GLONASS day, with a leap second (RTCM 10403.3, DF034).
const MS_PER_GLONASS_DAY: u64 = 86_401_000;
/// Days from 1980-01-06, the GPS epoch, to 1996-01-01, the GLONASS epoch.
const GLONASS_FIRST_DAY: i64 = 5839;
/// Valid GPS weeks, up to the year 2171. Damaged messages cannot produce times near the limits of
/// the type.
const WEEKS: std::ops::RangeInclusive<i32> = 0..=9999;
const GLONASS_AHEAD_OF_UTC_NS: i64 = GLONASS_AHEAD_OF_UTC_S as i64 * NS_PER_SECOND;

/// A known time that completes the truncated times of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeReference {
    /// A time within half a week of the stream's first message.
    Week(GpsTime),
    /// A time within half a day of the stream's first message.
    Day(GpsTime),
}

/// The newest known time of a stream.
#[derive(Clone, Debug)]
pub(in crate::formats) struct Clock {
    newest: Option<TimeReference>,
    leap_seconds: LeapSeconds,
}

impl Clock {
    /// A clock with the reference, if there is one and its week is valid.
    pub(in crate::formats) fn new(reference: Option<TimeReference>) -> Self {
        let newest = reference.filter(|reference| match reference {
            TimeReference::Week(time) | TimeReference::Day(time) => WEEKS.contains(&time.week()),
        });
        Self { newest, leap_seconds: LeapSeconds::table() }
    }

    /// Sets the newest known time, unless its week is invalid.
    pub(in crate::formats) fn set(&mut self, time: GpsTime) {
        if WEEKS.contains(&time.week()) {
            self.newest = Some(TimeReference::Day(time));
        }
    }

    pub(in crate::formats) const fn set_leap_seconds(&mut self, leap_seconds: LeapSeconds) {
        self.leap_seconds = leap_seconds;
    }

    pub(in crate::formats) const fn leap_seconds(&self) -> &LeapSeconds {
        &self.leap_seconds
    }

    /// The newest known time, if any.
    pub(in crate::formats) const fn time(&self) -> Option<GpsTime> {
        match self.newest {
            Some(TimeReference::Week(time) | TimeReference::Day(time)) => Some(time),
            None => None,
        }
    }

    /// The newest known time, if its day is certain.
    const fn day(&self) -> Option<GpsTime> {
        match self.newest {
            Some(TimeReference::Day(time)) => Some(time),
            _ => None,
        }
    }

    /// The instant with this millisecond of the GPS week.
    pub(in crate::formats) fn of_week(&self, ms: u64) -> Result<GpsTime, Refusal> {
        if MS_PER_WEEK <= ms {
            return Err(Refusal::InvalidTime);
        }
        let near = self.time().ok_or(Refusal::NoReferenceTime)?;
        Ok(nearest(near, near.as_ns(), ms as i64 * NS_PER_MS, NS_PER_WEEK))
    }

    /// The instant with this millisecond of the GLONASS day; `day_of_week` counts from Sunday.
    pub(in crate::formats) fn of_glonass_day(
        &self,
        ms: u64,
        day_of_week: Option<u64>,
    ) -> Result<GpsTime, Refusal> {
        if MS_PER_GLONASS_DAY <= ms {
            return Err(Refusal::InvalidTime);
        }
        let of_day_ns = ms as i64 * NS_PER_MS;
        match (self.day(), self.time(), day_of_week) {
            (Some(near), ..) => Ok(self.nearest_glonass(near, of_day_ns, NS_PER_DAY)),
            (None, Some(near), Some(day)) => {
                let of_week_ns = day as i64 * NS_PER_DAY + of_day_ns;
                Ok(self.nearest_glonass(near, of_week_ns, NS_PER_WEEK))
            }
            _ => Err(Refusal::NoReferenceTime),
        }
    }

    /// The instant nearest to `near` whose GLONASS calendar is `target_ns` into a period.
    fn nearest_glonass(&self, near: GpsTime, target_ns: i64, period_ns: i64) -> GpsTime {
        let seconds_ns = 1_000 * NS_PER_MS;
        let label = |leap: i64| near.as_ns() - leap * seconds_ns + GLONASS_AHEAD_OF_UTC_NS;
        let leap = self.leap_seconds.at(near);
        let found = nearest(near, label(leap), target_ns, period_ns);
        // On the other side of a leap second its other value is in force.
        let leap_there = self.leap_seconds.at(found);
        if leap_there == leap {
            found
        } else {
            nearest(near, label(leap_there), target_ns, period_ns)
        }
    }

    /// The instant of a GLONASS date: four-year interval since 1996 (from 1), day in it (from 1),
    /// second of the day; GLONASS ICD 5.1, 4.4 and table 4.6.
    pub(in crate::formats) fn of_glonass_date(
        &self,
        four_years: i64,
        day: i64,
        second: i64,
    ) -> GpsTime {
        let days = GLONASS_FIRST_DAY + (four_years - 1) * 1461 + day - 1;
        let label = days * NS_PER_DAY + second * 1_000 * NS_PER_MS - GLONASS_AHEAD_OF_UTC_NS;
        let leap = |near_ns| self.leap_seconds.at(GpsTime::from_ns(near_ns)) * 1_000 * NS_PER_MS;
        // The leap seconds at the label equal those at the instant, except within a leap second.
        GpsTime::from_ns(label + leap(label + leap(label)))
    }

    /// The week nearest to the clock's that equals `truncated` modulo `modulus`.
    pub(in crate::formats) fn week(&self, truncated: u64, modulus: i32) -> Result<i32, Refusal> {
        let near = self.time().ok_or(Refusal::NoReferenceTime)?.week();
        let ahead = (truncated as i32 - near).rem_euclid(modulus);
        Ok(near + if modulus / 2 < ahead { ahead - modulus } else { ahead })
    }
}

/// The instant nearest to `near` whose label is `target_ns` into a period; `near` has `label_ns`.
fn nearest(near: GpsTime, label_ns: i64, target_ns: i64, period_ns: i64) -> GpsTime {
    let ahead_ns = (target_ns - label_ns).rem_euclid(period_ns);
    let back_ns = if period_ns / 2 < ahead_ns { period_ns } else { 0 };
    GpsTime::from_ns(near.as_ns() + ahead_ns - back_ns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{CivilTime, TimeScale};

    fn glonass(year: i32, month: u8, day: u8, hour: u8, minute: u8, second: u8) -> GpsTime {
        let civil = CivilTime { year, month, day, hour, minute, second, nanosecond: 0 };
        GpsTime::from_civil(&civil, TimeScale::Glonass, &LeapSeconds::table()).unwrap()
    }

    #[test]
    fn weeks_roll_over() {
        let end = GpsTime::from_week_seconds(2100, 604_799.0);
        let mut clock = Clock::new(Some(TimeReference::Week(end)));
        assert_eq!(clock.of_week(500), Ok(end + 1.5));
        clock.set(end + 1.5);
        assert_eq!(clock.of_week(604_799_900), Ok(end + 0.9));
        assert_eq!(clock.of_week(604_800_000), Err(Refusal::InvalidTime));
        assert_eq!(Clock::new(None).of_week(0), Err(Refusal::NoReferenceTime));
    }

    #[test]
    fn glonass_days_roll_over_at_21_utc() {
        let midnight = glonass(2021, 3, 4, 0, 0, 0);
        let mut clock = Clock::new(Some(TimeReference::Day(midnight - 0.5)));
        assert_eq!(clock.of_glonass_day(250, None), Ok(midnight + 0.25));
        clock.set(midnight + 1.0);
        assert_eq!(clock.of_glonass_day(86_399_000, None), Ok(midnight - 1.0));
    }

    #[test]
    fn a_week_alone_needs_the_day_of_the_week() {
        let thursday = glonass(2021, 3, 4, 12, 0, 0);
        let clock = Clock::new(Some(TimeReference::Week(thursday)));
        let monday = glonass(2021, 3, 1, 7, 0, 0);
        assert_eq!(clock.of_glonass_day(7 * 3_600_000, Some(1)), Ok(monday));
        assert_eq!(clock.of_glonass_day(0, None), Err(Refusal::NoReferenceTime));
    }

    #[test]
    fn the_leap_second_of_2016_is_counted() {
        // 2017-01-01T00:00:00 UTC is 03:00 GLONASS time; the second before it is 02:59:60.
        let after = glonass(2017, 1, 1, 3, 0, 0);
        let clock = Clock::new(Some(TimeReference::Day(after - 2.0)));
        assert_eq!(clock.of_glonass_day(3 * 3_600_000 - 1_000, None), Ok(after - 2.0));
        assert_eq!(clock.of_glonass_day(3 * 3_600_000 + 1_000, None), Ok(after + 1.0));
    }

    #[test]
    fn absurd_times_are_not_taken_over() {
        let mut clock = Clock::new(Some(TimeReference::Day(GpsTime::from_ns(i64::MAX))));
        clock.set(GpsTime::from_ns(i64::MIN));
        assert_eq!(clock.time(), None);
    }

    #[test]
    fn glonass_dates() {
        let clock = Clock::new(None);
        // 2021-03-04 is day 429 of the four years from 2020, the seventh since 1996.
        assert_eq!(clock.of_glonass_date(7, 366 + 31 + 28 + 4, 600), glonass(2021, 3, 4, 0, 10, 0));
        assert_eq!(clock.of_glonass_date(1, 1, 0), glonass(1996, 1, 1, 0, 0, 0));
    }

    #[test]
    fn truncated_weeks_are_the_nearest() {
        let at =
            |week| Clock::new(Some(TimeReference::Week(GpsTime::from_week_seconds(week, 0.0))));
        assert_eq!(at(2048).week(1023, 1024), Ok(2047));
        assert_eq!(at(2047).week(0, 1024), Ok(2048));
        assert_eq!(at(1800).week(776, 1024), Ok(1800));
    }
}
