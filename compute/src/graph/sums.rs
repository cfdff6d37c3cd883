//! Rows on the same coordinates, summed before they are added to a system.
//!
//! All rows of one kind at a state, such as the ranges measured there, depend on the same few
//! coordinates. Σ w·jjᵀ and Σ w·jr of their Jacobians j are then small and dense, and are added to
//! the state's block once.

use crate::graph::system::{Link, System};

/// Normal equations of rows on the same N coordinates of one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RowSum<const N: usize> {
    /// Σ w·jjᵀ, both triangles.
    matrix: [[f64; N]; N],
    /// Σ w·jr.
    gradient: [f64; N],
}

impl<const N: usize> RowSum<N> {
    /// The sum of no rows.
    pub(crate) const ZERO: Self = Self { matrix: [[0.0; N]; N], gradient: [0.0; N] };

    /// Adds a row with its weight, which [`System::weigh`] returns.
    #[inline]
    pub(crate) fn add(&mut self, residual: f64, jacobian: &[f64; N], weight: f64) {
        let scaled = jacobian.map(|slope| slope * weight);
        for (column, factor) in self.matrix.iter_mut().zip(scaled) {
            for (value, slope) in column.iter_mut().zip(jacobian) {
                *value += factor * slope;
            }
        }
        for (value, factor) in self.gradient.iter_mut().zip(scaled) {
            *value += factor * residual;
        }
    }
}

/// Normal equations of rows on the same N coordinates of one state and M of the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LinkSum<const N: usize, const M: usize> {
    earlier: RowSum<N>,
    later: RowSum<M>,
    /// Σ w·j₊jᵀ with j₊ the later state's Jacobian; indexed by the earlier coordinate first.
    coupling: [[f64; M]; N],
}

impl<const N: usize, const M: usize> LinkSum<N, M> {
    /// The sum of no rows.
    pub(crate) const ZERO: Self =
        Self { earlier: RowSum::ZERO, later: RowSum::ZERO, coupling: [[0.0; M]; N] };

    /// Adds a row with its weight, which [`System::weigh`] returns. Its coordinates must be those
    /// of the other rows.
    #[inline]
    pub(crate) fn add(&mut self, link: &Link<N, M>, weight: f64) {
        self.earlier.add(link.residual, &link.jacobian, weight);
        self.later.add(link.residual, &link.next_jacobian, weight);
        for (column, slope) in self.coupling.iter_mut().zip(link.jacobian) {
            let factor = weight * slope;
            for (value, slope) in column.iter_mut().zip(link.next_jacobian) {
                *value += factor * slope;
            }
        }
    }
}

impl<const N: usize, const M: usize> LinkSum<N, M> {
    /// Eliminates, by its Schur complement, an offset o that enters every row like the later
    /// coordinate `column`. Its prior is zero with σ = 1/√`information`. The rows were added with
    /// their residuals at o = `at`.
    pub(crate) fn free_offset(&mut self, column: usize, at: f64, information: f64) {
        let by_later = self.later.matrix[column];
        let by_earlier: [f64; N] = std::array::from_fn(|i| self.coupling[i][column]);
        let total = by_later[column] + information;
        if total <= 0.0 {
            return;
        }
        let gradient = (self.later.gradient[column] + information * at) / total;
        for i in 0..N {
            let factor = by_earlier[i] / total;
            self.earlier.gradient[i] -= by_earlier[i] * gradient;
            (0..N).for_each(|j| self.earlier.matrix[i][j] -= factor * by_earlier[j]);
            (0..M).for_each(|j| self.coupling[i][j] -= factor * by_later[j]);
        }
        for i in 0..M {
            let factor = by_later[i] / total;
            self.later.gradient[i] -= by_later[i] * gradient;
            (0..M).for_each(|j| self.later.matrix[i][j] -= factor * by_later[j]);
        }
    }
}

impl<const S: usize> System<S> {
    /// Adds summed rows on the coordinates `columns` of state `k`, which are in ascending order
    /// without repetition. Their losses are not added, because [`System::weigh`] already adds them
    /// to the cost.
    #[inline]
    pub(crate) fn add_sum<const N: usize>(
        &mut self,
        k: usize,
        columns: &[usize; N],
        sum: &RowSum<N>,
    ) {
        let block = &mut self.diagonal[k].data.0;
        let gradient = &mut self.gradient[k].data.0[0];
        for j in 0..N {
            gradient[columns[j]] += sum.gradient[j];
            let target = &mut block[columns[j]];
            for i in j..N {
                target[columns[i]] += sum.matrix[j][i];
            }
        }
    }

    /// Adds summed rows on the coordinates `columns` of state `k` and `next` of state `k + 1`;
    /// otherwise like [`System::add_sum`].
    #[inline]
    pub(crate) fn add_link_sum<const N: usize, const M: usize>(
        &mut self,
        k: usize,
        (columns, next): (&[usize; N], &[usize; M]),
        sum: &LinkSum<N, M>,
    ) {
        self.add_sum(k, columns, &sum.earlier);
        self.add_sum(k + 1, next, &sum.later);
        let block = &mut self.coupling[k].data.0;
        for j in 0..N {
            let target = &mut block[columns[j]];
            for i in 0..M {
                target[next[i]] += sum.coupling[j][i];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::kernel::Kernel;
    use crate::graph::system::BorderLife;

    const COLUMNS: ([usize; 2], [usize; 3]) = ([0, 3], [1, 2, 4]);

    fn links() -> [Link<2, 3>; 3] {
        [1.0, -0.5, 3.0].map(|residual: f64| Link {
            residual,
            columns: COLUMNS.0,
            jacobian: [0.3 * residual, -1.1],
            next_columns: COLUMNS.1,
            next_jacobian: [0.7, residual, -0.2],
        })
    }

    /// Compares with the dense normal equations in which the offset is one more unknown; it is 0.4
    /// and has a prior at zero with information 2.
    #[test]
    fn a_free_offset_is_an_unknown_of_the_dense_solve() {
        let (at, information) = (0.4, 2.0);
        let mut sum = LinkSum::ZERO;
        let (mut h, mut g) = (nalgebra::SMatrix::<f64, 6, 6>::zeros(), nalgebra::SVector::zeros());
        for link in links() {
            sum.add(&link, 1.5);
            let [a, b] = link.jacobian;
            let [c, d, e] = link.next_jacobian;
            let row = nalgebra::SVector::<f64, 6>::from([a, b, c, d, e, d]);
            h += row * row.transpose() * 1.5;
            g += row * link.residual * 1.5;
        }
        h[(5, 5)] += information;
        g[5] += information * at;
        sum.free_offset(1, at, information);
        let last = h.column(5).into_owned();
        let reduced = h - last * last.transpose() / last[5];
        let gradient = g - last * (g[5] / last[5]);
        for i in 0..2 {
            assert!((sum.earlier.gradient[i] - gradient[i]).abs() < 1e-12);
            (0..3).for_each(|j| assert!((sum.coupling[i][j] - reduced[(i, 2 + j)]).abs() < 1e-12));
            (0..2)
                .for_each(|j| assert!((sum.earlier.matrix[i][j] - reduced[(i, j)]).abs() < 1e-12));
        }
        for i in 0..3 {
            assert!((sum.later.gradient[i] - gradient[2 + i]).abs() < 1e-12);
            let dense = |j: usize| reduced[(2 + i, 2 + j)];
            (0..3).for_each(|j| assert!((sum.later.matrix[i][j] - dense(j)).abs() < 1e-12));
        }
    }

    /// Rows that are summed first give the same system as rows added one by one.
    #[test]
    fn a_sum_is_its_rows() {
        let kernel = Kernel::cauchy(2.0).scaled(0.5);
        let (mut single, mut summed) =
            (System::<5>::new(BorderLife::WholeChain), System::<5>::new(BorderLife::WholeChain));
        single.reset(2, 0);
        summed.reset(2, 0);
        let mut sum = LinkSum::ZERO;
        for link in links() {
            single.add_link(0, &link, &kernel);
            sum.add(&link, summed.weigh(link.residual, &kernel));
        }
        summed.add_link_sum(0, (&COLUMNS.0, &COLUMNS.1), &sum);
        for k in 0..2 {
            assert!((single.diagonal[k] - summed.diagonal[k]).norm() < 1e-14);
            assert!((single.coupling[k] - summed.coupling[k]).norm() < 1e-14);
            assert!((single.gradient[k] - summed.gradient[k]).norm() < 1e-14);
        }
        assert!(1.0 < single.diagonal[1].norm());
        assert!((single.cost() - summed.cost()).abs() < 1e-14);
    }
}
