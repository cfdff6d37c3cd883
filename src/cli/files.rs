//! The files that commands read, and the arguments that date them.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::str::FromStr;

use clap::Args;

use crate::formats::receiver::TimeReference;
use crate::gnss::{CivilTime, GpsTime, LeapSeconds, TimeScale};
use crate::recording::{Input, RecordingError};
use crate::refusal::Code;

use super::Failure;

const READ_BUFFER_BYTES: usize = 1 << 16;
/// Middle of a week (s).
const HALF_WEEK_S: f64 = 302_400.0;

/// The arguments that date receiver data without a GPS week.
#[derive(Clone, Debug, Args)]
pub(crate) struct TimeArguments {
    /// GPS week of RTCM 3 data, which do not contain it. Default: from the navigation data.
    #[arg(long, value_name = "WEEK", conflicts_with = "start_time", value_parser = weeks())]
    week: Option<i64>,
    /// Approximate start of RTCM 3 data, GPS time, within half a day: 2019-03-24T12:00:00.
    #[arg(long, value_name = "TIME")]
    start_time: Option<StartTime>,
}

fn weeks() -> clap::builder::RangedI64ValueParser {
    clap::value_parser!(i64).range(0..=9999)
}

/// A calendar date and time of day, GPS time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StartTime(pub(crate) GpsTime);

impl FromStr for StartTime {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (date, time) = text.trim().trim_end_matches('Z').split_once(['T', ' '])?;
            let mut date = date.split('-');
            let mut time = time.split(':');
            let civil = CivilTime {
                year: date.next()?.parse().ok()?,
                month: date.next()?.parse().ok()?,
                day: date.next()?.parse().ok()?,
                hour: time.next()?.parse().ok()?,
                minute: time.next()?.parse().ok()?,
                second: time.next().unwrap_or("0").parse().ok()?,
                nanosecond: 0,
            };
            let is_whole = date.next().is_none() && time.next().is_none();
            GpsTime::from_civil(&civil, TimeScale::Gps, &LeapSeconds::table()).filter(|_| is_whole)
        };
        parse().map(Self).ok_or_else(|| "expected a time such as 2019-03-24T12:00:00".to_owned())
    }
}

impl TimeArguments {
    /// The reference time from the arguments.
    pub(crate) fn reference(&self) -> Option<TimeReference> {
        let middle = |week: i64| {
            let week = i32::try_from(week).expect("the parser bounds it");
            TimeReference::Week(GpsTime::from_week_seconds(week, HALF_WEEK_S))
        };
        let start = self.start_time.map(|StartTime(time)| TimeReference::Day(time));
        start.or_else(|| self.week.map(middle))
    }
}

/// A file as an input, opened where it is read.
pub(crate) fn input(path: &Path) -> Input {
    let file = path.to_owned();
    Input::new(path.display().to_string(), move || {
        Ok(Box::new(BufReader::with_capacity(READ_BUFFER_BYTES, File::open(&file)?)))
    })
}

impl From<RecordingError> for Failure {
    fn from(error: RecordingError) -> Self {
        let (code, remedy) = match &error {
            RecordingError::NotReadable { .. } => return Self::of(Code::FileNotReadable, &error),
            RecordingError::NotUnderstood { remedy, .. } => (Code::FileNotUnderstood, *remedy),
            RecordingError::NoReferenceTime { .. } => {
                return Self::of(Code::NoReferenceTime, &error);
            }
            RecordingError::NavigationRequired { .. } => {
                (Code::NavigationRequired, "add --nav FILE: RINEX navigation data of that day")
            }
            RecordingError::BasePositionMissing { .. } => {
                (Code::BasePositionMissing, "give --base-position X,Y,Z")
            }
            RecordingError::BaseRequired { .. } => (Code::Usage, "add --base FILE"),
            RecordingError::FrameUnavailable { .. } => {
                let remedy = "state the base's frame, as by --base-frame ETRF2000";
                (Code::FrameUnavailable, remedy)
            }
            RecordingError::NoSuchAnswer { .. } => {
                (Code::Usage, "name a mode with a window, as fgo")
            }
            RecordingError::NoEpochs { .. } => (Code::NoEpochs, "check --from and --to"),
        };
        Self::new(code, &error, remedy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn start_times_as_users_write_them() {
        let time = StartTime(GpsTime::from_week_seconds(2046, 43_200.0));
        for text in ["2019-03-24T12:00:00", "2019-03-24 12:00", "2019-03-24T12:00:00Z"] {
            assert_eq!(text.parse(), Ok(time), "{text}");
        }
        for wrong in ["", "2019-03-24", "2019-02-30T12:00:00", "2019-03-24T12", "x"] {
            assert!(wrong.parse::<StartTime>().is_err(), "{wrong}");
        }
    }
}
