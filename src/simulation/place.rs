//! Where a rover is and how it moves.

use nalgebra::Vector3;

/// Where the rover is and how it moves, east, north, up of the scenario's origin (m, m/s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    pub(super) position_m: Vector3<f64>,
    pub(super) velocity_m_s: Vector3<f64>,
}
