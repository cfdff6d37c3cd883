//! The window of epochs in the graph: how it starts, grows and is marginalised.

use crate::gnss::{GpsTime, LocalFrame, SatelliteId};
use crate::graph::{
    Departure, Elimination, EliminationError, Estimate, Prior, Problem, System, Widening,
    Workspace, optimize,
};
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::factors::{ComponentFactor, MotionFactor, VELOCITY};
use crate::positioning::rtk::observed::{
    NewRows, RowScratch, Rows, RtkEpoch, STATE, Slips, State, cut_slips, fill,
};
use crate::positioning::rtk::tracking::Tracking;
use crate::positioning::setup::{GraphSettings, Setup};
use crate::positioning::starts::{START_M, START_M_S, start_frame};
use crate::snapshot::state_fields;

use super::history::History;

/// The epochs in the graph, their estimate, and the prior of the marginalised ones.
#[derive(Debug)]
pub(crate) struct Chain {
    pub(crate) frame: LocalFrame,
    pub(crate) epochs: Vec<RtkEpoch>,
    pub(crate) estimate: Estimate<STATE>,
    pub(crate) prior: Prior<STATE>,
    pub(crate) tracking: Tracking,
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
    pub(crate) fn empty() -> Self {
        Self {
            frame: start_frame(),
            epochs: Vec::new(),
            estimate: Estimate::new(),
            prior: Prior::none(),
            tracking: Tracking::new(),
        }
    }

    /// The newest state, extrapolated to `time` by its velocity.
    pub(crate) fn expected(&self, time: GpsTime) -> State {
        let (Some(last), Some(state)) = (self.epochs.last(), self.estimate.states.last()) else {
            return State::zeros();
        };
        let interval_s = time - last.time;
        let mut next = *state;
        for axis in 0..3 {
            next[axis] += interval_s * state[VELOCITY + axis];
        }
        next
    }

    /// Adds an epoch whose state is approximately `guess`.
    pub(crate) fn append(
        &mut self,
        time: GpsTime,
        guess: State,
        differences: &SingleDifferences,
        setup: &Setup,
        scratch: &mut RowScratch,
    ) {
        let interval_s = self.epochs.last().map(|last| time - last.time);
        let mut epoch = RtkEpoch { time, ..RtkEpoch::default() };
        epoch.motion = interval_s.map(|interval_s| MotionFactor::new(&setup.motion, interval_s));
        if interval_s.is_none() {
            let mut add = |column: usize, sigma: f64| {
                let (mean, inverse_sigma) = (guess[column], sigma.recip());
                epoch.components.push(ComponentFactor { column, mean, inverse_sigma });
            };
            (0..3).for_each(|axis| add(axis, START_M));
            (VELOCITY..STATE).for_each(|rate| add(rate, START_M_S));
        }
        let Self { tracking: Tracking { arcs, receivers, .. }, frame, estimate, .. } = self;
        let (border, options) = (&mut estimate.border, &setup.options);
        #[rustfmt::skip]
        let new = NewRows {
            frame, guess: &guess, differences, options, arcs, receivers, border, scratch,
        };
        fill(&mut epoch, new);
        self.estimate.states.push(guess);
        self.epochs.push(epoch);
    }

    /// Moves the estimate to the minimum of the objective.
    pub(crate) fn optimize(
        &mut self,
        settings: &GraphSettings,
        scratch: &mut RowScratch,
        workspace: &mut Workspace<STATE>,
    ) -> Result<(), EliminationError> {
        let is_young = self.epochs.iter().any(|epoch| epoch.motion.is_none());
        let how = if is_young { &settings.whole } else { &settings.update };
        let Self { epochs, estimate, prior, .. } = self;
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, scratch };
        optimize(&mut rows, estimate, how, workspace).map(|_| ())
    }

    /// Linearises and factors the window at its estimate.
    pub(crate) fn factor(
        &self,
        settings: &GraphSettings,
        scratch: &mut RowScratch,
        workspace: &mut Workspace<STATE>,
    ) -> Result<(), EliminationError> {
        let Workspace { system, elimination, .. } = workspace;
        let Self { epochs, estimate, prior, .. } = self;
        system.reset(estimate.states.len(), estimate.border.len());
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, scratch };
        rows.linearize(estimate, Widening::Final(1.0), system);
        elimination.factor(system, 0.0)
    }

    /// Restarts the arcs whose newest phase has slipped; returns whether any did.
    pub(crate) fn cut_slips(
        &mut self,
        settings: &GraphSettings,
        slipped: &mut Vec<SatelliteId>,
        scratch: &mut RowScratch,
    ) -> bool {
        let Self { epochs, estimate, tracking, .. } = self;
        let (Some(epoch), Some(state)) = (epochs.last_mut(), estimate.states.last()) else {
            return false;
        };
        let kernel = settings.kernels.last().phase;
        let (arcs, border) = (&mut tracking.arcs, &mut estimate.border);
        cut_slips(epoch, state, Slips { arcs, border, kernel, slipped }, scratch)
    }

    /// Marginalises the oldest epoch into the prior, together with the ambiguities that no other
    /// epoch uses. `history` keeps what is needed to smooth them later.
    pub(crate) fn forget_oldest(
        &mut self,
        settings: &GraphSettings,
        history: Option<&mut History>,
        scratch: &mut RowScratch,
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
