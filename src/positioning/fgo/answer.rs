//! From a state of the graph to a solution.

use nalgebra::SMatrix;

use crate::gnss::{Solution, Status};
use crate::graph::Phase;
use crate::positioning::answer::Answer;
use crate::positioning::factors::STATE;
use crate::positioning::ranging::Ranging;

use super::chain::Chain;
use super::settings::Settings;

/// Weight from which on a pseudorange counts as used: a Geman–McClure kernel's at its width.
const USED_WEIGHT: f64 = 0.25;

/// The solution of state `k` with its covariance.
pub(super) fn solution(
    chain: &Chain,
    k: usize,
    covariance: &SMatrix<f64, STATE, STATE>,
    settings: &Settings,
) -> Solution {
    let (epoch, state) = (&chain.epochs[k], &chain.estimate.states[k]);
    let biases_m = &chain.estimate.border;
    let kernel = settings.kernels.pseudorange.at(Phase::Graduated(1.0));
    let is_used = |range: &&Ranging| {
        let row = range.factor.linearize(state, range.bias_m(biases_m));
        USED_WEIGHT <= kernel.weight(row.residual)
    };
    let answer = Answer {
        status: Status::Fgo,
        time: epoch.time,
        frame: &chain.frame,
        state,
        covariance,
        biases_m,
        ranges: &epoch.ranges,
        used: epoch.ranges.iter().filter(is_used).collect(),
        has_velocity: epoch.carries_velocity(),
        repetition: epoch.repetition,
        lasting_m2: settings.lasting_m2,
        reasons: epoch.reasons.clone(),
    };
    answer.solution()
}
