//! The sliding window: each epoch is answered at once, and revised when it leaves.

use nalgebra::{SMatrix, Vector3};

use crate::config::PositioningOptions;
use crate::gnss::{Ecef, Enu, GpsTime, Reason, Solution};
use crate::graph::{BorderLife, Covariances, Elimination, System, Workspace};
use crate::positioning::Measurements;
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::factors::{DRIFT, STATE, State, VELOCITY, position};
use crate::positioning::setup::Setup;
use crate::positioning::spp::SinglePoint;
use crate::positioning::starts::{FRAME_LIMIT_M, WINDOW_EPOCHS_MIN};
use crate::snapshot::state_fields;

use super::answer::{AnswerScratch, solution};
use super::chain::{Chain, ChainScratch};

/// A causal estimator over a sliding window.
#[derive(Debug)]
pub(crate) struct SlidingWindow {
    /// Whether epochs are revised when they leave.
    revises: bool,
    pub(super) chain: Chain,
}

state_fields!(SlidingWindow { revises, chain });

/// Scratch of the window.
#[derive(Debug)]
pub(crate) struct WindowScratch {
    single_point: SinglePoint,
    measurements: Measurements,
    chain: ChainScratch,
    workspace: Workspace<STATE>,
    covariances: Covariances<STATE>,
    smoothed: Vec<SMatrix<f64, STATE, STATE>>,
    oldest: (System<STATE>, Elimination<STATE>),
    answer: AnswerScratch,
}

impl Default for WindowScratch {
    fn default() -> Self {
        Self {
            single_point: SinglePoint::default(),
            measurements: Measurements::default(),
            chain: ChainScratch::default(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            smoothed: Vec::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
            answer: AnswerScratch::default(),
        }
    }
}

impl Engine for SlidingWindow {
    type Scratch = WindowScratch;

    fn new(setup: &Setup, revises: bool) -> Self {
        Self { revises, chain: Chain::new(ring(&setup.options)) }
    }

    fn fits(&self, setup: &Setup) -> bool {
        self.chain.ring() == ring(&setup.options)
    }

    /// An epoch that is not after the last one is answered alone and does not change the state.
    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut WindowScratch,
        revisions: &mut Vec<Solution>,
    ) -> Solution {
        let (time, options) = (inputs.epoch.time, inputs.options());
        let Some(last) = self.chain.last_time() else {
            return self.restart(inputs, scratch, revisions);
        };
        let interval_s = time - last;
        if interval_s <= 0.0 {
            return scratch.single_point.solve(inputs, None);
        }
        let guess = self.chain.predicted(time);
        let is_far = FRAME_LIMIT_M < position(&guess).norm();
        if options.graph.gap_s < interval_s || is_far {
            return self.restart(inputs, scratch, revisions);
        }
        let receiver = self.chain.frame.to_ecef(Enu(position(&guess)));
        if scratch.measure(inputs, receiver).is_none() {
            return self.restart(inputs, scratch, revisions);
        }
        let before = |satellite| self.chain.ephemeris(satellite);
        scratch.measurements.follow_ephemerides(before, receiver, time, inputs.navigation);
        self.chain.append(
            inputs.epoch.time,
            guess,
            &scratch.measurements,
            inputs.setup,
            &mut scratch.chain,
        );
        let Some(solution) = self.solve(inputs.setup, scratch) else {
            self.chain.drop_newest();
            return self.restart(inputs, scratch, revisions);
        };
        if self.chain.is_refuted(&mut scratch.chain) && scratch.has_own_position(inputs) {
            self.chain.drop_newest();
            return self.restart(inputs, scratch, revisions);
        }
        self.learn(inputs.setup, scratch);
        self.let_leave(inputs.setup, scratch, revisions);
        solution
    }

    fn finish(
        &mut self,
        setup: &Setup,
        scratch: &mut WindowScratch,
        revisions: &mut Vec<Solution>,
    ) {
        self.revise_all(setup, scratch, revisions);
    }

    fn oldest_unrevised(&self) -> Option<GpsTime> {
        self.chain.epochs.first().map(|epoch| epoch.time)
    }
}

/// Largest number of epochs that each have separate biases; zero if the biases are constant.
fn ring(options: &PositioningOptions) -> usize {
    match options.graph.motion {
        true => 0,
        false => options.graph.window_epochs_max + 1,
    }
}

impl WindowScratch {
    /// Whether the epoch's own pseudoranges give a position.
    fn has_own_position(&mut self, inputs: &EpochInputs<'_>) -> bool {
        self.single_point.solve(inputs, None).estimate.is_some()
    }

    /// The epoch's measurements, corrected for a receiver at `receiver`; `None` for a position
    /// where no receiver can be.
    fn measure(&mut self, inputs: &EpochInputs<'_>, receiver: Ecef) -> Option<()> {
        let EpochInputs { epoch, navigation, bands, .. } = *inputs;
        self.measurements.gather(epoch, navigation, inputs.options(), bands);
        self.measurements.place(receiver, epoch.time, navigation, inputs.options())?;
        if let Some(corrected) = inputs.corrected {
            self.measurements.correct(corrected);
        }
        Some(())
    }
}

/// The position of an epoch, known from elsewhere.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KnownPosition {
    pub(crate) position: Ecef,
    /// Standard deviations east, north and up (m).
    pub(crate) sigma_m: Vector3<f64>,
}

impl SlidingWindow {
    /// Whether the chain has no epoch.
    pub(crate) fn is_empty(&self) -> bool {
        self.chain.epochs.is_empty()
    }

    /// Time of the chain's first epoch.
    pub(crate) fn started(&self) -> Option<GpsTime> {
        (!self.is_empty()).then_some(self.chain.started)
    }

    /// Empties the chain. What was learnt about the receiver stays.
    pub(crate) fn rest(&mut self) {
        self.chain.clear();
    }

    /// Marks the chain as settled at `now`: no search for other positions follows.
    pub(crate) fn settle(&mut self, now: GpsTime) {
        self.chain.watch.settle(now);
    }

    /// Begins a chain at an epoch whose position is known. If that fails, the chain is empty.
    pub(crate) fn begin_at(
        &mut self,
        known: &KnownPosition,
        inputs: &EpochInputs<'_>,
        scratch: &mut WindowScratch,
    ) {
        self.chain.clear();
        if self.try_begin_at(known, inputs, scratch).is_none() {
            self.chain.clear();
        }
    }

    fn try_begin_at(
        &mut self,
        known: &KnownPosition,
        inputs: &EpochInputs<'_>,
        scratch: &mut WindowScratch,
    ) -> Option<()> {
        let (setup, time) = (inputs.setup, inputs.epoch.time);
        scratch.measure(inputs, known.position)?;
        self.chain.begin(known.position);
        let WindowScratch { measurements, chain: chain_scratch, workspace, covariances, .. } =
            scratch;
        self.chain.append(time, State::zeros(), measurements, setup, chain_scratch);
        self.chain.know_position(&known.sigma_m);
        self.chain.solve(&setup.alone, &setup.alone.whole, chain_scratch, workspace).ok()?;
        covariances.newest(&workspace.elimination);
        self.learn(setup, scratch);
        Some(())
    }
}

impl SlidingWindow {
    /// Begins a new chain at the epoch's single-point position.
    fn restart(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut WindowScratch,
        revisions: &mut Vec<Solution>,
    ) -> Solution {
        self.revise_all(inputs.setup, scratch, revisions);
        self.chain.clear();
        let alone = scratch.single_point.solve(inputs, None);
        let started = self.start(&alone, inputs, scratch);
        started.unwrap_or_else(|| self.answer_by_single_point(alone, revisions))
    }

    /// Begins a chain with an epoch whose single-point solution is `alone`, and answers it.
    fn start(
        &mut self,
        alone: &Solution,
        inputs: &EpochInputs<'_>,
        scratch: &mut WindowScratch,
    ) -> Option<Solution> {
        let estimate = alone.estimate.as_ref()?;
        scratch.measure(inputs, estimate.position)?;
        self.chain.begin(estimate.position);
        let mut guess = State::zeros();
        if let Some(velocity) = &estimate.velocity {
            let local = self.chain.frame.rotation * velocity.velocity_m_s;
            guess.fixed_rows_mut::<3>(VELOCITY).copy_from(&local);
            guess[DRIFT] = velocity.clock_drift_m_s;
        }
        self.chain.append(
            inputs.epoch.time,
            guess,
            &scratch.measurements,
            inputs.setup,
            &mut scratch.chain,
        );
        let solution = self.solve(inputs.setup, scratch);
        match solution {
            Some(_) => self.learn(inputs.setup, scratch),
            None => self.chain.clear(),
        }
        solution
    }

    /// The single-point solution as the answer of an epoch outside the chain, also as its revision.
    fn answer_by_single_point(
        &self,
        mut alone: Solution,
        revisions: &mut Vec<Solution>,
    ) -> Solution {
        if alone.estimate.is_some() {
            alone.reasons.push(Reason::NotConverged);
        }
        if self.revises {
            revisions.push(alone.clone());
        }
        alone
    }

    /// Number of oldest epochs that leave, now that the newest is solved. The next epoch is
    /// expected after the same interval as the last one; with it the window has its full length
    /// again.
    fn leaving(&self, setup: &Setup) -> usize {
        let options = &setup.options.graph;
        let [.., before, newest] = self.chain.epochs.as_slice() else { return 0 };
        let (now, count) = (newest.time, self.chain.epochs.len() + 1);
        let over = count.saturating_sub(options.window_epochs_max);
        if !setup.learns && self.chain.unproven_s(now).is_some() {
            // A marginalised epoch cannot be corrected any more.
            return over;
        }
        let next = now + (now - before.time);
        let late = self.chain.epochs.iter().filter(|epoch| options.window_s < next - epoch.time);
        over.max(late.count().min(count.saturating_sub(WINDOW_EPOCHS_MIN)))
    }

    /// Revises and marginalises the oldest epochs of the window that was just solved.
    fn let_leave(
        &mut self,
        setup: &Setup,
        scratch: &mut WindowScratch,
        revisions: &mut Vec<Solution>,
    ) {
        let leaving = self.leaving(setup);
        if leaving == 0 {
            return;
        }
        self.revise(leaving, setup, scratch, revisions);
        let WindowScratch { chain: chain_scratch, oldest, .. } = scratch;
        let bias_walk_m = setup.options.graph.bias_walk_m;
        let mut forget =
            || self.chain.forget_oldest(&setup.alone, bias_walk_m, chain_scratch, oldest);
        if (0..leaving).any(|_| forget().is_err()) {
            // Without this prior the next epoch begins a new chain.
            self.revise_all(setup, scratch, revisions);
            self.chain.clear();
        }
    }

    /// Revises every epoch of the window. If the normal equations cannot be factored, their first
    /// answers stay.
    fn revise_all(
        &self,
        setup: &Setup,
        scratch: &mut WindowScratch,
        revisions: &mut Vec<Solution>,
    ) {
        let count = self.chain.epochs.len();
        let WindowScratch { chain, workspace, .. } = scratch;
        let is_due = self.revises && 0 < count;
        if is_due && self.chain.factor(&setup.alone, chain, workspace).is_ok() {
            self.revise(count, setup, scratch, revisions);
        }
    }

    /// Revises the oldest `count` epochs with all epochs of the window, which the workspace has
    /// factored.
    fn revise(
        &self,
        count: usize,
        setup: &Setup,
        scratch: &mut WindowScratch,
        revisions: &mut Vec<Solution>,
    ) {
        let WindowScratch { workspace, covariances, smoothed, answer, .. } = scratch;
        if !self.revises {
            return;
        }
        covariances.all_states(&workspace.elimination, smoothed);
        for (k, covariance) in smoothed.iter().enumerate().take(count) {
            revisions.push(solution(&self.chain, k, covariance, setup, answer));
        }
    }

    /// Learns from the newest epoch, after the window is solved.
    fn learn(&mut self, setup: &Setup, scratch: &mut WindowScratch) {
        if setup.learns {
            self.chain.learn(scratch.covariances.state(), &mut scratch.chain);
        }
    }

    /// Solves the window; `None` if it cannot be solved.
    fn solve(&mut self, setup: &Setup, scratch: &mut WindowScratch) -> Option<Solution> {
        let WindowScratch { chain: chain_scratch, workspace, covariances, answer, .. } = scratch;
        let (chain, settings) = (&mut self.chain, &setup.alone);
        // Until the first epoch is marginalised, the window can still move to a better minimum.
        // From a start that is metres off, the sharp kernels of phases lead to a wrong one.
        let is_near = chain.has_past() && chain_scratch.is_start_precise;
        let how = if is_near { &settings.update } else { &settings.whole };
        let cost = chain.solve(settings, how, chain_scratch, workspace).ok()?;
        if setup.learns && chain.lacks_redundancy() {
            chain.retry(cost, settings, chain_scratch, workspace).ok()?;
        }
        if setup.learns && chain.reconsider(chain_scratch) {
            chain.solve(settings, &settings.whole, chain_scratch, workspace).ok()?;
        }
        covariances.newest(&workspace.elimination);
        let newest = chain.epochs.len() - 1;
        Some(solution(chain, newest, covariances.state(), setup, answer))
    }
}
