//! Solutions as GeoJSON (RFC 7946): a point for each position and lines for the track.
//!
//! Coordinates are longitude and latitude (degrees) and ellipsoidal height (m) on WGS 84. A point
//! has the properties `time` (UTC), `gpsWeek`, `tow` (s), `status`, `satellites`, `sdEastM`,
//! `sdNorthM`, `sdUpM`, and, where known, `speedMS`, the protection levels `horizontalProtectionM`
//! and `verticalProtectionM` (m), and `reasons`. The track ends where an epoch has no position,
//! and after [`POINTS_PER_LINE`] points, so that writing needs little memory.

use std::io::{self, Write};

use super::decimal::{push_fixed, push_integer, push_seconds};
use crate::gnss::{LeapSeconds, LocalFrame, Solution, SolutionEstimate};

/// Largest number of points in one line of the track.
pub(crate) const POINTS_PER_LINE: usize = 1000;

/// Writes solutions as one feature collection, one at a time, to a buffered writer.
///
/// The document is complete only after [`Writer::finish`].
pub(crate) struct Writer<W> {
    output: W,
    leap: LeapSeconds,
    buffer: Vec<u8>,
    /// Coordinates of the current line of the track, as text.
    track: Vec<u8>,
    points_of_track: usize,
    features: usize,
}

impl<W: Write> Writer<W> {
    /// Begins the collection; `leap` converts GPS time to UTC.
    pub(crate) fn new(mut output: W, leap: LeapSeconds) -> io::Result<Self> {
        output.write_all(b"{\"type\":\"FeatureCollection\",\"features\":[")?;
        let (buffer, track) = (Vec::new(), Vec::new());
        Ok(Self { output, leap, buffer, track, points_of_track: 0, features: 0 })
    }

    /// Writes one point; a solution without position ends the current line of the track.
    pub(crate) fn write(&mut self, solution: &Solution) -> io::Result<()> {
        let Some(estimate) = &solution.estimate else {
            return self.end_track(false);
        };
        self.buffer.clear();
        push_coordinates(&mut self.buffer, estimate);
        if self.points_of_track != 0 {
            self.track.push(b',');
        }
        self.track.extend_from_slice(&self.buffer);
        self.points_of_track += 1;
        self.begin_feature("Point")?;
        self.output.write_all(&self.buffer)?;
        self.buffer.clear();
        push_properties(&mut self.buffer, solution, estimate, &self.leap);
        self.output.write_all(&self.buffer)?;
        if POINTS_PER_LINE <= self.points_of_track { self.end_track(true) } else { Ok(()) }
    }

    /// Writes the last line of the track, ends the document, flushes and returns the output.
    pub(crate) fn finish(mut self) -> io::Result<W> {
        self.end_track(false)?;
        self.output.write_all(b"\n]}\n")?;
        self.output.flush()?;
        Ok(self.output)
    }

    fn begin_feature(&mut self, geometry: &str) -> io::Result<()> {
        let before = if self.features == 0 { "" } else { "," };
        self.features += 1;
        write!(
            self.output,
            "{before}\n{{\"type\":\"Feature\",\"geometry\":{{\"type\":\"{geometry}\",\
             \"coordinates\":"
        )
    }

    /// Writes the current line of the track; the next one begins at its last point if `continued`.
    fn end_track(&mut self, continued: bool) -> io::Result<()> {
        if 2 <= self.points_of_track {
            self.begin_feature("LineString")?;
            self.output.write_all(b"[")?;
            self.output.write_all(&self.track)?;
            self.output.write_all(b"]},\"properties\":{\"kind\":\"track\"}}")?;
        }
        let last = self.track.iter().rposition(|byte| *byte == b'[').filter(|_| continued);
        self.track.drain(..last.unwrap_or(self.track.len()));
        self.points_of_track = usize::from(last.is_some());
        Ok(())
    }
}

fn push_coordinates(out: &mut Vec<u8>, estimate: &SolutionEstimate) {
    let geodetic = estimate.position.to_geodetic();
    out.push(b'[');
    push_fixed(out, geodetic.longitude_rad.to_degrees(), 9, 0);
    out.push(b',');
    push_fixed(out, geodetic.latitude_rad.to_degrees(), 9, 0);
    out.push(b',');
    push_fixed(out, geodetic.height_m, 4, 0);
    out.push(b']');
}

fn push_properties(
    out: &mut Vec<u8>,
    solution: &Solution,
    estimate: &SolutionEstimate,
    leap: &LeapSeconds,
) {
    let time = solution.time.to_rfc3339(leap);
    let status = solution.status.name();
    let mut text = |text: &str| out.extend_from_slice(text.as_bytes());
    text("},\"properties\":{\"kind\":\"position\",\"time\":\"");
    text(&time);
    text("\",\"status\":\"");
    text(status);
    text("\",\"gpsWeek\":");
    push_integer(out, i64::from(solution.time.week()), 0);
    out.extend_from_slice(b",\"tow\":");
    push_seconds(out, solution.time.ns_of_week(), 3, 0);
    out.extend_from_slice(b",\"satellites\":");
    push_integer(out, estimate.satellites_used.len() as i64, 0);
    let enu = LocalFrame::at(estimate.position).covariance_to_enu(&estimate.covariance);
    for (axis, name) in ["sdEastM", "sdNorthM", "sdUpM"].into_iter().enumerate() {
        push_number(out, name, enu[(axis, axis)].sqrt());
    }
    if let Some(velocity) = &estimate.velocity {
        push_number(out, "speedMS", velocity.velocity_m_s.norm());
    }
    if let Some(levels) = &solution.protection {
        push_number(out, "horizontalProtectionM", levels.horizontal_m);
        push_number(out, "verticalProtectionM", levels.vertical_m);
    }
    if !solution.reasons.is_empty() {
        let codes: Vec<_> = solution.reasons.iter().map(|r| format!("\"{}\"", r.code())).collect();
        out.extend_from_slice(format!(",\"reasons\":[{}]", codes.join(",")).as_bytes());
    }
    out.extend_from_slice(b"}}");
}

/// Appends a member with a number; JSON has no NaN, so other values become `null`.
fn push_number(out: &mut Vec<u8>, name: &str, value: f64) {
    out.extend_from_slice(b",\"");
    out.extend_from_slice(name.as_bytes());
    out.extend_from_slice(b"\":");
    match value.is_finite() {
        true => push_fixed(out, value, 4, 0),
        false => out.extend_from_slice(b"null"),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use serde_json::Value;

    use super::*;
    use crate::gnss::{Dops, Geodetic, GpsTime, Provenance, Reason, Status};

    fn solution(index: usize) -> Solution {
        let time = GpsTime::from_week_seconds(2051, 46_701.0 + index as f64);
        let estimate = SolutionEstimate {
            position: Geodetic::from_degrees(10.0, index as f64 * 0.01, 5.0).to_ecef(),
            covariance: Matrix3::identity() * 4.0,
            velocity: None,
            clock_m: 0.0,
            inter_system_biases_m: Vec::new(),
            reception_time: time,
            dops: Dops { gdop: 2.0, pdop: 1.5, hdop: 1.0, vdop: 1.0, tdop: 1.0 },
            satellites_used: Vec::new(),
            relative: None,
        };
        Solution {
            time,
            status: Status::Single,
            estimate: Some(estimate),
            protection: None,
            reasons: vec![Reason::NoRedundancy],
            provenance: Provenance::default(),
        }
    }

    fn features(solutions: &[Solution]) -> Vec<Value> {
        let mut writer = Writer::new(Vec::new(), LeapSeconds::table()).unwrap();
        solutions.iter().for_each(|solution| writer.write(solution).unwrap());
        let document: Value = serde_json::from_slice(&writer.finish().unwrap()).unwrap();
        document["features"].as_array().unwrap().clone()
    }

    fn lines(features: &[Value]) -> Vec<usize> {
        let lines = features.iter().filter(|f| f["geometry"]["type"] == "LineString");
        lines.map(|f| f["geometry"]["coordinates"].as_array().unwrap().len()).collect()
    }

    #[test]
    fn a_point_tells_where_when_and_how() {
        let all = features(&[solution(1)]);
        assert_eq!(all.len(), 1);
        let expected = serde_json::json!({
            "kind": "position", "time": "2019-04-28T12:58:04.000Z", "status": "SINGLE",
            "gpsWeek": 2051, "tow": 46702.0, "satellites": 0,
            "sdEastM": 2.0, "sdNorthM": 2.0, "sdUpM": 2.0, "reasons": ["NO_REDUNDANCY"],
        });
        assert_eq!(all[0]["properties"], expected);
        assert_eq!(all[0]["geometry"]["coordinates"], serde_json::json!([0.01, 10.0, 5.0]));
    }

    #[test]
    fn the_track_breaks_where_there_is_no_position() {
        let gap = Solution::none(GpsTime::EPOCH, Vec::new());
        let all = features(&[solution(0), solution(1), gap, solution(3), solution(4), solution(5)]);
        assert_eq!(lines(&all), [2, 3]);
        assert_eq!(all.len(), 5 + 2);
    }

    #[test]
    fn a_long_track_comes_in_joined_segments() {
        let many: Vec<_> = (0..POINTS_PER_LINE + 5).map(solution).collect();
        let all = features(&many);
        assert_eq!(lines(&all), [POINTS_PER_LINE, 6]);
        let segments: Vec<_> =
            all.iter().filter(|f| f["geometry"]["type"] == "LineString").collect();
        let coordinates = |segment: &Value| segment["geometry"]["coordinates"].clone();
        assert_eq!(coordinates(segments[0])[POINTS_PER_LINE - 1], coordinates(segments[1])[0]);
    }

    #[test]
    fn nothing_is_a_collection_too() {
        assert!(features(&[]).is_empty());
    }
}
