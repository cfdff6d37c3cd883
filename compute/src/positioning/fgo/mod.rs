//! Factor graph optimisation: a chain of epochs, solved as a sliding window or as a whole.
//!
//! The objective is Σ ρ(‖r‖²_Σ) over the factors of [`super::factors`], Wen & Hsu (2021), (13).
//! `epoch` contains the factors of one epoch, and `chain` builds and marginalises them.
//! [`SlidingWindow`] answers each epoch at once, [`WholeChain`] all of them at the end.
//! `docs/estimation.md` has the reasons for the factors and kernels.

mod answer;
mod batch;
mod chain;
mod competition;
mod epoch;
mod learning;
mod start;
mod window;

pub(super) use batch::WholeChain;
pub(super) use window::{KnownPosition, SlidingWindow, WindowScratch};
