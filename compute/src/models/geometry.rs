//! Ranges, range rates and angles between a receiver and a satellite.

use nalgebra::{RowVector3, Vector3};

use crate::gnss::constants::{EARTH_ROTATION_RATE, SPEED_OF_LIGHT};
use crate::gnss::{Ecef, LocalFrame};

/// Rotation of the Earth while light travels one metre (rad/m).
const ROTATION_PER_METER: f64 = EARTH_ROTATION_RATE / SPEED_OF_LIGHT;

/// Geometric range from receiver to satellite with the Sagnac term (m).
///
/// ρ = ‖s − p‖ + (ω_e/c)(s_x p_y − s_y p_x), first order in ω_e; s at transmission in the frame of
/// transmission. Also ∂ρ/∂p, 1×3.
pub fn geometric_range(satellite: Ecef, receiver: Ecef) -> (f64, RowVector3<f64>) {
    let (s, p) = (satellite.0, receiver.0);
    let k = ROTATION_PER_METER;
    let line = s - p;
    let distance = line.norm();
    let range = distance + k * (s.x * p.y - s.y * p.x);
    (range, RowVector3::new(-k * s.y, k * s.x, 0.0) - line.transpose() / distance)
}

/// Rate of the geometric range and its derivative by the receiver's velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeRate {
    /// dρ/dt in the receiver's time (m/s).
    pub rate_m_s: f64,
    /// ∂(dρ/dt)/∂v, 1×3.
    pub by_velocity: RowVector3<f64>,
}

/// Rate of [`geometric_range`] for a satellite with velocity vˢ and a receiver with velocity v.
///
/// ρ̇ = [eᵀ(vˢ − v) + (ω_e/c)(vˢ_x p_y + s_x v_y − vˢ_y p_x − s_y v_x)] / (1 + eᵀvˢ/c), e the unit
/// vector from receiver to satellite. Wen & Hsu (2021), equations (5) and (6), differ: (5) prints
/// +e for ∂ρ̇/∂v, and the Sagnac term of (6) has the opposite sign of the range's derivative (up to
/// 1 cm/s apart). The denominator comes from a time of transmission that moves at 1 − ρ̇/c; it
/// matters up to 3 mm/s.
pub fn range_rate(
    satellite: Ecef,
    satellite_velocity_m_s: &Vector3<f64>,
    receiver: Ecef,
    velocity_m_s: &Vector3<f64>,
) -> RangeRate {
    let (_, by_position) = geometric_range(satellite, receiver);
    let (p, u) = (receiver.0, satellite_velocity_m_s);
    let line = (satellite.0 - p).normalize();
    let by_satellite = line.dot(u) + ROTATION_PER_METER * (u.x * p.y - u.y * p.x);
    let scale = 1.0 / (1.0 + by_satellite / SPEED_OF_LIGHT);
    RangeRate {
        rate_m_s: (by_satellite + (by_position * velocity_m_s).x) * scale,
        by_velocity: by_position * scale,
    }
}

/// Direction from a receiver to a satellite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookAngles {
    /// Azimuth, clockwise from north (rad), 0 … 2π.
    pub azimuth_rad: f64,
    /// Elevation above the ellipsoid's horizon (rad).
    pub elevation_rad: f64,
}

/// Azimuth and elevation of a satellite from the origin of `frame`.
///
/// The Earth's rotation during the signal's travel (5 µrad) is neglected.
pub fn look_angles(frame: &LocalFrame, satellite: Ecef) -> LookAngles {
    let enu = frame.to_enu(satellite).0;
    let azimuth = enu.x.atan2(enu.y);
    let full = std::f64::consts::TAU;
    LookAngles {
        azimuth_rad: if azimuth < 0.0 { azimuth + full } else { azimuth },
        elevation_rad: enu.z.atan2(enu.x.hypot(enu.y)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Geodetic;

    const RECEIVER: Ecef = Ecef::new(-2_414_266.9, 5_386_768.9, 2_407_460.0);
    const SATELLITE: Ecef = Ecef::new(-10_000_000.0, 20_000_000.0, 14_000_000.0);
    const SATELLITE_VELOCITY: Vector3<f64> = Vector3::new(1_500.0, -1_200.0, 2_400.0);

    /// Hand-worked: 3-4-5 line along x and y, Sagnac k·(s_x p_y − s_y p_x).
    #[test]
    fn a_line_worked_by_hand() {
        let receiver = Ecef::new(6e6, 1e6, 0.0);
        let satellite = Ecef::new(21e6, 21e6, 0.0);
        let (range, _) = geometric_range(satellite, receiver);
        // √(15² + 20²)·10⁶ m and 7.2921151467e-5/299792458·(21·1 − 21·6)·10¹² = −25.540 m.
        assert!((range - (25e6 - 25.540_071_805)).abs() < 1e-6, "{range}");
    }

    #[test]
    fn the_range_has_its_derivative() {
        let (_, derivative) = geometric_range(SATELLITE, RECEIVER);
        for axis in 0..3 {
            let mut step = Vector3::zeros();
            step[axis] = 10.0;
            let (ahead, _) = geometric_range(SATELLITE, Ecef(RECEIVER.0 + step));
            let (behind, _) = geometric_range(SATELLITE, Ecef(RECEIVER.0 - step));
            assert!(((ahead - behind) / 20.0 - derivative[axis]).abs() < 1e-9);
        }
    }

    /// The Sagnac term equals rotating the satellite's position by the Earth's rotation during the
    /// signal's travel.
    #[test]
    fn sagnac_is_the_turn_of_the_frame() {
        let (range, _) = geometric_range(SATELLITE, RECEIVER);
        let angle = ROTATION_PER_METER * range;
        let s = SATELLITE.0;
        let turned = Vector3::new(
            angle.cos() * s.x + angle.sin() * s.y,
            angle.cos() * s.y - angle.sin() * s.x,
            s.z,
        );
        // Second order: ω²·(travel)²·r/2, below a millimetre.
        assert!(((turned - RECEIVER.0).norm() - range).abs() < 1e-3);
        assert!(1.0 < (SATELLITE.distance_m(RECEIVER) - range).abs(), "the term matters");
    }

    /// Range rate against the difference of ranges whose transmission times move with the range.
    #[test]
    fn the_range_rate_is_the_derivative_of_the_range() {
        let velocity = Vector3::new(12.0, -7.0, 3.0);
        let range_at = |t: f64| {
            let receiver = Ecef(RECEIVER.0 + velocity * t);
            let mut range = 0.0;
            for _ in 0..5 {
                let sent = t - range / SPEED_OF_LIGHT;
                range = geometric_range(Ecef(SATELLITE.0 + SATELLITE_VELOCITY * sent), receiver).0;
            }
            range
        };
        let sent = -range_at(0.0) / SPEED_OF_LIGHT;
        let satellite = Ecef(SATELLITE.0 + SATELLITE_VELOCITY * sent);
        let modelled = range_rate(satellite, &SATELLITE_VELOCITY, RECEIVER, &velocity);
        let measured = (range_at(0.5) - range_at(-0.5)) / 1.0;
        assert!((modelled.rate_m_s - measured).abs() < 1e-6, "{} {measured}", modelled.rate_m_s);
        let faster = range_rate(
            satellite,
            &SATELLITE_VELOCITY,
            RECEIVER,
            &(velocity + Vector3::new(0.0, 2.0, 0.0)),
        );
        assert!((faster.rate_m_s - modelled.rate_m_s - 2.0 * modelled.by_velocity.y).abs() < 1e-9);
    }

    #[test]
    fn directions_of_the_compass() {
        let origin = Geodetic::from_degrees(30.0, 95.0, 0.0).to_ecef();
        let frame = LocalFrame::at(origin);
        let at = |east, north, up| {
            let target = frame.to_ecef(crate::gnss::Enu(Vector3::new(east, north, up)));
            let angles = look_angles(&frame, target);
            (angles.azimuth_rad.to_degrees(), angles.elevation_rad.to_degrees())
        };
        let near = |a: (f64, f64), b: (f64, f64)| {
            assert!((a.0 - b.0).abs() < 1e-9 && (a.1 - b.1).abs() < 1e-9, "{a:?} {b:?}");
        };
        near(at(1e5, 0.0, 1e5), (90.0, 45.0));
        near(at(-1e5, 0.0, 0.0), (270.0, 0.0));
        near(at(-1e5, -1e5, 2e5_f64.sqrt() * 1e2), (225.0, 17.548_400_613_793_81));
    }
}
