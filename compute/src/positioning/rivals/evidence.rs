//! The cost of a hypothesis given pooled residuals, and its minimisation (see
//! [`hypotheses`](super::hypotheses)).

use std::ops::Range;

use nalgebra::{SMatrix, SVector, Vector3};

use crate::gnss::{Constellation, SatelliteId};
use crate::positioning::pseudorange_error::{Likelihood, PseudorangeError};
use crate::snapshot::snapshot_fields;

/// Position and a clock for each constellation.
pub(super) const UNKNOWNS: usize = 3 + Constellation::COUNT;
/// An offset (m): position, local, and clocks by constellation.
pub(super) type Unknowns = SVector<f64, UNKNOWNS>;
pub(super) type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Largest number of iterations of a refinement, and the length of a step that ends it (m).
const ITERATIONS_MAX: usize = 12;
const LAST_STEP_M: f64 = 0.3;
/// Longest step (m): farther away the quadratic approximation of the cost is invalid.
const STEP_MAX_M: f64 = 30.0;
/// Cost of the noise before learning (nats): odds of 20 : 1 that the learnt noise is right.
const UNLEARNT_COST: f64 = 3.0;
/// ½ Σ κ(1 − r)(Δs/σ)² above which two hypotheses are distinct (nats).
const DISTINCT_NATS: f64 = 10.0;
/// Scale of T (m).
const PRIOR_SCALE_M: f64 = 10.0;
/// Number of residuals whose densities are multiplied before the logarithm. No density is below
/// 0.02/400 m, so their product is at least 10⁻⁵².
const OF_ONE_LOGARITHM: usize = 12;

/// The residual of one satellite over a few seconds: a term of the cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pooled {
    pub(crate) satellite: SatelliteId,
    /// g = ∂ρ/∂p, local east, north, up.
    pub(crate) slope: Vector3<f64>,
    /// s: upper median of measured − modelled (m).
    pub(crate) excess_m: f64,
    pub(crate) error: PseudorangeError,
    /// Its error model before anything was learnt about the receiver.
    pub(crate) before_learning: PseudorangeError,
    /// κ: independent fraction of the information.
    pub(crate) independent: f64,
}

snapshot_fields!(Pooled { satellite, slope, excess_m, error, before_learning, independent });

impl Pooled {
    /// The residual that is left after the offset `x` (m).
    pub(super) fn left_m(&self, x: &Unknowns) -> f64 {
        let along_m = self.slope.x * x[0] + self.slope.y * x[1] + self.slope.z * x[2];
        self.excess_m - along_m - x[3 + self.satellite.constellation.index()]
    }
}

/// Prior knowledge of the clocks and the trajectory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Knowledge {
    /// β: scale of the errors of inter-system biases (m); infinite while they are unknown.
    pub(crate) bias_scale_m: f64,
    /// a: 0 at a start … 1 for a trajectory that has been accepted for a while.
    pub(crate) settled: f64,
}

/// A hypothesis (d, c) with its cost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Offset {
    x: Unknowns,
    cost: f64,
    noise: Noise,
}

/// The unknowns that a descent changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Free {
    Clocks,
    PositionAndClocks,
}

/// The noise of pseudoranges in a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Noise {
    Learnt,
    BeforeLearning,
}

impl Offset {
    /// d: offset of the position, local east, north, up (m).
    pub(crate) fn position_m(&self) -> Vector3<f64> {
        position_m(&self.x)
    }

    /// c: offset of a constellation's clock (m).
    pub(crate) fn clock_m(&self, constellation: Constellation) -> f64 {
        self.x[3 + constellation.index()]
    }

    /// Whether its noise is that before anything was learnt about the receiver.
    pub(crate) fn is_before_learning(&self) -> bool {
        self.noise == Noise::BeforeLearning
    }

    /// −ln of its likelihood, up to a constant (nats).
    pub(super) fn cost(&self) -> f64 {
        self.cost
    }
}

fn position_m(x: &Unknowns) -> Vector3<f64> {
    x.fixed_rows::<3>(0).into_owned()
}

/// Residuals of one pool whose densities share a logarithm.
struct Terms {
    of: Range<usize>,
    /// κ.
    independent: f64,
    /// Lower bound of Σ κ·J.
    bound: f64,
}

/// Residuals and prior knowledge.
pub(super) struct Evidence<'a> {
    pool: &'a [Pooled],
    noise: Noise,
    knowledge: Knowledge,
    /// Constellations that have residuals.
    present: [bool; Constellation::COUNT],
    /// Error model of each residual.
    likelihoods: Vec<Likelihood>,
    terms: Vec<Terms>,
}

impl<'a> Evidence<'a> {
    pub(super) fn new(pool: &'a [Pooled], noise: Noise, knowledge: Knowledge) -> Self {
        let mut present = [false; Constellation::COUNT];
        pool.iter().for_each(|pooled| present[pooled.satellite.constellation.index()] = true);
        let likelihoods: Vec<_> =
            pool.iter().map(|pooled| error_by(noise, pooled).likelihood()).collect();
        let (mut terms, mut start) = (Vec::with_capacity(pool.len() / 8 + 3), 0);
        for equal in pool.chunk_by(|a, b| a.independent == b.independent) {
            for part in equal.chunks(OF_ONE_LOGARITHM) {
                let (of, independent) = (start..start + part.len(), part[0].independent);
                let densities = likelihoods[of.clone()].iter().map(Likelihood::density_bound);
                let bound = -independent * densities.product::<f64>().ln();
                start = of.end;
                terms.push(Terms { of, independent, bound });
            }
        }
        Self { pool, noise, knowledge, present, likelihoods, terms }
    }

    pub(super) fn pool(&self) -> &'a [Pooled] {
        self.pool
    }

    /// Indices of the constellations that have residuals.
    pub(super) fn present(&self) -> impl Iterator<Item = usize> {
        (0..Constellation::COUNT).filter(|system| self.present[*system])
    }

    pub(super) fn error(&self, pooled: &Pooled) -> PseudorangeError {
        error_by(self.noise, pooled)
    }

    /// Whether inter-system biases are known, so that a subset determines one clock for all
    /// constellations.
    pub(super) fn shares_clock(&self) -> bool {
        self.knowledge.bias_scale_m.is_finite()
    }

    /// Whether two hypotheses are distinct: ½ Σ κ(1 − r)(Δs/σ)² is above 10. Δs is the difference
    /// of a residual, and r its probability of being reflected before the residual is known.
    pub(super) fn are_distinct(&self, one: &Offset, other: &Offset) -> bool {
        let squares = self.pool.iter().map(|pooled| {
            let error = self.error(pooled);
            let change = (pooled.left_m(&one.x) - pooled.left_m(&other.x)) / error.sigma_m;
            pooled.independent * (1.0 - error.reflected) * change * change
        });
        DISTINCT_NATS < 0.5 * squares.sum::<f64>()
    }

    /// The trajectory, with the clock of each constellation.
    pub(super) fn with_clocks(&self, mut clock_m: impl FnMut(usize) -> f64) -> Offset {
        let mut x = Unknowns::zeros();
        self.present().for_each(|system| x[3 + system] = clock_m(system));
        self.offset(x)
    }

    /// The trajectory itself, with the clocks that fit it best.
    pub(super) fn trajectory(&self) -> Offset {
        let mut x = Unknowns::zeros();
        self.descend(&mut x, Free::Clocks, |_| true);
        self.offset(x)
    }

    /// Minimises the cost from `offset` by expectation maximisation.
    pub(super) fn refine(&self, offset: &Offset) -> Offset {
        let mut x = offset.x;
        self.descend(&mut x, Free::PositionAndClocks, |_| true);
        self.offset(x)
    }

    /// The same; `None` if a position on the way is not `accepted`.
    pub(super) fn refine_while(
        &self,
        offset: Offset,
        accepted: impl Fn(&Vector3<f64>) -> bool,
    ) -> Option<Offset> {
        let mut x = offset.x;
        self.descend(&mut x, Free::PositionAndClocks, accepted).then(|| self.offset(x))
    }

    /// A lower bound of all costs.
    pub(super) fn cost_bound(&self) -> f64 {
        self.terms.iter().map(|terms| terms.bound).sum::<f64>() + self.cost_of_noise()
    }

    /// The hypothesis `x`, if it costs less than `enough`.
    pub(super) fn offset_below(&self, x: Unknowns, enough: f64) -> Option<Offset> {
        let mut cost = self.cost_bound() + self.prior_cost(&x);
        for terms in &self.terms {
            if enough <= cost {
                return None;
            }
            cost += self.loss(terms, &x) - terms.bound;
        }
        (cost < enough).then_some(Offset { x, cost, noise: self.noise })
    }

    fn offset(&self, x: Unknowns) -> Offset {
        let losses = self.terms.iter().map(|terms| self.loss(terms, &x));
        let cost = losses.sum::<f64>() + self.cost_of_noise() + self.prior_cost(&x);
        Offset { x, cost, noise: self.noise }
    }

    fn cost_of_noise(&self) -> f64 {
        if self.noise == Noise::Learnt { 0.0 } else { UNLEARNT_COST }
    }

    /// Σ κ·J.
    fn loss(&self, terms: &Terms, x: &Unknowns) -> f64 {
        let own = self.pool[terms.of.clone()].iter().zip(&self.likelihoods[terms.of.clone()]);
        let densities = own.map(|(pooled, error)| error.density(pooled.left_m(x)));
        -terms.independent * densities.product::<f64>().ln()
    }

    /// Cost of the clocks and of the distance from the trajectory.
    fn prior_cost(&self, x: &Unknowns) -> f64 {
        let Knowledge { bias_scale_m, settled } = self.knowledge;
        let common_m = self.common_clock_m(x);
        let biases = self.present().map(|i| student((x[3 + i] - common_m) / bias_scale_m));
        let horizontal = student(x.fixed_rows::<2>(0).norm() / PRIOR_SCALE_M);
        biases.sum::<f64>() + settled * (horizontal + student(x[2] / PRIOR_SCALE_M))
    }

    /// The clock offset that inter-system biases refer to: the median of the constellations'.
    fn common_clock_m(&self, x: &Unknowns) -> f64 {
        let (mut clocks, mut count) = ([0.0; Constellation::COUNT], 0);
        for i in self.present() {
            clocks[count] = x[3 + i];
            count += 1;
        }
        *clocks[..count.max(1)].select_nth_unstable_by(count / 2, f64::total_cmp).1
    }

    /// Minimises the cost from `x` over the `free` unknowns by expectation maximisation. Ends early
    /// and returns false at a position that is not `accepted`.
    fn descend(
        &self,
        x: &mut Unknowns,
        free: Free,
        accepted: impl Fn(&Vector3<f64>) -> bool,
    ) -> bool {
        for _ in 0..ITERATIONS_MAX {
            let (normal, right) = self.normal_equations(x, free);
            let Some(factor) = normal.cholesky() else { break };
            let step = factor.solve(&right);
            let length_m = step.amax();
            *x += step * (STEP_MAX_M / length_m).min(1.0);
            if !accepted(&position_m(x)) {
                return false;
            }
            if length_m < LAST_STEP_M {
                break;
            }
        }
        true
    }

    /// Lower triangle of the normal equations of a step of the `free` unknowns from `x`, and their
    /// right side.
    fn normal_equations(&self, x: &Unknowns, free: Free) -> (Normal, Unknowns) {
        // WEAK keeps unknowns that no residual determines where they are. HELD fixes a position
        // that is not free, and the clocks of absent constellations.
        const WEAK: f64 = 1e-9;
        const HELD: f64 = 1e12;
        let moves = free == Free::PositionAndClocks;
        let (mut normal, mut right) = (Normal::zeros(), Unknowns::zeros());
        (0..3).for_each(|i| normal[(i, i)] = if moves { WEAK } else { HELD });
        (3..UNKNOWNS).for_each(|c| normal[(c, c)] = HELD);
        let (common_m, scale_m) = (self.common_clock_m(x), self.knowledge.bias_scale_m);
        for c in self.present().map(|i| 3 + i) {
            let since_m = x[c] - common_m;
            let tie = student_weight(since_m / scale_m) / (scale_m * scale_m);
            (normal[(c, c)], right[c]) = (WEAK + tie, -tie * since_m);
        }
        for (pooled, error) in self.pool.iter().zip(&self.likelihoods) {
            let at = error.evaluate(pooled.left_m(x));
            let (slope, curvature) =
                (pooled.independent * at.slope, pooled.independent * at.curvature);
            let c = 3 + pooled.satellite.constellation.index();
            normal[(c, c)] += curvature;
            right[c] += slope;
            for i in (0..3).filter(|_| moves) {
                right[i] += slope * pooled.slope[i];
                normal[(c, i)] += curvature * pooled.slope[i];
                for j in 0..=i {
                    normal[(i, j)] += curvature * pooled.slope[i] * pooled.slope[j];
                }
            }
        }
        (normal, right)
    }
}

/// −ln of Student's t density with three degrees of freedom, up to a constant.
fn student(z: f64) -> f64 {
    2.0 * (z * z / 3.0).ln_1p()
}

/// The weight of a quadratic loss ½wz² with the slope of [`student`].
fn student_weight(z: f64) -> f64 {
    4.0 / (3.0 + z * z)
}

fn error_by(noise: Noise, pooled: &Pooled) -> PseudorangeError {
    match noise {
        Noise::Learnt => pooled.error,
        Noise::BeforeLearning => pooled.before_learning,
    }
}
