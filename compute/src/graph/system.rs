//! Normal equations of a chain with a border, accumulated row by row: H·δ = −g.
//!
//! H = Σ w·JᵀJ and g = Σ w·Jᵀr, with w the kernel's weight. For each state k the system holds the
//! diagonal block Hₖₖ (lower triangle), the coupling Hₖ₊₁,ₖ, and the border part of the rows at k.
//! A row names only the coordinates it depends on, so that a row of N entries costs N²/2 products
//! instead of S²/2.
//!
//! Rows are summed in the order of the calls: the same calls give the same bits.

use nalgebra::{SMatrix, SVector};

use crate::graph::border::Packed;
use crate::graph::kernel::{Kernel, LossSum};

/// When a border variable is eliminated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BorderLife {
    /// After the last state that touches it. The cost of a batch is then linear in its length.
    WhileTouched,
    /// At the end of the chain. A window needs this for the joint covariance of its whole border.
    WholeChain,
}

/// A whitened scalar row on one state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<const N: usize> {
    /// r (model − measured) / σ.
    pub residual: f64,
    /// Indices of the coordinates it depends on, in ascending order without repetition.
    pub columns: [usize; N],
    /// ∂r/∂x at the coordinates `columns`.
    pub jacobian: [f64; N],
}

/// A whitened scalar row on two neighbouring states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link<const N: usize, const M: usize> {
    /// r (model − measured) / σ.
    pub residual: f64,
    /// Indices of the earlier state's coordinates, in ascending order without repetition.
    pub columns: [usize; N],
    /// ∂r/∂xₖ at the coordinates `columns`.
    pub jacobian: [f64; N],
    /// Indices of the later state's coordinates, in ascending order without repetition.
    pub next_columns: [usize; M],
    /// ∂r/∂xₖ₊₁ at the coordinates `next_columns`.
    pub next_jacobian: [f64; M],
}

/// Border part of the rows at one state. Variables are in the order in which rows first touch them.
#[derive(Clone, Debug)]
pub(crate) struct Touched<const S: usize> {
    pub(crate) variables: Vec<usize>,
    /// Hₖᵦ, one column per variable.
    pub(crate) columns: Vec<SVector<f64, S>>,
    pub(crate) gradient: Vec<f64>,
    pub(crate) matrix: Packed,
    /// Whether some row touches two of the variables; if not, the matrix is diagonal.
    pub(crate) coupled: bool,
}

impl<const S: usize> Touched<S> {
    const fn new() -> Self {
        Self {
            variables: Vec::new(),
            columns: Vec::new(),
            gradient: Vec::new(),
            matrix: Packed::new(),
            coupled: false,
        }
    }

    fn clear(&mut self) {
        self.variables.clear();
        self.columns.clear();
        self.gradient.clear();
        self.matrix.clear();
        self.coupled = false;
    }

    /// Appends a variable; returns its position in the list.
    fn push(&mut self, variable: usize) -> usize {
        self.variables.push(variable);
        self.columns.push(SVector::zeros());
        self.gradient.push(0.0);
        self.matrix.push();
        self.variables.len() - 1
    }
}

/// Where in the chain a border variable is touched.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Life {
    /// Last state that touches it; `None` if no row does.
    pub(crate) last: Option<usize>,
    /// The state at which a row touched it last.
    state: usize,
    /// Its position in [`Touched::variables`] of that state.
    position: usize,
}

impl Life {
    /// Its position in [`Touched::variables`] of the state at which a row touched it last.
    pub(crate) fn position(&self) -> usize {
        self.position
    }
}

/// Normal equations of a chain of `S`×1 states and a border. Keeps its storage when reset.
#[derive(Clone, Debug)]
pub struct System<const S: usize> {
    pub(crate) states: usize,
    pub(crate) border_life: BorderLife,
    pub(crate) diagonal: Vec<SMatrix<f64, S, S>>,
    pub(crate) coupling: Vec<SMatrix<f64, S, S>>,
    pub(crate) gradient: Vec<SVector<f64, S>>,
    pub(crate) touched: Vec<Touched<S>>,
    pub(crate) lives: Vec<Life>,
    cost: LossSum,
    pub(crate) scratch: Vec<f64>,
}

impl<const S: usize> System<S> {
    /// An empty system; [`System::reset`] sets its size.
    pub const fn new(border_life: BorderLife) -> Self {
        Self {
            states: 0,
            border_life,
            diagonal: Vec::new(),
            coupling: Vec::new(),
            gradient: Vec::new(),
            touched: Vec::new(),
            lives: Vec::new(),
            cost: LossSum::ZERO,
            scratch: Vec::new(),
        }
    }

    /// Sets the size; all entries are then zero. Border variables are 0 … `border` − 1.
    pub fn reset(&mut self, states: usize, border: usize) {
        self.states = states;
        self.cost = LossSum::ZERO;
        for blocks in [&mut self.diagonal, &mut self.coupling] {
            blocks.clear();
            blocks.resize(states, SMatrix::zeros());
        }
        self.gradient.clear();
        self.gradient.resize(states, SVector::zeros());
        self.touched.iter_mut().for_each(Touched::clear);
        if self.touched.len() < states {
            self.touched.resize_with(states, Touched::new);
        }
        self.lives.clear();
        self.lives.resize(border, Life { last: None, state: 0, position: 0 });
    }

    /// Number of states.
    pub(crate) fn states(&self) -> usize {
        self.states
    }

    /// Σ ρ(r) of the rows added since the reset.
    pub(crate) fn cost(&self) -> f64 {
        self.cost.value()
    }

    /// Adds a loss to the cost for which the system has no row.
    pub(crate) fn add_cost(&mut self, cost: f64) {
        self.cost.add_loss(cost);
    }

    /// Adds the loss of a residual to the cost; returns the weight that the kernel gives it.
    #[inline]
    pub(crate) fn weigh(&mut self, residual: f64, kernel: &Kernel) -> f64 {
        self.cost.add(residual, kernel)
    }

    /// Adds a row on state `k`; returns the weight that the kernel gives it.
    #[inline]
    pub fn add<const N: usize>(&mut self, k: usize, row: &Row<N>, kernel: &Kernel) -> f64 {
        let weight = self.weigh(row.residual, kernel);
        self.add_weighted(k, row, weight);
        weight
    }

    /// Adds a row on state `k` with a known weight, without its loss.
    #[inline]
    pub(crate) fn add_weighted<const N: usize>(&mut self, k: usize, row: &Row<N>, weight: f64) {
        let block = &mut self.diagonal[k].data.0;
        let gradient = &mut self.gradient[k].data.0[0];
        for j in 0..N {
            let (column, scaled) = (row.columns[j], weight * row.jacobian[j]);
            gradient[column] += scaled * row.residual;
            let target = &mut block[column];
            for i in j..N {
                target[row.columns[i]] += scaled * row.jacobian[i];
            }
        }
    }

    /// Adds a row on states `k` and `k + 1`; returns the weight that the kernel gives it.
    #[inline]
    pub fn add_link<const N: usize, const M: usize>(
        &mut self,
        k: usize,
        link: &Link<N, M>,
        kernel: &Kernel,
    ) -> f64 {
        let weight = self.weigh(link.residual, kernel);
        self.add_link_weighted(k, link, weight);
        weight
    }

    /// Adds a row on states `k` and `k + 1` with a known weight, without its loss.
    #[inline]
    pub(crate) fn add_link_weighted<const N: usize, const M: usize>(
        &mut self,
        k: usize,
        link: &Link<N, M>,
        weight: f64,
    ) {
        let Link { residual, columns, jacobian, next_columns, next_jacobian } = *link;
        self.add_weighted(k, &Row { residual, columns, jacobian }, weight);
        let next = Row { residual, columns: next_columns, jacobian: next_jacobian };
        self.add_weighted(k + 1, &next, weight);
        let block = &mut self.coupling[k].data.0;
        for j in 0..N {
            let scaled = weight * jacobian[j];
            let target = &mut block[columns[j]];
            for i in 0..M {
                target[next_columns[i]] += scaled * next_jacobian[i];
            }
        }
    }

    /// Adds a row on state `k` and on border variables, given as `(variable, ∂r/∂b)` without
    /// repetition. A row on border variables alone has `N` = 0. Returns the weight that the kernel
    /// gives it.
    #[inline]
    pub fn add_with_border<const N: usize>(
        &mut self,
        k: usize,
        row: &Row<N>,
        border: &[(usize, f64)],
        kernel: &Kernel,
    ) -> f64 {
        let weight = self.add(k, row, kernel);
        self.add_border(k, row, border, weight);
        weight
    }

    /// Adds the border part of a row on state `k` with a known weight. [`System::add_weighted`]
    /// adds the rest.
    #[inline]
    pub(crate) fn add_border<const N: usize>(
        &mut self,
        k: usize,
        row: &Row<N>,
        border: &[(usize, f64)],
        weight: f64,
    ) {
        for (index, &(variable, derivative)) in border.iter().enumerate() {
            let position = self.touch(k, variable);
            let touched = &mut self.touched[k];
            touched.coupled |= 0 < index;
            let scaled = weight * derivative;
            touched.gradient[position] += scaled * row.residual;
            let column = &mut touched.columns[position];
            for i in 0..N {
                column[row.columns[i]] += scaled * row.jacobian[i];
            }
            for &(other, derivative) in &border[..=index] {
                let other = self.lives[other].position;
                *touched.matrix.get_mut(position, other) += scaled * derivative;
            }
        }
    }

    /// Adds `h`, of which the lower triangle is read, and `g` to block and gradient of state `k`.
    pub(crate) fn add_information(
        &mut self,
        k: usize,
        h: &SMatrix<f64, S, S>,
        g: &SVector<f64, S>,
    ) {
        self.diagonal[k] += h;
        self.gradient[k] += g;
    }

    /// Number of values that fit into the storage without a new allocation.
    #[cfg(test)]
    pub(crate) fn capacity(&self) -> usize {
        let blocks = (self.diagonal.capacity() + self.coupling.capacity()) * S * S;
        let border = self.touched.iter().map(|touched| {
            let columns = touched.columns.capacity() * S + touched.variables.capacity();
            columns + touched.gradient.capacity() + touched.matrix.capacity()
        });
        blocks + self.gradient.capacity() * S + border.sum::<usize>() + self.lives.capacity()
    }

    /// Position of a border variable in [`Touched::variables`] of state `k`; appends it if new.
    #[inline]
    pub(crate) fn touch(&mut self, k: usize, variable: usize) -> usize {
        let (life, touched) = (&mut self.lives[variable], &mut self.touched[k]);
        if life.last.is_none_or(|last| last < k) {
            *life = Life { last: Some(k), state: k, position: touched.push(variable) };
        } else if life.state != k {
            let known = touched.variables.iter().position(|&known| known == variable);
            (life.state, life.position) = (k, known.unwrap_or_else(|| touched.push(variable)));
        }
        life.position
    }
}
