//! The filter on differences against a base: each epoch answered as it comes.

use crate::config::PositioningOptions;
use crate::gnss::{Ecef, Enu, Epoch, GpsTime, LocalFrame, Navigation, Reason, Solution};
use crate::graph::Phase;
use crate::positioning::base::BaseAiding;
use crate::positioning::chi_square::ChiSquareLimits;
use crate::positioning::ekf::KalmanFilter;
use crate::positioning::factors::{MotionFactor, VELOCITY};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::answer::{Findings, solution};
use super::belief::{Belief, Gains};
use super::epoch::{RtkEpoch, STATE, Scratch, State};
use super::front::{Front, UsableBase};
use super::integers::Integers;
use super::noise::Residuals;
use super::settings::Settings;
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

/// A causal estimator that keeps one state with its ambiguities.
#[derive(Debug)]
pub(in crate::positioning) struct RtkFilter {
    settings: Settings,
    /// Of the innovation test, infinite without.
    limit: f64,
    memory: Memory,
    front: Front,
    /// Answers while there is no base to use.
    stand_in: Option<Box<KalmanFilter>>,
    integers: Integers,
    epoch: RtkEpoch,
    /// What was believed before the epoch's rows.
    before: Belief,
    border: Vec<f64>,
    gains: Gains,
}

impl Memory {
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

impl RtkFilter {
    /// One that has seen nothing.
    pub(in crate::positioning) fn new(options: &PositioningOptions) -> Self {
        let limit = match options.fault_exclusion {
            true => ChiSquareLimits::new(options.false_alarm_probability).at(1),
            false => f64::INFINITY,
        };
        Self {
            settings: Settings::new(options),
            limit,
            memory: Memory::new(),
            front: Front::new(options),
            stand_in: None,
            integers: Integers::new(),
            epoch: RtkEpoch::new(),
            before: Belief::zero(),
            border: Vec::new(),
            gains: Gains::default(),
        }
    }

    /// Answers one epoch.
    ///
    /// An epoch that is not after the last one is answered by itself and changes nothing. Without a
    /// base that can be used the answer is that of a filter without one, with the reason; what is
    /// known of the ambiguities stays for the base's return. With another base the filter begins
    /// anew.
    pub(in crate::positioning) fn advance(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseAiding<'_>>,
        options: &PositioningOptions,
    ) -> Solution {
        if self.front.changes_base(epoch.time, base) {
            self.memory = Memory::new();
        }
        let arcs = &mut self.memory.tracking.arcs;
        if let Some(alone) = self.front.receive(epoch, navigation, base, arcs, options) {
            return alone;
        }
        match self.relative(epoch, navigation, base, options) {
            Ok(solution) => {
                self.stand_in = None;
                solution
            }
            Err(reason) => {
                let stand_in =
                    self.stand_in.get_or_insert_with(|| Box::new(KalmanFilter::new(options)));
                let mut solution = stand_in.advance(epoch, navigation, options);
                solution.reasons.extend(self.front.reasons_alone(reason));
                solution
            }
        }
    }

    /// The answer relative to the base, or why there is none.
    fn relative(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseAiding<'_>>,
        options: &PositioningOptions,
    ) -> Result<Solution, Reason> {
        let base = self.front.usable_base(epoch.time, navigation, base, options)?;
        let guess = self.guess(epoch, navigation, options)?;
        let place = self.memory.place(&guess);
        let arcs = &mut self.memory.tracking.arcs;
        self.front.difference(epoch, place, base.station, navigation, arcs, options)?;
        self.predict(epoch.time);
        let is_lost = self.update(options);
        let solution = self.answer(base, options);
        if is_lost {
            self.memory.time = None;
        }
        Ok(solution)
    }

    /// Where the rover is about now; the filter begins anew where it cannot tell.
    fn guess(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Result<State, Reason> {
        if let Some(last) = self.memory.time {
            let guess = self.memory.predicted(epoch.time);
            let is_near = guess.fixed_rows::<3>(0).norm() < FRAME_LIMIT_M;
            if options.rtk.single_epoch {
                self.memory.begin(self.memory.place(&guess), &State::zeros());
                return Ok(State::zeros());
            }
            if epoch.time - last <= options.graph.gap_s && is_near {
                return Ok(guess);
            }
        }
        let alone = self.front.single_point.solve(epoch, navigation, options, None);
        let estimate = alone.estimate.ok_or(Reason::NotConverged)?;
        let mut guess = State::zeros();
        if let Some(velocity) = &estimate.velocity {
            let local = LocalFrame::at(estimate.position).rotation * velocity.velocity_m_s;
            guess.fixed_rows_mut::<3>(VELOCITY).copy_from(&local);
        }
        self.memory.begin(estimate.position, &guess);
        Ok(guess)
    }

    /// Goes on to an epoch.
    fn predict(&mut self, time: GpsTime) {
        let Self { memory, epoch, settings, .. } = self;
        epoch.clear();
        epoch.time = time;
        if let Some(last) = memory.time.replace(time) {
            let interval_s = time - last;
            memory.belief.predict(&settings.motion, interval_s);
            epoch.motion = Some(MotionFactor::new(&settings.motion, interval_s));
        }
    }

    /// Takes the epoch's rows in, slips cut out; returns whether the filter is lost.
    fn update(&mut self, options: &PositioningOptions) -> bool {
        let Self { memory, epoch, before, border, gains, front, settings, .. } = self;
        let Memory { belief, tracking, frame, .. } = memory;
        border.clear();
        border.extend_from_slice(belief.border());
        let guess = belief.state();
        tracking.fill(epoch, frame, &guess, &front.differences, border, options);
        before.clone_from(belief);
        let kernel = settings.kernels.at(Phase::Graduated(1.0))[1];
        let mut passed = (0, 0);
        for round in 0..=SLIP_ROUNDS {
            passed = enter(belief, epoch, &mut tracking.scratch, self.limit, gains);
            border.clear();
            border.extend_from_slice(belief.border());
            let state = belief.state();
            let is_last = round == SLIP_ROUNDS;
            if is_last || !tracking.cut_slips(epoch, &state, border, &kernel, &mut front.slipped) {
                break;
            }
            belief.clone_from(before);
        }
        let covariance = belief.state_covariance().fixed_view::<3, 3>(0, 0).into_owned();
        tracking.learn_noise(epoch, &belief.state(), border, &covariance);
        tracking.arcs.release(|_| false);
        let interval_s = epoch.motion.as_ref().map_or(0.0, MotionFactor::interval_s);
        let is_failing = 2 * passed.0 < passed.1;
        memory.failing_s = if is_failing { memory.failing_s + interval_s } else { 0.0 };
        LOST_S < memory.failing_s
    }

    fn answer(&mut self, base: UsableBase<'_>, options: &PositioningOptions) -> Solution {
        let Self { memory, epoch, integers, front, .. } = self;
        let Memory { belief, tracking, frame, .. } = memory;
        let present = tracking.arcs.list.iter().filter(|arc| arc.last == epoch.time);
        let float = belief.float(present);
        let (border, residuals) = (belief.border(), &Residuals::NONE);
        let resolution = tracking.resolve(integers, epoch, border, &float, residuals, options);
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

impl Snapshot for Memory {
    fn save(&self, writer: &mut SnapshotWriter) {
        let Self { time, frame, belief, tracking, failing_s } = self;
        time.save(writer);
        frame.save(writer);
        belief.save(writer);
        tracking.save(writer);
        failing_s.save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let memory = Self {
            time: Snapshot::load(reader)?,
            frame: Snapshot::load(reader)?,
            belief: Snapshot::load(reader)?,
            tracking: Snapshot::load(reader)?,
            failing_s: Snapshot::load(reader)?,
        };
        let ambiguities = memory.belief.ambiguities();
        let is_whole = ambiguities.is_some_and(|count| memory.tracking.arcs.is_within(count));
        if is_whole { Ok(memory) } else { Err(reader.invalid("filter")) }
    }
}

impl RtkFilter {
    /// Writes what the next answers depend on; the settings follow from the options.
    pub(in crate::positioning) fn save(&self, writer: &mut SnapshotWriter) {
        self.memory.save(writer);
        self.front.save(writer);
        self.stand_in.is_some().save(writer);
        if let Some(stand_in) = &self.stand_in {
            stand_in.save(writer);
        }
    }

    /// The filter that was written, by the options it was made with.
    pub(in crate::positioning) fn load(
        options: &PositioningOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        Ok(Self {
            memory: Snapshot::load(reader)?,
            front: Front::load(options, reader)?,
            stand_in: match bool::load(reader)? {
                true => Some(Box::new(KalmanFilter::load(options, reader)?)),
                false => None,
            },
            ..Self::new(options)
        })
    }

    /// Swaps the memory both work in.
    pub(in crate::positioning) fn exchange_memory(&mut self, other: &mut Self) {
        #[rustfmt::skip]
        let Self {
            settings: _, limit: _, memory, front, stand_in, integers, epoch, before, border, gains,
        } = self;
        memory.tracking.exchange_memory(&mut other.memory.tracking);
        front.exchange_memory(&mut other.front);
        if let (Some(stand_in), Some(other)) = (stand_in, &mut other.stand_in) {
            stand_in.exchange_memory(other);
        }
        std::mem::swap(integers, &mut other.integers);
        std::mem::swap(epoch, &mut other.epoch);
        std::mem::swap(before, &mut other.before);
        std::mem::swap(border, &mut other.border);
        std::mem::swap(gains, &mut other.gains);
    }
}

/// Copies into the storage already held.
impl Clone for Memory {
    fn clone(&self) -> Self {
        let mut clone = Self::new();
        clone.clone_from(self);
        clone
    }

    fn clone_from(&mut self, source: &Self) {
        self.time = source.time;
        self.frame = source.frame;
        self.belief.clone_from(&source.belief);
        self.tracking.clone_from(&source.tracking);
        self.failing_s = source.failing_s;
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for RtkFilter {
    fn clone(&self) -> Self {
        Self {
            settings: self.settings.clone(),
            limit: self.limit,
            memory: self.memory.clone(),
            front: self.front.clone(),
            stand_in: self.stand_in.clone(),
            integers: Integers::new(),
            epoch: RtkEpoch::new(),
            before: Belief::zero(),
            border: Vec::new(),
            gains: Gains::default(),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.settings.clone_from(&source.settings);
        self.limit = source.limit;
        self.memory.clone_from(&source.memory);
        self.front.clone_from(&source.front);
        self.stand_in.clone_from(&source.stand_in);
    }
}
