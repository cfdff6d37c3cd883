//! Linear algebra on blocks of fixed size: Cholesky factor, triangular solves and products, S×S.
//!
//! Of a symmetric block only the lower triangle is read. Columns are contiguous, so every inner
//! loop runs down a column. Loops over `0..S` have constant bounds.

use nalgebra::{SMatrix, SVector};

/// Smallest pivot that counts as information, relative to its diagonal entry before elimination: a
/// smaller one may consist of rounding errors only.
pub(crate) const PIVOT_FLOOR: f64 = 64.0 * f64::EPSILON;

/// What to do at a pivot that is not above its floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rank {
    /// Return an error: the solution would not be unique.
    Full,
    /// Skip it: in a semidefinite matrix the column of a zero pivot is zero.
    Deficient,
}

/// A pivot that is not above its floor, or not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BadPivot {
    pub(crate) index: usize,
    pub(crate) pivot: f64,
}

/// Lower Cholesky factor and the reciprocals of its diagonal, which are zero at skipped pivots.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Factor<const S: usize> {
    pub(crate) lower: SMatrix<f64, S, S>,
    pub(crate) reciprocal: SVector<f64, S>,
}

impl<const S: usize> Factor<S> {
    /// Replaces the block in `lower` by its Cholesky factor.
    ///
    /// # Errors
    /// Pivot j is not above `floor[j]` or not finite. With [`Rank::Deficient`] such a pivot is
    /// skipped unless it is NaN.
    #[inline]
    pub(crate) fn factor(&mut self, floor: &SVector<f64, S>, rank: Rank) -> Result<(), BadPivot> {
        let a = &mut self.lower.data.0;
        for j in 0..S {
            let pivot = a[j][j];
            let positive = floor[j] < pivot && pivot.is_finite();
            if !positive && (rank == Rank::Full || pivot.is_nan()) {
                return Err(BadPivot { index: j, pivot });
            }
            let reciprocal = if positive { 1.0 / pivot.sqrt() } else { 0.0 };
            self.reciprocal[j] = reciprocal;
            let mut column = a[j];
            for value in &mut column {
                *value *= reciprocal;
            }
            a[j] = column;
            for k in j + 1..S {
                subtract_column(k, &mut a[k], &column, column[k]);
            }
        }
        Ok(())
    }

    /// L⁻¹·v.
    #[inline]
    pub(crate) fn solve_lower(&self, v: &SVector<f64, S>) -> SVector<f64, S> {
        let mut x = *v;
        for j in 0..S {
            let value = x[j] * self.reciprocal[j];
            let column = &self.lower.data.0[j];
            for i in j + 1..S {
                x[i] -= column[i] * value;
            }
            x[j] = value;
        }
        x
    }

    /// L⁻ᵀ·v.
    #[inline]
    pub(crate) fn solve_upper(&self, v: &SVector<f64, S>) -> SVector<f64, S> {
        let mut x = *v;
        for j in (0..S).rev() {
            let column = &self.lower.data.0[j];
            let mut value = x[j];
            for i in j + 1..S {
                value -= column[i] * x[i];
            }
            x[j] = value * self.reciprocal[j];
        }
        x
    }

    /// G ← G·L⁻ᵀ.
    #[inline]
    pub(crate) fn solve_right(&self, g: &mut SMatrix<f64, S, S>) {
        for j in 0..S {
            let mut column = g.data.0[j];
            for i in 0..j {
                let factor = self.lower.data.0[i][j];
                let done = &g.data.0[i];
                for r in 0..S {
                    column[r] -= done[r] * factor;
                }
            }
            for value in &mut column {
                *value *= self.reciprocal[j];
            }
            g.data.0[j] = column;
        }
    }

    /// (L·Lᵀ)⁻¹, both triangles.
    pub(crate) fn inverse(&self) -> SMatrix<f64, S, S> {
        let mut inverse = SMatrix::<f64, S, S>::zeros();
        for j in 0..S {
            let mut unit = SVector::<f64, S>::zeros();
            unit[j] = 1.0;
            inverse.set_column(j, &self.solve_upper(&self.solve_lower(&unit)));
        }
        inverse
    }
}

/// D ← D − G·Gᵀ, of which the lower triangle is correct.
#[inline]
pub(crate) fn subtract_square<const S: usize>(d: &mut SMatrix<f64, S, S>, g: &SMatrix<f64, S, S>) {
    for c in 0..S {
        let mut column = d.data.0[c];
        for source in &g.data.0 {
            subtract_column(c, &mut column, source, source[c]);
        }
        d.data.0[c] = column;
    }
}

/// Subtracts `factor`·`source` from column `c` of a lower triangle. In the right half of the
/// columns the upper half of the rows is skipped: a constant bound, so that the loop vectorises.
#[inline(always)]
fn subtract_column<const S: usize>(
    c: usize,
    column: &mut [f64; S],
    source: &[f64; S],
    factor: f64,
) {
    if c < S / 2 {
        for r in 0..S {
            column[r] -= source[r] * factor;
        }
    } else {
        for r in S / 2..S {
            column[r] -= source[r] * factor;
        }
    }
}

/// v ← v − G·w.
#[inline]
pub(crate) fn subtract_product<const S: usize>(
    v: &mut SVector<f64, S>,
    g: &SMatrix<f64, S, S>,
    w: &SVector<f64, S>,
) {
    for j in 0..S {
        let (source, factor) = (&g.data.0[j], w[j]);
        for r in 0..S {
            v[r] -= source[r] * factor;
        }
    }
}

/// The symmetric matrix of which `lower` is the lower triangle.
pub(crate) fn symmetric<const S: usize>(lower: &SMatrix<f64, S, S>) -> SMatrix<f64, S, S> {
    SMatrix::from_fn(|r, c| lower[(r.max(c), r.min(c))])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SMatrix;

    fn example() -> SMatrix<f64, 4, 4> {
        let a = SMatrix::<f64, 4, 4>::from_fn(|r, c| ((r * 7 + c * 3) % 5) as f64 - 1.5);
        a * a.transpose() + SMatrix::identity()
    }

    #[test]
    fn agrees_with_nalgebra() {
        let (a, b) = (example(), SMatrix::<f64, 4, 4>::from_fn(|r, c| (r + 2 * c) as f64));
        let mut factor = Factor { lower: a, reciprocal: SVector::zeros() };
        factor.factor(&SVector::zeros(), Rank::Full).unwrap();
        let oracle = a.cholesky().unwrap().l();
        let inverse = oracle.try_inverse().unwrap();
        assert!((factor.lower.lower_triangle() - oracle).norm() < 1e-12);
        assert!((factor.inverse() - a.try_inverse().unwrap()).norm() < 1e-12);
        let mut solved = b;
        factor.solve_right(&mut solved);
        assert!((solved - b * inverse.transpose()).norm() < 1e-11);
        let v = SVector::<f64, 4>::new(1.0, -2.0, 3.0, 0.5);
        assert!((factor.solve_lower(&v) - inverse * v).norm() < 1e-12);
        assert!((factor.solve_upper(&v) - inverse.transpose() * v).norm() < 1e-12);
        let (mut d, mut w) = (a, v);
        subtract_square(&mut d, &b);
        subtract_product(&mut w, &b, &v);
        assert!((symmetric(&d) - (a - b * b.transpose())).norm() < 1e-12);
        assert!((w - (v - b * v)).norm() < 1e-12);
    }

    #[test]
    fn names_the_pivot_without_information() {
        let mut a = example();
        a.fill_row(2, 0.0);
        a.fill_column(2, 0.0);
        let mut factor = Factor { lower: a, reciprocal: SVector::zeros() };
        let refused = factor.factor(&SVector::zeros(), Rank::Full);
        assert_eq!(refused, Err(BadPivot { index: 2, pivot: 0.0 }));
        let mut factor = Factor { lower: a, reciprocal: SVector::zeros() };
        factor.factor(&SVector::zeros(), Rank::Deficient).unwrap();
        let square = factor.lower.lower_triangle() * factor.lower.lower_triangle().transpose();
        assert!((square - a).norm() < 1e-12);
    }
}
