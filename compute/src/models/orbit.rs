//! What every kind of broadcast ephemeris gives: an orbit and a clock at one time.

use nalgebra::Vector3;

/// Position and velocity in ECEF (m, m/s).
pub(super) struct Orbit {
    pub(super) position_m: Vector3<f64>,
    pub(super) velocity_m_s: Vector3<f64>,
}

/// Clock offset (s) and drift (s/s).
#[derive(Clone, Copy)]
pub(super) struct Clock {
    pub(super) bias_s: f64,
    pub(super) drift: f64,
}
