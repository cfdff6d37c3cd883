//! Time of one call of the integer resolver, decorrelation included.
//!
//! Covariances are those of differences of `n` + 1 precise measurements of three real parameters,
//! beside measurements that are 100 times coarser. `weak` cannot be fixed completely; `singular`
//! has condition 10¹².

use divan::Bencher;
use graphfix::lambda::Options;
use graphfix::lambda::Partial;
use graphfix::lambda::Resolver;
use nalgebra::DMatrix;

const SIZES: [usize; 5] = [5, 10, 20, 40, 100];

fn main() {
    divan::main();
}

#[divan::bench(args = SIZES)]
fn strong(bencher: Bencher<'_, '_>, size: usize) {
    resolve(bencher, &covariance(size, 0.05, 100.0));
}

#[divan::bench(args = SIZES)]
fn weak(bencher: Bencher<'_, '_>, size: usize) {
    resolve(bencher, &covariance(size, 0.5, 100.0));
}

#[divan::bench(args = SIZES)]
fn singular(bencher: Bencher<'_, '_>, size: usize) {
    resolve(bencher, &covariance(size, 0.1, 1e6));
}

fn resolve(bencher: Bencher<'_, '_>, covariance: &DMatrix<f64>) {
    let size = covariance.nrows();
    let float: Vec<f64> = (0..size).map(|i| 1e3 * pseudo(i) + 0.3 * pseudo(i + 7)).collect();
    let options = Options {
        success_rate_min: 0.0,
        ratio_min: 3.0,
        probability_min: 0.0,
        scale: None,
        fixed_min: 4,
        candidates: 2,
        nodes_max: 20_000,
        attempts_max: 20,
    };
    let mut resolver = Resolver::with_capacity(size);
    let order: Vec<usize> = (0..size).collect();
    let partial = Partial::Ordered(&order);
    bencher.bench_local(|| resolver.resolve(&float, covariance, partial, &options));
}

/// Q = s² (I + 11ᵀ + k² AAᵀ), A with pseudo-random entries.
fn covariance(size: usize, sigma: f64, coarseness: f64) -> DMatrix<f64> {
    let design = DMatrix::from_fn(size, 3, |i, j| pseudo(3 * i + j) - pseudo(3 * size + j));
    let differencing = DMatrix::from_fn(size, size, |i, j| if i == j { 2.0 } else { 1.0 });
    (differencing + &design * design.transpose() * coarseness.powi(2)) * sigma.powi(2)
}

/// A fixed irregular sequence in −1..1.
fn pseudo(i: usize) -> f64 {
    let x = (i as f64 + 1.0) * 0.754_877_666_246_692_8;
    2.0 * (x * (1.0 + x)).fract() - 1.0
}
