//! Solutions as KML 2.2: a point for each position, and the track as lines, coloured by status.
//!
//! Coordinates are longitude and latitude (degrees) and the height above the **ellipsoid** (m), WGS
//! 84. KML's own heights are above the sea; therefore all features are clamped to the ground. A
//! point has its UTC time, its status as name, and time tag, number of satellites and standard
//! deviations in its description.
//!
//! A line ends where the status changes, where an epoch has no position, and after
//! [`POINTS_PER_LINE`] points. Where the status changes the next line begins at the last point, so
//! that the track has no hole.
//!
//! Source: the schema of OGC KML 2.2, `ogckml22.xsd`, which `tests/oracles/tracks.rs` checks.

use super::decimal::push_fixed;
use super::encoder::{Encoder, Revision};
use crate::gnss::{LeapSeconds, LocalFrame, Presented, Solution, SolutionEstimate, Status};

/// Largest number of points in one line of the track.
const POINTS_PER_LINE: usize = 1000;

/// Writes KML.
pub(super) struct Kml {
    leap: LeapSeconds,
    /// Coordinates of the current line, as text.
    line: Vec<u8>,
    points_of_line: usize,
    /// Status of the current line.
    status: Status,
}

impl Kml {
    /// `leap` converts GPS time to UTC.
    pub(super) const fn new(leap: LeapSeconds) -> Self {
        Self { leap, line: Vec::new(), points_of_line: 0, status: Status::None }
    }

    /// Appends the current line; the next one begins at its last point if `continued`.
    fn end_line(&mut self, continued: bool, out: &mut Vec<u8>) {
        if 2 <= self.points_of_line {
            let style = format!("<Placemark><styleUrl>#{}</styleUrl>", self.status.name());
            out.extend_from_slice(style.as_bytes());
            out.extend_from_slice(b"<LineString><tessellate>1</tessellate><coordinates>");
            out.extend_from_slice(&self.line);
            out.extend_from_slice(b"</coordinates></LineString></Placemark>\n");
        }
        let last = self.line.iter().rposition(|byte| *byte == b' ').filter(|_| continued);
        self.line.drain(..last.unwrap_or(self.line.len()));
        self.points_of_line = usize::from(last.is_some());
    }

    /// Adds a point to the current line.
    fn extend_line(&mut self, status: Status, coordinates: &[u8], out: &mut Vec<u8>) {
        if status != self.status || POINTS_PER_LINE <= self.points_of_line {
            self.end_line(true, out);
            self.status = status;
        }
        self.line.push(b' ');
        self.line.extend_from_slice(coordinates);
        self.points_of_line += 1;
    }
}

impl Encoder for Kml {
    fn begin(&mut self, out: &mut Vec<u8>) {
        out.extend_from_slice(
            b"<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
              <kml xmlns=\"http://www.opengis.net/kml/2.2\"><Document><name>Graphfix</name>\n",
        );
        for status in Status::ALL.into_iter().filter(|status| *status != Status::None) {
            let (name, color) = (status.name(), color(status));
            let style = format!(
                "<Style id=\"{name}\"><IconStyle><color>{color}</color><scale>0.3</scale>\
                 </IconStyle><LabelStyle><scale>0</scale></LabelStyle>\
                 <LineStyle><color>{color}</color><width>2</width></LineStyle></Style>\n"
            );
            out.extend_from_slice(style.as_bytes());
        }
    }

    fn push(&mut self, presented: &Presented<'_>, _: Option<Revision>, out: &mut Vec<u8>) {
        let solution = &presented.solution;
        let Some(estimate) = &solution.estimate else { return self.end_line(false, out) };
        let mut coordinates = Vec::new();
        push_coordinates(&mut coordinates, estimate);
        self.extend_line(solution.status, &coordinates, out);
        let name = solution.status.name();
        let utc = solution.time.to_rfc3339(&self.leap);
        let head = format!(
            "<Placemark><name>{name}</name><description>{}</description>\
             <TimeStamp><when>{utc}</when></TimeStamp><styleUrl>#{name}</styleUrl>\
             <Point><coordinates>",
            description(solution, estimate)
        );
        out.extend_from_slice(head.as_bytes());
        out.extend_from_slice(&coordinates);
        out.extend_from_slice(b"</coordinates></Point></Placemark>\n");
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        self.end_line(false, out);
        out.extend_from_slice(b"</Document></kml>\n");
    }
}

/// Colour of a status, `aabbggrr`: green fixed, amber float, blue graph, violet filter, red single.
const fn color(status: Status) -> &'static str {
    match status {
        Status::Fixed => "ff4caf2e",
        Status::Float => "ff00a5ff",
        Status::Fgo => "fff08020",
        Status::Ekf => "ffb0409a",
        Status::Single => "ff3030e0",
        Status::None => "ff808080",
    }
}

fn push_coordinates(out: &mut Vec<u8>, estimate: &SolutionEstimate) {
    let geodetic = estimate.position.to_geodetic();
    push_fixed(out, geodetic.longitude_rad.to_degrees(), 9, 0);
    out.push(b',');
    push_fixed(out, geodetic.latitude_rad.to_degrees(), 9, 0);
    out.push(b',');
    push_fixed(out, geodetic.height_m, 4, 0);
}

fn description(solution: &Solution, estimate: &SolutionEstimate) -> String {
    let enu = LocalFrame::at(estimate.position).covariance_to_enu(&estimate.covariance);
    let sigma = |axis: usize| enu[(axis, axis)].max(0.0).sqrt();
    format!(
        "{} satellites; sd east {:.3} m, north {:.3} m, up {:.3} m; GPS time {}:{:.3}",
        estimate.satellites_used.len(),
        sigma(0),
        sigma(1),
        sigma(2),
        solution.time.week(),
        solution.time.seconds_of_week(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::encoder::{sample, text_of};
    use crate::gnss::GpsTime;

    fn written(solutions: &[Solution]) -> String {
        text_of(&mut Kml::new(LeapSeconds::table()), solutions)
    }

    #[test]
    fn a_point_has_status_time_and_place() {
        let text = written(&[sample(Status::Fixed)]);
        assert!(text.contains(
            "<Placemark><name>FIXED</name><description>3 satellites; sd east 1.000 m, north 2.000 \
             m, up 3.000 m; GPS time 2051:46702.000</description><TimeStamp><when>\
             2019-04-28T12:58:04.000Z</when></TimeStamp><styleUrl>#FIXED</styleUrl><Point>\
             <coordinates>8.565265000,47.285233166,499.6000</coordinates></Point></Placemark>"
        ));
        assert!(!text.contains("<LineString>"), "a line of one point");
    }

    /// Points and style of each line of the track.
    fn lines(text: &str) -> Vec<(String, usize)> {
        let lines = text.lines().filter(|line| line.contains("<LineString>"));
        let style = |line: &str| line.split(['#', '<']).nth(3).unwrap().to_owned();
        lines.map(|line| (style(line), line.matches(",499.6000").count())).collect()
    }

    #[test]
    fn the_track_changes_its_colour_without_a_hole_and_breaks_without_position() {
        let gap = Solution::none(GpsTime::EPOCH, Vec::new());
        let [float, fixed] = [Status::Float, Status::Fixed].map(sample);
        let text = written(&[
            float.clone(),
            float,
            fixed.clone(),
            fixed.clone(),
            gap,
            fixed.clone(),
            fixed,
        ]);
        let named = |name: &str, points| (name.to_owned(), points);
        assert_eq!(lines(&text), [named("FLOAT", 2), named("FIXED", 3), named("FIXED", 2)]);
    }

    #[test]
    fn a_long_track_comes_in_joined_lines() {
        let text = written(&vec![sample(Status::Single); POINTS_PER_LINE + 5]);
        let counts: Vec<usize> = lines(&text).into_iter().map(|(_, points)| points).collect();
        assert_eq!(counts, [POINTS_PER_LINE, 6]);
    }
}
