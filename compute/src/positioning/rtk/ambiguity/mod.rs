//! From float ambiguities to integers, and back to the position.

mod acceptance;
mod conditioning;
mod confirmation;
mod differences;
mod fixed_position;
mod float;
mod held_integers;
mod hold;
mod integer_history;
mod integers;
mod joint;
mod separation;

pub(crate) use acceptance::refusal;
pub(crate) use conditioning::{EarlierAmbiguity, condition_on_known_integers};
pub(crate) use confirmation::Confirmation;
pub(crate) use fixed_position::{
    FixedEpoch, FixedPosition, PhasePosition, position_from_fixed_phases, subtract_common_cycles,
    subtract_integers,
};
pub(crate) use float::FloatSolution;
pub(crate) use hold::{FOUND_EPOCHS, HoldState, NEARLY_CERTAIN};
pub(crate) use integer_history::{HoldPeriod, IntegerHistory};
pub(crate) use integers::{IntegerQuestion, IntegerSearch, Resolution, may_be_integer};
pub(crate) use joint::{Joint, condition, scale_odds};
