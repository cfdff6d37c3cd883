//! Covariance of position and clocks from the satellites' directions alone.

use nalgebra::{SMatrix, SVector, Vector3};

use crate::gnss::{Constellation, Dops};

/// Number of unknowns: position, and a clock for each constellation.
const UNKNOWNS: usize = 3 + Constellation::COUNT;

/// PDOP above which the directions do not determine the position.
const PDOP_MAX: f64 = 100.0;

/// Dilutions of precision reported if the directions do not determine the position.
pub(super) const UNDETERMINED: Dops = Dops {
    gdop: f64::INFINITY,
    pdop: f64::INFINITY,
    hdop: f64::INFINITY,
    vdop: f64::INFINITY,
    tdop: f64::INFINITY,
};

/// (GᵀG)⁻¹ of local position and one clock for each constellation, with equal weights.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    inverse: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// Index of the first constellation's clock.
    clock: usize,
}

impl Geometry {
    /// From slopes ∂ρ/∂p; `None` if they do not determine the position. Clocks of constellations
    /// without slopes are fixed.
    pub(super) fn of(slopes: impl Iterator<Item = (Constellation, Vector3<f64>)>) -> Option<Self> {
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut clock = UNKNOWNS;
        for (constellation, slope) in slopes {
            let mut row = SVector::<f64, UNKNOWNS>::zeros();
            row.fixed_rows_mut::<3>(0).copy_from(&slope);
            row[3 + constellation.index()] = 1.0;
            clock = clock.min(3 + constellation.index());
            normal += row * row.transpose();
        }
        for place in 3..UNKNOWNS {
            if normal[(place, place)] == 0.0 {
                normal[(place, place)] = 1.0;
            }
        }
        let inverse = normal.cholesky().filter(|_| clock < UNKNOWNS)?.inverse();
        let pdop_squared = inverse.fixed_view::<3, 3>(0, 0).trace();
        (pdop_squared < PDOP_MAX * PDOP_MAX).then_some(Self { inverse, clock })
    }

    /// The dilutions of precision.
    pub(super) fn dops(&self) -> Dops {
        let horizontal = self.inverse[(0, 0)] + self.inverse[(1, 1)];
        let (vertical, time) = (self.inverse[(2, 2)], self.inverse[(self.clock, self.clock)]);
        Dops {
            gdop: (horizontal + vertical + time).sqrt(),
            pdop: (horizontal + vertical).sqrt(),
            hdop: horizontal.sqrt(),
            vdop: vertical.sqrt(),
            tdop: time.sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six directions along the axes and one clock: GᵀG = diag(2, 2, 2, 6).
    #[test]
    fn six_directions_worked_by_hand() {
        let axes = (0..6).map(|i| {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            (Constellation::Galileo, Vector3::ith(i / 2, sign))
        });
        let dops = Geometry::of(axes).unwrap().dops();
        assert!((dops.pdop - 1.5_f64.sqrt()).abs() < 1e-12);
        assert!((dops.hdop - 1.0).abs() < 1e-12);
        assert!((dops.tdop - 6.0_f64.sqrt().recip()).abs() < 1e-12);
        assert!(Geometry::of([(Constellation::Gps, Vector3::x())].into_iter()).is_none());
    }
}
