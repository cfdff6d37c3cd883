//! What rover and base observe together, before any estimate.

mod arcs;
mod base;
mod base_tracking;
mod code_biases;
mod epoch;
mod half_cycles;
mod losses;
mod noise;
mod pseudorange_age;
mod receivers;
mod residuals;
mod rivals;
mod rows;
mod slips;

pub(crate) use arcs::{ArcReference, Arcs, CarrierArc, Flip, HeldInteger};
pub(crate) use base_tracking::{BaseTracking, Intake, Received, UsableBase};
#[cfg(test)]
pub(crate) use epoch::Group;
pub(crate) use epoch::{
    AmbiguityStart, AmbiguityTie, DifferenceFactor, EpochAmbiguity, RowScratch, Rows, RtkEpoch,
    STATE, State,
};
pub(crate) use half_cycles::half_cycle_step;
pub(crate) use losses::{Losses, MORE_LIKELY, Tracked};
pub(crate) use noise::{FREEDOM_LEAST, Residuals};
pub(crate) use receivers::Receivers;
pub(crate) use residuals::{carrier_residuals, whitened, window_residuals};
pub(crate) use rivals::{Judged, PseudorangeWatch};
pub(crate) use rows::{NewRows, fill};
pub(crate) use slips::{SLIP_ROUNDS, Slips, cut_slips};
