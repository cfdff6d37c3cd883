//! The filter over epochs: start, prediction, update, and restart.

use nalgebra::Vector3;

use crate::config::{DopplerUse, GraphOptions, PositioningOptions};
use crate::gnss::{
    Constellation, Ecef, Enu, GpsTime, LocalFrame, Reason, Solution, SolutionEstimate, Status,
};
use crate::positioning::Measurements;
use crate::positioning::answer::Answer;
use crate::positioning::clock_jump::{CRYSTAL_DRIFT_M_S, jump_m};
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::factors::{
    CLOCK, DRIFT, OdometryFactor, VELOCITY, ZeroVelocityFactor, position,
};
use crate::positioning::phases::{ClockScratch, Phases};
use crate::positioning::ranging::{Influence, RangesAt, Ranging, above_mask, look, rates};
use crate::positioning::setup::Setup;
use crate::positioning::spp::SinglePoint;
use crate::positioning::standstill::Standstill;
use crate::positioning::starts::{
    FAILING_MAX_S, FRAME_LIMIT_M, START_BIAS_M, START_CLOCK_M, START_M, START_M_S,
    UNKNOWN_SPEED_M_S,
};
use crate::positioning::uncertainty::{ErrorModel, Residuals, repetition};
use crate::positioning::velocity::VelocityEstimator;
use crate::snapshot::state_fields;

use super::gaussian::{BIAS, Gaussian};
use super::rows::Rows;

/// Least standard deviation of a phase difference (m): a quarter wavelength at L1, the bound of
/// multipath from a reflection no stronger than the signal. The filter has no kernel for phases,
/// and its innovation test accepts the rows that come first, right or wrong. With 0.01 m the data
/// set `hers-hert` has errors of up to 26 m.
const PHASE_BOUND_M: f64 = 0.05;

/// State of the filter between epochs.
#[derive(Debug)]
struct Known {
    time: GpsTime,
    frame: LocalFrame,
    gaussian: Gaussian,
    /// Constellations whose bias has begun.
    begun: [bool; Constellation::COUNT],
    phases: Phases,
    standstill: Standstill,
    /// For how long most pseudoranges have failed the test (s).
    failing_s: f64,
}

state_fields!(Known { time, frame, gaussian, begun, phases, standstill, failing_s });

/// A causal estimator that keeps one state.
#[derive(Debug)]
pub(crate) struct KalmanFilter {
    /// `None` before the first position.
    known: Option<Known>,
}

state_fields!(KalmanFilter { known });

/// Scratch of the filter.
#[derive(Debug, Default)]
pub(crate) struct FilterScratch {
    single_point: SinglePoint,
    velocity: VelocityEstimator,
    measurements: Measurements,
    rows: Rows,
    clock: ClockScratch,
}

impl Engine for KalmanFilter {
    type Scratch = FilterScratch;

    fn new(_setup: &Setup, _revises: bool) -> Self {
        Self { known: None }
    }

    /// An epoch that is not after the last one is answered alone and does not change the state.
    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut FilterScratch,
        _revisions: &mut Vec<Solution>,
    ) -> Solution {
        let Some(known) = &mut self.known else { return self.begin(inputs, scratch) };
        let interval_s = inputs.epoch.time - known.time;
        if interval_s <= 0.0 {
            return scratch.single_point.solve(inputs, None);
        }
        let is_far = FRAME_LIMIT_M < position(&known.gaussian.state()).norm();
        let is_over = inputs.options().graph.gap_s < interval_s || is_far;
        let solution = if is_over { None } else { scratch.go_on(inputs, known, interval_s) };
        solution.unwrap_or_else(|| self.begin(inputs, scratch))
    }
}

impl KalmanFilter {
    /// Begins from the epoch's own position.
    fn begin(&mut self, inputs: &EpochInputs<'_>, scratch: &mut FilterScratch) -> Solution {
        let alone = scratch.single_point.solve(inputs, None);
        let begun = alone.estimate.as_ref().and_then(|e| scratch.begin(inputs, e));
        match begun {
            None => {
                self.known = None;
                alone
            }
            Some((known, solution)) => {
                self.known = Some(known);
                solution
            }
        }
    }
}

impl FilterScratch {
    /// Predicts and updates by one epoch; `None` if the filter is lost and must restart.
    fn go_on(
        &mut self,
        inputs: &EpochInputs<'_>,
        known: &mut Known,
        interval_s: f64,
    ) -> Option<Solution> {
        let (setup, graph) = (inputs.setup, &inputs.options().graph);
        let walks = graph.motion.then_some((&setup.motion, &setup.clock));
        known.gaussian.predict(walks, interval_s);
        known.time = inputs.epoch.time;
        if !graph.motion {
            known.begun = [false; Constellation::COUNT];
        } else {
            let wandered_m2 = graph.bias_walk_m.powi(2) * interval_s;
            for constellation in Constellation::ALL.into_iter().skip(1).map(Constellation::index) {
                if known.begun[constellation] {
                    known.gaussian.loosen(BIAS + constellation, wandered_m2);
                }
            }
        }
        let receiver = known.frame.to_ecef(Enu(position(&known.gaussian.state())));
        self.observe(inputs, &known.frame, receiver)?;
        self.start_clocks(known, Some(interval_s), graph);
        self.rates(&known.frame, receiver, inputs.options());
        if graph.phase {
            let before = |satellite| known.phases.ephemeris(satellite);
            let (time, navigation) = (inputs.epoch.time, inputs.navigation);
            self.measurements.follow_ephemerides(before, receiver, time, navigation);
            let sigma_m = graph.phase_sigma_m.max(PHASE_BOUND_M);
            let Self { measurements, rows: Rows { sights, phases, .. }, clock, .. } = self;
            known.phases.differences(&measurements.list, sigma_m, interval_s, phases);
            let states = [&known.gaussian.past(), &known.gaussian.state()];
            known.phases.follow_clock(sights, states, phases, clock);
        }
        self.other_sensors(known, receiver, setup, interval_s);
        let independent_share = (interval_s / graph.independence_s).min(1.0);
        let before = known.phases.sights();
        self.rows.enter(
            &mut known.gaussian,
            before,
            setup.innovation_limit,
            independent_share,
            graph,
        );
        let is_failing = self.rows.used.len() * 2 < self.rows.ranges.len();
        known.failing_s = if is_failing { known.failing_s + interval_s } else { 0.0 };
        if FAILING_MAX_S < known.failing_s && self.can_begin(inputs) {
            return None;
        }
        Some(self.finish(inputs, known, interval_s))
    }

    /// The displacement by odometry, and whether the receiver is at rest.
    fn other_sensors(&mut self, known: &mut Known, receiver: Ecef, setup: &Setup, interval_s: f64) {
        let rows = &mut self.rows;
        let over = |odometry| OdometryFactor::over(interval_s, &known.frame, receiver, odometry);
        rows.odometry = self.measurements.odometry.as_ref().and_then(over);
        if setup.options.graph.zero_velocity {
            let is_still = known.standstill.observe(&rows.rates, Some(interval_s));
            rows.standstill = is_still.then(|| ZeroVelocityFactor::new(interval_s));
        }
    }

    /// Whether the epoch's own single point has a position.
    fn can_begin(&mut self, inputs: &EpochInputs<'_>) -> bool {
        self.single_point.solve(inputs, None).estimate.is_some()
    }

    /// A filter that begins at the epoch's own position, with its answer.
    fn begin(
        &mut self,
        inputs: &EpochInputs<'_>,
        estimate: &SolutionEstimate,
    ) -> Option<(Known, Solution)> {
        let (options, limit) = (inputs.options(), inputs.setup.innovation_limit);
        let mut known = Known {
            time: inputs.epoch.time,
            frame: LocalFrame::at(estimate.position),
            gaussian: Gaussian::zero(),
            begun: [false; Constellation::COUNT],
            phases: Phases::default(),
            standstill: Standstill::default(),
            failing_s: 0.0,
        };
        self.observe(inputs, &known.frame, estimate.position)?;
        let list = &self.measurements.list;
        let is_used = |index: usize| list[index].is_above_mask;
        let velocity = self.velocity.estimate(estimate.position, list, is_used, options);
        let (local, drift_m_s) = match &velocity {
            Some(velocity) => {
                (known.frame.rotation * velocity.velocity_m_s, velocity.clock_drift_m_s)
            }
            None => (Vector3::zeros(), 0.0),
        };
        for axis in 0..3 {
            known.gaussian.renew(axis, 0.0, START_M);
            known.gaussian.renew(VELOCITY + axis, local[axis], START_M_S);
        }
        known.gaussian.renew(DRIFT, drift_m_s, CRYSTAL_DRIFT_M_S);
        self.start_clocks(&mut known, None, &options.graph);
        if velocity.is_some() {
            self.rates(&known.frame, estimate.position, options);
            // The filter has no velocity yet: test against the epoch's own.
            let state = known.gaussian.state();
            self.rows.rates.retain(|rate| rate.linearize(&state).residual.powi(2) <= limit);
        }
        let all = std::mem::take(&mut self.rows.ranges);
        let is_used =
            |range: &&Ranging| estimate.satellites_used.binary_search(&range.satellite).is_ok();
        self.rows.ranges.extend(all.iter().filter(is_used));
        self.rows.enter(&mut known.gaussian, &[], limit, 1.0, &options.graph);
        self.rows.ranges = all;
        // The covariance is at least that of the single point, which takes the size of the
        // residuals into account.
        let own = known.gaussian.state_covariance().fixed_view::<3, 3>(0, 0).trace();
        known.gaussian.scale((estimate.covariance.trace() / own).max(1.0));
        let solution = self.finish(inputs, &mut known, options.graph.independence_s);
        Some((known, solution))
    }

    /// The epoch's measurements, corrected for a receiver at `receiver`, and its pseudoranges;
    /// `None` for a position where no receiver can be.
    fn observe(
        &mut self,
        inputs: &EpochInputs<'_>,
        frame: &LocalFrame,
        receiver: Ecef,
    ) -> Option<()> {
        let EpochInputs { epoch, navigation, bands, .. } = *inputs;
        let Self { measurements, rows, .. } = self;
        rows.clear();
        measurements.gather(epoch, navigation, inputs.options(), bands);
        measurements.place(receiver, epoch.time, navigation, inputs.options())?;
        // The most precise first; rows of equal precision in the order of their satellites.
        measurements.list.sort_unstable_by(|a, b| {
            a.variance_m2.total_cmp(&b.variance_m2).then(a.satellite.cmp(&b.satellite))
        });
        look(frame, &measurements.list, &mut rows.sights);
        for (sight, measurement) in above_mask(&measurements.list).filter(|(_, m)| !m.is_excluded) {
            let constellation = measurement.satellite.constellation;
            let bias = constellation != Constellation::Gps;
            let bias = bias.then_some(constellation.index() as u32);
            rows.ranges.push(Ranging::new(sight, measurement, bias));
        }
        Some(())
    }

    /// Starts clocks, and adjusts the receiver clock after jumps, by the medians of the pseudorange
    /// residuals.
    ///
    /// Without an interval all clocks start. Without a motion model the receiver clock starts at
    /// every epoch.
    fn start_clocks(&mut self, known: &mut Known, interval_s: Option<f64>, graph: &GraphOptions) {
        let state = known.gaussian.state();
        self.rows.see(&state);
        let Rows { ranges, lines, numbers, .. } = &mut self.rows;
        let Known { gaussian, begun, .. } = known;
        let mut biases_m = [0.0; Constellation::COUNT];
        biases_m.copy_from_slice(gaussian.biases_m());
        let begins = |index, mean_m| gaussian.renew(BIAS + index, mean_m, START_BIAS_M);
        let seen = RangesAt { ranges, lines, state: &state };
        // Where the reference begins late, its rows move the clock: its variance is still large.
        let change = seen.start_clocks(&mut biases_m, begun, numbers, begins);
        let clock_error_m = change.clock_m.unwrap_or(0.0);
        let jump_m = interval_s.filter(|_| graph.motion).and_then(|s| jump_m(clock_error_m, s));
        match jump_m {
            Some(jump_m) => known.gaussian.shift(CLOCK, jump_m),
            None => known.gaussian.renew(CLOCK, state[CLOCK] + clock_error_m, START_CLOCK_M),
        }
        if !graph.motion && interval_s.is_some() {
            known.gaussian.renew(DRIFT, 0.0, CRYSTAL_DRIFT_M_S);
        }
    }

    /// Doppler rows of the measurements that are used.
    fn rates(&mut self, frame: &LocalFrame, receiver: Ecef, options: &PositioningOptions) {
        if options.graph.doppler == DopplerUse::Satellites {
            let list = above_mask(&self.measurements.list);
            self.rows.rates.extend(rates(list, frame, receiver, options.doppler_sigma_m_s));
        }
    }

    /// Keeps the data that the next epoch needs, and answers this one.
    fn finish(&mut self, inputs: &EpochInputs<'_>, known: &mut Known, interval_s: f64) -> Solution {
        let options = inputs.options();
        let has_velocity = options.graph.motion || self.set_doppler_velocity(known, options);
        if options.graph.phase {
            known.phases.keep(&self.rows.sights, &self.measurements.list);
        }
        let mut reasons = Vec::new();
        self.measurements.aiding_reasons(&mut reasons);
        let odometry = self.measurements.odometry.filter(|_| self.rows.odometry.is_none());
        reasons.extend(odometry.map(|o| Reason::OdometryUnused { interval_s: o.interval_s }));
        let (state, biases_m) = (known.gaussian.state(), known.gaussian.biases_m());
        self.rows.see(&state);
        let Rows { used, lines, ranges, weights, .. } = &mut self.rows;
        let is_used = |range: &Ranging| used.binary_search(&range.satellite).is_ok();
        weights.clear();
        weights.extend(ranges.iter().map(|range| f64::from(u8::from(is_used(range)))));
        // Rows that the innovation test has rejected do not determine the state.
        let accepted = ranges.iter().filter(|range| is_used(range)).map(|range| Influence {
            constellation: range.satellite.constellation,
            pull: range.linearize(lines, &state, biases_m).residual,
            weight: 1.0,
            slope: 1.0,
            is_accepted: true,
        });
        let residuals = Residuals::of(accepted);
        let spacing_s = interval_s.max(options.graph.independence_s);
        let answer = Answer {
            status: Status::Ekf,
            time: known.time,
            frame: &known.frame,
            state: &state,
            covariance: &known.gaussian.state_covariance(),
            biases_m,
            lines,
            ranges,
            weights,
            has_velocity,
            errors: ErrorModel {
                repetition: repetition(spacing_s, options.graph.correlation_s),
                variance_factor: residuals.of_own_position().variance_factor(),
                orbit_clock_m2: options.graph.orbit_clock_sigma_m.powi(2),
            },
            reasons,
        };
        answer.solution()
    }

    /// Without a motion model, sets the velocity that predicts the next epoch: this epoch's own
    /// from Doppler, (11) of Wen & Hsu (2021). Returns whether there is one.
    fn set_doppler_velocity(&mut self, known: &mut Known, options: &PositioningOptions) -> bool {
        let receiver = known.frame.to_ecef(Enu(position(&known.gaussian.state())));
        let list = &self.measurements.list;
        let velocity = self.velocity.estimate_whole(receiver, list, options);
        let (local, sigma_m_s) = match &velocity {
            Some(velocity) => (
                known.frame.rotation * velocity.velocity_m_s,
                options.graph.doppler_velocity_sigma_m_s,
            ),
            None => (Vector3::zeros(), UNKNOWN_SPEED_M_S),
        };
        for axis in 0..3 {
            known.gaussian.renew(VELOCITY + axis, local[axis], sigma_m_s);
        }
        if let Some(velocity) = &velocity {
            known.gaussian.renew(DRIFT, velocity.clock_drift_m_s, sigma_m_s);
        }
        velocity.is_some()
    }
}
