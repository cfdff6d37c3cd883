//! Estimation: pure, synchronous, deterministic. Same input, same bits.
//!
//! [`Estimator::advance`] turns one epoch and the [`Aiding`] valid at its time into a solution.
//! On the way, `measurements` corrects and weighs what was observed, `spp` finds position and
//! clocks by least squares and leaves out what contradicts the rest, `velocity` does the same for
//! Doppler, `fgo` keeps a window of epochs in a factor graph made of `factors`, and `ekf` filters
//! the same factors with one state. Physics is in
//! `models`, the choice of all of it in `config`.

mod answer;
mod chi_square;
mod clock_jump;
mod ekf;
mod estimator;
mod factors;
mod fgo;
mod measurements;
mod phases;
mod ranging;
#[cfg(test)]
mod scenario;
mod spp;
mod velocity;

pub use estimator::{Aiding, Batch, Estimator};
pub use measurements::{CarrierPhase, Measurement, Measurements, SecondFrequency};
