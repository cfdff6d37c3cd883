//! Solutions against truth: errors, availability, fixes, honesty of the stated covariance, plots.
//!
//! Each solution row gets the reference position of its time, by linear interpolation in ECEF
//! between two neighbours that are close enough, else the nearest within a tolerance. Errors are
//! solution minus reference in the local east, north, up frame of the reference; 2D is
//! √(E² + N²), 3D √(E² + N² + U²). Reading files is [`formats`](crate::formats)' work, choosing
//! them the caller's.

pub mod comparison;
mod epoch;
mod judgement;
mod matching;
pub mod plot;
mod report;
mod statistics;

pub use epoch::JudgedEpoch;
pub use judgement::{Criteria, Expected, Judgement, Truth, judge};
pub use report::{FixReport, FixedErrors, MatchedReport, Report, Uncertainty};
pub use statistics::{ErrorStatistics, percentile};
