//! RTKLIB solution files (`.pos`), written and read.
//!
//! A row is time, three coordinates, quality Q, satellites, six standard deviations, age and ratio
//! (RTKLIB manual, "Positioning Solution File"). Off-diagonal "standard deviations" are
//! sign(c)·√|c| of the covariance c. Graphfix writes latitude, longitude and ellipsoidal height
//! with GPS week and seconds of week; it reads these, calendar dates and ECEF coordinates.

use std::io::{self, BufRead};

use nalgebra::{Matrix3, Vector3};

use super::decimal::{push_fixed, push_integer, push_seconds};
use super::encoder::{Encoder, Revision};
use crate::gnss::{
    CivilTime, Ecef, Geodetic, GpsTime, LeapSeconds, LocalFrame, Presented, Solution, Status,
    TimeScale,
};

const COLUMNS: &str = "%  GPST          latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   \
     sde(m)   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio";
const CONVENTIONS: &str = "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,\
     5:single,6:ppp,ns=# of satellites)";
/// Coordinates above this are metres from the Earth's centre, not degrees.
const LARGEST_ANGLE: f64 = 1000.0;
/// Larger ratios are written as this, as RTKLIB does, to fit their column.
const RATIO_MAX: f64 = 999.9;

/// RTKLIB's quality number of a status; `None` for a status without row.
pub(crate) const fn quality(status: Status) -> Option<u8> {
    match status {
        Status::None => None,
        Status::Single | Status::Ekf | Status::Fgo => Some(5),
        Status::Float => Some(2),
        Status::Fixed => Some(1),
    }
}

/// Writes `.pos` rows with the receiver's time tag; none for a solution without position.
pub(super) struct Rows {
    /// Lines of the header before the column titles.
    pub(super) comments: Vec<String>,
}

impl Encoder for Rows {
    fn begin(&mut self, out: &mut Vec<u8>) {
        for comment in &self.comments {
            out.extend_from_slice(format!("% {comment}\n").as_bytes());
        }
        out.extend_from_slice(format!("%\n{CONVENTIONS}\n{COLUMNS}\n").as_bytes());
    }

    fn push(&mut self, presented: &Presented<'_>, _: Option<Revision>, line: &mut Vec<u8>) {
        let solution = &presented.solution;
        let (Some(quality), Some(estimate)) = (quality(solution.status), &solution.estimate) else {
            return;
        };
        push_integer(line, i64::from(solution.time.week()), 4);
        line.push(b' ');
        push_seconds(line, solution.time.ns_of_week(), 3, 10);
        let geodetic = estimate.position.to_geodetic();
        push_column(line, geodetic.latitude_rad.to_degrees(), 9, 14);
        push_column(line, geodetic.longitude_rad.to_degrees(), 9, 14);
        push_column(line, geodetic.height_m, 4, 10);
        line.push(b' ');
        push_integer(line, i64::from(quality), 3);
        line.push(b' ');
        push_integer(line, estimate.satellites_used.len() as i64, 3);
        let enu = LocalFrame::at(estimate.position).covariance_to_enu(&estimate.covariance);
        for (row, column) in [(1, 1), (0, 0), (2, 2), (0, 1), (0, 2), (1, 2)] {
            push_column(line, signed_root(enu[(row, column)]), 4, 8);
        }
        let relative = estimate.relative.as_ref();
        let ratio = relative.and_then(|relative| relative.ratio).unwrap_or(0.0);
        push_column(line, relative.map_or(0.0, |relative| relative.age_s), 2, 6);
        push_column(line, ratio.min(RATIO_MAX), 1, 6);
        line.push(b'\n');
    }

    fn finish(&mut self, _: &mut Vec<u8>) {}
}

/// Appends a blank and a number.
fn push_column(line: &mut Vec<u8>, value: f64, decimals: usize, width: usize) {
    line.push(b' ');
    push_fixed(line, value, decimals, width);
}

/// sign(c)·√|c|: RTKLIB's text of a covariance c.
fn signed_root(covariance: f64) -> f64 {
    covariance.abs().sqrt().copysign(covariance)
}

/// One row of a solution file.
#[derive(Clone, Debug, PartialEq)]
pub struct PosRow {
    /// GPS time of the row.
    pub time: GpsTime,
    /// Position, ECEF (m).
    pub position: Ecef,
    /// RTKLIB's quality number: 1 fixed, 2 float, 5 single, …
    pub quality: i64,
    /// Number of satellites, if the row has it.
    pub satellites: Option<u32>,
    /// ECEF covariance, 3×3 (m²), if the row has standard deviations.
    pub covariance: Option<Matrix3<f64>>,
}

impl PosRow {
    /// The row of a solution, with all digits; `None` without a position.
    pub(crate) fn of(solution: &Solution) -> Option<Self> {
        let estimate = solution.estimate.as_ref()?;
        Some(Self {
            time: solution.time,
            position: estimate.position,
            quality: i64::from(quality(solution.status)?),
            satellites: u32::try_from(estimate.satellites_used.len()).ok(),
            covariance: Some(estimate.covariance),
        })
    }
}

/// The content of a solution file.
#[derive(Clone, Debug, PartialEq)]
pub struct PosFile {
    /// The readable rows, in the file's order.
    pub rows: Vec<PosRow>,
    /// Numbers (from 1) of the lines that were left out because they cannot be read.
    pub unreadable: Vec<usize>,
}

/// Why a solution file is refused.
#[derive(Debug, thiserror::Error)]
pub enum PosError {
    /// The input cannot be read.
    #[error("reading failed: {0}")]
    Read(#[from] io::Error),
    /// The kind of coordinates or times is not supported.
    #[error("line {line}: {what} is not supported")]
    Unsupported {
        /// Number of the line, from 1.
        line: usize,
        /// Name of the coordinates or times.
        what: &'static str,
    },
}

/// The kind of coordinates, from the header or else from the first row.
#[derive(Clone, Copy, PartialEq)]
enum Coordinates {
    Unknown,
    Degrees,
    Ecef,
}

/// Reads a solution file; rows that cannot be read are left out and listed.
///
/// # Errors
/// Baselines, degrees with minutes, heights above the geoid and times other than GPS time are
/// refused, since they would be evaluated wrongly.
///
/// # Example
/// ```
/// let file = "%  GPST  latitude(deg) longitude(deg)  height(m)  Q\n\
///     2051  46700.997  22.301234500 114.179012300  10.2500  1\n";
/// let solutions = graphfix_compute::formats::pos::read(file.as_bytes())?;
/// let position = solutions.rows[0].position.to_geodetic();
/// assert!((position.height_m - 10.25).abs() < 1e-6);
/// # Ok::<(), graphfix_compute::formats::pos::PosError>(())
/// ```
pub fn read(mut input: impl BufRead) -> Result<PosFile, PosError> {
    let mut file = PosFile { rows: Vec::new(), unreadable: Vec::new() };
    let mut coordinates = Coordinates::Unknown;
    let (mut bytes, mut number) = (Vec::new(), 0);
    loop {
        bytes.clear();
        if input.read_until(b'\n', &mut bytes)? == 0 {
            return Ok(file);
        }
        number += 1;
        let text = String::from_utf8_lossy(&bytes);
        let line = text.trim();
        if line.starts_with('%') {
            coordinates = read_header(line, number)?.unwrap_or(coordinates);
        } else if !line.is_empty() {
            match read_row(line, &mut coordinates) {
                Some(row) => file.rows.push(row),
                None => file.unreadable.push(number),
            }
        }
    }
}

/// The kind of coordinates that a header line names, if any.
fn read_header(line: &str, number: usize) -> Result<Option<Coordinates>, PosError> {
    let low = line.to_lowercase();
    let refuse = |what| Err(PosError::Unsupported { line: number, what });
    let titles = low.contains("latitude") || low.contains("x-ecef");
    if low.contains("e-baseline") {
        return refuse("a baseline");
    }
    if low.contains("latitude(d'") {
        return refuse("an angle in degrees, minutes and seconds");
    }
    if low.contains("height=") && low.replace("wgs84/ellipsoidal", "").contains("geodetic") {
        return refuse("a height above the geoid");
    }
    let scale = low.split('(').next().unwrap_or_default();
    if titles && (scale.contains("utc") || scale.contains("jst")) {
        return refuse("a time other than GPS time");
    }
    Ok(match titles {
        true if low.contains("x-ecef") => Some(Coordinates::Ecef),
        true => Some(Coordinates::Degrees),
        false => None,
    })
}

fn read_row(line: &str, coordinates: &mut Coordinates) -> Option<PosRow> {
    let mut fields = line.split([' ', '\t', ',']).filter(|field| !field.is_empty());
    let time = read_time(fields.next()?, fields.next()?)?;
    let mut number = || fields.next()?.parse::<f64>().ok().filter(|value| value.is_finite());
    let triple = Vector3::new(number()?, number()?, number()?);
    let quality = fields.next()?.parse().ok()?;
    let satellites = fields.next().and_then(|field| field.parse().ok());
    if *coordinates == Coordinates::Unknown {
        let metres = LARGEST_ANGLE < triple.x.abs();
        *coordinates = if metres { Coordinates::Ecef } else { Coordinates::Degrees };
    }
    let is_ecef = *coordinates == Coordinates::Ecef;
    let position = match is_ecef {
        true => Ecef(triple),
        false => Geodetic::from_degrees(triple.x, triple.y, triple.z).to_ecef(),
    };
    let mut roots = [0.0; 6];
    let complete = roots.iter_mut().all(|root| {
        let value = fields.next().and_then(|field| field.parse::<f64>().ok());
        value.inspect(|value| *root = *value).is_some_and(f64::is_finite)
    });
    let covariance = complete.then(|| covariance_of(&roots, is_ecef, position));
    Some(PosRow { time, position, quality, satellites, covariance })
}

/// Parses week and seconds of week, or `yyyy/mm/dd` and `hh:mm:ss.s`.
fn read_time(first: &str, second: &str) -> Option<GpsTime> {
    if !first.contains('/') {
        let (week, seconds) = (first.parse::<i32>().ok()?, second.parse::<f64>().ok()?);
        let plausible = (-15_000..=15_000).contains(&week) && seconds.is_finite();
        return plausible.then(|| GpsTime::from_week_seconds(week, seconds));
    }
    let mut date = first.split('/').map(str::parse::<i32>);
    let mut clock = second.split(':');
    let civil = CivilTime {
        year: date.next()?.ok()?,
        month: u8::try_from(date.next()?.ok()?).ok()?,
        day: u8::try_from(date.next()?.ok()?).ok()?,
        hour: clock.next()?.parse().ok()?,
        minute: clock.next()?.parse().ok()?,
        second: 0,
        nanosecond: 0,
    };
    let seconds: f64 = clock.next()?.parse().ok()?;
    let minute = GpsTime::from_civil(&civil, TimeScale::Gps, &LeapSeconds::table())?;
    seconds.is_finite().then(|| minute + seconds)
}

/// The ECEF covariance from six signed roots: n, e, u, ne, eu, un or x, y, z, xy, yz, zx.
fn covariance_of(roots: &[f64; 6], is_ecef: bool, position: Ecef) -> Matrix3<f64> {
    let c = roots.map(|root| root * root.abs());
    #[rustfmt::skip]
    let matrix = Matrix3::new(
        c[0], c[3], c[5],
        c[3], c[1], c[4],
        c[5], c[4], c[2],
    );
    if is_ecef {
        return matrix;
    }
    let frame = LocalFrame::at(position).rotation;
    // The file's order is north, east, up.
    let to_local = Matrix3::from_rows(&[frame.row(1), frame.row(0), frame.row(2)]);
    to_local.transpose() * matrix * to_local
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::encoder::text_of;
    use crate::gnss::{Dops, Provenance, SolutionEstimate};

    fn solution(covariance_enu: Matrix3<f64>) -> Solution {
        let position = Geodetic::from_degrees(22.301_234_5, -114.179_012_3, 10.25).to_ecef();
        let rotation = LocalFrame::at(position).rotation;
        let time = GpsTime::from_week_seconds(2051, 46_700.997);
        let estimate = SolutionEstimate {
            position,
            covariance: rotation.transpose() * covariance_enu * rotation,
            velocity: None,
            clock_m: 0.0,
            inter_system_biases_m: Vec::new(),
            reception_time: time,
            dops: Dops { gdop: 2.0, pdop: 1.5, hdop: 1.0, vdop: 1.0, tdop: 1.0 },
            satellites_used: ["G01", "C05"].map(|name| name.parse().unwrap()).to_vec(),
            relative: None,
        };
        Solution {
            time,
            status: Status::Single,
            estimate: Some(estimate),
            protection: None,
            reasons: Vec::new(),
            provenance: Provenance::default(),
        }
    }

    fn written(solutions: &[Solution]) -> String {
        text_of(&mut Rows { comments: vec!["program : graphfix".to_owned()] }, solutions)
    }

    #[test]
    fn a_row_as_rtklib_prints_it() {
        // Variances of e, n, u 4, 9, 16 m²; covariances en −1, eu 2.25, nu −0.25 m².
        let enu = Matrix3::new(4.0, -1.0, 2.25, -1.0, 9.0, -0.25, 2.25, -0.25, 16.0);
        let text = written(&[solution(enu)]);
        assert!(text.starts_with("% program : graphfix\n%\n% (lat/lon/height=WGS84/ellipsoidal"));
        assert_eq!(
            text.lines().last().unwrap(),
            "2051  46700.997   22.301234500 -114.179012300    10.2500   5   2   3.0000   2.0000   \
             4.0000  -1.0000   1.5000  -0.5000   0.00    0.0"
        );
    }

    #[test]
    fn what_is_written_reads_back() {
        let enu = Matrix3::new(4.0, -1.0, 2.25, -1.0, 9.0, -0.25, 2.25, -0.25, 16.0);
        let original = solution(enu);
        let nothing = Solution::none(original.time + 1.0, Vec::new());
        let file = read(written(&[original.clone(), nothing]).as_bytes()).unwrap();
        let [row] = &file.rows[..] else { panic!("{} rows", file.rows.len()) };
        let estimate = original.estimate.unwrap();
        assert_eq!((row.time, row.quality, row.satellites), (original.time, 5, Some(2)));
        assert!(row.position.distance_m(estimate.position) < 2e-4);
        assert!((row.covariance.unwrap() - estimate.covariance).amax() < 1e-3);
    }

    #[test]
    fn calendar_dates_ecef_and_commas_are_read() {
        let text = "%  GPST , x-ecef(m),y-ecef(m),z-ecef(m),Q\n\
                    2019/04/28 12:58:21.500,-2414266.9,5386768.9,2407460.0,1\n\
                    2019/04/28 12:58:22.5,oops,5386768.9,2407460.0,1\n";
        let file = read(text.as_bytes()).unwrap();
        assert_eq!(file.unreadable, [3]);
        let row = &file.rows[0];
        assert_eq!(row.time, GpsTime::from_week_seconds(2051, 46_701.5));
        assert_eq!(row.position, Ecef::new(-2_414_266.9, 5_386_768.9, 2_407_460.0));
        assert_eq!((row.quality, row.satellites, row.covariance), (1, None, None));
    }

    #[test]
    fn what_would_be_judged_wrongly_is_refused() {
        for header in [
            "%  GPST  e-baseline(m)  n-baseline(m)",
            "%  GPST  latitude(d'\") longitude(d'\")",
            "% (lat/lon/height=WGS84/geodetic,Q=1:fix)",
            "%  UTC   latitude(deg) longitude(deg)",
        ] {
            assert!(matches!(read(header.as_bytes()), Err(PosError::Unsupported { line: 1, .. })));
        }
    }
}
