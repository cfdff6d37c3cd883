//! Solutions as comma-separated values: one row for each epoch, also without a position.
//!
//! | column | content |
//! |---|---|
//! | `gps_week`, `tow_s` | receiver's time tag: GPS week and seconds of week (s) |
//! | `status` | as in the API: `NONE`, `SINGLE`, … |
//! | `x_m`, `y_m`, `z_m` | antenna position, ECEF (m) |
//! | `latitude_deg`, `longitude_deg`, `height_m` | antenna position, WGS 84, ellipsoidal height |
//! | `var_e_m2` … `cov_nu_m2` | covariance of the position, east, north, up (m²) |
//! | `ve_m_s`, `vn_m_s`, `vu_m_s` | velocity, east, north, up (m/s) |
//! | `var_ve_m2_s2` … `cov_vnvu_m2_s2` | covariance of the velocity, east, north, up (m²/s²) |
//! | `clock_m`, `clock_drift_m_s` | receiver clock error (m) and drift (m/s) |
//! | `reception_tow_s` | estimated true time of reception, seconds of GPS week (s) |
//! | `gdop`, `pdop`, `hdop`, `vdop`, `tdop` | dilutions of precision |
//! | `satellites` | number of satellites used |
//! | `satellite_list` | satellites used, separated by blanks |
//! | `baseline_e_m`, `baseline_n_m`, `baseline_u_m` | from the base, east, north, up (m) |
//! | `age_s` | age of the base epoch (s) |
//! | `ambiguities`, `fixed_ambiguities` | number of ambiguities, and of those fixed to integers |
//! | `ratio`, `success_rate`, `fix_probability` | quality of the integers |
//! | `reasons` | what limits the solution, separated by `; `, in quotes |
//! | `hpl_m`, `vpl_m` | horizontal and vertical protection levels (m) |
//!
//! Further columns may stand at the end: `frame` and `frame_epoch_year` of the position, where a
//! frame is asked for or a base states its own, and `orthometric_height_m`, the height above the
//! geoid (m), where it is asked for.
//!
//! Unknown values are empty fields. Of stored solutions two more columns stand in front: `seq`, the
//! number of the epoch, and `revision`. All revisions of an epoch can be in one file.
//!
//! The positions of such files are read, too.

use std::io::{BufRead, Write};

use nalgebra::{Matrix3, Vector3};

use super::decimal::{push_fixed, push_integer, push_seconds};
use super::encoder::{Additions, Encoder, Revision};
use super::pos::{PosError, PosFile, PosRow, quality};
use crate::gnss::{
    Ecef, FrameRefusal, GpsTime, LocalFrame, Presented, RelativeEstimate, SolutionEstimate, Status,
    Velocity,
};

pub(super) const COLUMNS: &str = "gps_week,tow_s,status,x_m,y_m,z_m,latitude_deg,longitude_deg,\
     height_m,var_e_m2,var_n_m2,var_u_m2,cov_en_m2,cov_eu_m2,cov_nu_m2,ve_m_s,vn_m_s,vu_m_s,\
     var_ve_m2_s2,var_vn_m2_s2,var_vu_m2_s2,cov_vevn_m2_s2,cov_vevu_m2_s2,cov_vnvu_m2_s2,\
     clock_m,clock_drift_m_s,reception_tow_s,gdop,pdop,hdop,vdop,tdop,satellites,\
     satellite_list,baseline_e_m,baseline_n_m,baseline_u_m,age_s,ambiguities,\
     fixed_ambiguities,ratio,success_rate,fix_probability,reasons,hpl_m,vpl_m";
/// Titles that stand in front in files of stored solutions.
pub(super) const STORED_COLUMNS: &str = "seq,revision,";
/// Titles that stand behind where solutions have them.
pub(super) const FRAME_COLUMNS: &str = ",frame,frame_epoch_year";
pub(super) const GEOID_COLUMN: &str = ",orthometric_height_m";
/// Number of columns from `gps_week` to `cov_nu_m2`, which are read, and place of `satellites`.
const READ_COLUMNS: usize = 15;
const SATELLITES_COLUMN: usize = 32;
/// Number of columns between `status` and `reasons`.
const ESTIMATE_COLUMNS: usize = 40;
/// Number of columns from `baseline_e_m` to `fix_probability`.
const RELATIVE_COLUMNS: usize = 9;
/// Number of columns from `ve_m_s` to `cov_vnvu_m2_s2`.
const VELOCITY_COLUMNS: usize = 9;

/// Writes CSV rows.
pub(super) struct Rows {
    pub(super) additions: Additions,
}

impl Encoder for Rows {
    fn begin(&mut self, out: &mut Vec<u8>) {
        let Additions { is_stored, has_frame, has_geoid } = self.additions;
        for (is_there, titles) in [
            (is_stored, STORED_COLUMNS),
            (true, COLUMNS),
            (has_frame, FRAME_COLUMNS),
            (has_geoid, GEOID_COLUMN),
        ] {
            out.extend_from_slice(if is_there { titles.as_bytes() } else { b"" });
        }
        out.push(b'\n');
    }

    fn push(&mut self, presented: &Presented<'_>, revision: Option<Revision>, line: &mut Vec<u8>) {
        let solution = &presented.solution;
        if self.additions.is_stored {
            match revision {
                Some(Revision { seq, revision }) => {
                    push_integer(line, seq as i64, 0);
                    line.push(b',');
                    push_integer(line, i64::from(revision), 0);
                    line.push(b',');
                }
                None => line.extend_from_slice(b",,"),
            }
        }
        push_integer(line, i64::from(solution.time.week()), 0);
        line.push(b',');
        push_seconds(line, solution.time.ns_of_week(), 3, 0);
        line.push(b',');
        line.extend_from_slice(solution.status.name().as_bytes());
        match &solution.estimate {
            Some(estimate) => push_estimate(line, estimate),
            None => line.extend_from_slice(&[b','; ESTIMATE_COLUMNS]),
        }
        line.push(b',');
        push_reasons(line, presented);
        match &solution.protection {
            Some(levels) => {
                push_field(line, levels.horizontal_m, 2);
                push_field(line, levels.vertical_m, 2);
            }
            None => line.extend_from_slice(b",,"),
        }
        push_reference(line, presented, self.additions);
        line.push(b'\n');
    }

    fn finish(&mut self, _: &mut Vec<u8>) {}
}

/// Whether a line has the titles of such a file. Files of other versions may have other columns
/// behind those that are read.
pub(super) fn has_titles(line: &[u8]) -> bool {
    std::str::from_utf8(line).is_ok_and(|line| is_stored(line).is_some())
}

/// Whether number and revision stand in front, if the line has the titles.
fn is_stored(line: &str) -> Option<bool> {
    let stored = line.strip_prefix(STORED_COLUMNS);
    let titles = stored.unwrap_or(line).trim_end().split(',').take(READ_COLUMNS);
    titles.eq(COLUMNS.split(',').take(READ_COLUMNS)).then_some(stored.is_some())
}

/// Reads the positions of a file; rows that cannot be read are left out and listed. Of several
/// revisions of an epoch the last one counts.
///
/// # Errors
/// The input cannot be read.
pub(super) fn read(mut input: impl BufRead) -> Result<PosFile, PosError> {
    let mut file = PosFile { rows: Vec::new(), unreadable: Vec::new() };
    let (mut bytes, mut number, mut has_revisions) = (Vec::new(), 0, false);
    loop {
        bytes.clear();
        if input.read_until(b'\n', &mut bytes)? == 0 {
            return Ok(file);
        }
        number += 1;
        let text = String::from_utf8_lossy(&bytes);
        let line = text.trim_end();
        if let Some(is_stored) = is_stored(line) {
            has_revisions = is_stored;
            continue;
        }
        match read_row(line, has_revisions) {
            Some(Some(row)) => {
                file.rows.pop_if(|last| has_revisions && last.time == row.time);
                file.rows.push(row);
            }
            Some(None) => {}
            None => file.unreadable.push(number),
        }
    }
}

/// The position of a line; `None` if it cannot be read, `Some(None)` if it has no position.
fn read_row(line: &str, has_revision: bool) -> Option<Option<PosRow>> {
    let first = if has_revision { 2 } else { 0 };
    // The reasons, which may have commas, stand behind.
    let fields: Vec<&str> = line.split(',').skip(first).take(SATELLITES_COLUMN + 1).collect();
    let number =
        |column: usize| fields.get(column)?.parse::<f64>().ok().filter(|value| value.is_finite());
    let week = fields.first()?.parse::<u16>().ok()?;
    let time = GpsTime::from_week_seconds(i32::from(week), number(1)?);
    let status = Status::ALL.into_iter().find(|status| Some(&status.name()) == fields.get(2))?;
    let Some(quality) = quality(status) else { return Some(None) };
    let position = Ecef(Vector3::new(number(3)?, number(4)?, number(5)?));
    let [ee, nn, uu, en, eu, nu] = [9, 10, 11, 12, 13, 14].map(number);
    let local = Matrix3::new(ee?, en?, eu?, en?, nn?, nu?, eu?, nu?, uu?);
    let frame = LocalFrame::at(position).rotation;
    Some(Some(PosRow {
        time,
        position,
        quality: i64::from(quality),
        satellites: fields.get(SATELLITES_COLUMN).and_then(|field| field.parse().ok()),
        covariance: Some(frame.transpose() * local * frame),
    }))
}

fn push_estimate(line: &mut Vec<u8>, estimate: &SolutionEstimate) {
    let geodetic = estimate.position.to_geodetic();
    let frame = LocalFrame::at(estimate.position);
    estimate.position.0.iter().for_each(|value| push_field(line, *value, 4));
    push_field(line, geodetic.latitude_rad.to_degrees(), 9);
    push_field(line, geodetic.longitude_rad.to_degrees(), 9);
    push_field(line, geodetic.height_m, 4);
    push_covariance(line, &frame.covariance_to_enu(&estimate.covariance));
    match &estimate.velocity {
        Some(velocity) => push_velocity(line, velocity, &frame),
        None => line.extend_from_slice(&[b','; VELOCITY_COLUMNS]),
    }
    push_field(line, estimate.clock_m, 4);
    match &estimate.velocity {
        Some(velocity) => push_field(line, velocity.clock_drift_m_s, 4),
        None => line.push(b','),
    }
    line.push(b',');
    push_seconds(line, estimate.reception_time.ns_of_week(), 3, 0);
    let dops = &estimate.dops;
    [dops.gdop, dops.pdop, dops.hdop, dops.vdop, dops.tdop]
        .into_iter()
        .for_each(|value| push_field(line, value, 3));
    line.push(b',');
    push_integer(line, estimate.satellites_used.len() as i64, 0);
    for (index, satellite) in estimate.satellites_used.iter().enumerate() {
        let before = if index == 0 { ',' } else { ' ' };
        write!(line, "{before}{satellite}").expect("a Vec<u8> takes every byte");
    }
    if estimate.satellites_used.is_empty() {
        line.push(b',');
    }
    match &estimate.relative {
        Some(relative) => push_relative(line, relative, &frame),
        None => line.extend_from_slice(&[b','; RELATIVE_COLUMNS]),
    }
}

fn push_relative(line: &mut Vec<u8>, relative: &RelativeEstimate, frame: &LocalFrame) {
    let local = frame.rotation * relative.baseline_m;
    local.iter().for_each(|value| push_field(line, *value, 4));
    push_field(line, relative.age_s, 3);
    for count in [relative.ambiguities, relative.fixed_ambiguities] {
        line.push(b',');
        push_integer(line, count as i64, 0);
    }
    for quality in [relative.ratio, relative.success_rate, relative.fix_probability] {
        match quality {
            Some(value) => push_field(line, value, 6),
            None => line.push(b','),
        }
    }
}

fn push_velocity(line: &mut Vec<u8>, velocity: &Velocity, frame: &LocalFrame) {
    let enu = frame.rotation * velocity.velocity_m_s;
    enu.iter().for_each(|value| push_field(line, *value, 5));
    push_covariance(line, &frame.covariance_to_enu(&velocity.covariance));
}

/// Appends the variances, then the covariances 12, 13 and 23.
fn push_covariance(line: &mut Vec<u8>, covariance: &Matrix3<f64>) {
    for (row, column) in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] {
        push_field(line, covariance[(row, column)], 8);
    }
}

fn push_reasons(line: &mut Vec<u8>, presented: &Presented<'_>) {
    let text = reasons_text(presented);
    if !text.is_empty() {
        line.push(b'"');
        line.extend_from_slice(text.replace('"', "\"\"").as_bytes());
        line.push(b'"');
    }
}

/// What limits a solution, separated by `; `.
pub(super) fn reasons_text(presented: &Presented<'_>) -> String {
    let reasons = presented.solution.reasons.iter().map(ToString::to_string);
    let foreign = |refusal| format!("{}{{{refusal}}}", FrameRefusal::CODE);
    reasons.chain(presented.refusal.map(foreign)).collect::<Vec<_>>().join("; ")
}

/// Appends the frame of the position and its height above the geoid, where the file has them.
fn push_reference(line: &mut Vec<u8>, presented: &Presented<'_>, additions: Additions) {
    let has_position = presented.solution.estimate.is_some();
    if additions.has_frame {
        line.push(b',');
        let frame = has_position.then(|| presented.frame_of_position());
        line.extend_from_slice(frame.map_or("", |frame| frame.name).as_bytes());
        match frame.and_then(|frame| frame.epoch_year) {
            Some(year) => push_field(line, year, 4),
            None => line.push(b','),
        }
    }
    if additions.has_geoid {
        match presented.orthometric_height_m() {
            Some(height_m) => push_field(line, height_m, 4),
            None => line.push(b','),
        }
    }
}

/// Appends a comma and a number, of which one that is not finite is unknown.
fn push_field(line: &mut Vec<u8>, value: f64, decimals: usize) {
    line.push(b',');
    if value.is_finite() {
        push_fixed(line, value, decimals, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::encoder::{REFERRED, referred, sample, text_of, text_of_presented};
    use crate::gnss::{Dops, Ecef, GpsTime, Protection, Provenance, Reason, Solution, Status};

    fn solution(velocity: Option<Velocity>) -> Solution {
        let time = GpsTime::from_week_seconds(2300, 100.0);
        // On the equator at longitude 0: up is x, east y, north z.
        let covariance = Matrix3::new(9.0, 0.5, 0.0, 0.5, 1.0, 0.25, 0.0, 0.25, 4.0);
        let estimate = SolutionEstimate {
            position: Ecef::new(6_378_147.0, 0.0, 0.0),
            covariance,
            velocity,
            clock_m: -3.5,
            inter_system_biases_m: Vec::new(),
            reception_time: time - 0.001,
            dops: Dops { gdop: 2.0, pdop: 1.5, hdop: 1.0, vdop: 1.1, tdop: 1.2 },
            satellites_used: ["C05", "G01"].map(|name| name.parse().unwrap()).to_vec(),
            relative: None,
        };
        let reasons = vec![
            Reason::NoRedundancy,
            Reason::SatellitesExcluded { satellites: estimate.satellites_used.clone() },
        ];
        Solution {
            time,
            status: Status::Single,
            estimate: Some(estimate),
            protection: None,
            reasons,
            provenance: Provenance::default(),
        }
    }

    fn rows(solutions: &[Solution]) -> Vec<String> {
        let text = text_of(&mut Rows { additions: Additions::default() }, solutions);
        text.lines().map(str::to_owned).collect()
    }

    #[test]
    fn what_is_asked_for_stands_at_the_end() {
        let (solution, nothing) =
            (sample(Status::Fixed), Solution::none(GpsTime::EPOCH, Vec::new()));
        let foreign = Presented {
            refusal: Some(FrameRefusal::Unknown),
            frame: "BASE",
            epoch_year: None,
            ..referred(&solution)
        };
        let all = [referred(&solution), referred(&nothing), foreign];
        let text = text_of_presented(&mut Rows { additions: REFERRED }, &all);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with(",vpl_m,frame,frame_epoch_year,orthometric_height_m"));
        assert!(lines[1].ends_with(",,,ETRF2000,2019.5000,453.1000"), "{}", lines[1]);
        assert!(lines[2].ends_with(",,,,,"), "{}", lines[2]);
        let reason = "\"FRAME_UNAVAILABLE{the frame of the base's coordinates is unknown}\"";
        let end = format!("{reason},,,BASE,,453.1000");
        assert!(lines[3].ends_with(&end), "{}", lines[3]);
        let columns = |line: &str| line.split(',').count();
        assert!(lines.iter().all(|line| columns(line) == columns(lines[0])), "{text}");
        let read = read(text.as_bytes()).unwrap();
        assert_eq!((read.rows.len(), read.unreadable.len()), (2, 0));
    }

    #[test]
    fn a_number_that_is_not_finite_is_an_empty_field() {
        let mut solution = sample(Status::Single);
        solution.estimate.as_mut().unwrap().dops.gdop = f64::INFINITY;
        let rows = rows(&[solution]);
        let at = rows[0].split(',').position(|title| title == "gdop").unwrap();
        let fields: Vec<&str> = rows[1].split(',').collect();
        assert_eq!(fields[at..at + 2], ["", "1.500"]);
    }

    #[test]
    fn every_column_in_its_place() {
        let velocity = Velocity {
            velocity_m_s: Vector3::new(3.0, 1.0, 2.0),
            covariance: Matrix3::identity() * 0.25,
            clock_drift_m_s: 0.5,
        };
        let mut solution = solution(Some(velocity));
        solution.protection = Some(Protection { horizontal_m: 12.5, vertical_m: 30.0 });
        solution.estimate.as_mut().unwrap().relative = Some(RelativeEstimate {
            baseline_m: Vector3::new(10.0, 2.0, 3.0),
            age_s: 1.5,
            ambiguities: 14,
            fixed_ambiguities: 12,
            ratio: Some(3.25),
            success_rate: None,
            fix_probability: Some(0.999),
        });
        let lines = rows(&[solution]);
        let (row, quoted) = lines[1].split_once('"').unwrap();
        assert_eq!(
            row,
            "2300,100.000,SINGLE,6378147.0000,0.0000,0.0000,0.000000000,0.000000000,10.0000,\
             1.00000000,4.00000000,9.00000000,0.25000000,0.50000000,0.00000000,\
             1.00000,2.00000,3.00000,0.25000000,0.25000000,0.25000000,0.00000000,0.00000000,\
             0.00000000,-3.5000,0.5000,99.999,2.000,1.500,1.000,1.100,1.200,2,C05 G01,\
             2.0000,3.0000,10.0000,1.500,14,12,3.250000,,0.999000,"
        );
        assert_eq!(quoted, "NO_REDUNDANCY; SATELLITES_EXCLUDED[C05, G01]\",12.50,30.00");
    }

    #[test]
    fn unknown_fields_are_empty_and_columns_stay() {
        let mut bare = solution(None);
        bare.reasons.clear();
        let nothing = Solution::none(bare.time, Vec::new());
        let lines = rows(&[bare, nothing]);
        for line in &lines {
            assert_eq!(line.split(',').count(), lines[0].split(',').count(), "{line}");
        }
        assert!(lines[2].starts_with("2300,100.000,NONE,,,"));
    }

    #[test]
    fn stored_solutions_have_number_and_revision() {
        let mut rows = Rows { additions: Additions { is_stored: true, ..Additions::default() } };
        let mut out = Vec::new();
        rows.begin(&mut out);
        let solution = sample(Status::Fixed);
        let presented = Presented::as_computed(&solution);
        rows.push(&presented, Some(Revision { seq: 7, revision: 1 }), &mut out);
        let text = String::from_utf8(out).unwrap();
        let (titles, row) = text.split_once('\n').unwrap();
        assert!(titles.starts_with("seq,revision,gps_week,"), "{titles}");
        assert!(row.starts_with("7,1,2051,46702.000,FIXED,"), "{row}");
        assert_eq!(row.split(',').count(), titles.split(',').count());
    }

    #[test]
    fn what_is_written_reads_back() {
        let nothing = Solution::none(GpsTime::from_week_seconds(2300, 101.0), Vec::new());
        let original = solution(None);
        let text =
            text_of(&mut Rows { additions: Additions::default() }, &[original.clone(), nothing]);
        let file = read(text.as_bytes()).unwrap();
        assert!(file.unreadable.is_empty());
        let [row] = &file.rows[..] else { panic!("{:?}", file.rows) };
        let estimate = original.estimate.unwrap();
        assert_eq!((row.time, row.quality, row.satellites), (original.time, 5, Some(2)));
        assert!(row.position.distance_m(estimate.position) < 1e-9);
        assert!((row.covariance.unwrap() - estimate.covariance).amax() < 1e-9);
    }

    /// Of two revisions the later one counts; a broken row is listed.
    #[test]
    fn revisions_and_broken_rows() {
        let text = text_of(&mut Rows { additions: Additions::default() }, &[solution(None)]);
        let (titles, row) = text.trim_end().split_once('\n').unwrap();
        let moved = row.replace("6378147.0000", "6378148.0000");
        let stored = format!("seq,revision,{titles}\n7,0,{row}\n7,1,{moved}\n8,0,2300,oops\n");
        let file = read(stored.as_bytes()).unwrap();
        let rows: Vec<f64> = file.rows.iter().map(|row| row.position.0.x).collect();
        assert_eq!((rows, file.unreadable), (vec![6_378_148.0], vec![4]));
    }
}
