//! Decorrelation: Q into ZᵀQZ = LᵀDL with small off-diagonals and ordered variances.
//!
//! ẑ = Zᵀâ, Q_ẑ = ZᵀQZ = LᵀDL, L unit lower triangular, |l_ij| ≤ ½, Z integer with det ±1.
//!
//! Sources: de Jonge & Tiberius (1996); Chang, Yang & Zhou (2005)
//! (symmetric pivoting; an integer Gauss step below the subdiagonal only where a swap follows);
//! Xie, Chang & Al Borno (2011), *Partial LLL reduction*, arXiv:1204.1398 (the other entries of a
//! column only once, at the end: neither the swaps nor D depend on them).
//!
//! An entry is left out without a new decorrelation. Euclid's algorithm on a row of Z, by the same
//! two kinds of steps, leaves this row with a single entry that is not zero. This entry is moved to
//! the front, where nothing depends on it. The others are decorrelated again, which takes few
//! steps.

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

/// A factor of Z, as it acts on the entries ẑ = Zᵀâ.
#[derive(Clone, Copy, Debug)]
enum Step {
    /// Two entries change places.
    Exchange(u32, u32),
    /// A multiple of an entry is subtracted from another.
    Subtract { from: u32, of: u32, multiple: f64 },
}

impl Step {
    /// Applies the step (`sign` −1) or its inverse (1) to the entries. Returns whether the entry
    /// that changes is below the integers that an `f64` represents exactly.
    fn apply(&self, entries: &mut [f64], sign: f64) -> bool {
        match *self {
            Self::Exchange(a, b) => {
                entries.swap(a as usize, b as usize);
                true
            }
            Self::Subtract { from, of, multiple } => {
                let added = sign * multiple * entries[of as usize];
                let entry = &mut entries[from as usize];
                *entry += added;
                entry.abs() < EXACT_MAX
            }
        }
    }
}

/// A decorrelated covariance, and the workspace that computes the next one without allocation.
///
/// Matrices are flat and column-major; entry (i, j) is at i + j·n. Z is kept as the product of its
/// steps. A step then costs at most two numbers. To apply it to Z and Z⁻ᵀ would cost more than to
/// apply it to L.
#[derive(Clone, Debug)]
pub(crate) struct Reduction {
    size: usize,
    /// Entries left out; they stand first.
    left_out: usize,
    factor: Vec<f64>,
    factor_rows: Vec<f64>,
    variances: Vec<f64>,
    steps: Vec<Step>,
    floats: Vec<f64>,
    /// Whether all intermediate floats were below the integers that an `f64` represents exactly.
    is_exact: bool,
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
            left_out: 0,
            factor: square(),
            factor_rows: square(),
            variances: line(),
            steps: Vec::with_capacity(size * size),
            floats: line(),
            is_exact: true,
            scale: line(),
            row: line(),
        }
    }

    /// Decorrelates floats â, n of them, with a covariance of n² entries, column-major. Replaces
    /// the previous result.
    ///
    /// # Errors
    /// `Empty`, `NotPositiveDefinite`, `Overflow`.
    pub(in crate::lambda) fn reduce(
        &mut self,
        floats: impl Iterator<Item = f64>,
        entries: impl Iterator<Item = f64>,
    ) -> Result<(), LambdaError> {
        self.load(floats, entries);
        if self.size == 0 {
            return Err(LambdaError::Empty);
        }
        self.factorize()?;
        self.finish()
    }

    /// Copies another reduction into the memory of this one.
    pub(in crate::lambda) fn copy_from(&mut self, other: &Self) {
        (self.size, self.left_out, self.is_exact) = (other.size, other.left_out, other.is_exact);
        self.factor.clone_from(&other.factor);
        self.factor_rows.clone_from(&other.factor_rows);
        self.variances.clone_from(&other.variances);
        self.steps.clone_from(&other.steps);
        self.floats.clone_from(&other.floats);
    }

    /// Leaves out one decorrelated entry. The others are then the combinations of original entries
    /// whose coefficients times `weights` add up to zero. If one weight is 1 and the others are 0,
    /// that original entry is left out. If the weights of all differences from a common reference
    /// are 1, the reference is left out. The n weights are integers; they are overwritten.
    ///
    /// # Errors
    /// `Overflow`.
    pub(in crate::lambda) fn leave_out(&mut self, weights: &mut [f64]) -> Result<(), LambdaError> {
        if !self.transform(weights) {
            return Err(LambdaError::Overflow);
        }
        for k in (self.left_out..self.size.saturating_sub(1)).rev() {
            while weights[k + 1] != 0.0 {
                let multiple = (weights[k] / weights[k + 1]).round();
                self.subtract_multiple(k + 1, k, multiple);
                let (l, next) = (self.factor[k + 1 + k * self.size], self.variances[k + 1]);
                self.permute(k, self.variances[k] + l * (l * next));
                weights[k] -= multiple * weights[k + 1];
                weights.swap(k, k + 1);
            }
        }
        if self.left_out < self.size && weights[self.left_out] != 0.0 {
            self.left_out += 1;
        }
        self.finish()
    }

    /// Number of entries that are not left out.
    pub(crate) fn size(&self) -> usize {
        self.size - self.left_out
    }

    /// Conditional variances D, each given all later entries; the last is unconditional.
    pub(crate) fn variances(&self) -> &[f64] {
        &self.variances[self.left_out..]
    }

    /// Row `i` of L up to its diagonal.
    pub(crate) fn factor_row(&self, i: usize) -> &[f64] {
        let n = self.size();
        &self.factor_rows[i * n..i * n + i + 1]
    }

    /// The decorrelated floats ẑ = Zᵀâ.
    pub(crate) fn floats(&self) -> &[f64] {
        &self.floats[self.left_out..]
    }

    /// ‖ẑ‖², the squared norm of the floats about zero.
    pub(in crate::lambda) fn squared_norm(&self) -> f64 {
        let n = self.size();
        let mut conditioned = self.floats().to_vec();
        for k in (0..n).rev() {
            let (before, center) = (&self.factor_row(k)[..k], conditioned[k]);
            conditioned.iter_mut().zip(before).for_each(|(z, l)| *z -= center * l);
        }
        conditioned.iter().zip(self.variances()).map(|(z, d)| z * z / d).sum()
    }

    /// Turns n values a into Zᵀa; the first ones belong to the entries left out. Returns whether
    /// all intermediate numbers are below the integers that an `f64` represents exactly.
    pub(in crate::lambda) fn transform(&self, values: &mut [f64]) -> bool {
        let steps = self.steps.iter();
        steps.fold(true, |is_exact, step| is_exact & step.apply(values, -1.0))
    }

    /// Turns decorrelated integers z into the original ones, a = Z⁻ᵀz; integers of entries left out
    /// have no meaning. Returns whether all intermediate numbers are exact.
    pub(crate) fn restore(&self, integers: &mut Vec<f64>) -> bool {
        integers.splice(..0, std::iter::repeat_n(0.0, self.left_out));
        let steps = self.steps.iter().rev();
        steps.fold(true, |is_exact, step| is_exact & step.apply(integers, 1.0))
    }

    fn load(&mut self, floats: impl Iterator<Item = f64>, entries: impl Iterator<Item = f64>) {
        self.floats.clear();
        self.floats.extend(floats);
        let size = self.floats.len();
        (self.size, self.left_out, self.is_exact) = (size, 0, true);
        self.factor.clear();
        self.factor.extend(entries);
        assert_eq!(self.factor.len(), size * size, "the caller passes n² entries");
        self.scale.clear();
        self.scale.extend((0..size).map(|i| self.factor[i + i * size]));
        self.steps.clear();
        self.variances.clear();
        self.variances.resize(size, 0.0);
    }

    /// Decorrelates what is not left out.
    fn finish(&mut self) -> Result<(), LambdaError> {
        self.decorrelate();
        self.shorten();
        self.store_rows();
        if self.is_exact { Ok(()) } else { Err(LambdaError::Overflow) }
    }

    /// Records a step, and takes it.
    fn step(&mut self, step: Step) {
        self.is_exact &= step.apply(&mut self.floats, -1.0);
        self.steps.push(step);
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
        self.step(Step::Exchange(p as u32, i as u32));
        self.scale.swap(p, i);
    }

    /// The original index of entry `i`, before decorrelation: all steps are exchanges so far.
    fn original_index(&self, i: usize) -> usize {
        self.steps.iter().rev().fold(i, |at, step| match *step {
            Step::Exchange(a, b) if at == a as usize => b as usize,
            Step::Exchange(a, b) if at == b as usize => a as usize,
            _ => at,
        })
    }

    /// Swaps neighbours as long as this moves the smaller variance to the later position.
    fn decorrelate(&mut self) {
        let n = self.size;
        let mut swaps_left = SWAPS_PER_ENTRY_MAX * n;
        let mut k = n.saturating_sub(1);
        while self.left_out < k && 0 < swaps_left {
            let (upper, lower) = (k - 1, k);
            let l = self.factor[lower + upper * n];
            let multiple = nearest(l);
            let remainder = l - multiple;
            let (here, next) = (self.variances[upper], self.variances[lower]);
            let swapped = here + remainder * (remainder * next);
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
        for j in (self.left_out..self.size).rev() {
            (j + 1..self.size).for_each(|i| self.subtract(i, j));
        }
    }

    /// Integer Gauss step: column j minus round(l_ij) times column i.
    fn subtract(&mut self, i: usize, j: usize) {
        let entry = self.factor[i + j * self.size];
        if 0.5 <= entry.abs() {
            self.subtract_multiple(i, j, nearest(entry));
        }
    }

    /// Column j minus a multiple of column i, a later one.
    fn subtract_multiple(&mut self, i: usize, j: usize, multiple: f64) {
        let n = self.size;
        let (left, right) = self.factor.split_at_mut(i * n);
        let target = left[j * n + i..(j + 1) * n].iter_mut();
        target.zip(&right[i..n]).for_each(|(a, b)| *a -= multiple * b);
        self.step(Step::Subtract { from: j as u32, of: i as u32, multiple });
    }

    /// Swaps entries k and k+1 in LᵀDL; `swapped` is the variance entry k gets without k+1.
    fn permute(&mut self, k: usize, swapped: f64) {
        let n = self.size;
        let l = self.factor[k + 1 + k * n];
        let shrink = self.variances[k] / swapped;
        let coupling = l * self.variances[k + 1] / swapped;
        self.variances[k] = shrink * self.variances[k + 1];
        self.variances[k + 1] = swapped;
        for column in self.factor[self.left_out * n..k * n].chunks_exact_mut(n) {
            let pair = &mut column[k..k + 2];
            let (a, b) = (pair[0], pair[1]);
            pair[0] = b - l * a;
            pair[1] = shrink * a + coupling * b;
        }
        self.factor[k + 1 + k * n] = coupling;
        let (left, right) = self.factor.split_at_mut((k + 1) * n);
        left[k * n + k + 2..].swap_with_slice(&mut right[k + 2..n]);
        self.step(Step::Exchange(k as u32, k as u32 + 1));
    }

    /// Stores the rows of L that are not left out.
    fn store_rows(&mut self) {
        self.factor_rows.clear();
        let begin = self.left_out * self.size;
        for i in self.left_out..self.size {
            self.factor_rows.extend(self.factor[begin + i..].iter().step_by(self.size));
        }
    }
}

fn swap_columns(matrix: &mut [f64], n: usize, a: usize, b: usize) {
    let (first, last) = (a.min(b), a.max(b));
    let (left, right) = matrix.split_at_mut(last * n);
    left[first * n..(first + 1) * n].swap_with_slice(&mut right[..n]);
}
