//! Solutions for tests.

use nalgebra::{Matrix3, Vector3};

use crate::gnss::{
    Dops, Ecef, Enu, GpsTime, LocalFrame, Provenance, RelativeEstimate, Solution, SolutionEstimate,
    Status,
};

/// On the equator and the meridian of Greenwich.
pub(super) const PLACE: Ecef = Ecef::new(6_378_137.0, 0.0, 0.0);

/// A solution this far east of [`PLACE`], with a standard deviation of a metre; a fix has integers.
pub(super) fn solution(second: usize, east_m: f64, status: Status) -> Solution {
    let time = GpsTime::from_week_seconds(2300, second as f64);
    let fixed = status == Status::Fixed;
    let relative = RelativeEstimate {
        baseline_m: Vector3::zeros(),
        age_s: 0.0,
        ambiguities: 8,
        fixed_ambiguities: 8,
        ratio: Some(4.0),
        success_rate: Some(0.99),
        fix_probability: Some(0.99),
    };
    let estimate = SolutionEstimate {
        position: LocalFrame::at(PLACE).to_ecef(Enu(Vector3::new(east_m, 0.0, 0.0))),
        covariance: Matrix3::identity(),
        velocity: None,
        clock_m: 0.0,
        inter_system_biases_m: Vec::new(),
        reception_time: time,
        dops: Dops { gdop: 2.0, pdop: 1.5, hdop: 1.0, vdop: 1.0, tdop: 1.0 },
        satellites_used: Vec::new(),
        relative: fixed.then_some(relative),
    };
    let provenance = Provenance::default();
    let (estimate, reasons) = (Some(estimate), Vec::new());
    Solution { time, status, estimate, protection: None, reasons, provenance }
}
