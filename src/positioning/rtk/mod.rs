//! Positions relative to a base: double differences with integer ambiguities.
//!
//! `base` remembers the base's newest epoch, `arcs` which ambiguities live, `epoch` holds the
//! factors of one epoch, `chain` builds and forgets them, `integers` resolves the ambiguities, and
//! [`RtkWindow`] answers each epoch as it comes. `docs/estimation.md` tells why things are as they
//! are.

mod answer;
mod arcs;
mod base;
mod chain;
mod epoch;
mod float;
mod front;
mod integers;
mod noise;
mod settings;
mod tracking;
mod window;

pub(super) use window::RtkWindow;
