//! Solves a window of differences, and revises its epochs.

use std::ops::Range;

use nalgebra::Matrix3;

use crate::config::{PositioningOptions, RtkOptions};
use crate::gnss::{Ecef, GpsTime, LocalFrame, Reason, SatelliteId, Solution};
use crate::graph::{BorderLife, Covariances, Elimination, Prior, Smoother, System, Workspace};
use crate::positioning::engine::EpochInputs;
use crate::positioning::fgo::{KnownPosition, SlidingWindow, WindowScratch};
use crate::positioning::rtk::ambiguity::{FloatSolution, IntegerSearch};
use crate::positioning::rtk::observed::{
    AmbiguityTie, Flip, RowScratch, RtkEpoch, SLIP_ROUNDS, STATE, State, half_cycle_step,
    window_residuals,
};
use crate::positioning::rtk::pause::SolvedPhases;
use crate::positioning::rtk::relative_solver::{NewEpoch, RelativeSolver, Resolved};
use crate::positioning::rtk::tracking::{SolvedEpoch, Tracking};
use crate::positioning::setup::Setup;

use super::chain::Chain;
use super::history::{FactoredWindow, History};

/// Epochs of the shortest window: a slip shows in the change since the last epoch.
const EPOCHS_LEAST: usize = 2;

/// Scratch of the window.
#[derive(Debug)]
pub(crate) struct ChainScratch {
    rows: RowScratch,
    search: IntegerSearch,
    workspace: Workspace<STATE>,
    covariances: Covariances<STATE>,
    smoother: Smoother<STATE>,
    oldest: (System<STATE>, Elimination<STATE>),
}

impl Default for ChainScratch {
    fn default() -> Self {
        Self {
            rows: RowScratch::default(),
            search: IntegerSearch::default(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            smoother: Smoother::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
        }
    }
}

impl RelativeSolver for Chain {
    type Alone = SlidingWindow;
    type Past = Option<History>;
    type Scratch = ChainScratch;

    const IS_ACCOMPANIED: bool = true;

    fn new() -> Self {
        Self::empty()
    }

    fn begin_alone(
        alone: &mut SlidingWindow,
        known: &KnownPosition,
        inputs: &EpochInputs<'_>,
        scratch: &mut WindowScratch,
    ) {
        alone.begin_at(known, inputs, scratch);
    }

    fn past(revises: bool) -> Option<History> {
        revises.then(History::default)
    }

    fn last_time(&self) -> Option<GpsTime> {
        self.epochs.last().map(|epoch| epoch.time)
    }

    fn predicted(&self, time: GpsTime) -> State {
        self.expected(time)
    }

    fn frame(&self) -> &LocalFrame {
        &self.frame
    }

    fn tracking(&mut self) -> &mut Tracking {
        &mut self.tracking
    }

    fn clear(&mut self) {
        self.epochs.clear();
        self.estimate.states.clear();
        self.estimate.border.clear();
        self.prior = Prior::none();
        self.tracking.clear();
    }

    fn begin(&mut self, start: Ecef, _guess: &State) {
        self.clear();
        self.frame = LocalFrame::at(start);
    }

    fn forget(&mut self) {
        self.clear();
        self.tracking = Tracking::new();
    }

    fn solve(
        &mut self,
        new: NewEpoch<'_>,
        past: &mut Option<History>,
        scratch: &mut ChainScratch,
    ) -> Result<Resolved, Reason> {
        let (setup, slipped) = (new.setup, new.slipped);
        self.append(new.time, new.guess, new.differences, setup, &mut scratch.rows);
        let ended = slipped.len();
        if self.settle(setup, slipped, past.as_mut(), scratch).is_none() {
            self.clear();
            return Err(Reason::NotConverged);
        }
        if !self.judge_arcs(slipped.len() - ended, &mut scratch.rows) {
            slipped.extend(self.tracking.arcs.present(new.time).map(|arc| arc.satellite));
            self.clear();
            return Err(Reason::NotConverged);
        }
        let ChainScratch { rows, search, workspace, covariances, .. } = scratch;
        covariances.newest(&workspace.elimination);
        self.continue_half_cycles(covariances, &setup.options.rtk);
        let covariance = position_covariance(covariances);
        let Self { tracking, estimate, epochs, .. } = self;
        let epoch = epochs.last().expect("a window that was solved has an epoch");
        let state = estimate.states.last().expect("one state for each epoch");
        tracking.learn_noise(epoch, state, &covariance, rows);
        let variables = covariances.variables().iter();
        let ambiguities = variables.map(|&variable| estimate.border[variable]).collect();
        let solved = SolvedEpoch {
            epoch,
            border: &estimate.border,
            float: &FloatSolution::of_graph(state, ambiguities, covariances),
            residuals: window_residuals(epochs, &estimate.states, &covariance, rows),
        };
        let resolution = tracking.resolve(&solved, &setup.options, search, rows);
        let covariance = *covariances.state();
        Ok(Resolved { state: *state, covariance, has_velocity: true, resolution })
    }

    fn epoch<'a>(&'a self, _scratch: &'a ChainScratch) -> &'a RtkEpoch {
        self.epochs.last().expect("a window that was solved has an epoch")
    }

    fn remember(
        &self,
        (solution, is_relative): (&Solution, bool),
        inputs: &EpochInputs<'_>,
        past: &mut Option<History>,
        scratch: &mut ChainScratch,
        revisions: &mut Vec<Solution>,
    ) {
        let Some(history) = past else { return };
        let options = inputs.options();
        match is_relative {
            true => history.push(solution.clone(), &self.tracking, &options.rtk),
            false => history.push_alone(solution.clone()),
        }
        let due = history.due(inputs.epoch.time, &options.graph);
        self.revise(due.clone(), inputs.setup, history, scratch);
        if !inputs.setup.is_batch {
            revisions.extend(history.leave(due.end));
        }
    }

    fn answer_all(
        &self,
        setup: &Setup,
        past: &mut Option<History>,
        scratch: &mut ChainScratch,
        revisions: &mut Vec<Solution>,
    ) {
        if let Some(history) = past {
            self.revise(history.all(), setup, history, scratch);
        }
        Self::leave_all(past, revisions);
    }

    fn leave_all(past: &mut Option<History>, revisions: &mut Vec<Solution>) {
        if let Some(history) = past {
            revisions.extend(history.leave(history.all().end));
            *history = History::default();
        }
    }

    fn oldest(past: &Option<History>) -> Option<GpsTime> {
        past.as_ref()?.oldest_time()
    }
}

impl Chain {
    /// Whether the oldest epoch leaves.
    ///
    /// Without integers the epochs of the last `window_s` are weighted again with each new epoch,
    /// because only together do they show which pseudoranges are reflected. With integers the
    /// position is known to a centimetre, so older epochs need no new weights.
    fn is_too_long(&self, options: &PositioningOptions) -> bool {
        let ([oldest, .., newest], count) = (self.epochs.as_slice(), self.epochs.len()) else {
            return false;
        };
        let is_late = options.graph.window_s < newest.time - oldest.time;
        let is_over = options.rtk.window_epochs < count;
        let is_known = 0 < self.tracking.hold.epochs_in_a_row;
        is_over || EPOCHS_LEAST < count && (is_late || is_known)
    }

    /// Marginalises the epochs that leave and solves the window, until no slip is found.
    fn settle(
        &mut self,
        setup: &Setup,
        slipped: &mut Vec<SatelliteId>,
        mut history: Option<&mut History>,
        scratch: &mut ChainScratch,
    ) -> Option<()> {
        let ChainScratch { rows, workspace, oldest, .. } = scratch;
        let settings = &setup.relative;
        while self.is_too_long(&setup.options) {
            self.forget_oldest(settings, history.as_deref_mut(), rows, oldest).ok()?;
        }
        for _ in 0..SLIP_ROUNDS {
            self.optimize(settings, rows, workspace).ok()?;
            if !self.cut_slips(settings, slipped, rows) {
                break;
            }
        }
        Some(())
    }

    /// Judges the arcs by the newest epoch, in which the test for slips has ended `cut` of them.
    /// Returns whether they have more likely kept their ambiguities than not.
    #[must_use]
    fn judge_arcs(&mut self, cut: usize, scratch: &mut RowScratch) -> bool {
        let Self { epochs, estimate, tracking, .. } = self;
        let (Some(epoch), Some(state)) = (epochs.last(), estimate.states.last()) else {
            return true;
        };
        let border = &estimate.border;
        tracking.judge_arcs(&SolvedPhases { epoch, state, border, cut }, scratch)
    }

    /// Ties the ambiguities of arcs that began because a half cycle was resolved to those of the
    /// arcs before, if the solved epoch shows by which step they differ. The tie acts from the next
    /// solve on. The phase then has the weight of one that continues an arc.
    fn continue_half_cycles(&mut self, covariances: &Covariances<STATE>, options: &RtkOptions) {
        let Self { epochs, estimate, tracking, .. } = self;
        let Some(epoch) = epochs.last_mut() else { return };
        for Flip { variables, interval_s } in tracking.arcs.flips(epoch.time) {
            let [earlier, later] = variables;
            let own = covariances.border(earlier, earlier).zip(covariances.border(later, later));
            let cross = covariances.border(earlier, later);
            let Some(((before, after), both)) = own.zip(cross) else { continue };
            let difference = estimate.border[later] - estimate.border[earlier];
            let variance = before + after - 2.0 * both;
            let step = half_cycle_step(difference, variance, options.hold_probability_min);
            let Some(step) = step else { continue };
            let independent_share = (interval_s / options.carrier_correlation_s).min(1.0);
            epoch.tie(AmbiguityTie { variables, step }, independent_share);
        }
    }

    /// Revises some epochs. If the window cannot be factored, their answers stay.
    fn revise(
        &self,
        epochs: Range<usize>,
        setup: &Setup,
        history: &mut History,
        scratch: &mut ChainScratch,
    ) {
        let ChainScratch { rows, search, workspace, smoother, .. } = scratch;
        if history.has_graph(epochs.clone())
            && self.factor(&setup.relative, rows, workspace).is_ok()
        {
            let Self { estimate, frame, .. } = self;
            let (elimination, resolver) = (&workspace.elimination, &mut search.resolver);
            let float_factor = self.tracking.receivers.pseudorange_noise.variance_factor();
            let window =
                FactoredWindow { elimination, estimate, frame, smoother, resolver, float_factor };
            history.revise(epochs, window, &setup.options.rtk);
        }
    }
}

/// Covariance of the newest position (m²).
fn position_covariance(covariances: &Covariances<STATE>) -> Matrix3<f64> {
    covariances.state().fixed_view::<3, 3>(0, 0).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, Profile};
    use crate::positioning::rtk::observed::RtkEpoch;

    /// Epochs left in a window of `count`, one each `interval_s`, after `epochs_in_a_row` with
    /// integers.
    fn left(count: usize, interval_s: f64, epochs_in_a_row: u32) -> usize {
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let mut chain = Chain::empty();
        chain.tracking.hold.epochs_in_a_row = epochs_in_a_row;
        for k in 0..count {
            let time = GpsTime::EPOCH + k as f64 * interval_s;
            chain.epochs.push(RtkEpoch { time, ..RtkEpoch::default() });
        }
        while chain.is_too_long(&options) {
            chain.epochs.remove(0);
        }
        chain.epochs.len()
    }

    /// Without integers ten epochs and 10 s, but at least two epochs; with integers two.
    #[test]
    fn the_window_is_long_until_integers_are_found() {
        for (interval_s, expected) in [(0.1, 10), (1.0, 10), (2.5, 5), (5.0, 3), (30.0, 2)] {
            assert_eq!(left(12, interval_s, 0), expected, "{interval_s} s");
            assert_eq!(left(12, interval_s, 1), 2, "{interval_s} s");
        }
        assert_eq!([0, 1].map(|count| left(count, 1.0, 0)), [0, 1]);
    }
}
