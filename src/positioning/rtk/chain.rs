//! The window of epochs in the graph: how it begins, grows and forgets.

use nalgebra::Matrix3;

use crate::gnss::{Ecef, Enu, GpsTime, LocalFrame, SatelliteId};
use crate::graph::{
    Departure, Elimination, EliminationError, Estimate, Phase, Prior, Problem, System, Workspace,
    optimize,
};
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::factors::{ComponentFactor, MotionFactor, VELOCITY};
use crate::positioning::setup::{GraphSettings, Setup};
use crate::snapshot::state_fields;

use super::epoch::{Rows, RtkEpoch, STATE, Scratch, State};
use super::history::History;
use super::tracking::Tracking;

/// Deviation of the first position about its start (m): says nearly nothing.
pub(super) const START_M: f64 = 1e4;
/// Deviation of the first velocity about zero, per axis (m/s).
pub(super) const START_M_S: f64 = 100.0;

/// The epochs in the graph, their estimate, and the prior of those before.
#[derive(Debug)]
pub(super) struct Chain {
    pub(super) frame: LocalFrame,
    pub(super) epochs: Vec<RtkEpoch>,
    pub(super) estimate: Estimate<STATE>,
    pub(super) prior: Prior<STATE>,
    pub(super) tracking: Tracking,
}

state_fields!(Chain { frame, epochs, estimate, prior, tracking } checked by is_whole);

impl Chain {
    fn is_whole(&self) -> bool {
        let border = self.estimate.border.len();
        self.epochs.len() == self.estimate.states.len()
            && self.epochs.iter().all(|epoch| epoch.is_within(border))
            && self.prior.variables().all(|variable| variable < border)
            && self.tracking.arcs.is_within(border)
    }

    /// An empty chain.
    pub(super) fn new() -> Self {
        Self {
            frame: LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0)),
            epochs: Vec::new(),
            estimate: Estimate::new(),
            prior: Prior::none(),
            tracking: Tracking::new(),
        }
    }

    /// Time of the newest epoch.
    pub(super) fn last_time(&self) -> Option<GpsTime> {
        self.epochs.last().map(|epoch| epoch.time)
    }

    /// Forgets everything and puts the origin at `start`.
    pub(super) fn begin(&mut self, start: Ecef) {
        self.clear();
        self.frame = LocalFrame::at(start);
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.epochs.clear();
        self.estimate.states.clear();
        self.estimate.border.clear();
        self.prior = Prior::none();
        self.tracking.clear();
    }

    /// Where the newest state will be at `time`, if nothing happens.
    pub(super) fn predicted(&self, time: GpsTime) -> State {
        let (Some(last), Some(state)) = (self.last_time(), self.estimate.states.last()) else {
            return State::zeros();
        };
        let interval_s = time - last;
        let mut next = *state;
        for axis in 0..3 {
            next[axis] += interval_s * state[VELOCITY + axis];
        }
        next
    }

    /// The ECEF position of a state.
    pub(super) fn place(&self, state: &State) -> Ecef {
        self.frame.to_ecef(Enu(state.fixed_rows::<3>(0).into_owned()))
    }

    /// Adds an epoch whose state is about `guess`.
    pub(super) fn append(
        &mut self,
        time: GpsTime,
        guess: State,
        differences: &SingleDifferences,
        setup: &Setup,
        scratch: &mut Scratch,
    ) {
        let mut epoch = RtkEpoch::new();
        epoch.time = time;
        let interval_s = self.last_time().map(|last| time - last);
        epoch.motion = interval_s.map(|interval_s| MotionFactor::new(&setup.motion, interval_s));
        if interval_s.is_none() {
            let mut add = |column: usize, sigma: f64| {
                let (mean, inverse_sigma) = (guess[column], sigma.recip());
                epoch.components.push(ComponentFactor { column, mean, inverse_sigma });
            };
            (0..3).for_each(|axis| add(axis, START_M));
            (VELOCITY..STATE).for_each(|rate| add(rate, START_M_S));
        }
        let Self { tracking, frame, estimate, .. } = self;
        let (border, options) = (&mut estimate.border, &setup.options);
        tracking.fill(&mut epoch, frame, &guess, differences, border, options, scratch);
        self.estimate.states.push(guess);
        self.epochs.push(epoch);
    }

    /// Solves the window.
    pub(super) fn solve(
        &mut self,
        settings: &GraphSettings,
        scratch: &mut Scratch,
        workspace: &mut Workspace<STATE>,
    ) -> Result<(), EliminationError> {
        let is_young = self.epochs.iter().any(|epoch| epoch.motion.is_none());
        let how = if is_young { &settings.whole } else { &settings.update };
        let Self { epochs, estimate, prior, .. } = self;
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, scratch };
        optimize(&mut rows, estimate, how, workspace).map(|_| ())
    }

    /// Factors the window where it stands; no factor of an earlier solve is state.
    pub(super) fn factor(
        &self,
        settings: &GraphSettings,
        scratch: &mut Scratch,
        workspace: &mut Workspace<STATE>,
    ) -> Result<(), EliminationError> {
        let Workspace { system, elimination, .. } = workspace;
        let Self { epochs, estimate, prior, .. } = self;
        system.reset(estimate.states.len(), estimate.border.len());
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, scratch };
        rows.linearize(estimate, Phase::Graduated(1.0), system);
        elimination.factor(system, 0.0)
    }

    /// Begins the arcs anew whose newest phase contradicts the others; returns whether any did.
    pub(super) fn cut_slips(
        &mut self,
        settings: &GraphSettings,
        slipped: &mut Vec<SatelliteId>,
        scratch: &mut Scratch,
    ) -> bool {
        let Self { epochs, estimate, tracking, .. } = self;
        let (Some(epoch), Some(state)) = (epochs.last_mut(), estimate.states.last()) else {
            return false;
        };
        let kernel = settings.kernels.last().phase;
        tracking.cut_slips(epoch, state, &mut estimate.border, &kernel, slipped, scratch)
    }

    /// Learns from the newest epoch how noisy pseudoranges are, by its position's covariance.
    pub(super) fn learn_noise(&mut self, covariance: &Matrix3<f64>, scratch: &mut Scratch) {
        let Self { epochs, estimate, tracking, .. } = self;
        if let (Some(epoch), Some(state)) = (epochs.last(), estimate.states.last()) {
            tracking.learn_noise(epoch, state, &estimate.border, covariance, scratch);
        }
    }

    /// Marginalises the oldest epoch into the prior, and with it the ambiguities nothing names.
    /// `history`, if there is one, learns how what is gone depends on what stays.
    pub(super) fn forget_oldest(
        &mut self,
        settings: &GraphSettings,
        history: Option<&mut History>,
        scratch: &mut Scratch,
        (system, elimination): &mut (System<STATE>, Elimination<STATE>),
    ) -> Result<(), EliminationError> {
        let carried = self.prior.variables().count();
        let kernels = settings.kernels.last();
        system.reset(2, self.estimate.border.len());
        self.prior.add_to(0, &self.estimate, system);
        self.epochs[0].add_to(0, &self.estimate, &kernels, scratch, system);
        self.epochs[1].add_tie_to(0, &self.estimate, system);
        let (arcs, later) = (&self.tracking.arcs, &self.epochs[1..]);
        let over =
            |variable: usize| !arcs.has(variable) && !later.iter().any(|e| e.names(variable));
        self.prior.marginalize(system, &self.estimate, over, elimination)?;
        if let Some(history) = history {
            history.depart(Departure::of(elimination, &self.estimate, carried));
        }
        self.epochs.remove(0);
        self.estimate.states.remove(0);
        let Self { tracking, epochs, prior, .. } = self;
        tracking.arcs.release(|variable| {
            epochs.iter().any(|epoch| epoch.names(variable))
                || prior.variables().any(|known| known == variable)
        });
        Ok(())
    }
}
