//! Oracles for tests: random linear problems solved densely, and Jacobians by central differences.

use nalgebra::{DMatrix, DVector, SVector};

use crate::graph::annealing::Widening;
use crate::graph::estimate::Estimate;
use crate::graph::kernel::Kernel;
use crate::graph::optimizer::Problem;
use crate::graph::system::{Link, Row, System};

/// Asserts that `jacobian` is ∂f/∂x at `x`, to `tolerance` relative to the largest entry.
pub(crate) fn assert_jacobian<const S: usize>(
    f: impl Fn(&SVector<f64, S>) -> f64,
    x: &SVector<f64, S>,
    jacobian: &SVector<f64, S>,
    tolerance: f64,
) {
    for j in 0..S {
        let h = 1e-5 * x[j].abs().max(1.0);
        let (mut above, mut below) = (*x, *x);
        above[j] += h;
        below[j] -= h;
        let slope = (f(&above) - f(&below)) / (2.0 * h);
        let bound = tolerance * jacobian.amax().max(1.0);
        assert!((slope - jacobian[j]).abs() < bound, "∂/∂x{j}: {slope} against {}", jacobian[j]);
    }
}

/// Numbers in [−1, 1) from a linear congruential generator (Knuth's MMIX constants).
pub(crate) struct Numbers(u64);

impl Numbers {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// A linear row r = J·x − measured on state `k`, border variables and, if a link, state `k` + 1.
#[derive(Clone, Debug)]
pub(crate) struct LinearRow {
    pub(crate) k: usize,
    columns: [usize; 2],
    jacobian: [f64; 2],
    next: Option<[f64; 2]>,
    pub(crate) border: Vec<(usize, f64)>,
    measured: f64,
}

impl LinearRow {
    pub(crate) fn is_link(&self) -> bool {
        self.next.is_some()
    }
}

/// A random linear problem: every state observed and linked, border variables of bounded life.
#[derive(Clone, Debug)]
pub(crate) struct Linear<const S: usize> {
    pub(crate) states: usize,
    pub(crate) border: usize,
    pub(crate) rows: Vec<LinearRow>,
}

impl<const S: usize> Linear<S> {
    /// Each border variable is touched by the rows of three states, the first of which is
    /// proportional to its index. No variable is undetermined.
    pub(crate) fn random(seed: u64, states: usize, border: usize) -> Self {
        let mut numbers = Numbers::new(seed);
        let mut rows = Vec::new();
        for k in 0..states {
            for i in 0..2 * S {
                let columns = [i % (S - 1), S - 1];
                rows.push(Self::row(&mut numbers, k, columns));
            }
            for i in 0..S {
                let mut row = Self::row(&mut numbers, k, [i.min(S - 2), S - 1]);
                row.next = Some([numbers.next(), numbers.next()]);
                if k + 1 < states {
                    rows.push(row);
                }
            }
            for b in 0..border {
                let home = b * states / border;
                for _ in 0..if home <= k && k < home + 3 { 3 } else { 0 } {
                    let mut row = Self::row(&mut numbers, k, [0, 1]);
                    row.border.push((b, 1.0 + numbers.next().abs()));
                    if 0 < b && (b - 1) * states / border + 3 > k {
                        row.border.push((b - 1, numbers.next()));
                    }
                    rows.push(row);
                }
            }
        }
        Self { states, border, rows }
    }

    fn row(numbers: &mut Numbers, k: usize, columns: [usize; 2]) -> LinearRow {
        let jacobian = [numbers.next() * 3.0, numbers.next()];
        let measured = numbers.next() * 10.0;
        LinearRow { k, columns, jacobian, next: None, border: Vec::new(), measured }
    }

    /// Last state with a row on a border variable.
    pub(crate) fn last_state_of(&self, variable: usize) -> Option<usize> {
        let names = |row: &&LinearRow| row.border.iter().any(|&(named, _)| named == variable);
        self.rows.iter().filter(names).map(|row| row.k).max()
    }

    pub(crate) fn zero(&self) -> Estimate<S> {
        Estimate { states: vec![SVector::zeros(); self.states], border: vec![0.0; self.border] }
    }

    /// Adds one row to a system whose first state is state `shift` of the problem.
    pub(crate) fn add(
        &self,
        row: &LinearRow,
        shift: usize,
        x: &Estimate<S>,
        system: &mut System<S>,
    ) {
        let k = row.k - shift;
        let LinearRow { columns, jacobian, .. } = *row;
        let at = |k: usize, jacobian: [f64; 2]| -> f64 {
            (0..2).map(|i| jacobian[i] * x.states[k][columns[i]]).sum()
        };
        let border: f64 = row.border.iter().map(|&(b, d)| d * x.border[b]).sum();
        let next = row.next.map_or(0.0, |next| at(k + 1, next));
        let residual = at(k, jacobian) + next + border - row.measured;
        if let Some(next_jacobian) = row.next {
            let link = Link { residual, columns, jacobian, next_columns: columns, next_jacobian };
            system.add_link(k, &link, &Kernel::QUADRATIC);
        } else {
            let own = Row { residual, columns, jacobian };
            system.add_with_border(k, &own, &row.border, &Kernel::QUADRATIC);
        }
    }

    /// Solution and covariance by a dense inverse, states first.
    pub(crate) fn dense(&self) -> (DVector<f64>, DMatrix<f64>) {
        let size = self.states * S + self.border;
        let mut j = DMatrix::zeros(self.rows.len(), size);
        let mut z = DVector::zeros(self.rows.len());
        for (i, row) in self.rows.iter().enumerate() {
            for c in 0..2 {
                j[(i, row.k * S + row.columns[c])] += row.jacobian[c];
                if let Some(next) = row.next {
                    j[(i, (row.k + 1) * S + row.columns[c])] += next[c];
                }
            }
            for &(b, derivative) in &row.border {
                j[(i, self.states * S + b)] += derivative;
            }
            z[i] = row.measured;
        }
        let covariance = (j.transpose() * &j).try_inverse().expect("determined");
        (&covariance * j.transpose() * z, covariance)
    }

    /// Largest difference of any unknown, relative to the largest unknown.
    pub(crate) fn distance(&self, estimate: &Estimate<S>, dense: &DVector<f64>) -> f64 {
        let states = estimate.states.iter().flat_map(|state| state.iter());
        let all = states.chain(&estimate.border);
        let worst = all.zip(dense.iter()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        worst / dense.amax()
    }
}

impl<const S: usize> Problem<S> for Linear<S> {
    fn linearize(&mut self, estimate: &Estimate<S>, _: Widening, system: &mut System<S>) {
        for row in &self.rows {
            self.add(row, 0, estimate, system);
        }
    }
}
