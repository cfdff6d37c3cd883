//! Earth-centred, geodetic and local coordinates on WGS 84.

use nalgebra::{Matrix3, Vector3};

use super::constants::{WGS84_ECCENTRICITY_SQUARED as E2, WGS84_FLATTENING, WGS84_SEMI_MAJOR_AXIS};

/// Earth-centred, Earth-fixed position (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ecef(pub Vector3<f64>);

/// Geodetic position on WGS 84.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Geodetic latitude (rad).
    pub latitude_rad: f64,
    /// Longitude (rad), east positive.
    pub longitude_rad: f64,
    /// Height above the ellipsoid (m).
    pub height_m: f64,
}

/// East, north, up (m) in a local frame that the caller names.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enu(pub Vector3<f64>);

impl Ecef {
    /// The position with these ECEF coordinates (m).
    pub const fn new(x: f64, y: f64, z: f64) -> Self {
        Self(Vector3::new(x, y, z))
    }

    /// Geodetic coordinates, exact to well under a micrometre from −10 km to 30 000 km.
    ///
    /// Bowring (1985), *The accuracy of geodetic latitude and height equations*, Survey Review 28,
    /// with one Newton-like refinement; the Earth's axis is handled.
    pub fn to_geodetic(self) -> Geodetic {
        let (x, y, z) = (self.0.x, self.0.y, self.0.z);
        let b = WGS84_SEMI_MAJOR_AXIS * (1.0 - WGS84_FLATTENING);
        let second_e2 = E2 / (1.0 - E2);
        let p = x.hypot(y);
        let mut tan_reduced = z * WGS84_SEMI_MAJOR_AXIS / (p * b).max(f64::MIN_POSITIVE)
            * (1.0 + second_e2 * b / p.hypot(z).max(1.0));
        let mut latitude_rad = 0.0;
        for _ in 0..3 {
            let cos = 1.0 / (1.0 + tan_reduced * tan_reduced).sqrt();
            let sin = if tan_reduced.is_finite() { tan_reduced * cos } else { z.signum() };
            let up = z + second_e2 * b * sin.powi(3);
            let out = p - E2 * WGS84_SEMI_MAJOR_AXIS * cos.powi(3);
            latitude_rad = up.atan2(out);
            tan_reduced = (1.0 - WGS84_FLATTENING) * up / out.max(f64::MIN_POSITIVE);
        }
        let (sin, cos) = latitude_rad.sin_cos();
        let height_m = p * cos + z * sin - WGS84_SEMI_MAJOR_AXIS * (1.0 - E2 * sin * sin).sqrt();
        Geodetic { latitude_rad, longitude_rad: y.atan2(x), height_m }
    }

    /// Straight-line distance (m).
    pub fn distance_m(self, other: Self) -> f64 {
        (self.0 - other.0).norm()
    }
}

impl Geodetic {
    /// The position at a latitude (degrees), longitude (degrees) and height (m).
    pub const fn from_degrees(latitude: f64, longitude: f64, height_m: f64) -> Self {
        Self {
            latitude_rad: latitude.to_radians(),
            longitude_rad: longitude.to_radians(),
            height_m,
        }
    }

    /// Earth-centred, Earth-fixed coordinates.
    pub fn to_ecef(self) -> Ecef {
        let (sin_lat, cos_lat) = self.latitude_rad.sin_cos();
        let (sin_lon, cos_lon) = self.longitude_rad.sin_cos();
        let normal = WGS84_SEMI_MAJOR_AXIS / (1.0 - E2 * sin_lat * sin_lat).sqrt();
        let horizontal = (normal + self.height_m) * cos_lat;
        Ecef::new(
            horizontal * cos_lon,
            horizontal * sin_lon,
            (normal * (1.0 - E2) + self.height_m) * sin_lat,
        )
    }
}

/// The local east, north, up frame at an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    /// Origin of east, north and up, ECEF (m).
    pub origin: Ecef,
    /// Rotation from ECEF differences to ENU, 3×3, with rows east, north, up.
    pub rotation: Matrix3<f64>,
}

impl LocalFrame {
    /// The frame at `origin`, with up along the ellipsoid's normal.
    pub fn at(origin: Ecef) -> Self {
        let geodetic = origin.to_geodetic();
        let (sin_lat, cos_lat) = geodetic.latitude_rad.sin_cos();
        let (sin_lon, cos_lon) = geodetic.longitude_rad.sin_cos();
        #[rustfmt::skip]
        let rotation = Matrix3::new(
            -sin_lon,           cos_lon,            0.0,
            -sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat,
            cos_lat * cos_lon,  cos_lat * sin_lon,  sin_lat,
        );
        Self { origin, rotation }
    }

    /// Local coordinates of an ECEF position (m).
    pub fn to_enu(&self, position: Ecef) -> Enu {
        Enu(self.rotation * (position.0 - self.origin.0))
    }

    /// ECEF position of local coordinates (m).
    pub fn to_ecef(&self, enu: Enu) -> Ecef {
        Ecef(self.origin.0 + self.rotation.transpose() * enu.0)
    }

    /// An ECEF covariance rotated into this frame, 3×3 (m²).
    pub fn covariance_to_enu(&self, covariance: &Matrix3<f64>) -> Matrix3<f64> {
        self.rotation * covariance * self.rotation.transpose()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_point_of_the_equator_and_the_poles() {
        let a = WGS84_SEMI_MAJOR_AXIS;
        assert!(
            Geodetic::from_degrees(0.0, 90.0, 1.0).to_ecef().distance_m(Ecef::new(
                0.0,
                a + 1.0,
                0.0
            )) < 1e-8
        );
        for sign in [1.0, -1.0] {
            let b = a * (1.0 - WGS84_FLATTENING);
            let pole = Ecef::new(0.0, 0.0, sign * (b + 7.0)).to_geodetic();
            assert!((pole.latitude_rad - sign * std::f64::consts::FRAC_PI_2).abs() < 1e-12);
            assert!((pole.height_m - 7.0).abs() < 1e-6);
        }
    }

    #[test]
    fn up_is_up() {
        let frame = LocalFrame::at(Geodetic::from_degrees(22.3, 114.2, 5.0).to_ecef());
        let above = Geodetic::from_degrees(22.3, 114.2, 15.0).to_ecef();
        assert!((frame.to_enu(above).0 - Vector3::new(0.0, 0.0, 10.0)).norm() < 1e-8);
        assert!(frame.to_ecef(frame.to_enu(above)).distance_m(above) < 1e-8);
    }

    proptest! {
        /// Geodetic → ECEF → geodetic moves no point by 0.1 mm, from −10 km to 30 000 km.
        #[test]
        fn geodetic_round_trip(lat in -90.0..90.0, lon in -180.0..180.0, height_m in -1e4..3e7) {
            let there = Geodetic::from_degrees(lat, lon, height_m).to_ecef();
            prop_assert!(there.to_geodetic().to_ecef().distance_m(there) < 1e-4);
        }
    }
}
