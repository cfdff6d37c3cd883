//! Positions relative to a base: double differences with integer ambiguities.
//!
//! | module | what it contains |
//! |---|---|
//! | `observed` | what rover and base observe together: base, arcs, rows, noise |
//! | `ambiguity` | from float ambiguities to confirmed integers, and their position |
//! | `pause` | whether arcs have kept their integers while epochs are missing |
//! | `tracking` | arcs, held integers and noise from epoch to epoch, shared by both estimators |
//! | `answer` | from a state with its ambiguities to a solution |
//! | `companion` | a chain without ambiguities, for the epochs without integers |
//! | `relative` | the driver: one epoch in order, with or without a usable base |
//! | `relative_solver` | what the driver asks of a solver |
//! | `window` | [`RtkWindow`]: a window of epochs in the graph, which are revised as they leave |
//! | `paper` | [`RtkPaper`]: the published estimator, for comparison |
//! | `filter` | [`RtkFilter`]: the same rows in an extended Kalman filter, for comparison |
//!
//! `docs/estimation.md` has the equations.

mod ambiguity;
mod answer;
mod companion;
mod filter;
mod observed;
mod paper;
mod pause;
mod relative;
mod relative_solver;
mod tracking;
mod window;

pub(super) use filter::RtkFilter;
pub(super) use paper::RtkPaper;
pub(super) use window::RtkWindow;
