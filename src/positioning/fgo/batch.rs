//! The whole chain at once: all epochs first, then all answers.

use crate::config::{DopplerUse, PositioningOptions};
use crate::gnss::{Epoch, Navigation, Reason, Solution};
use crate::graph::{BorderLife, Covariances, Workspace, optimize};
use crate::positioning::factors::{DRIFT, STATE, VELOCITY};
use crate::positioning::spp::SinglePoint;
use crate::positioning::velocity::VelocityEstimator;

use super::answer::{AnswerMemory, solution};
use super::chain::Chain;
use super::settings::Settings;

/// A smoother over everything it is given.
#[derive(Debug)]
pub(in crate::positioning) struct WholeChain {
    settings: Settings,
    chain: Chain,
    /// What each epoch of the chain is by itself, for where the chain cannot be solved.
    alone: Vec<Solution>,
    solutions: Vec<Solution>,
    single_point: SinglePoint,
    velocity: VelocityEstimator,
    workspace: Workspace<STATE>,
}

impl WholeChain {
    /// One that has seen nothing.
    pub(in crate::positioning) fn new(options: &PositioningOptions) -> Self {
        Self {
            settings: Settings::new(&options.graph),
            chain: Chain::new(if options.graph.motion { 0 } else { usize::MAX }),
            alone: Vec::new(),
            solutions: Vec::new(),
            single_point: SinglePoint::new(options),
            velocity: VelocityEstimator::default(),
            workspace: Workspace::new(BorderLife::WhileTouched),
        }
    }

    /// Takes one epoch; those not after the last one are answered by themselves.
    pub(in crate::positioning) fn push(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) {
        let place = |solution: &Solution| Some(solution.estimate.as_ref()?.position);
        let start = self.alone.last().and_then(place);
        let alone = self.single_point.solve(epoch, navigation, options, start);
        let interval_s = self.chain.last_time().map(|last| epoch.time - last);
        if interval_s.is_some_and(|interval_s| interval_s <= 0.0) {
            self.solutions.push(alone);
            return;
        }
        if interval_s.is_some_and(|interval_s| options.graph.gap_s < interval_s) {
            self.solve();
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
        let place = self.chain.frame.to_ecef(crate::gnss::Enu(guess.fixed_rows::<3>(0).into()));
        let measurements = self.single_point.measurements();
        if alone.estimate.is_none()
            && measurements.place(place, epoch.time, navigation, options).is_none()
        {
            self.solutions.push(alone);
            return;
        }
        let list = &measurements.list;
        let is_used = |index: usize| list[index].is_above_mask;
        let velocity = match options.graph.doppler {
            DopplerUse::Velocity => self.velocity.estimate(place, list, is_used, options),
            DopplerUse::None | DopplerUse::Satellites => None,
        };
        let local = velocity.map(|velocity| self.chain.frame.rotation * velocity.velocity_m_s);
        self.chain.append(epoch.time, guess, measurements, local, options, &self.settings);
        self.alone.push(alone);
    }

    /// All answers, in order of time.
    pub(in crate::positioning) fn finish(&mut self) -> Vec<Solution> {
        self.solve();
        self.solutions.sort_by_key(|solution| solution.time);
        std::mem::take(&mut self.solutions)
    }

    /// Solves the chain, empties it and keeps its answers.
    fn solve(&mut self) {
        let Self { chain, settings, workspace, .. } = self;
        if chain.epochs.is_empty() {
            return;
        }
        let mut estimate = std::mem::take(&mut chain.estimate);
        let solved = optimize(&mut chain.rows(settings), &mut estimate, &settings.whole, workspace);
        chain.estimate = estimate;
        match solved {
            Ok(_) => {
                chain.weigh_residuals(settings);
                let (mut covariances, mut memory) = (Vec::new(), AnswerMemory::default());
                Covariances::new().all_states(&workspace.elimination, &mut covariances);
                for (k, covariance) in covariances.iter().enumerate() {
                    self.solutions.push(solution(chain, k, covariance, settings, &mut memory));
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
