//! The chain of epochs in a graph: start, growth, marginalisation.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::config::DopplerUse;
use crate::gnss::{
    Constellation, Ecef, Enu, EphemerisIssue, GpsTime, LocalFrame, Odometry, SatelliteId,
};
use crate::graph::{
    Elimination, EliminationError, Estimate, OptimizerOptions, Prior, Problem, System, Widening,
    Workspace, optimize,
};
use crate::positioning::clock_jump::jump_m;
use crate::positioning::factors::{
    BiasFactor, CLOCK, ClockFactor, DRIFT, DopplerVelocityFactor, Line, MotionFactor,
    OdometryFactor, STATE, State, VELOCITY, ZeroVelocityFactor, position,
};
use crate::positioning::phases::{ClockScratch, Phases};
use crate::positioning::ranging::{ClockChange, RangesAt, Ranging, above_mask, look, rates};
use crate::positioning::receiver::{self, ReceiverModel, Signal, common_ionosphere_m};
use crate::positioning::rivals::Watch;
use crate::positioning::setup::{GraphSettings, Setup};
use crate::positioning::standstill::Standstill;
use crate::positioning::starts::{START_BIAS_M, UNKNOWN_SPEED_M_S, start_frame};
use crate::positioning::uncertainty::{Residuals, repetition};
use crate::positioning::velocity::VelocityEstimator;
use crate::positioning::{Measurement, Measurements};
use crate::snapshot::state_fields;

use super::epoch::{EpochLink, Excess, Factors, GraphEpoch, Rows, Seen};
use super::start::{follow_doppler, is_precise, regularize};

/// The epochs in the graph, their estimate, and the prior of those marginalised.
#[derive(Debug)]
pub(super) struct Chain {
    pub(super) frame: LocalFrame,
    pub(super) epochs: Vec<GraphEpoch>,
    pub(super) estimate: Estimate<STATE>,
    pub(super) prior: Prior<STATE>,
    phases: Phases,
    standstill: Standstill,
    /// Receiver model, learnt from residuals. A restart does not clear it.
    pub(super) receiver: ReceiverModel,
    pub(super) watch: Watch,
    /// Constellations whose constant inter-system bias is in the graph.
    pub(super) begun: [bool; Constellation::COUNT],
    sequence: usize,
    /// Time of its first epoch.
    pub(super) started: GpsTime,
    /// Whether the start is proven: by the agreement of one epoch's pseudoranges, or with the
    /// mixture by the search for other positions.
    pub(super) is_proven: bool,
    /// Largest number of epochs that each have separate inter-system biases; zero if the biases are
    /// constant.
    ring: usize,
}

state_fields!(
    Chain {
        frame,
        epochs,
        estimate,
        prior,
        phases,
        standstill,
        receiver,
        watch,
        begun,
        sequence,
        started,
        is_proven,
        ring,
    }
    checked by is_whole
);

/// Scratch to build and solve a chain.
#[derive(Debug, Default)]
pub(super) struct ChainScratch {
    /// The epoch that is being built.
    factors: Factors,
    pub(super) numbers: Vec<f64>,
    pub(super) lines: Vec<Line>,
    /// Residuals of which the search for other positions takes the medians.
    pub(super) excesses: Vec<Excess>,
    pub(super) seen: [Seen; 2],
    clock: ClockScratch,
    velocity: VelocityEstimator,
    /// Signals of the newest epoch's pseudoranges.
    pub(super) signals: Vec<Signal>,
    /// Whether the start of the newest epoch's solve is about as precise as its solution.
    pub(super) is_start_precise: bool,
}

impl Chain {
    /// An empty chain, with separate inter-system biases for each of up to `ring` epochs, or with
    /// constant biases if `ring` is zero.
    pub(super) fn new(ring: usize) -> Self {
        Self {
            frame: start_frame(),
            epochs: Vec::new(),
            estimate: Estimate::new(),
            prior: Prior::none(),
            phases: Phases::default(),
            standstill: Standstill::default(),
            receiver: ReceiverModel::default(),
            watch: Watch::default(),
            begun: [false; Constellation::COUNT],
            sequence: 0,
            started: GpsTime::EPOCH,
            is_proven: false,
            ring,
        }
    }

    /// Time of the newest epoch.
    pub(super) fn last_time(&self) -> Option<GpsTime> {
        self.epochs.last().map(|epoch| epoch.time)
    }

    /// Largest number of epochs that each have separate biases; zero if the biases are constant.
    pub(super) fn ring(&self) -> usize {
        self.ring
    }

    /// Removes the newest epoch.
    pub(super) fn drop_newest(&mut self) {
        self.epochs.pop();
        self.estimate.states.pop();
    }

    /// Empties the chain, and sets the origin of its local frame to `start`.
    pub(super) fn begin(&mut self, start: Ecef) {
        self.clear();
        self.frame = LocalFrame::at(start);
    }

    /// Empties the chain. The receiver model stays.
    pub(super) fn clear(&mut self) {
        self.epochs.clear();
        self.estimate.states.clear();
        self.estimate.border.clear();
        self.prior = Prior::none();
        self.phases.clear();
        self.standstill = Standstill::default();
        self.watch = Watch::default();
        self.begun = [false; Constellation::COUNT];
        self.sequence = 0;
        self.is_proven = false;
    }

    /// Sets the prior of the first epoch's position to these standard deviations (m, east, north,
    /// up). The chain then counts as settled and its start as proven.
    pub(super) fn know_position(&mut self, sigma_m: &Vector3<f64>) {
        let Some(first) = self.epochs.first_mut() else { return };
        let components = &mut Arc::make_mut(&mut first.factors).components;
        for component in components.iter_mut().filter(|component| component.column < 3) {
            component.inverse_sigma = sigma_m[component.column].recip();
        }
        self.watch.settle(first.time);
        self.is_proven = true;
    }

    /// The newest state, extrapolated to `time` by its velocity and clock drift.
    pub(super) fn predicted(&self, time: GpsTime) -> State {
        let (Some(last), Some(state)) = (self.last_time(), self.estimate.states.last()) else {
            return State::zeros();
        };
        let interval_s = time - last;
        let mut next = *state;
        for (moved, rate) in [(0, VELOCITY), (1, VELOCITY + 1), (2, VELOCITY + 2), (CLOCK, DRIFT)] {
            next[moved] += interval_s * state[rate];
        }
        next
    }

    /// Ephemeris of a satellite's phase at the newest epoch.
    pub(super) fn ephemeris(&self, satellite: SatelliteId) -> Option<EphemerisIssue> {
        self.phases.ephemeris(satellite)
    }

    /// Adds an epoch with the initial state `guess`, at which the measurements were modelled.
    ///
    /// The clock of the guess, and the biases of constellations that the chain has not had before,
    /// are set from the medians of the pseudorange residuals.
    pub(super) fn append(
        &mut self,
        time: GpsTime,
        mut guess: State,
        measurements: &Measurements,
        setup: &Setup,
        scratch: &mut ChainScratch,
    ) {
        let options = &setup.options.graph;
        let interval_s = self.last_time().map(|last| time - last);
        self.started = interval_s.map_or(time, |_| self.started);
        self.begin_factors(measurements, &mut scratch.factors);
        let factors = &mut scratch.factors;
        let receiver = self.frame.to_ecef(Enu(position(&guess)));
        let velocity =
            scratch.velocity.estimate_whole(receiver, &measurements.list, &setup.options);
        factors.doppler_velocity_m_s = velocity.map(|v| self.frame.rotation * v.velocity_m_s);
        let spacing_s = interval_s.unwrap_or(options.independence_s);
        if setup.learns {
            self.receiver.observe(time, &measurements.list);
        }
        look(&self.frame, &measurements.list, &mut factors.sights);
        self.add_pseudoranges(measurements, setup, scratch);
        self.add_dopplers(receiver, &measurements.list, setup, scratch);
        scratch.is_start_precise = true;
        if let (true, Some(interval_s), Some(before)) =
            (setup.learns, interval_s, self.estimate.states.last())
        {
            let rates = &scratch.factors.rates;
            let follows = follow_doppler(&mut guess, before, interval_s, rates);
            scratch.is_start_precise = is_precise(interval_s, follows, options.horizontal_walk_m_s);
        }
        let clock_m = self.start_clocks(&mut guess, scratch);
        if let (Some(interval_s), Some(before)) = (interval_s, self.estimate.states.last()) {
            let factors = &mut scratch.factors;
            factors.link = Some(self.link(interval_s, clock_m, setup));
            factors.phase_clock =
                setup.learns.then(|| self.receiver.phase_against_pseudorange(interval_s));
            if options.phase {
                self.add_phases(interval_s, [before, &guess], &measurements.list, setup, scratch);
            }
        }
        let factors = &mut scratch.factors;
        if let Some(odometry) = &measurements.odometry {
            self.add_odometry(factors, odometry, interval_s, receiver);
        }
        let mut share = match setup.learns {
            true => self.receiver.independent_share(spacing_s),
            false => (spacing_s / options.independence_s).min(1.0),
        };
        if options.zero_velocity && self.standstill.observe(&factors.rates, interval_s) {
            factors.standstill = interval_s.map(ZeroVelocityFactor::new);
            // At rest multipath repeats: scale the weight by Δt/τ, with τ its correlation time.
            share = share.min(spacing_s / options.correlation_s);
        }
        regularize(factors, interval_s.is_none(), &guess, options);
        factors.vertical = setup.learns.then(|| self.receiver.vertical_prior(spacing_s));
        if options.phase {
            self.phases.keep(&factors.sights, &measurements.list);
        }
        self.estimate.states.push(guess);
        self.epochs.push(GraphEpoch {
            time,
            share,
            repetition: (share * repetition(spacing_s, options.correlation_s)).max(1.0),
            residuals: Residuals::default(),
            factors: Arc::new(factors.clone()),
        });
        self.sequence += 1;
    }

    /// Empties the factors and begins those of the next epoch. The border gets a variable for each
    /// of its biases.
    fn begin_factors(&mut self, measurements: &Measurements, factors: &mut Factors) {
        factors.clear();
        factors.slot = self.sequence % self.ring.max(1);
        factors.without_ephemeris.clone_from(&measurements.without_ephemeris);
        factors.ionosphere_fallback = measurements.ionosphere_fallback;
        let border = &mut self.estimate.border;
        border.resize(border.len().max(Constellation::COUNT * (factors.slot + 1)), 0.0);
    }

    /// Adds the differences of phases between two states, `interval_s` apart.
    fn add_phases(
        &self,
        interval_s: f64,
        states: [&State; 2],
        list: &[Measurement],
        setup: &Setup,
        scratch: &mut ChainScratch,
    ) {
        let Factors { phases, sights, .. } = &mut scratch.factors;
        self.phases.differences(list, setup.options.graph.phase_sigma_m, interval_s, phases);
        self.phases.follow_clock(sights, states, phases, &mut scratch.clock);
        let scale = if setup.learns { self.receiver.phase_scale() } else { 1.0 };
        phases.iter_mut().for_each(|phase| phase.inverse_sigma /= scale);
    }

    /// Adds the factor of the odometry's displacement, if the displacement covers the interval.
    fn add_odometry(
        &self,
        factors: &mut Factors,
        odometry: &Odometry,
        interval_s: Option<f64>,
        receiver: Ecef,
    ) {
        let over = |interval_s| OdometryFactor::over(interval_s, &self.frame, receiver, odometry);
        factors.odometry.extend(interval_s.and_then(over));
        factors.unused_odometry_s = factors.odometry.is_empty().then_some(odometry.interval_s);
    }

    /// Adds the Doppler factors of the measurements that are used.
    fn add_dopplers(
        &self,
        receiver: Ecef,
        list: &[Measurement],
        setup: &Setup,
        scratch: &mut ChainScratch,
    ) {
        if setup.options.graph.doppler != DopplerUse::Satellites {
            return;
        }
        let is_new = |m: &Measurement| !setup.learns || !self.receiver.repeats_rate(m);
        let scale = if setup.learns { self.receiver.doppler_scale() } else { 1.0 };
        let list = above_mask(list).filter(|(_, m)| is_new(m));
        let rates = rates(list, &self.frame, receiver, setup.options.doppler_sigma_m_s);
        scratch.factors.rates.extend(rates.map(|rate| rate.scaled(scale)));
    }

    /// Adds the pseudorange factors of the measurements that are used.
    fn add_pseudoranges(
        &mut self,
        measurements: &Measurements,
        setup: &Setup,
        scratch: &mut ChainScratch,
    ) {
        let (list, factors) = (&measurements.list, &mut scratch.factors);
        scratch.signals.clear();
        let present = |c: Constellation| {
            list.iter().any(|m| m.is_above_mask && !m.is_excluded && m.satellite.constellation == c)
        };
        // Constant biases refer to GPS, biases per epoch to its first constellation.
        let reference = match self.ring {
            0 => Some(Constellation::Gps),
            _ => Constellation::ALL.into_iter().find(|c| present(*c)),
        };
        let first = Constellation::COUNT * factors.slot;
        let common_m = common_ionosphere_m(list);
        for (sight, measurement) in above_mask(list).filter(|(_, m)| !m.is_excluded) {
            let constellation = measurement.satellite.constellation;
            let further = Some(constellation) != reference;
            let bias = further.then_some((first + constellation.index()) as u32);
            let mut range = Ranging::new(sight, measurement, bias);
            if setup.learns {
                let signal = Signal::of(measurement, common_m);
                let error = self.receiver.pseudorange_error(constellation, &signal);
                range.set_error_model(error, receiver::error_before_learning(&signal));
                scratch.signals.push(signal);
            }
            factors.ranges.push(range);
        }
        if self.ring != 0 {
            self.begun = [false; Constellation::COUNT];
        }
    }

    /// Sets the clock of `guess` and the biases that begin; returns the measured minus the
    /// predicted clock (m), if it is measured. A late reference makes all clocks its own.
    fn start_clocks(&mut self, guess: &mut State, scratch: &mut ChainScratch) -> Option<f64> {
        let ChainScratch { factors, numbers, lines, .. } = scratch;
        factors.see(guess, lines);
        let Factors { ranges, biases, .. } = factors;
        let begins = |variable, mean_m| {
            biases.push(BiasFactor { variable, mean_m, inverse_sigma: START_BIAS_M.recip() });
        };
        let seen = RangesAt { ranges, lines, state: guess };
        let biases_m = &mut self.estimate.border;
        let ClockChange { clock_m, reference_m } =
            seen.start_clocks(biases_m, &mut self.begun, numbers, begins);
        self.estimate.states.iter_mut().for_each(|state| state[CLOCK] += reference_m);
        guess[CLOCK] += clock_m.unwrap_or(0.0) + reference_m;
        clock_m
    }

    /// The link to the previous epoch, besides phases.
    fn link(&self, interval_s: f64, clock_m: Option<f64>, setup: &Setup) -> EpochLink {
        if setup.options.graph.motion {
            let jump_m = jump_m(clock_m.unwrap_or(0.0), interval_s);
            let motion = MotionFactor::new(&setup.motion, interval_s);
            let mut clock = ClockFactor::new(&setup.clock, interval_s, jump_m);
            if setup.learns {
                clock =
                    clock.with_step_prior(self.receiver.pseudorange_against_doppler(interval_s));
            }
            return EpochLink::Motion(motion, clock);
        }
        let velocity = self.epochs.last().and_then(|before| before.factors.doppler_velocity_m_s);
        let sigma_m_s = match velocity {
            Some(_) => setup.options.graph.doppler_velocity_sigma_m_s,
            None => UNKNOWN_SPEED_M_S,
        };
        EpochLink::DopplerVelocity(DopplerVelocityFactor {
            velocity_m_s: velocity.unwrap_or_else(Vector3::zeros),
            interval_s,
            inverse_sigma: sigma_m_s.recip(),
        })
    }

    /// Updates the sums of each epoch's residuals at the estimate.
    pub(super) fn sum_residuals(&mut self, settings: &GraphSettings, scratch: &mut ChainScratch) {
        let (kernel, lines) = (settings.kernels.last().pseudorange, &mut scratch.lines);
        let Estimate { states, border } = &self.estimate;
        for (epoch, state) in self.epochs.iter_mut().zip(states) {
            epoch.factors.see(state, lines);
            epoch.residuals = epoch.factors.residuals(lines, state, border, &kernel);
            // With `weighted_by_pseudorange`, the search for other positions proves the position
            // instead.
            self.is_proven |=
                !settings.kernels.last().weighted_by_pseudorange && epoch.residuals.agree();
        }
    }

    /// Age of the chain at `time` (s), if its start is not proven yet.
    ///
    /// With few satellites or mostly reflections, a redescending kernel may accept the wrong
    /// pseudoranges. Later epochs then agree with the prior that these leave.
    pub(super) fn unproven_s(&self, time: GpsTime) -> Option<f64> {
        (!self.is_proven).then(|| time - self.started)
    }

    /// Moves the estimate to the minimum of the objective; returns the cost before the last step.
    pub(super) fn solve(
        &mut self,
        settings: &GraphSettings,
        how: &OptimizerOptions,
        scratch: &mut ChainScratch,
        workspace: &mut Workspace<STATE>,
    ) -> Result<f64, EliminationError> {
        let Self { epochs, prior, estimate, .. } = self;
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, seen: &mut scratch.seen };
        let summary = optimize(&mut rows, estimate, how, workspace)?;
        self.sum_residuals(settings, scratch);
        Ok(summary.cost)
    }

    /// Linearises and factors the chain at its estimate.
    pub(super) fn factor(
        &self,
        settings: &GraphSettings,
        scratch: &mut ChainScratch,
        workspace: &mut Workspace<STATE>,
    ) -> Result<(), EliminationError> {
        let Workspace { system, elimination, .. } = workspace;
        let Self { epochs, prior, estimate, .. } = self;
        system.reset(estimate.states.len(), estimate.border.len());
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, seen: &mut scratch.seen };
        rows.linearize(estimate, Widening::Final(1.0), system);
        elimination.factor(system, 0.0)
    }

    fn is_whole(&self) -> bool {
        let border = self.estimate.border.len();
        self.epochs.len() == self.estimate.states.len()
            && self.epochs.len() <= self.sequence
            && self.has_valid_references(border)
            && self.prior.variables().all(|variable| variable < border)
    }

    /// Whether every factor refers to variables, columns and satellites that exist.
    fn has_valid_references(&self, border: usize) -> bool {
        // The first epoch's phases refer to an epoch that is marginalised.
        let before =
            |k: usize| k.checked_sub(1).map_or(usize::MAX, |k| self.epochs[k].factors.sights.len());
        self.epochs.iter().enumerate().all(|(k, epoch)| epoch.factors.is_within(border, before(k)))
            && self.phases.is_within(self.epochs.last().map_or(0, |last| last.factors.sights.len()))
    }

    /// Whether some epoch has been marginalised.
    pub(super) fn has_past(&self) -> bool {
        self.epochs.len() < self.sequence
    }

    /// Marginalises the oldest epoch into the prior; the biases' random walk is `bias_walk_m`
    /// (m/√s).
    pub(super) fn forget_oldest(
        &mut self,
        settings: &GraphSettings,
        bias_walk_m: f64,
        scratch: &mut ChainScratch,
        (system, elimination): &mut (System<STATE>, Elimination<STATE>),
    ) -> Result<(), EliminationError> {
        self.keep_residuals(&mut scratch.lines);
        system.reset(2, self.estimate.border.len());
        let Self { epochs, prior, estimate, .. } = self;
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, seen: &mut scratch.seen };
        rows.add_oldest(estimate, system);
        let (per_epoch, slot) = (self.ring != 0, self.epochs[0].factors.slot);
        let retired = |variable| per_epoch && variable / Constellation::COUNT == slot;
        self.prior.marginalize(system, &self.estimate, retired, elimination)?;
        let interval_s = self.epochs[1].time - self.epochs[0].time;
        if !per_epoch && 0.0 < bias_walk_m {
            let variance_m2 = bias_walk_m * bias_walk_m * interval_s;
            self.prior.loosen_border(variance_m2, &mut scratch.numbers);
        }
        self.epochs.remove(0);
        self.estimate.states.remove(0);
        Ok(())
    }
}
