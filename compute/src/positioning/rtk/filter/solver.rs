//! Solves epochs of differences one by one, by an extended Kalman filter.

use crate::gnss::{Ecef, GpsTime, LocalFrame, Reason};
use crate::positioning::ekf::KalmanFilter;
use crate::positioning::factors::{MotionFactor, VELOCITY};
use crate::positioning::rtk::ambiguity::IntegerSearch;
use crate::positioning::rtk::observed::{
    NewRows, Residuals, RowScratch, RtkEpoch, SLIP_ROUNDS, STATE, Slips, State, cut_slips, fill,
};
use crate::positioning::rtk::pause::SolvedPhases;
use crate::positioning::rtk::relative_solver::{NewEpoch, RelativeSolver, Resolved};
use crate::positioning::rtk::tracking::{SolvedEpoch, Tracking};
use crate::positioning::setup::Setup;
use crate::positioning::starts::{FAILING_MAX_S, START_M_S, start_frame};
use crate::snapshot::state_fields;

use super::gaussian::{Gains, Gaussian};

/// Standard deviation of the first position about its start (m): much wider than any measurement's.
const START_M: f64 = 1e3;

/// State of the filter between epochs.
#[derive(Debug)]
pub(crate) struct FilterState {
    /// Time of the newest epoch filtered; `None` if the filter must restart.
    time: Option<GpsTime>,
    frame: LocalFrame,
    gaussian: Gaussian,
    tracking: Tracking,
    /// How long most pseudoranges have failed the innovation test (s).
    failing_s: f64,
}

state_fields!(FilterState { time, frame, gaussian, tracking, failing_s } checked by is_whole);

/// Scratch of the filter.
#[derive(Debug)]
pub(crate) struct FilterStateScratch {
    rows: RowScratch,
    search: IntegerSearch,
    epoch: RtkEpoch,
    /// The predicted distribution, before the epoch's rows enter.
    before: Gaussian,
    border: Vec<f64>,
    gains: Gains,
}

impl Default for FilterStateScratch {
    fn default() -> Self {
        Self {
            rows: RowScratch::default(),
            search: IntegerSearch::default(),
            epoch: RtkEpoch::default(),
            before: Gaussian::zero(),
            border: Vec::new(),
            gains: Gains::default(),
        }
    }
}

impl RelativeSolver for FilterState {
    type Alone = KalmanFilter;
    type Past = ();
    type Scratch = FilterStateScratch;

    fn new() -> Self {
        Self {
            time: None,
            frame: start_frame(),
            gaussian: Gaussian::zero(),
            tracking: Tracking::new(),
            failing_s: 0.0,
        }
    }

    fn past(_revises: bool) {}

    fn last_time(&self) -> Option<GpsTime> {
        self.time
    }

    fn predicted(&self, time: GpsTime) -> State {
        let mut state = self.gaussian.state();
        let interval_s = self.time.map_or(0.0, |last| time - last);
        for axis in 0..3 {
            state[axis] += interval_s * state[VELOCITY + axis];
        }
        state
    }

    fn frame(&self) -> &LocalFrame {
        &self.frame
    }

    fn tracking(&mut self) -> &mut Tracking {
        &mut self.tracking
    }

    fn clear(&mut self) {
        (self.time, self.gaussian, self.failing_s) = (None, Gaussian::zero(), 0.0);
        self.tracking.clear();
    }

    fn begin(&mut self, start: Ecef, guess: &State) {
        self.clear();
        self.frame = LocalFrame::at(start);
        for column in 0..STATE {
            let sigma = if column < VELOCITY { START_M } else { START_M_S };
            self.gaussian.renew(column, guess[column], sigma);
        }
    }

    fn forget(&mut self) {
        *self = Self::new();
    }

    fn solve(
        &mut self,
        new: NewEpoch<'_>,
        _past: &mut (),
        scratch: &mut FilterStateScratch,
    ) -> Result<Resolved, Reason> {
        let (time, setup, slipped) = (new.time, new.setup, &mut *new.slipped);
        self.predict(time, setup, &mut scratch.epoch);
        let ended = slipped.len();
        if self.update(NewEpoch { slipped: &mut *slipped, ..new }, scratch) {
            self.time = None;
        }
        if !self.judge_arcs(slipped.len() - ended, scratch) {
            slipped.extend(self.tracking.arcs.present(time).map(|arc| arc.satellite));
            self.clear();
            return Err(Reason::NotConverged);
        }
        let FilterStateScratch { rows, search, epoch, .. } = scratch;
        let Self { gaussian, tracking, .. } = self;
        let covariance = gaussian.state_covariance().fixed_view::<3, 3>(0, 0).into_owned();
        tracking.learn_noise(epoch, &gaussian.state(), &covariance, rows);
        let solved = SolvedEpoch {
            epoch,
            border: gaussian.border(),
            float: &gaussian.float(tracking.arcs.present(epoch.time)),
            residuals: Residuals::NONE,
        };
        let resolution = tracking.resolve(&solved, &setup.options, search, rows);
        let (state, covariance) = (gaussian.state(), gaussian.state_covariance());
        Ok(Resolved { state, covariance, has_velocity: true, resolution })
    }

    fn epoch<'a>(&'a self, scratch: &'a FilterStateScratch) -> &'a RtkEpoch {
        &scratch.epoch
    }
}

impl FilterState {
    fn is_whole(&self) -> bool {
        self.gaussian.ambiguities().is_some_and(|count| self.tracking.arcs.is_within(count))
    }

    /// Judges the arcs by the newest epoch, in which the test for slips has ended `cut` of them.
    /// Returns whether they have more likely kept their ambiguities than not.
    #[must_use]
    fn judge_arcs(&mut self, cut: usize, scratch: &mut FilterStateScratch) -> bool {
        let FilterStateScratch { rows, epoch, .. } = scratch;
        let Self { gaussian, tracking, .. } = self;
        let (state, border) = (&gaussian.state(), gaussian.border());
        tracking.judge_arcs(&SolvedPhases { epoch, state, border, cut }, rows)
    }

    /// Predicts the state of an epoch.
    fn predict(&mut self, time: GpsTime, setup: &Setup, epoch: &mut RtkEpoch) {
        epoch.clear();
        epoch.time = time;
        if let Some(last) = self.time.replace(time) {
            let interval_s = time - last;
            self.gaussian.predict(&setup.motion, interval_s);
            epoch.motion = Some(MotionFactor::new(&setup.motion, interval_s));
        }
    }

    /// Updates with the epoch's rows, again after each round that finds slips. Returns whether the
    /// filter must restart.
    fn update(&mut self, new: NewEpoch<'_>, scratch: &mut FilterStateScratch) -> bool {
        let NewEpoch { differences, setup, slipped, .. } = new;
        let Self { gaussian, tracking: Tracking { arcs, receivers, .. }, frame, .. } = self;
        let FilterStateScratch { rows, epoch, before, border, gains, .. } = scratch;
        border.clear();
        border.extend_from_slice(gaussian.border());
        let (guess, options) = (&gaussian.state(), &setup.options);
        let scratch = &mut *rows;
        fill(
            epoch,
            NewRows { frame, guess, differences, options, arcs, receivers, border, scratch },
        );
        before.clone_from(gaussian);
        let kernel = setup.relative.kernels.last().phase;
        let mut passed = (0, 0);
        for round in 0..=SLIP_ROUNDS {
            passed = enter(gaussian, epoch, rows, setup.innovation_limit, gains);
            border.clear();
            border.extend_from_slice(gaussian.border());
            let slips = Slips { arcs, border, kernel, slipped };
            if round == SLIP_ROUNDS || !cut_slips(epoch, &gaussian.state(), slips, rows) {
                break;
            }
            gaussian.clone_from(before);
        }
        arcs.release(|_| false);
        let interval_s = epoch.motion.as_ref().map_or(0.0, MotionFactor::interval_s);
        let is_failing = 2 * passed.0 < passed.1;
        self.failing_s = if is_failing { self.failing_s + interval_s } else { 0.0 };
        FAILING_MAX_S < self.failing_s
    }
}

/// Updates with all rows of an epoch: the Doppler shifts, each group of pseudoranges, then the
/// carriers. Returns two numbers of pseudoranges: those that passed the innovation test, and all.
fn enter(
    gaussian: &mut Gaussian,
    epoch: &RtkEpoch,
    scratch: &mut RowScratch,
    limit: f64,
    gains: &mut Gains,
) -> (usize, usize) {
    epoch.starts.iter().for_each(|start| gaussian.begin(start));
    epoch.linearize_rates(&gaussian.state(), scratch);
    gaussian.enter(&scratch.rows, limit, gains);
    let mut pseudoranges = (0, 0);
    for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
        epoch.see(&gaussian.state(), scratch);
        epoch.linearize_group(group, gaussian.border(), scratch);
        pseudoranges.0 += gaussian.enter(&scratch.rows, limit, gains);
        pseudoranges.1 += scratch.rows.len();
    }
    epoch.see(&gaussian.state(), scratch);
    epoch.linearize_carriers(gaussian.border(), scratch);
    gaussian.enter(&scratch.rows, limit, gains);
    pseudoranges
}
