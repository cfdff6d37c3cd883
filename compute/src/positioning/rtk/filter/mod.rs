//! The filter on differences against a base: each epoch is answered at once and never revised.

mod gaussian;
mod solver;

/// A causal estimator that keeps one state with its ambiguities.
pub(crate) type RtkFilter = super::relative::Relative<solver::FilterState>;
