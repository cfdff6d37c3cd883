//! The range to one satellite in the local frame of a graph.

use nalgebra::Vector3;

use crate::gnss::{Ecef, LocalFrame};
use crate::models::geometric_range;
use crate::snapshot::snapshot_fields;

/// The range ρ (m) from one position, and its gradient ∂ρ/∂p.
pub(crate) type Line = (f64, Vector3<f64>);

/// A satellite as seen from positions near the origin of a local frame.
///
/// ρ(p) = ‖s − p‖ + a + gᵀp. The Sagnac term is linear in the receiver's position, so its value a
/// and its gradient g at the frame's origin are exact; s, p, g local.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sight {
    satellite_m: Vector3<f64>,
    sagnac_m: f64,
    sagnac_slope: Vector3<f64>,
}

impl Sight {
    /// Of a satellite at the transmission of its signal.
    pub(crate) fn new(frame: &LocalFrame, satellite: Ecef) -> Self {
        let line = satellite.0 - frame.origin.0;
        let distance_m = line.norm();
        let (range_m, slope) = geometric_range(satellite, frame.origin);
        Self {
            satellite_m: frame.rotation * line,
            sagnac_m: range_m - distance_m,
            sagnac_slope: frame.rotation * (slope.transpose() + line / distance_m),
        }
    }

    /// Range from a local position (m), and ∂ρ/∂p.
    #[inline]
    pub(crate) fn range(&self, position: &Vector3<f64>) -> Line {
        let line = self.satellite_m - position;
        let distance_m = line.norm();
        let range_m = distance_m + self.sagnac_m + self.sagnac_slope.dot(position);
        (range_m, self.sagnac_slope - line * distance_m.recip())
    }
}

snapshot_fields!(Sight { satellite_m, sagnac_m, sagnac_slope });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Enu;
    use crate::positioning::factors::sample::{SATELLITE, frame};

    /// The same range as in ECEF, 20 km from the origin.
    #[test]
    fn the_frame_changes_no_range() {
        let frame = frame();
        let sight = Sight::new(&frame, SATELLITE);
        let local = Vector3::new(12_000.0, -16_000.0, 300.0);
        let (expected, slope) = geometric_range(SATELLITE, frame.to_ecef(Enu(local)));
        let (range_m, gradient) = sight.range(&local);
        assert!((range_m - expected).abs() < 1e-6, "{range_m} {expected}");
        assert!((gradient - frame.rotation * slope.transpose()).norm() < 1e-12);
    }
}
