//! Values of the unknowns: one vector per state of the chain, one scalar per border variable.

use nalgebra::SVector;

use crate::snapshot::state_fields;

/// The estimate x: `states` along the chain and the `border`.
#[derive(Debug, PartialEq)]
pub struct Estimate<const S: usize> {
    /// State vectors in chain order.
    pub states: Vec<SVector<f64, S>>,
    /// Values of the border variables, by index.
    pub border: Vec<f64>,
}

impl<const S: usize> Estimate<S> {
    /// Without states and border variables.
    pub fn new() -> Self {
        Self { states: Vec::new(), border: Vec::new() }
    }

    /// x ← x + δ.
    pub(crate) fn step(&mut self, delta: &Self) {
        for (state, d) in self.states.iter_mut().zip(&delta.states) {
            *state += d;
        }
        for (value, d) in self.border.iter_mut().zip(&delta.border) {
            *value += d;
        }
    }
}

state_fields!(generic [const S: usize] Estimate<S> { states, border });

impl<const S: usize> Default for Estimate<S> {
    fn default() -> Self {
        Self::new()
    }
}
