//! Best and second-best integers against two independent implementations, up to 16 entries.

use graphfix_oracles::lambda::Options;
use graphfix_oracles::lambda::Partial;
use graphfix_oracles::lambda::Resolver;
use nalgebra::DMatrix;

const CASES_PER_SIZE: usize = 40;

/// A fixed irregular sequence in −1..1.
fn pseudo(i: usize) -> f64 {
    let x = (i as f64 + 1.0) * 0.754_877_666_246_692_8;
    2.0 * (x * (1.0 + x)).fract() - 1.0
}

/// A covariance with strong correlations: differences of precise measurements of three parameters
/// that are known coarsely.
fn covariance(size: usize, seed: usize) -> DMatrix<f64> {
    let coarseness = [10.0, 30.0, 100.0][seed % 3];
    let design = DMatrix::from_fn(size, 3, |i, j| coarseness * pseudo(seed * 97 + 3 * i + j));
    let differencing = DMatrix::from_fn(size, size, |i, j| if i == j { 2.0 } else { 1.0 });
    (differencing + &design * design.transpose()) * [0.0025, 0.01, 0.04][seed / 3 % 3]
}

#[test]
fn two_independent_implementations_agree() {
    let options = Options {
        success_rate_min: 0.0,
        ratio_min: 1.0,
        probability_min: 0.0,
        scale: None,
        fixed_min: 1,
        candidates: 2,
        nodes_max: 10_000_000,
        attempts_max: 1,
    };
    let mut resolver = Resolver::with_capacity(16);
    let mut compared = 0;
    for size in 1..=16 {
        for seed in 0..CASES_PER_SIZE {
            let covariance = covariance(size, seed);
            let float: Vec<f64> = (0..size).map(|i| 3e3 * pseudo(seed * 31 + i)).collect();
            let outcome =
                resolver.resolve(&float, &covariance, Partial::None, &options).expect("definite");
            let integers: Vec<i64> = resolver.fix().entries().iter().flatten().copied().collect();
            let best = outcome.squared_norm.expect("searched");
            let second = best * outcome.ratio.expect("two candidates");
            let close = |a: f64, b: f64| (a - b).abs() < 1e-6 * (1.0 + b);

            let flat: Vec<f64> = covariance.iter().copied().collect();
            let other = spacelab_gnss::lambda::Reduction::new(&float, &flat).expect("definite");
            let found = other.search(2).expect("within its limit");
            assert_eq!(found[0].ambiguities, integers, "spacelab, n {size}, seed {seed}");
            assert!(close(found[0].squared_norm, best) && close(found[1].squared_norm, second));

            let rows: Vec<Vec<f64>> =
                covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
            let other = astrodynamics_gnss::ils::lambda_ils_search(&float, &rows, 1.0)
                .expect("within its limit");
            assert_eq!(other.fixed, integers, "astrodynamics, n {size}, seed {seed}");
            assert!(close(other.best_score, best));
            assert!(other.second_best_score.is_some_and(|score| close(score, second)));
            compared += 1;
        }
    }
    assert_eq!(compared, 16 * CASES_PER_SIZE);
}
