//! The front of the elimination, which moves along the chain from state to state.

use nalgebra::{SMatrix, SVector};

use crate::graph::block::{subtract_product, subtract_square};
use crate::graph::border::Packed;
use crate::graph::lanes::{Tiles, dot};
use crate::graph::system::System;

use super::columns::Step;

/// The part of H and −g that elimination works on: the next state, and the border variables alive.
#[derive(Clone, Debug)]
pub(crate) struct Front<const S: usize> {
    pub(crate) block: SMatrix<f64, S, S>,
    pub(crate) right: SVector<f64, S>,
    /// Diagonal of the block before elimination, damping included.
    pub(crate) diagonal: SVector<f64, S>,
    pub(crate) variables: Vec<usize>,
    pub(crate) columns: Vec<SVector<f64, S>>,
    pub(crate) matrix: Packed,
    pub(crate) border_right: Vec<f64>,
    pub(crate) border_diagonal: Vec<f64>,
    /// By border variable: its position among those alive; `None` if it is not alive.
    pub(crate) positions: Vec<Option<usize>>,
    pub(super) tiles: Tiles<S>,
}

impl<const S: usize> Front<S> {
    pub(super) const fn new() -> Self {
        Self {
            block: SMatrix::from_array_storage(nalgebra::ArrayStorage([[0.0; S]; S])),
            right: SVector::from_array_storage(nalgebra::ArrayStorage([[0.0; S]; 1])),
            diagonal: SVector::from_array_storage(nalgebra::ArrayStorage([[0.0; S]; 1])),
            variables: Vec::new(),
            columns: Vec::new(),
            matrix: Packed::new(),
            border_right: Vec::new(),
            border_diagonal: Vec::new(),
            positions: Vec::new(),
            tiles: Tiles::new(),
        }
    }

    fn clear(&mut self, border: usize) {
        self.variables.clear();
        self.columns.clear();
        self.matrix.clear();
        self.border_right.clear();
        self.border_diagonal.clear();
        self.positions.clear();
        self.positions.resize(border, None);
    }

    /// Begins at the first state of the system.
    pub(super) fn load(&mut self, system: &System<S>, damping: f64) {
        self.clear(system.lives.len());
        self.set_block(system, 0, damping);
        self.join(system, 0, damping);
    }

    /// Loads block and right side of state `k` from the system.
    fn set_block(&mut self, system: &System<S>, k: usize, damping: f64) {
        self.block = system.diagonal[k];
        self.right = -system.gradient[k];
        for j in 0..S {
            self.block[(j, j)] *= 1.0 + damping;
            self.diagonal[j] = self.block[(j, j)];
        }
    }

    /// Moves to state `k`, and subtracts what the elimination of state k − 1 contributes to its
    /// block, right side and columns.
    pub(super) fn move_to(
        &mut self,
        system: &System<S>,
        k: usize,
        damping: f64,
        step: &Step<S>,
        columns: &[SVector<f64, S>],
    ) {
        self.set_block(system, k, damping);
        subtract_square(&mut self.block, &step.coupling);
        subtract_product(&mut self.right, &step.coupling, &step.forward);
        for (column, w) in self.columns.iter_mut().zip(columns) {
            *column = SVector::zeros();
            subtract_product(column, &step.coupling, w);
        }
    }

    /// Hᵦᵦ −= Wᵀ·W and −gᵦ −= Wᵀ·y.
    pub(super) fn reduce_border(&mut self, columns: &[SVector<f64, S>], forward: &SVector<f64, S>) {
        for (right, w) in self.border_right.iter_mut().zip(columns) {
            *right -= dot(w.as_slice(), forward.as_slice());
        }
        self.tiles.load(columns);
        self.matrix.subtract_gram(&self.tiles);
    }

    /// Adds the border part of the rows at state `k`. Variables that no earlier row touched join.
    pub(super) fn join(&mut self, system: &System<S>, k: usize, damping: f64) {
        let touched = &system.touched[k];
        for (index, &variable) in touched.variables.iter().enumerate() {
            let position = self.position(variable);
            self.columns[position] += touched.columns[index];
            self.border_right[position] -= touched.gradient[index];
            let own = touched.matrix.get(index, index);
            self.border_diagonal[position] += own + damping * own;
            *self.matrix.get_mut(position, position) += damping * own;
        }
        let position =
            |index: usize| self.positions[touched.variables[index]].expect("joined above");
        match touched.coupled {
            true => self.matrix.add(&touched.matrix, position),
            false => self.matrix.add_diagonal(&touched.matrix, position),
        }
    }

    #[inline]
    fn position(&mut self, variable: usize) -> usize {
        if let Some(position) = self.positions[variable] {
            return position;
        }
        let position = self.variables.len();
        self.positions[variable] = Some(position);
        self.variables.push(variable);
        self.columns.push(SVector::zeros());
        self.matrix.push();
        self.border_right.push(0.0);
        self.border_diagonal.push(0.0);
        position
    }

    /// Subtracts the outer product of a retired variable's column, which is `next` in the rows of
    /// the state and `row` in those of the border variables left.
    pub(super) fn subtract_outer(&mut self, next: &SVector<f64, S>, row: &[f64], forward: f64) {
        for c in 0..S {
            for r in c..S {
                self.block[(r, c)] -= next[r] * next[c];
            }
        }
        self.right -= next * forward;
        for (i, &factor) in row.iter().enumerate() {
            self.columns[i] -= next * factor;
            self.border_right[i] -= factor * forward;
        }
        self.matrix.subtract_square(row);
    }

    pub(super) fn remove(&mut self, position: usize) {
        self.positions[self.variables[position]] = None;
        for &variable in &self.variables[position + 1..] {
            self.positions[variable] = self.positions[variable].map(|old| old - 1);
        }
        self.variables.remove(position);
        self.columns.remove(position);
        self.matrix.remove(position);
        self.border_right.remove(position);
        self.border_diagonal.remove(position);
    }
}
