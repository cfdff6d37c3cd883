//! The whole chain at once: all epochs first, then all answers.

use crate::gnss::{Enu, Reason, Solution};
use crate::graph::{BorderLife, Covariances, Workspace};
use crate::positioning::engine::EpochInputs;
use crate::positioning::factors::{DRIFT, STATE, VELOCITY, position};
use crate::positioning::setup::Setup;
use crate::positioning::spp::SinglePoint;

use super::answer::{AnswerScratch, solution};
use super::chain::{Chain, ChainScratch};

/// A smoother over a whole recording.
#[derive(Debug)]
pub(crate) struct WholeChain {
    chain: Chain,
    /// The single-point solution of each epoch in the chain, used if the chain cannot be solved.
    alone: Vec<Solution>,
    solutions: Vec<Solution>,
    single_point: SinglePoint,
    scratch: ChainScratch,
    workspace: Workspace<STATE>,
}

impl WholeChain {
    /// A chain without epochs.
    pub(crate) fn new(setup: &Setup) -> Self {
        Self {
            chain: Chain::new(if setup.options.graph.motion { 0 } else { usize::MAX }),
            alone: Vec::new(),
            solutions: Vec::new(),
            single_point: SinglePoint::default(),
            scratch: ChainScratch::default(),
            workspace: Workspace::new(BorderLife::WhileTouched),
        }
    }

    /// Adds one epoch. An epoch that is not after the last one is answered by its single-point
    /// solution.
    pub(crate) fn push(&mut self, inputs: &EpochInputs<'_>) {
        let EpochInputs { epoch, navigation, .. } = *inputs;
        let options = inputs.options();
        let position_of = |solution: &Solution| Some(solution.estimate.as_ref()?.position);
        let start = self.alone.last().and_then(position_of);
        let alone = self.single_point.solve(inputs, start);
        let interval_s = self.chain.last_time().map(|last| epoch.time - last);
        if interval_s.is_some_and(|interval_s| interval_s <= 0.0) {
            self.solutions.push(alone);
            return;
        }
        if interval_s.is_some_and(|interval_s| options.graph.gap_s < interval_s) {
            self.solve(inputs.setup);
        }
        let mut guess = self.chain.predicted(epoch.time);
        if let Some(estimate) = &alone.estimate {
            if self.chain.last_time().is_none() {
                self.chain.begin(estimate.position);
            }
            guess.fixed_rows_mut::<3>(0).copy_from(&self.chain.frame.to_enu(estimate.position).0);
            if let Some(velocity) = &estimate.velocity {
                let local = self.chain.frame.rotation * velocity.velocity_m_s;
                guess.fixed_rows_mut::<3>(VELOCITY).copy_from(&local);
                guess[DRIFT] = velocity.clock_drift_m_s;
            }
        } else if self.chain.last_time().is_none() {
            self.solutions.push(alone);
            return;
        }
        let receiver = self.chain.frame.to_ecef(Enu(position(&guess)));
        let measurements = self.single_point.measurements();
        if alone.estimate.is_none()
            && measurements.place(receiver, epoch.time, navigation, options).is_none()
        {
            self.solutions.push(alone);
            return;
        }
        self.chain.append(epoch.time, guess, measurements, inputs.setup, &mut self.scratch);
        self.alone.push(alone);
    }

    /// All answers, in order of time.
    pub(crate) fn finish(mut self, setup: &Setup) -> Vec<Solution> {
        self.solve(setup);
        self.solutions.sort_by_key(|solution| solution.time);
        self.solutions
    }

    /// Solves the chain, empties it and keeps its answers.
    fn solve(&mut self, setup: &Setup) {
        let Self { chain, scratch, workspace, .. } = self;
        if chain.epochs.is_empty() {
            return;
        }
        match chain.solve(&setup.alone, &setup.alone.whole, scratch, workspace) {
            Ok(_) => {
                let (mut covariances, mut answer) = (Vec::new(), AnswerScratch::default());
                Covariances::new().all_states(&workspace.elimination, &mut covariances);
                for (k, covariance) in covariances.iter().enumerate() {
                    self.solutions.push(solution(chain, k, covariance, setup, &mut answer));
                }
                self.alone.clear();
            }
            Err(_) => {
                for mut alone in self.alone.drain(..) {
                    alone.reasons.push(Reason::NotConverged);
                    self.solutions.push(alone);
                }
            }
        }
        chain.clear();
    }
}
