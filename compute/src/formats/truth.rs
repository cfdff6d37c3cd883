//! Reference trajectories as CSV: `gps_week,tow,lat_deg,lon_deg,height_m` or
//! `gps_week,tow,x_m,y_m,z_m`.
//!
//! Lines that start with `#` or `%` and one title line are skipped, further columns are ignored.
//! Week −1 means an unknown week, which the caller gives.

use std::io::{self, BufRead, Write};

use nalgebra::Vector3;

use super::decimal::{push_fixed, push_integer, push_seconds};
use crate::gnss::{Ecef, Geodetic, GpsTime};

/// Coordinates above this are metres from the Earth's centre, not degrees.
const LARGEST_ANGLE: f64 = 1000.0;
const LARGEST_WEEK: f64 = 9999.0;

/// The true antenna position at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthRow {
    /// GPS time of the position.
    pub time: GpsTime,
    /// True antenna position, ECEF (m).
    pub position: Ecef,
}

/// Why a truth file is refused.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The input cannot be read.
    #[error("reading failed: {0}")]
    Read(#[from] io::Error),
    /// A line does not begin with five numbers.
    #[error("line {line}: {text:?} does not begin with five numbers")]
    Malformed {
        /// Number of the line, from 1.
        line: usize,
        /// Text of the line.
        text: String,
    },
    /// The first column is not a GPS week.
    #[error("line {line}: column 1 is not a GPS week ({value}); use -1 if it is unknown")]
    NoWeek {
        /// Number of the line, from 1.
        line: usize,
        /// Value of the first column.
        value: f64,
    },
    /// The file has no rows.
    #[error("the file has no rows")]
    Empty,
}

/// Reads a truth file in its order; rows of week −1 get the week `unknown_week`.
///
/// ```
/// let file = "gps_week,tow,lat_deg,lon_deg,height_m\n-1,46701.0,22.3,114.2,5.0\n";
/// let rows = graphfix_compute::formats::truth::read(file.as_bytes(), 2051)?;
/// assert_eq!((rows[0].time.week(), rows[0].time.seconds_of_week()), (2051, 46_701.0));
/// # Ok::<(), graphfix_compute::formats::truth::TruthError>(())
/// ```
pub fn read(mut input: impl BufRead, unknown_week: i32) -> Result<Vec<TruthRow>, TruthError> {
    let (mut rows, mut is_ecef, mut titled) = (Vec::new(), None, false);
    let (mut bytes, mut number) = (Vec::new(), 0);
    loop {
        bytes.clear();
        if input.read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
        number += 1;
        let text = String::from_utf8_lossy(&bytes);
        let line = text.trim().trim_start_matches('\u{feff}');
        if line.is_empty() || line.starts_with(['#', '%']) {
            continue;
        }
        let Some(values) = read_numbers(line) else {
            if titled || !rows.is_empty() {
                return Err(TruthError::Malformed { line: number, text: line.to_owned() });
            }
            titled = true;
            is_ecef = coordinates_of_titles(line);
            continue;
        };
        if !(-LARGEST_WEEK..=LARGEST_WEEK).contains(&values[0]) {
            return Err(TruthError::NoWeek { line: number, value: values[0] });
        }
        let is_ecef = *is_ecef.get_or_insert(LARGEST_ANGLE < values[2].abs());
        rows.push(row_of(&values, is_ecef, unknown_week));
    }
    if rows.is_empty() { Err(TruthError::Empty) } else { Ok(rows) }
}

fn read_numbers(line: &str) -> Option<[f64; 5]> {
    let mut fields = line.split([',', ';']);
    let mut values = [0.0; 5];
    for value in &mut values {
        *value = fields.next()?.trim().parse().ok().filter(|value: &f64| value.is_finite())?;
    }
    Some(values)
}

/// Whether a title line names ECEF coordinates; `None` if it names no coordinates.
fn coordinates_of_titles(line: &str) -> Option<bool> {
    let low = line.to_lowercase();
    let mut names = low.split([',', ';']).map(str::trim);
    if names.clone().any(|name| matches!(name, "x" | "x_m" | "ecef_x" | "x_ecef")) {
        return Some(true);
    }
    names.any(|name| name.starts_with("lat")).then_some(false)
}

fn row_of(values: &[f64; 5], is_ecef: bool, unknown_week: i32) -> TruthRow {
    let week = if values[0] < 0.0 { unknown_week } else { values[0] as i32 };
    let position = match is_ecef {
        true => Ecef(Vector3::new(values[2], values[3], values[4])),
        false => Geodetic::from_degrees(values[2], values[3], values[4]).to_ecef(),
    };
    TruthRow { time: GpsTime::from_week_seconds(week, values[1]), position }
}

/// Writes a truth file in ECEF, to a hundredth of a millimetre.
pub fn write(mut output: impl Write, rows: &[TruthRow]) -> io::Result<()> {
    writeln!(output, "gps_week,tow,x_m,y_m,z_m")?;
    let mut line = Vec::new();
    for row in rows {
        line.clear();
        push_integer(&mut line, i64::from(row.time.week()), 0);
        line.push(b',');
        push_seconds(&mut line, row.time.ns_of_week(), 3, 0);
        for value in row.position.0.iter() {
            line.push(b',');
            push_fixed(&mut line, *value, 5, 0);
        }
        line.push(b'\n');
        output.write_all(&line)?;
    }
    output.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn titles_magnitude_and_unknown_weeks() {
        let degrees = "# note\ngps_week,tow,lat_deg,lon_deg,height_m\n-1,46701.0,0.0,90.0,1.0,x\n";
        let rows = read(degrees.as_bytes(), 2051).unwrap();
        assert_eq!(rows[0].time, GpsTime::from_week_seconds(2051, 46_701.0));
        assert!(rows[0].position.distance_m(Ecef::new(0.0, 6_378_138.0, 0.0)) < 1e-6);
        let metres = "2051;46701.5;-2414266.9;5386768.9;2407460.0\n";
        let rows = read(metres.as_bytes(), 0).unwrap();
        assert_eq!(rows[0].position, Ecef::new(-2_414_266.9, 5_386_768.9, 2_407_460.0));
    }

    #[test]
    fn what_cannot_be_read_is_refused_with_its_line() {
        let late_title = "2051,1.0,1,2,3\nweek,tow\n";
        assert!(matches!(
            read(late_title.as_bytes(), 0),
            Err(TruthError::Malformed { line: 2, .. })
        ));
        let unix_time = "1556456301,1.0,1,2,3\n";
        assert!(matches!(read(unix_time.as_bytes(), 0), Err(TruthError::NoWeek { line: 1, .. })));
        assert!(matches!(read("a,b\n".as_bytes(), 0), Err(TruthError::Empty)));
    }

    #[test]
    fn what_is_written_reads_back() {
        let position = Ecef::new(-2_414_266.9, 5_386_768.912_34, 2_407_460.0);
        let rows = [TruthRow { time: GpsTime::from_week_seconds(2300, 0.25), position }];
        let mut text = Vec::new();
        write(&mut text, &rows).unwrap();
        assert_eq!(read(&text[..], 0).unwrap(), rows);
    }
}
