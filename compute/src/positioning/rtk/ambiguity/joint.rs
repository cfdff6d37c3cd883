//! The joint distribution of position and double differences: conditioning on integers, and the
//! probability of integers given the ambiguities that stay float.

use nalgebra::{DMatrix, DVector};

use super::float::FloatSolution;

/// Prior probability that a carrier tracks a reflection or hides a slip.
pub(crate) const FAULTY: f64 = 0.1;
/// Above this σ (cycles) a wrapped normal is uniform to 1.4 %: the ambiguity is no evidence.
const UNINFORMATIVE_CYCLES: f64 = 0.5;
/// Least σ of an ambiguity given the others (cycles): carrier multipath.
const UNCERTAIN_CYCLES: f64 = 0.05;

/// Position and ambiguities with their joint covariance, position first.
pub(crate) struct Joint {
    pub(crate) estimate: DVector<f64>,
    pub(crate) covariance: DMatrix<f64>,
}

impl Joint {
    /// Position and double differences of ambiguities, each given by two indices in the float
    /// solution.
    pub(crate) fn of_differences(float: &FloatSolution, pairs: &[(usize, usize)]) -> Self {
        let n = pairs.len();
        let mut joint =
            Self { estimate: DVector::zeros(3 + n), covariance: DMatrix::zeros(3 + n, 3 + n) };
        for axis in 0..3 {
            joint.estimate[axis] = float.position[axis];
            for other in 0..3 {
                joint.covariance[(axis, other)] = float.covariance[(axis, other)];
            }
        }
        for (j, &(b, s)) in pairs.iter().enumerate() {
            joint.estimate[3 + j] = float.ambiguities[b] - float.ambiguities[s];
            for axis in 0..3 {
                let cross = float.covariance[(axis, 3 + b)] - float.covariance[(axis, 3 + s)];
                joint.covariance[(axis, 3 + j)] = cross;
                joint.covariance[(3 + j, axis)] = cross;
            }
            for (i, &(a, r)) in pairs[..=j].iter().enumerate() {
                let own = float.between(a, b) - float.between(a, s);
                let references = float.between(r, b) - float.between(r, s);
                joint.covariance[(3 + i, 3 + j)] = own - references;
                joint.covariance[(3 + j, 3 + i)] = own - references;
            }
        }
        joint
    }

    /// Number of ambiguities.
    pub(crate) fn ambiguities(&self) -> usize {
        self.estimate.len() - 3
    }

    /// Position and some of the ambiguities.
    pub(crate) fn of(&self, wanted: &[usize]) -> Self {
        let kept: Vec<usize> = (0..3).chain(wanted.iter().map(|i| 3 + i)).collect();
        let m = kept.len();
        Self {
            estimate: DVector::from_fn(m, |i, _| self.estimate[kept[i]]),
            covariance: DMatrix::from_fn(m, m, |i, j| self.covariance[(kept[i], kept[j])]),
        }
    }
}

/// The probability after its odds are multiplied by a factor.
pub(crate) fn scale_odds(factor: f64, probability: f64) -> f64 {
    // Rounding may put it above one, and the next factor would make that worse.
    (probability * factor / (probability * factor + 1.0 - probability)).min(1.0)
}

/// The probability of integers that were the first of `tried` subsets to pass. Each subset may pass
/// by chance: Bonferroni's bound on the odds.
pub(crate) fn bonferroni(tried: usize, probability: f64) -> f64 {
    probability / (probability + tried.max(1) as f64 * (1.0 - probability))
}

/// The probability of integers given the ambiguities left float.
///
/// If the integers are wrong, the fractional parts d of the others are uniform, with density one.
/// If they are right, a carrier is faulty with probability ε, else its d is a wrapped normal of
/// density f: the odds change by (1 − ε)·f(d) + ε, where that is below one. Evidence in favour is
/// not independent of the search and does not count.
pub(crate) fn given_unfixed_ambiguities(probability: f64, rest: &Joint) -> f64 {
    let against = |i: usize| {
        let variance = rest.covariance[(i, i)].max(UNCERTAIN_CYCLES.powi(2));
        if UNINFORMATIVE_CYCLES.powi(2) < variance {
            return 1.0;
        }
        let beyond = rest.estimate[i] - rest.estimate[i].round();
        let normal = |k: f64| (-0.5 * (beyond + k).powi(2) / variance).exp();
        let density = [-2.0, -1.0, 0.0, 1.0, 2.0].map(normal).iter().sum::<f64>()
            / (std::f64::consts::TAU * variance).sqrt();
        ((1.0 - FAULTY) * density + FAULTY).min(1.0)
    };
    let factor: f64 = (3..rest.estimate.len()).map(against).product();
    scale_odds(factor, probability)
}

/// Position and the ambiguities `others`, conditioned on `values` for the ambiguities `known`; and
/// ‖â − z‖² of the known ones. `None` if their covariance is not positive definite.
///
/// With Q_h = LLᵀ, W = L⁻¹Q_hb and y = L⁻¹(z − â): b + Wᵀy, Q_b − WᵀW, yᵀy.
///
/// Source: Teunissen (1995), *The least-squares ambiguity decorrelation adjustment*.
pub(crate) fn condition(
    joint: &Joint,
    known: &[usize],
    values: &[f64],
    others: &[usize],
) -> Option<(Joint, f64)> {
    let kept: Vec<usize> = (0..3).chain(others.iter().map(|i| 3 + i)).collect();
    let m = known.len();
    let held = DMatrix::from_fn(m, m, |i, j| joint.covariance[(3 + known[i], 3 + known[j])]);
    let lower = held.cholesky()?.unpack();
    let mut y = DVector::from_fn(m, |i, _| values[i] - joint.estimate[3 + known[i]]);
    let mut w = DMatrix::from_fn(m, kept.len(), |i, j| joint.covariance[(3 + known[i], kept[j])]);
    let solved =
        lower.solve_lower_triangular_mut(&mut y) && lower.solve_lower_triangular_mut(&mut w);
    if !solved {
        return None;
    }
    let gain = w.tr_mul(&y);
    let less = w.tr_mul(&w);
    let estimate = DVector::from_fn(kept.len(), |i, _| joint.estimate[kept[i]] + gain[i]);
    let covariance = DMatrix::from_fn(kept.len(), kept.len(), |i, j| {
        joint.covariance[(kept[i], kept[j])] - less[(i, j)]
    });
    Some((Joint { estimate, covariance }, y.norm_squared()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One position coordinate tied to two ambiguities, x = 0.2·a₁ + 0.1·a₂ exactly; holding a₁ at
    /// 1 and then a₂ at −2 puts x at 0, whichever order.
    #[test]
    fn conditioning_worked_by_hand() {
        let slope = [0.2, 0.1];
        let q = [[0.04, 0.01], [0.01, 0.09]];
        let mut joint = Joint { estimate: DVector::zeros(5), covariance: DMatrix::identity(5, 5) };
        let float = [0.9, -1.8];
        joint.estimate[0] = slope[0] * float[0] + slope[1] * float[1];
        for i in 0..2 {
            joint.estimate[3 + i] = float[i];
            let cross = slope[0] * q[0][i] + slope[1] * q[1][i];
            (joint.covariance[(0, 3 + i)], joint.covariance[(3 + i, 0)]) = (cross, cross);
            (0..2).for_each(|j| joint.covariance[(3 + i, 3 + j)] = q[i][j]);
        }
        let both: f64 =
            slope.iter().enumerate().map(|(i, s)| s * joint.covariance[(0, 3 + i)]).sum();
        joint.covariance[(0, 0)] = both + 1e-6;
        let (first, norm) = condition(&joint, &[0], &[1.0], &[1]).unwrap();
        assert!((norm - 0.01 / 0.04).abs() < 1e-12);
        assert!((first.estimate[3] - (-1.8 + 0.01 / 0.04 * 0.1)).abs() < 1e-12);
        let (second, _) = condition(&first, &[0], &[-2.0], &[]).unwrap();
        let (at_once, _) = condition(&joint, &[0, 1], &[1.0, -2.0], &[]).unwrap();
        assert!((second.estimate[0] - at_once.estimate[0]).abs() < 1e-12);
        assert!(at_once.estimate[0].abs() < 1e-9 && at_once.covariance[(0, 0)] < 2e-6);
    }

    /// Of two carriers left real-valued, each known to 0.1 cycles, one agrees and one is half a
    /// cycle off: the odds 99 become 99·(0.9·f(½) + 0.1), f(½) = 2·e^(−12.5)/(0.1·√2π).
    #[test]
    fn unfixed_ambiguities_lower_the_odds() {
        let mut rest = Joint { estimate: DVector::zeros(5), covariance: DMatrix::zeros(5, 5) };
        (3..5).for_each(|i| rest.covariance[(i, i)] = 0.01);
        rest.estimate[3] = 7.02;
        assert!(
            (given_unfixed_ambiguities(0.99, &rest) - 0.99).abs() < 1e-12,
            "agreement adds nothing"
        );
        rest.estimate[4] = -2.5;
        let density = 2.0 * (-12.5_f64).exp() / (0.1 * std::f64::consts::TAU.sqrt());
        let odds = 99.0 * (0.9 * density + 0.1);
        assert!((given_unfixed_ambiguities(0.99, &rest) - odds / (1.0 + odds)).abs() < 1e-6);
        // An ambiguity with σ of one cycle is no evidence.
        rest.covariance[(4, 4)] = 1.0;
        assert!((given_unfixed_ambiguities(0.99, &rest) - 0.99).abs() < 1e-6);
    }

    #[test]
    fn more_tries_are_more_chances_to_be_wrong() {
        assert_eq!(bonferroni(1, 0.9), 0.9);
        assert!((bonferroni(9, 0.9) - 0.5).abs() < 1e-12);
        assert_eq!(bonferroni(5, 1.0), 1.0);
    }
}
