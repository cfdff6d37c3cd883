//! A solution row with its reference position.

use nalgebra::{Matrix2, Vector2, Vector3};

use crate::formats::pos::PosRow;
use crate::gnss::{Ecef, Enu, GpsTime, LocalFrame};

/// A solution row with its reference position.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgedEpoch {
    /// GPS time with the shift of the criteria.
    pub time: GpsTime,
    /// RTKLIB's quality number: 1 fixed, 2 float, 5 single, …
    pub quality: i64,
    /// Reference position, ECEF (m).
    pub reference: Ecef,
    /// Solution minus reference in the reference's frame (m).
    pub error: Enu,
    /// Stated standard deviations, east, north, up (m), if the row has a covariance.
    pub stated_sigma_m: Option<Vector3<f64>>,
    /// Normalised squared errors eᵀC⁻¹e in 2D and 3D, if the covariance is invertible.
    pub normalised_squares: Option<(f64, f64)>,
}

impl JudgedEpoch {
    /// Judges a row at `time` against the reference position.
    pub(super) fn of(time: GpsTime, row: &PosRow, reference: Ecef) -> Self {
        let frame = LocalFrame::at(reference);
        let error = frame.to_enu(row.position);
        let covariance = row.covariance.map(|ecef| frame.covariance_to_enu(&ecef));
        let stated_sigma_m = covariance.map(|c| c.diagonal().map(f64::sqrt));
        let normalised_squares = covariance.and_then(|covariance| {
            let horizontal: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
            let e2: Vector2<f64> = error.0.xy();
            let square_2d = e2.dot(&horizontal.cholesky()?.solve(&e2));
            let square_3d = error.0.dot(&covariance.cholesky()?.solve(&error.0));
            Some((square_2d, square_3d))
        });
        Self { time, quality: row.quality, reference, error, stated_sigma_m, normalised_squares }
    }

    /// Horizontal error (m).
    pub(crate) fn error_2d_m(&self) -> f64 {
        self.error.0.xy().norm()
    }

    /// Three-dimensional error (m).
    pub(crate) fn error_3d_m(&self) -> f64 {
        self.error.0.norm()
    }
}
