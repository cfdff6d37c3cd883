//! Solutions as GPX 1.1: one track, with a segment from each gap to the next.
//!
//! A point has latitude and longitude (degrees, WGS 84), the height above the **ellipsoid** as
//! elevation (m), UTC time, the status as `type`, the number of
//! satellites and the dilutions of precision. `fix` is `dgps` for positions relative to a base,
//! whose age is `ageofdgpsdata`, and `3d` for others. An epoch without position ends the segment.
//!
//! With a table of the geoid, the elevation is the height above the **geoid**, and `geoidheight`
//! that of the geoid above the ellipsoid; a point where the table has none has no elevation.
//!
//! Source: Topografix, the schema of GPX 1.1 (topografix.com/GPX/1/1).

use super::decimal::push_fixed;
use super::encoder::{Additions, Encoder, Revision};
use crate::gnss::{LeapSeconds, Presented, SolutionEstimate};

/// Writes GPX.
pub(super) struct Gpx {
    leap: LeapSeconds,
    has_geoid: bool,
    is_in_segment: bool,
}

impl Gpx {
    /// `leap` converts GPS time to UTC.
    pub(super) const fn new(leap: LeapSeconds, additions: Additions) -> Self {
        Self { leap, has_geoid: additions.has_geoid, is_in_segment: false }
    }

    fn end_segment(&mut self, out: &mut Vec<u8>) {
        if std::mem::take(&mut self.is_in_segment) {
            out.extend_from_slice(b"</trkseg>\n");
        }
    }
}

impl Gpx {
    /// Appends a point; the schema gives the order of its elements.
    fn push_point(
        &self,
        out: &mut Vec<u8>,
        presented: &Presented<'_>,
        estimate: &SolutionEstimate,
    ) {
        let (solution, geodetic) = (&presented.solution, estimate.position.to_geodetic());
        out.extend_from_slice(b"<trkpt lat=\"");
        push_fixed(out, geodetic.latitude_rad.to_degrees(), 9, 0);
        out.extend_from_slice(b"\" lon=\"");
        push_fixed(out, geodetic.longitude_rad.to_degrees(), 9, 0);
        out.extend_from_slice(b"\">");
        match self.has_geoid {
            false => push_element(out, "ele", geodetic.height_m, 4),
            true => push_some(out, "ele", presented.orthometric_height_m(), 4),
        }
        let time = format!("<time>{}</time>", solution.time.to_rfc3339(&self.leap));
        out.extend_from_slice(time.as_bytes());
        push_some(out, "geoidheight", presented.geoid_height_m, 4);
        let fix = if estimate.relative.is_some() { "dgps" } else { "3d" };
        let text = format!(
            "<type>{}</type><fix>{fix}</fix><sat>{}</sat>",
            solution.status.name(),
            estimate.satellites_used.len(),
        );
        out.extend_from_slice(text.as_bytes());
        let dops = &estimate.dops;
        push_element(out, "hdop", dops.hdop, 2);
        push_element(out, "vdop", dops.vdop, 2);
        push_element(out, "pdop", dops.pdop, 2);
        push_some(out, "ageofdgpsdata", estimate.relative.as_ref().map(|r| r.age_s), 2);
        out.extend_from_slice(b"</trkpt>\n");
    }
}

impl Encoder for Gpx {
    fn begin(&mut self, out: &mut Vec<u8>) {
        let (version, above) =
            (env!("CARGO_PKG_VERSION"), if self.has_geoid { "geoid" } else { "WGS 84 ellipsoid" });
        let head = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
             <gpx version=\"1.1\" creator=\"Graphfix {version}\" \
             xmlns=\"http://www.topografix.com/GPX/1/1\"><metadata>\
             <desc>Elevations are heights above the {above}</desc></metadata>\n<trk>\n"
        );
        out.extend_from_slice(head.as_bytes());
    }

    fn push(&mut self, presented: &Presented<'_>, _: Option<Revision>, out: &mut Vec<u8>) {
        let Some(estimate) = &presented.solution.estimate else { return self.end_segment(out) };
        if !std::mem::replace(&mut self.is_in_segment, true) {
            out.extend_from_slice(b"<trkseg>\n");
        }
        self.push_point(out, presented, estimate);
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        self.end_segment(out);
        out.extend_from_slice(b"</trk></gpx>\n");
    }
}

/// Appends an element with a number, if there is one.
fn push_some(out: &mut Vec<u8>, name: &str, value: Option<f64>, decimals: usize) {
    if let Some(value) = value {
        push_element(out, name, value, decimals);
    }
}

/// Appends an element with a number; one that is not finite is left out.
fn push_element(out: &mut Vec<u8>, name: &str, value: f64, decimals: usize) {
    if !value.is_finite() {
        return;
    }
    out.extend_from_slice(format!("<{name}>").as_bytes());
    push_fixed(out, value, decimals, 0);
    out.extend_from_slice(format!("</{name}>").as_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::encoder::{REFERRED, referred, sample, text_of, text_of_presented};
    use crate::gnss::{GpsTime, Solution, Status};

    fn written(solutions: &[Solution]) -> String {
        text_of(&mut Gpx::new(LeapSeconds::table(), Additions::default()), solutions)
    }

    #[test]
    fn a_point_tells_where_when_and_how() {
        let text = written(&[sample(Status::Float)]);
        assert!(text.contains(
            "<trkpt lat=\"47.285233166\" lon=\"8.565265000\"><ele>499.6000</ele>\
             <time>2019-04-28T12:58:04.000Z</time><type>FLOAT</type><fix>dgps</fix><sat>3</sat>\
             <hdop>1.04</hdop><vdop>1.10</vdop><pdop>1.50</pdop>\
             <ageofdgpsdata>1.50</ageofdgpsdata></trkpt>"
        ));
    }

    /// The schema has `geoidheight` behind `time`.
    #[test]
    fn with_a_geoid_elevations_are_above_it() {
        let solution = sample(Status::Single);
        let gpx = || Gpx::new(LeapSeconds::table(), REFERRED);
        let text = text_of_presented(&mut gpx(), &[referred(&solution)]);
        assert!(text.contains("Elevations are heights above the geoid<"), "{text}");
        assert!(
            text.contains("<ele>453.1000</ele><time>2019-04-28T12:58:04.000Z</time>"),
            "{text}"
        );
        assert!(text.contains("</time><geoidheight>46.5000</geoidheight><type>SINGLE</type>"));
        let outside = text_of_presented(&mut gpx(), &[Presented::as_computed(&solution)]);
        assert!(outside.contains("lon=\"8.565265000\"><time>"), "{outside}");
    }

    #[test]
    fn an_epoch_without_position_ends_the_segment() {
        let gap = Solution::none(GpsTime::EPOCH, Vec::new());
        let point = sample(Status::Single);
        let text = written(&[gap.clone(), point.clone(), gap.clone(), gap, point.clone(), point]);
        let segments: Vec<usize> =
            text.split("<trkseg>").skip(1).map(|s| s.matches("<trkpt").count()).collect();
        assert_eq!(segments, [1, 2]);
        assert_eq!(text.matches("</trkseg>").count(), 2);
    }
}
