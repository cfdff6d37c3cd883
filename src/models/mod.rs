//! The physics between a satellite and a receiver.
//!
//! Ephemeris and time become a [`SatelliteState`]; positions become ranges, range rates and angles;
//! the atmosphere, the satellite's electronics and the quality of a measurement become metres and
//! variances. All are pure functions of their arguments, in SI units, ECEF and GPS time.
//!
//! A pseudorange P of satellite s by receiver r is modelled as
//!
//! P = ρ(s, p) + c·δt_r − c·δtˢ + τ + T + I·(f_L1/f)²
//!
//! with ρ from [`geometric_range`], c·δtˢ in [`SatelliteState::clock_m`], τ from [`group_delay_m`],
//! T from [`troposphere`] and I from [`ionosphere`]. Which measurements to use and what to do with
//! their residuals is not decided here.

pub mod antenna;
pub mod ionosphere;
pub mod troposphere;
pub mod weights;

mod geometry;
mod glonass;
mod group_delay;
mod kepler;
#[cfg(test)]
mod sample;
mod satellite;
mod selection;

pub use geometry::{LookAngles, RangeRate, geometric_range, look_angles, range_rate};
pub use group_delay::group_delay_m;
pub use satellite::{SatelliteState, satellite_state, state_at_transmission};
pub use selection::{is_usable, select_ephemeris, select_ephemeris_within, validity_s};
