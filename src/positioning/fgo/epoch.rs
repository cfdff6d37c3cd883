//! The factors of one epoch, and how they enter the normal equations.

use nalgebra::Vector3;

use crate::gnss::{GpsTime, Reason};
use crate::graph::{Estimate, Kernel, Phase, Prior, Problem, System};
use crate::positioning::factors::{
    BiasFactor, ClockFactor, ComponentFactor, DopplerFactor, DopplerVelocityFactor, MotionFactor,
    OdometryFactor, PhaseDifferenceFactor, STATE, State, ZeroVelocityFactor,
};
use crate::positioning::ranging::Ranging;
use crate::positioning::uncertainty::Residuals;
use crate::snapshot::snapshot_fields;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::settings::Kernels;

/// Trust in the phase of a satellite whose pseudorange is rejected: epochs with no other stay tied.
const TRUST_MIN: f64 = 0.1;
/// Wheels slip: Huber's kernel, 95 % efficient under normal errors, bounds what that does.
const ODOMETRY_KERNEL: Kernel = Kernel::huber(1.345);

/// What ties an epoch to the one before, besides carrier phase.
#[derive(Clone, Copy, Debug)]
pub(super) enum Tie {
    /// Velocity and drift carry position and clock on.
    Motion(MotionFactor, ClockFactor),
    /// The velocity solved from the earlier epoch's Doppler does.
    DopplerVelocity(DopplerVelocityFactor),
}

/// One epoch of the chain.
#[derive(Debug)]
pub(super) struct GraphEpoch {
    pub(super) time: GpsTime,
    /// Share of information its pseudoranges keep, because errors last.
    pub(super) share: f64,
    /// How many epochs repeat one error.
    pub(super) repetition: f64,
    /// What its pseudoranges missed by in the last solve.
    pub(super) residuals: Residuals,
    pub(super) ranges: Vec<Ranging>,
    pub(super) rates: Vec<DopplerFactor>,
    /// From the epoch before to this one.
    pub(super) phases: Vec<PhaseDifferenceFactor>,
    /// From the epoch before to this one; `None` for the first of a chain.
    pub(super) tie: Option<Tie>,
    /// From the epoch before to this one.
    pub(super) odometry: Option<OdometryFactor>,
    /// Where the receiver stood still since the epoch before.
    pub(super) standstill: Option<ZeroVelocityFactor>,
    pub(super) components: Vec<ComponentFactor>,
    pub(super) biases: Vec<BiasFactor>,
    /// Local velocity from this epoch's Doppler alone, where the tie needs it (m/s).
    pub(super) doppler_velocity_m_s: Option<Vector3<f64>>,
    /// What the epoch lacked.
    pub(super) reasons: Vec<Reason>,
    /// Its place in the ring of per-epoch biases.
    pub(super) slot: usize,
}

impl GraphEpoch {
    pub(super) fn new() -> Self {
        Self {
            time: GpsTime::EPOCH,
            share: 1.0,
            repetition: 1.0,
            residuals: Residuals::default(),
            ranges: Vec::new(),
            rates: Vec::new(),
            phases: Vec::new(),
            tie: None,
            odometry: None,
            standstill: None,
            components: Vec::new(),
            biases: Vec::new(),
            doppler_velocity_m_s: None,
            reasons: Vec::new(),
            slot: 0,
        }
    }

    /// Empties the lists; their memory stays.
    pub(super) fn clear(&mut self) {
        self.ranges.clear();
        self.rates.clear();
        self.phases.clear();
        self.components.clear();
        self.biases.clear();
        self.reasons.clear();
        self.tie = None;
        self.odometry = None;
        self.standstill = None;
        self.doppler_velocity_m_s = None;
    }

    /// Whether its state's velocity means anything.
    pub(super) fn carries_velocity(&self) -> bool {
        !matches!(self.tie, Some(Tie::DopplerVelocity(_)))
    }

    /// Sums up what its pseudoranges miss by at `state`, under their kernel.
    pub(super) fn weigh_residuals(&mut self, state: &State, biases_m: &[f64], kernel: &Kernel) {
        self.residuals = Residuals::of(self.ranges.iter().map(|range| {
            let residual = range.factor.linearize(state, range.bias_m(biases_m)).residual;
            let pull = kernel.weight(residual) * residual;
            (range.satellite.constellation, pull, kernel.pull_slope(residual))
        }));
    }

    /// Adds what touches this epoch's state alone, and the border.
    pub(super) fn add_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        kernels: &[Kernel; 3],
        system: &mut System<STATE>,
    ) {
        let state = &estimate.states[k];
        let pseudorange = kernels[0].tempered(self.share);
        for range in &self.ranges {
            let row = range.factor.linearize(state, range.bias_m(&estimate.border));
            match range.bias {
                None => system.add(k, &row, &pseudorange),
                Some(variable) => {
                    let border = [(variable, range.factor.inverse_sigma)];
                    system.add_with_border(k, &row, &border, &pseudorange)
                }
            };
        }
        for rate in &self.rates {
            system.add(k, &rate.linearize(state), &kernels[1]);
        }
        for component in &self.components {
            system.add(k, &component.linearize(state), &Kernel::QUADRATIC);
        }
        for bias in &self.biases {
            let (row, slope) = bias.linearize(estimate.border[bias.variable]);
            system.add_with_border(k, &row, &[(bias.variable, slope)], &Kernel::QUADRATIC);
        }
    }

    /// How far a phase is the direct signal's: as far as the same satellite's pseudorange is not
    /// rejected. A reflection's phase is as steady as any and moves with the reflection; where
    /// several are followed at once, they agree with one another and not with the car.
    fn trust_in_phase(
        &self,
        phase: &PhaseDifferenceFactor,
        next: &State,
        biases_m: &[f64],
        pseudorange: &Kernel,
    ) -> f64 {
        let of_satellite = |range: &&Ranging| range.factor.sight == phase.after;
        self.ranges.iter().find(of_satellite).map_or(1.0, |range| {
            let residual = range.factor.linearize(next, range.bias_m(biases_m)).residual;
            pseudorange.weight(residual).max(TRUST_MIN)
        })
    }

    /// Adds what ties this epoch, state `k + 1`, to the one before, state `k`.
    pub(super) fn add_tie_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        kernels: &[Kernel; 3],
        system: &mut System<STATE>,
    ) {
        let (state, next) = (&estimate.states[k], &estimate.states[k + 1]);
        for phase in &self.phases {
            let trust = self.trust_in_phase(phase, next, &estimate.border, &kernels[0]);
            let kernel = kernels[2].tempered(trust);
            system.add_link(k, &phase.linearize(state, next), &kernel);
        }
        if let Some(odometry) = &self.odometry {
            for row in 0..3 {
                system.add_link(k, &odometry.linearize(row, state, next), &ODOMETRY_KERNEL);
            }
        }
        if let Some(standstill) = &self.standstill {
            for axis in 0..3 {
                system.add_link(k, &standstill.place(axis, state, next), &Kernel::QUADRATIC);
                system.add(k + 1, &standstill.pace(axis, next), &Kernel::QUADRATIC);
            }
        }
        match &self.tie {
            None => {}
            Some(Tie::DopplerVelocity(factor)) => {
                for axis in 0..3 {
                    let link = factor.linearize(axis, state, next);
                    system.add_link(k, &link, &Kernel::QUADRATIC);
                }
            }
            Some(Tie::Motion(motion, clock)) => {
                for axis in 0..3 {
                    let place = motion.place(axis, state, next);
                    system.add_link(k, &place, &Kernel::QUADRATIC);
                    system.add_link(k, &motion.pace(axis, state, next), &Kernel::QUADRATIC);
                }
                system.add_link(k, &clock.clock(state, next), &Kernel::QUADRATIC);
                system.add_link(k, &clock.drift(state, next), &Kernel::QUADRATIC);
            }
        }
    }
}

snapshot_fields!(GraphEpoch {
    time,
    share,
    repetition,
    residuals,
    ranges,
    rates,
    phases,
    tie,
    odometry,
    standstill,
    components,
    biases,
    doppler_velocity_m_s,
    reasons,
    slot,
});

impl Snapshot for Tie {
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
            _ => Err(reader.invalid("tie")),
        }
    }
}

impl GraphEpoch {
    /// Gives back the room that its lists, which grew by doubling, do not need.
    pub(super) fn release_surplus(&mut self) {
        fn fit<T>(list: &mut Vec<T>) {
            if list.len() + list.len() / 8 < list.capacity() {
                list.shrink_to_fit();
            }
        }
        fit(&mut self.ranges);
        fit(&mut self.rates);
        fit(&mut self.phases);
        fit(&mut self.components);
        fit(&mut self.biases);
        fit(&mut self.reasons);
    }

    /// Whether its factors name only variables below `border` and numbers of a state.
    pub(super) fn is_within(&self, border: usize) -> bool {
        self.ranges.iter().all(|range| range.bias.is_none_or(|variable| variable < border))
            && self.biases.iter().all(|bias| bias.variable < border)
            && self.components.iter().all(|component| component.column < STATE)
    }
}

impl Clone for GraphEpoch {
    fn clone(&self) -> Self {
        let mut clone = Self::new();
        clone.clone_from(self);
        clone
    }

    /// Copies into the storage already held.
    fn clone_from(&mut self, source: &Self) {
        self.time = source.time;
        self.share = source.share;
        self.repetition = source.repetition;
        self.residuals = source.residuals;
        self.ranges.clone_from(&source.ranges);
        self.rates.clone_from(&source.rates);
        self.phases.clone_from(&source.phases);
        self.tie = source.tie;
        self.odometry = source.odometry;
        self.standstill = source.standstill;
        self.components.clone_from(&source.components);
        self.biases.clone_from(&source.biases);
        self.doppler_velocity_m_s = source.doppler_velocity_m_s;
        self.reasons.clone_from(&source.reasons);
        self.slot = source.slot;
    }
}

/// All factors of a chain, as the solver wants them.
pub(super) struct Rows<'a> {
    pub(super) epochs: &'a [GraphEpoch],
    pub(super) prior: &'a Prior<STATE>,
    pub(super) kernels: &'a Kernels,
}

impl Problem<STATE> for Rows<'_> {
    fn linearize(&mut self, estimate: &Estimate<STATE>, phase: Phase, system: &mut System<STATE>) {
        let kernels = self.kernels.at(phase);
        self.prior.add_to(0, estimate, system);
        for (k, epoch) in self.epochs.iter().enumerate() {
            if 0 < k {
                epoch.add_tie_to(k - 1, estimate, &kernels, system);
            }
            epoch.add_to(k, estimate, &kernels, system);
        }
    }
}
