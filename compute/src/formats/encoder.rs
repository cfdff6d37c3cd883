//! What the formats of solutions have in common: each turns one solution after another into bytes.

use crate::gnss::{Presentation, Presented};

/// Number and revision of a stored solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Revision {
    /// Number of the epoch.
    pub seq: u64,
    /// 0 for the immediate answer, 1 for the smoothed one.
    pub revision: u32,
}

/// A format of solutions.
///
/// Bytes are appended to a buffer, so that the same code writes a file and streams an answer. The
/// document is complete after [`Encoder::finish`].
pub(crate) trait Encoder: Send {
    /// Appends what precedes the first solution.
    fn begin(&mut self, out: &mut Vec<u8>);

    /// Appends one solution. `revision` is that of a stored one.
    fn push(&mut self, presented: &Presented<'_>, revision: Option<Revision>, out: &mut Vec<u8>);

    /// Appends what follows the last solution.
    fn finish(&mut self, out: &mut Vec<u8>);
}

/// What solutions have beside what every solution has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Additions {
    /// Number and revision, since they are stored ones.
    pub(super) is_stored: bool,
    /// The frame of the position, since one was asked for or a base states its own.
    pub(super) has_frame: bool,
    /// The height above the geoid.
    pub(super) has_geoid: bool,
}

impl Additions {
    /// What solutions of this presentation have.
    pub(super) const fn new(presentation: &Presentation, is_stored: bool) -> Self {
        let Presentation { names_frames: has_frame, geoid, .. } = presentation;
        Self { is_stored, has_frame: *has_frame, has_geoid: geoid.is_some() }
    }
}

/// All solutions as one text, as they are computed. For tests.
#[cfg(test)]
pub(super) fn text_of(encoder: &mut dyn Encoder, solutions: &[crate::gnss::Solution]) -> String {
    let presented: Vec<_> = solutions.iter().map(Presented::as_computed).collect();
    text_of_presented(encoder, &presented)
}

/// All solutions as one text. For tests.
#[cfg(test)]
pub(super) fn text_of_presented(encoder: &mut dyn Encoder, all: &[Presented<'_>]) -> String {
    let mut out = Vec::new();
    encoder.begin(&mut out);
    all.iter().for_each(|presented| encoder.push(presented, None, &mut out));
    encoder.finish(&mut out);
    String::from_utf8(out).expect("every format is text")
}

/// A position at 47° 17.11399' N, 8° 33.91590' E, 499.6 m, at 2019-04-28T12:58:04 UTC. For tests.
#[cfg(test)]
pub(super) fn sample(status: crate::gnss::Status) -> crate::gnss::Solution {
    use nalgebra::{Matrix3, Vector3};

    use crate::gnss::{
        Dops, Geodetic, GpsTime, LocalFrame, Provenance, RelativeEstimate, Solution,
        SolutionEstimate, Status, Velocity,
    };

    let time = GpsTime::from_week_seconds(2051, 46_702.0);
    let position = Geodetic::from_degrees(47.285_233_166, 8.565_265, 499.6).to_ecef();
    let to_ecef = LocalFrame::at(position).rotation.transpose();
    // East, north, up: σ of 1, 2 and 3 m.
    let enu = Matrix3::from_diagonal(&Vector3::new(1.0, 4.0, 9.0));
    let velocity = Velocity {
        // 3 m/s east, 4 m/s north.
        velocity_m_s: to_ecef * Vector3::new(3.0, 4.0, 0.0),
        covariance: Matrix3::identity(),
        clock_drift_m_s: 0.0,
    };
    let relative = (Status::Float <= status).then(|| RelativeEstimate {
        baseline_m: Vector3::zeros(),
        age_s: 1.5,
        ambiguities: 0,
        fixed_ambiguities: 0,
        ratio: None,
        success_rate: None,
        fix_probability: None,
    });
    let estimate = SolutionEstimate {
        position,
        covariance: to_ecef * enu * to_ecef.transpose(),
        velocity: Some(velocity),
        clock_m: 0.0,
        inter_system_biases_m: Vec::new(),
        reception_time: time,
        dops: Dops { gdop: 2.0, pdop: 1.5, hdop: 1.04, vdop: 1.1, tdop: 1.2 },
        satellites_used: ["E11", "G01", "G05"].map(|name| name.parse().expect("valid")).to_vec(),
        relative,
    };
    Solution {
        time,
        status,
        estimate: Some(estimate),
        protection: None,
        reasons: Vec::new(),
        provenance: Provenance::default(),
    }
}

/// The same solution in ETRF2000 of 2019.5, with the geoid 46.5 m above the ellipsoid. For tests.
#[cfg(test)]
pub(super) fn referred(solution: &crate::gnss::Solution) -> Presented<'_> {
    let geoid_height_m = Some(46.5).filter(|_| solution.estimate.is_some());
    let (frame, epoch_year) = ("ETRF2000", Some(2019.5));
    Presented { frame, epoch_year, geoid_height_m, ..Presented::as_computed(solution) }
}

/// What such solutions have. For tests.
#[cfg(test)]
pub(super) const REFERRED: Additions =
    Additions { is_stored: false, has_frame: true, has_geoid: true };
