//! The solution from an epoch's state, for estimators with states.

use nalgebra::{Matrix3, SMatrix};

use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Constellation, Enu, GpsTime, LocalFrame, Provenance, Reason, Solution, SolutionEstimate,
    Status, Velocity,
};

use super::factors::{CLOCK, DRIFT, Line, STATE, State, VELOCITY, position, velocity};
use super::geometry::{Geometry, UNDETERMINED};
use super::ranging::{Ranging, USED_WEIGHT};
use super::uncertainty::ErrorModel;

/// Standard deviation above which no position is reported (m).
pub(super) const SIGMA_MAX_M: f64 = 1e3;

/// The state of one epoch, with the inputs of its solution.
pub(super) struct Answer<'a> {
    /// Status of the solution.
    pub(super) status: Status,
    /// The receiver's time tag.
    pub(super) time: GpsTime,
    /// Local frame of the state.
    pub(super) frame: &'a LocalFrame,
    /// Position, velocity, clock and drift.
    pub(super) state: &'a State,
    /// Formal covariance of the state.
    pub(super) covariance: &'a SMatrix<f64, STATE, STATE>,
    /// Inter-system biases, by the index in the pseudoranges (m).
    pub(super) biases_m: &'a [f64],
    /// Lines of sight from the state's position.
    pub(super) lines: &'a [Line],
    /// All pseudoranges of the epoch.
    pub(super) ranges: &'a [Ranging],
    /// Kernel weight of each pseudorange, 0 … 1.
    pub(super) weights: &'a [f64],
    /// Whether the state's velocity is determined.
    pub(super) has_velocity: bool,
    /// Error model of the pseudoranges.
    pub(super) errors: ErrorModel,
    /// Reasons known before the estimate, such as missing ephemerides.
    pub(super) reasons: Vec<Reason>,
}

impl Answer<'_> {
    /// The solution with its reported covariance, which differs from the estimator's: see
    /// `uncertainty`.
    pub(super) fn solution(mut self) -> Solution {
        self.quality_reasons();
        let Self { frame, state, covariance, lines, ranges, weights, .. } = self;
        if SIGMA_MAX_M * SIGMA_MAX_M < covariance.fixed_view::<3, 3>(0, 0).trace() {
            return Solution::none(self.time, self.reasons);
        }
        let mut ephemerides = Vec::with_capacity(used(ranges, weights).count());
        ephemerides.extend(used(ranges, weights).map(Ranging::ephemeris));
        ephemerides.sort_unstable_by_key(|issue| issue.satellite);
        let geometry = Geometry::of(
            used(ranges, weights)
                .map(|range| (range.satellite.constellation, lines[usize::from(range.sight)].1)),
        );
        let formal = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let weighted = ranges.iter().zip(weights.iter().copied());
        let position_covariance = self.errors.covariance(&formal, lines, weighted);
        let to_ecef = |c: &Matrix3<f64>| frame.rotation.transpose() * c * frame.rotation;
        let velocity_covariance = covariance.fixed_view::<3, 3>(VELOCITY, VELOCITY).into_owned();
        let (clock_m, inter_system_biases_m) = clocks(ranges, self.biases_m, state[CLOCK]);
        let estimate = SolutionEstimate {
            position: frame.to_ecef(Enu(position(state))),
            covariance: to_ecef(&position_covariance),
            velocity: self.has_velocity.then(|| Velocity {
                velocity_m_s: frame.rotation.transpose() * velocity(state),
                covariance: to_ecef(&velocity_covariance),
                clock_drift_m_s: state[DRIFT],
            }),
            clock_m,
            inter_system_biases_m,
            reception_time: self.time - clock_m / SPEED_OF_LIGHT,
            dops: geometry.map_or(UNDETERMINED, |geometry| geometry.dops()),
            satellites_used: ephemerides.iter().map(|issue| issue.satellite).collect(),
            relative: None,
        };
        Solution {
            time: self.time,
            status: self.status,
            estimate: Some(estimate),
            protection: None,
            reasons: self.reasons,
            provenance: Provenance { ephemerides, base: None },
        }
    }

    /// Adds the reasons that follow from the pseudoranges used.
    fn quality_reasons(&mut self) {
        let (all, reasons) = (self.ranges.len(), &mut self.reasons);
        let (mut used_count, mut present) = (0, [false; Constellation::COUNT]);
        for range in used(self.ranges, self.weights) {
            used_count += 1;
            present[range.satellite.constellation.index()] = true;
        }
        if used_count < all {
            let mut satellites = Vec::with_capacity(all - used_count);
            let others = self.ranges.iter().zip(self.weights).filter(|(_, w)| !counts(**w));
            satellites.extend(others.map(|(range, _)| range.satellite));
            satellites.sort_unstable();
            reasons.push(Reason::SatellitesExcluded { satellites });
        }
        let needed = 3 + present.iter().filter(|present| **present).count().max(1);
        if used_count < needed {
            reasons.push(Reason::TooFewSatellites { used: used_count, needed });
        } else if used_count == needed {
            reasons.push(Reason::NoRedundancy);
        }
        if used_count < all - used_count {
            let ratio = (all - used_count) as f64 / used_count.max(1) as f64;
            reasons.push(Reason::ResidualsTooLarge { ratio });
        }
    }
}

/// Whether a pseudorange with this weight counts as used.
fn counts(weight: f64) -> bool {
    USED_WEIGHT <= weight
}

/// The pseudoranges that count as used.
fn used<'a>(ranges: &'a [Ranging], weights: &'a [f64]) -> impl Iterator<Item = &'a Ranging> {
    ranges.iter().zip(weights).filter(|(_, weight)| counts(**weight)).map(|(range, _)| range)
}

/// Clock of the first constellation present (m), and each further one minus it.
fn clocks(ranges: &[Ranging], biases_m: &[f64], clock_m: f64) -> (f64, Vec<(Constellation, f64)>) {
    let bias_m = |constellation: Constellation| {
        let found = ranges.iter().find(|range| range.satellite.constellation == constellation);
        found.map(|range| (constellation, range.bias_m(biases_m)))
    };
    let mut present = Constellation::ALL.into_iter().filter_map(bias_m);
    let Some((_, first_m)) = present.next() else {
        return (clock_m, Vec::new());
    };
    (clock_m + first_m, present.map(|(c, bias_m)| (c, bias_m - first_m)).collect())
}
