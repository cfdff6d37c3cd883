//! Factors of the graph: residual (model − measured) over σ, and its Jacobian.
//!
//! The state of one epoch, 8×1, in the local frame (east, north, up) of an origin that all states
//! of a graph share: position p (m), velocity v (m/s), receiver clock b = c·δt_r (m) of the
//! reference constellation, drift d = c·δṫ_r (m/s). A further constellation's clock is b plus its
//! inter-system bias β (m), a border variable of the graph.
//!
//! | factor | on | source |
//! |---|---|---|
//! | [`PseudorangeFactor`] | p, b, β | Wen & Hsu (2021), (9) and (10) |
//! | [`DopplerFactor`] | v, d | Wen & Hsu (2021), (4) to (6), one satellite at a time |
//! | [`DopplerVelocityFactor`] | p, p₊ | Wen & Hsu (2021), (11) and (12) |
//! | [`PhaseDifferenceFactor`] | p, b, p₊, b₊ | van Graas & Soloviev (2004) |
//! | [`MotionFactor`] | p, v, p₊, v₊ | constant acceleration noise |
//! | [`ClockFactor`] | b, d, b₊, d₊ | two-state clock |
//! | [`OdometryFactor`] | p, p₊ | another sensor's displacement |
//! | [`ZeroVelocityFactor`] | p, p₊, v₊ | a standstill |
//! | [`BiasFactor`] | β | |
//! | [`ComponentFactor`] | one number of a state | |
//!
//! Marginalised epochs are a `graph::Prior`.

mod bias;
mod clock;
mod component;
mod doppler;
mod doppler_velocity;
mod motion;
mod odometry;
mod phase_difference;
mod pseudorange;
mod sight;
mod zero_velocity;

pub(super) use bias::BiasFactor;
pub(super) use clock::{ClockFactor, ClockStepPrior, ClockWalk};
pub(super) use component::ComponentFactor;
pub(super) use doppler::DopplerFactor;
pub(super) use doppler_velocity::DopplerVelocityFactor;
pub(super) use motion::{MotionFactor, MotionWalk};
pub(super) use odometry::OdometryFactor;
pub(super) use phase_difference::PhaseDifferenceFactor;
pub(super) use pseudorange::PseudorangeFactor;
pub(super) use sight::{Line, Sight};
pub(super) use zero_velocity::ZeroVelocityFactor;

/// Number of components of a state.
pub(super) const STATE: usize = 8;
/// First column of the velocity.
pub(super) const VELOCITY: usize = 3;
/// Column of the receiver clock.
pub(super) const CLOCK: usize = 6;
/// Column of the clock's drift.
pub(super) const DRIFT: usize = 7;
/// Columns of position and clock.
pub(super) const POSITION_AND_CLOCK: [usize; 4] = [0, 1, 2, CLOCK];
/// Columns of velocity and drift.
pub(super) const VELOCITY_AND_DRIFT: [usize; 4] = [VELOCITY, VELOCITY + 1, VELOCITY + 2, DRIFT];

/// The state of one epoch.
pub(super) type State = nalgebra::SVector<f64, STATE>;

/// Position of a state, local (m).
pub(super) fn position(state: &State) -> nalgebra::Vector3<f64> {
    state.fixed_rows::<3>(0).into_owned()
}

/// Velocity of a state, local (m/s).
pub(super) fn velocity(state: &State) -> nalgebra::Vector3<f64> {
    state.fixed_rows::<3>(VELOCITY).into_owned()
}

#[cfg(test)]
mod sample;
