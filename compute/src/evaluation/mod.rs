//! Solutions against truth: errors, availability, fixes, consistency of the covariance, plots.
//!
//! Each solution row gets the reference position at its time: by linear interpolation in ECEF
//! between two rows that are close enough, else the nearest row within a tolerance. Errors are
//! solution minus reference in the reference's local east, north, up frame; 2D is √(E² + N²), 3D
//! √(E² + N² + U²). Reading files is the task of [`formats`](crate::formats), choosing them that of
//! the caller.

pub mod comparison;
mod epoch;
mod html;
mod judgement;
mod matching;
mod overview;
pub mod plot;
mod report;
mod run_page;
#[cfg(test)]
mod sample;
mod statistics;

pub use epoch::JudgedEpoch;
pub use judgement::{Criteria, Expected, Judgement, Truth, judge};
pub use overview::Overview;
pub use report::{FixReport, FixedErrors, MatchedReport, Report, Uncertainty};
pub use run_page::RunPage;
pub use statistics::ErrorStatistics;
