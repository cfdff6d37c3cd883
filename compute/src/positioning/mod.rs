//! Estimation: pure, synchronous, deterministic. Same input, same bits.
//!
//! [`Estimator::advance`] turns one epoch and the [`Aiding`] valid at its time into a solution.
//! `measurements` corrects and weights the observations. `spp` estimates position and clocks by
//! least squares and excludes outliers, and `velocity` does the same with Doppler. `fgo` keeps a
//! window of epochs in a factor graph of `factors`, and `ekf` filters the same factors.
//! `differencing` differences a rover against a base, and `rtk` estimates its position and
//! integers. [`correct_for_antenna`] corrects observations to the antenna reference point.
//!
//! Physical models are in `models`, the options in `config`.

mod aiding;
mod answer;
mod antenna;
mod base_position;
mod chi_square;
mod clock_jump;
mod differencing;
mod draws;
mod ekf;
mod engine;
mod estimator;
mod factors;
mod fgo;
mod geometry;
mod integrity;
mod log_product;
mod measurements;
mod phases;
mod pseudorange_error;
mod ranging;
mod receiver;
mod rivals;
mod rtk;
#[cfg(test)]
mod scenario;
mod setup;
mod sky;
mod snapshot;
mod spp;
mod standstill;
mod starts;
mod uncertainty;
mod velocity;

pub(crate) use aiding::BASE_MOVED_M;
pub use aiding::{Aiding, BASE_LATER_S, BaseAiding, TAG_SLACK_S};
pub use antenna::correct_for_antenna;
pub use base_position::{BasePositionCheck, BasePositionVerdict};
pub use estimator::{Batch, Estimator, EstimatorState, PreparedOptions, Scratch};
pub use measurements::{CarrierPhase, Measurement, Measurements, SecondFrequency};
pub use sky::{SatelliteRole, SatelliteView, satellite_views};
