//! The files that commands read: opened, recognised by their content, and dated.

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use nalgebra::Vector3;

use crate::formats::decompress;
use crate::formats::observations::{
    FileError, LeftOut, Observations, Recognised, first_time, read_navigation, station,
};
use crate::formats::receiver::TimeReference;
use crate::gnss::{
    CivilTime, Ecef, Enu, Ephemeris, GpsTime, LeapSeconds, LocalFrame, Navigation, PositionSource,
    TimeScale,
};

use super::Failure;

const READ_BUFFER_BYTES: usize = 1 << 16;
/// Middle of a week (s).
const HALF_WEEK_S: f64 = 302_400.0;

/// A file of observations.
pub(crate) type ObservationFile = Observations<Box<dyn BufRead>>;

/// The arguments that date receiver data which do not tell their week.
#[derive(Clone, Debug, Args)]
pub(crate) struct TimeArguments {
    /// GPS week of RTCM 3 files, which do not tell it; else the navigation data must.
    #[arg(long, value_name = "WEEK", conflicts_with = "start_time", value_parser = weeks())]
    week: Option<i64>,
    /// About when RTCM 3 files begin, GPS time, within half a day: 2019-03-24T12:00:00.
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
    fn reference(&self) -> Option<TimeReference> {
        let middle = |week: i64| {
            let week = i32::try_from(week).expect("the parser bounds it");
            TimeReference::Week(GpsTime::from_week_seconds(week, HALF_WEEK_S))
        };
        let start = self.start_time.map(|StartTime(time)| TimeReference::Day(time));
        start.or_else(|| self.week.map(middle))
    }
}

/// Opens a file, unpacked where it is gzip.
pub(crate) fn open_plain(path: &Path) -> Result<Box<dyn BufRead>, Failure> {
    let file = File::open(path).map_err(|error| {
        let message = format!("cannot open {}: {error}", path.display());
        Failure::new("FILE_NOT_READABLE", message, "check the path and its rights")
    })?;
    Ok(Box::new(decompress(BufReader::with_capacity(READ_BUFFER_BYTES, file))))
}

fn open(path: &Path) -> Result<Recognised<Box<dyn BufRead>>, Failure> {
    open_plain(path).map(Recognised::new)
}

/// Whether a file holds the bytes of a receiver.
pub(crate) fn is_receiver_data(path: &Path) -> Result<bool, Failure> {
    Ok(open(path)?.is_receiver_data())
}

/// What dates the receiver data of a recording, whose files are of one time.
pub(crate) struct Dating {
    /// As asked for.
    asked: Option<TimeReference>,
    /// From the navigation data, or from another file.
    found: Option<TimeReference>,
}

impl Dating {
    /// The reference of a file: its own time, else the one asked for, else the recording's.
    fn of(&self, path: &Path) -> Result<Option<TimeReference>, Failure> {
        let own = first_time(open(path)?).map_err(|error| unreadable(path, &error, REPAIR))?;
        Ok(own.map(TimeReference::Day).or(self.asked).or(self.found))
    }
}

/// What was left out, by file.
pub(crate) type LeftOutOf<'a> = Vec<(&'a Path, LeftOut)>;

/// Reads navigation data of several files; what was left out, by file; and what dates the rest.
pub(crate) fn navigation<'a>(
    paths: &'a [PathBuf],
    observations: &[&Path],
    times: &TimeArguments,
) -> Result<(Navigation, LeftOutOf<'a>, Dating), Failure> {
    let mut dating = Dating { asked: times.reference(), found: None };
    for path in observations {
        if dating.found.is_none()
            && let Some(TimeReference::Day(time)) = dating.of(path)?
        {
            dating.found = Some(TimeReference::Week(time));
        }
    }
    let mut navigation = Navigation::default();
    let mut left_out = Vec::new();
    let mut undated = Vec::new();
    for path in paths {
        let is_receiver_data = open(path)?.is_receiver_data();
        let reference = if is_receiver_data { dating.of(path)? } else { None };
        if is_receiver_data && reference.is_none() {
            undated.push(path);
        }
        let (read, left) = read(path, reference)?;
        navigation.merge(read);
        left_out.push((path.as_path(), left));
    }
    dating.found = dating.found.or_else(|| middle_toe(&navigation).map(TimeReference::Week));
    // Some ephemerides tell their week in full: they date those that do not.
    for path in undated {
        let Some(reference) = dating.found else { return Err(undatable(path)) };
        let (read, left) = read(path, Some(reference))?;
        navigation.merge(read);
        left_out.retain(|(other, _)| *other != path.as_path());
        left_out.push((path.as_path(), left));
    }
    Ok((navigation, left_out, dating))
}

fn read(path: &Path, reference: Option<TimeReference>) -> Result<(Navigation, LeftOut), Failure> {
    let remedy = "name a RINEX navigation file, or receiver data with ephemerides";
    read_navigation(open(path)?, reference).map_err(|error| unreadable(path, &error, remedy))
}

/// The middle one of all times of ephemeris: old ones of single satellites do not move it.
fn middle_toe(navigation: &Navigation) -> Option<GpsTime> {
    let mut times: Vec<GpsTime> =
        navigation.satellites().flat_map(|(_, list)| list.iter().map(Ephemeris::toe)).collect();
    times.sort_unstable();
    times.get(times.len() / 2).copied()
}

/// Opens a file of observations.
pub(crate) fn observations(
    path: &Path,
    dating: &Dating,
    navigation: &Navigation,
) -> Result<ObservationFile, Failure> {
    let file = open(path)?;
    let mut reference = None;
    if file.is_receiver_data() {
        reference = dating.of(path)?;
        if reference.is_none() {
            return Err(undatable(path));
        }
    }
    let remedy = "name a RINEX observation file, or UBX or RTCM 3 data";
    Observations::new(file, reference, navigation).map_err(|error| unreadable(path, &error, remedy))
}

/// Where a receiver's antenna is, as far as its file tells.
pub(crate) struct Site {
    pub(crate) name: String,
    /// Type and radome, empty where not told.
    pub(crate) antenna: String,
    pub(crate) marker: Option<Ecef>,
    /// What tells the marker's position, where anything does.
    pub(crate) source: PositionSource,
    /// Antenna reference point above, east and north of the marker (m).
    pub(crate) antenna_hen_m: [f64; 3],
}

/// What an open file tells of its site: its header, or its messages 1005 to 1008 and 1033.
pub(crate) fn site(path: &Path, file: &ObservationFile) -> Result<Site, Failure> {
    if let Observations::Rinex(reader) = file {
        let header = reader.header();
        return Ok(Site {
            name: header.marker.clone(),
            antenna: header.antenna.clone(),
            marker: header.approximate_position,
            source: PositionSource::Header,
            antenna_hen_m: header.antenna_delta_hen_m,
        });
    }
    let station =
        station(open(path)?).map_err(|error| unreadable(path, &error, REPAIR))?.unwrap_or_default();
    // The messages tell the antenna reference point and its height above the marker.
    let height_m = station.antenna_height_m.unwrap_or(0.0);
    let below = Enu(Vector3::new(0.0, 0.0, -height_m));
    let point = station.antenna_reference_point;
    Ok(Site {
        name: station.id.to_string(),
        antenna: station.antenna,
        marker: point.map(|point| LocalFrame::at(point).to_ecef(below)),
        source: PositionSource::Message,
        antenna_hen_m: [height_m, 0.0, 0.0],
    })
}

const REPAIR: &str = "repair or cut the file at that place";

/// The refusal of a file that cannot be read on.
pub(crate) fn broken(path: &Path, error: &FileError) -> Failure {
    unreadable(path, error, REPAIR)
}

fn undatable(path: &Path) -> Failure {
    let message = format!("nothing tells the GPS week of {}", path.display());
    let remedy = "add --week WEEK or --start-time TIME";
    Failure::new("NO_REFERENCE_TIME", message, remedy)
}

/// The refusal of a file that is not what it should be.
pub(crate) fn unreadable(path: &Path, error: &dyn fmt::Display, remedy: &str) -> Failure {
    Failure::new("FILE_NOT_UNDERSTOOD", format!("{}: {error}", path.display()), remedy)
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
