//! The factors of one epoch, and how they enter the normal equations.

use nalgebra::SVector;

use crate::gnss::GpsTime;
use crate::graph::{Estimate, Kernel, Prior, Problem, Row, SharingRow, System, Widening};
use crate::positioning::factors::{ComponentFactor, DopplerFactor, Line, MotionFactor, Sight};
use crate::positioning::setup::{AnnealedKernels, Kernels};
use crate::snapshot::{snapshot_fields, state_fields};

/// Standard deviation of an ambiguity about its start (cycles): 200 m.
const START_CYCLES: f64 = 1e3;

/// Standard deviation of a known step between two ambiguities (cycles): a hundredth of a cycle is
/// below the noise of any phase.
const TIE_CYCLES: f64 = 0.01;

/// Numbers in a state: local position (m) and velocity (m/s).
pub(crate) const STATE: usize = 6;

/// The state of one epoch.
pub(crate) type State = SVector<f64, STATE>;

/// The ambiguity of a carrier phase.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EpochAmbiguity {
    /// Border variable (cycles).
    pub(crate) variable: usize,
    /// λ (m).
    pub(crate) wavelength_m: f64,
}

/// A single difference as a row: r = (ρ(s, p) + λN + o − z) / σ. The offset o is the difference of
/// the receivers' clocks: one for each group of pseudoranges, one for all carriers.
///
/// Wen & Hsu (2021), (15) and (16), before the difference between satellites. Only carrier phases
/// have the term λN.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DifferenceFactor {
    /// Index of its satellite in [`RtkEpoch::sights`].
    pub(crate) sight: usize,
    /// z (m).
    pub(crate) range_m: f64,
    /// 1/σ (1/m).
    pub(crate) inverse_sigma: f64,
    /// Fraction of its information that is kept, since errors are correlated in time.
    pub(crate) independent_share: f64,
    pub(crate) ambiguity: Option<EpochAmbiguity>,
    /// Index of the code bias that z was corrected for, if its codes differ.
    pub(crate) bias: Option<usize>,
}

impl DifferenceFactor {
    /// The row at offset zero.
    #[inline]
    fn linearize(&self, (range_m, slope): &Line, border: &[f64]) -> SharingRow<3> {
        let w = self.inverse_sigma;
        let (ambiguity_m, border) = match self.ambiguity {
            None => (0.0, None),
            Some(EpochAmbiguity { variable, wavelength_m }) => {
                (wavelength_m * border[variable], Some((variable, wavelength_m * w)))
            }
        };
        let residual = ((range_m - self.range_m) + ambiguity_m) * w;
        let jacobian = [slope.x * w, slope.y * w, slope.z * w];
        let row = Row { residual, columns: [0, 1, 2], jacobian };
        SharingRow { row, by_offset: w, border, independent_share: self.independent_share }
    }
}

/// Rows of one signal: pseudoranges that share an offset, or carriers whose ambiguities differ by
/// integers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Group {
    pub(crate) begin: usize,
    pub(crate) end: usize,
    pub(crate) is_carrier: bool,
}

impl Group {
    /// Its rows.
    pub(crate) fn factors<'a>(&self, epoch: &'a RtkEpoch) -> &'a [DifferenceFactor] {
        &epoch.rows[self.begin..self.end]
    }
}

/// Prior of an ambiguity that begins. The phases determine the ambiguity far better.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AmbiguityStart {
    pub(crate) variable: usize,
    /// (cycles).
    pub(crate) mean: f64,
    /// (1/cycles).
    pub(crate) inverse_sigma: f64,
}

/// The ambiguities of an arc and of the one that follows it, which differ by a known step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AmbiguityTie {
    /// Border variables, the earlier arc first.
    pub(crate) variables: [usize; 2],
    /// Later minus earlier ambiguity (cycles).
    pub(crate) step: f64,
}

impl AmbiguityTie {
    /// r = (N₊ − N − step) / σ, on the border alone.
    fn add_to(&self, k: usize, estimate: &Estimate<STATE>, system: &mut System<STATE>) {
        let [earlier, later] = self.variables;
        let weight = TIE_CYCLES.recip();
        let difference = estimate.border[later] - estimate.border[earlier];
        let row = Row { residual: (difference - self.step) * weight, columns: [], jacobian: [] };
        let border = [(earlier, -weight), (later, weight)];
        system.add_with_border(k, &row, &border, &Kernel::QUADRATIC);
    }
}

/// One epoch of the window.
#[derive(Debug)]
pub(crate) struct RtkEpoch {
    pub(crate) time: GpsTime,
    pub(crate) sights: Vec<Sight>,
    pub(crate) rows: Vec<DifferenceFactor>,
    pub(crate) groups: Vec<Group>,
    /// The rover's Doppler shifts, of one common drift.
    pub(crate) rates: Vec<DopplerFactor>,
    /// From the previous epoch; `None` for the first.
    pub(crate) motion: Option<MotionFactor>,
    pub(crate) components: Vec<ComponentFactor>,
    pub(crate) starts: Vec<AmbiguityStart>,
    pub(crate) ties: Vec<AmbiguityTie>,
}

/// Scratch for linearisation.
#[derive(Debug, Default)]
pub(crate) struct RowScratch {
    ranges: Vec<Line>,
    pub(crate) rows: Vec<SharingRow<3>>,
    pub(crate) numbers: Vec<f64>,
    /// Whitened residuals.
    pub(crate) residuals: Vec<f64>,
}

impl RowScratch {
    /// Range to a satellite at the state of the last [`RtkEpoch::see`] (m).
    pub(crate) fn range_m(&self, sight: usize) -> f64 {
        self.ranges[sight].0
    }
}

snapshot_fields!(EpochAmbiguity { variable, wavelength_m });
snapshot_fields!(DifferenceFactor {
    sight,
    range_m,
    inverse_sigma,
    independent_share,
    ambiguity,
    bias
});
snapshot_fields!(Group { begin, end, is_carrier });
snapshot_fields!(AmbiguityStart { variable, mean, inverse_sigma });
snapshot_fields!(AmbiguityTie { variables, step });
state_fields!(RtkEpoch { time, sights, rows, groups, rates, motion, components, starts, ties });

impl Default for RtkEpoch {
    fn default() -> Self {
        Self {
            time: GpsTime::EPOCH,
            sights: Vec::new(),
            rows: Vec::new(),
            groups: Vec::new(),
            rates: Vec::new(),
            motion: None,
            components: Vec::new(),
            starts: Vec::new(),
            ties: Vec::new(),
        }
    }
}

impl RtkEpoch {
    /// Whether its factors refer only to its own satellites, to variables below `border` and to
    /// columns of a state.
    pub(crate) fn is_within(&self, border: usize) -> bool {
        let is_known = |row: &DifferenceFactor| {
            row.sight < self.sights.len()
                && row.ambiguity.is_none_or(|ambiguity| ambiguity.variable < border)
        };
        self.rows.iter().all(is_known)
            && self.groups.iter().all(|g| g.begin <= g.end && g.end <= self.rows.len())
            && self.components.iter().all(|component| component.column < STATE)
            && self.starts.iter().all(|start| start.variable < border)
            && self.ties.iter().flat_map(|tie| tie.variables).all(|variable| variable < border)
    }

    /// Empties the lists and keeps their memory.
    pub(crate) fn clear(&mut self) {
        self.sights.clear();
        self.rows.clear();
        self.groups.clear();
        self.rates.clear();
        self.motion = None;
        self.components.clear();
        self.starts.clear();
        self.ties.clear();
    }

    /// Computes the ranges to all satellites at a state and their derivatives, into the scratch.
    pub(crate) fn see(&self, state: &State, scratch: &mut RowScratch) {
        let position = state.fixed_rows::<3>(0).into_owned();
        scratch.ranges.clear();
        scratch.ranges.extend(self.sights.iter().map(|sight| sight.range(&position)));
    }

    /// The rows of a group at offset zero, into the scratch, after [`Self::see`].
    pub(crate) fn linearize_group(&self, group: &Group, border: &[f64], scratch: &mut RowScratch) {
        let (ranges, rows) = (&scratch.ranges, &mut scratch.rows);
        let factors = group.factors(self);
        rows.clear();
        rows.extend(factors.iter().map(|factor| factor.linearize(&ranges[factor.sight], border)));
    }

    /// The rows of all carriers at offset zero, into the scratch, after [`Self::see`], in the order
    /// of [`Self::carriers`].
    ///
    /// They share one offset: all carriers of a receiver are measured against one oscillator. What
    /// differs between constellations and bands is constant, and part of their ambiguities.
    pub(crate) fn linearize_carriers(&self, border: &[f64], scratch: &mut RowScratch) {
        let (ranges, rows) = (&scratch.ranges, &mut scratch.rows);
        let factors = self.carriers().map(|index| &self.rows[index]);
        rows.clear();
        rows.extend(factors.map(|factor| factor.linearize(&ranges[factor.sight], border)));
    }

    /// Indices of the rows of carriers.
    pub(crate) fn carriers(&self) -> impl Iterator<Item = usize> + '_ {
        let groups = self.groups.iter().filter(|group| group.is_carrier);
        groups.flat_map(|group| group.begin..group.end)
    }

    /// The rows of the Doppler shifts at drift zero, into the scratch.
    pub(crate) fn linearize_rates(&self, state: &State, scratch: &mut RowScratch) {
        let velocity = state.fixed_rows::<3>(3).into_owned();
        scratch.rows.clear();
        scratch.rows.extend(self.rates.iter().map(|rate| rate.linearize_sharing(&velocity)));
    }

    /// Adds the factors on this epoch's state alone and on the border.
    pub(crate) fn add_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        kernels: &Kernels,
        scratch: &mut RowScratch,
        system: &mut System<STATE>,
    ) {
        let state = &estimate.states[k];
        self.see(state, scratch);
        for group in self.groups.iter().filter(|group| !group.is_carrier) {
            self.linearize_group(group, &estimate.border, scratch);
            system.add_sharing_offset(k, &scratch.rows, &kernels.pseudorange);
        }
        self.linearize_carriers(&estimate.border, scratch);
        system.add_sharing_offset(k, &scratch.rows, &kernels.phase);
        self.linearize_rates(state, scratch);
        system.add_sharing_offset(k, &scratch.rows, &kernels.doppler);
        self.components.iter().for_each(|component| component.add_to(k, estimate, system));
        for start in &self.starts {
            let residual = (estimate.border[start.variable] - start.mean) * start.inverse_sigma;
            let row = Row { residual, columns: [], jacobian: [] };
            let border = [(start.variable, start.inverse_sigma)];
            system.add_with_border(k, &row, &border, &Kernel::QUADRATIC);
        }
        self.ties.iter().for_each(|tie| tie.add_to(k, estimate, system));
    }

    /// Adds the motion from the previous epoch, state `k`, to this one, state `k + 1`.
    pub(crate) fn add_tie_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        system: &mut System<STATE>,
    ) {
        if let Some(motion) = &self.motion {
            motion.add_to(k, estimate, system);
        }
    }

    /// Adds the prior of an ambiguity that begins at `mean` (cycles), and sets its value in
    /// `border`.
    pub(crate) fn start_ambiguity(&mut self, border: &mut Vec<f64>, variable: usize, mean: f64) {
        if border.len() <= variable {
            border.resize(variable + 1, 0.0);
        }
        border[variable] = mean;
        let inverse_sigma = START_CYCLES.recip();
        self.starts.push(AmbiguityStart { variable, mean, inverse_sigma });
    }

    /// Ties the ambiguity of a phase to that of the arc before. `independent_share` is the fraction
    /// of the phase's error that is independent of the earlier arc.
    pub(crate) fn tie(&mut self, tie: AmbiguityTie, independent_share: f64) {
        let [_, later] = tie.variables;
        let is_its =
            |row: &&mut DifferenceFactor| row.ambiguity.is_some_and(|a| a.variable == later);
        if let Some(row) = self.rows.iter_mut().find(is_its) {
            row.independent_share = independent_share;
        }
        self.ties.push(tie);
    }

    /// Whether a row or a tie depends on the border variable.
    pub(crate) fn names(&self, variable: usize) -> bool {
        let named = |row: &DifferenceFactor| row.ambiguity.is_some_and(|a| a.variable == variable);
        self.rows.iter().any(named) || self.ties.iter().any(|tie| tie.variables.contains(&variable))
    }
}

/// All factors of a window, as a problem of the solver.
pub(crate) struct Rows<'a> {
    pub(crate) epochs: &'a [RtkEpoch],
    pub(crate) prior: &'a Prior<STATE>,
    pub(crate) kernels: &'a AnnealedKernels,
    pub(crate) scratch: &'a mut RowScratch,
}

impl Problem<STATE> for Rows<'_> {
    fn linearize(
        &mut self,
        estimate: &Estimate<STATE>,
        widening: Widening,
        system: &mut System<STATE>,
    ) {
        let kernels = self.kernels.at(widening);
        self.prior.add_to(0, estimate, system);
        for (k, epoch) in self.epochs.iter().enumerate() {
            if 0 < k {
                epoch.add_tie_to(k - 1, estimate, system);
            }
            epoch.add_to(k, estimate, &kernels, self.scratch, system);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};
    use crate::gnss::{Ecef, Enu, LocalFrame};
    use crate::graph::{BorderLife, Covariances, Elimination};
    use crate::positioning::setup::Setup;

    /// Variances of the position with a prior of 1 m, from one row in each of two groups: a
    /// satellite at the zenith and one in the east at 45°.
    fn variances(is_carrier: bool) -> Vector3<f64> {
        let frame = LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0));
        let mut epoch = RtkEpoch::default();
        for (index, direction) in [Vector3::z(), Vector3::new(1.0, 0.0, 1.0)].iter().enumerate() {
            let satellite = frame.to_ecef(Enu(direction.normalize() * 2e7));
            let sight = Sight::new(&frame, satellite);
            let (range_m, _) = sight.range(&Vector3::zeros());
            epoch.sights.push(sight);
            epoch.rows.push(DifferenceFactor {
                sight: index,
                range_m,
                inverse_sigma: 1e3,
                independent_share: 1.0,
                ambiguity: None,
                bias: None,
            });
            epoch.groups.push(Group { begin: index, end: index + 1, is_carrier });
        }
        let prior = |column| ComponentFactor { column, mean: 0.0, inverse_sigma: 1.0 };
        epoch.components.extend((0..STATE).map(prior));
        let setup = Setup::new(PositioningOptions::new(Mode::RtkFgo, Profile::General));
        let mut estimate = Estimate::new();
        estimate.states.push(State::zeros());
        let mut system = System::new(BorderLife::WholeChain);
        system.reset(1, 0);
        let kernels = setup.relative.kernels.last();
        epoch.add_to(0, &estimate, &kernels, &mut RowScratch::default(), &mut system);
        let mut elimination = Elimination::new();
        elimination.factor(&system, 0.0).unwrap();
        let mut covariances = Covariances::new();
        covariances.newest(&elimination);
        covariances.state().fixed_view::<3, 3>(0, 0).diagonal()
    }

    /// One clock for all carriers: two satellites of different groups give their difference, of
    /// slope (−sin 45°, 0, 1 − cos 45°) with a variance of 2 mm². The pseudoranges of groups with
    /// one satellite each give nothing.
    #[test]
    fn carriers_share_one_clock_and_pseudoranges_do_not() {
        let slope = Vector3::new(-0.5_f64.sqrt(), 0.0, 1.0 - 0.5_f64.sqrt());
        let gain = slope.component_mul(&slope) / (slope.norm_squared() + 2e-6);
        assert!((variances(true) - (Vector3::repeat(1.0) - gain)).norm() < 1e-4);
        assert!((variances(false) - Vector3::repeat(1.0)).norm() < 1e-9);
    }

    /// An ambiguity of 3 ± 0.1 cycles and a step of half a cycle, known to 0.01: the later one is
    /// 3.5 cycles with a variance of 0.01 + 0.0001. Its phase keeps a fifth of its information.
    #[test]
    fn a_tie_hands_an_ambiguity_on() {
        let (mut epoch, mut estimate) = (RtkEpoch::default(), Estimate::new());
        estimate.states.push(State::zeros());
        epoch.start_ambiguity(&mut estimate.border, 0, 3.0);
        epoch.start_ambiguity(&mut estimate.border, 1, 100.0);
        epoch.starts[0].inverse_sigma = 10.0;
        epoch.rows.push(DifferenceFactor {
            sight: 0,
            range_m: 2e7,
            inverse_sigma: 200.0,
            independent_share: 1.0,
            ambiguity: Some(EpochAmbiguity { variable: 1, wavelength_m: 0.19 }),
            bias: None,
        });
        epoch.tie(AmbiguityTie { variables: [0, 1], step: 0.5 }, 0.2);
        assert_eq!(epoch.rows[0].independent_share, 0.2);
        assert!(epoch.names(0) && epoch.names(1) && !epoch.names(2));
        let prior = |column| ComponentFactor { column, mean: 0.0, inverse_sigma: 1.0 };
        epoch.components.extend((0..STATE).map(prior));
        let setup = Setup::new(PositioningOptions::new(Mode::RtkFgo, Profile::General));
        let mut system = System::new(BorderLife::WholeChain);
        system.reset(1, 2);
        let kernels = setup.relative.kernels.last();
        epoch.add_to(0, &estimate, &kernels, &mut RowScratch::default(), &mut system);
        let (mut elimination, mut delta) = (Elimination::new(), Estimate::new());
        elimination.factor(&system, 0.0).unwrap();
        elimination.solve(&mut delta);
        estimate.step(&delta);
        let mut covariances = Covariances::new();
        covariances.newest(&elimination);
        assert!((estimate.border[0] - 3.0).abs() < 1e-5, "{:?}", estimate.border);
        assert!((estimate.border[1] - 3.5).abs() < 1e-5, "{:?}", estimate.border);
        assert!((covariances.border(1, 1).unwrap() - 0.0101).abs() < 1e-6);
    }
}
