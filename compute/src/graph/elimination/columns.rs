//! The columns of the Cholesky factor: those of a state, and those of a retired border variable.

use nalgebra::{SMatrix, SVector};

use crate::graph::block::Factor;

/// The columns of the Cholesky factor that belong to one state.
#[derive(Clone, Debug)]
pub(crate) struct Step<const S: usize> {
    pub(crate) factor: Factor<S>,
    /// G, S×S: how the next state depends on this one.
    pub(crate) coupling: SMatrix<f64, S, S>,
    /// y, the forward solution.
    pub(crate) forward: SVector<f64, S>,
    /// Index of W's first column in `Elimination::columns`.
    pub(crate) columns: usize,
    /// Number of border variables alive at the state, and of columns of W.
    pub(crate) alive: usize,
    /// Number of these that were alive at the state before too; they come first.
    pub(crate) carried: usize,
    /// Index in `Elimination::retired` of the first variable that retired after the state.
    pub(crate) retired: usize,
    /// Number of variables that retired after the state.
    pub(crate) retired_count: usize,
}

impl<const S: usize> Step<S> {
    pub(super) fn new() -> Self {
        Self {
            factor: Factor { lower: SMatrix::zeros(), reciprocal: SVector::zeros() },
            coupling: SMatrix::zeros(),
            forward: SVector::zeros(),
            columns: 0,
            alive: 0,
            carried: 0,
            retired: 0,
            retired_count: 0,
        }
    }
}

/// The column of the Cholesky factor of a border variable that retired before the end of the chain.
#[derive(Clone, Debug)]
pub(crate) struct Retired<const S: usize> {
    pub(crate) variable: usize,
    /// Its position among the variables alive when it retired.
    pub(crate) position: usize,
    /// 1/√pivot; zero if the pivot was skipped.
    pub(crate) reciprocal: f64,
    /// Its entry of the forward solution.
    pub(crate) forward: f64,
    /// Its column of the factor in the rows of the next state.
    pub(crate) next: SVector<f64, S>,
    /// Index in `Elimination::retired_rows` of its column in the rows of the other variables alive.
    pub(crate) row: usize,
}
