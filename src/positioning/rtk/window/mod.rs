//! The sliding window on differences against a base: each epoch answered as it comes, and again.

mod chain;
mod history;
mod record;
mod revision;
mod solver;

/// An estimator over a sliding window of differences.
pub(crate) type RtkWindow = super::relative::Relative<chain::Chain>;
