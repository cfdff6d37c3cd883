//! The sliding window on differences against a base: each epoch is answered at once and revised
//! later.

mod chain;
mod history;
mod record;
mod revision;
mod solver;

/// An estimator over a sliding window of differences.
pub(crate) type RtkWindow = super::relative::Relative<chain::Chain>;
