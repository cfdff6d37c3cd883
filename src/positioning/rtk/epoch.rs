//! The factors of one epoch, and how they enter the normal equations.

use nalgebra::SVector;

use crate::gnss::GpsTime;
use crate::graph::{Estimate, Kernel, Phase, Prior, Problem, Row, SharingRow, System};
use crate::positioning::factors::{ComponentFactor, DopplerFactor, Line, MotionFactor, Sight};
use crate::positioning::setup::{AnnealedKernels, Kernels};
use crate::snapshot::{snapshot_fields, state_fields};

/// Numbers in a state: local position (m) and velocity (m/s).
pub(super) const STATE: usize = 6;

/// The state of one epoch.
pub(super) type State = SVector<f64, STATE>;

/// The ambiguity of a carrier phase.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ambiguity {
    /// Border variable (cycles).
    pub(super) variable: usize,
    /// λ (m).
    pub(super) wavelength_m: f64,
}

/// A single difference as a row: r = (ρ(s, p) + λN + o − z) / σ, o shared by its group.
///
/// Wen & Hsu (2021), (15) and (16), before the difference between satellites; N is there for
/// carrier phases.
#[derive(Clone, Copy, Debug)]
pub(super) struct DifferenceFactor {
    /// Place of its satellite in [`RtkEpoch::sights`].
    pub(super) sight: usize,
    /// z (m).
    pub(super) range_m: f64,
    /// 1/σ (1/m).
    pub(super) inverse_sigma: f64,
    /// Share of information kept because errors last.
    pub(super) share: f64,
    pub(super) ambiguity: Option<Ambiguity>,
    /// Place of the code bias that z was corrected for, if its codes differ.
    pub(super) bias: Option<usize>,
}

impl DifferenceFactor {
    /// The row at offset zero.
    #[inline]
    fn linearize(&self, (range_m, slope): &Line, border: &[f64]) -> SharingRow<3> {
        let w = self.inverse_sigma;
        let (ambiguity_m, border) = match self.ambiguity {
            None => (0.0, None),
            Some(Ambiguity { variable, wavelength_m }) => {
                (wavelength_m * border[variable], Some((variable, wavelength_m * w)))
            }
        };
        let residual = ((range_m - self.range_m) + ambiguity_m) * w;
        let jacobian = [slope.x * w, slope.y * w, slope.z * w];
        let row = Row { residual, columns: [0, 1, 2], jacobian };
        SharingRow { row, by_offset: w, border, share: self.share }
    }
}

/// Rows that share an offset.
#[derive(Clone, Copy, Debug)]
pub(super) struct Group {
    pub(super) begin: usize,
    pub(super) end: usize,
    pub(super) is_carrier: bool,
}

/// What is known of an ambiguity before any phase: next to nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct AmbiguityStart {
    pub(super) variable: usize,
    /// (cycles).
    pub(super) mean: f64,
    /// (1/cycles).
    pub(super) inverse_sigma: f64,
}

/// One epoch of the window.
#[derive(Debug)]
pub(super) struct RtkEpoch {
    pub(super) time: GpsTime,
    pub(super) sights: Vec<Sight>,
    pub(super) rows: Vec<DifferenceFactor>,
    pub(super) groups: Vec<Group>,
    /// The rover's Doppler shifts, whose drift is one.
    pub(super) rates: Vec<DopplerFactor>,
    /// From the epoch before; `None` for the first.
    pub(super) motion: Option<MotionFactor>,
    pub(super) components: Vec<ComponentFactor>,
    pub(super) starts: Vec<AmbiguityStart>,
}

/// Memory to linearise in.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    ranges: Vec<Line>,
    pub(super) rows: Vec<SharingRow<3>>,
    pub(super) numbers: Vec<f64>,
    /// Whitened residuals.
    pub(super) residuals: Vec<f64>,
}

impl Scratch {
    /// Range to a satellite seen last (m).
    pub(super) fn range_m(&self, sight: usize) -> f64 {
        self.ranges[sight].0
    }
}

snapshot_fields!(Ambiguity { variable, wavelength_m });
snapshot_fields!(DifferenceFactor { sight, range_m, inverse_sigma, share, ambiguity, bias });
snapshot_fields!(Group { begin, end, is_carrier });
snapshot_fields!(AmbiguityStart { variable, mean, inverse_sigma });
state_fields!(RtkEpoch { time, sights, rows, groups, rates, motion, components, starts });

impl RtkEpoch {
    /// Whether its factors name only satellites of its own, variables below `border` and numbers of
    /// a state.
    pub(super) fn is_within(&self, border: usize) -> bool {
        let is_known = |row: &DifferenceFactor| {
            row.sight < self.sights.len()
                && row.ambiguity.is_none_or(|ambiguity| ambiguity.variable < border)
        };
        self.rows.iter().all(is_known)
            && self.groups.iter().all(|g| g.begin <= g.end && g.end <= self.rows.len())
            && self.components.iter().all(|component| component.column < STATE)
            && self.starts.iter().all(|start| start.variable < border)
    }

    pub(super) fn new() -> Self {
        Self {
            time: GpsTime::EPOCH,
            sights: Vec::new(),
            rows: Vec::new(),
            groups: Vec::new(),
            rates: Vec::new(),
            motion: None,
            components: Vec::new(),
            starts: Vec::new(),
        }
    }

    /// Empties the lists; their memory stays.
    pub(super) fn clear(&mut self) {
        self.sights.clear();
        self.rows.clear();
        self.groups.clear();
        self.rates.clear();
        self.motion = None;
        self.components.clear();
        self.starts.clear();
    }

    /// Ranges and slopes of all satellites from a state, into the scratch.
    pub(super) fn see(&self, state: &State, scratch: &mut Scratch) {
        let position = state.fixed_rows::<3>(0).into_owned();
        scratch.ranges.clear();
        scratch.ranges.extend(self.sights.iter().map(|sight| sight.range(&position)));
    }

    /// The rows of a group at offset zero, into the scratch, after [`Self::see`].
    pub(super) fn linearize_group(&self, group: &Group, border: &[f64], scratch: &mut Scratch) {
        let (ranges, rows) = (&scratch.ranges, &mut scratch.rows);
        let factors = &self.rows[group.begin..group.end];
        rows.clear();
        rows.extend(factors.iter().map(|factor| factor.linearize(&ranges[factor.sight], border)));
    }

    /// The rows of the Doppler shifts at drift zero, into the scratch.
    pub(super) fn linearize_rates(&self, state: &State, scratch: &mut Scratch) {
        let velocity = state.fixed_rows::<3>(3).into_owned();
        scratch.rows.clear();
        scratch.rows.extend(self.rates.iter().map(|rate| rate.linearize_sharing(&velocity)));
    }

    /// Adds what touches this epoch's state alone, and the border.
    pub(super) fn add_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        kernels: &Kernels,
        scratch: &mut Scratch,
        system: &mut System<STATE>,
    ) {
        let state = &estimate.states[k];
        self.see(state, scratch);
        for group in &self.groups {
            self.linearize_group(group, &estimate.border, scratch);
            let kernel = if group.is_carrier { &kernels.phase } else { &kernels.pseudorange };
            system.add_sharing_offset(k, &scratch.rows, kernel);
        }
        self.linearize_rates(state, scratch);
        system.add_sharing_offset(k, &scratch.rows, &kernels.doppler);
        for component in &self.components {
            system.add(k, &component.linearize(state), &Kernel::QUADRATIC);
        }
        for start in &self.starts {
            let residual = (estimate.border[start.variable] - start.mean) * start.inverse_sigma;
            let row = Row { residual, columns: [], jacobian: [] };
            let border = [(start.variable, start.inverse_sigma)];
            system.add_with_border(k, &row, &border, &Kernel::QUADRATIC);
        }
    }

    /// Adds the motion from the epoch before, state `k`, to this one, state `k + 1`.
    pub(super) fn add_tie_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        system: &mut System<STATE>,
    ) {
        let Some(motion) = &self.motion else { return };
        let (state, next) = (&estimate.states[k], &estimate.states[k + 1]);
        for axis in 0..3 {
            system.add_link(k, &motion.place(axis, state, next), &Kernel::QUADRATIC);
            system.add_link(k, &motion.pace(axis, state, next), &Kernel::QUADRATIC);
        }
    }

    /// Whether a row names the border variable.
    pub(super) fn names(&self, variable: usize) -> bool {
        let named = |row: &DifferenceFactor| row.ambiguity.is_some_and(|a| a.variable == variable);
        self.rows.iter().any(named)
    }
}

/// All factors of a window, as the solver wants them.
pub(super) struct Rows<'a> {
    pub(super) epochs: &'a [RtkEpoch],
    pub(super) prior: &'a Prior<STATE>,
    pub(super) kernels: &'a AnnealedKernels,
    pub(super) scratch: &'a mut Scratch,
}

impl Problem<STATE> for Rows<'_> {
    fn linearize(&mut self, estimate: &Estimate<STATE>, phase: Phase, system: &mut System<STATE>) {
        let kernels = self.kernels.at(phase);
        self.prior.add_to(0, estimate, system);
        for (k, epoch) in self.epochs.iter().enumerate() {
            if 0 < k {
                epoch.add_tie_to(k - 1, estimate, system);
            }
            epoch.add_to(k, estimate, &kernels, self.scratch, system);
        }
    }
}
