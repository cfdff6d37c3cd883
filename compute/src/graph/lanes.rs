//! Operations on four rows of the border's matrix at once.
//!
//! Four rows, stored column by column, are a *panel*. Loops over `0..ROWS` have constant bounds and
//! run over neighbours in memory, so that they vectorise. The order of their sums is fixed.

use nalgebra::SVector;

/// Rows of a panel.
pub(crate) const ROWS: usize = 4;

/// One column of a panel: a number for each of its rows.
pub(crate) type Lanes = [f64; ROWS];

/// aᵀ·b, summed in four lanes and then over the lanes: it vectorises, and its order is fixed.
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

/// aᵀ·b of two columns.
#[inline]
pub(crate) fn across(a: &Lanes, b: &Lanes) -> f64 {
    (a[0] * b[0] + a[2] * b[2]) + (a[1] * b[1] + a[3] * b[3])
}

/// a ← a − f·b.
#[inline]
pub(crate) fn subtract(a: &mut Lanes, b: &Lanes, factor: f64) {
    for (value, taken) in a.iter_mut().zip(b) {
        *value -= taken * factor;
    }
}

/// Σ aₖ·bₖᵀ over the columns of two panels; entry `[j][i]` is for row i of `a` and row j of `b`.
#[inline]
pub(crate) fn products(a: &[Lanes], b: &[Lanes]) -> [Lanes; ROWS] {
    let mut sums = [[0.0; ROWS]; ROWS];
    for (a, b) in a.iter().zip(b) {
        for j in 0..ROWS {
            for i in 0..ROWS {
                sums[j][i] += a[i] * b[j];
            }
        }
    }
    sums
}

/// X ← L⁻¹·(X − T), 4×4 each; `triangle` holds L with reciprocals on the diagonal.
#[inline]
pub(crate) fn solve_block(triangle: &[Lanes], taken: &[Lanes; ROWS], x: &mut [Lanes]) {
    for j in 0..ROWS {
        let mut row = x[j];
        subtract(&mut row, &taken[j], 1.0);
        for l in 0..j {
            subtract(&mut row, &x[l], triangle[l][j]);
        }
        x[j] = row.map(|value| value * triangle[j][j]);
    }
}

/// The first numbers of a slice, zero beyond its end.
#[inline]
pub(crate) fn lanes(values: &[f64]) -> Lanes {
    let mut lanes = [0.0; ROWS];
    let rows = values.len().min(ROWS);
    lanes[..rows].copy_from_slice(&values[..rows]);
    lanes
}

/// The rows of Wᵀ in panels.
#[derive(Clone, Debug)]
pub(crate) struct Tiles<const S: usize>(pub(crate) Vec<[Lanes; S]>);

impl<const S: usize> Tiles<S> {
    pub(crate) const fn new() -> Self {
        Self(Vec::new())
    }

    pub(crate) fn load(&mut self, columns: &[SVector<f64, S>]) {
        self.0.clear();
        for four in columns.chunks(ROWS) {
            let mut tile = [[0.0; ROWS]; S];
            for (lane, column) in four.iter().enumerate() {
                for s in 0..S {
                    tile[s][lane] = column[s];
                }
            }
            self.0.push(tile);
        }
    }

    #[cfg(test)]
    pub(crate) fn capacity(&self) -> usize {
        self.0.capacity() * ROWS * S
    }
}
