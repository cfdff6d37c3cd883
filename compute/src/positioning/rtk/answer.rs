//! From a state with its ambiguities to a solution.

use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::config::RtkOptions;
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    BaseEpochIssue, Ecef, Enu, LocalFrame, Provenance, Reason, RelativeEstimate, Solution,
    SolutionEstimate, Status, Velocity,
};
use crate::graph::median;
use crate::graph::shared_offset;
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::factors::VELOCITY;
use crate::positioning::geometry::{Geometry, UNDETERMINED};
use crate::positioning::setup::OFFSET_KERNEL;

use super::ambiguity::Resolution;
use super::observed::{RtkEpoch, STATE, State, UsableBase};

/// What the solution of an epoch is made from.
pub(crate) struct AnswerParts<'a> {
    /// Frame of the state.
    pub(crate) frame: &'a LocalFrame,
    pub(crate) epoch: &'a RtkEpoch,
    pub(crate) state: &'a State,
    /// Of the state.
    pub(crate) covariance: &'a SMatrix<f64, STATE, STATE>,
    pub(crate) has_velocity: bool,
    pub(crate) differences: &'a SingleDifferences,
    /// Factor on the variance of a position without integers.
    pub(crate) float_factor: f64,
    pub(crate) resolution: Resolution,
    pub(crate) base: UsableBase<'a>,
    pub(crate) reasons: Vec<Reason>,
    pub(crate) options: &'a RtkOptions,
}

/// Standard deviation of the zenith wet delay's decrease with height, relative to the standard
/// atmosphere's (m/m). The zenith wet delay at sea level is 0 to 0.4 m, in the standard atmosphere
/// 0.1 m, and water vapour decreases to 1/e in some 2 km: 0.1 m/2 km.
const WET_DELAY_GRADIENT: f64 = 5e-5;
/// Error of the height by a zenith delay at one of two receivers: Beutler, Bauersima, Gurtner,
/// Rothacher, Schildknecht & Geiger (1988), *Atmospheric refraction and other important biases in
/// GPS carrier phase observations*: 3 mm for each millimetre.
const HEIGHT_BY_ZENITH_DELAY: f64 = 3.0;

/// Covariance of a position by the atmosphere over a baseline (ENU, m), ENU (m²).
///
/// The ionosphere's gradient lasts for minutes and is the same for all satellites, so its effect
/// does not average out. σ is g·d in each horizontal direction and 2·g·d in height, because the
/// delay has the same sign on all satellites. A difference in height adds the troposphere.
pub(crate) fn atmosphere_covariance(
    options: &RtkOptions,
    baseline_m: &Vector3<f64>,
) -> Matrix3<f64> {
    let ionosphere_m = options.ionosphere_gradient * baseline_m.norm();
    let troposphere_m = HEIGHT_BY_ZENITH_DELAY * WET_DELAY_GRADIENT * baseline_m.z;
    let mut covariance = Matrix3::from_diagonal_element(ionosphere_m * ionosphere_m);
    covariance[(2, 2)] = (2.0 * ionosphere_m).powi(2) + troposphere_m * troposphere_m;
    covariance
}

/// The solution of an epoch.
pub(crate) fn solution(parts: AnswerParts<'_>) -> Solution {
    let AnswerParts { frame, epoch, state, covariance, differences, .. } = parts;
    let (resolution, base, mut reasons) = (parts.resolution, parts.base, parts.reasons);
    let rotation = &frame.rotation;
    let to_ecef = |c: &Matrix3<f64>| rotation.transpose() * c * rotation;
    let (status, local, uncertainty, held, probability) = match resolution.outcome {
        Ok(fixed) => {
            let probability = Some(fixed.probability);
            (Status::Fixed, fixed.position, fixed.covariance, fixed.held, probability)
        }
        Err(reason) => {
            reasons.extend(Some(reason).filter(|_| parts.options.resolve));
            let local = state.fixed_rows::<3>(0).into_owned();
            let uncertainty = covariance.fixed_view::<3, 3>(0, 0) * parts.float_factor;
            (Status::Float, local, uncertainty, 0, None)
        }
    };
    reasons.extend(base.position_warning);
    let position = frame.to_ecef(Enu(local));
    let baseline_m = position.0 - base.station.antenna_reference_point.0;
    let uncertainty = uncertainty + atmosphere_covariance(parts.options, &(rotation * baseline_m));
    let mut used: Vec<_> = differences.list.iter().map(|d| d.common).collect();
    used.sort_unstable_by_key(|&common| differences.satellites[common].satellite);
    used.dedup();
    let of = |common: &usize| &differences.satellites[*common];
    let velocity = state.fixed_rows::<3>(VELOCITY).into_owned();
    let velocity_covariance = covariance.fixed_view::<3, 3>(VELOCITY, VELOCITY).into_owned();
    let at = state.fixed_rows::<3>(0).into_owned();
    let slope = |common: usize| epoch.sights[common].range(&at).1;
    let geometry = Geometry::of(used.iter().map(|c| (of(c).satellite.constellation, slope(*c))));
    let clock_m = clock_m(epoch, differences, &used, &local);
    let estimate = SolutionEstimate {
        position,
        covariance: to_ecef(&uncertainty),
        velocity: parts.has_velocity.then(|| Velocity {
            velocity_m_s: rotation.transpose() * velocity,
            covariance: to_ecef(&velocity_covariance),
            clock_drift_m_s: clock_drift_m_s(epoch, &velocity),
        }),
        clock_m,
        inter_system_biases_m: Vec::new(),
        reception_time: epoch.time - clock_m / SPEED_OF_LIGHT,
        dops: geometry.map_or(UNDETERMINED, |geometry| geometry.dops()),
        satellites_used: used.iter().map(|common| of(common).satellite).collect(),
        relative: Some(RelativeEstimate {
            baseline_m,
            age_s: base.age_s,
            ambiguities: resolution.ambiguities,
            fixed_ambiguities: held,
            ratio: resolution.ratio,
            success_rate: resolution.success_rate,
            fix_probability: probability,
        }),
    };
    let ephemerides = used.iter().map(|c| of(c).ephemeris).collect();
    let (name, time) = (base.station.name.clone(), epoch.time - base.age_s);
    let provenance = Provenance { ephemerides, base: Some(BaseEpochIssue { base: name, time }) };
    let estimate = Some(estimate);
    Solution { time: epoch.time, status, estimate, protection: None, reasons, provenance }
}

/// The answer without integers, or that of the companion if its horizontal covariance is smaller.
pub(crate) fn better_known(float: Solution, companion: Solution, options: &RtkOptions) -> Solution {
    let (Some(own), Some(mut other)) = (&float.estimate, companion.estimate) else { return float };
    let Some(relative) = &own.relative else { return float };
    let baseline_m = relative.baseline_m + (other.position.0 - own.position.0);
    let rotation = LocalFrame::at(own.position).rotation;
    let atmosphere = atmosphere_covariance(options, &(rotation * baseline_m));
    other.covariance += rotation.transpose() * atmosphere * rotation;
    let horizontal_m2 = |e: &SolutionEstimate| horizontal_m2(e.position, &e.covariance);
    if horizontal_m2(own) <= horizontal_m2(&other) {
        return float;
    }
    other.relative = Some(RelativeEstimate { baseline_m, ambiguities: 0, ..relative.clone() });
    let mut reasons = float.reasons.clone();
    let is_new = |reason: &Reason| !float.reasons.contains(reason);
    reasons.extend(companion.reasons.into_iter().filter(is_new));
    let provenance = Provenance { base: float.provenance.base, ..companion.provenance };
    Solution { estimate: Some(other), reasons, provenance, ..float }
}

/// Whether an answer is that of the companion, which has no ambiguities.
pub(crate) fn is_by_companion(solution: &Solution) -> bool {
    let relative = solution.estimate.as_ref().and_then(|estimate| estimate.relative.as_ref());
    solution.status == Status::Float && relative.is_some_and(|relative| relative.ambiguities == 0)
}

/// Sum of a position's variances along east and north (m²), from its ECEF covariance.
pub(crate) fn horizontal_m2(position: Ecef, covariance: &Matrix3<f64>) -> f64 {
    let rotation = LocalFrame::at(position).rotation;
    (rotation * covariance * rotation.transpose()).fixed_view::<2, 2>(0, 0).trace()
}

/// The answer at another local position, with its covariance; velocity and clock stay.
pub(crate) fn moved(
    solution: &Solution,
    frame: &LocalFrame,
    (position, covariance): (&Vector3<f64>, &Matrix3<f64>),
    options: &RtkOptions,
) -> Solution {
    let mut solution = solution.clone();
    let rotation = &frame.rotation;
    if let Some(estimate) = &mut solution.estimate {
        let moved = frame.to_ecef(Enu(*position));
        let mut covariance = *covariance;
        if let Some(relative) = &mut estimate.relative {
            relative.baseline_m += moved.0 - estimate.position.0;
            covariance += atmosphere_covariance(options, &(rotation * relative.baseline_m));
        }
        estimate.position = moved;
        estimate.covariance = rotation.transpose() * covariance * rotation;
    }
    solution
}

/// The rover's clock drift (m/s): the common offset of its Doppler shifts at a velocity; zero
/// without any.
fn clock_drift_m_s(epoch: &RtkEpoch, velocity: &Vector3<f64>) -> f64 {
    let rows: Vec<_> = epoch.rates.iter().map(|rate| rate.linearize_sharing(velocity)).collect();
    shared_offset(&rows, &OFFSET_KERNEL, &mut Vec::new())
}

/// The rover's clock (m): the median of the first constellation's pseudoranges less the ranges, so
/// that a wild pseudorange does not shift it. It includes the ionospheric delay, which differences
/// cancel.
fn clock_m(
    epoch: &RtkEpoch,
    differences: &SingleDifferences,
    used: &[usize],
    local: &Vector3<f64>,
) -> f64 {
    let constellation = |common: usize| differences.satellites[common].satellite.constellation;
    let first = used.iter().map(|&common| constellation(common)).min();
    let of_first = used.iter().filter(|&&common| Some(constellation(common)) == first);
    let clock_m = |&common: &usize| {
        let (range_m, _) = epoch.sights[common].range(local);
        differences.satellites[common].rover_range_m - range_m
    };
    median(&mut of_first.map(clock_m).collect::<Vec<_>>()).unwrap_or(0.0)
}

/// Whether a reason states why an epoch is not fixed.
pub(crate) fn keeps_from_fixing(reason: &Reason) -> bool {
    matches!(
        reason,
        Reason::RatioBelowThreshold { .. }
            | Reason::SuccessRateTooLow { .. }
            | Reason::FixRejected
            | Reason::FixImprecise { .. }
            | Reason::TooFewCommonSatellites { .. }
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};

    /// 1 mm/km over 13 km; 3·0.05 mm/m over 5 km of height.
    #[test]
    fn the_atmosphere_over_a_baseline_worked_by_hand() {
        let mut options = PositioningOptions::new(Mode::RtkFgo, Profile::General).rtk;
        options.ionosphere_gradient = 1e-6;
        let found = atmosphere_covariance(&options, &Vector3::new(12_000.0, 0.0, 5_000.0));
        let expected = Vector3::new(0.013_f64.powi(2), 0.013_f64.powi(2), 0.026_f64.powi(2));
        let expected = Matrix3::from_diagonal(&(expected + Vector3::new(0.0, 0.0, 0.75 * 0.75)));
        assert!((found - expected).norm() < 1e-12, "{found}");
    }
}
