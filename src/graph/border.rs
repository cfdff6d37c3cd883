//! A growing and shrinking symmetric matrix for the border: packed lower triangle, row by row.
//!
//! Appending a variable appends a row, so nothing moves; all storage is kept when variables leave.

use nalgebra::SVector;

use crate::graph::block::{BadPivot, Rank};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

/// Lower triangle of a symmetric matrix, or its Cholesky factor, packed by rows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Packed {
    size: usize,
    values: Vec<f64>,
}

impl Snapshot for Packed {
    fn save(&self, writer: &mut SnapshotWriter) {
        let Self { size, values } = self;
        size.save(writer);
        values.save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        // No larger than the values that follow, so that its square does not overflow.
        let size = reader.count()?;
        let values: Vec<f64> = Vec::load(reader)?;
        match values.len() == start(size) {
            true => Ok(Self { size, values }),
            false => Err(reader.invalid("packed matrix")),
        }
    }
}

/// Where row `row` begins.
#[inline]
fn start(row: usize) -> usize {
    row * (row + 1) / 2
}

/// Dot product in four fixed lanes: vectorises, and always in the same order.
#[inline]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 4];
    let (a4, b4) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail = a4.remainder().iter().zip(b4.remainder());
    let tail: f64 = tail.map(|(x, y)| x * y).sum();
    for (x, y) in a4.zip(b4) {
        for lane in 0..4 {
            lanes[lane] += x[lane] * y[lane];
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + tail
}

/// Columns of height S in tiles of four: entry [s][lane], short tiles filled up with zeros.
#[derive(Clone, Debug)]
pub(crate) struct Tiles<const S: usize>(Vec<[[f64; 4]; S]>);

impl<const S: usize> Tiles<S> {
    pub(crate) const fn new() -> Self {
        Self(Vec::new())
    }

    pub(crate) fn load(&mut self, columns: &[SVector<f64, S>]) {
        self.0.clear();
        for four in columns.chunks(4) {
            let mut tile = [[0.0; 4]; S];
            for (lane, column) in four.iter().enumerate() {
                for s in 0..S {
                    tile[s][lane] = column[s];
                }
            }
            self.0.push(tile);
        }
    }

    pub(crate) fn capacity(&self) -> usize {
        self.0.capacity() * 4 * S
    }
}

/// aᵀ·b of two tiles, 4×4.
#[inline]
fn multiply<const S: usize>(a: &[[f64; 4]; S], b: &[[f64; 4]; S]) -> [[f64; 4]; 4] {
    let mut product = [[0.0; 4]; 4];
    for s in 0..S {
        for i in 0..4 {
            for j in 0..4 {
                product[i][j] += a[s][i] * b[s][j];
            }
        }
    }
    product
}

impl Packed {
    /// Subtracts Wᵀ·W, W's columns in tiles; four rows and four columns at a time.
    pub(crate) fn subtract_gram<const S: usize>(&mut self, tiles: &Tiles<S>) {
        for (group, a) in tiles.0.iter().enumerate() {
            let rows = 4.min(self.size - 4 * group);
            for (other, b) in tiles.0[..=group].iter().enumerate() {
                let product = multiply(a, b);
                for (i, values) in product[..rows].iter().enumerate() {
                    let row = &mut self.row_mut(4 * group + i)[4 * other..];
                    for (value, taken) in row.iter_mut().zip(values) {
                        *value -= taken;
                    }
                }
            }
        }
    }

    pub(crate) const fn new() -> Self {
        Self { size: 0, values: Vec::new() }
    }

    pub(crate) fn size(&self) -> usize {
        self.size
    }

    pub(crate) fn clear(&mut self) {
        self.size = 0;
        self.values.clear();
    }

    /// Appends a variable with a zero row.
    pub(crate) fn push(&mut self) {
        self.size += 1;
        self.values.resize(start(self.size), 0.0);
    }

    /// Row `row` up to and with its diagonal.
    #[inline]
    pub(crate) fn row(&self, row: usize) -> &[f64] {
        &self.values[start(row)..start(row + 1)]
    }

    #[inline]
    pub(crate) fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.values[start(row)..start(row + 1)]
    }

    /// Entry (i, j) of the symmetric matrix, in either order.
    #[inline]
    pub(crate) fn get(&self, i: usize, j: usize) -> f64 {
        self.values[start(i.max(j)) + i.min(j)]
    }

    #[inline]
    pub(crate) fn get_mut(&mut self, i: usize, j: usize) -> &mut f64 {
        &mut self.values[start(i.max(j)) + i.min(j)]
    }

    /// Removes row and column `index`, keeping the order of the others.
    pub(crate) fn remove(&mut self, index: usize) {
        let mut to = start(index);
        for row in index + 1..self.size {
            for column in (0..=row).filter(|&column| column != index) {
                self.values[to] = self.values[start(row) + column];
                to += 1;
            }
        }
        self.size -= 1;
        self.values.truncate(start(self.size));
    }

    /// Inserts a zero row and column at `index`.
    pub(crate) fn insert(&mut self, index: usize) {
        self.push();
        for row in (index + 1..self.size).rev() {
            for column in (0..=row).rev() {
                let value = match column {
                    c if c == index => 0.0,
                    c => self.values[start(row - 1) + c - usize::from(index < c)],
                };
                self.values[start(row) + column] = value;
            }
        }
        self.row_mut(index).fill(0.0);
    }

    /// Keeps the first `size` variables.
    pub(crate) fn truncate(&mut self, size: usize) {
        self.size = size;
        self.values.truncate(start(size));
    }

    /// Cholesky factor in place, reciprocals on the diagonal; pivot j must exceed `floor[j]`.
    pub(crate) fn factor(&mut self, floor: &[f64], rank: Rank) -> Result<(), BadPivot> {
        for i in 0..self.size {
            let (before, rest) = self.values.split_at_mut(start(i));
            let row = &mut rest[..=i];
            for j in 0..i {
                let other = &before[start(j)..start(j + 1)];
                row[j] = (row[j] - dot(&row[..j], &other[..j])) * other[j];
            }
            let pivot = row[i] - dot(&row[..i], &row[..i]);
            let positive = floor[i] < pivot && pivot.is_finite();
            if !positive && (rank == Rank::Full || pivot.is_nan()) {
                return Err(BadPivot { index: i, pivot });
            }
            row[i] = if positive { 1.0 / pivot.sqrt() } else { 0.0 };
        }
        Ok(())
    }

    /// v ← L⁻¹·v, on a factor.
    pub(crate) fn solve_lower(&self, v: &mut [f64]) {
        for i in 0..self.size {
            let row = self.row(i);
            v[i] = (v[i] - dot(&row[..i], &v[..i])) * row[i];
        }
    }

    /// v ← L⁻ᵀ·v, on a factor.
    pub(crate) fn solve_upper(&self, v: &mut [f64]) {
        for i in (0..self.size).rev() {
            let row = self.row(i);
            v[i] *= row[i];
            let value = v[i];
            for (x, l) in v[..i].iter_mut().zip(row) {
                *x -= l * value;
            }
        }
    }

    /// (L·Lᵀ)⁻¹ of a factor, into `inverse`; `column` is scratch.
    pub(crate) fn invert_into(&self, inverse: &mut Self, column: &mut Vec<f64>) {
        inverse.clear();
        for _ in 0..self.size {
            inverse.push();
        }
        for j in 0..self.size {
            column.clear();
            column.resize(self.size, 0.0);
            column[j] = 1.0;
            self.solve_lower(column);
            self.solve_upper(column);
            inverse.row_mut(j).copy_from_slice(&column[..=j]);
        }
    }

    /// Copies into the storage already held.
    pub(crate) fn copy_from(&mut self, source: &Self) {
        self.size = source.size;
        self.values.clone_from(&source.values);
    }

    /// Numbers storage can hold without growing.
    pub(crate) fn capacity(&self) -> usize {
        self.values.capacity()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn example(n: usize) -> (DMatrix<f64>, Packed) {
        let a = DMatrix::from_fn(n, n, |r, c| ((r * 11 + c * 5) % 7) as f64 - 2.5);
        let a = &a * a.transpose() + DMatrix::identity(n, n);
        let mut packed = Packed::new();
        for row in 0..n {
            packed.push();
            for column in 0..=row {
                *packed.get_mut(row, column) = a[(row, column)];
            }
        }
        (a, packed)
    }

    fn dense(packed: &Packed) -> DMatrix<f64> {
        DMatrix::from_fn(packed.size(), packed.size(), |r, c| packed.get(r, c))
    }

    #[test]
    fn remove_and_insert_are_inverse() {
        let (a, mut packed) = example(6);
        packed.remove(2);
        assert_eq!(dense(&packed), a.clone().remove_row(2).remove_column(2));
        packed.insert(2);
        let mut holed = a;
        holed.row_mut(2).fill(0.0);
        holed.column_mut(2).fill(0.0);
        assert_eq!(dense(&packed), holed);
        packed.remove(5);
        packed.remove(0);
        assert_eq!(packed.size(), 4);
    }

    #[test]
    fn agrees_with_nalgebra() {
        let (a, mut packed) = example(11);
        packed.factor(&[0.0; 11], Rank::Full).unwrap();
        let (mut inverse, mut column) = (Packed::new(), Vec::new());
        packed.invert_into(&mut inverse, &mut column);
        assert!((dense(&inverse) - a.try_inverse().unwrap()).norm() < 1e-11);
    }

    #[test]
    fn names_the_pivot_without_information() {
        let (_, mut packed) = example(5);
        for other in 0..5 {
            *packed.get_mut(3, other) = 0.0;
        }
        let refused = packed.clone().factor(&[0.0; 5], Rank::Full);
        assert_eq!(refused, Err(BadPivot { index: 3, pivot: 0.0 }));
        packed.factor(&[0.0; 5], Rank::Deficient).unwrap();
        assert_eq!(packed.get(3, 3), 0.0);
    }
}
