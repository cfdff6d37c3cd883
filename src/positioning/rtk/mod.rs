//! Positions relative to a base: double differences with integer ambiguities.
//!
//! `base` remembers the base's newest epoch, `arcs` which ambiguities live, `epoch` holds the
//! factors of one epoch, `chain` builds and forgets them, `integers` resolves the ambiguities, and
//! [`RtkWindow`] answers each epoch as it comes. [`RtkFilter`] is its comparator: the same rows in
//! an extended Kalman filter, whose state `belief` holds. `docs/estimation.md` tells why things are
//! as they are.

mod answer;
mod answered;
mod arcs;
mod base;
mod belief;
mod biases;
mod chain;
mod epoch;
mod filter;
mod float;
mod front;
mod heard;
mod held;
mod history;
mod integers;
mod joint;
mod labels;
mod noise;
mod placed;
mod revision;
mod tracking;
mod window;

pub(super) use filter::RtkFilter;
pub(super) use window::{RtkWindow, RtkWindowScratch};
