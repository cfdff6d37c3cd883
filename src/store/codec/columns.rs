//! Columns of a row that repeat values of its solution: some are needed to restore it, others serve
//! only readers of SQL.

use nalgebra::Matrix3;

use crate::gnss::{Ecef, GpsTime, LocalFrame, Solution, Status};

const MM_PER_M: f64 = 1e3;
const MS_PER_S: f64 = 1e3;

/// The columns that are needed to restore a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::store) struct SolutionColumns {
    /// Time tag of the epoch.
    pub time: GpsTime,
    /// ECEF position (m).
    pub position_m: [Option<f64>; 3],
}

/// Columns that readers of SQL ask for. The solution itself is in its bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::store) struct SolutionSummary {
    /// Standard deviations of the position to the east, north and up (mm).
    pub sigma_mm: [Option<i32>; 3],
    /// Ratio of second-best to best integers.
    pub ratio: Option<f32>,
    /// The epoch's time minus that of the base epoch (ms).
    pub base_age_ms: Option<i32>,
}

/// The stored number of a status. It never changes. A better status has a higher number.
pub(in crate::store) const fn status_number(status: Status) -> i16 {
    match status {
        Status::None => 0,
        Status::Single => 10,
        Status::Ekf => 15,
        Status::Fgo => 20,
        Status::Float => 30,
        Status::Fixed => 40,
    }
}

/// The columns of a solution. A position that SQLite would not return bit by bit is left out.
pub(in crate::store) fn solution_columns(solution: &Solution) -> SolutionColumns {
    let position = solution.estimate.as_ref().map(|estimate| estimate.position.0);
    let is_kept = |axis_m: &f64| axis_m.is_finite() && *axis_m != 0.0; // −0 would lose its sign.
    let position = position.filter(|position| position.iter().all(is_kept));
    let axis_m = |axis: usize| position.map(|position| position[axis]);
    SolutionColumns { time: solution.time, position_m: [axis_m(0), axis_m(1), axis_m(2)] }
}

/// The summary of a solution. What is not finite is left out.
pub(in crate::store) fn solution_summary(solution: &Solution) -> SolutionSummary {
    let Some(estimate) = &solution.estimate else { return SolutionSummary::default() };
    let relative = estimate.relative.as_ref();
    SolutionSummary {
        sigma_mm: sigmas_mm(estimate.position, &estimate.covariance),
        ratio: relative.and_then(|relative| relative.ratio).map(|ratio| ratio as f32),
        base_age_ms: relative.and_then(|relative| rounded(relative.age_s * MS_PER_S)),
    }
}

fn sigmas_mm(position: Ecef, covariance: &Matrix3<f64>) -> [Option<i32>; 3] {
    let local = LocalFrame::at(position).covariance_to_enu(covariance);
    [0, 1, 2].map(|axis| rounded(local[(axis, axis)].sqrt() * MM_PER_M))
}

/// The nearest integer, limited to the range of `i32`; `None` if the value is not finite.
fn rounded(value: f64) -> Option<i32> {
    value.is_finite().then(|| value.round() as i32) // The cast saturates.
}

#[cfg(test)]
mod tests {
    use crate::gnss::{Dops, Provenance, RelativeEstimate, SolutionEstimate};
    use nalgebra::Vector3;

    use super::*;

    /// At the equator and the Greenwich meridian, x is up, y east and z north.
    #[test]
    fn a_summary_has_sigmas_ratio_and_age() {
        let estimate = SolutionEstimate {
            position: Ecef::new(6_378_137.0, 0.0, 0.0),
            covariance: Matrix3::from_diagonal(&Vector3::new(4.0, 0.25, 1e-6)),
            velocity: None,
            clock_m: 0.0,
            inter_system_biases_m: Vec::new(),
            reception_time: GpsTime::EPOCH,
            dops: Dops { gdop: 1.0, pdop: 1.0, hdop: 1.0, vdop: 1.0, tdop: 1.0 },
            satellites_used: Vec::new(),
            relative: Some(RelativeEstimate {
                baseline_m: Vector3::zeros(),
                age_s: 1.2346,
                ambiguities: 0,
                fixed_ambiguities: 0,
                ratio: Some(3.5),
                success_rate: None,
                fix_probability: None,
            }),
        };
        let solution = Solution {
            time: GpsTime::EPOCH,
            status: Status::Float,
            estimate: Some(estimate),
            protection: None,
            reasons: Vec::new(),
            provenance: Provenance { ephemerides: Vec::new(), base: None },
        };
        let summary = solution_summary(&solution);
        assert_eq!(summary.sigma_mm, [Some(500), Some(1), Some(2_000)]);
        assert_eq!((summary.ratio, summary.base_age_ms), (Some(3.5), Some(1_235)));
        assert_eq!(rounded(f64::INFINITY), None);
        assert_eq!(rounded(1e12), Some(i32::MAX));
        let none = Solution::none(GpsTime::EPOCH, vec![]);
        assert_eq!(solution_summary(&none), SolutionSummary::default());
    }
}
