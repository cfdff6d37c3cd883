//! Displacements measured by another sensor, as CSV: one a line, in order of time.
//!
//! A title line names the columns, in any order. Other columns are ignored, as are empty lines and
//! lines that start with `#` or `%`:
//!
//! | column | content |
//! |---|---|
//! | `gps_week`, `tow` | GPS time at the end of the displacement, week and seconds |
//! | `interval_s` | duration of the displacement (s) |
//! | `frame` | `ecef`, `enu` or `body` (forward, left, up) |
//! | `x_m`, `y_m`, `z_m` | displacement (m) |
//! | `var_x_m2`, `var_y_m2`, `var_z_m2` | variances of the displacement (m²) |
//! | `cov_xy_m2`, `cov_xz_m2`, `cov_yz_m2` | covariances (m²); zero without such a column |
//! | `heading_deg`, `heading_sigma_deg` | of a body, clockwise from north; else empty |

use std::io::{self, BufRead, Write};

use super::decimal::{push_fixed, push_integer, push_seconds};
use crate::gnss::constants::SECONDS_PER_WEEK;
use crate::gnss::{GpsTime, Odometry, OdometryError, OdometryFrame, symmetric_of};

const COLUMNS: [&str; 15] = [
    "gps_week",
    "tow",
    "interval_s",
    "frame",
    "x_m",
    "y_m",
    "z_m",
    "var_x_m2",
    "var_y_m2",
    "var_z_m2",
    "cov_xy_m2",
    "cov_xz_m2",
    "cov_yz_m2",
    "heading_deg",
    "heading_sigma_deg",
];
/// Number of columns that a file must have.
const NEEDED: usize = 10;
const WEEK_MAX: f64 = 9_999.0;

/// A displacement and the time of its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryRow {
    /// GPS time at the end of the displacement.
    pub time: GpsTime,
    /// Displacement with its covariance.
    pub odometry: Odometry,
}

/// Why an odometry file is refused.
#[derive(Debug, thiserror::Error)]
pub enum OdometryFileError {
    /// The input cannot be read.
    #[error("reading failed: {0}")]
    Read(#[from] io::Error),
    /// The title line lacks a required column.
    #[error("line {line}: no column is named {column}")]
    MissingColumn {
        /// Number of the line, from 1.
        line: usize,
        /// Name of the column.
        column: &'static str,
    },
    /// A field is not a number, or out of its range.
    #[error("line {line}: {column} is {text:?}")]
    Field {
        /// Number of the line, from 1.
        line: usize,
        /// Name of the column.
        column: &'static str,
        /// Content of the field.
        text: String,
    },
    /// The displacement is invalid.
    #[error("line {line}: {error}")]
    Impossible {
        /// Number of the line, from 1.
        line: usize,
        /// Why the displacement is invalid.
        error: OdometryError,
    },
    /// The time of a row is not after that of the previous row.
    #[error("line {line}: its time is not after that of the previous row")]
    OutOfOrder {
        /// Number of the line, from 1.
        line: usize,
    },
    /// The file has no rows.
    #[error("the file has no rows")]
    Empty,
}

/// Reads all displacements of a file.
///
/// # Errors
/// The first line that cannot be read, with the reason.
///
/// # Example
/// ```
/// let file = "gps_week,tow,interval_s,frame,x_m,y_m,z_m,var_x_m2,var_y_m2,var_z_m2\n\
///     2051,46701.5,0.5,enu,1.0,2.0,0.0,0.1,0.2,0.3\n";
/// let rows = graphfix_compute::formats::odometry::read(file.as_bytes())?;
/// assert_eq!(rows[0].odometry.displacement_m.norm(), 5_f64.sqrt());
/// # Ok::<(), graphfix_compute::formats::odometry::OdometryFileError>(())
/// ```
pub fn read(mut input: impl BufRead) -> Result<Vec<OdometryRow>, OdometryFileError> {
    let (mut rows, mut indices) = (Vec::<OdometryRow>::new(), None);
    let (mut bytes, mut line) = (Vec::new(), 0);
    loop {
        bytes.clear();
        if input.read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
        line += 1;
        let text = String::from_utf8_lossy(&bytes);
        let text = text.trim().trim_start_matches('\u{feff}');
        if text.is_empty() || text.starts_with(['#', '%']) {
            continue;
        }
        let Some(indices) = &indices else {
            indices = Some(columns_of(text, line)?);
            continue;
        };
        let row =
            Fields { line, values: text.split(',').map(str::trim).collect(), indices }.row()?;
        if rows.last().is_some_and(|last| row.time <= last.time) {
            return Err(OdometryFileError::OutOfOrder { line });
        }
        rows.push(row);
    }
    if rows.is_empty() { Err(OdometryFileError::Empty) } else { Ok(rows) }
}

/// Index of each column in the title line.
fn columns_of(
    title: &str,
    line: usize,
) -> Result<[Option<usize>; COLUMNS.len()], OdometryFileError> {
    let names: Vec<_> = title.split(',').map(|name| name.trim().to_lowercase()).collect();
    let indices = COLUMNS.map(|column| names.iter().position(|name| name == column));
    match indices.iter().take(NEEDED).position(Option::is_none) {
        Some(missing) => Err(OdometryFileError::MissingColumn { line, column: COLUMNS[missing] }),
        None => Ok(indices),
    }
}

/// The fields of one line.
struct Fields<'a> {
    line: usize,
    values: Vec<&'a str>,
    indices: &'a [Option<usize>; COLUMNS.len()],
}

impl Fields<'_> {
    fn row(&self) -> Result<OdometryRow, OdometryFileError> {
        let numbers: [f64; 3] = self.numbers(4)?;
        let variances: [f64; 3] = self.numbers(7)?;
        let mut covariances = [0.0; 3];
        for (index, value) in covariances.iter_mut().enumerate() {
            *value = self.optional(10 + index)?.unwrap_or(0.0);
        }
        let ([xx, yy, zz], [xy, xz, yz]) = (variances, covariances);
        let frame = match self.text(3) {
            "ecef" => OdometryFrame::Ecef,
            "enu" => OdometryFrame::Enu,
            "body" => OdometryFrame::Body {
                heading_rad: self.number(13)?.to_radians(),
                heading_sigma_rad: self.number(14)?.to_radians(),
            },
            _ => return Err(self.refused(3)),
        };
        let odometry = Odometry {
            interval_s: self.number(2)?,
            frame,
            displacement_m: numbers.into(),
            covariance: symmetric_of([xx, yy, zz, xy, xz, yz]),
        };
        let line = self.line;
        let impossible = |error| OdometryFileError::Impossible { line, error };
        Ok(OdometryRow { time: self.time()?, odometry: odometry.checked().map_err(impossible)? })
    }

    fn time(&self) -> Result<GpsTime, OdometryFileError> {
        let (week, seconds) = (self.number(0)?, self.number(1)?);
        if week.fract() != 0.0 || !(0.0..=WEEK_MAX).contains(&week) {
            return Err(self.refused(0));
        }
        if !(0.0..SECONDS_PER_WEEK).contains(&seconds) {
            return Err(self.refused(1));
        }
        Ok(GpsTime::from_week_seconds(week as i32, seconds))
    }

    fn text(&self, column: usize) -> &str {
        self.indices[column].and_then(|index| self.values.get(index)).copied().unwrap_or_default()
    }

    fn numbers(&self, first: usize) -> Result<[f64; 3], OdometryFileError> {
        Ok([self.number(first)?, self.number(first + 1)?, self.number(first + 2)?])
    }

    fn number(&self, column: usize) -> Result<f64, OdometryFileError> {
        let value = self.text(column).parse().ok();
        value.filter(|value: &f64| value.is_finite()).ok_or_else(|| self.refused(column))
    }

    /// The number in a column that may be absent or empty.
    fn optional(&self, column: usize) -> Result<Option<f64>, OdometryFileError> {
        if self.text(column).is_empty() { Ok(None) } else { self.number(column).map(Some) }
    }

    fn refused(&self, column: usize) -> OdometryFileError {
        let (line, text) = (self.line, self.text(column).to_owned());
        OdometryFileError::Field { line, column: COLUMNS[column], text }
    }
}

/// Writes an odometry file, lengths to a hundredth of a millimetre.
pub fn write(mut output: impl Write, rows: &[OdometryRow]) -> io::Result<()> {
    writeln!(output, "{}", COLUMNS.join(","))?;
    let mut line = Vec::new();
    for OdometryRow { time, odometry } in rows {
        line.clear();
        push_integer(&mut line, i64::from(time.week()), 0);
        line.push(b',');
        push_seconds(&mut line, time.ns_of_week(), 3, 0);
        line.push(b',');
        push_fixed(&mut line, odometry.interval_s, 6, 0);
        line.push(b',');
        line.extend_from_slice(odometry.frame.name().as_bytes());
        let indices = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
        let lengths = odometry.displacement_m.iter().map(|value| (*value, 5));
        let squares = indices.into_iter().map(|index| (odometry.covariance[index], 8));
        for (value, decimals) in lengths.chain(squares) {
            line.push(b',');
            push_fixed(&mut line, value, decimals, 0);
        }
        match odometry.frame {
            OdometryFrame::Body { heading_rad, heading_sigma_rad } => {
                for angle in [heading_rad, heading_sigma_rad] {
                    line.push(b',');
                    push_fixed(&mut line, angle.to_degrees(), 6, 0);
                }
            }
            OdometryFrame::Ecef | OdometryFrame::Enu => line.extend_from_slice(b",,"),
        }
        line.push(b'\n');
        output.write_all(&line)?;
    }
    output.flush()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    const TITLE: &str = "tow,gps_week,frame,interval_s,x_m,y_m,z_m,var_x_m2,var_y_m2,var_z_m2,note";

    #[test]
    fn columns_are_found_by_their_titles() {
        let text = format!("# wheels\n{TITLE}\n\n46701.5,2051,enu,0.5,1,2,3,0.1,0.2,0.3,any\n");
        let rows = read(text.as_bytes()).unwrap();
        assert_eq!(rows[0].time, GpsTime::from_week_seconds(2051, 46_701.5));
        let odometry = rows[0].odometry;
        assert_eq!(odometry.interval_s, 0.5);
        assert_eq!(odometry.frame, OdometryFrame::Enu);
        assert_eq!(odometry.displacement_m, Vector3::new(1.0, 2.0, 3.0));
        assert_eq!(odometry.covariance, symmetric_of([0.1, 0.2, 0.3, 0.0, 0.0, 0.0]));
    }

    #[test]
    fn what_cannot_be_read_is_refused_with_its_line() {
        let refused =
            |rows: &str| read(format!("{TITLE}\n{rows}").as_bytes()).unwrap_err().to_string();
        for (rows, message) in [
            ("", "the file has no rows"),
            ("1,2051,enu,1,x,0,0,1,1,1", "line 2: x_m is \"x\""),
            ("1,2051,enu,1", "line 2: x_m is \"\""),
            ("1,2051,ned,1,0,0,0,1,1,1", "line 2: frame is \"ned\""),
            ("1,2051,body,1,0,0,0,1,1,1", "line 2: heading_deg is \"\""),
            ("1,2051.5,enu,1,0,0,0,1,1,1", "line 2: gps_week is \"2051.5\""),
            ("604800,2051,enu,1,0,0,0,1,1,1", "line 2: tow is \"604800\""),
            ("1,2051,enu,1,0,0,0,1,0,1", "line 2: the covariance is not positive definite"),
            (
                "1,2051,enu,1,0,0,0,1,1,1\n\n1,2051,enu,1,0,0,0,1,1,1",
                "line 4: its time is not after that of the previous row",
            ),
        ] {
            assert_eq!(refused(rows), message);
        }
        let untitled = read("1,2051,enu,1,0,0,0,1,1,1\n".as_bytes()).unwrap_err();
        assert_eq!(untitled.to_string(), "line 1: no column is named gps_week");
    }

    #[test]
    fn what_is_written_reads_back() {
        let heading = OdometryFrame::Body { heading_rad: 1.0, heading_sigma_rad: 0.02 };
        let row = |second: f64, frame| OdometryRow {
            time: GpsTime::from_week_seconds(2300, second),
            odometry: Odometry {
                interval_s: 0.2,
                frame,
                displacement_m: Vector3::new(1.25, -0.5, 0.0),
                covariance: symmetric_of([0.04, 0.01, 0.25, 0.001, 0.0, -0.002]),
            },
        };
        let rows = [row(0.2, OdometryFrame::Ecef), row(0.4, OdometryFrame::Enu), row(0.6, heading)];
        let mut text = Vec::new();
        write(&mut text, &rows).unwrap();
        let read = read(&text[..]).unwrap();
        assert_eq!(read[..2], rows[..2]);
        let OdometryFrame::Body { heading_rad, heading_sigma_rad } = read[2].odometry.frame else {
            panic!("the frame is lost");
        };
        assert!((heading_rad - 1.0).abs() < 1e-7 && (heading_sigma_rad - 0.02).abs() < 1e-7);
    }
}
