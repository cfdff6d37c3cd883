//! Searches for the position on which the pseudoranges of the last half minute agree.
//!
//! A hypothesis (d, c) moves the whole estimated trajectory by the offset d, and the clock of each
//! constellation by an offset c. It leaves the residuals s − gᵀd − c, with s = measured − modelled
//! (m) at the estimate and g = ∂ρ/∂p. Its cost is
//!
//! Σ κ·J(s − gᵀd − c) + Σ ½·(c − c̄)²/β² + a·[T(d_h) + T(d_v)]
//!
//! - J: negative log likelihood of [`CodeError`]; one term for each satellite and ten seconds. The
//!   noise is either what was learnt about the receiver, or its prior, which costs 3 more: from a
//!   wrong position, direct signals look like reflections, and what is learnt there confirms it.
//! - κ: independent fraction of these terms' information; smaller at rest, where multipath repeats.
//! - β: standard deviation of the graph's inter-system biases; infinite while they are unknown.
//! - T: −ln of Student's t density with three degrees of freedom and a scale of 10 m. It penalises
//!   large offsets of a trajectory that has been accepted for a while (a → 1).
//!
//! Two hypotheses have the odds exp(−Δcost).
//!
//! Candidates are the positions of minimal subsets of satellites, drawn with the probability that
//! they are direct (Fischler & Bolles 1981, *Random sample consensus*, CACM 24). The best ones, and
//! the trajectory itself, are refined by expectation maximisation. The draws depend on the time of
//! the epoch only, so that a replay makes the same ones.

use nalgebra::{SMatrix, SVector, Vector3};

use crate::gnss::{Constellation, SatelliteId};
use crate::positioning::code_error::{CodeError, log_product};
use crate::positioning::draws::Draws;
use crate::snapshot::snapshot_fields;

/// Position and a clock for each constellation.
const UNKNOWNS: usize = 3 + Constellation::COUNT;
/// An offset (m): position, local, and clocks by constellation.
type Unknowns = SVector<f64, UNKNOWNS>;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Number of subsets drawn. If half of the satellites are direct, at least one subset of four is
/// all direct with a probability of 1 − (15/16)⁴⁰ = 92 %.
const SUBSETS: usize = 40;
/// Most draws of a satellite for one subset.
const DRAWS_MAX: usize = 60;
/// Number of candidates that are refined.
const REFINED: usize = 2;
/// Most iterations of a refinement, and the length of a step that ends it (m).
const ITERATIONS_MAX: usize = 12;
const LAST_STEP_M: f64 = 0.3;
/// Longest step (m): farther away the quadratic approximation of the cost is invalid.
const STEP_MAX_M: f64 = 30.0;
/// Distances up to which two positions count as the same: horizontal, and vertical, where positions
/// are half as precise (m).
const DISTINCT_M: (f64, f64) = (8.0, 16.0);
/// Largest horizontal and largest vertical offset of a candidate (m).
const REACH_M: f64 = 1e3;
/// Cost of the prior's noise: odds of 20 : 1 that what was learnt about the receiver holds (nats).
const UNLEARNT_COST: f64 = 3.0;
/// Scale of T (m).
const SETTLED_M: f64 = 10.0;

/// The residual of one satellite over a few seconds: a term of the cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pooled {
    pub(crate) satellite: SatelliteId,
    /// g = ∂ρ/∂p, local east, north, up.
    pub(crate) slope: Vector3<f64>,
    /// s: median of measured − modelled (m).
    pub(crate) residual_m: f64,
    pub(crate) error: CodeError,
    /// Its error model before anything was learnt about the receiver.
    pub(crate) before_learning: CodeError,
    /// κ: independent fraction of the information, the same for all residuals of a pool.
    pub(crate) independent: f64,
}

snapshot_fields!(Pooled { satellite, slope, residual_m, error, before_learning, independent });

/// Prior knowledge of the clocks and the trajectory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Knowledge {
    /// β: standard deviation of inter-system biases (m); infinite while they are unknown.
    pub(crate) bias_sigma_m: f64,
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

/// The noise of pseudoranges in a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Noise {
    Learnt,
    BeforeLearning,
}

impl Offset {
    /// d: offset of the position, local east, north, up (m).
    pub(crate) fn position_m(&self) -> Vector3<f64> {
        self.x.fixed_rows::<3>(0).into_owned()
    }

    /// c: offset of a constellation's clock (m).
    pub(crate) fn clock_m(&self, constellation: Constellation) -> f64 {
        self.x[3 + constellation.index()]
    }

    /// Whether it holds with the noise before anything was learnt about the receiver.
    pub(crate) fn is_before_learning(&self) -> bool {
        self.noise == Noise::BeforeLearning
    }
}

/// Whether two positions this far apart count as different.
fn are_distinct(by_m: &Vector3<f64>) -> bool {
    DISTINCT_M.0 < by_m.xy().norm() || DISTINCT_M.1 < by_m.z.abs()
}

/// The result of a search.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Rivalry {
    /// The satellites are too few for a redundant position.
    Undetermined,
    /// There is no candidate at another position, or none can reach the required odds.
    Unrivalled,
    /// The likeliest candidate at another position.
    Rival {
        /// Its offset from the estimated trajectory.
        offset: Offset,
        /// Logarithm of its odds against the trajectory.
        log_odds: f64,
    },
}

/// Residuals and prior knowledge.
struct Evidence<'a> {
    pool: &'a [Pooled],
    noise: Noise,
    knowledge: Knowledge,
    /// Constellations that have residuals.
    present: [bool; Constellation::COUNT],
}

/// Searches for the likeliest position that is distinct from the trajectory. The search is skipped
/// if no position can have log odds of `least`. `seed` determines the draws.
pub(crate) fn rivalry(pool: &[Pooled], knowledge: Knowledge, least: f64, seed: u64) -> Rivalry {
    let mut present = [false; Constellation::COUNT];
    pool.iter().for_each(|pooled| present[pooled.satellite.constellation.index()] = true);
    let of_noise = |noise| Evidence { pool, noise, knowledge, present };
    let learnt = of_noise(Noise::Learnt);
    if learnt.satellites() < 3 + learnt.clocks() + 1 {
        return Rivalry::Undetermined;
    }
    let has_learnt = pool.iter().any(|pooled| pooled.error != pooled.before_learning);
    let other = has_learnt.then(|| of_noise(Noise::BeforeLearning));
    let least_cost = other.iter().map(Evidence::least_cost).fold(learnt.least_cost(), f64::min);
    let by_learnt = learnt.stands().cost;
    if by_learnt - least_cost < least {
        return Rivalry::Unrivalled;
    }
    let stands_cost = other.iter().map(|other| other.stands().cost).fold(by_learnt, f64::min);
    if stands_cost - least_cost < least {
        return Rivalry::Unrivalled;
    }
    let evidences = std::iter::once(&learnt).chain(&other);
    let rivals = evidences.filter_map(|evidence| evidence.best_elsewhere(seed));
    match rivals.min_by(|a, b| a.cost.total_cmp(&b.cost)) {
        Some(offset) => Rivalry::Rival { offset, log_odds: stands_cost - offset.cost },
        None => Rivalry::Unrivalled,
    }
}

impl Evidence<'_> {
    /// The trajectory itself, with the clocks that fit it best.
    fn stands(&self) -> Offset {
        self.refine(Unknowns::zeros(), false)
    }

    /// The likeliest distinct position.
    fn best_elsewhere(&self, seed: u64) -> Option<Offset> {
        let starts = self.candidates(seed).into_iter().chain([self.stands().x]);
        let refined = starts.map(|x| self.refine(x, true));
        let elsewhere = refined.filter(|offset| are_distinct(&offset.position_m()));
        elsewhere.min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    fn error(&self, pooled: &Pooled) -> CodeError {
        match self.noise {
            Noise::Learnt => pooled.error,
            Noise::BeforeLearning => pooled.before_learning,
        }
    }

    fn satellites(&self) -> usize {
        let mut satellites: Vec<_> = self.pool.iter().map(|pooled| pooled.satellite).collect();
        satellites.sort_unstable();
        satellites.dedup();
        satellites.len()
    }

    /// Whether inter-system biases are known, so that a subset determines one clock for all
    /// constellations.
    fn shares_clock(&self) -> bool {
        self.knowledge.bias_sigma_m.is_finite()
    }

    /// Number of clocks that a subset must determine.
    fn clocks(&self) -> usize {
        if self.shares_clock() { 1 } else { self.present.iter().filter(|p| **p).count() }
    }

    fn mean_clock_m(&self, x: &Unknowns) -> f64 {
        let clocks = (0..Constellation::COUNT).filter(|i| self.present[*i]).map(|i| x[3 + i]);
        let (sum, count) = clocks.fold((0.0, 0.0), |(sum, n), clock| (sum + clock, n + 1.0));
        sum / count
    }

    fn residual_m(pooled: &Pooled, x: &Unknowns) -> f64 {
        let Pooled { slope, .. } = pooled;
        let along_m = slope.x * x[0] + slope.y * x[1] + slope.z * x[2];
        pooled.residual_m - along_m - x[3 + pooled.satellite.constellation.index()]
    }

    fn cost(&self, x: &Unknowns) -> f64 {
        let Knowledge { bias_sigma_m, settled } = self.knowledge;
        let mean_m = self.mean_clock_m(x);
        let present = (0..Constellation::COUNT).filter(|i| self.present[*i]);
        let biases = present.map(|i| 0.5 * ((x[3 + i] - mean_m) / bias_sigma_m).powi(2));
        let student = |square: f64| 2.0 * (square / (3.0 * SETTLED_M * SETTLED_M)).ln_1p();
        let moved = student(x[0] * x[0] + x[1] * x[1]) + student(x[2] * x[2]);
        self.loss(|p| Self::residual_m(p, x)) + biases.sum::<f64>() + settled * moved
    }

    /// A lower bound of all costs: the cost of a position that leaves no residual.
    fn least_cost(&self) -> f64 {
        self.loss(|_| 0.0)
    }

    /// Σ κ·J of these residuals (m), and the cost of the noise.
    fn loss(&self, residual_m: impl Fn(&Pooled) -> f64) -> f64 {
        let pools = self.pool.chunk_by(|a, b| a.independent == b.independent);
        let density = |p: &Pooled| self.error(p).density(residual_m(p));
        let losses = pools.map(|pool| -pool[0].independent * log_product(pool.iter().map(density)));
        let of_noise = if self.noise == Noise::Learnt { 0.0 } else { UNLEARNT_COST };
        losses.sum::<f64>() + of_noise
    }

    fn offset(&self, x: Unknowns) -> Offset {
        Offset { x, cost: self.cost(&x), noise: self.noise }
    }

    /// Minimises the cost from `x` by expectation maximisation; unless `moves`, over the clocks
    /// only.
    fn refine(&self, mut x: Unknowns, moves: bool) -> Offset {
        for _ in 0..ITERATIONS_MAX {
            let (normal, right) = self.normal_equations(&x, moves);
            let Some(factor) = normal.cholesky() else { break };
            let step = factor.solve(&right);
            let length_m = step.amax();
            x += step * (STEP_MAX_M / length_m).min(1.0);
            if length_m < LAST_STEP_M {
                break;
            }
        }
        self.offset(x)
    }

    /// Lower triangle of the normal equations of a step from `x`, and their right side.
    fn normal_equations(&self, x: &Unknowns, moves: bool) -> (Normal, Unknowns) {
        // WEAK keeps unknowns that no residual determines where they are. HELD fixes the position
        // if it does not move, and the clocks of absent constellations.
        const WEAK: f64 = 1e-9;
        const HELD: f64 = 1e12;
        let bias_sigma_m = self.knowledge.bias_sigma_m;
        let (mut normal, mut right) = (Normal::zeros(), Unknowns::zeros());
        (0..3).for_each(|i| normal[(i, i)] = if moves { WEAK } else { HELD });
        let (mean_m, tie) = (self.mean_clock_m(x), bias_sigma_m.powi(-2));
        for i in 0..Constellation::COUNT {
            let c = 3 + i;
            normal[(c, c)] = if self.present[i] { WEAK + tie } else { HELD };
            right[c] = if self.present[i] { -tie * (x[c] - mean_m) } else { 0.0 };
        }
        for pooled in self.pool {
            let at = self.error(pooled).evaluate(Self::residual_m(pooled, x));
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

    /// The best distinct positions of the drawn subsets, best first.
    fn candidates(&self, seed: u64) -> Vec<Unknowns> {
        let (mut draws, mut subset) = (Draws::new(seed), Vec::with_capacity(UNKNOWNS));
        let mut found = Vec::with_capacity(SUBSETS);
        for _ in 0..SUBSETS {
            self.draw_subset(&mut draws, &mut subset);
            found.extend(self.solve_subset(&subset).map(|x| self.offset(x)));
        }
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut distinct: Vec<Offset> = Vec::with_capacity(REFINED);
        for offset in found {
            let apart = |other: &Offset| are_distinct(&(other.position_m() - offset.position_m()));
            if distinct.len() < REFINED && distinct.iter().all(apart) {
                distinct.push(offset);
            }
        }
        distinct.into_iter().map(|offset| offset.x).collect()
    }

    /// Draws residuals of different satellites until they determine a position and their clocks.
    fn draw_subset(&self, draws: &mut Draws, subset: &mut Vec<usize>) {
        let total: f64 = self.pool.iter().map(|pooled| 1.0 - self.error(pooled).reflected).sum();
        let mut drawn = [false; Constellation::COUNT];
        subset.clear();
        for _ in 0..DRAWS_MAX {
            let clocks = if self.shares_clock() { 1 } else { drawn.iter().filter(|d| **d).count() };
            if !subset.is_empty() && 3 + clocks <= subset.len() {
                break;
            }
            let mut left = draws.unit() * total;
            let reached = |pooled: &Pooled| {
                left -= 1.0 - self.error(pooled).reflected;
                left < 0.0
            };
            let index = self.pool.iter().position(reached).unwrap_or(self.pool.len() - 1);
            let satellite = self.pool[index].satellite;
            if subset.iter().all(|other: &usize| self.pool[*other].satellite != satellite) {
                subset.push(index);
                drawn[satellite.constellation.index()] = true;
            }
        }
    }

    /// The offset that leaves no residual in a subset. A clock that the subset does not determine
    /// is set to the lower tercile of its constellation's residuals, because reflections are late.
    fn solve_subset(&self, subset: &[usize]) -> Option<Unknowns> {
        let (mut normal, mut right) = (Normal::identity() * 1e-10, Unknowns::zeros());
        let mut drawn = [self.shares_clock(); Constellation::COUNT];
        for index in subset {
            let Pooled { satellite, slope, residual_m, .. } = &self.pool[*index];
            let system = if self.shares_clock() { 0 } else { satellite.constellation.index() };
            drawn[system] = true;
            let mut row = Unknowns::zeros();
            row.fixed_rows_mut::<3>(0).copy_from(slope);
            row[3 + system] = 1.0;
            normal += row * row.transpose();
            right += row * *residual_m;
        }
        let mut x = normal.cholesky()?.solve(&right);
        if !(x[0].hypot(x[1]) < REACH_M && x[2].abs() < REACH_M) {
            return None;
        }
        if self.shares_clock() {
            let clock_m = x[3];
            x.rows_mut(3, Constellation::COUNT).fill(clock_m);
        }
        for system in (0..Constellation::COUNT).filter(|i| self.present[*i] && !drawn[*i]) {
            let of = |p: &&Pooled| p.satellite.constellation.index() == system;
            let mut own: Vec<f64> = self
                .pool
                .iter()
                .filter(of)
                .map(|p| Self::residual_m(p, &x) + x[3 + system])
                .collect();
            let third = own.len() / 3;
            x[3 + system] = *own.select_nth_unstable_by(third, f64::total_cmp).1;
        }
        Some(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN_NOISE: CodeError = CodeError { sigma_m: 2.0, reflected: 0.3 };
    const KNOWN: Knowledge = Knowledge { bias_sigma_m: 6.0, settled: 0.0 };

    /// Residuals of twelve satellites on a trajectory that is wrong by `off`. The pseudoranges of
    /// `late` are reflections, 45 m too long.
    fn pool(off: Vector3<f64>, late: &[usize]) -> Vec<Pooled> {
        let pooled = |index: usize| {
            let azimuth = index as f64 * 2.4;
            let elevation = 0.4 + 0.08 * index as f64;
            let slope = -Vector3::new(
                azimuth.sin() * elevation.cos(),
                azimuth.cos() * elevation.cos(),
                elevation.sin(),
            );
            let reflection_m = if late.contains(&index) { 45.0 } else { 0.0 };
            let satellite =
                format!("{}{:02}", if index.is_multiple_of(2) { 'G' } else { 'E' }, index + 1);
            Pooled {
                satellite: satellite.parse().unwrap(),
                slope,
                residual_m: -slope.dot(&off) + reflection_m + 0.3 * (index as f64).sin(),
                error: KNOWN_NOISE,
                before_learning: KNOWN_NOISE,
                independent: 1.0,
            }
        };
        (0..12).map(pooled).collect()
    }

    /// The rival, which must exist, and its log odds.
    fn found(pool: &[Pooled], knowledge: Knowledge) -> (Offset, f64) {
        match rivalry(pool, knowledge, f64::NEG_INFINITY, 7) {
            Rivalry::Rival { offset, log_odds } => (offset, log_odds),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_trajectory_that_is_off_has_a_likelier_rival_where_the_truth_is() {
        let off = Vector3::new(40.0, -25.0, 30.0);
        for bias_sigma_m in [6.0, f64::INFINITY] {
            let knowledge = Knowledge { bias_sigma_m, ..KNOWN };
            let (offset, log_odds) = found(&pool(off, &[0, 5, 9]), knowledge);
            assert!(20.0 < log_odds, "{log_odds}");
            assert!((offset.position_m() + off).norm() < 3.0, "{offset:?}");
        }
    }

    #[test]
    fn a_trajectory_that_is_right_has_none() {
        let rivalry = rivalry(&pool(Vector3::zeros(), &[1, 6]), KNOWN, f64::NEG_INFINITY, 7);
        let is_right = match rivalry {
            Rivalry::Unrivalled => true,
            Rivalry::Rival { log_odds, .. } => log_odds < -10.0,
            Rivalry::Undetermined => false,
        };
        assert!(is_right, "{rivalry:?}");
    }

    /// The offset of 60 m costs T(60 m) = 2·ln(1 + 3600/300) = 5.13; that of the height is zero.
    #[test]
    fn a_settled_trajectory_is_moved_for_more() {
        let pool = pool(Vector3::new(60.0, 0.0, 0.0), &[]);
        let odds = |settled| found(&pool, Knowledge { settled, ..KNOWN }).1;
        assert!((odds(0.0) - odds(1.0) - 5.13).abs() < 0.3, "{} {}", odds(0.0), odds(1.0));
    }

    /// From a height that is 40 m wrong all signals seem reflected. Noise that was learnt there makes
    /// the truth no likelier; by the prior's noise the truth has odds, less the cost of the prior.
    #[test]
    fn noise_learnt_at_a_wrong_position_is_doubted() {
        let off = Vector3::new(3.0, -4.0, -40.0);
        let learnt = CodeError { sigma_m: 12.0, reflected: 0.98 };
        let with_prior = |before_learning| {
            let residual = |pooled| Pooled { error: learnt, before_learning, ..pooled };
            pool(off, &[]).into_iter().map(residual).collect::<Vec<_>>()
        };
        let (_, learnt_alone) = found(&with_prior(learnt), KNOWN);
        let (offset, log_odds) = found(&with_prior(KNOWN_NOISE), KNOWN);
        assert!(learnt_alone < 5.0 && 10.0 < log_odds, "{learnt_alone} {log_odds}");
        assert!(offset.is_before_learning() && (offset.position_m() + off).norm() < 3.0);
    }

    #[test]
    fn too_few_satellites_decide_nothing() {
        let rivalry = rivalry(&pool(Vector3::zeros(), &[])[..4], KNOWN, f64::NEG_INFINITY, 7);
        assert!(matches!(rivalry, Rivalry::Undetermined));
    }
}
