//! The filter on differences against a base: each epoch answered as it comes.

use crate::config::PositioningOptions;
use crate::gnss::{Ecef, Enu, GpsTime, LocalFrame, Reason, Solution};
use crate::positioning::ekf::{FilterScratch, KalmanFilter};
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::factors::{MotionFactor, VELOCITY};
use crate::positioning::setup::Setup;
use crate::snapshot::state_fields;

use super::answer::{Findings, solution};
use super::belief::{Belief, Gains};
use super::epoch::{RtkEpoch, STATE, Scratch, State};
use super::front::{Front, FrontScratch, UsableBase};
use super::integers::Integers;
use super::noise::Residuals;
use super::tracking::Tracking;
use super::window::{FRAME_LIMIT_M, SLIP_ROUNDS};

/// Deviation of the first position about its start (m): says next to nothing.
const START_M: f64 = 1e3;
/// Deviation of the first velocity about its start, per axis (m/s).
const START_M_S: f64 = 100.0;
/// How long most pseudoranges may fail the test before the filter takes itself for lost (s).
const LOST_S: f64 = 10.0;

/// What the filter knows between epochs.
#[derive(Debug)]
struct Memory {
    /// Of the newest epoch filtered; none before the first.
    time: Option<GpsTime>,
    frame: LocalFrame,
    belief: Belief,
    tracking: Tracking,
    /// For how long most pseudoranges have failed the test (s).
    failing_s: f64,
}

state_fields!(Memory { time, frame, belief, tracking, failing_s } checked by is_whole);

/// A causal estimator that keeps one state with its ambiguities.
#[derive(Debug)]
pub(in crate::positioning) struct RtkFilter {
    memory: Memory,
    front: Front,
    /// Answers while there is no base to use.
    stand_in: Option<Box<KalmanFilter>>,
}

state_fields!(RtkFilter { memory, front, stand_in });

/// Memory to compute in.
#[derive(Debug)]
pub(in crate::positioning) struct RtkFilterScratch {
    front: FrontScratch,
    alone: FilterScratch,
    rows: Scratch,
    integers: Integers,
    epoch: RtkEpoch,
    /// What was believed before the epoch's rows.
    before: Belief,
    border: Vec<f64>,
    gains: Gains,
}

impl Default for RtkFilterScratch {
    fn default() -> Self {
        Self {
            front: FrontScratch::default(),
            alone: FilterScratch::default(),
            rows: Scratch::default(),
            integers: Integers::default(),
            epoch: RtkEpoch::new(),
            before: Belief::zero(),
            border: Vec::new(),
            gains: Gains::default(),
        }
    }
}

impl Memory {
    fn is_whole(&self) -> bool {
        self.belief.ambiguities().is_some_and(|count| self.tracking.arcs.is_within(count))
    }

    fn new() -> Self {
        Self {
            time: None,
            frame: LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0)),
            belief: Belief::zero(),
            tracking: Tracking::new(),
            failing_s: 0.0,
        }
    }

    /// Forgets everything and puts the origin at `start`.
    fn begin(&mut self, start: Ecef, guess: &State) {
        self.time = None;
        self.frame = LocalFrame::at(start);
        self.belief = Belief::zero();
        for column in 0..STATE {
            let sigma = if column < VELOCITY { START_M } else { START_M_S };
            self.belief.renew(column, guess[column], sigma);
        }
        self.tracking.clear();
        self.failing_s = 0.0;
    }

    /// Where the newest state will be at `time`, if nothing happens.
    fn predicted(&self, time: GpsTime) -> State {
        let mut state = self.belief.state();
        let interval_s = self.time.map_or(0.0, |last| time - last);
        for axis in 0..3 {
            state[axis] += interval_s * state[VELOCITY + axis];
        }
        state
    }

    fn place(&self, state: &State) -> Ecef {
        self.frame.to_ecef(Enu(state.fixed_rows::<3>(0).into_owned()))
    }
}

impl Engine for RtkFilter {
    type Scratch = RtkFilterScratch;

    fn new(_setup: &Setup, _revises: bool) -> Self {
        Self { memory: Memory::new(), front: Front::default(), stand_in: None }
    }

    /// An epoch that is not after the last one is answered by itself and changes nothing. Without a
    /// base that can be used the answer is that of a filter without one, with the reason; what is
    /// known of the ambiguities stays for the base's return. With another base the filter begins
    /// again.
    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RtkFilterScratch,
        revisions: &mut Vec<Solution>,
    ) -> Solution {
        if self.front.changes_base(inputs, &mut scratch.front) {
            self.memory = Memory::new();
        }
        let arcs = &mut self.memory.tracking.arcs;
        if let Some(alone) = self.front.receive(inputs, arcs, &mut scratch.front) {
            return alone;
        }
        match self.relative(inputs, scratch) {
            Ok(solution) => {
                self.stand_in = None;
                solution
            }
            Err(reason) => {
                let stand_in = self
                    .stand_in
                    .get_or_insert_with(|| Box::new(KalmanFilter::new(inputs.setup, false)));
                let mut solution = stand_in.advance(inputs, &mut scratch.alone, revisions);
                solution.reasons.extend(scratch.front.reasons_alone(reason));
                solution
            }
        }
    }
}

impl RtkFilter {
    /// The answer relative to the base, or why there is none.
    fn relative(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RtkFilterScratch,
    ) -> Result<Solution, Reason> {
        let base = self.front.usable_base(inputs, &mut scratch.front)?;
        let guess = self.guess(inputs, &mut scratch.front)?;
        let place = self.memory.place(&guess);
        let arcs = &mut self.memory.tracking.arcs;
        self.front.difference(inputs, place, base.station, arcs, &mut scratch.front)?;
        self.memory.predict(inputs.epoch.time, inputs.setup, &mut scratch.epoch);
        let is_lost = self.memory.update(inputs.setup, scratch);
        let solution = self.memory.answer(base, inputs.options(), scratch);
        if is_lost {
            self.memory.time = None;
        }
        Ok(solution)
    }

    /// Where the rover is about now; the filter begins again where it cannot tell.
    fn guess(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut FrontScratch,
    ) -> Result<State, Reason> {
        let (time, options) = (inputs.epoch.time, inputs.options());
        if let Some(last) = self.memory.time {
            let guess = self.memory.predicted(time);
            let is_near = guess.fixed_rows::<3>(0).norm() < FRAME_LIMIT_M;
            if options.rtk.single_epoch {
                self.memory.begin(self.memory.place(&guess), &State::zeros());
                return Ok(State::zeros());
            }
            if time - last <= options.graph.gap_s && is_near {
                return Ok(guess);
            }
        }
        let alone = scratch.single_point.solve(inputs, None);
        let estimate = alone.estimate.ok_or(Reason::NotConverged)?;
        let mut guess = State::zeros();
        if let Some(velocity) = &estimate.velocity {
            let local = LocalFrame::at(estimate.position).rotation * velocity.velocity_m_s;
            guess.fixed_rows_mut::<3>(VELOCITY).copy_from(&local);
        }
        self.memory.begin(estimate.position, &guess);
        Ok(guess)
    }
}

impl Memory {
    /// Goes on to an epoch.
    fn predict(&mut self, time: GpsTime, setup: &Setup, epoch: &mut RtkEpoch) {
        epoch.clear();
        epoch.time = time;
        if let Some(last) = self.time.replace(time) {
            let interval_s = time - last;
            self.belief.predict(&setup.motion, interval_s);
            epoch.motion = Some(MotionFactor::new(&setup.motion, interval_s));
        }
    }

    /// Takes the epoch's rows in, slips cut out; returns whether the filter is lost.
    fn update(&mut self, setup: &Setup, scratch: &mut RtkFilterScratch) -> bool {
        let Self { belief, tracking, frame, .. } = self;
        let RtkFilterScratch { front, rows, epoch, before, border, gains, .. } = scratch;
        border.clear();
        border.extend_from_slice(belief.border());
        let (guess, options) = (belief.state(), &setup.options);
        tracking.fill(epoch, frame, &guess, &front.differences, border, options, rows);
        before.clone_from(belief);
        let kernel = setup.relative.kernels.last().phase;
        let mut passed = (0, 0);
        for round in 0..=SLIP_ROUNDS {
            passed = enter(belief, epoch, rows, setup.innovation_limit, gains);
            border.clear();
            border.extend_from_slice(belief.border());
            let state = belief.state();
            let slipped = &mut front.slipped;
            let is_last = round == SLIP_ROUNDS;
            if is_last || !tracking.cut_slips(epoch, &state, border, &kernel, slipped, rows) {
                break;
            }
            belief.clone_from(before);
        }
        let covariance = belief.state_covariance().fixed_view::<3, 3>(0, 0).into_owned();
        tracking.learn_noise(epoch, &belief.state(), border, &covariance, rows);
        tracking.arcs.release(|_| false);
        let interval_s = epoch.motion.as_ref().map_or(0.0, MotionFactor::interval_s);
        let is_failing = 2 * passed.0 < passed.1;
        self.failing_s = if is_failing { self.failing_s + interval_s } else { 0.0 };
        LOST_S < self.failing_s
    }

    fn answer(
        &mut self,
        base: UsableBase<'_>,
        options: &PositioningOptions,
        scratch: &mut RtkFilterScratch,
    ) -> Solution {
        let Self { belief, tracking, frame, .. } = self;
        let RtkFilterScratch { front, rows, integers, epoch, .. } = scratch;
        let present = tracking.arcs.list.iter().filter(|arc| arc.last == epoch.time);
        let float = belief.float(present);
        let (border, residuals) = (belief.border(), &Residuals::NONE);
        let resolution =
            tracking.resolve(integers, epoch, border, &float, residuals, options, rows);
        let reasons = front.reasons(epoch.time, &tracking.arcs);
        solution(Findings {
            frame,
            epoch,
            state: &belief.state(),
            covariance: &belief.state_covariance(),
            differences: &front.differences,
            resolution,
            reasons,
            base,
            options: &options.rtk,
        })
    }
}

/// Takes all rows of an epoch in, group by group; returns how many pseudoranges passed the test,
/// and of how many.
fn enter(
    belief: &mut Belief,
    epoch: &RtkEpoch,
    scratch: &mut Scratch,
    limit: f64,
    gains: &mut Gains,
) -> (usize, usize) {
    epoch.starts.iter().for_each(|start| belief.begin(start));
    epoch.linearize_rates(&belief.state(), scratch);
    belief.enter(&scratch.rows, limit, gains);
    let mut pseudoranges = (0, 0);
    for is_carrier in [false, true] {
        for group in epoch.groups.iter().filter(|group| group.is_carrier == is_carrier) {
            epoch.see(&belief.state(), scratch);
            epoch.linearize_group(group, belief.border(), scratch);
            let passed = belief.enter(&scratch.rows, limit, gains);
            if !is_carrier {
                pseudoranges.0 += passed;
                pseudoranges.1 += scratch.rows.len();
            }
        }
    }
    pseudoranges
}
