//! The vocabulary: plain data that all other modules use.
//!
//! Time, coordinates and their frames, satellites, signals, observations, odometry, ephemerides,
//! base stations and solutions. Nothing here computes a model, reads a byte or waits. Inside the
//! service positions are ECEF, lengths metres, times seconds of GPS time, angles radians, and
//! clocks metres (c·δt).

mod antenna;
mod base;
pub mod constants;
mod coordinates;
mod ephemeris;
mod etrs89;
mod frame;
mod geoid;
mod navigation;
mod observation;
mod odometry;
mod presentation;
mod satellite;
mod signal;
mod solution;
mod time;

pub(crate) use antenna::split_antenna_name;
pub use antenna::{AntennaCalibration, AntennaCatalogue, PhaseCentrePattern};
pub(crate) use base::antenna_reference_point;
pub use base::{BaseSite, BaseStation, PositionSource};
pub use coordinates::{Ecef, Enu, Geodetic, LocalFrame};
pub use ephemeris::{
    Ephemeris, GlonassEphemeris, GroupDelays, KeplerianEphemeris, NO_PREDICTION_M,
    NavigationMessage,
};
pub use etrs89::FrameRefusal;
pub use frame::CoordinateFrame;
pub use geoid::{Geoid, GeoidGrid};
pub use navigation::{KlobucharCoefficients, Navigation, NeQuickCoefficients};
pub(crate) use observation::Meters;
pub use observation::{Cycles, Epoch, Observation};
pub use odometry::{Odometry, OdometryError, OdometryFrame, symmetric_of};
pub use presentation::{Presentation, Presented};
pub use satellite::{Constellation, SatelliteId, SatelliteIdError};
pub use signal::{Band, ObservationCode, Signal};
pub use solution::{
    BaseEpochIssue, Dops, EphemerisIssue, Protection, Provenance, Reason, RelativeEstimate,
    Solution, SolutionEstimate, Status, Velocity,
};
pub(crate) use time::wrap_half_week;
pub use time::{CivilTime, GpsTime, LeapSeconds, TimeScale};
