//! Displacements between epochs, measured by another sensor.

use nalgebra::{Matrix3, Vector3};

/// Axes of a displacement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OdometryFrame {
    /// Earth-centred, Earth-fixed axes (ECEF).
    Ecef,
    /// East, north, up at the antenna.
    Enu,
    /// Forward, left and up of a level body: x, y, z of ISO 8855.
    Body {
        /// Heading of the forward axis, clockwise from north, midway through the displacement
        /// (rad).
        heading_rad: f64,
        /// Standard deviation of the heading (rad).
        heading_sigma_rad: f64,
    },
}

impl OdometryFrame {
    /// The name in the API and in files.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Ecef => "ecef",
            Self::Enu => "enu",
            Self::Body { .. } => "body",
        }
    }
}

/// A displacement of the antenna since the previous epoch.
///
/// Its errors are modelled as normal and independent between displacements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odometry {
    /// Duration of the displacement, up to the epoch's time (s). It is used only if the epochs are
    /// this far apart.
    pub interval_s: f64,
    /// Axes of displacement and covariance.
    pub frame: OdometryFrame,
    /// Vector from the antenna's previous position to its present one (m).
    pub displacement_m: Vector3<f64>,
    /// Covariance of the displacement, 3×3, symmetric and positive definite (m²), without the
    /// heading's error.
    pub covariance: Matrix3<f64>,
}

/// Why a displacement is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum OdometryError {
    /// The interval is outside its range, or not a number.
    #[error("an interval of {interval_s} s is not in {INTERVAL_MIN_S} to {INTERVAL_MAX_S} s")]
    Interval {
        /// The interval given (s).
        interval_s: f64,
    },
    /// A component is too large, or not a number.
    #[error("a displacement of {value_m} m is invalid: at most {DISPLACEMENT_MAX_M} m an axis")]
    Displacement {
        /// The component along one axis (m).
        value_m: f64,
    },
    /// The covariance is not symmetric and positive definite.
    #[error("the covariance is not positive definite")]
    Covariance,
    /// The heading or its deviation is not a number, or the deviation is negative.
    #[error("a heading is needed with a deviation of zero or more")]
    Heading,
}

const INTERVAL_MIN_S: f64 = 1e-3;
const INTERVAL_MAX_S: f64 = 3_600.0;
const DISPLACEMENT_MAX_M: f64 = 1e6;
/// Smallest ratio of a component's conditional variance, given the previous ones, to its variance.
const PIVOT_RATIO_MIN: f64 = 1e-9;

impl Odometry {
    /// The displacement, if it is valid.
    ///
    /// # Errors
    /// The first value that is invalid.
    pub fn checked(self) -> Result<Self, OdometryError> {
        if !(INTERVAL_MIN_S..=INTERVAL_MAX_S).contains(&self.interval_s) {
            return Err(OdometryError::Interval { interval_s: self.interval_s });
        }
        // NaN is in no range, so it is refused.
        let allowed_m = -DISPLACEMENT_MAX_M..=DISPLACEMENT_MAX_M;
        if let Some(value_m) = self.displacement_m.iter().find(|v| !allowed_m.contains(v)) {
            return Err(OdometryError::Displacement { value_m: *value_m });
        }
        if !is_covariance(&self.covariance) {
            return Err(OdometryError::Covariance);
        }
        if let OdometryFrame::Body { heading_rad, heading_sigma_rad } = self.frame {
            let is_right =
                heading_rad.is_finite() && (0.0..f64::INFINITY).contains(&heading_sigma_rad);
            if !is_right {
                return Err(OdometryError::Heading);
            }
        }
        Ok(self)
    }
}

/// Whether a matrix is symmetric and positive definite beyond rounding errors.
fn is_covariance(matrix: &Matrix3<f64>) -> bool {
    let is_finite = matrix.iter().all(|value| value.is_finite());
    let Some(factor) = matrix.cholesky().filter(|_| is_finite && *matrix == matrix.transpose())
    else {
        return false;
    };
    let pivots = factor.l_dirty().diagonal();
    (0..3).all(|axis| PIVOT_RATIO_MIN * matrix[(axis, axis)] < pivots[axis] * pivots[axis])
}

/// The symmetric matrix with the elements xx, yy, zz, xy, xz, yz.
pub fn symmetric_of([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> Matrix3<f64> {
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn odometry() -> Odometry {
        Odometry {
            interval_s: 1.0,
            frame: OdometryFrame::Body { heading_rad: 1.0, heading_sigma_rad: 0.0 },
            displacement_m: Vector3::new(8.0, 0.0, 0.0),
            covariance: symmetric_of([0.04, 0.01, 0.01, 0.01, 0.0, 0.0]),
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        assert_eq!(odometry().checked(), Ok(odometry()));
        for interval_s in [0.0, -1.0, f64::NAN, 1e5] {
            let refused = Odometry { interval_s, ..odometry() }.checked();
            assert!(matches!(refused, Err(OdometryError::Interval { .. })), "{interval_s}");
        }
        let displacement_m = Vector3::new(0.0, f64::NAN, 0.0);
        let refused = Odometry { displacement_m, ..odometry() }.checked();
        assert!(matches!(refused, Err(OdometryError::Displacement { .. })));
        let correlated = [1.0, 1.0, 1.0, 1.5, 0.0, 0.0];
        for values in [[0.0; 6], [0.04; 6], correlated, [f64::NAN; 6]] {
            let covariance = symmetric_of(values);
            let refused = Odometry { covariance, ..odometry() }.checked();
            assert_eq!(refused, Err(OdometryError::Covariance), "{values:?}");
        }
        let frame = OdometryFrame::Body { heading_rad: 0.0, heading_sigma_rad: -0.1 };
        assert_eq!(Odometry { frame, ..odometry() }.checked(), Err(OdometryError::Heading));
    }
}
