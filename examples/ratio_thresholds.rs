//! Simulates the table of `src/lambda/thresholds.rs` and prints it as Rust.
//!
//! Run: `cargo run --release --example ratio_thresholds`. The same seeds give the same table.
//!
//! Model of one trial: n integers seen through differences of n + 1 fine measurements of 3 real
//! parameters, which as many coarse measurements hold too. With random unit directions e_i,
//! A the differences e_i − e_0 and D = I + 11ᵀ that of the differencing,
//!
//! Q = s² (D + A Q_b Aᵀ), Q_b = k² (Aᵀ D⁻¹ A + 10⁻⁶ I)⁻¹
//!
//! where k is coarse over fine standard deviation: 30, 100 and 300, each with `GEOMETRIES`. The scale
//! s is set by bisection to the wanted bootstrapped failure rate. Of `TRIALS` floats around zero the
//! wrong ones' best-over-second ratios are sorted: the one at the wanted count is μ.

use std::f64::consts::TAU;

use graphfix::lambda::FailureRate;
use graphfix::lambda::Reduction;
use graphfix::lambda::Search;
use graphfix::lambda::SearchLimits;
use graphfix::lambda::bootstrapped_failure_rate;
use nalgebra::DMatrix;

const SIZES: [usize; 7] = [1, 2, 3, 4, 6, 8, 12];
const FAILURE_RATES: [f64; 9] = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7];
const COARSENESS: [f64; 3] = [30.0, 100.0, 300.0];
const GEOMETRIES: usize = 12;
const TRIALS: usize = 20_000;

fn main() {
    let mut tables = [FailureRate::PerMille, FailureRate::Percent].map(|rate| (rate, Vec::new()));
    for size in SIZES {
        let mut rows = [[1.0_f64; FAILURE_RATES.len()]; 2];
        for seed in 0..COARSENESS.len() * GEOMETRIES {
            let coarseness = COARSENESS[seed % COARSENESS.len()];
            let mut random = Random(0x9e37_79b9_7f4a_7c15 ^ (size * 100 + seed) as u64);
            let mut reduction = Reduction::with_capacity(size);
            reduction.reduce(&covariance(size, coarseness, &mut random)).expect("Q is definite");
            for (column, failure_rate) in FAILURE_RATES.into_iter().enumerate() {
                let wrong = wrong_ratios(&reduction, failure_rate, &mut random);
                for (row, (rate, _)) in rows.iter_mut().zip(&tables) {
                    let allowed = (rate.value() * TRIALS as f64) as usize;
                    let mu = wrong.get(allowed).copied().unwrap_or(1.0);
                    row[column] = row[column].min(mu);
                }
            }
        }
        tables.iter_mut().zip(rows).for_each(|((_, table), row)| table.push(row));
        eprintln!("n = {size} done");
    }
    for (_, table) in &mut tables {
        for small in (0..SIZES.iter().filter(|size| **size < 4).count()).rev() {
            let next = table[small + 1];
            table[small].iter_mut().zip(next).for_each(|(mu, above)| *mu = mu.min(above));
        }
    }
    println!("const SIZES: [usize; {}] = {SIZES:?};", SIZES.len());
    println!("const FAILURE_RATES: [f64; {}] = {FAILURE_RATES:?};", FAILURE_RATES.len());
    for (rate, table) in tables {
        println!("// {rate:?}");
        for row in table {
            let cells: Vec<String> = row.iter().map(|mu| format!("{mu:.3}")).collect();
            println!("    [{}],", cells.join(", "));
        }
    }
}

fn covariance(size: usize, coarseness: f64, random: &mut Random) -> DMatrix<f64> {
    let directions: Vec<[f64; 3]> = (0..=size).map(|_| random.direction()).collect();
    let design = DMatrix::from_fn(size, 3, |i, j| directions[i + 1][j] - directions[0][j]);
    let differencing = DMatrix::from_fn(size, size, |i, j| if i == j { 2.0 } else { 1.0 });
    let weight = differencing.clone().try_inverse().expect("I + 11ᵀ is definite");
    let normal = design.transpose() * weight * &design + DMatrix::identity(3, 3) * 1e-6;
    let real = normal.try_inverse().expect("a ridge makes it definite") * coarseness.powi(2);
    (differencing + &design * real * design.transpose()) * 1e-4
}

/// Best-over-second ratios of the trials whose best integers are wrong, ascending.
fn wrong_ratios(reduction: &Reduction, failure_rate: f64, random: &mut Random) -> Vec<f64> {
    let size = reduction.size();
    let scale = scale_for(reduction.variances(), failure_rate);
    let mut search = Search::with_capacity(size);
    let mut wrong = Vec::new();
    let mut float = vec![0.0; size];
    for _ in 0..TRIALS {
        float.fill(0.0);
        for i in 0..size {
            let noise = scale * reduction.variances()[i].sqrt() * random.normal();
            float.iter_mut().zip(reduction.factor_row(i)).for_each(|(z, l)| *z += l * noise);
        }
        search.run(reduction, &float, 0, SearchLimits { candidates: 2, nodes: 100_000_000 });
        if search.candidate(0).iter().any(|z| *z != 0.0) {
            wrong.push(search.norms()[0] / search.norms()[1]);
        }
    }
    wrong.sort_by(f64::total_cmp);
    wrong
}

/// Standard deviations times this have the wanted bootstrapped failure rate.
fn scale_for(variances: &[f64], failure_rate: f64) -> f64 {
    let (mut low, mut high) = (1e-6_f64, 1e6_f64);
    for _ in 0..80 {
        let middle = (low * high).sqrt();
        let scaled: Vec<f64> = variances.iter().map(|d| d * middle * middle).collect();
        let fails_more = failure_rate < bootstrapped_failure_rate(&scaled);
        if fails_more { high = middle } else { low = middle }
    }
    low
}

/// SplitMix64 (Steele, Lea & Flood 2014).
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }

    fn direction(&mut self) -> [f64; 3] {
        let [x, y, z] = [self.normal(), self.normal(), self.normal()];
        let norm = (x * x + y * y + z * z).sqrt();
        [x / norm, y / norm, z / norm]
    }
}
