//! From the newest state of the window to a solution.

use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Ecef, Enu, Provenance, Reason, RelativeEstimate, Solution, SolutionEstimate, Status, Velocity,
};
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::factors::VELOCITY;
use crate::positioning::geometry::{Geometry, UNDETERMINED};

use super::chain::Chain;
use super::epoch::STATE;
use super::integers::Resolution;

/// What the answer is made of beside the chain.
pub(super) struct Findings<'a> {
    pub(super) differences: &'a SingleDifferences,
    /// Of the newest state.
    pub(super) covariance: &'a SMatrix<f64, STATE, STATE>,
    pub(super) resolution: Resolution,
    pub(super) base: Ecef,
    pub(super) age_s: f64,
    pub(super) reasons: Vec<Reason>,
}

/// The solution of the newest state.
pub(super) fn solution(chain: &Chain, findings: Findings<'_>) -> Solution {
    let epoch = chain.epochs.last().expect("a window that was solved has an epoch");
    let state = chain.estimate.states.last().expect("one state for each epoch");
    let Findings { differences, covariance, resolution, base, age_s, mut reasons } = findings;
    let rotation = &chain.frame.rotation;
    let to_ecef = |c: &Matrix3<f64>| rotation.transpose() * c * rotation;
    let (status, place, uncertainty, held, probability) = match resolution.outcome {
        Ok(fixed) => {
            let probability = Some(fixed.probability);
            (Status::Fixed, fixed.position, fixed.covariance, fixed.held, probability)
        }
        Err(reason) => {
            reasons.push(reason);
            let place = state.fixed_rows::<3>(0).into_owned();
            let uncertainty = covariance.fixed_view::<3, 3>(0, 0).into_owned();
            (Status::Float, place, uncertainty, 0, None)
        }
    };
    let position = chain.frame.to_ecef(Enu(place));
    let mut used: Vec<_> = differences.list.iter().map(|d| d.common).collect();
    used.sort_unstable_by_key(|&common| differences.satellites[common].satellite);
    used.dedup();
    let of = |common: &usize| &differences.satellites[*common];
    let velocity = state.fixed_rows::<3>(VELOCITY).into_owned();
    let pace = covariance.fixed_view::<3, 3>(VELOCITY, VELOCITY).into_owned();
    let slopes = chain.slopes();
    let geometry = Geometry::of(used.iter().map(|c| (of(c).satellite.constellation, slopes[*c])));
    let clock_m = clock_m(chain, differences, &used, &place);
    let estimate = SolutionEstimate {
        position,
        covariance: to_ecef(&uncertainty),
        velocity: Some(Velocity {
            velocity_m_s: rotation.transpose() * velocity,
            covariance: to_ecef(&pace),
            clock_drift_m_s: 0.0,
        }),
        clock_m,
        inter_system_biases_m: Vec::new(),
        reception_time: epoch.time - clock_m / SPEED_OF_LIGHT,
        dops: geometry.map_or(UNDETERMINED, |geometry| geometry.dops()),
        satellites_used: used.iter().map(|common| of(common).satellite).collect(),
        relative: Some(RelativeEstimate {
            baseline_m: position.0 - base.0,
            age_s,
            ambiguities: resolution.ambiguities,
            fixed_ambiguities: held,
            ratio: resolution.ratio,
            success_rate: resolution.success_rate,
            fix_probability: probability,
        }),
    };
    let provenance = Provenance { ephemerides: used.iter().map(|c| of(c).ephemeris).collect() };
    Solution { time: epoch.time, status, estimate: Some(estimate), reasons, provenance }
}

/// The rover's clock (m), from the mean of the first constellation's pseudoranges: the ionosphere,
/// which differences cancel, is in it.
fn clock_m(
    chain: &Chain,
    differences: &SingleDifferences,
    used: &[usize],
    place: &Vector3<f64>,
) -> f64 {
    let epoch = chain.epochs.last().expect("a window that was solved has an epoch");
    let constellation = |c: &&usize| differences.satellites[**c].satellite.constellation;
    let Some(first) = used.iter().map(|c| constellation(&c)).min() else { return 0.0 };
    let mut count = 0;
    let mut sum_m = 0.0;
    for &common in used.iter().filter(|c| constellation(c) == first) {
        let (range_m, _) = epoch.sights[common].range(place);
        sum_m += differences.satellites[common].rover_range_m - range_m;
        count += 1;
    }
    sum_m / f64::from(count.max(1))
}
