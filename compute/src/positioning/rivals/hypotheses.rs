//! Searches for the position on which the pseudoranges of the last half minute agree.
//!
//! A hypothesis (d, c) moves the whole estimated trajectory by the offset d, and the clock of each
//! constellation by an offset c. It leaves the residuals s − gᵀd − c, with s = measured − modelled
//! (m) at the estimate and g = ∂ρ/∂p. Its cost is
//!
//! Σ κ·J(s − gᵀd − c) + Σ T((c − c̄)/β) + a·[T(d_h/10 m) + T(d_v/10 m)]
//!
//! - J: negative log likelihood of [`PseudorangeError`]; one term for each satellite and ten
//!   seconds. The noise is either the learnt one, or the one before learning, which costs 3 more.
//!   The latter is needed because from a wrong position direct signals look like reflections, and
//!   the noise that was learnt there confirms that position.
//! - κ: independent fraction of these terms' information; smaller at rest, where multipath repeats.
//! - T: −ln of Student's t density with three degrees of freedom. It penalises large offsets of the
//!   inter-system biases, and those of a trajectory that has been accepted for a while (a → 1). Its
//!   tails are heavy because biases estimated at a wrong position are as wrong as the position, and
//!   because receivers step the clock of a constellation.
//! - β: scale of the errors of inter-system biases; infinite while they are unknown. c̄: the median
//!   of the constellations' offsets.
//!
//! Two hypotheses have the odds exp(−Δcost).
//!
//! Candidates are the positions of minimal subsets of satellites, drawn with the probability that
//! they are direct (Fischler & Bolles 1981, *Random sample consensus*, CACM 24). The best ones are
//! refined by expectation maximisation, and so is the trajectory itself, from its own clocks and
//! from the lower tercile of each constellation's residuals, because reflections are late. The
//! draws depend on the time of the epoch only, so that a replay makes the same ones.

use std::cmp::Ordering;

use nalgebra::{Matrix4, Vector3, Vector4};

use crate::gnss::Constellation;
use crate::positioning::draws::{Draws, subsets_needed};

use super::evidence::{Evidence, Knowledge, Noise, Normal, Offset, Pooled, UNKNOWNS, Unknowns};

/// Largest number of subsets drawn. If half of the satellites are direct, at least one subset of
/// four is all direct with a probability of 1 − (15/16)⁴⁰ = 92 %, or of 72 % if every other subset
/// determines a clock for each constellation. The search is repeated with other draws.
const SUBSETS_MAX: usize = 40;
/// Largest number of draws of a satellite for one subset.
const DRAWS_MAX: usize = 60;
/// Number of candidates that are refined.
const REFINED: usize = 2;
/// Horizontal distance up to which positions of subsets count as the same (m).
const APART_HORIZONTAL_M: f64 = 8.0;
/// The same vertically, where positions are half as precise (m).
const APART_VERTICAL_M: f64 = 16.0;
/// Keeps unknowns that no residual determines at zero (1/m²).
const WEAK: f64 = 1e-10;
/// Largest horizontal and largest vertical offset of a candidate (m).
const REACH_M: f64 = 1e3;

/// Whether two positions at this distance count as different.
fn are_apart(by_m: &Vector3<f64>) -> bool {
    APART_HORIZONTAL_M < by_m.xy().norm() || APART_VERTICAL_M < by_m.z.abs()
}

/// The result of a search.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Rivalry {
    /// The satellites are too few for a redundant position.
    Undetermined,
    /// The likeliest hypotheses besides the trajectory.
    Rivals(Rivals),
}

/// The likeliest hypotheses besides the trajectory. One is missing if there is no candidate, or
/// none that can reach the required odds.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Rivals {
    /// That at another position, [`are_apart`] from the trajectory.
    pub(crate) far: Option<Rival>,
    /// That near the trajectory, distinct from it by the residuals.
    pub(crate) near: Option<Rival>,
}

impl Rivals {
    /// The likelier one.
    pub(crate) fn likeliest(&self) -> Option<Rival> {
        let both = [self.far, self.near].into_iter().flatten();
        both.max_by(|a, b| a.log_odds.total_cmp(&b.log_odds))
    }
}

/// A hypothesis beside the trajectory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rival {
    /// Its offset from the estimated trajectory.
    pub(crate) offset: Offset,
    /// Logarithm of its odds against the trajectory.
    pub(crate) log_odds: f64,
}

/// Searches for the likeliest hypotheses besides the trajectory, if any can have log odds of
/// `wanted`. `seed` determines the draws.
pub(crate) fn rivalry(pool: &[Pooled], knowledge: Knowledge, wanted: f64, seed: u64) -> Rivalry {
    let learnt = Evidence::new(pool, Noise::Learnt, knowledge);
    if satellites(pool) < 3 + clocks(&learnt) + 1 {
        return Rivalry::Undetermined;
    }
    let mut models = vec![(learnt.trajectory(), learnt)];
    if pool.iter().any(|pooled| pooled.error != pooled.before_learning) {
        let before = Evidence::new(pool, Noise::BeforeLearning, knowledge);
        models.push((before.trajectory(), before));
    }
    let costs = models.iter().map(|(trajectory, _)| trajectory.cost());
    let cost = costs.fold(f64::INFINITY, f64::min);
    models.retain(|(_, evidence)| wanted <= cost - evidence.cost_bound());
    let all = models.iter().flat_map(|(start, evidence)| hypotheses(evidence, start, seed));
    let (far, near): (Vec<_>, Vec<_>) = all.partition(|offset| are_apart(&offset.position_m()));
    let likeliest = |hypotheses: Vec<Offset>| {
        let offset = hypotheses.into_iter().min_by(by_cost)?;
        Some(Rival { offset, log_odds: cost - offset.cost() })
    };
    Rivalry::Rivals(Rivals { far: likeliest(far), near: likeliest(near) })
}

/// Hypotheses that are distinct from `trajectory`, which has its best clocks.
fn hypotheses(evidence: &Evidence<'_>, trajectory: &Offset, seed: u64) -> Vec<Offset> {
    let mut search = Search::new(evidence, seed);
    let from_subsets = search.candidates().into_iter();
    // A candidate that comes near the trajectory would converge to one of those in `near`.
    let far = from_subsets.filter_map(|offset| evidence.refine_while(offset, are_apart));
    let far = far.filter(|offset| are_apart(&offset.position_m()));
    // A known clock that has stepped makes a minimum of its own.
    let mut tercile_m = |system| search.late_clock_m(system, &Unknowns::zeros());
    let stepped = evidence.shares_clock().then(|| evidence.with_clocks(&mut tercile_m));
    let near = stepped.iter().chain([trajectory]).map(|start| evidence.refine(start));
    far.chain(near.filter(|offset| evidence.are_distinct(offset, trajectory))).collect()
}

fn by_cost(a: &Offset, b: &Offset) -> Ordering {
    a.cost().total_cmp(&b.cost())
}

fn satellites(pool: &[Pooled]) -> usize {
    let mut satellites: Vec<_> = pool.iter().map(|pooled| pooled.satellite).collect();
    satellites.sort_unstable();
    satellites.dedup();
    satellites.len()
}

/// Number of clocks that a subset must determine.
fn clocks(evidence: &Evidence<'_>) -> usize {
    if evidence.shares_clock() { 1 } else { evidence.present().count() }
}

/// Random minimal subsets of the residuals, and their positions.
struct Search<'a> {
    evidence: &'a Evidence<'a>,
    /// Sums of the probabilities that residuals are of direct signals, up to each of them.
    directs: Vec<f64>,
    /// Number of subsets to draw: until one contains only direct signals.
    subsets: usize,
    draws: Draws,
    /// The residuals drawn last.
    subset: Vec<usize>,
    /// The residuals of a constellation (m).
    own_m: Vec<f64>,
}

impl<'a> Search<'a> {
    fn new(evidence: &'a Evidence<'a>, seed: u64) -> Self {
        let count = evidence.pool().len();
        let mut directs = Vec::with_capacity(count);
        let (mut sum, mut squares) = (0.0, 0.0);
        for pooled in evidence.pool() {
            let direct = 1.0 - evidence.error(pooled).reflected;
            sum += direct;
            squares += direct * direct;
            directs.push(sum);
        }
        // Signals are drawn with their probability of being direct. So the probability that a drawn
        // signal is direct is the mean of these probabilities, weighted with themselves.
        let needed = subsets_needed(squares / sum, 3 + clocks(evidence));
        let subsets = (needed.ceil() as usize).clamp(1, SUBSETS_MAX);
        let (subset, own_m) = (Vec::with_capacity(UNKNOWNS), Vec::with_capacity(count));
        Self { evidence, directs, subsets, draws: Draws::new(seed), subset, own_m }
    }

    /// The best positions of the drawn subsets that are distinct from the trajectory and from each
    /// other, best first.
    fn candidates(&mut self) -> Vec<Offset> {
        let mut best: Vec<Offset> = Vec::with_capacity(REFINED + 1);
        for subset in 0..self.subsets {
            // Biases that were estimated at a wrong position are as wrong as it is.
            let shares_clock = self.evidence.shares_clock() && subset.is_multiple_of(2);
            self.draw(shares_clock);
            let Some(x) = self.solved(shares_clock) else { continue };
            let enough = best.get(REFINED - 1).map_or(f64::INFINITY, Offset::cost);
            if let Some(offset) = self.evidence.offset_below(x, enough) {
                keep_best(&mut best, offset);
            }
        }
        best
    }

    /// Draws residuals of different satellites until they determine a position and their clocks.
    fn draw(&mut self, shares_clock: bool) {
        let pool = self.evidence.pool();
        let total = self.directs.last().copied().unwrap_or(0.0);
        let mut drawn = [false; Constellation::COUNT];
        self.subset.clear();
        for _ in 0..DRAWS_MAX {
            let clocks = if shares_clock { 1 } else { drawn.iter().filter(|d| **d).count() };
            if !self.subset.is_empty() && 3 + clocks <= self.subset.len() {
                break;
            }
            let reached = self.draws.unit() * total;
            let index = self.directs.partition_point(|sum| *sum <= reached).min(pool.len() - 1);
            let satellite = pool[index].satellite;
            if self.subset.iter().all(|other| pool[*other].satellite != satellite) {
                self.subset.push(index);
                drawn[satellite.constellation.index()] = true;
            }
        }
    }

    /// The offset that leaves no residual in the subset, if its position is distinct from the
    /// trajectory and within reach.
    fn solved(&mut self, shares_clock: bool) -> Option<Unknowns> {
        let (mut x, drawn) = match shares_clock {
            true => (self.with_one_clock()?, [true; Constellation::COUNT]),
            false => self.with_own_clocks()?,
        };
        let by_m = x.fixed_rows::<3>(0).into_owned();
        let is_near = by_m.xy().norm() < REACH_M && by_m.z.abs() < REACH_M;
        if !is_near || !are_apart(&by_m) {
            return None;
        }
        for system in self.evidence.present().filter(|system| !drawn[*system]) {
            x[3 + system] = self.late_clock_m(system, &x);
        }
        Some(x)
    }

    /// Position and one clock for all constellations.
    fn with_one_clock(&self) -> Option<Unknowns> {
        let (mut normal, mut right) = (Matrix4::identity() * WEAK, Vector4::zeros());
        for index in &self.subset {
            let Pooled { slope, excess_m, .. } = &self.evidence.pool()[*index];
            let row = slope.push(1.0);
            normal += row * row.transpose();
            right += row * *excess_m;
        }
        let solved = normal.cholesky()?.solve(&right);
        let mut x = Unknowns::repeat(solved.w);
        x.fixed_rows_mut::<3>(0).copy_from(&solved.xyz());
        Some(x)
    }

    /// Position and the clocks of the drawn constellations, and which these are.
    fn with_own_clocks(&self) -> Option<(Unknowns, [bool; Constellation::COUNT])> {
        let (mut normal, mut right) = (Normal::identity() * WEAK, Unknowns::zeros());
        let mut drawn = [false; Constellation::COUNT];
        for index in &self.subset {
            let Pooled { satellite, slope, excess_m, .. } = &self.evidence.pool()[*index];
            let clock = 3 + satellite.constellation.index();
            drawn[clock - 3] = true;
            for i in 0..3 {
                right[i] += slope[i] * excess_m;
                normal[(clock, i)] += slope[i];
                (0..=i).for_each(|j| normal[(i, j)] += slope[i] * slope[j]);
            }
            normal[(clock, clock)] += 1.0;
            right[clock] += excess_m;
        }
        Some((normal.cholesky()?.solve(&right), drawn))
    }

    /// The lower tercile of the clock by a constellation's residuals at the position of `x` (m),
    /// because reflections are late.
    fn late_clock_m(&mut self, system: usize, x: &Unknowns) -> f64 {
        let of = |p: &&Pooled| p.satellite.constellation.index() == system;
        let own = self.evidence.pool().iter().filter(of);
        self.own_m.clear();
        self.own_m.extend(own.map(|p| p.left_m(x) + x[3 + system]));
        let third = self.own_m.len() / 3;
        *self.own_m.select_nth_unstable_by(third, f64::total_cmp).1
    }
}

/// Adds a candidate to the best ones, unless a better one is at the same position.
fn keep_best(best: &mut Vec<Offset>, new: Offset) {
    let same = |other: &Offset| !are_apart(&(other.position_m() - new.position_m()));
    if best.iter().any(|other| same(other) && other.cost() <= new.cost()) {
        return;
    }
    best.retain(|other| !same(other));
    let place = best.partition_point(|other| other.cost() <= new.cost());
    best.insert(place, new);
    best.truncate(REFINED);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::pseudorange_error::PseudorangeError;

    const KNOWN_NOISE: PseudorangeError =
        PseudorangeError { sigma_m: 2.0, reflected: 0.3, extra_path_m: 40.0 };
    const KNOWN: Knowledge = Knowledge { bias_scale_m: 6.0, settled: 0.0 };

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
                excess_m: -slope.dot(&off) + reflection_m + 0.3 * (index as f64).sin(),
                error: KNOWN_NOISE,
                before_learning: KNOWN_NOISE,
                independent: 1.0,
            }
        };
        (0..12).map(pooled).collect()
    }

    /// The rivals of a pool that determines them.
    fn rivals(pool: &[Pooled], knowledge: Knowledge) -> Rivals {
        match rivalry(pool, knowledge, f64::NEG_INFINITY, 7) {
            Rivalry::Rivals(rivals) => rivals,
            Rivalry::Undetermined => panic!("undetermined"),
        }
    }

    /// The likeliest rival, which must exist, and its log odds.
    fn found(pool: &[Pooled], knowledge: Knowledge) -> (Offset, f64) {
        let Rival { offset, log_odds } = rivals(pool, knowledge).likeliest().unwrap();
        (offset, log_odds)
    }

    #[test]
    fn a_trajectory_that_is_off_has_a_likelier_rival_where_the_truth_is() {
        let off = Vector3::new(40.0, -25.0, 30.0);
        for bias_scale_m in [6.0, f64::INFINITY] {
            let knowledge = Knowledge { bias_scale_m, ..KNOWN };
            let (offset, log_odds) = found(&pool(off, &[0, 5, 9]), knowledge);
            assert!(20.0 < log_odds, "{log_odds}");
            assert!((offset.position_m() + off).norm() < 3.0, "{offset:?}");
        }
    }

    #[test]
    fn a_trajectory_that_is_right_has_none() {
        let likeliest = rivals(&pool(Vector3::zeros(), &[1, 6]), KNOWN).likeliest();
        assert!(likeliest.is_none_or(|rival| rival.log_odds < -10.0), "{likeliest:?}");
    }

    /// The offset of 60 m costs T(60 m) = 2·ln(1 + 3600/300) = 5.13; that of the height is zero.
    #[test]
    fn a_settled_trajectory_is_moved_for_more() {
        let pool = pool(Vector3::new(60.0, 0.0, 0.0), &[]);
        let odds = |settled| found(&pool, Knowledge { settled, ..KNOWN }).1;
        assert!((odds(0.0) - odds(1.0) - 5.13).abs() < 0.3, "{} {}", odds(0.0), odds(1.0));
    }

    /// From a height that is 40 m wrong all signals seem reflected. With the noise that was learnt
    /// there, the truth is not likelier. With the noise before learning it is, by its odds less the
    /// cost of that noise.
    #[test]
    fn noise_learnt_at_a_wrong_position_is_doubted() {
        let off = Vector3::new(3.0, -4.0, -40.0);
        let learnt = PseudorangeError { sigma_m: 12.0, reflected: 0.98, extra_path_m: 40.0 };
        let with_prior = |before_learning| {
            let residual = |pooled| Pooled { error: learnt, before_learning, ..pooled };
            pool(off, &[]).into_iter().map(residual).collect::<Vec<_>>()
        };
        let (_, learnt_alone) = found(&with_prior(learnt), KNOWN);
        let (offset, log_odds) = found(&with_prior(KNOWN_NOISE), KNOWN);
        assert!(learnt_alone < 5.0 && 10.0 < log_odds, "{learnt_alone} {log_odds}");
        assert!(offset.is_before_learning() && (offset.position_m() + off).norm() < 3.0);
    }

    /// The estimate has followed reflections to a position 200 m too high, and Galileo's bias with
    /// it: there it is 90 m off. The costs of such a bias are 2·ln(1 + 15²/3) = 8.7; those of a
    /// normal error would be 112.
    #[test]
    fn biases_estimated_at_a_wrong_position_are_left_with_it() {
        let off = Vector3::new(40.0, -25.0, 200.0);
        let mut pool = pool(off, &[0, 5, 9]);
        shift_galileo(&mut pool, -90.0);
        let (offset, log_odds) = found(&pool, KNOWN);
        assert!(10.0 < log_odds, "{log_odds}");
        assert!((offset.position_m() + off).norm() < 3.0, "{offset:?}");
        assert!((galileo_minus_gps_m(&offset) + 90.0).abs() < 3.0, "{offset:?}");
    }

    /// The receiver's clock for Galileo steps by 60 m. The position stays.
    #[test]
    fn a_clock_that_steps_is_followed_at_the_same_position() {
        for step_m in [60.0, -60.0] {
            let mut pool = pool(Vector3::zeros(), &[1, 6]);
            shift_galileo(&mut pool, step_m);
            let (offset, log_odds) = found(&pool, KNOWN);
            assert!(10.0 < log_odds, "{log_odds}");
            assert!(offset.position_m().norm() < 3.0, "{offset:?}");
            assert!((galileo_minus_gps_m(&offset) - step_m).abs() < 3.0, "{offset:?}");
        }
    }

    /// A position 5 m off is a rival of precise pseudoranges, not of noisy ones.
    #[test]
    fn near_positions_are_distinct_to_precise_pseudoranges() {
        let off = Vector3::new(3.0, 0.0, -4.0);
        let with_sigma = |sigma_m| {
            let error = PseudorangeError { sigma_m, ..KNOWN_NOISE };
            let precise = |pooled| Pooled { error, before_learning: error, ..pooled };
            pool(off, &[]).into_iter().map(precise).collect::<Vec<_>>()
        };
        let (offset, log_odds) = found(&with_sigma(0.5), KNOWN);
        assert!(10.0 < log_odds && (offset.position_m() + off).norm() < 0.5, "{offset:?}");
        let likeliest = rivals(&with_sigma(4.0), KNOWN).likeliest();
        assert!(likeliest.is_none_or(|rival| rival.log_odds < 0.0), "{likeliest:?}");
    }

    /// Two thirds of the satellites agree on a position 4 m off, one third on one 60 m off. The
    /// near one is likelier, and does not hide the other.
    #[test]
    fn a_near_rival_hides_no_far_one() {
        let precise = PseudorangeError { sigma_m: 0.5, ..KNOWN_NOISE };
        let (near_m, far_m) = (Vector3::new(4.0, 0.0, 0.0), Vector3::new(-60.0, 0.0, 0.0));
        let mut pool = pool(near_m, &[]);
        for (index, pooled) in pool.iter_mut().enumerate() {
            (pooled.error, pooled.before_learning) = (precise, precise);
            if index % 3 == 0 {
                pooled.excess_m -= pooled.slope.dot(&(far_m - near_m));
            }
        }
        let Rivals { far, near } = rivals(&pool, KNOWN);
        let (far, near) = (far.unwrap(), near.unwrap());
        assert!(far.log_odds < near.log_odds, "{far:?} {near:?}");
        assert!((near.offset.position_m() + near_m).norm() < 1.0, "{near:?}");
        assert!(are_apart(&far.offset.position_m()), "{far:?}");
    }

    fn shift_galileo(pool: &mut [Pooled], by_m: f64) {
        let galileo =
            |pooled: &&mut Pooled| pooled.satellite.constellation == Constellation::Galileo;
        pool.iter_mut().filter(galileo).for_each(|pooled| pooled.excess_m += by_m);
    }

    fn galileo_minus_gps_m(offset: &Offset) -> f64 {
        offset.clock_m(Constellation::Galileo) - offset.clock_m(Constellation::Gps)
    }

    #[test]
    fn too_few_satellites_decide_nothing() {
        let pool = pool(Vector3::zeros(), &[]);
        let rivalry = rivalry(&pool[..4], KNOWN, f64::NEG_INFINITY, 7);
        assert!(matches!(rivalry, Rivalry::Undetermined));
    }
}
