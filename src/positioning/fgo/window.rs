//! The sliding window: each epoch answered as it comes, and again when it leaves.

use std::sync::Arc;

use nalgebra::SMatrix;

use crate::config::{DopplerUse, PositioningOptions};
use crate::gnss::{Enu, Epoch, GpsTime, Navigation, Reason, Solution};
use crate::graph::{
    BorderLife, Covariances, Elimination, Phase, Problem, System, Workspace, optimize,
};
use crate::positioning::Measurements;
use crate::positioning::factors::{DRIFT, STATE, State, VELOCITY, position};
use crate::positioning::spp::SinglePoint;
use crate::positioning::velocity::VelocityEstimator;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::answer::{AnswerMemory, solution};
use super::chain::Chain;
use super::epoch::GraphEpoch;
use super::settings::Settings;

/// Epochs a window holds at least, however far apart they are.
const EPOCHS_MIN: usize = 10;
/// Distance from the frame's origin at which the graph starts anew (m): up has turned by 1°.
const FRAME_LIMIT_M: f64 = 1e5;

/// A causal estimator over a sliding window.
#[derive(Debug)]
pub(in crate::positioning) struct SlidingWindow {
    settings: Arc<Settings>,
    chain: Chain,
    revisions: Option<Vec<Solution>>,
    single_point: SinglePoint,
    velocity: VelocityEstimator,
    measurements: Measurements,
    workspace: Workspace<STATE>,
    covariances: Covariances<STATE>,
    smoothed: Vec<SMatrix<f64, STATE, STATE>>,
    oldest: (System<STATE>, Elimination<STATE>),
    answer: AnswerMemory,
}

impl SlidingWindow {
    /// One that has seen nothing; with `revises`, epochs are answered again when they leave.
    pub(in crate::positioning) fn new(options: &PositioningOptions, revises: bool) -> Self {
        let ring = match options.graph.motion {
            true => 0,
            false => options.graph.window_epochs_max + 1,
        };
        Self {
            settings: Arc::new(Settings::new(&options.graph)),
            chain: Chain::new(ring),
            revisions: revises.then(Vec::new),
            single_point: SinglePoint::new(options),
            velocity: VelocityEstimator::default(),
            measurements: Measurements::default(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            smoothed: Vec::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
            answer: AnswerMemory::default(),
        }
    }

    /// Answers one epoch.
    ///
    /// An epoch that is not after the last one is answered by itself and changes nothing.
    pub(in crate::positioning) fn advance(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Solution {
        let Some(last) = self.chain.last_time() else {
            return self.restart(epoch, navigation, options);
        };
        let interval_s = epoch.time - last;
        if interval_s <= 0.0 {
            return self.single_point.solve(epoch, navigation, options, None);
        }
        let guess = self.chain.predicted(epoch.time);
        let is_far = FRAME_LIMIT_M < position(&guess).norm();
        if options.graph.gap_s < interval_s || is_far {
            return self.restart(epoch, navigation, options);
        }
        self.measurements.gather(epoch, navigation, options);
        let place = self.chain.frame.to_ecef(Enu(position(&guess)));
        if self.measurements.place(place, epoch.time, navigation, options).is_none() {
            return self.restart(epoch, navigation, options);
        }
        let leaving = self.leaving(epoch.time, options);
        self.revise(leaving);
        self.append(epoch.time, guess, options);
        match self.solve(leaving, options) {
            Some(solution) => solution,
            None => {
                self.chain.drop_newest();
                self.restart(epoch, navigation, options)
            }
        }
    }

    /// Revises every epoch still in the window; returns all revisions not yet taken.
    pub(in crate::positioning) fn finish(&mut self) -> Vec<Solution> {
        self.revise(self.chain.epochs.len());
        self.take_revisions()
    }

    /// Answers of the epochs that have left the window since the last call.
    pub(in crate::positioning) fn take_revisions(&mut self) -> Vec<Solution> {
        self.revisions.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Begins a new chain from the epoch's own position.
    fn restart(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Solution {
        self.revise(self.chain.epochs.len());
        self.chain.clear();
        let alone = self.single_point.solve(epoch, navigation, options, None);
        let Some(estimate) = &alone.estimate else {
            return self.unanswered(alone);
        };
        self.measurements.gather(epoch, navigation, options);
        let placed = self.measurements.place(estimate.position, epoch.time, navigation, options);
        if placed.is_none() {
            return self.unanswered(alone);
        }
        self.chain.begin(estimate.position);
        let mut guess = State::zeros();
        if let Some(velocity) = &estimate.velocity {
            let local = self.chain.frame.rotation * velocity.velocity_m_s;
            guess.fixed_rows_mut::<3>(VELOCITY).copy_from(&local);
            guess[DRIFT] = velocity.clock_drift_m_s;
        }
        self.append(epoch.time, guess, options);
        match self.solve(0, options) {
            Some(solution) => solution,
            None => {
                self.chain.clear();
                self.unanswered(alone)
            }
        }
    }

    /// An answer of the epoch alone, which no revision will follow.
    fn unanswered(&mut self, mut alone: Solution) -> Solution {
        if alone.estimate.is_some() {
            alone.reasons.push(Reason::NotConverged);
        }
        if let Some(revisions) = &mut self.revisions {
            revisions.push(alone.clone());
        }
        alone
    }

    fn append(&mut self, time: GpsTime, guess: State, options: &PositioningOptions) {
        let place = self.chain.frame.to_ecef(Enu(position(&guess)));
        let list = &self.measurements.list;
        let is_used = |index: usize| list[index].is_above_mask;
        let velocity = match options.graph.doppler {
            DopplerUse::Velocity => self.velocity.estimate(place, list, is_used, options),
            DopplerUse::None | DopplerUse::Satellites => None,
        };
        let local = velocity.map(|velocity| self.chain.frame.rotation * velocity.velocity_m_s);
        let (settings, measurements) = (&self.settings, &self.measurements);
        self.chain.append(time, guess, measurements, local, options, settings);
    }

    /// How many of the oldest epochs leave when one at `time` comes.
    fn leaving(&self, time: GpsTime, options: &PositioningOptions) -> usize {
        let epochs = &self.chain.epochs;
        let count = epochs.len() + 1;
        let over = count.saturating_sub(options.graph.window_epochs_max);
        if self.chain.unproven_s(time).is_some() {
            // What is marginalised cannot be doubted any more.
            return over;
        }
        let late = epochs.iter().filter(|epoch| options.graph.window_s < time - epoch.time).count();
        over.max(late.min(count.saturating_sub(EPOCHS_MIN)))
    }

    /// Answers the oldest `count` epochs again, from all that the window has seen.
    ///
    /// Linearised anew where the window stands, so that no factor of an earlier solve is state. A
    /// window whose normal equations cannot be factored leaves its first answers as they are.
    fn revise(&mut self, count: usize) {
        let Some(revisions) = &mut self.revisions else { return };
        if count == 0 {
            return;
        }
        let Workspace { system, elimination, .. } = &mut self.workspace;
        let estimate = std::mem::take(&mut self.chain.estimate);
        system.reset(estimate.states.len(), estimate.border.len());
        self.chain.rows(&self.settings).linearize(&estimate, Phase::Graduated(1.0), system);
        self.chain.estimate = estimate;
        if elimination.factor(system, 0.0).is_err() {
            return;
        }
        self.covariances.all_states(elimination, &mut self.smoothed);
        for (k, covariance) in self.smoothed.iter().enumerate().take(count) {
            let (chain, settings) = (&self.chain, &self.settings);
            revisions.push(solution(chain, k, covariance, settings, &mut self.answer));
        }
    }

    /// Forgets the epochs that leave and solves the window; `None` if it cannot be solved.
    fn solve(&mut self, leaving: usize, options: &PositioningOptions) -> Option<Solution> {
        let Self { chain, settings, workspace, oldest, .. } = self;
        for _ in 0..leaving {
            chain.forget_oldest(settings, options.graph.bias_walk_m, oldest).ok()?;
        }
        // Until the first epoch is forgotten, its minimum can still be left for a better one.
        let how = if chain.has_past() { &settings.update } else { &settings.whole };
        let mut estimate = std::mem::take(&mut chain.estimate);
        let solved = optimize(&mut chain.rows(settings), &mut estimate, how, workspace);
        chain.estimate = estimate;
        solved.ok()?;
        chain.weigh_residuals(settings);
        self.covariances.newest(&self.workspace.elimination);
        let (newest, covariance) = (self.chain.epochs.len() - 1, self.covariances.state());
        Some(solution(&self.chain, newest, covariance, &self.settings, &mut self.answer))
    }
}

impl SlidingWindow {
    /// Writes what the next answers depend on, all of which [`Clone`] copies; the settings follow
    /// from the options, and revisions not yet taken are left out.
    pub(in crate::positioning) fn save(&self, writer: &mut SnapshotWriter) {
        self.revisions.is_some().save(writer);
        self.chain.save(writer);
    }

    /// The window that was written, by the options it was made with.
    pub(in crate::positioning) fn load(
        options: &PositioningOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        let revises = bool::load(reader)?;
        let fresh = Self::new(options, revises);
        let chain = Chain::load(reader)?;
        match chain.ring() == fresh.chain.ring() {
            true => Ok(Self { chain, ..fresh }),
            false => Err(reader.invalid("ring of biases")),
        }
    }

    /// Swaps the memory both work in.
    pub(in crate::positioning) fn exchange_memory(&mut self, other: &mut Self) {
        #[rustfmt::skip]
        let Self {
            settings: _, chain, revisions: _, single_point, velocity, measurements, workspace,
            covariances, smoothed, oldest, answer,
        } = self;
        chain.exchange_memory(&mut other.chain);
        single_point.exchange_memory(&mut other.single_point);
        std::mem::swap(velocity, &mut other.velocity);
        std::mem::swap(measurements, &mut other.measurements);
        std::mem::swap(workspace, &mut other.workspace);
        std::mem::swap(covariances, &mut other.covariances);
        std::mem::swap(smoothed, &mut other.smoothed);
        std::mem::swap(oldest, &mut other.oldest);
        std::mem::swap(answer, &mut other.answer);
    }

    /// Gives back the room that the epochs do not need.
    pub(in crate::positioning) fn release_surplus(&mut self) {
        self.chain.epochs.iter_mut().for_each(GraphEpoch::release_surplus);
    }

    /// Time of the oldest epoch that has not left the window.
    pub(in crate::positioning) fn oldest_time(&self) -> Option<GpsTime> {
        self.chain.epochs.first().map(|epoch| epoch.time)
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for SlidingWindow {
    fn clone(&self) -> Self {
        Self {
            settings: self.settings.clone(),
            chain: self.chain.clone(),
            revisions: self.revisions.clone(),
            single_point: self.single_point.with_fresh_memory(),
            velocity: VelocityEstimator::default(),
            measurements: Measurements::default(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            smoothed: Vec::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
            answer: AnswerMemory::default(),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.settings.clone_from(&source.settings);
        self.chain.clone_from(&source.chain);
        self.single_point.answer_like(&source.single_point);
        self.revisions.clone_from(&source.revisions);
    }
}
