//! The symmetric matrix of the border variables alive, which grows and shrinks with them.
//!
//! The lower triangle is stored in panels. A panel is four rows, stored column by column, as wide
//! as its last row. Every operation works on the four rows of a panel at once. A new variable
//! appends a row, so that no other entry moves. Storage is kept when variables retire.

use nalgebra::SVector;

use crate::graph::block::{BadPivot, Rank};
use crate::graph::lanes::{Lanes, ROWS, Tiles, across, lanes, products, solve_block, subtract};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter, clone_fields};

/// Lower triangle of a symmetric matrix, or its Cholesky factor.
///
/// The rows of the last panel beyond the size are zero. Entries above the diagonal are never read.
#[derive(Debug, Default)]
pub(crate) struct Packed {
    size: usize,
    /// Columns of all panels, one panel after the other.
    columns: Vec<Lanes>,
}

clone_fields!(Packed { size, columns });

impl Snapshot for Packed {
    /// Writes the triangle row by row.
    fn save(&self, writer: &mut SnapshotWriter) {
        let Self { size, columns: _ } = self;
        size.save(writer);
        let rows = (0..*size).flat_map(|i| (0..=i).map(move |j| self.get(i, j)));
        rows.collect::<Vec<f64>>().save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        // `count` bounds the size by the bytes that follow, so that its square does not overflow.
        let size = reader.count()?;
        let values: Vec<f64> = Vec::load(reader)?;
        if values.len() != size * (size + 1) / 2 {
            return Err(reader.invalid("packed matrix"));
        }
        let mut matrix = Self::new();
        matrix.resize(size);
        let entries = (0..size).flat_map(|i| (0..=i).map(move |j| (i, j)));
        entries.zip(values).for_each(|((i, j), value)| *matrix.get_mut(i, j) = value);
        Ok(matrix)
    }
}

/// Index of the first column of panel `panel`.
#[inline]
fn start(panel: usize) -> usize {
    ROWS * panel * (panel + 1) / 2
}

impl Packed {
    pub(crate) const fn new() -> Self {
        Self { size: 0, columns: Vec::new() }
    }

    pub(crate) fn size(&self) -> usize {
        self.size
    }

    fn panels(&self) -> usize {
        self.size.div_ceil(ROWS)
    }

    /// Columns of a panel.
    #[inline]
    fn panel(&self, panel: usize) -> &[Lanes] {
        &self.columns[start(panel)..start(panel + 1)]
    }

    pub(crate) fn clear(&mut self) {
        self.size = 0;
        self.columns.clear();
    }

    /// Sets the size; all entries are then zero.
    fn resize(&mut self, size: usize) {
        self.clear();
        self.size = size;
        self.columns.resize(start(self.panels()), [0.0; ROWS]);
    }

    /// Appends a variable with a zero row.
    pub(crate) fn push(&mut self) {
        self.size += 1;
        self.columns.resize(start(self.panels()), [0.0; ROWS]);
    }

    /// Entry (i, j) of the symmetric matrix, in either order.
    #[inline]
    pub(crate) fn get(&self, i: usize, j: usize) -> f64 {
        let (row, column) = (i.max(j), i.min(j));
        self.columns[start(row / ROWS) + column][row % ROWS]
    }

    #[inline]
    pub(crate) fn get_mut(&mut self, i: usize, j: usize) -> &mut f64 {
        let (row, column) = (i.max(j), i.min(j));
        &mut self.columns[start(row / ROWS) + column][row % ROWS]
    }

    /// Removes row and column `index`, keeping the order of the others.
    pub(crate) fn remove(&mut self, index: usize) {
        for row in index + 1..self.size {
            for column in (0..=row).filter(|&column| column != index) {
                let to = column - usize::from(index < column);
                *self.get_mut(row - 1, to) = self.get(row, column);
            }
        }
        self.truncate(self.size - 1);
    }

    /// Inserts a zero row and column at `index`.
    pub(crate) fn insert(&mut self, index: usize) {
        self.push();
        for row in (index + 1..self.size).rev() {
            for column in (0..=row).rev() {
                *self.get_mut(row, column) = match column {
                    c if c == index => 0.0,
                    c => self.get(row - 1, c - usize::from(index < c)),
                };
            }
        }
        (0..=index).for_each(|column| *self.get_mut(index, column) = 0.0);
    }

    /// Keeps the first `size` variables.
    pub(crate) fn truncate(&mut self, size: usize) {
        self.size = size;
        self.columns.truncate(start(self.panels()));
        let (last, rows) = (size / ROWS, size % ROWS);
        if 0 < rows {
            let columns = &mut self.columns[start(last)..];
            columns.iter_mut().for_each(|column| column[rows..].fill(0.0));
        }
    }

    /// Adds `other`, whose variable i has index `position(i)` here; no two have the same.
    pub(crate) fn add(&mut self, other: &Self, position: impl Fn(usize) -> usize) {
        if other.size <= self.size && (0..other.size).all(|i| position(i) == i) {
            for (column, more) in self.columns.iter_mut().zip(&other.columns) {
                for (value, more) in column.iter_mut().zip(more) {
                    *value += more;
                }
            }
            return;
        }
        for i in 0..other.size {
            let row = position(i);
            for j in 0..=i {
                let more = other.get(i, j);
                // A row touches few variables, so most entries are zero.
                if more != 0.0 {
                    *self.get_mut(row, position(j)) += more;
                }
            }
        }
    }

    /// Adds the diagonal of `other`; positions as in [`Packed::add`].
    pub(crate) fn add_diagonal(&mut self, other: &Self, position: impl Fn(usize) -> usize) {
        for i in 0..other.size {
            *self.get_mut(position(i), position(i)) += other.get(i, i);
        }
    }

    /// Subtracts Wᵀ·W; `tiles` holds the columns of W.
    pub(crate) fn subtract_gram<const S: usize>(&mut self, tiles: &Tiles<S>) {
        for (panel, a) in tiles.0.iter().enumerate() {
            let blocks = self.columns[start(panel)..start(panel + 1)].chunks_exact_mut(ROWS);
            for (block, b) in blocks.zip(&tiles.0) {
                for (column, taken) in block.iter_mut().zip(&products(a, b)) {
                    subtract(column, taken, 1.0);
                }
            }
        }
    }

    /// Subtracts v·vᵀ.
    pub(crate) fn subtract_square(&mut self, v: &[f64]) {
        for panel in 0..self.panels() {
            let rows = lanes(&v[ROWS * panel..]);
            for (column, &factor) in self.columns[start(panel)..start(panel + 1)].iter_mut().zip(v)
            {
                subtract(column, &rows, factor);
            }
        }
    }

    /// y ← y + A·x.
    pub(crate) fn multiply_add(&self, x: &[f64], y: &mut [f64]) {
        for panel in 0..self.panels() {
            let (before, block) = self.panel(panel).split_at(ROWS * panel);
            let (above, own) = y.split_at_mut(ROWS * panel);
            let (x_above, x_own) = x.split_at(ROWS * panel);
            let rows = lanes(x_own);
            let mut sums = [0.0; ROWS];
            for ((column, &x), y) in before.iter().zip(x_above).zip(above) {
                subtract(&mut sums, column, -x);
                *y += across(column, &rows);
            }
            for (i, y) in own.iter_mut().take(ROWS).enumerate() {
                let left: f64 = (0..=i).map(|j| block[j][i] * rows[j]).sum();
                let below: f64 = (i + 1..ROWS).map(|j| block[i][j] * rows[j]).sum();
                *y += sums[i] + left + below;
            }
        }
    }

    /// Y ← Y − X·A, columns of height S.
    pub(crate) fn subtract_product<const S: usize>(
        &self,
        x: &[SVector<f64, S>],
        y: &mut [SVector<f64, S>],
    ) {
        for i in 0..self.size {
            for j in 0..i {
                let value = self.get(i, j);
                y[i] -= x[j] * value;
                y[j] -= x[i] * value;
            }
            y[i] -= x[i] * self.get(i, i);
        }
    }

    /// Replaces the matrix by its Cholesky factor L, with 1/Lⱼⱼ on the diagonal.
    ///
    /// # Errors
    /// Pivot j is not above `floor[j]` or not finite. With [`Rank::Deficient`] such a pivot is
    /// skipped unless it is NaN.
    pub(crate) fn factor(&mut self, floor: &[f64], rank: Rank) -> Result<(), BadPivot> {
        for panel in 0..self.panels() {
            let (above, rest) = self.columns.split_at_mut(start(panel));
            for other in 0..panel {
                let known = &above[start(other)..start(other + 1)];
                let (known, triangle) = known.split_at(ROWS * other);
                let (done, block) = rest.split_at_mut(ROWS * other);
                solve_block(triangle, &products(done, known), block);
            }
            let (done, block) = rest.split_at_mut(ROWS * panel);
            let taken = products(done, done);
            let floor = &floor[ROWS * panel..];
            for (j, &floor) in floor.iter().take(ROWS).enumerate() {
                let mut column = block[j];
                subtract(&mut column, &taken[j], 1.0);
                for left in &block[..j] {
                    subtract(&mut column, left, left[j]);
                }
                let pivot = column[j];
                let positive = floor < pivot && pivot.is_finite();
                if !positive && (rank == Rank::Full || pivot.is_nan()) {
                    return Err(BadPivot { index: ROWS * panel + j, pivot });
                }
                let reciprocal = if positive { 1.0 / pivot.sqrt() } else { 0.0 };
                block[j] = column.map(|value| value * reciprocal);
                block[j][j] = reciprocal;
            }
        }
        Ok(())
    }

    /// v ← L⁻¹·v, where `self` is a factor L.
    pub(crate) fn solve_lower(&self, v: &mut [f64]) {
        for panel in 0..self.panels() {
            let (before, block) = self.panel(panel).split_at(ROWS * panel);
            let (known, own) = v.split_at_mut(ROWS * panel);
            let mut rows = lanes(own);
            for (column, &known) in before.iter().zip(known.iter()) {
                subtract(&mut rows, column, known);
            }
            for (j, own) in own.iter_mut().take(ROWS).enumerate() {
                *own = rows[j] * block[j][j];
                subtract(&mut rows, &block[j], *own);
            }
        }
    }

    /// v ← L⁻ᵀ·v, where `self` is a factor L.
    pub(crate) fn solve_upper(&self, v: &mut [f64]) {
        for panel in (0..self.panels()).rev() {
            let (before, block) = self.panel(panel).split_at(ROWS * panel);
            let (above, own) = v.split_at_mut(ROWS * panel);
            let mut rows = [0.0; ROWS];
            for (j, own) in own.iter_mut().take(ROWS).enumerate().rev() {
                *own = (*own - across(&block[j], &rows)) * block[j][j];
                rows[j] = *own;
            }
            for (value, column) in above.iter_mut().zip(before) {
                *value -= across(column, &rows);
            }
        }
    }

    /// Writes (L·Lᵀ)⁻¹ to `inverse`, where `self` is a factor L; `rows` is scratch.
    ///
    /// Solves for four columns at a time, and only for their rows from the diagonal down: those
    /// above follow by symmetry.
    pub(crate) fn invert_into(&self, inverse: &mut Self, rows: &mut Vec<Lanes>) {
        inverse.resize(self.size);
        for first in 0..self.panels() {
            rows.clear();
            rows.resize(ROWS * (self.panels() - first), [0.0; ROWS]);
            (0..ROWS).for_each(|j| rows[j][j] = 1.0);
            for panel in first..self.panels() {
                self.solve_rows(first, panel, rows);
            }
            for panel in (first..self.panels()).rev() {
                let own = self.solve_rows_back(first, panel, rows);
                let target = &mut inverse.columns[start(panel) + ROWS * first..];
                for (j, column) in target.iter_mut().take(ROWS).enumerate() {
                    *column = own.map(|row| row[j]);
                }
            }
        }
    }

    /// Rows `panel` of L⁻¹·R. R is zero above panel `first`; the rows of L⁻¹·R from there to
    /// `panel` are known.
    fn solve_rows(&self, first: usize, panel: usize, rows: &mut [Lanes]) {
        let width = ROWS * (panel - first);
        let (before, block) = self.panel(panel)[ROWS * first..].split_at(width);
        let (done, own) = rows.split_at_mut(width);
        solve_block(block, &products(done, before), own);
    }

    /// Rows `panel` of L⁻ᵀ·R, after those of all later panels; subtracts their part from the rows
    /// of the panels `first` to `panel`.
    fn solve_rows_back(&self, first: usize, panel: usize, rows: &mut [Lanes]) -> [Lanes; ROWS] {
        let width = ROWS * (panel - first);
        let (before, block) = self.panel(panel)[ROWS * first..].split_at(width);
        let (above, rest) = rows.split_at_mut(width);
        let mut own = [[0.0; ROWS]; ROWS];
        for j in (0..ROWS).rev() {
            let mut row = rest[j];
            for l in j + 1..ROWS {
                subtract(&mut row, &own[l], block[j][l]);
            }
            own[j] = row.map(|value| value * block[j][j]);
        }
        for (row, column) in above.iter_mut().zip(before) {
            for l in 0..ROWS {
                subtract(row, &own[l], column[l]);
            }
        }
        own
    }

    /// Number of values that fit into the storage without a new allocation.
    #[cfg(test)]
    pub(crate) fn capacity(&self) -> usize {
        self.columns.capacity() * ROWS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

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
        let (mut inverse, mut rows) = (Packed::new(), Vec::new());
        packed.invert_into(&mut inverse, &mut rows);
        let oracle = a.try_inverse().unwrap();
        assert!((dense(&inverse) - &oracle).norm() < 1e-11);
        let right = DVector::from_fn(11, |i, _| (i as f64).cos());
        let mut solved = right.clone();
        packed.solve_lower(solved.as_mut_slice());
        packed.solve_upper(solved.as_mut_slice());
        assert!((solved - oracle * right).norm() < 1e-11);
    }

    /// Sums and products agree with dense matrices, for whole panels and others.
    #[test]
    fn sums_and_products_are_those_of_dense_matrices() {
        for n in [3, 8, 11] {
            let (mut a, mut packed) = example(n);
            let v = DVector::from_fn(n, |i, _| (i as f64).sin());
            let x: Vec<_> = (0..n).map(|i| SVector::<f64, 2>::new(v[i], i as f64 - 2.5)).collect();
            let (mut sum, mut left) = (vec![1.0; n], vec![SVector::zeros(); n]);
            packed.multiply_add(v.as_slice(), &mut sum);
            packed.subtract_product(&x, &mut left);
            for i in 0..n {
                assert!((sum[i] - 1.0 - a.row(i).dot(&v.transpose())).abs() < 1e-12);
                let product: SVector<f64, 2> = (0..n).map(|j| x[j] * a[(i, j)]).sum();
                assert!((left[i] + product).norm() < 1e-12);
            }
            packed.subtract_square(v.as_slice());
            a -= &v * v.transpose();
            let mut tiles = Tiles::new();
            tiles.load(&x);
            packed.subtract_gram(&tiles);
            a -= DMatrix::from_fn(n, n, |i, j| x[i].dot(&x[j]));
            assert!((dense(&packed) - &a).norm() < 1e-12);
            let other = packed.clone();
            packed.add(&other, |i| n - 1 - i);
            packed.add(&other, |i| i);
            let turned = DMatrix::from_fn(n, n, |i, j| a[(n - 1 - i, n - 1 - j)]);
            assert!((dense(&packed) - (&a * 2.0 + turned)).norm() < 1e-12);
        }
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
