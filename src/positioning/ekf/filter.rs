//! The filter over epochs: how it begins, goes on, is lost and begins anew.

use nalgebra::Vector3;

use crate::config::{DopplerUse, GraphOptions, PositioningOptions};
use crate::gnss::{
    Constellation, Ecef, Enu, EphemerisIssue, Epoch, GpsTime, LocalFrame, Navigation, Reason,
    Solution, Status,
};
use crate::positioning::Measurements;
use crate::positioning::answer::Answer;
use crate::positioning::chi_square::ChiSquareLimits;
use crate::positioning::clock_jump::{CRYSTAL_DRIFT_M_S, jump_m};
use crate::positioning::factors::{
    CLOCK, ClockWalk, DRIFT, DopplerFactor, MotionWalk, OdometryFactor, VELOCITY,
    ZeroVelocityFactor, position,
};
use crate::positioning::phases::Phases;
use crate::positioning::ranging::{Ranging, look, median, sighted};
use crate::positioning::spp::SinglePoint;
use crate::positioning::standstill::{Standstill, StandstillTest};
use crate::positioning::uncertainty::{ErrorModel, Residuals, repetition};
use crate::positioning::velocity::{CN0_IF_MISSING_DB_HZ, VelocityEstimator, variance_m2_s2};
use crate::snapshot::snapshot_fields;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::belief::{BIAS, Belief};
use super::rows::Rows;

/// Deviation of the first position about its start (m): says nearly nothing.
const START_M: f64 = 1e4;
/// Deviation of a velocity that is not known, per axis (m/s).
const START_M_S: f64 = 100.0;
/// Speed taken for a deviation where no Doppler gives the velocity to go on with (m/s).
const UNKNOWN_SPEED_M_S: f64 = 50.0;
/// Deviation of a clock that begins (m).
const START_CLOCK_M: f64 = 1e5;
/// Deviation of an inter-system bias before it is measured (m): 1 µs.
const BIAS_M: f64 = 300.0;
/// Distance from the frame's origin at which the filter starts anew (m): up has turned by 1°.
const FRAME_LIMIT_M: f64 = 1e5;
/// Most that a reflection no stronger than the signal shifts a phase at L1, a quarter wavelength
/// (m). No kernel judges the filter's differences and the test trusts those that come first, so
/// that the bound stands for the deviation: with 0.01 m, `hers-hert` errs by up to 26 m.
const PHASE_BOUND_M: f64 = 0.05;
/// How long most pseudoranges may fail the test before the filter takes itself for lost (s).
const LOST_S: f64 = 10.0;

/// What the filter knows between epochs; plain data.
#[derive(Clone, Debug)]
struct Memory {
    time: GpsTime,
    frame: LocalFrame,
    belief: Belief,
    /// Constellations whose bias has begun.
    begun: [bool; Constellation::COUNT],
    phases: Phases,
    /// Ephemerides of those phases.
    issues: Vec<EphemerisIssue>,
    standstill: Standstill,
    /// For how long most pseudoranges have failed the test (s).
    failing_s: f64,
}

/// What the options mean to the filter.
#[derive(Clone, Debug)]
struct Settings {
    motion: MotionWalk,
    clock: ClockWalk,
    /// The test for standstill, where it is made.
    standstill: Option<StandstillTest>,
    /// Limit of the innovation test, infinite without.
    limit: f64,
}

/// What an epoch is solved from.
struct Scene<'a> {
    epoch: &'a Epoch,
    navigation: &'a Navigation,
    options: &'a PositioningOptions,
}

/// A causal estimator that keeps one state.
#[derive(Debug)]
pub(in crate::positioning) struct KalmanFilter {
    settings: Settings,
    memory: Option<Memory>,
    single_point: SinglePoint,
    velocity: VelocityEstimator,
    measurements: Measurements,
    rows: Rows,
}

impl KalmanFilter {
    /// One that has seen nothing.
    pub(in crate::positioning) fn new(options: &PositioningOptions) -> Self {
        let limit = match options.fault_exclusion {
            true => ChiSquareLimits::new(options.false_alarm_probability).at(1),
            false => f64::INFINITY,
        };
        Self {
            settings: Settings {
                motion: MotionWalk::of(&options.graph),
                clock: ClockWalk::of(&options.graph),
                standstill: options.graph.zero_velocity.then(StandstillTest::new),
                limit,
            },
            memory: None,
            single_point: SinglePoint::new(options),
            velocity: VelocityEstimator::default(),
            measurements: Measurements::default(),
            rows: Rows::default(),
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
        let scene = Scene { epoch, navigation, options };
        let Some(memory) = self.memory.take() else {
            return self.begin(&scene);
        };
        let interval_s = epoch.time - memory.time;
        if interval_s <= 0.0 {
            self.memory = Some(memory);
            return self.single_point.solve(epoch, navigation, options, None);
        }
        let is_far = FRAME_LIMIT_M < position(&memory.belief.state()).norm();
        if options.graph.gap_s < interval_s || is_far {
            return self.begin(&scene);
        }
        match self.go_on(&scene, memory, interval_s) {
            Some(solution) => solution,
            None => self.begin(&scene),
        }
    }

    /// One epoch more; `None` where the filter is lost.
    fn go_on(
        &mut self,
        scene: &Scene<'_>,
        mut memory: Memory,
        interval_s: f64,
    ) -> Option<Solution> {
        let graph = &scene.options.graph;
        let walks = graph.motion.then_some((&self.settings.motion, &self.settings.clock));
        memory.belief.predict(walks, interval_s);
        memory.time = scene.epoch.time;
        if !graph.motion {
            memory.begun = [false; Constellation::COUNT];
        } else {
            let wandered_m2 = graph.bias_walk_m.powi(2) * interval_s;
            for constellation in Constellation::ALL.into_iter().map(Constellation::index) {
                if memory.begun[constellation] {
                    memory.belief.loosen(BIAS + constellation, wandered_m2);
                }
            }
        }
        let place = memory.frame.to_ecef(Enu(position(&memory.belief.state())));
        self.observe(scene, &memory.frame, place)?;
        self.settle_clock(&mut memory, Some(interval_s), graph);
        self.rates(&memory, place, scene.options);
        if graph.phase {
            self.end_arcs(&memory.issues);
            let sigma_m = graph.phase_sigma_m.max(PHASE_BOUND_M);
            let list = &self.measurements.list;
            let phases = &mut self.rows.phases;
            memory.phases.differences(list, sigma_m, interval_s, phases);
            let (past, next) = (memory.belief.past(), memory.belief.state());
            memory.phases.follow_clock(&self.rows.sights, phases, &past, &next);
        }
        self.other_sensors(&mut memory, place, interval_s);
        let share = (interval_s / graph.independence_s).min(1.0);
        let before = memory.phases.sights();
        self.rows.enter(&mut memory.belief, before, self.settings.limit, share, graph);
        let is_failing = self.rows.used.len() * 2 < self.rows.ranges.len();
        memory.failing_s = if is_failing { memory.failing_s + interval_s } else { 0.0 };
        if LOST_S < memory.failing_s && self.can_begin(scene) {
            return None;
        }
        Some(self.finish(scene, memory, interval_s))
    }

    /// Ends the carrier phases whose ephemeris changed: the step between two ephemerides would pass
    /// for a displacement, and no kernel is here to judge it.
    fn end_arcs(&mut self, before: &[EphemerisIssue]) {
        for measurement in &mut self.measurements.list {
            let is_new = !before.contains(&measurement.ephemeris);
            if let Some(phase) = measurement.phase.as_mut().filter(|_| is_new) {
                phase.loss_of_lock = true;
            }
        }
    }

    /// What odometry says of the way, and whether there was any.
    fn other_sensors(&mut self, memory: &mut Memory, place: Ecef, interval_s: f64) {
        let rows = &mut self.rows;
        let over = |odometry| OdometryFactor::over(interval_s, &memory.frame, place, odometry);
        rows.odometry = self.measurements.odometry.as_ref().and_then(over);
        if let Some(test) = &self.settings.standstill {
            let stands = memory.standstill.observe(test, &rows.rates, Some(interval_s));
            rows.standstill = stands.then(|| ZeroVelocityFactor::new(interval_s));
        }
    }

    /// Whether the epoch has a position of its own.
    fn can_begin(&mut self, scene: &Scene<'_>) -> bool {
        let Scene { epoch, navigation, options } = *scene;
        self.single_point.solve(epoch, navigation, options, None).estimate.is_some()
    }

    /// Begins from the epoch's own position.
    fn begin(&mut self, scene: &Scene<'_>) -> Solution {
        let Scene { epoch, navigation, options } = *scene;
        let alone = self.single_point.solve(epoch, navigation, options, None);
        let Some(estimate) = &alone.estimate else { return alone };
        let mut memory = Memory {
            time: epoch.time,
            frame: LocalFrame::at(estimate.position),
            belief: Belief::zero(),
            begun: [false; Constellation::COUNT],
            phases: Phases::default(),
            issues: Vec::new(),
            standstill: Standstill::default(),
            failing_s: 0.0,
        };
        if self.observe(scene, &memory.frame, estimate.position).is_none() {
            return alone;
        }
        let list = &self.measurements.list;
        let is_used = |index: usize| list[index].is_above_mask;
        let velocity = self.velocity.estimate(estimate.position, list, is_used, options);
        let (local, drift_m_s) = match &velocity {
            Some(velocity) => {
                (memory.frame.rotation * velocity.velocity_m_s, velocity.clock_drift_m_s)
            }
            None => (Vector3::zeros(), 0.0),
        };
        for axis in 0..3 {
            memory.belief.renew(axis, 0.0, START_M);
            memory.belief.renew(VELOCITY + axis, local[axis], START_M_S);
        }
        memory.belief.renew(DRIFT, drift_m_s, CRYSTAL_DRIFT_M_S);
        self.settle_clock(&mut memory, None, &options.graph);
        if velocity.is_some() {
            self.rates(&memory, estimate.position, options);
            // What contradicts the epoch's own velocity, where the filter knows none yet.
            let (state, limit) = (memory.belief.state(), self.settings.limit);
            self.rows.rates.retain(|rate| rate.linearize(&state).residual.powi(2) <= limit);
        }
        let all = std::mem::take(&mut self.rows.ranges);
        let is_used =
            |range: &&Ranging| estimate.satellites_used.binary_search(&range.satellite).is_ok();
        self.rows.ranges.extend(all.iter().filter(is_used));
        self.rows.enter(&mut memory.belief, &[], self.settings.limit, 1.0, &options.graph);
        self.rows.ranges = all;
        // As wide as single-point positioning says, which knows how well its residuals fit.
        let own = memory.belief.state_covariance().fixed_view::<3, 3>(0, 0).trace();
        memory.belief.scale((estimate.covariance.trace() / own).max(1.0));
        self.finish(scene, memory, options.graph.independence_s)
    }

    /// Measurements placed and their pseudoranges; `None` where no receiver can be.
    fn observe(&mut self, scene: &Scene<'_>, frame: &LocalFrame, place: Ecef) -> Option<()> {
        let Scene { epoch, navigation, options } = *scene;
        let Self { measurements, rows, .. } = self;
        rows.clear();
        measurements.gather(epoch, navigation, options);
        measurements.place(place, epoch.time, navigation, options)?;
        // The least suspect first; the satellite decides among equals.
        measurements.list.sort_unstable_by(|a, b| {
            a.variance_m2.total_cmp(&b.variance_m2).then(a.satellite.cmp(&b.satellite))
        });
        look(frame, &measurements.list, &mut rows.sights);
        for (sight, measurement) in sighted(&measurements.list).filter(|(_, m)| !m.is_excluded) {
            let constellation = measurement.satellite.constellation;
            let bias = constellation != Constellation::Gps;
            let bias = bias.then_some(constellation.index() as u32);
            rows.ranges.push(Ranging::new(sight, measurement, bias));
        }
        Some(())
    }

    /// Finds clocks that begin or jumped from the median of the pseudoranges.
    ///
    /// Without an interval all begin; without a motion model the receiver's does at every epoch.
    fn settle_clock(&mut self, memory: &mut Memory, interval_s: Option<f64>, graph: &GraphOptions) {
        let state = memory.belief.state();
        self.rows.see(&state);
        let Rows { ranges, lines, misses_m, .. } = &mut self.rows;
        let begun = memory.begun;
        let is_known = |range: &&Ranging| range.bias.is_none_or(|bias| begun[bias as usize]);
        misses_m.clear();
        let known = ranges.iter().filter(is_known);
        misses_m.extend(known.map(|range| range.miss_m(lines, &state, memory.belief.biases_m())));
        let mut miss_m = median(misses_m);
        for constellation in Constellation::ALL {
            let place = constellation.index();
            let of = |range: &&Ranging| range.bias == Some(place as u32);
            if memory.begun[place] || !ranges.iter().any(|range| of(&range)) {
                continue;
            }
            memory.belief.renew(BIAS + place, 0.0, BIAS_M);
            memory.begun[place] = true;
            misses_m.clear();
            let misses = ranges.iter().filter(of);
            let biases_m = memory.belief.biases_m();
            misses_m.extend(misses.map(|range| range.miss_m(lines, &state, biases_m)));
            let own_m = median(misses_m).unwrap_or(0.0);
            // Without any clock yet, the first constellation's stands in for GPS's.
            let clock_m = *miss_m.get_or_insert(own_m);
            memory.belief.shift(BIAS + place, own_m - clock_m);
        }
        let miss_m = miss_m.unwrap_or(0.0);
        let jump_m = interval_s.filter(|_| graph.motion).and_then(|s| jump_m(miss_m, s));
        match jump_m {
            Some(jump_m) => memory.belief.shift(CLOCK, jump_m),
            None => memory.belief.renew(CLOCK, state[CLOCK] + miss_m, START_CLOCK_M),
        }
        if !graph.motion && interval_s.is_some() {
            memory.belief.renew(DRIFT, 0.0, CRYSTAL_DRIFT_M_S);
        }
    }

    /// Doppler rows of the measurements that are used.
    fn rates(&mut self, memory: &Memory, place: Ecef, options: &PositioningOptions) {
        if options.graph.doppler != DopplerUse::Satellites {
            return;
        }
        for measurement in self.measurements.list.iter().filter(|m| m.is_above_mask) {
            let Some(rate_m_s) = measurement.range_rate_m_s else { continue };
            let cn0_db_hz = measurement.cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ);
            let sigma_m_s = variance_m2_s2(options.doppler_sigma_m_s, cn0_db_hz).sqrt();
            let (frame, state) = (&memory.frame, &measurement.state);
            self.rows.rates.push(DopplerFactor::new(frame, place, state, rate_m_s, sigma_m_s));
        }
    }

    /// Keeps what the next epoch needs and answers this one.
    fn finish(&mut self, scene: &Scene<'_>, mut memory: Memory, interval_s: f64) -> Solution {
        let options = scene.options;
        let has_velocity = options.graph.motion || self.paced(&mut memory, options);
        if options.graph.phase {
            memory.issues.clear();
            memory.issues.extend(self.measurements.list.iter().map(|m| m.ephemeris));
            memory.phases.keep(&self.rows.sights, &self.measurements.list);
        }
        let mut reasons = Vec::new();
        self.measurements.aiding_reasons(&mut reasons);
        let odometry = self.measurements.odometry.filter(|_| self.rows.odometry.is_none());
        reasons.extend(odometry.map(|o| Reason::OdometryUnused { interval_s: o.interval_s }));
        let (state, biases_m) = (memory.belief.state(), memory.belief.biases_m());
        self.rows.see(&state);
        let Rows { used, lines, ranges, weights, .. } = &mut self.rows;
        let is_used = |range: &Ranging| used.binary_search(&range.satellite).is_ok();
        weights.clear();
        weights.extend(ranges.iter().map(|range| f64::from(u8::from(is_used(range)))));
        let kernelled = ranges.iter().zip(&*weights).map(|(range, weight)| {
            let residual = range.linearize(lines, &state, biases_m).residual;
            (range.satellite.constellation, weight * residual, *weight)
        });
        let residuals = Residuals::of(kernelled);
        let spacing_s = interval_s.max(options.graph.independence_s);
        let answer = Answer {
            status: Status::Ekf,
            time: memory.time,
            frame: &memory.frame,
            state: &state,
            covariance: &memory.belief.state_covariance(),
            biases_m,
            lines,
            ranges,
            weights,
            has_velocity,
            errors: ErrorModel {
                repetition: repetition(spacing_s, options.graph.correlation_s),
                variance_factor: residuals.variance_factor(),
                orbit_clock_m2: options.graph.orbit_clock_sigma_m.powi(2),
            },
            reasons,
        };
        let solution = answer.solution();
        self.memory = Some(memory);
        solution
    }

    /// Without a motion model, the velocity that carries on to the next epoch: this epoch's own
    /// from Doppler, (11) of Wen & Hsu (2021); returns whether there is one.
    fn paced(&mut self, memory: &mut Memory, options: &PositioningOptions) -> bool {
        let place = memory.frame.to_ecef(Enu(position(&memory.belief.state())));
        let list = &self.measurements.list;
        let is_used = |index: usize| list[index].is_above_mask;
        let velocity = match options.graph.doppler {
            DopplerUse::Velocity => self.velocity.estimate(place, list, is_used, options),
            DopplerUse::None | DopplerUse::Satellites => None,
        };
        let (local, sigma_m_s) = match &velocity {
            Some(velocity) => (
                memory.frame.rotation * velocity.velocity_m_s,
                options.graph.doppler_velocity_sigma_m_s,
            ),
            None => (Vector3::zeros(), UNKNOWN_SPEED_M_S),
        };
        for axis in 0..3 {
            memory.belief.renew(VELOCITY + axis, local[axis], sigma_m_s);
        }
        if let Some(velocity) = &velocity {
            memory.belief.renew(DRIFT, velocity.clock_drift_m_s, sigma_m_s);
        }
        velocity.is_some()
    }
}

snapshot_fields!(Memory { time, frame, belief, begun, phases, issues, standstill, failing_s });

impl KalmanFilter {
    /// Writes what the next answers depend on; the settings follow from the options.
    pub(in crate::positioning) fn save(&self, writer: &mut SnapshotWriter) {
        self.memory.save(writer);
    }

    /// The filter that was written, by the options it was made with.
    pub(in crate::positioning) fn load(
        options: &PositioningOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        Ok(Self { memory: Snapshot::load(reader)?, ..Self::new(options) })
    }

    /// Swaps the storage both work in.
    pub(in crate::positioning) fn exchange_memory(&mut self, other: &mut Self) {
        let Self { settings: _, memory: _, single_point, velocity, measurements, rows } = self;
        single_point.exchange_memory(&mut other.single_point);
        std::mem::swap(velocity, &mut other.velocity);
        std::mem::swap(measurements, &mut other.measurements);
        std::mem::swap(rows, &mut other.rows);
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for KalmanFilter {
    fn clone(&self) -> Self {
        Self {
            settings: self.settings.clone(),
            memory: self.memory.clone(),
            single_point: self.single_point.with_fresh_memory(),
            velocity: VelocityEstimator::default(),
            measurements: Measurements::default(),
            rows: Rows::default(),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.settings.clone_from(&source.settings);
        self.memory.clone_from(&source.memory);
        self.single_point.answer_like(&source.single_point);
    }
}
