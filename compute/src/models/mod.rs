//! Models of what lies between a satellite and a receiver.
//!
//! [`SatelliteState`] from ephemeris and time; ranges, range rates and angles from positions;
//! delays of the atmosphere and of the satellite's electronics (m); variances of measurements (m²).
//! All are pure functions of their arguments, in SI units, ECEF and GPS time.
//!
//! A pseudorange P of satellite s by receiver r is modelled as
//!
//! P = ρ(s, p) + c·δt_r − c·δtˢ + τ + T + I·(f_L1/f)²
//!
//! with ρ from [`geometric_range`], c·δtˢ in [`SatelliteState::clock_m`], τ from [`group_delay_m`],
//! T from [`troposphere`] and I from [`ionosphere`]. The choice of measurements and the use of
//! residuals belong to `positioning`.

pub mod antenna;
pub mod ionosphere;
pub mod troposphere;
pub(crate) mod weights;

mod geometry;
mod glonass;
mod group_delay;
mod kepler;
mod orbit;
#[cfg(test)]
mod sample;
mod satellite;
mod selection;

pub use geometry::{LookAngles, RangeRate, geometric_range, look_angles, range_rate};
pub use group_delay::group_delay_m;
pub(crate) use group_delay::{UNSTATED_DELAY_M, unstated_delay_m};
pub use satellite::{SatelliteState, satellite_state, state_at_transmission};
pub(crate) use selection::{closest_ephemerides, ephemerides_in_force, select_ephemeris_within};
pub use selection::{is_usable, select_ephemeris, validity_s};
pub(crate) use weights::normal_operation_m;
