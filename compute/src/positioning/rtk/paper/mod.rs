//! Positions relative to a base as Wen & Hsu (2021) published them, equations (15) to (25), for
//! comparison.
//!
//! The states are positions. Pseudoranges are differenced against the highest satellite of their
//! signal, each difference with an error of its own under Huber's kernel. The Doppler velocity of
//! the earlier epoch links two states, (11) and (12). Each epoch has ambiguities of its own, (18).
//! So its phases have no information on its position before they have integers, and the float
//! ambiguities follow from the position and its covariance. LAMBDA resolves them by the ratio test,
//! epoch by epoch. No integer is held, no slip is detected and no noise is learnt.
//!
//! The paper gives no weights. Those of pseudoranges are goGPS's, as in its positioning without a
//! base, for both receivers. Those of phases come from the options.

mod chain;
mod epoch;
mod integers;
mod past;
mod solver;

/// The published estimator.
pub(crate) type RtkPaper = super::relative::Relative<chain::PaperChain>;
