//! Solutions as NMEA 0183 sentences: GGA, RMC, VTG and GST of each epoch, also without a position.
//!
//! - Times are UTC, of the receiver's time tag rounded to the millisecond; the leap second is
//!   second 60.
//! - Angles have seven decimals of a minute (0.2 mm), more than older receivers write.
//! - GGA: without a table of the geoid, the altitude is the height above the **ellipsoid** and the
//!   geoid separation is empty. With one, the altitude is the height above the **geoid**, and the
//!   separation the height of the geoid above the ellipsoid. A reader that adds both gets the
//!   ellipsoidal height in each case.
//! - Quality of GGA: 4 fixed, 5 float, 1 other positions, 0 none. Mode of RMC and VTG: R, F, A, N.
//! - GST: the rms of the ranges is empty; then 1σ of the error ellipse's axes, the direction of its
//!   major axis from north, and 1σ of latitude, longitude and height.
//!
//! Source of the sentences: DePriest, *NMEA data* (gpsinformation.org/dale/nmea.htm); the modes are
//! those of NMEA 0183 2.3 and later.

use std::io::Write;

use nalgebra::Matrix3;

use super::decimal::push_fixed;
use super::encoder::{Encoder, Revision};
use crate::gnss::{
    CivilTime, LeapSeconds, LocalFrame, Presented, Solution, SolutionEstimate, Status, TimeScale,
};

/// Talker of the combined solution of several constellations.
const TALKER: &str = "GN";
const NS_PER_MS: i64 = 1_000_000;
/// Metres a second in a knot: 1852 m an hour.
const KNOT_M_S: f64 = 1852.0 / 3600.0;
const KMH_PER_M_S: f64 = 3.6;
/// Speeds below this have no direction (m/s).
const SLOWEST_M_S: f64 = 0.01;

/// Writes NMEA 0183.
pub(super) struct Nmea {
    leap: LeapSeconds,
    sentence: Vec<u8>,
}

/// Horizontal motion.
struct Motion {
    speed_m_s: f64,
    /// Direction from true north, clockwise, 0 to 360; `None` at rest.
    course_deg: Option<f64>,
}

impl Nmea {
    /// `leap` converts GPS time to UTC.
    pub(super) const fn new(leap: LeapSeconds) -> Self {
        Self { leap, sentence: Vec::new() }
    }

    /// Begins a sentence.
    fn start(&mut self, kind: &str) -> &mut Vec<u8> {
        self.sentence.clear();
        self.sentence.extend_from_slice(TALKER.as_bytes());
        self.sentence.extend_from_slice(kind.as_bytes());
        &mut self.sentence
    }

    /// Appends the sentence with its checksum.
    fn end(&self, out: &mut Vec<u8>) {
        let checksum = checksum(&self.sentence);
        out.push(b'$');
        out.extend_from_slice(&self.sentence);
        write!(out, "*{checksum:02X}\r\n").expect("a Vec<u8> takes every byte");
    }

    fn gga(&mut self, presented: &Presented<'_>, utc: &CivilTime, out: &mut Vec<u8>) {
        let solution = &presented.solution;
        let sentence = self.start("GGA");
        push_time(sentence, utc);
        push_place(sentence, solution.estimate.as_ref());
        push_text(sentence, &format!(",{}", quality(solution.status)));
        match &solution.estimate {
            Some(estimate) => {
                push_text(sentence, &format!(",{:02},", estimate.satellites_used.len()));
                // Too few satellites of each constellation have no dilution of precision.
                if estimate.dops.hdop.is_finite() {
                    push_fixed(sentence, estimate.dops.hdop, 1, 0);
                }
                sentence.push(b',');
                let height_m = estimate.position.to_geodetic().height_m;
                push_fixed(sentence, presented.orthometric_height_m().unwrap_or(height_m), 3, 0);
                push_text(sentence, ",M,");
                if let Some(geoid_height_m) = presented.geoid_height_m {
                    push_fixed(sentence, geoid_height_m, 3, 0);
                }
                push_text(sentence, ",M,");
                if let Some(relative) = &estimate.relative {
                    push_fixed(sentence, relative.age_s, 1, 0);
                }
                sentence.push(b',');
            }
            None => push_text(sentence, ",00,,,M,,M,,"),
        }
        self.end(out);
    }

    fn rmc(&mut self, solution: &Solution, utc: &CivilTime, out: &mut Vec<u8>) {
        let motion = solution.estimate.as_ref().and_then(motion);
        let mode = mode(solution.status);
        let sentence = self.start("RMC");
        push_time(sentence, utc);
        push_text(sentence, if solution.estimate.is_some() { ",A" } else { ",V" });
        push_place(sentence, solution.estimate.as_ref());
        sentence.push(b',');
        if let Some(motion) = &motion {
            push_fixed(sentence, motion.speed_m_s / KNOT_M_S, 3, 0);
        }
        sentence.push(b',');
        if let Some(course_deg) = motion.and_then(|motion| motion.course_deg) {
            push_fixed(sentence, course_deg, 2, 0);
        }
        let CivilTime { day, month, year, .. } = utc;
        push_text(sentence, &format!(",{day:02}{month:02}{:02},,,{mode}", year.rem_euclid(100)));
        self.end(out);
    }

    fn vtg(&mut self, solution: &Solution, out: &mut Vec<u8>) {
        let motion = solution.estimate.as_ref().and_then(motion);
        let mode = mode(solution.status);
        let sentence = self.start("VTG");
        sentence.push(b',');
        if let Some(course_deg) = motion.as_ref().and_then(|motion| motion.course_deg) {
            push_fixed(sentence, course_deg, 2, 0);
        }
        push_text(sentence, ",T,,M,");
        if let Some(motion) = &motion {
            push_fixed(sentence, motion.speed_m_s / KNOT_M_S, 3, 0);
        }
        push_text(sentence, ",N,");
        if let Some(motion) = &motion {
            push_fixed(sentence, motion.speed_m_s * KMH_PER_M_S, 3, 0);
        }
        push_text(sentence, &format!(",K,{mode}"));
        self.end(out);
    }

    fn gst(&mut self, solution: &Solution, utc: &CivilTime, out: &mut Vec<u8>) {
        let sentence = self.start("GST");
        push_time(sentence, utc);
        sentence.push(b',');
        match &solution.estimate {
            Some(estimate) => {
                let enu = LocalFrame::at(estimate.position).covariance_to_enu(&estimate.covariance);
                let (major_m, minor_m, direction_deg) = error_ellipse(&enu);
                let sigma = |axis: usize| enu[(axis, axis)].max(0.0).sqrt();
                for (value, decimals) in [
                    (major_m, 4),
                    (minor_m, 4),
                    (direction_deg, 1),
                    (sigma(1), 4),
                    (sigma(0), 4),
                    (sigma(2), 4),
                ] {
                    sentence.push(b',');
                    push_fixed(sentence, value, decimals, 0);
                }
            }
            None => push_text(sentence, ",,,,,,"),
        }
        self.end(out);
    }
}

impl Encoder for Nmea {
    fn begin(&mut self, _: &mut Vec<u8>) {}

    fn push(&mut self, presented: &Presented<'_>, _: Option<Revision>, out: &mut Vec<u8>) {
        let solution = &presented.solution;
        let utc = presented.solution.time.to_nearest_ms().to_civil(TimeScale::Utc, &self.leap);
        self.gga(presented, &utc, out);
        self.rmc(solution, &utc, out);
        self.vtg(solution, out);
        self.gst(solution, &utc, out);
    }

    fn finish(&mut self, _: &mut Vec<u8>) {}
}

/// The exclusive or of all bytes between `$` and `*`.
fn checksum(sentence: &[u8]) -> u8 {
    sentence.iter().fold(0, |sum, byte| sum ^ byte)
}

const fn quality(status: Status) -> u8 {
    match status {
        Status::None => 0,
        Status::Single | Status::Ekf | Status::Fgo => 1,
        Status::Float => 5,
        Status::Fixed => 4,
    }
}

const fn mode(status: Status) -> char {
    match status {
        Status::None => 'N',
        Status::Single | Status::Ekf | Status::Fgo => 'A',
        Status::Float => 'F',
        Status::Fixed => 'R',
    }
}

/// The horizontal motion of a position with a velocity.
fn motion(estimate: &SolutionEstimate) -> Option<Motion> {
    let velocity = estimate.velocity.as_ref()?;
    let enu = LocalFrame::at(estimate.position).rotation * velocity.velocity_m_s;
    let speed_m_s = enu.x.hypot(enu.y);
    let course_deg = wrapped(enu.x.atan2(enu.y).to_degrees(), 360.0, 100.0);
    Some(Motion { speed_m_s, course_deg: (SLOWEST_M_S <= speed_m_s).then_some(course_deg) })
}

/// Standard deviations along the axes of the horizontal error ellipse (m), major and minor, and the
/// direction of the major axis from north, clockwise, 0 to 180 (degrees).
///
/// λ = (σ_e² + σ_n²)/2 ± √((σ_e² − σ_n²)²/4 + σ_en²); tan 2α = 2σ_en/(σ_n² − σ_e²).
fn error_ellipse(enu: &Matrix3<f64>) -> (f64, f64, f64) {
    let (east, north, both) = (enu[(0, 0)], enu[(1, 1)], enu[(0, 1)]);
    let mean = (east + north) / 2.0;
    let radius = ((north - east) / 2.0).hypot(both);
    let direction_deg = (2.0 * both).atan2(north - east).to_degrees() / 2.0;
    let sigma = |variance: f64| variance.max(0.0).sqrt();
    (sigma(mean + radius), sigma(mean - radius), wrapped(direction_deg, 180.0, 10.0))
}

/// An angle between 0 and `full`, which is written as 0; rounded to one of `units` of a degree.
fn wrapped(degrees: f64, full: f64, units: f64) -> f64 {
    ((degrees * units).round() / units).rem_euclid(full)
}

fn push_text(out: &mut Vec<u8>, text: &str) {
    out.extend_from_slice(text.as_bytes());
}

/// Appends `,hhmmss.sss`.
fn push_time(out: &mut Vec<u8>, utc: &CivilTime) {
    let CivilTime { hour, minute, second, nanosecond, .. } = utc;
    let ms = i64::from(*nanosecond) / NS_PER_MS;
    push_text(out, &format!(",{hour:02}{minute:02}{second:02}.{ms:03}"));
}

/// Appends latitude, hemisphere, longitude and hemisphere.
fn push_place(out: &mut Vec<u8>, estimate: Option<&SolutionEstimate>) {
    let Some(estimate) = estimate else { return push_text(out, ",,,,") };
    let geodetic = estimate.position.to_geodetic();
    push_angle(out, geodetic.latitude_rad.to_degrees(), 2, ['N', 'S']);
    push_angle(out, geodetic.longitude_rad.to_degrees(), 3, ['E', 'W']);
}

/// Appends degrees and minutes, `ddmm.mmmmmmm`, with the letter of the hemisphere.
fn push_angle(out: &mut Vec<u8>, degrees: f64, digits: usize, letters: [char; 2]) {
    /// Units of the last digit in a degree.
    const UNITS: u64 = 60 * MINUTE;
    const MINUTE: u64 = 10_000_000;
    let units = (degrees.abs() * UNITS as f64).round() as u64;
    let (whole, minutes, rest) = (units / UNITS, units % UNITS / MINUTE, units % MINUTE);
    let letter = letters[usize::from(degrees < 0.0)];
    push_text(out, &format!(",{whole:0digits$}{minutes:02}.{rest:07},{letter}"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::encoder::{referred, sample, text_of, text_of_presented};
    use crate::gnss::GpsTime;

    fn sentences(solution: Solution) -> Vec<String> {
        let text = text_of(&mut Nmea::new(LeapSeconds::table()), &[solution]);
        assert!(text.ends_with("\r\n"));
        text.lines().map(str::to_owned).collect()
    }

    /// The sample of DePriest's page.
    #[test]
    fn a_published_checksum() {
        let sentence = "GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,";
        assert_eq!(checksum(sentence.as_bytes()), 0x47);
    }

    /// Leap seconds: 46 702 s of week 2051 are 12:58:22 GPS time, 12:58:04 UTC. 5 m/s are
    /// 9.719 knots; east 3, north 4 is 36.87° from north. The major axis is north, σ 2 m.
    #[test]
    fn sentences_worked_by_hand() {
        let [gga, rmc, vtg, gst] = &sentences(sample(Status::Fixed))[..] else { panic!("four") };
        let body = |sentence: &str| sentence.rsplit_once('*').unwrap().0.to_owned();
        assert_eq!(
            body(gga),
            "$GNGGA,125804.000,4717.1139900,N,00833.9159000,E,4,03,1.0,499.600,M,,M,1.5,"
        );
        assert_eq!(
            body(rmc),
            "$GNRMC,125804.000,A,4717.1139900,N,00833.9159000,E,9.719,36.87,280419,,,R"
        );
        assert_eq!(body(vtg), "$GNVTG,36.87,T,,M,9.719,N,18.000,K,R");
        assert_eq!(body(gst), "$GNGST,125804.000,,2.0000,1.0000,0.0,2.0000,1.0000,3.0000");
        assert!(vtg.ends_with("*35"), "{vtg}");
        // 82 bytes are the most that NMEA 0183 allows, with the two of the line's end.
        assert!(gga.len() + 2 <= 82, "{}", gga.len() + 2);
    }

    /// 499.6 m above the ellipsoid, and the geoid 46.5 m: 453.1 m above the geoid. A table without
    /// a height there leaves the separation empty.
    #[test]
    fn the_geoid_separates_two_heights() {
        let solution = sample(Status::Fixed);
        let gga = |presented: &Presented<'_>| {
            let all = std::slice::from_ref(presented);
            let text = text_of_presented(&mut Nmea::new(LeapSeconds::table()), all);
            let line = text.lines().next().unwrap();
            line.split(',').skip(9).map(str::to_owned).collect::<Vec<_>>()
        };
        let with = referred(&solution);
        assert_eq!(gga(&with)[..5], ["453.100", "M", "46.500", "M", "1.5"]);
        let without = Presented { geoid_height_m: None, ..with };
        assert_eq!(gga(&without)[..5], ["499.600", "M", "", "M", "1.5"]);
    }

    #[test]
    fn an_unknown_dilution_is_an_empty_field() {
        let mut solution = sample(Status::Single);
        solution.estimate.as_mut().unwrap().dops.hdop = f64::NAN;
        let gga = sentences(solution).remove(0);
        assert!(gga.contains(",1,03,,499.600,M,"), "{gga}");
    }

    #[test]
    fn an_epoch_without_position_is_void() {
        let nothing = Solution::none(GpsTime::from_week_seconds(2051, 46_702.0), Vec::new());
        let [gga, rmc, vtg, gst] = &sentences(nothing)[..] else { panic!("four") };
        assert!(gga.starts_with("$GNGGA,125804.000,,,,,0,00,,,M,,M,,*"), "{gga}");
        assert!(rmc.starts_with("$GNRMC,125804.000,V,,,,,,,280419,,,N*"), "{rmc}");
        assert!(vtg.starts_with("$GNVTG,,T,,M,,N,,K,N*"), "{vtg}");
        assert!(gst.starts_with("$GNGST,125804.000,,,,,,,*"), "{gst}");
    }

    /// The second before 2017-01-01 is 23:59:60; GPS time was then 17 s ahead.
    #[test]
    fn a_leap_second_is_second_sixty() {
        // 2017-01-01T00:00:17 GPS time is second 17 of day 0 of week 1930.
        let mut solution = Solution::none(GpsTime::from_week_seconds(1930, 17.0), Vec::new());
        assert!(sentences(solution.clone())[1].contains("235960.000,V,,,,,,,311216,"));
        solution.time = solution.time + 0.9996;
        assert!(sentences(solution)[1].contains("000000.000,V,,,,,,,010117,"));
    }

    #[test]
    fn angles_carry_into_degrees() {
        let angle = |degrees, digits, letters| {
            let mut out = Vec::new();
            push_angle(&mut out, degrees, digits, letters);
            String::from_utf8(out).unwrap()
        };
        assert_eq!(angle(-0.5, 2, ['N', 'S']), ",0030.0000000,S");
        assert_eq!(angle(59.999_999_999_9, 2, ['N', 'S']), ",6000.0000000,N");
        assert_eq!(angle(-114.25, 3, ['E', 'W']), ",11415.0000000,W");
    }

    #[test]
    fn a_full_turn_is_zero() {
        assert_eq!(wrapped(359.996, 360.0, 100.0), 0.0);
        assert_eq!(wrapped(-1e-12, 180.0, 10.0), 0.0);
        assert_eq!(wrapped(-0.25, 360.0, 100.0), 359.75);
    }

    /// Variances 2 east and 2 north with covariance 1: axes √3 and 1, to the north-east.
    #[test]
    fn a_tilted_ellipse() {
        let enu = Matrix3::new(2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 1.0);
        let (major_m, minor_m, direction_deg) = error_ellipse(&enu);
        assert!((major_m - 3.0_f64.sqrt()).abs() < 1e-12 && (minor_m - 1.0).abs() < 1e-12);
        assert!((direction_deg - 45.0).abs() < 1e-12);
    }
}
