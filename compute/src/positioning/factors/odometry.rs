//! The odometry factor: another sensor's displacement between two epochs.

use nalgebra::{Matrix3, Vector3};

use crate::gnss::{Ecef, LocalFrame, Odometry, OdometryFrame};
use crate::graph::Link;
use crate::snapshot::snapshot_fields;

use super::State;

/// Largest difference between the duration of a displacement and the interval of the epochs: this
/// (s), and this part of the interval. A sensor at 50 Hz has another duration than epochs at 25 Hz.
const INTERVAL_TOLERANCE_S: f64 = 0.05;
const INTERVAL_TOLERANCE: f64 = 0.1;

/// Odometry factor between two states, three rows.
///
/// r = L⁻¹·(p₊ − p − R·d), L·Lᵀ = R·Σ·Rᵀ + σ_ψ²·u·uᵀ
///
/// d is the displacement along the sensor's axes (m), Σ its covariance (m²), R the rotation from
/// those axes to the local frame. For body axes R rotates by the heading ψ, from north to east:
/// forward is [sin ψ, cos ψ, 0], left [−cos ψ, sin ψ, 0]. u = ∂(R·d)/∂ψ = [n, −e, 0], with e and n
/// the east and north components of R·d; it propagates the heading's σ_ψ. The body is assumed
/// level: Σ must allow for slopes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OdometryFactor {
    /// R·d (m).
    displacement_m: Vector3<f64>,
    /// L⁻¹ (1/m).
    whitening: Matrix3<f64>,
}

impl OdometryFactor {
    /// The factor between epochs `interval_s` apart; `None` if the displacement has another
    /// duration, or its covariance is not positive definite.
    pub(crate) fn over(
        interval_s: f64,
        frame: &LocalFrame,
        place: Ecef,
        odometry: &Odometry,
    ) -> Option<Self> {
        let tolerance_s = INTERVAL_TOLERANCE_S.min(INTERVAL_TOLERANCE * interval_s);
        if tolerance_s < (odometry.interval_s - interval_s).abs() {
            return None;
        }
        let axes = match odometry.frame {
            OdometryFrame::Ecef => frame.rotation,
            OdometryFrame::Enu => from_enu(frame, place),
            OdometryFrame::Body { heading_rad, .. } => from_enu(frame, place) * turn(heading_rad),
        };
        let mut covariance = axes * odometry.covariance * axes.transpose();
        if let OdometryFrame::Body { heading_rad, heading_sigma_rad } = odometry.frame {
            let enu = turn(heading_rad) * odometry.displacement_m;
            let aside = from_enu(frame, place) * Vector3::new(enu.y, -enu.x, 0.0);
            covariance += aside * aside.transpose() * heading_sigma_rad.powi(2);
        }
        let lower = covariance.cholesky()?.l();
        let displacement_m = axes * odometry.displacement_m;
        Some(Self { displacement_m, whitening: lower.try_inverse()? })
    }

    /// Whitened residual `row` and its Jacobian on p and p₊.
    #[inline]
    pub(crate) fn linearize(&self, row: usize, state: &State, next: &State) -> Link<3, 3> {
        let w = [0, 1, 2].map(|column| self.whitening[(row, column)]);
        let miss = |axis: usize| next[axis] - state[axis] - self.displacement_m[axis];
        Link {
            residual: w[0] * miss(0) + w[1] * miss(1) + w[2] * miss(2),
            columns: [0, 1, 2],
            jacobian: w.map(|value| -value),
            next_columns: [0, 1, 2],
            next_jacobian: w,
        }
    }
}

snapshot_fields!(OdometryFactor { displacement_m, whitening });

/// From east, north, up at a position to the axes of the frame.
fn from_enu(frame: &LocalFrame, place: Ecef) -> Matrix3<f64> {
    frame.rotation * LocalFrame::at(place).rotation.transpose()
}

/// From forward, left, up to east, north, up.
fn turn(heading_rad: f64) -> Matrix3<f64> {
    let (sin, cos) = heading_rad.sin_cos();
    Matrix3::new(sin, -cos, 0.0, cos, sin, 0.0, 0.0, 0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{check_link, frame, next_state, state};

    fn body(heading_rad: f64, heading_sigma_rad: f64) -> Odometry {
        Odometry {
            interval_s: 1.0,
            frame: OdometryFrame::Body { heading_rad, heading_sigma_rad },
            displacement_m: Vector3::new(8.0, 1.0, 0.0),
            covariance: Matrix3::from_diagonal(&Vector3::new(0.04, 0.01, 0.25)),
        }
    }

    fn factor(odometry: &Odometry) -> OdometryFactor {
        OdometryFactor::over(1.0, &frame(), frame().origin, odometry).unwrap()
    }

    fn residuals(odometry: &Odometry) -> Vector3<f64> {
        let factor = factor(odometry);
        Vector3::from([0, 1, 2].map(|row| factor.linearize(row, &state(), &next_state()).residual))
    }

    /// Moved east 8.5, north −3, up 0.1 m. With heading east, forward 8 and left 1 is east 8, north
    /// 1: residuals of 0.5, −4 and 0.1 m over 0.2, 0.1 and 0.5 m.
    #[test]
    fn residuals_worked_by_hand() {
        let east = residuals(&body(std::f64::consts::FRAC_PI_2, 0.0));
        assert!((east - Vector3::new(2.5, -40.0, 0.2)).norm() < 1e-9, "{east}");
        // Heading north: east −1, north 8, and the standard deviations are exchanged.
        let north = residuals(&body(0.0, 0.0));
        assert!((north - Vector3::new(95.0, -55.0, 0.2)).norm() < 1e-9, "{north}");
        let enu = Odometry { frame: OdometryFrame::Enu, ..body(0.0, 0.0) };
        assert!((residuals(&enu) - Vector3::new(2.5, -40.0, 0.2)).norm() < 1e-9);
    }

    /// A sensor at 50 Hz beside epochs at 50, 25 and 16.7 Hz.
    #[test]
    fn a_displacement_of_another_duration_is_none() {
        let odometry = Odometry { interval_s: 0.02, ..body(0.0, 0.0) };
        let fits = |interval_s| {
            OdometryFactor::over(interval_s, &frame(), frame().origin, &odometry).is_some()
        };
        assert_eq!([0.02, 0.021, 0.04, 0.06].map(fits), [true, true, false, false]);
        let slow = body(0.0, 0.0);
        let fits = |interval_s| {
            OdometryFactor::over(interval_s, &frame(), frame().origin, &slow).is_some()
        };
        assert_eq!([1.04, 1.06].map(fits), [true, false]);
    }

    /// The same displacement along the Earth's axes gives the same sum of squares.
    #[test]
    fn the_axes_change_nothing() {
        let enu = Odometry { frame: OdometryFrame::Enu, ..body(0.0, 0.0) };
        let turned = frame().rotation.transpose();
        let ecef = Odometry {
            frame: OdometryFrame::Ecef,
            displacement_m: turned * enu.displacement_m,
            covariance: turned * enu.covariance * turned.transpose(),
            ..enu
        };
        let (a, b) = (residuals(&enu).norm_squared(), residuals(&ecef).norm_squared());
        assert!((a - b).abs() < 1e-6 * a, "{a} {b}");
    }

    /// 0.1 rad of heading over a distance of √65 m is 0.81 m across the track; along the track
    /// nothing changes.
    #[test]
    fn the_headings_deviation_is_across_the_way() {
        let exact = residuals(&body(1.0, 0.0)).norm_squared();
        let vague = residuals(&body(1.0, 0.1)).norm_squared();
        assert!(vague < 0.1 * exact, "{vague} of {exact}");
        let straight = Odometry { displacement_m: Vector3::new(8.0, 0.0, 0.0), ..body(0.0, 0.1) };
        let covariance = factor(&straight).whitening.try_inverse().unwrap();
        let covariance = covariance * covariance.transpose();
        assert!((covariance[(0, 0)] - (0.01 + 0.64)).abs() < 1e-9, "{covariance}");
        assert!((covariance[(1, 1)] - 0.04).abs() < 1e-9, "{covariance}");
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        let factor = factor(&body(0.7, 0.05));
        (0..3).for_each(|row| check_link(|a, b| factor.linearize(row, a, b)));
    }

    #[test]
    fn another_interval_ties_nothing() {
        let origin = frame().origin;
        assert_eq!(OdometryFactor::over(2.0, &frame(), origin, &body(0.0, 0.0)), None);
        assert!(OdometryFactor::over(1.04, &frame(), origin, &body(0.0, 0.0)).is_some());
    }
}
