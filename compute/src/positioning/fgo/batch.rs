//! The whole chain at once: all epochs first, then all answers.
//!
//! The mixture kernel has many minima, and the noise and clocks of the receiver must be known
//! before the epochs can be weighted. Both come from a sliding window that runs over the epochs
//! first. Each epoch uses the receiver model that the window had learnt before it. The chain is
//! solved from the last state of each epoch in the window. Other kernels are annealed, starting
//! from single-point positions.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use crate::gnss::{Ecef, Enu, GpsTime, Reason, Solution};
use crate::graph::{BorderLife, Covariances, Workspace};
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::factors::{CLOCK, DRIFT, STATE, VELOCITY, position};
use crate::positioning::setup::Setup;
use crate::positioning::spp::SinglePoint;

use super::answer::{AnswerScratch, solution};
use super::chain::{Chain, ChainScratch};
use super::window::{SlidingWindow, WindowScratch};

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
    /// `None` with other kernels than the mixture.
    first_pass: Option<Box<FirstPass>>,
}

/// The sliding window that is run first.
#[derive(Debug)]
struct FirstPass {
    window: SlidingWindow,
    scratch: WindowScratch,
    /// The last state of each epoch in the window.
    states: BTreeMap<GpsTime, WindowState>,
    /// Whether the start of the window was proven since the chain began.
    is_proven: bool,
}

/// A state of the window; frames of window and chain may differ.
#[derive(Clone, Copy, Debug)]
struct WindowState {
    position: Ecef,
    /// ECEF (m/s).
    velocity_m_s: Vector3<f64>,
    clock_m: f64,
    drift_m_s: f64,
}

impl FirstPass {
    fn new(setup: &Setup) -> Self {
        let window = SlidingWindow::new(setup, false);
        let (scratch, states) = (WindowScratch::default(), BTreeMap::new());
        Self { window, scratch, states, is_proven: false }
    }

    fn advance(&mut self, inputs: &EpochInputs<'_>) {
        let Self { window, scratch, states, is_proven } = self;
        window.advance(inputs, scratch, &mut Vec::new());
        *is_proven |= window.chain.is_proven;
        let Chain { frame, epochs, estimate, .. } = &window.chain;
        states.extend(epochs.iter().zip(&estimate.states).map(|(epoch, state)| {
            let velocity_m_s = state.fixed_rows::<3>(VELOCITY).into_owned();
            let state = WindowState {
                position: frame.to_ecef(Enu(position(state))),
                velocity_m_s: frame.rotation.transpose() * velocity_m_s,
                clock_m: state[CLOCK],
                drift_m_s: state[DRIFT],
            };
            (epoch.time, state)
        }));
    }

    /// Sets the chain's states and biases to those of the window. If the window's position was
    /// proven, so is that of the chain, which has all its epochs.
    fn set_start(&mut self, chain: &mut Chain) {
        chain.is_proven = std::mem::take(&mut self.is_proven);
        let Chain { frame, epochs, estimate, .. } = chain;
        for (epoch, state) in epochs.iter().zip(&mut estimate.states) {
            let Some(first_pass) = self.states.get(&epoch.time) else { continue };
            state.fixed_rows_mut::<3>(0).copy_from(&frame.to_enu(first_pass.position).0);
            state
                .fixed_rows_mut::<3>(VELOCITY)
                .copy_from(&(frame.rotation * first_pass.velocity_m_s));
            (state[CLOCK], state[DRIFT]) = (first_pass.clock_m, first_pass.drift_m_s);
        }
        let biases_m = &self.window.chain.estimate.border;
        estimate.border.iter_mut().zip(biases_m).for_each(|(own, known)| *own = *known);
    }
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
            first_pass: setup.learns.then(|| Box::new(FirstPass::new(setup))),
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
        let before = |satellite| self.chain.ephemeris(satellite);
        measurements.follow_ephemerides(before, receiver, epoch.time, navigation);
        if let Some(first_pass) = &mut self.first_pass {
            self.chain.receiver = first_pass.window.chain.receiver.clone();
            first_pass.advance(inputs);
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
        if let Some(first_pass) = &mut self.first_pass {
            first_pass.set_start(chain);
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
