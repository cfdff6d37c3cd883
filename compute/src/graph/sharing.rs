//! Groups of rows with one unknown offset in common, which is eliminated before they are added.
//!
//! rᵢ(x, o) = rᵢ(x) + cᵢ·o, with one offset o for all rows of a group on one state, and no prior on
//! o. The minimum over o is taken inside the group: with ρᵢ = rᵢ/cᵢ, aᵢ = ∂ρᵢ/∂x,
//! vᵢ = wᵢcᵢ², V = Σ vᵢ and the means ā and ρ̄ weighted by vᵢ,
//!
//! H = Σ vᵢ·(aᵢ − ā)(aᵢ − ā)ᵀ = Σ vᵢ·aᵢaᵢᵀ − (Σ vᵢaᵢ)(Σ vᵢaᵢ)ᵀ/V, g = Σ vᵢ·aᵢ·(ρᵢ − ρ̄)
//!
//! Differences against any one row of the group, with their full covariance, give the same: both
//! project the rows on the complement of the offset.
//!
//! The mean of a state's column is subtracted before the products are formed, so that rounding
//! errors stay small if all rows have nearly the same entry. This is not necessary for the columns
//! of border variables, because only one row of the group touches each of them.

use std::array;

use crate::graph::kernel::{Kernel, Law};
use crate::graph::median::median;
use crate::graph::system::{Row, System};

/// Iterations for the offset under a robust kernel; it starts at the median.
const OFFSET_ITERATIONS: usize = 4;

/// A whitened row on one state, the offset of its group and at most one border variable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SharingRow<const N: usize> {
    /// The row at offset zero; all rows of a group have the same columns.
    pub row: Row<N>,
    /// c = ∂r/∂o, above zero.
    pub by_offset: f64,
    /// A border variable that no other row of the group touches, with ∂r/∂b.
    pub border: Option<(usize, f64)>,
    /// Fraction of its information that the row keeps: the [`Kernel::factor`] of its kernel.
    pub independent_share: f64,
}

/// The offset o that minimises Σ ρ(rᵢ + cᵢ·o), by iterations that begin at the median of −rᵢ/cᵢ.
/// Zero without rows.
pub(crate) fn shared_offset<const N: usize>(
    rows: &[SharingRow<N>],
    kernel: &Kernel,
    scratch: &mut Vec<f64>,
) -> f64 {
    if rows.is_empty() {
        return 0.0;
    }
    let mut offset = 0.0;
    let mut iterations = 1;
    if kernel.law != Law::Quadratic {
        scratch.clear();
        scratch.extend(rows.iter().map(|row| -row.row.residual / row.by_offset));
        offset = median(scratch).unwrap_or(0.0);
        iterations = OFFSET_ITERATIONS;
    }
    for _ in 0..iterations {
        let (mut weight_sum, mut pull) = (0.0, 0.0);
        for row in rows {
            let weight =
                row.independent_share * kernel.weight(row.row.residual + row.by_offset * offset);
            weight_sum += weight * row.by_offset * row.by_offset;
            pull += weight * row.by_offset * row.row.residual;
        }
        if weight_sum <= 0.0 {
            break;
        }
        let before = std::mem::replace(&mut offset, -pull / weight_sum);
        if offset == before {
            break;
        }
    }
    offset
}

impl<const S: usize> System<S> {
    /// Adds a group of rows on state `k` with an unknown offset in common; returns the offset.
    ///
    /// A single row adds nothing: the offset explains all of it.
    pub(crate) fn add_sharing_offset<const N: usize>(
        &mut self,
        k: usize,
        rows: &[SharingRow<N>],
        kernel: &Kernel,
    ) -> f64 {
        let mut scratch = std::mem::take(&mut self.scratch);
        let offset = shared_offset(rows, kernel, &mut scratch);
        scratch.clear();
        let (mut total, mut mean) = (0.0, [0.0; N]);
        let mut mean_residual = 0.0;
        for row in rows {
            let shifted = row.row.residual + row.by_offset * offset;
            let (loss, weight) = kernel.scaled(row.independent_share).loss_and_weight(shifted);
            self.add_cost(loss);
            let scaled = weight * row.by_offset;
            scratch.push(scaled * row.by_offset);
            total += scaled * row.by_offset;
            mean_residual += scaled * shifted;
            for (sum, entry) in mean.iter_mut().zip(row.row.jacobian) {
                *sum += scaled * entry;
            }
        }
        if 0.0 < total {
            mean.iter_mut().for_each(|sum| *sum /= total);
            mean_residual /= total;
            let mut products = Products::zero();
            for (row, &v) in rows.iter().zip(&scratch) {
                let unit = row.by_offset.recip();
                let shifted = (row.row.residual * unit + offset) - mean_residual;
                products.add(array::from_fn(|i| row.row.jacobian[i] * unit - mean[i]), shifted, v);
            }
            self.add_products(k, &rows[0].row.columns, &products);
            self.add_group_border(k, rows, &mut scratch, &mean, offset - mean_residual, total);
        }
        self.scratch = scratch;
        offset
    }

    fn add_products<const N: usize>(
        &mut self,
        k: usize,
        columns: &[usize; N],
        products: &Products<N>,
    ) {
        let block = &mut self.diagonal[k].data.0;
        let gradient = &mut self.gradient[k].data.0[0];
        for (j, &column) in columns.iter().enumerate() {
            gradient[column] += products.gradient[j];
            for (i, &row) in columns.iter().enumerate().skip(j) {
                block[column][row] += products.matrix[j][i];
            }
        }
    }

    /// Adds the border part of a group: with p = v·∂ρ/∂b of each row, the border's matrix gains
    /// diag(p·∂ρ/∂b) − p·pᵀ/V. Overwrites `weights`, the weight v of each row.
    fn add_group_border<const N: usize>(
        &mut self,
        k: usize,
        rows: &[SharingRow<N>],
        weights: &mut Vec<f64>,
        mean: &[f64; N],
        offset: f64,
        total: f64,
    ) {
        if let [only] = rows {
            // The offset explains all of it, and rounding must leave nothing.
            only.border.iter().for_each(|&(variable, _)| _ = self.touch(k, variable));
            return;
        }
        let inverse_root = total.sqrt().recip();
        let bordered = rows.iter().zip(weights.iter_mut());
        let bordered = bordered.filter_map(|(row, weight)| Some((row, row.border?, weight)));
        let mut count = 0;
        for (row, (variable, derivative), weight) in bordered {
            let position = self.touch(k, variable);
            let unit = row.by_offset.recip();
            let slope = derivative * unit;
            let pull = *weight * slope;
            let touched = &mut self.touched[k];
            touched.coupled |= 0 < count;
            touched.gradient[position] += pull * (row.row.residual * unit + offset);
            let column = &mut touched.columns[position];
            for n in 0..N {
                column[row.row.columns[n]] += pull * (row.row.jacobian[n] * unit - mean[n]);
            }
            *touched.matrix.get_mut(position, position) += pull * slope;
            *weight = pull * inverse_root;
            count += 1;
        }
        if count == 0 {
            return;
        }
        weights.resize(rows.len() + self.touched[k].variables.len(), 0.0);
        let (pulls, by_position) = weights.split_at_mut(rows.len());
        for (row, pull) in rows.iter().zip(pulls) {
            let Some((variable, _)) = row.border else { continue };
            by_position[self.lives[variable].position()] = *pull;
        }
        self.touched[k].matrix.subtract_square(by_position);
    }
}

/// Σ v·aaᵀ and Σ v·ρa of a group of rows.
struct Products<const N: usize> {
    gradient: [f64; N],
    /// The upper triangle.
    matrix: [[f64; N]; N],
}

impl<const N: usize> Products<N> {
    const fn zero() -> Self {
        Self { gradient: [0.0; N], matrix: [[0.0; N]; N] }
    }

    #[inline]
    fn add(&mut self, a: [f64; N], residual: f64, weight: f64) {
        for (j, column) in self.matrix.iter_mut().enumerate() {
            let scaled = weight * a[j];
            self.gradient[j] += scaled * residual;
            let below = column.iter_mut().zip(&a).skip(j);
            below.for_each(|(sum, other)| *sum += scaled * other);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::elimination::Elimination;
    use crate::graph::estimate::Estimate;
    use crate::graph::system::BorderLife;
    use nalgebra::{DMatrix, DVector, Vector2};

    fn rows() -> Vec<SharingRow<2>> {
        let numbers = [
            (0.3, [1.0, -0.4], 2.0, Some((0, 0.7))),
            (-1.1, [0.2, 0.9], 1.0, Some((1, -0.2))),
            (0.8, [-0.6, 0.1], 0.5, None),
            (2.0, [0.5, 0.5], 4.0, Some((2, 1.5))),
        ];
        numbers
            .map(|(residual, jacobian, by_offset, border)| SharingRow {
                row: Row { residual, columns: [0, 1], jacobian },
                by_offset,
                border,
                independent_share: 1.0,
            })
            .to_vec()
    }

    /// Normal equations over (x, b₀ … b₂) of rows that carry o as one more unknown, o eliminated
    /// densely: H − hhᵀ/V.
    fn dense(rows: &[SharingRow<2>]) -> (DMatrix<f64>, DVector<f64>) {
        let mut h = DMatrix::zeros(6, 6);
        let mut g = DVector::zeros(6);
        for row in rows {
            let mut a = DVector::zeros(6);
            (a[0], a[1], a[5]) = (row.row.jacobian[0], row.row.jacobian[1], row.by_offset);
            if let Some((variable, derivative)) = row.border {
                a[2 + variable] = derivative;
            }
            h += row.independent_share * &a * a.transpose();
            g += row.independent_share * &a * row.row.residual;
        }
        let last = h.column(5).into_owned();
        let reduced = &h - &last * last.transpose() / last[5];
        let gradient = &g - &last * (g[5] / last[5]);
        (reduced.view((0, 0), (5, 5)).into_owned(), gradient.rows(0, 5).into_owned())
    }

    /// A prior of unit information on every variable makes both systems solvable.
    fn solve(add: impl FnOnce(&mut System<2>)) -> Estimate<2> {
        let mut system = System::new(BorderLife::WholeChain);
        system.reset(1, 3);
        for column in 0..2 {
            let unit = Row { residual: 0.0, columns: [column], jacobian: [1.0] };
            system.add(0, &unit, &Kernel::QUADRATIC);
        }
        for variable in 0..3 {
            let none = Row { residual: 0.0, columns: [], jacobian: [] };
            system.add_with_border(0, &none, &[(variable, 1.0)], &Kernel::QUADRATIC);
        }
        add(&mut system);
        let (mut elimination, mut delta) = (Elimination::new(), Estimate::new());
        elimination.factor(&system, 0.0).unwrap();
        elimination.solve(&mut delta);
        delta
    }

    #[test]
    fn an_eliminated_offset_is_an_unknown_of_the_dense_solve() {
        let mut rows = rows();
        rows[1].independent_share = 0.3;
        let (h, g) = dense(&rows);
        let expected = (h + DMatrix::identity(5, 5)).cholesky().unwrap().solve(&-g);
        let delta = solve(|system| {
            system.add_sharing_offset(0, &rows, &Kernel::QUADRATIC);
        });
        let found = [delta.states[0].x, delta.states[0].y];
        for (value, wanted) in found.iter().chain(&delta.border).zip(expected.iter()) {
            assert!((value - wanted).abs() < 1e-12, "{value} {wanted}");
        }
    }

    /// A constant on all rows, in units of the offset, changes nothing, even a very large one.
    #[test]
    fn a_common_shift_changes_nothing() {
        let shifted = |by: f64| {
            let mut rows = rows();
            rows.iter_mut().for_each(|row| row.row.residual += by * row.by_offset);
            solve(|system| {
                let offset = system.add_sharing_offset(0, &rows, &Kernel::huber(1.345));
                assert!((offset + by).abs() < 2.0);
            })
        };
        let (near, far) = (shifted(0.0), shifted(1e4));
        assert!((near.states[0] - far.states[0]).norm() < 1e-10);
    }

    #[test]
    fn a_single_row_says_nothing() {
        let delta = solve(|system| {
            system.add_sharing_offset(0, &rows()[..1], &Kernel::QUADRATIC);
        });
        assert_eq!(delta.states[0], Vector2::zeros());
        assert_eq!(delta.border, [0.0; 3]);
    }

    /// Median 1, and a gross error that a redescending kernel ignores.
    #[test]
    fn the_offset_is_robust() {
        let at = |residual: f64| SharingRow {
            row: Row { residual, columns: [], jacobian: [] },
            by_offset: 1.0,
            border: None,
            independent_share: 1.0,
        };
        let rows = [-0.9, -1.0, -1.1, -50.0].map(at);
        let offset = shared_offset(&rows, &Kernel::geman_mcclure(3.0), &mut Vec::new());
        assert!((offset - 1.0).abs() < 1e-3, "{offset}");
        let mean = shared_offset(&rows, &Kernel::QUADRATIC, &mut Vec::new());
        assert!((mean - 13.25).abs() < 1e-12, "{mean}");
    }
}
