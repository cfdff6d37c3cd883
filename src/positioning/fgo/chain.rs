//! The chain of epochs in a graph: how it begins, grows and forgets.

use nalgebra::Vector3;

use crate::config::{DopplerUse, PositioningOptions};
use crate::gnss::{Constellation, Ecef, Enu, GpsTime, LocalFrame, Odometry};
use crate::graph::{Elimination, EliminationError, Estimate, Phase, Prior, System};
use crate::positioning::clock_jump::{CRYSTAL_DRIFT_M_S, jump_m};
use crate::positioning::factors::{
    BiasFactor, CLOCK, ClockFactor, ComponentFactor, DRIFT, DopplerFactor, DopplerVelocityFactor,
    Line, MotionFactor, OdometryFactor, STATE, State, VELOCITY, ZeroVelocityFactor, position,
};
use crate::positioning::phases::Phases;
use crate::positioning::ranging::{Ranging, look, median, sighted};
use crate::positioning::standstill::Standstill;
use crate::positioning::uncertainty::repetition;
use crate::positioning::velocity::{CN0_IF_MISSING_DB_HZ, variance_m2_s2};
use crate::positioning::{Measurement, Measurements};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::epoch::{GraphEpoch, Rows, Seen, Tie};
use super::settings::Settings;

/// Deviation of the first position about its start (m): says nearly nothing.
const START_M: f64 = 1e4;
/// Deviation of the first velocity about zero, per axis (m/s).
const START_M_S: f64 = 100.0;
/// Deviation of the first clock (m): far more than any receiver leaves after the median.
const START_CLOCK_M: f64 = 1e5;
/// Deviation of an inter-system bias before it is measured (m): 1 µs.
const BIAS_M: f64 = 300.0;
/// Speed taken for a deviation where no Doppler gives the velocity of a tie (m/s).
const UNKNOWN_SPEED_M_S: f64 = 50.0;

/// The epochs in the graph, their estimate, and the prior of those before.
#[derive(Debug)]
pub(super) struct Chain {
    pub(super) frame: LocalFrame,
    pub(super) epochs: Vec<GraphEpoch>,
    pub(super) estimate: Estimate<STATE>,
    pub(super) prior: Prior<STATE>,
    phases: Phases,
    standstill: Standstill,
    spare: Vec<GraphEpoch>,
    /// Constellations whose constant bias has begun.
    begun: [bool; Constellation::COUNT],
    sequence: usize,
    /// Time of its first epoch.
    started: GpsTime,
    /// Whether an epoch has been seen whose pseudoranges agree.
    is_proven: bool,
    /// Epochs whose own biases may be alive at once; zero where biases are constant.
    ring: usize,
    scratch: Vec<f64>,
    lines: Vec<Line>,
    seen: [Seen; 2],
}

impl Clone for Chain {
    fn clone(&self) -> Self {
        let mut clone = Self::new(self.ring);
        clone.clone_from(self);
        clone
    }

    /// Copies into the storage already held.
    fn clone_from(&mut self, source: &Self) {
        self.frame = source.frame;
        self.epochs.clone_from(&source.epochs);
        self.estimate.clone_from(&source.estimate);
        self.prior.clone_from(&source.prior);
        self.phases.clone_from(&source.phases);
        self.standstill = source.standstill;
        self.begun = source.begun;
        self.sequence = source.sequence;
        self.started = source.started;
        self.is_proven = source.is_proven;
        self.ring = source.ring;
    }
}

impl Snapshot for Chain {
    fn save(&self, writer: &mut SnapshotWriter) {
        #[rustfmt::skip]
        let Self {
            frame, epochs, estimate, prior, phases, standstill, spare: _, begun, sequence, started,
            is_proven, ring, scratch: _, lines: _, seen: _,
        } = self;
        frame.save(writer);
        epochs.save(writer);
        estimate.save(writer);
        prior.save(writer);
        phases.save(writer);
        standstill.save(writer);
        begun.save(writer);
        sequence.save(writer);
        started.save(writer);
        is_proven.save(writer);
        ring.save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let chain = Self {
            frame: Snapshot::load(reader)?,
            epochs: Snapshot::load(reader)?,
            estimate: Snapshot::load(reader)?,
            prior: Snapshot::load(reader)?,
            phases: Snapshot::load(reader)?,
            standstill: Snapshot::load(reader)?,
            spare: Vec::new(),
            begun: Snapshot::load(reader)?,
            sequence: Snapshot::load(reader)?,
            started: Snapshot::load(reader)?,
            is_proven: Snapshot::load(reader)?,
            ring: Snapshot::load(reader)?,
            scratch: Vec::new(),
            lines: Vec::new(),
            seen: Default::default(),
        };
        let border = chain.estimate.border.len();
        let is_whole = chain.epochs.len() == chain.estimate.states.len()
            && chain.epochs.len() <= chain.sequence
            && chain.names_what_it_holds(border)
            && chain.prior.variables().all(|variable| variable < border);
        if is_whole { Ok(chain) } else { Err(reader.invalid("chain")) }
    }
}

impl Chain {
    /// An empty chain; `ring` is how many epochs may have biases of their own, zero for constant
    /// biases.
    pub(super) fn new(ring: usize) -> Self {
        Self {
            frame: LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0)),
            epochs: Vec::new(),
            estimate: Estimate::new(),
            prior: Prior::none(),
            phases: Phases::default(),
            standstill: Standstill::default(),
            spare: Vec::new(),
            begun: [false; Constellation::COUNT],
            sequence: 0,
            started: GpsTime::EPOCH,
            is_proven: false,
            ring,
            scratch: Vec::new(),
            lines: Vec::new(),
            seen: Default::default(),
        }
    }

    /// Time of the newest epoch.
    pub(super) fn last_time(&self) -> Option<GpsTime> {
        self.epochs.last().map(|epoch| epoch.time)
    }

    /// Epochs that may have biases of their own.
    pub(super) fn ring(&self) -> usize {
        self.ring
    }

    /// Swaps the memory both work in.
    pub(super) fn exchange_memory(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.spare, &mut other.spare);
        std::mem::swap(&mut self.scratch, &mut other.scratch);
        std::mem::swap(&mut self.lines, &mut other.lines);
        std::mem::swap(&mut self.seen, &mut other.seen);
    }

    /// Takes the newest epoch back.
    pub(super) fn drop_newest(&mut self) {
        self.spare.extend(self.epochs.pop());
        self.estimate.states.pop();
    }

    /// Forgets everything and puts the origin at `start`.
    pub(super) fn begin(&mut self, start: Ecef) {
        self.clear();
        self.frame = LocalFrame::at(start);
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.spare.append(&mut self.epochs);
        self.estimate.states.clear();
        self.estimate.border.clear();
        self.prior = Prior::none();
        self.phases.clear();
        self.standstill = Standstill::default();
        self.begun = [false; Constellation::COUNT];
        self.sequence = 0;
        self.is_proven = false;
    }

    /// Where the newest state will be at `time`, if nothing happens.
    pub(super) fn predicted(&self, time: GpsTime) -> State {
        let (Some(last), Some(state)) = (self.last_time(), self.estimate.states.last()) else {
            return State::zeros();
        };
        let interval_s = time - last;
        let mut next = *state;
        for (place, rate) in [(0, VELOCITY), (1, VELOCITY + 1), (2, VELOCITY + 2), (CLOCK, DRIFT)] {
            next[place] += interval_s * state[rate];
        }
        next
    }

    /// Adds an epoch whose state is about `guess`, its measurements being placed there.
    ///
    /// The guess's clock and the biases of constellations met for the first time are set from the
    /// median of the pseudoranges.
    pub(super) fn append(
        &mut self,
        time: GpsTime,
        mut guess: State,
        measurements: &Measurements,
        doppler_velocity_m_s: Option<Vector3<f64>>,
        options: &PositioningOptions,
        settings: &Settings,
    ) {
        let mut epoch = self.spare.pop().unwrap_or_else(GraphEpoch::new);
        epoch.clear();
        epoch.time = time;
        epoch.doppler_velocity_m_s = doppler_velocity_m_s;
        epoch.slot = self.sequence % self.ring.max(1);
        let needed = Constellation::COUNT * (epoch.slot + 1);
        if self.estimate.border.len() < needed {
            self.estimate.border.resize(needed, 0.0);
        }
        let interval_s = self.last_time().map(|last| time - last);
        if interval_s.is_none() {
            self.started = time;
        }
        let independence_s = options.graph.independence_s;
        let spacing_s = interval_s.unwrap_or(independence_s);
        epoch.share = (spacing_s / independence_s).min(1.0);
        epoch.repetition = repetition(spacing_s.max(independence_s), options.graph.correlation_s);
        epoch.without_ephemeris.clone_from(&measurements.without_ephemeris);
        epoch.ionosphere_fallback = measurements.ionosphere_fallback;
        look(&self.frame, &measurements.list, &mut epoch.sights);
        self.range(&mut epoch, &measurements.list);
        let miss_m = self.settle_clock(&mut epoch, &mut guess);
        self.doppler(&mut epoch, &guess, &measurements.list, options);
        if let (Some(interval_s), Some(before)) = (interval_s, self.estimate.states.last()) {
            epoch.tie = Some(self.tie(interval_s, miss_m, options, settings));
            if options.graph.phase {
                let (list, sigma_m) = (&measurements.list, options.graph.phase_sigma_m);
                let factors = &mut epoch.phases;
                self.phases.differences(list, sigma_m, interval_s, factors);
                self.phases.follow_clock(&epoch.sights, factors, before, &guess);
            }
        }
        self.carry_on(&mut epoch, interval_s, &guess, measurements.odometry.as_ref());
        if let Some(test) = &settings.standstill {
            let stands = self.standstill.observe(test, &epoch.rates, interval_s);
            epoch.standstill = interval_s.filter(|_| stands).map(ZeroVelocityFactor::new);
            if stands {
                // What reflects stands as well: its errors repeat, and so many epochs are one.
                epoch.share = (spacing_s / options.graph.correlation_s).min(epoch.share);
            }
        }
        self.regularize(&mut epoch, interval_s.is_none(), &guess, options);
        if options.graph.phase {
            self.phases.keep(&epoch.sights, &measurements.list);
        }
        self.estimate.states.push(guess);
        self.epochs.push(epoch);
        self.sequence += 1;
    }

    /// Pseudorange factors of the measurements that are used.
    fn range(&mut self, epoch: &mut GraphEpoch, list: &[Measurement]) {
        let present = |c: Constellation| {
            list.iter().any(|m| m.is_above_mask && !m.is_excluded && m.satellite.constellation == c)
        };
        // Constant biases refer to GPS, whether present or not; those of one epoch to its first.
        let reference = match self.ring {
            0 => Some(Constellation::Gps),
            _ => Constellation::ALL.into_iter().find(|c| present(*c)),
        };
        let first = Constellation::COUNT * epoch.slot;
        for (sight, measurement) in sighted(list).filter(|(_, m)| !m.is_excluded) {
            let constellation = measurement.satellite.constellation;
            let further = Some(constellation) != reference;
            let bias = further.then_some((first + constellation.index()) as u32);
            epoch.ranges.push(Ranging::new(sight, measurement, bias));
        }
        if self.ring != 0 {
            self.begun = [false; Constellation::COUNT];
        }
    }

    /// Sets the clock of `guess` and biases that begin; returns by how much the clock missed its
    /// prediction (m), if it could be seen.
    fn settle_clock(&mut self, epoch: &mut GraphEpoch, guess: &mut State) -> Option<f64> {
        let known = |range: &Ranging, begun: &[bool]| match range.bias {
            None => true,
            Some(_) => begun[range.satellite.constellation.index()],
        };
        epoch.see(guess, &mut self.lines);
        self.scratch.clear();
        for range in epoch.ranges.iter().filter(|range| known(range, &self.begun)) {
            self.scratch.push(range.miss_m(&self.lines, guess, &self.estimate.border));
        }
        let mut miss = median(&mut self.scratch);
        for constellation in Constellation::ALL {
            let of = |range: &&Ranging| range.satellite.constellation == constellation;
            let Some(first) = epoch.ranges.iter().find(of) else { continue };
            let (Some(variable), false) = (first.bias, self.begun[constellation.index()]) else {
                continue;
            };
            self.scratch.clear();
            let variable = variable as usize;
            self.estimate.border[variable] = 0.0;
            let of_own = |r: &Ranging| r.miss_m(&self.lines, guess, &self.estimate.border);
            self.scratch.extend(epoch.ranges.iter().filter(of).map(of_own));
            let own = median(&mut self.scratch).unwrap_or(0.0);
            // Without any clock yet, the first constellation's stands in for the reference's.
            let clock_m = *miss.get_or_insert(own);
            let mean_m = own - clock_m;
            self.estimate.border[variable] = mean_m;
            self.begun[constellation.index()] = true;
            let inverse_sigma = BIAS_M.recip();
            epoch.biases.push(BiasFactor { variable, mean_m, inverse_sigma });
        }
        guess[CLOCK] += miss.unwrap_or(0.0);
        miss
    }

    fn doppler(
        &self,
        epoch: &mut GraphEpoch,
        guess: &State,
        list: &[Measurement],
        options: &PositioningOptions,
    ) {
        if options.graph.doppler != DopplerUse::Satellites {
            return;
        }
        let receiver = self.frame.to_ecef(Enu(position(guess)));
        for measurement in list.iter().filter(|m| m.is_above_mask && !m.is_excluded) {
            let Some(rate_m_s) = measurement.range_rate_m_s else { continue };
            let cn0_db_hz = measurement.cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ);
            let sigma_m_s = variance_m2_s2(options.doppler_sigma_m_s, cn0_db_hz).sqrt();
            let (frame, state) = (&self.frame, &measurement.state);
            epoch.rates.push(DopplerFactor::new(frame, receiver, state, rate_m_s, sigma_m_s));
        }
    }

    /// The tie to the epoch before.
    fn tie(
        &self,
        interval_s: f64,
        miss_m: Option<f64>,
        options: &PositioningOptions,
        settings: &Settings,
    ) -> Tie {
        if options.graph.motion {
            let jump_m = jump_m(miss_m.unwrap_or(0.0), interval_s);
            let motion = MotionFactor::new(&settings.motion, interval_s);
            return Tie::Motion(motion, ClockFactor::new(&settings.clock, interval_s, jump_m));
        }
        let velocity = self.epochs.last().and_then(|before| before.doppler_velocity_m_s);
        let sigma_m_s = match velocity {
            Some(_) => options.graph.doppler_velocity_sigma_m_s,
            None => UNKNOWN_SPEED_M_S,
        };
        Tie::DopplerVelocity(DopplerVelocityFactor {
            velocity_m_s: velocity.unwrap_or_else(Vector3::zeros),
            interval_s,
            inverse_sigma: sigma_m_s.recip(),
        })
    }

    /// The tie by another sensor, where the epoch carries one.
    fn carry_on(
        &self,
        epoch: &mut GraphEpoch,
        interval_s: Option<f64>,
        guess: &State,
        odometry: Option<&Odometry>,
    ) {
        let Some(odometry) = odometry else { return };
        let place = self.frame.to_ecef(Enu(position(guess)));
        let over = |interval_s| OdometryFactor::over(interval_s, &self.frame, place, odometry);
        epoch.odometry.extend(interval_s.and_then(over));
        if epoch.odometry.is_empty() {
            epoch.unused_odometry_s = Some(odometry.interval_s);
        }
    }

    /// What is known of single numbers of the state.
    fn regularize(
        &self,
        epoch: &mut GraphEpoch,
        is_first: bool,
        guess: &State,
        options: &PositioningOptions,
    ) {
        let mut add = |column: usize, mean: f64, sigma: f64| {
            epoch.components.push(ComponentFactor { column, mean, inverse_sigma: sigma.recip() });
        };
        if is_first {
            (0..3).for_each(|axis| add(axis, guess[axis], START_M));
        }
        if is_first || !options.graph.motion {
            (VELOCITY..CLOCK).for_each(|rate| add(rate, guess[rate], START_M_S));
            add(CLOCK, guess[CLOCK], START_CLOCK_M);
            add(DRIFT, guess[DRIFT], CRYSTAL_DRIFT_M_S);
        }
        if options.graph.vertical_velocity_m_s.is_finite() {
            add(VELOCITY + 2, 0.0, options.graph.vertical_velocity_m_s);
        }
    }

    /// Sums up the residuals of every epoch at the estimate.
    pub(super) fn weigh_residuals(&mut self, settings: &Settings) {
        let kernel = settings.kernels.pseudorange.at(Phase::Graduated(1.0));
        let Estimate { states, border } = &self.estimate;
        for (epoch, state) in self.epochs.iter_mut().zip(states) {
            epoch.see(state, &mut self.lines);
            epoch.weigh_residuals(&self.lines, state, border, &kernel);
            self.is_proven |= epoch.residuals.agree();
        }
    }

    /// Age of the chain at `time` while no epoch has proven its start (s).
    ///
    /// Where the first epochs see few satellites or mostly reflections, a redescending kernel may
    /// settle on the wrong ones, and what follows agrees with the prior that they leave.
    pub(super) fn unproven_s(&self, time: GpsTime) -> Option<f64> {
        (!self.is_proven).then(|| time - self.started)
    }

    /// The rows of the whole chain.
    pub(super) fn rows<'a>(&'a mut self, settings: &'a Settings) -> Rows<'a> {
        let Self { epochs, prior, seen, .. } = self;
        Rows { epochs, prior, kernels: &settings.kernels, seen }
    }

    /// Whether every factor names variables, numbers and satellites that there are.
    fn names_what_it_holds(&self, border: usize) -> bool {
        // The first epoch's phases go back to one that is forgotten.
        let before =
            |k: usize| k.checked_sub(1).map_or(usize::MAX, |k| self.epochs[k].sights.len());
        self.epochs.iter().enumerate().all(|(k, epoch)| epoch.is_within(border, before(k)))
            && self.phases.is_within(self.epochs.last().map_or(0, |last| last.sights.len()))
    }

    /// Whether some epoch has been marginalised.
    pub(super) fn has_past(&self) -> bool {
        self.epochs.len() < self.sequence
    }

    /// Marginalises the oldest epoch into the prior; biases wander by `bias_walk_m` (m/√s).
    pub(super) fn forget_oldest(
        &mut self,
        settings: &Settings,
        bias_walk_m: f64,
        workspace: &mut (System<STATE>, Elimination<STATE>),
    ) -> Result<(), EliminationError> {
        let (system, elimination) = workspace;
        system.reset(2, self.estimate.border.len());
        let Self { epochs, prior, seen, estimate, .. } = self;
        let mut rows = Rows { epochs, prior, kernels: &settings.kernels, seen };
        rows.add_oldest(estimate, system);
        let (per_epoch, slot) = (self.ring != 0, self.epochs[0].slot);
        let retired = |variable| per_epoch && variable / Constellation::COUNT == slot;
        self.prior.marginalize(system, &self.estimate, retired, elimination)?;
        let interval_s = self.epochs[1].time - self.epochs[0].time;
        if !per_epoch && 0.0 < bias_walk_m {
            self.prior.loosen_border(bias_walk_m * bias_walk_m * interval_s);
        }
        let oldest = self.epochs.remove(0);
        self.spare.push(oldest);
        self.estimate.states.remove(0);
        Ok(())
    }
}
