//! The vocabulary: plain data that all other modules use.
//!
//! Time, coordinates, satellites, signals, observations, odometry, ephemerides, base stations and
//! solutions. Nothing here computes a model, reads a byte or waits. Inside the service positions
//! are ECEF, lengths metres, times seconds of GPS time, angles radians, and clocks metres (c·δt).

mod antenna;
mod base;
pub mod constants;
mod coordinates;
mod ephemeris;
mod navigation;
mod observation;
mod odometry;
mod satellite;
mod signal;
mod solution;
mod time;

pub use antenna::{
    AntennaCalibration, AntennaCatalogue, PhaseCentrePattern, SatelliteAntenna, split_antenna_name,
};
pub use base::{BaseSite, BaseStation, PositionSource};
pub use coordinates::{Ecef, Enu, Geodetic, LocalFrame};
pub use ephemeris::{
    Ephemeris, GlonassEphemeris, GroupDelays, KeplerianEphemeris, NavigationMessage,
};
pub use navigation::{KlobucharCoefficients, Navigation, NeQuickCoefficients};
pub use observation::{Cycles, Epoch, Meters, Observation};
pub use odometry::{Odometry, OdometryError, OdometryFrame, symmetric_of};
pub use satellite::{Constellation, SatelliteId, SatelliteIdError};
pub use signal::{Band, ObservationCode, Signal};
pub use solution::{
    BaseEpochIssue, Dops, EphemerisIssue, Provenance, Reason, RelativeEstimate, Solution,
    SolutionEstimate, Status, Velocity,
};
pub use time::{CivilTime, GpsTime, LeapSeconds, TimeScale, wrap_half_week};
