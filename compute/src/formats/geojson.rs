//! Solutions as GeoJSON (RFC 7946): a point for each position and lines for the track.
//!
//! Coordinates are longitude and latitude (degrees) and ellipsoidal height (m) on WGS 84. A point
//! has the properties `time` (UTC), `gpsWeek`, `tow` (s), `status`, `satellites`, `sdEastM`,
//! `sdNorthM`, `sdUpM`, and, where known, `speedMS`, the protection levels `horizontalProtectionM`
//! and `verticalProtectionM` (m), `reasons`, and where a session asks for them `frame`,
//! `frameEpochYear` and `orthometricHeightM`, the height above the geoid (m). The track ends where
//! an epoch has no position, where it crosses the antimeridian (RFC 7946, 3.1.9), and after
//! [`POINTS_PER_LINE`] points, so that writing needs little memory.
//!
//! A stored solution also has `seq` and `revision`. Each listed revision of an epoch is a point;
//! the track goes through the first of them.

use super::decimal::{push_fixed, push_integer, push_seconds};
use super::encoder::{Additions, Encoder, Revision};
use crate::gnss::{FrameRefusal, LeapSeconds, LocalFrame, Presented, Solution, SolutionEstimate};

/// Largest number of points in one line of the track.
pub(super) const POINTS_PER_LINE: usize = 1000;

/// Writes one feature collection.
pub(super) struct Collection {
    leap: LeapSeconds,
    additions: Additions,
    /// Coordinates of the current line of the track, as text.
    track: Vec<u8>,
    points_of_track: usize,
    features: usize,
    /// Number of the last stored epoch.
    last_seq: Option<u64>,
}

impl Collection {
    /// `leap` converts GPS time to UTC.
    pub(super) const fn new(leap: LeapSeconds, additions: Additions) -> Self {
        Self { leap, additions, track: Vec::new(), points_of_track: 0, features: 0, last_seq: None }
    }

    fn begin_feature(&mut self, geometry: &str, out: &mut Vec<u8>) {
        let before = if self.features == 0 { "" } else { "," };
        self.features += 1;
        let text = format!(
            "{before}\n{{\"type\":\"Feature\",\"geometry\":{{\"type\":\"{geometry}\",\
             \"coordinates\":"
        );
        out.extend_from_slice(text.as_bytes());
    }

    fn extend_track(&mut self, coordinates: &[u8]) {
        if self.points_of_track != 0 {
            self.track.push(b',');
        }
        self.track.extend_from_slice(coordinates);
        self.points_of_track += 1;
    }

    /// Whether the line to this position would go around the Earth: the longitude changes by more
    /// than 180°.
    fn would_cross_antimeridian(&self, estimate: &SolutionEstimate) -> bool {
        let last = self.track.iter().rposition(|byte| *byte == b'[').map(|at| at + 1);
        let longitude = last.and_then(|at| self.track[at..].split(|byte| *byte == b',').next());
        let longitude = longitude.and_then(|text| std::str::from_utf8(text).ok()?.parse().ok());
        let now_deg = estimate.position.to_geodetic().longitude_rad.to_degrees();
        longitude.is_some_and(|last_deg: f64| 180.0 < (now_deg - last_deg).abs())
    }

    /// Writes the current line of the track; the next one begins at its last point if `continued`.
    fn end_track(&mut self, continued: bool, out: &mut Vec<u8>) {
        if 2 <= self.points_of_track {
            self.begin_feature("LineString", out);
            out.push(b'[');
            out.extend_from_slice(&self.track);
            out.extend_from_slice(b"]},\"properties\":{\"kind\":\"track\"}}");
        }
        let last = self.track.iter().rposition(|byte| *byte == b'[').filter(|_| continued);
        self.track.drain(..last.unwrap_or(self.track.len()));
        self.points_of_track = usize::from(last.is_some());
    }
}

impl Encoder for Collection {
    fn begin(&mut self, out: &mut Vec<u8>) {
        out.extend_from_slice(b"{\"type\":\"FeatureCollection\",\"features\":[");
    }

    /// Appends one point; a solution without position ends the current line of the track.
    fn push(&mut self, presented: &Presented<'_>, revision: Option<Revision>, out: &mut Vec<u8>) {
        let solution = &presented.solution;
        let seq = revision.map(|revision| revision.seq);
        let is_repeated = seq.is_some() && seq == self.last_seq;
        self.last_seq = seq;
        let Some(estimate) = &solution.estimate else {
            return self.end_track(false, out);
        };
        if !is_repeated && self.would_cross_antimeridian(estimate) {
            self.end_track(false, out);
        }
        self.begin_feature("Point", out);
        let start = out.len();
        push_coordinates(out, estimate);
        if !is_repeated {
            self.extend_track(&out[start..]);
        }
        push_properties(out, solution, estimate, revision, &self.leap);
        push_reference(out, presented, self.additions);
        out.extend_from_slice(b"}}");
        if POINTS_PER_LINE <= self.points_of_track {
            self.end_track(true, out);
        }
    }

    /// Appends the last line of the track, and ends the document.
    fn finish(&mut self, out: &mut Vec<u8>) {
        self.end_track(false, out);
        out.extend_from_slice(b"\n]}\n");
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
    revision: Option<Revision>,
    leap: &LeapSeconds,
) {
    let time = solution.time.to_rfc3339(leap);
    let status = solution.status.name();
    let mut text = |text: &str| out.extend_from_slice(text.as_bytes());
    text("},\"properties\":{\"kind\":\"position\",\"time\":\"");
    text(&time);
    text("\",\"status\":\"");
    text(status);
    if let Some(Revision { seq, revision }) = revision {
        text(&format!("\",\"seq\":{seq},\"revision\":{revision},\"gpsWeek\":"));
    } else {
        text("\",\"gpsWeek\":");
    }
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
}

/// Appends the reasons, and where they are asked for the frame of the position and its height above
/// the geoid.
fn push_reference(out: &mut Vec<u8>, presented: &Presented<'_>, additions: Additions) {
    let codes = presented.solution.reasons.iter().map(|reason| reason.code());
    let codes: Vec<_> = codes.chain(presented.refusal.map(|_| FrameRefusal::CODE)).collect();
    if !codes.is_empty() {
        let text = format!(",\"reasons\":[\"{}\"]", codes.join("\",\""));
        out.extend_from_slice(text.as_bytes());
    }
    if additions.has_frame {
        let frame = presented.frame_of_position();
        out.extend_from_slice(format!(",\"frame\":\"{}\"", frame.name).as_bytes());
        if let Some(year) = frame.epoch_year {
            push_number(out, "frameEpochYear", year);
        }
    }
    if let Some(height_m) = presented.orthometric_height_m() {
        push_number(out, "orthometricHeightM", height_m);
    }
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
    use crate::formats::encoder::{REFERRED, referred, text_of, text_of_presented};
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
        let text =
            text_of(&mut Collection::new(LeapSeconds::table(), Additions::default()), solutions);
        let document: Value = serde_json::from_str(&text).unwrap();
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

    /// RFC 7946: the height of a coordinate is above the ellipsoid.
    #[test]
    fn what_is_asked_for_is_a_property() {
        let solution = solution(1);
        let mut collection = Collection::new(LeapSeconds::table(), REFERRED);
        let presented = Presented { refusal: Some(FrameRefusal::Outside), ..referred(&solution) };
        let text = text_of_presented(&mut collection, &[presented]);
        let document: Value = serde_json::from_str(&text).unwrap();
        let feature = &document["features"][0];
        let of = |name: &str| feature["properties"][name].clone();
        assert_eq!(of("frame"), "ETRF2000");
        assert_eq!(
            (of("frameEpochYear"), of("orthometricHeightM")),
            (2019.5.into(), (-41.5).into())
        );
        assert_eq!(of("reasons"), serde_json::json!(["NO_REDUNDANCY", "FRAME_UNAVAILABLE"]));
        assert_eq!(feature["geometry"]["coordinates"][2], 5.0);
    }

    #[test]
    fn the_track_breaks_where_there_is_no_position() {
        let gap = Solution::none(GpsTime::EPOCH, Vec::new());
        let all = features(&[solution(0), solution(1), gap, solution(3), solution(4), solution(5)]);
        assert_eq!(lines(&all), [2, 3]);
        assert_eq!(all.len(), 5 + 2);
    }

    /// A ship to the east, over 180°.
    #[test]
    fn the_track_is_cut_at_the_antimeridian() {
        let at = |index: usize, longitude_deg: f64| {
            let mut moved = solution(index);
            let position = Geodetic::from_degrees(10.0, longitude_deg, 5.0).to_ecef();
            moved.estimate.as_mut().unwrap().position = position;
            moved
        };
        let longitudes = [179.97, 179.98, 179.99, -179.99, -179.98];
        let ship: Vec<_> = longitudes.iter().enumerate().map(|(i, deg)| at(i, *deg)).collect();
        let all = features(&ship);
        assert_eq!((lines(&all), all.len()), (vec![3, 2], 5 + 2));
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

    /// Two revisions of an epoch are two points, and one point of the track.
    #[test]
    fn the_track_has_each_epoch_once() {
        let mut collection = Collection::new(LeapSeconds::table(), Additions::default());
        let mut out = Vec::new();
        collection.begin(&mut out);
        for (seq, revision) in [(1, 0), (1, 1), (2, 0), (2, 1)] {
            let solution = solution(2 * seq as usize + revision as usize);
            let presented = Presented::as_computed(&solution);
            collection.push(&presented, Some(Revision { seq, revision }), &mut out);
        }
        collection.finish(&mut out);
        let document: Value = serde_json::from_slice(&out).unwrap();
        let all = document["features"].as_array().unwrap();
        assert_eq!((all.len(), lines(all)), (5, vec![2]));
        let names = |feature: &Value| {
            let number = |name: &str| feature["properties"][name].as_u64();
            (number("seq"), number("revision"))
        };
        assert_eq!(names(&all[3]), (Some(2), Some(1)));
        assert_eq!(all[4]["geometry"]["coordinates"][1], all[2]["geometry"]["coordinates"]);
    }
}
