//! Decorrelation: Q into ZᵀQZ = LᵀDL with small off-diagonals and ordered variances.
//!
//! ẑ = Zᵀâ, Q_ẑ = ZᵀQZ = LᵀDL, L unit lower triangular, |l_ij| ≤ ½, Z integer with det ±1.
//!
//! Sources: de Jonge & Tiberius (1996); Chang, Yang & Zhou (2005)
//! (symmetric pivoting; an integer Gauss step below the subdiagonal only where a swap follows);
//! Xie, Chang & Al Borno (2011), *Partial LLL reduction*, arXiv:1204.1398 (the other entries of a
//! column only once, at the end: neither the swaps nor D depend on them).

use crate::lambda::EXACT_MAX;
use crate::lambda::LambdaError;
use crate::lambda::nearest;

/// A swap must reduce the leading variance by this factor: Lovász' condition with δ just below 1,
/// so that rounding cannot swap two neighbours endlessly.
const SWAP_GAIN: f64 = 1.0 - 1e-6;

/// Largest number of swaps per entry; entries left unswapped cost search time only.
const SWAPS_PER_ENTRY_MAX: usize = 60;

/// An integer Gauss step of at least this multiple shortens the whole column, so that its other
/// entries stay small and keep their digits.
const LONG_STEP: f64 = 2.0;

/// A conditional variance below this fraction of its variance is rounding noise.
const PIVOT_FRACTION_MIN: f64 = 1e-14;

/// A decorrelated covariance, and the workspace that computes the next one without allocation.
///
/// Matrices are flat and column-major; entry (i, j) is at i + j·n.
#[derive(Clone, Debug)]
pub(crate) struct Reduction {
    size: usize,
    factor: Vec<f64>,
    factor_rows: Vec<f64>,
    variances: Vec<f64>,
    transformation: Vec<f64>,
    inverse_transpose: Vec<f64>,
    scale: Vec<f64>,
    row: Vec<f64>,
}

impl Reduction {
    /// An empty reduction with room for `size` entries.
    pub(crate) fn with_capacity(size: usize) -> Self {
        let square = || Vec::with_capacity(size * size);
        let line = || Vec::with_capacity(size);
        Self {
            size: 0,
            factor: square(),
            factor_rows: square(),
            variances: line(),
            transformation: square(),
            inverse_transpose: square(),
            scale: line(),
            row: line(),
        }
    }

    /// Decorrelates a covariance of n² entries, column-major, and replaces the previous result.
    ///
    /// # Errors
    /// `Empty`, `NotPositiveDefinite`, `Overflow`.
    pub(in crate::lambda) fn reduce(
        &mut self,
        size: usize,
        entries: impl Iterator<Item = f64>,
    ) -> Result<(), LambdaError> {
        if size == 0 {
            return Err(LambdaError::Empty);
        }
        self.load(size, entries);
        self.factorize()?;
        self.decorrelate();
        self.shorten();
        let too_large = |z: &f64| EXACT_MAX <= z.abs() || z.is_nan();
        if self.transformation.iter().chain(&self.inverse_transpose).any(too_large) {
            return Err(LambdaError::Overflow);
        }
        self.store_rows();
        Ok(())
    }

    /// Number of entries n.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// Conditional variances D, each given all later entries; the last is unconditional.
    pub(crate) fn variances(&self) -> &[f64] {
        &self.variances
    }

    /// Column `j` of Z: the integer combination of original entries that equals ẑ_j.
    pub(crate) fn combination(&self, j: usize) -> &[f64] {
        &self.transformation[j * self.size..(j + 1) * self.size]
    }

    /// Column `j` of Z⁻ᵀ: the change of the original integers for one unit of z_j.
    pub(crate) fn restoration(&self, j: usize) -> &[f64] {
        &self.inverse_transpose[j * self.size..(j + 1) * self.size]
    }

    /// Row `i` of L up to its diagonal.
    pub(crate) fn factor_row(&self, i: usize) -> &[f64] {
        &self.factor_rows[i * self.size..i * self.size + i + 1]
    }

    /// Computes ẑ = Zᵀâ into `decorrelated`.
    ///
    /// # Panics
    /// When `float` is shorter than the reduction.
    pub(crate) fn transform(&self, float: &[f64], decorrelated: &mut Vec<f64>) {
        decorrelated.clear();
        decorrelated.extend((0..self.size).map(|j| dot(self.combination(j), float)));
    }

    fn load(&mut self, size: usize, entries: impl Iterator<Item = f64>) {
        self.size = size;
        self.factor.clear();
        self.factor.extend(entries);
        assert_eq!(self.factor.len(), size * size, "the caller passes n² entries");
        self.scale.clear();
        self.scale.extend((0..size).map(|i| self.factor[i + i * size]));
        for matrix in [&mut self.transformation, &mut self.inverse_transpose] {
            matrix.clear();
            matrix.resize(size * size, 0.0);
            (0..size).for_each(|i| matrix[i + i * size] = 1.0);
        }
        self.variances.clear();
        self.variances.resize(size, 0.0);
    }

    /// Q = LᵀDL with symmetric pivoting: the smallest remaining conditional variance goes last.
    fn factorize(&mut self) -> Result<(), LambdaError> {
        let n = self.size;
        for i in (0..n).rev() {
            let diagonal = |j: &usize| self.factor[j + j * n];
            let pivot = (0..=i).min_by(|a, b| diagonal(a).total_cmp(&diagonal(b)));
            self.exchange(pivot.expect("the range 0..=i is not empty"), i);
            let variance = self.factor[i + i * n];
            let least = PIVOT_FRACTION_MIN * self.scale[i];
            if !(variance.is_finite() && 0.0 < variance && least < variance) {
                return Err(LambdaError::NotPositiveDefinite {
                    index: self.original_index(i),
                    pivot: variance,
                });
            }
            self.variances[i] = variance;
            self.eliminate(i, variance);
        }
        Ok(())
    }

    /// Divides row `i` by its pivot and subtracts its contribution from the leading block.
    fn eliminate(&mut self, i: usize, variance: f64) {
        let n = self.size;
        self.row.clear();
        self.row.extend((0..i).map(|j| self.factor[i + j * n] / variance));
        for k in 0..i {
            let weight = self.row[k] * variance;
            let column = &mut self.factor[k * n..k * n + i];
            column.iter_mut().zip(&self.row).for_each(|(q, l)| *q -= weight * l);
            self.factor[i + k * n] = self.row[k];
        }
        self.factor[i + i * n] = 1.0;
        self.factor[i * n..i * n + i].fill(0.0);
    }

    /// Swaps entries `p` and `i` of the block not yet factorized, and their columns of L.
    fn exchange(&mut self, p: usize, i: usize) {
        if p == i {
            return;
        }
        let n = self.size;
        swap_columns(&mut self.factor, n, p, i);
        (0..=i).for_each(|j| self.factor.swap(p + j * n, i + j * n));
        swap_columns(&mut self.transformation, n, p, i);
        swap_columns(&mut self.inverse_transpose, n, p, i);
        self.scale.swap(p, i);
    }

    /// The original index of entry `i`. Before decorrelation Z is a permutation, and this is the
    /// row of the one in its column `i`.
    fn original_index(&self, i: usize) -> usize {
        let column = self.combination(i);
        column.iter().position(|&z| z != 0.0).expect("a permutation has a one in each column")
    }

    /// Swaps neighbours as long as this moves the smaller variance to the later position.
    fn decorrelate(&mut self) {
        let n = self.size;
        let mut swaps_left = SWAPS_PER_ENTRY_MAX * n;
        let mut k = n.saturating_sub(1);
        while 0 < k && 0 < swaps_left {
            let (upper, lower) = (k - 1, k);
            let l = self.factor[lower + upper * n];
            let multiple = nearest(l);
            let remainder = l - multiple;
            let (here, next) = (self.variances[upper], self.variances[lower]);
            let swapped = remainder.mul_add(remainder * next, here);
            if swapped < SWAP_GAIN * next {
                let last = if multiple.abs() < LONG_STEP { lower + 1 } else { n };
                (lower..last).for_each(|i| self.subtract(i, upper));
                self.permute(upper, swapped);
                swaps_left -= 1;
                k = (k + 1).min(n - 1);
            } else {
                k -= 1;
            }
        }
    }

    /// Makes every |l_ij| ≤ ½.
    fn shorten(&mut self) {
        for j in (0..self.size).rev() {
            (j + 1..self.size).for_each(|i| self.subtract(i, j));
        }
    }

    /// Integer Gauss step: column j minus round(l_ij) times column i.
    fn subtract(&mut self, i: usize, j: usize) {
        let n = self.size;
        let entry = self.factor[i + j * n];
        if entry.abs() < 0.5 {
            return;
        }
        let multiple = nearest(entry);
        let (left, right) = self.factor.split_at_mut(i * n);
        let target = left[j * n + i..(j + 1) * n].iter_mut();
        target.zip(&right[i..n]).for_each(|(a, b)| *a -= multiple * b);
        add_column(&mut self.transformation, n, j, i, -multiple);
        add_column(&mut self.inverse_transpose, n, i, j, multiple);
    }

    /// Swaps entries k and k+1 in LᵀDL; `swapped` is the variance entry k gets without k+1.
    fn permute(&mut self, k: usize, swapped: f64) {
        let n = self.size;
        let l = self.factor[k + 1 + k * n];
        let shrink = self.variances[k] / swapped;
        let coupling = l * self.variances[k + 1] / swapped;
        self.variances[k] = shrink * self.variances[k + 1];
        self.variances[k + 1] = swapped;
        for j in 0..k {
            let (a, b) = (self.factor[k + j * n], self.factor[k + 1 + j * n]);
            self.factor[k + j * n] = b - l * a;
            self.factor[k + 1 + j * n] = shrink * a + coupling * b;
        }
        self.factor[k + 1 + k * n] = coupling;
        (k + 2..n).for_each(|i| self.factor.swap(i + k * n, i + (k + 1) * n));
        swap_columns(&mut self.transformation, n, k, k + 1);
        swap_columns(&mut self.inverse_transpose, n, k, k + 1);
    }

    fn store_rows(&mut self) {
        self.factor_rows.clear();
        for i in 0..self.size {
            self.factor_rows.extend(self.factor[i..].iter().step_by(self.size));
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Column `to` plus `multiple` times column `from`, of a square matrix.
fn add_column(matrix: &mut [f64], n: usize, to: usize, from: usize, multiple: f64) {
    let (first, last) = (to.min(from), to.max(from));
    let (left, right) = matrix.split_at_mut(last * n);
    let (low, high) = (&mut left[first * n..(first + 1) * n], &mut right[..n]);
    let (target, source) = if to < from { (low, high) } else { (high, low) };
    target.iter_mut().zip(source.iter()).for_each(|(a, b)| *a += multiple * b);
}

fn swap_columns(matrix: &mut [f64], n: usize, a: usize, b: usize) {
    let (first, last) = (a.min(b), a.max(b));
    let (left, right) = matrix.split_at_mut(last * n);
    left[first * n..(first + 1) * n].swap_with_slice(&mut right[..n]);
}
