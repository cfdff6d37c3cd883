//! The factors of one epoch, and how they enter the normal equations.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::gnss::{GpsTime, Reason, SatelliteId};
use crate::graph::HUBER_WIDTH;
use crate::graph::median;
use crate::graph::{Estimate, Kernel, Link, LinkSum, Prior, Problem, RowSum, System, Widening};
use crate::positioning::factors::{
    BiasFactor, ClockFactor, ClockStepPrior, ComponentFactor, DopplerFactor, DopplerVelocityFactor,
    Line, MotionFactor, OdometryFactor, POSITION_AND_CLOCK, PhaseDifferenceFactor, STATE, Sight,
    State, VELOCITY_AND_DRIFT, ZeroVelocityFactor, position,
};
use crate::positioning::measurements::aiding_reasons;
use crate::positioning::ranging::{RangeLosses, Ranging};
use crate::positioning::receiver::VerticalPrior;
use crate::positioning::setup::{AnnealedKernels, Kernels, student};
use crate::positioning::uncertainty::Residuals;
use crate::snapshot::snapshot_fields;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

/// Weight of the phase of a satellite whose pseudorange is rejected: small, but enough to link
/// epochs without other phases.
const PHASE_WEIGHT_MIN: f64 = 0.1;
/// Kernel of odometry, since wheels slip: Huber's, 95 % efficient under normal errors.
const ODOMETRY_KERNEL: Kernel = Kernel::huber(HUBER_WIDTH);
/// Index of the clock in [`POSITION_AND_CLOCK`].
const CLOCK_INDEX: usize = 3;
/// Iterations of reweighted least squares for the step of the phase clock.
const CLOCK_ITERATIONS: usize = 5;
/// The iterations end at a change of the step below this (standard deviations of the step).
const CLOCK_TOLERANCE: f64 = 1e-3;

/// What links an epoch to the previous one, besides carrier phase.
#[derive(Clone, Copy, Debug)]
pub(super) enum EpochLink {
    /// Position and clock by velocity and drift.
    Motion(MotionFactor, ClockFactor),
    /// Position by the velocity solved from the previous epoch's Doppler.
    DopplerVelocity(DopplerVelocityFactor),
}

/// The residual of a pseudorange of the last ten seconds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Excess {
    pub(super) satellite: SatelliteId,
    /// Measured minus predicted (m).
    pub(super) excess_m: f64,
    pub(super) source: Source,
}

/// Where a residual comes from: the index of its epoch, and its index there.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source {
    Window(usize, usize),
    Departed(usize, usize),
}

/// Lines of sight and phase residuals of an epoch at the current estimate.
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// Lines of sight, from the epoch's state.
    pub(super) lines: Vec<Line>,
    /// Weight of each satellite's phase: the probability that its pseudorange is direct. The phase
    /// of a reflected signal is as precise as that of a direct one, but follows the reflected path.
    /// Several reflections can agree with one another and not with the receiver's motion.
    phase_weights: Vec<f64>,
    phases: Vec<SeenPhase>,
    numbers: Vec<f64>,
}

/// A phase difference at the current estimate.
#[derive(Debug)]
struct SeenPhase {
    link: Link<4, 4>,
    /// 1/σ (1/m).
    inverse_sigma: f64,
    /// Its weight: the probability that the signal is direct.
    direct: f64,
}

/// One epoch of the chain.
#[derive(Clone, Debug)]
pub(super) struct GraphEpoch {
    pub(super) time: GpsTime,
    /// Fraction of their information that pseudoranges keep, because errors are correlated in time.
    pub(super) share: f64,
    /// Number of epochs that have the same error, beyond what `share` accounts for.
    pub(super) repetition: f64,
    /// Residuals of its pseudoranges in the last solve.
    pub(super) residuals: Residuals,
    /// Factors do not change once the epoch is in the chain, so copies of a state share them.
    pub(super) factors: Arc<Factors>,
}

snapshot_fields!(GraphEpoch { time, share, repetition, residuals, factors });

impl GraphEpoch {
    /// Adds the factors on this epoch's state alone and on the border. Computes the lines of sight
    /// and phase weights for the links.
    fn add_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        kernels: &Kernels,
        seen: &mut Seen,
        system: &mut System<STATE>,
    ) {
        let (state, biases_m) = (&estimate.states[k], &estimate.border);
        let Self { share, factors, .. } = self;
        factors.see(state, &mut seen.lines);
        seen.phase_weights.clear();
        seen.phase_weights.resize(factors.sights.len(), 1.0);
        let (mut sum, mut losses) = (RowSum::ZERO, RangeLosses::ZERO);
        for range in &factors.ranges {
            let mut row = range.linearize(&seen.lines, state, biases_m);
            let judged = range.judge(row.residual, &kernels.pseudorange, &mut losses);
            seen.phase_weights[usize::from(range.sight)] = judged.direct.max(PHASE_WEIGHT_MIN);
            row.residual = judged.residual;
            let weight = *share * judged.weight;
            sum.add(row.residual, &row.jacobian, weight);
            if let Some(variable) = range.bias {
                let border = [(variable as usize, range.factor.inverse_sigma)];
                system.add_border(k, &row, &border, weight);
            }
        }
        system.add_cost(*share * losses.value());
        system.add_sum(k, &POSITION_AND_CLOCK, &sum);
        let mut sum = RowSum::ZERO;
        for rate in &factors.rates {
            let row = rate.linearize(state);
            let direct = match kernels.weighted_by_pseudorange {
                true => seen.phase_weights[usize::from(rate.sight)],
                false => 1.0,
            };
            let weight = system.weigh(row.residual, &kernels.doppler.scaled(direct));
            sum.add(row.residual, &row.jacobian, weight);
        }
        system.add_sum(k, &VELOCITY_AND_DRIFT, &sum);
        factors.components.iter().for_each(|component| component.add_to(k, estimate, system));
        if let Some(vertical) = &factors.vertical {
            vertical.add_to(k, estimate, system);
        }
        for bias in &factors.biases {
            let (row, slope) = bias.linearize(estimate.border[bias.variable]);
            system.add_with_border(k, &row, &[(bias.variable, slope)], &Kernel::QUADRATIC);
        }
    }
}

/// The factors of one epoch, and what its answer reports of its measurements.
#[derive(Clone, Debug, Default)]
pub(super) struct Factors {
    /// Satellites above the mask; factors refer to them by index.
    pub(super) sights: Vec<Sight>,
    pub(super) ranges: Vec<Ranging>,
    pub(super) rates: Vec<DopplerFactor>,
    /// From the previous epoch to this one.
    pub(super) phases: Vec<PhaseDifferenceFactor>,
    /// Prior of the step of the phases' clock against that of the pseudoranges; `None` if both are
    /// one clock.
    pub(super) phase_clock: Option<ClockStepPrior>,
    /// From the previous epoch to this one; `None` for the first of a chain.
    pub(super) link: Option<EpochLink>,
    /// From the previous epoch to this one: one or none, in a list because most epochs have none.
    pub(super) odometry: Vec<OdometryFactor>,
    /// Present if the receiver has been at rest since the previous epoch.
    pub(super) standstill: Option<ZeroVelocityFactor>,
    pub(super) components: Vec<ComponentFactor>,
    /// Present if the receiver's vertical velocity is learnt.
    pub(super) vertical: Option<VerticalPrior>,
    pub(super) biases: Vec<BiasFactor>,
    /// Local velocity from this epoch's Doppler alone, if the next link uses it (m/s).
    pub(super) doppler_velocity_m_s: Option<Vector3<f64>>,
    /// Satellites without an ephemeris.
    pub(super) without_ephemeris: Vec<SatelliteId>,
    /// The ionosphere model used in place of the chosen one.
    pub(super) ionosphere_fallback: Option<&'static str>,
    /// Interval of a displacement that was not used (s).
    pub(super) unused_odometry_s: Option<f64>,
    /// Index in the ring of per-epoch biases.
    pub(super) slot: usize,
}

snapshot_fields!(Factors {
    sights,
    ranges,
    rates,
    phases,
    phase_clock,
    link,
    odometry,
    standstill,
    components,
    vertical,
    biases,
    doppler_velocity_m_s,
    without_ephemeris,
    ionosphere_fallback,
    unused_odometry_s,
    slot,
});

impl Factors {
    /// Empties the lists and keeps their storage.
    pub(super) fn clear(&mut self) {
        self.sights.clear();
        self.ranges.clear();
        self.rates.clear();
        self.phases.clear();
        self.phase_clock = None;
        self.components.clear();
        self.vertical = None;
        self.biases.clear();
        self.without_ephemeris.clear();
        self.ionosphere_fallback = None;
        self.unused_odometry_s = None;
        self.link = None;
        self.odometry.clear();
        self.standstill = None;
        self.doppler_velocity_m_s = None;
    }

    /// Appends the reasons for missing data to `reasons`.
    pub(super) fn aiding_reasons(&self, reasons: &mut Vec<Reason>) {
        aiding_reasons(&self.without_ephemeris, self.ionosphere_fallback, reasons);
        let unused = |interval_s| Reason::OdometryUnused { interval_s };
        reasons.extend(self.unused_odometry_s.map(unused));
    }

    /// Whether the velocity of its state is estimated.
    pub(super) fn carries_velocity(&self) -> bool {
        !matches!(self.link, Some(EpochLink::DopplerVelocity(_)))
    }

    /// Lines of sight to its satellites from the position of `state`.
    pub(super) fn see(&self, state: &State, lines: &mut Vec<Line>) {
        let from = position(state);
        lines.clear();
        lines.extend(self.sights.iter().map(|sight| sight.range(&from)));
    }

    /// Sums the residuals of the pseudoranges at `state`, with the lines of sight from there, under
    /// their kernel.
    pub(super) fn residuals(
        &self,
        lines: &[Line],
        state: &State,
        biases_m: &[f64],
        kernel: &Kernel,
    ) -> Residuals {
        Residuals::of(
            self.ranges.iter().map(|range| {
                range.influence(range.linearize(lines, state, biases_m).residual, kernel)
            }),
        )
    }

    /// Computes lines of sight and phase weights as the factors do, without adding factors.
    fn look(&self, state: &State, biases_m: &[f64], pseudorange: &Kernel, seen: &mut Seen) {
        self.see(state, &mut seen.lines);
        seen.phase_weights.clear();
        seen.phase_weights.resize(self.sights.len(), 1.0);
        for range in &self.ranges {
            let residual = range.linearize(&seen.lines, state, biases_m).residual;
            let direct = range.direct(residual, pseudorange);
            seen.phase_weights[usize::from(range.sight)] = direct.max(PHASE_WEIGHT_MIN);
        }
    }

    /// Adds the factors between this epoch, state `k + 1`, and the previous one, state `k`.
    fn add_link_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        kernels: &Kernels,
        [before, seen]: [&mut Seen; 2],
        system: &mut System<STATE>,
    ) {
        let (state, next) = (&estimate.states[k], &estimate.states[k + 1]);
        self.add_phases_to(k, estimate, kernels, [before, seen], system);
        for odometry in &self.odometry {
            for row in 0..3 {
                system.add_link(k, &odometry.linearize(row, state, next), &ODOMETRY_KERNEL);
            }
        }
        if let Some(standstill) = &self.standstill {
            for axis in 0..3 {
                system.add_link(k, &standstill.position_row(axis, state, next), &Kernel::QUADRATIC);
                system.add(k + 1, &standstill.velocity_row(axis, next), &Kernel::QUADRATIC);
            }
        }
        match &self.link {
            None => {}
            Some(EpochLink::DopplerVelocity(factor)) => factor.add_to(k, estimate, system),
            Some(EpochLink::Motion(motion, clock)) => {
                motion.add_to(k, estimate, system);
                let kernel = if self.phase_clock.is_some() { student() } else { Kernel::QUADRATIC };
                system.add_link(k, &clock.clock_row(state, next), &kernel);
                system.add_link(k, &clock.drift_row(state, next), &Kernel::QUADRATIC);
            }
        }
    }
}

impl Factors {
    /// Adds the phase differences to the previous epoch. Eliminates the step of the phase clock
    /// against the pseudorange clock.
    fn add_phases_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        kernels: &Kernels,
        [before, seen]: [&mut Seen; 2],
        system: &mut System<STATE>,
    ) {
        let (state, next) = (&estimate.states[k], &estimate.states[k + 1]);
        let Seen { lines, phase_weights, phases, numbers } = seen;
        let link = |phase: &PhaseDifferenceFactor| {
            let (from, to) = (usize::from(phase.before), usize::from(phase.after));
            phase.linearize((&before.lines[from], state), (&lines[to], next))
        };
        phases.clear();
        phases.extend(self.phases.iter().map(|phase| {
            let mut direct = phase_weights[usize::from(phase.after)];
            if kernels.weighted_by_pseudorange {
                direct = direct.min(before.phase_weights[usize::from(phase.before)]);
            }
            SeenPhase { link: link(phase), inverse_sigma: phase.inverse_sigma, direct }
        }));
        numbers.clear();
        numbers.extend(phases.iter().map(|seen| -seen.link.residual / seen.inverse_sigma));
        let middle_m = median(numbers);
        let step = self
            .phase_clock
            .zip(middle_m)
            .map(|(prior, middle_m)| clock_step(prior, middle_m, phases, &kernels.phase));
        let step_m = step.unwrap_or(0.0);
        let mut sum = LinkSum::ZERO;
        for SeenPhase { link, inverse_sigma, direct } in phases {
            link.residual += step_m * *inverse_sigma;
            let kernel = kernels.phase.scaled(*direct);
            sum.add(link, system.weigh(link.residual, &kernel));
        }
        if let (Some(prior), Some(step_m)) = (self.phase_clock, step) {
            let (off_m, per_m) = (step_m - prior.mean_m, prior.scale_m2.sqrt().recip());
            let weight = system.weigh(off_m * per_m, &student());
            sum.free_offset(CLOCK_INDEX, off_m, weight * per_m * per_m);
        }
        system.add_link_sum(k, (&POSITION_AND_CLOCK, &POSITION_AND_CLOCK), &sum);
    }

    /// Whitened residuals of the phase differences between two states, after subtraction of their
    /// median.
    pub(super) fn phase_residuals(
        &self,
        [before, lines]: [&[Line]; 2],
        [state, next]: [&State; 2],
        numbers: &mut Vec<f64>,
    ) -> Vec<f64> {
        let residual = |phase: &PhaseDifferenceFactor| {
            let (from, to) = (usize::from(phase.before), usize::from(phase.after));
            phase.linearize((&before[from], state), (&lines[to], next)).residual
        };
        numbers.clear();
        numbers.extend(self.phases.iter().map(|phase| -residual(phase) / phase.inverse_sigma));
        let step_m = median(numbers).unwrap_or(0.0);
        self.phases.iter().map(|phase| residual(phase) + step_m * phase.inverse_sigma).collect()
    }
}

/// The likeliest step of the phase clock against the pseudorange clock (m). The iteration starts at
/// `start_m`.
fn clock_step(prior: ClockStepPrior, start_m: f64, phases: &[SeenPhase], kernel: &Kernel) -> f64 {
    let (per_m, prior_kernel) = (prior.scale_m2.sqrt().recip(), student());
    let mut step_m = start_m;
    for _ in 0..CLOCK_ITERATIONS {
        let trust = prior_kernel.weight((step_m - prior.mean_m) * per_m);
        let information = trust * per_m * per_m;
        let (mut weight, mut pull) = (information, -information * prior.mean_m);
        for SeenPhase { link: Link { residual, .. }, inverse_sigma, direct } in phases {
            let trust = kernel.scaled(*direct).weight(residual + inverse_sigma * step_m);
            weight += trust * inverse_sigma * inverse_sigma;
            pull += trust * inverse_sigma * residual;
        }
        let before_m = std::mem::replace(&mut step_m, -pull / weight);
        if (step_m - before_m).powi(2) * weight < CLOCK_TOLERANCE * CLOCK_TOLERANCE {
            break;
        }
    }
    step_m
}

impl Snapshot for EpochLink {
    fn save(&self, writer: &mut SnapshotWriter) {
        match self {
            Self::Motion(motion, clock) => {
                writer.u8(0);
                motion.save(writer);
                clock.save(writer);
            }
            Self::DopplerVelocity(factor) => {
                writer.u8(1);
                factor.save(writer);
            }
        }
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        match reader.u8()? {
            0 => Ok(Self::Motion(Snapshot::load(reader)?, Snapshot::load(reader)?)),
            1 => Ok(Self::DopplerVelocity(Snapshot::load(reader)?)),
            _ => Err(reader.invalid("link of epochs")),
        }
    }
}

impl Factors {
    /// Whether its factors refer to variables below `border`, columns of a state, its own
    /// satellites and the `before` satellites of the previous epoch only.
    pub(super) fn is_within(&self, border: usize, before: usize) -> bool {
        let is_known = |range: &Ranging| {
            usize::from(range.sight) < self.sights.len()
                && range.bias.is_none_or(|variable| (variable as usize) < border)
        };
        let ends = |phase: &PhaseDifferenceFactor| (phase.before.into(), phase.after.into());
        let is_link = |(from, to): (usize, usize)| from < before && to < self.sights.len();
        self.ranges.iter().all(is_known)
            && self.phases.iter().map(ends).all(is_link)
            && self.biases.iter().all(|bias| bias.variable < border)
            && self.components.iter().all(|component| component.column < STATE)
            && self.vertical.is_none_or(|vertical| vertical.is_valid())
    }
}

/// All factors of a chain, as a problem of the solver.
pub(super) struct Rows<'a> {
    pub(super) epochs: &'a [GraphEpoch],
    pub(super) prior: &'a Prior<STATE>,
    pub(super) kernels: &'a AnnealedKernels,
    /// Scratch for two neighbouring epochs.
    pub(super) seen: &'a mut [Seen; 2],
}

impl Rows<'_> {
    /// Adds all terms on the first epoch: its factors, the links to the second epoch, and the
    /// prior.
    pub(super) fn add_oldest(&mut self, estimate: &Estimate<STATE>, system: &mut System<STATE>) {
        let kernels = self.kernels.last();
        let [before, seen] = &mut *self.seen;
        let [first, second, ..] = self.epochs else { return };
        self.prior.add_to(0, estimate, system);
        first.add_to(0, estimate, &kernels, before, system);
        let factors = &second.factors;
        factors.look(&estimate.states[1], &estimate.border, &kernels.pseudorange, seen);
        factors.add_link_to(0, estimate, &kernels, [before, seen], system);
    }
}

impl Problem<STATE> for Rows<'_> {
    fn linearize(
        &mut self,
        estimate: &Estimate<STATE>,
        widening: Widening,
        system: &mut System<STATE>,
    ) {
        let kernels = self.kernels.at(widening);
        let [before, seen] = &mut *self.seen;
        self.prior.add_to(0, estimate, system);
        for (k, epoch) in self.epochs.iter().enumerate() {
            std::mem::swap(before, seen);
            epoch.add_to(k, estimate, &kernels, seen, system);
            if 0 < k {
                epoch.factors.add_link_to(k - 1, estimate, &kernels, [before, seen], system);
            }
        }
    }
}
