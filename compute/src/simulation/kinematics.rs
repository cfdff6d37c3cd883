//! Position and velocity of a rover.

use nalgebra::Vector3;

/// Position (m) and velocity (m/s) of the rover, east, north, up of the scenario's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Kinematics {
    pub(super) position_m: Vector3<f64>,
    pub(super) velocity_m_s: Vector3<f64>,
}
