//! The filter on differences against a base: each epoch answered as it comes.

mod gaussian;
mod solver;

/// A causal estimator that keeps one state with its ambiguities.
pub(crate) type RtkFilter = super::relative::Relative<solver::FilterState>;
