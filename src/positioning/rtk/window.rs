//! The sliding window on differences against a base: each epoch answered as it comes, and again.

use std::ops::Range;

use nalgebra::Matrix3;

use crate::config::PositioningOptions;
use crate::gnss::{GpsTime, Reason, Solution};
use crate::graph::{BorderLife, Covariances, Elimination, Smoother, System, Workspace};
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::fgo::{SlidingWindow, WindowScratch};
use crate::positioning::setup::Setup;
use crate::snapshot::state_fields;

use super::answer::{Findings, solution};
use super::chain::Chain;
use super::epoch::{STATE, Scratch, State};
use super::float::FloatSolution;
use super::front::{Front, FrontScratch, UsableBase};
use super::history::{History, Window};
use super::integers::Integers;
use super::tracking::Tracking;

/// Distance from the frame's origin at which the graph starts anew (m): up has turned by 1°.
pub(super) const FRAME_LIMIT_M: f64 = 1e5;
/// Times that slips are looked for in one epoch.
pub(super) const SLIP_ROUNDS: usize = 3;

/// An estimator over a sliding window of differences.
#[derive(Debug)]
pub(in crate::positioning) struct RtkWindow {
    chain: Chain,
    front: Front,
    /// Answers while there is no base to use.
    stand_in: Option<Box<SlidingWindow>>,
    /// The epochs to be answered again, if any are.
    history: Option<History>,
}

state_fields!(RtkWindow { chain, front, stand_in, history });

/// Memory to compute in.
#[derive(Debug)]
pub(in crate::positioning) struct RtkWindowScratch {
    front: FrontScratch,
    alone: WindowScratch,
    rows: Scratch,
    integers: Integers,
    workspace: Workspace<STATE>,
    covariances: Covariances<STATE>,
    smoother: Smoother<STATE>,
    oldest: (System<STATE>, Elimination<STATE>),
}

impl Default for RtkWindowScratch {
    fn default() -> Self {
        Self {
            front: FrontScratch::default(),
            alone: WindowScratch::default(),
            rows: Scratch::default(),
            integers: Integers::default(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            smoother: Smoother::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
        }
    }
}

impl Engine for RtkWindow {
    type Scratch = RtkWindowScratch;

    fn new(_setup: &Setup, revises: bool) -> Self {
        Self {
            chain: Chain::new(),
            front: Front::default(),
            stand_in: None,
            history: revises.then(History::default),
        }
    }

    fn fits(&self, setup: &Setup) -> bool {
        self.stand_in.as_ref().is_none_or(|stand_in| stand_in.fits(setup))
    }

    /// An epoch that is not after the last one is answered by itself and changes nothing. Without a
    /// base that can be used the answer is that of a window without one, with the reason; what is
    /// known of the ambiguities stays for the base's return. With another base the window begins
    /// again.
    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RtkWindowScratch,
        revisions: &mut Vec<Solution>,
    ) -> Solution {
        let (setup, options) = (inputs.setup, inputs.options());
        if self.front.changes_base(inputs, &mut scratch.front) {
            self.answer_all(setup, scratch, revisions);
            self.chain.clear();
            self.chain.tracking = Tracking::new();
        }
        let arcs = &mut self.chain.tracking.arcs;
        if let Some(alone) = self.front.receive(inputs, arcs, &mut scratch.front) {
            return alone;
        }
        let solution = match self.relative(inputs, scratch, revisions) {
            Ok(solution) => {
                self.stand_in = None;
                if let Some(history) = &mut self.history {
                    history.push(solution.clone(), &self.chain.tracking, &options.rtk);
                }
                solution
            }
            Err(reason) => {
                let stand_in =
                    self.stand_in.get_or_insert_with(|| Box::new(SlidingWindow::new(setup, false)));
                let mut solution = stand_in.advance(inputs, &mut scratch.alone, &mut Vec::new());
                solution.reasons.extend(scratch.front.reasons_alone(reason));
                if let Some(history) = &mut self.history {
                    history.push_alone(solution.clone());
                }
                solution
            }
        };
        if let Some(history) = &self.history {
            let due = history.due(inputs.epoch.time, &options.graph);
            self.revise(due.clone(), setup, scratch);
            if !setup.is_batch {
                self.leave(due.end, revisions);
            }
        }
        solution
    }

    fn finish(
        &mut self,
        setup: &Setup,
        scratch: &mut RtkWindowScratch,
        revisions: &mut Vec<Solution>,
    ) {
        self.answer_all(setup, scratch, revisions);
    }

    fn oldest_unrevised(&self) -> Option<GpsTime> {
        self.history.as_ref()?.oldest_time()
    }
}

impl RtkWindow {
    /// Answers some epochs again, where the window can be gone back from.
    fn revise(&mut self, epochs: Range<usize>, setup: &Setup, scratch: &mut RtkWindowScratch) {
        let RtkWindowScratch { rows, integers, workspace, smoother, .. } = scratch;
        let (Some(history), chain) = (&mut self.history, &self.chain) else { return };
        if history.has_graph(epochs.clone())
            && chain.factor(&setup.relative, rows, workspace).is_ok()
        {
            let Chain { estimate, frame, .. } = chain;
            let (elimination, resolver) = (&workspace.elimination, &mut integers.resolver);
            let window = Window { elimination, estimate, frame, smoother, resolver };
            history.revise(epochs, window, &setup.options.rtk);
        }
    }

    /// Answers the oldest epochs for good.
    fn leave(&mut self, count: usize, revisions: &mut Vec<Solution>) {
        let history = self.history.as_mut().filter(|_| 0 < count);
        revisions.extend(history.map(|history| history.leave(count)).unwrap_or_default());
    }

    /// Answers all epochs for good: nothing of the chain will be gone back to.
    fn leave_all(&mut self, revisions: &mut Vec<Solution>) {
        self.leave(self.history.as_ref().map_or(0, |history| history.all().end), revisions);
        self.history = self.history.is_some().then(History::default);
    }

    /// Answers all epochs again, and for good.
    fn answer_all(
        &mut self,
        setup: &Setup,
        scratch: &mut RtkWindowScratch,
        revisions: &mut Vec<Solution>,
    ) {
        self.revise(self.history.as_ref().map_or(0..0, History::all), setup, scratch);
        self.leave_all(revisions);
    }

    /// The answer relative to the base, or why there is none.
    fn relative(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RtkWindowScratch,
        revisions: &mut Vec<Solution>,
    ) -> Result<Solution, Reason> {
        let base = self.front.usable_base(inputs, &mut scratch.front)?;
        let guess = self.guess(inputs, scratch, revisions)?;
        let place = self.chain.place(&guess);
        let arcs = &mut self.chain.tracking.arcs;
        self.front.difference(inputs, place, base.station, arcs, &mut scratch.front)?;
        let (differences, rows) = (&scratch.front.differences, &mut scratch.rows);
        self.chain.append(inputs.epoch.time, guess, differences, inputs.setup, rows);
        if self.solve(inputs.setup, scratch).is_none() {
            self.chain.clear();
            self.leave_all(revisions);
            return Err(Reason::NotConverged);
        }
        scratch.covariances.newest(&scratch.workspace.elimination);
        self.chain.learn_noise(&position_covariance(&scratch.covariances), &mut scratch.rows);
        Ok(self.answer(base, inputs.options(), scratch))
    }

    /// Where the rover is about now; the chain begins again where it cannot tell.
    fn guess(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RtkWindowScratch,
        revisions: &mut Vec<Solution>,
    ) -> Result<State, Reason> {
        let (time, options) = (inputs.epoch.time, inputs.options());
        if let Some(last) = self.chain.last_time() {
            let guess = self.chain.predicted(time);
            let is_near = guess.fixed_rows::<3>(0).norm() < FRAME_LIMIT_M;
            if options.rtk.single_epoch {
                self.answer_all(inputs.setup, scratch, revisions);
                self.chain.begin(self.chain.place(&guess));
                return Ok(State::zeros());
            }
            if time - last <= options.graph.gap_s && is_near {
                return Ok(guess);
            }
        }
        let alone = scratch.front.single_point.solve(inputs, None);
        let estimate = alone.estimate.ok_or(Reason::NotConverged)?;
        self.answer_all(inputs.setup, scratch, revisions);
        self.chain.begin(estimate.position);
        let mut guess = State::zeros();
        if let Some(velocity) = &estimate.velocity {
            let local = self.chain.frame.rotation * velocity.velocity_m_s;
            guess.fixed_rows_mut::<3>(3).copy_from(&local);
        }
        Ok(guess)
    }

    /// Forgets the epochs that leave and solves the window, slips cut out.
    fn solve(&mut self, setup: &Setup, scratch: &mut RtkWindowScratch) -> Option<()> {
        let RtkWindowScratch { front, rows, workspace, oldest, .. } = scratch;
        let (chain, settings) = (&mut self.chain, &setup.relative);
        while setup.options.rtk.window_epochs < chain.epochs.len() {
            chain.forget_oldest(settings, self.history.as_mut(), rows, oldest).ok()?;
        }
        for _ in 0..SLIP_ROUNDS {
            chain.solve(settings, rows, workspace).ok()?;
            if !chain.cut_slips(settings, &mut front.slipped, rows) {
                break;
            }
        }
        Some(())
    }

    fn answer(
        &mut self,
        base: UsableBase<'_>,
        options: &PositioningOptions,
        scratch: &mut RtkWindowScratch,
    ) -> Solution {
        let RtkWindowScratch { front, rows, integers, covariances, .. } = scratch;
        let covariance = position_covariance(covariances);
        let Chain { tracking, estimate, epochs, frame, .. } = &mut self.chain;
        let epoch = epochs.last().expect("a window that was solved has an epoch");
        let state = estimate.states.last().expect("one state for each epoch");
        let variables = covariances.variables().iter();
        let ambiguities = variables.map(|&variable| estimate.border[variable]).collect();
        let float = FloatSolution::of_graph(state, ambiguities, covariances);
        let residuals = tracking.residuals(epochs, &estimate.states, &covariance, rows);
        let border = &estimate.border;
        let resolution =
            tracking.resolve(integers, epoch, border, &float, &residuals, options, rows);
        let reasons = front.reasons(epoch.time, &tracking.arcs);
        let findings = Findings {
            frame,
            epoch,
            state,
            covariance: covariances.state(),
            differences: &front.differences,
            resolution,
            reasons,
            base,
            options: &options.rtk,
        };
        solution(findings)
    }
}

/// Of the newest position (m²).
fn position_covariance(covariances: &Covariances<STATE>) -> Matrix3<f64> {
    covariances.state().fixed_view::<3, 3>(0, 0).into_owned()
}
