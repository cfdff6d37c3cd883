//! From a state of the graph to a solution.

use nalgebra::SMatrix;

use crate::gnss::{Reason, Solution, Status};
use crate::positioning::answer::Answer;
use crate::positioning::factors::{Line, STATE};
use crate::positioning::ranging::Ranging;
use crate::positioning::setup::Setup;
use crate::positioning::uncertainty::{ErrorModel, Residuals};

use super::chain::Chain;
use super::epoch::GraphEpoch;

/// The variance factor uses residuals of epochs within this time (s).
const NEIGHBOURS_S: f64 = 15.0;

/// Scratch for answers.
#[derive(Debug, Default)]
pub(super) struct AnswerScratch {
    lines: Vec<Line>,
    weights: Vec<f64>,
}

/// The solution of state `k` with its covariance.
pub(super) fn solution(
    chain: &Chain,
    k: usize,
    covariance: &SMatrix<f64, STATE, STATE>,
    setup: &Setup,
    scratch: &mut AnswerScratch,
) -> Solution {
    let (epoch, state) = (&chain.epochs[k], &chain.estimate.states[k]);
    let biases_m = &chain.estimate.border;
    let kernel = setup.alone.kernels.last().pseudorange;
    let AnswerScratch { lines, weights } = scratch;
    let factors = &*epoch.factors;
    factors.see(state, lines);
    weights.clear();
    let residual = |range: &Ranging| range.linearize(lines, state, biases_m).residual;
    weights.extend(factors.ranges.iter().map(|range| range.direct(residual(range), &kernel)));
    let mut reasons = Vec::new();
    factors.aiding_reasons(&mut reasons);
    reasons.extend(chain.unproven_s(epoch.time).map(|age_s| Reason::StartUnproven { age_s }));
    let answer = Answer {
        status: Status::Fgo,
        time: epoch.time,
        frame: &chain.frame,
        state,
        covariance,
        biases_m,
        lines,
        ranges: &factors.ranges,
        weights,
        has_velocity: factors.carries_velocity(),
        errors: ErrorModel {
            repetition: epoch.repetition,
            variance_factor: residuals_around(chain, k).variance_factor(),
            orbit_clock_m2: setup.options.graph.orbit_clock_sigma_m.powi(2),
        },
        reasons,
    };
    answer.solution()
}

/// Sums of the residuals of epoch `k` and its neighbours.
fn residuals_around(chain: &Chain, k: usize) -> Residuals {
    let time = chain.epochs[k].time;
    let near = |epoch: &GraphEpoch| (epoch.time - time).abs() <= NEIGHBOURS_S;
    let before = chain.epochs[..k].iter().rev().take_while(|epoch| near(epoch));
    let after = chain.epochs[k..].iter().take_while(|epoch| near(epoch));
    let mut sum = Residuals::default();
    before.chain(after).for_each(|epoch| sum.add(&epoch.residuals));
    sum
}
