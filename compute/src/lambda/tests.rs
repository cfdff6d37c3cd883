//! Properties of the whole module: agreement with brute force, unimodularity, calibration, bounds.

use nalgebra::DMatrix;
use nalgebra::DVector;
use proptest::prelude::*;

use crate::lambda::reduction::Reduction;
use crate::lambda::search::{Search, SearchLimits};
use crate::lambda::success::bootstrapped_success_rate;
use crate::lambda::*;

/// SplitMix64, for reproducible floats and covariances.
pub(super) struct Random(pub(super) u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn matrix(&mut self, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| self.normal())
    }

    /// A strongly correlated covariance: that of differences of unit noise, which depend on three
    /// common real parameters of standard deviation `coarseness`; all scaled by `sigma`.
    pub(super) fn covariance(&mut self, size: usize, sigma: f64, coarseness: f64) -> DMatrix<f64> {
        let design = self.matrix(size, 3) * coarseness;
        (DMatrix::from_fn(size, size, |i, j| if i == j { 2.0 } else { 1.0 })
            + &design * design.transpose())
            * sigma.powi(2)
    }

    /// The same, scaled to a bootstrapped failure rate.
    fn failing(&mut self, size: usize, coarseness: f64, failure_rate: f64) -> DMatrix<f64> {
        let covariance = self.covariance(size, 1.0, coarseness);
        let reduction = reduced(&covariance);
        let (mut low, mut high) = (1e-12_f64, 1e3_f64);
        for _ in 0..80 {
            let middle = (low * high).sqrt();
            let variances: Vec<f64> = reduction.variances().iter().map(|d| d * middle).collect();
            let fails_more = failure_rate < 1.0 - bootstrapped_success_rate(&variances);
            if fails_more { high = middle } else { low = middle }
        }
        covariance * low
    }

    /// A float of this covariance around zero.
    pub(super) fn float(&mut self, covariance: &DMatrix<f64>) -> Vec<f64> {
        let factor = covariance.clone().cholesky().expect("made definite").unpack();
        (factor * DVector::from_fn(covariance.nrows(), |_, _| self.normal())).as_slice().to_vec()
    }
}

fn reduced(covariance: &DMatrix<f64>) -> Reduction {
    let mut reduction = Reduction::with_capacity(covariance.nrows());
    let zeros = std::iter::repeat_n(0.0, covariance.nrows());
    reduction.reduce(zeros, covariance.iter().copied()).expect("made definite");
    reduction
}

pub(super) fn options() -> Options {
    Options {
        success_rate_min: 0.0,
        ratio_min: 1.0,
        probability_min: 0.0,
        scale: None,
        fixed_min: 1,
        candidates: 2,
        nodes_max: 200_000,
        attempts_max: 100,
    }
}

pub(super) fn squared_norm(float: &[f64], integers: &[f64], covariance: &DMatrix<f64>) -> f64 {
    let off = DVector::from_fn(float.len(), |i, _| float[i] - integers[i]);
    off.dot(&covariance.clone().cholesky().expect("definite").solve(&off))
}

/// The two least squared norms over the cube of integers `reach` around the rounded float.
fn brute_force(float: &[f64], covariance: &DMatrix<f64>, reach: i64) -> (Vec<f64>, [f64; 2]) {
    let (mut best, mut norms) = (Vec::new(), [f64::INFINITY; 2]);
    let inverse = covariance.clone().try_inverse().expect("definite");
    let width = 2 * reach + 1;
    for code in 0..width.pow(float.len() as u32) {
        let digit = |i: usize| (code / width.pow(i as u32) % width - reach) as f64;
        let z: Vec<f64> = float.iter().enumerate().map(|(i, a)| a.round() + digit(i)).collect();
        let off = DVector::from_fn(float.len(), |i, _| float[i] - z[i]);
        let norm = off.dot(&(&inverse * &off));
        if norm < norms[0] {
            (best, norms) = (z, [norm, norms[0]]);
        } else if norm < norms[1] {
            norms[1] = norm;
        }
    }
    (best, norms)
}

/// Halves go to the even neighbour; above 2⁵⁰ they go away from zero.
#[test]
fn the_nearest_integer_worked_by_hand() {
    let cases = [(0.5, 0.0), (1.5, 2.0), (-2.5, -2.0), (-0.6, -1.0), (7.0, 7.0), (1e9 + 0.4, 1e9)];
    for (value, integer) in cases {
        assert_eq!(nearest(value), integer);
    }
    let large = 2_f64.powi(51);
    assert_eq!((nearest(large + 0.5), nearest(-large)), (large + 1.0, -large));
}

/// A much used 3×3 example, its answer checked by enumerating 29 791 integer vectors.
#[test]
fn three_by_three_example() {
    let float = [5.450, 3.100, 2.970];
    let covariance = DMatrix::from_row_slice(
        3,
        3,
        &[6.290, 5.978, 0.544, 5.978, 6.292, 2.340, 0.544, 2.340, 6.288],
    );
    let (best, norms) = brute_force(&float, &covariance, 15);
    assert_eq!(best, [5.0, 3.0, 4.0]);
    assert!((norms[0] - 0.2183).abs() < 5e-5 && (norms[1] - 0.3073).abs() < 5e-5);

    let mut resolver = Resolver::with_capacity(3);
    let outcome = resolver.resolve(&float, &covariance, Partial::None, &options()).unwrap();
    assert_eq!(resolver.fix().entries(), [Some(5), Some(3), Some(4)]);
    assert!((outcome.squared_norm.unwrap() - norms[0]).abs() < 1e-9);
    assert!((outcome.ratio.unwrap() - norms[1] / norms[0]).abs() < 1e-9);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Best and second best are those of enumeration, if the cube contains the ellipsoid.
    #[test]
    fn equals_brute_force(seed in any::<u64>(), size in 1_usize..=4) {
        let mut random = Random(seed);
        let root = random.matrix(size, size) * 0.5;
        let covariance = &root * root.transpose() + DMatrix::identity(size, size) * 0.02;
        let float: Vec<f64> = (0..size).map(|_| 5.0 * random.normal()).collect();
        let reach = if size < 4 { 12 } else { 7 };
        let (best, norms) = brute_force(&float, &covariance, reach);
        let widest = (0..size).map(|i| covariance[(i, i)]).fold(0.0, f64::max);
        prop_assume!((norms[1] * widest).sqrt() + 0.5 < reach as f64);
        let mut resolver = Resolver::with_capacity(size);
        let outcome = resolver.resolve(&float, &covariance, Partial::None, &options()).unwrap();
        let found: Vec<f64> =
            resolver.fix().entries().iter().map(|z| z.expect("all are fixed") as f64).collect();
        prop_assert_eq!(found, best);
        prop_assert!((outcome.squared_norm.unwrap() - norms[0]).abs() < 1e-6 * (1.0 + norms[0]));
        let ratio = norms[1] / norms[0];
        prop_assert!((outcome.ratio.unwrap() / ratio - 1.0).abs() < 1e-6);
    }

    /// Z and Z⁻ᵀ are integer and inverse to each other, hence det ±1; ZᵀQZ = LᵀDL; |l_ij| ≤ ½.
    #[test]
    fn decorrelation_is_unimodular(seed in any::<u64>(), size in 1_usize..=25) {
        let covariance = Random(seed).covariance(size, 0.1, 50.0);
        let reduction = reduced(&covariance);
        let unit = |j: usize| (0..size).map(|i| f64::from(u8::from(i == j))).collect::<Vec<_>>();
        let rows = (0..size).map(|j| {
            let mut values = unit(j);
            assert!(reduction.transform(&mut values));
            DVector::from_vec(values).transpose()
        });
        let z = DMatrix::from_rows(&rows.collect::<Vec<_>>());
        let columns = (0..size).map(|j| {
            let mut integers = unit(j);
            assert!(reduction.restore(&mut integers));
            DVector::from_vec(integers)
        });
        let back = DMatrix::from_columns(&columns.collect::<Vec<_>>());
        prop_assert!(z.iter().chain(back.iter()).all(|entry| entry.fract() == 0.0));
        prop_assert_eq!(z.transpose() * back, DMatrix::identity(size, size));
        let lower = DMatrix::from_fn(size, size, |i, j| {
            if j <= i { reduction.factor_row(i)[j] } else { 0.0 }
        });
        let d = DMatrix::from_diagonal(&DVector::from_column_slice(reduction.variances()));
        let wanted = z.transpose() * &covariance * &z;
        let scale = covariance.amax() * z.amax().powi(2);
        prop_assert!((lower.transpose() * d * &lower - wanted).amax() < 1e-12 * scale);
        prop_assert!((0..size).all(|i| lower.row(i).iter().take(i).all(|l| l.abs() <= 0.5 + 1e-9)));
    }

    /// Entries left out one after another: what is left has the squared norms, the determinant and
    /// the integers of a decorrelation of the remaining entries alone.
    #[test]
    fn leaving_out_is_a_new_decorrelation(seed in any::<u64>(), size in 3_usize..=16) {
        let mut random = Random(seed);
        let covariance = random.covariance(size, 0.05, 30.0);
        let float = random.float(&covariance);
        let mut updated = Reduction::with_capacity(size);
        updated.reduce(float.iter().copied(), covariance.iter().copied()).unwrap();
        let mut kept: Vec<usize> = (0..size).collect();
        let mut searches = [Search::with_capacity(size), Search::with_capacity(size)];
        for _ in 1..size {
            let out = kept.remove(random.0 as usize % kept.len());
            let mut weights: Vec<f64> = (0..size).map(|i| f64::from(u8::from(i == out))).collect();
            updated.leave_out(&mut weights).unwrap();
            let entries = kept.iter().flat_map(|&j| kept.iter().map(move |&i| (i, j)));
            let mut anew = Reduction::with_capacity(size);
            let floats = kept.iter().map(|&i| float[i]);
            anew.reduce(floats, entries.map(|at| covariance[at])).unwrap();
            prop_assert_eq!(updated.size(), kept.len());
            let log = |of: &Reduction| of.variances().iter().map(|d| d.ln()).sum::<f64>();
            prop_assert!((log(&updated) - log(&anew)).abs() < 1e-6);
            for (search, reduction) in searches.iter_mut().zip([&updated, &anew]) {
                search.run(reduction, SearchLimits { candidates: 2, nodes: 200_000 });
            }
            let [own, other] = [searches[0].norms(), searches[1].norms()];
            for (a, b) in own.iter().zip(other) {
                prop_assert!((a - b).abs() < 1e-6 * (1.0 + b), "{own:?} {other:?}");
            }
            let mut integers = searches[0].candidate(0).to_vec();
            prop_assert!(updated.restore(&mut integers));
            let mut directly = searches[1].candidate(0).to_vec();
            prop_assert!(anew.restore(&mut directly));
            prop_assume!(own[0] * 1.001 < own[1]);
            let wanted: Vec<f64> = kept.iter().map(|&i| integers[i]).collect();
            prop_assert_eq!(wanted, directly);
        }
    }

    /// Shifting the float by integers shifts the answer by the same, at 10⁸ too.
    #[test]
    fn integers_shift_with_the_float(seed in any::<u64>(), size in 1_usize..=12) {
        let mut random = Random(seed);
        let covariance = random.covariance(size, 0.05, 20.0);
        let float = random.float(&covariance);
        let shift: Vec<f64> = (0..size).map(|_| (1e8 * random.normal()).round()).collect();
        let moved: Vec<f64> = float.iter().zip(&shift).map(|(a, s)| a + s).collect();
        let mut resolver = Resolver::with_capacity(size);
        let first = resolver.resolve(&float, &covariance, Partial::None, &options()).unwrap();
        let near: Vec<_> = resolver.fix().entries().iter().map(|z| z.unwrap()).collect();
        prop_assume!(first.ratio.unwrap() > 1.01);
        resolver.resolve(&moved, &covariance, Partial::None, &options()).unwrap();
        let far: Vec<_> = resolver.fix().entries().iter().map(|z| z.unwrap()).collect();
        let back: Vec<_> = far.iter().zip(&shift).map(|(z, s)| z - *s as i64).collect();
        prop_assert_eq!(near, back);
    }

    /// A partial fix leaves out the two weak entries, and its integers are the true ones.
    #[test]
    fn partial_fixes_are_true(seed in any::<u64>()) {
        let mut random = Random(seed);
        let size = 8;
        let mut covariance = random.covariance(size, 0.001, 20.0);
        (0..2).for_each(|i| covariance[(i, i)] += 1.0);
        let float = random.float(&covariance);
        let strict = Options { success_rate_min: 0.999, ..options() };
        let mut resolver = Resolver::with_capacity(size);
        let order = Partial::Ordered(&[1, 0]);
        let outcome = resolver.resolve(&float, &covariance, order, &strict).unwrap();
        prop_assert_eq!((outcome.rejection, outcome.size), (None, 6));
        prop_assert_eq!(resolver.fix().entries(), [&[None; 2][..], &[Some(0); 6]].concat());
    }
}

/// Bootstrapping of 20 000 floats succeeds at the stated rate; integer least squares at no lower
/// rate.
#[test]
fn success_rate_matches_monte_carlo() {
    let mut random = Random(7);
    let covariance = random.failing(6, 30.0, 0.3);
    let mut reduction = reduced(&covariance);
    let expected = bootstrapped_success_rate(reduction.variances());
    assert!((expected - 0.7).abs() < 1e-6);
    let mut search = Search::with_capacity(6);
    let (mut bootstrapped, mut least_squares) = (0, 0);
    let trials = 20_000;
    for _ in 0..trials {
        let float = random.float(&covariance);
        reduction.reduce(float.into_iter(), covariance.iter().copied()).expect("made definite");
        // The first candidate of a search of one leaf is the bootstrapped one.
        search.run(&reduction, SearchLimits { candidates: 1, nodes: 6 });
        bootstrapped += usize::from(search.candidate(0).iter().all(|i| *i == 0.0));
        search.run(&reduction, SearchLimits { candidates: 1, nodes: 100_000 });
        least_squares += usize::from(search.candidate(0).iter().all(|i| *i == 0.0));
    }
    // 3σ of a binomial rate: 1.1 %.
    let rate = bootstrapped as f64 / f64::from(trials);
    assert!((rate - expected).abs() < 0.011, "{rate} against {expected}");
    assert!(bootstrapped <= least_squares);
}

/// Integers with the posterior p are right in a fraction p of the cases, within 3σ and 1 %.
#[test]
fn posterior_is_calibrated() {
    let mut random = Random(11);
    for failure_rate in [0.05, 0.2, 0.5] {
        let covariance = random.failing(8, 30.0, failure_rate);
        let eight = Options { candidates: 8, ..options() };
        let mut resolver = Resolver::with_capacity(8);
        let (mut said, mut right) = (0.0, 0.0);
        let trials = 4000;
        for _ in 0..trials {
            let float = random.float(&covariance);
            let outcome = resolver.resolve(&float, &covariance, Partial::None, &eight).unwrap();
            said += outcome.probability.unwrap();
            right += f64::from(resolver.fix().entries().iter().all(|z| *z == Some(0)));
        }
        let off = (said - right) / f64::from(trials);
        assert!(off.abs() < 0.034, "{failure_rate}: said {said}, right {right} of {trials}");
    }
}

#[test]
fn bad_covariances_are_typed_errors() {
    let mut resolver = Resolver::with_capacity(3);
    let mut resolve =
        |q: &DMatrix<f64>| resolver.resolve(&[0.1, 0.2], q, Partial::None, &options());
    let indefinite = DMatrix::from_row_slice(2, 2, &[1.0, 2.0, 2.0, 1.0]);
    assert_eq!(
        resolve(&indefinite),
        Err(LambdaError::NotPositiveDefinite { index: 1, pivot: -3.0 })
    );
    for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        let q = DMatrix::from_diagonal_element(2, 2, bad);
        assert!(matches!(resolve(&q), Err(LambdaError::NotPositiveDefinite { .. })), "{bad}");
    }
    let dimension = LambdaError::Dimension { what: "covariance", actual: 3, expected: 2 };
    assert_eq!(resolve(&DMatrix::identity(3, 3)), Err(dimension));
    let identity = DMatrix::identity(1, 1);
    let far = resolver.resolve(&[1e16], &identity, Partial::None, &options());
    assert_eq!(far, Err(LambdaError::Float { index: 0, value: 1e16 }));
    let empty = resolver.resolve(&[], &DMatrix::zeros(0, 0), Partial::None, &options());
    assert_eq!(empty, Err(LambdaError::Empty));
    let twice = resolver.resolve(&[0.0], &identity, Partial::Ordered(&[0, 0]), &options());
    assert_eq!(twice, Err(LambdaError::Index { index: 0, size: 1 }));
}

/// All halves: every integer vertex ties. The search stops at its limit, with the count.
#[test]
fn search_stops_at_its_limit() {
    let mut resolver = Resolver::with_capacity(100);
    let limited = Options { nodes_max: 20_000, ..options() };
    let covariance = DMatrix::identity(100, 100);
    let outcome = resolver.resolve(&[0.5; 100], &covariance, Partial::None, &limited).unwrap();
    assert_eq!((outcome.rejection, outcome.nodes), (Some(Rejection::SearchLimit), 10_000));
    let order: Vec<usize> = (0..100).collect();
    let order = Partial::Ordered(&order);
    let outcome = resolver.resolve(&[0.5; 100], &covariance, order, &limited).unwrap();
    assert!(outcome.rejection.is_some() && 1 < outcome.attempts && outcome.nodes <= 20_000);
    assert!(resolver.fix().entries().iter().all(Option::is_none));
}

/// Condition numbers up to 10¹⁶ end in an answer or a typed error, within the node limit.
#[test]
fn badly_conditioned_covariances_end() {
    let mut random = Random(5);
    let mut resolver = Resolver::with_capacity(100);
    let limited = Options { nodes_max: 20_000, success_rate_min: 0.99, ..options() };
    let mut answered = 0;
    for exponent in 0..9 {
        let covariance = random.covariance(100, 0.05, 10_f64.powi(exponent));
        let float: Vec<f64> = (0..100).map(|_| 1e4 * random.normal()).collect();
        if let Ok(outcome) = resolver.resolve(&float, &covariance, Partial::None, &limited) {
            assert!(outcome.nodes <= 20_000);
            answered += 1;
        }
    }
    assert!(5 <= answered, "only {answered} of 9 answered");
}

/// The restored integers have the squared norm that the search reports.
#[test]
fn stated_norm_is_that_of_the_integers() {
    let mut random = Random(17);
    let covariance = random.covariance(12, 0.2, 40.0);
    let float = random.float(&covariance);
    let mut resolver = Resolver::with_capacity(12);
    let outcome = resolver.resolve(&float, &covariance, Partial::None, &options()).unwrap();
    let integers: Vec<f64> = resolver.fix().entries().iter().map(|z| z.unwrap() as f64).collect();
    let norm = squared_norm(&float, &integers, &covariance);
    assert!((outcome.squared_norm.unwrap() / norm - 1.0).abs() < 1e-6);
}
