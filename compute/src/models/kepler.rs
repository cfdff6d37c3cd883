//! Keplerian broadcast orbits and their clocks: GPS, Galileo, BeiDou and QZSS.
//!
//! The algorithm is IS-GPS-200N, table 20-IV (legacy) and table 30-II (CNAV: rates of A and n),
//! which Galileo OS SIS ICD 2.1, 5.1.1, and BDS-SIS-ICD-B1I-3.0, table 5-11, share except for the
//! constants; geostationary BeiDou satellites are given in a frame tilted by −5°. Velocities are
//! the same equations differentiated, as in Remondi (2004), *Computing satellite velocity using
//! the broadcast ephemeris*, GPS Solutions 8(3).

use nalgebra::Vector3;

use super::orbit::{Clock, Orbit};
use crate::gnss::constants::{
    EARTH_ROTATION_RATE, EARTH_ROTATION_RATE_BEIDOU, GRAVITATIONAL_CONSTANT_BEIDOU,
    GRAVITATIONAL_CONSTANT_GALILEO, GRAVITATIONAL_CONSTANT_GPS, SPEED_OF_LIGHT,
};
use crate::gnss::{Constellation, GpsTime, KeplerianEphemeris};

/// sin and cos of −5°, the tilt of the frame of geostationary BeiDou orbits.
const GEO_TILT_SIN: f64 = -0.087_155_742_747_658_17;
const GEO_TILT_COS: f64 = 0.996_194_698_091_745_5;

/// Iteration limit, above what any elliptical orbit needs.
const ITERATIONS_MAX: usize = 12;

/// Orbit and clock at `time`.
pub(super) fn state(e: &KeplerianEphemeris, time: GpsTime) -> (Orbit, Clock) {
    let constants = Constants::of(e.satellite.constellation);
    let t = time - e.toe;
    let anomaly = Anomaly::at(e, constants.gravitation, t);
    let plane = OrbitalPlane::at(e, &anomaly, t);
    let orbit = if e.satellite.is_beidou_geo() {
        geostationary_orbit(e, &plane, &constants, t)
    } else {
        let node = e.omega0_rad + (e.omega_dot_rad_s - constants.rotation) * t
            - constants.rotation * constants.seconds_of_week(e.toe);
        earth_fixed(&plane, node, e.omega_dot_rad_s - constants.rotation)
    };
    (orbit, clock(e, time, &constants, &anomaly))
}

/// The clock polynomial a_f0 + a_f1·t + a_f2·t² and its derivative, without relativity.
pub(super) fn clock_polynomial(e: &KeplerianEphemeris, time: GpsTime) -> Clock {
    let t = time - e.toc;
    Clock { bias_s: e.af0_s + t * (e.af1 + t * e.af2_per_s), drift: e.af1 + 2.0 * t * e.af2_per_s }
}

/// Adds the periodic relativistic term F·e·√A·sin E, F = −2√µ/c²; IS-GPS-200N, 20.3.3.3.3.1.
fn clock(e: &KeplerianEphemeris, time: GpsTime, constants: &Constants, anomaly: &Anomaly) -> Clock {
    let polynomial = clock_polynomial(e, time);
    let amplitude = constants.relativity * e.eccentricity * e.sqrt_a;
    Clock {
        bias_s: polynomial.bias_s + amplitude * anomaly.sin,
        drift: polynomial.drift + amplitude * anomaly.cos * anomaly.rate,
    }
}

/// Constants of an orbit that the constellation's interface document defines.
struct Constants {
    /// µ (m³/s²).
    gravitation: f64,
    /// ω_e (rad/s).
    rotation: f64,
    /// F = −2√µ/c² (s/√m).
    relativity: f64,
    beidou: bool,
}

impl Constants {
    fn of(constellation: Constellation) -> Self {
        let beidou = constellation == Constellation::BeiDou;
        let gravitation = match constellation {
            Constellation::Galileo => GRAVITATIONAL_CONSTANT_GALILEO,
            Constellation::BeiDou => GRAVITATIONAL_CONSTANT_BEIDOU,
            Constellation::Gps | Constellation::Qzss | Constellation::Glonass => {
                GRAVITATIONAL_CONSTANT_GPS
            }
        };
        let rotation = if beidou { EARTH_ROTATION_RATE_BEIDOU } else { EARTH_ROTATION_RATE };
        let relativity = -2.0 * gravitation.sqrt() / (SPEED_OF_LIGHT * SPEED_OF_LIGHT);
        Self { gravitation, rotation, relativity, beidou }
    }

    /// Seconds of week in the system's own time (s); Ω_0 refers to the start of that week.
    fn seconds_of_week(&self, time: GpsTime) -> f64 {
        if self.beidou { time.to_beidou().1 } else { time.seconds_of_week() }
    }
}

/// Eccentric anomaly E and the quantities derived from it.
struct Anomaly {
    sin: f64,
    cos: f64,
    /// dE/dt (rad/s).
    rate: f64,
    /// 1 − e·cos E.
    distance: f64,
}

impl Anomaly {
    /// Solves Kepler's equation M = E − e·sin E by Newton's method at `t` seconds after toe.
    fn at(e: &KeplerianEphemeris, gravitation: f64, t: f64) -> Self {
        let a = e.sqrt_a * e.sqrt_a;
        let n = gravitation.sqrt() / (a * e.sqrt_a) + e.delta_n_rad_s;
        let mean = e.m0_rad + (n + 0.5 * e.delta_n_dot_rad_s2 * t) * t;
        let mean_rate = n + e.delta_n_dot_rad_s2 * t;
        let (mut sin, mut cos) = mean.sin_cos();
        // The first two terms of the series leave an error of order e³.
        let mut eccentric = mean + e.eccentricity * sin * (1.0 + e.eccentricity * cos);
        for _ in 0..ITERATIONS_MAX {
            (sin, cos) = eccentric.sin_cos();
            let step = (mean - eccentric + e.eccentricity * sin) / (1.0 - e.eccentricity * cos);
            eccentric += step;
            (sin, cos) = (sin + step * cos, cos - step * sin);
            // A further step would change E by the order of step², below 1e-15.
            if step.abs() < 3e-8 {
                break;
            }
        }
        let distance = 1.0 - e.eccentricity * cos;
        Self { sin, cos, rate: mean_rate / distance, distance }
    }
}

/// Coordinates in the orbital plane, and the plane's inclination.
struct OrbitalPlane {
    x_m: f64,
    y_m: f64,
    x_rate_m_s: f64,
    y_rate_m_s: f64,
    inclination_sin: f64,
    inclination_cos: f64,
    /// di/dt (rad/s).
    inclination_rate: f64,
}

impl OrbitalPlane {
    /// Argument of latitude, radius and inclination with their harmonic corrections.
    fn at(e: &KeplerianEphemeris, anomaly: &Anomaly, t: f64) -> Self {
        let root = (1.0 - e.eccentricity * e.eccentricity).sqrt();
        let (perigee_sin, perigee_cos) = e.omega_rad.sin_cos();
        let true_sin = root * anomaly.sin / anomaly.distance;
        let true_cos = (anomaly.cos - e.eccentricity) / anomaly.distance;
        // φ = ν + ω, without computing ν itself.
        let sin = true_sin * perigee_cos + true_cos * perigee_sin;
        let cos = true_cos * perigee_cos - true_sin * perigee_sin;
        let rate = root * anomaly.rate / anomaly.distance;
        let (sin2, cos2) = (2.0 * sin * cos, cos * cos - sin * sin);
        let harmonic = |s: f64, c: f64| (s * sin2 + c * cos2, 2.0 * rate * (s * cos2 - c * sin2));

        let (latitude, latitude_rate) = harmonic(e.cus_rad, e.cuc_rad);
        let (radius, radius_rate) = harmonic(e.crs_m, e.crc_m);
        let (inclination, inclination_rate) = harmonic(e.cis_rad, e.cic_rad);
        let a = e.sqrt_a * e.sqrt_a + e.a_dot_m_s * t;
        let r = a * anomaly.distance + radius;
        let r_rate = e.a_dot_m_s * anomaly.distance
            + a * e.eccentricity * anomaly.sin * anomaly.rate
            + radius_rate;
        let (correction_sin, correction_cos) = latitude.sin_cos();
        let u_sin = sin * correction_cos + cos * correction_sin;
        let u_cos = cos * correction_cos - sin * correction_sin;
        let u_rate = rate + latitude_rate;
        let (inclination_sin, inclination_cos) =
            (e.i0_rad + e.idot_rad_s * t + inclination).sin_cos();
        Self {
            x_m: r * u_cos,
            y_m: r * u_sin,
            x_rate_m_s: r_rate * u_cos - r * u_sin * u_rate,
            y_rate_m_s: r_rate * u_sin + r * u_cos * u_rate,
            inclination_sin,
            inclination_cos,
            inclination_rate: e.idot_rad_s + inclination_rate,
        }
    }
}

/// Rotates the orbital plane by its inclination and by the longitude of its node.
fn earth_fixed(plane: &OrbitalPlane, node: f64, node_rate: f64) -> Orbit {
    let (node_sin, node_cos) = node.sin_cos();
    let (sin, cos) = (plane.inclination_sin, plane.inclination_cos);
    // Components along the node, perpendicular to it in the equator, and up.
    let (along, across, up) = (plane.x_m, plane.y_m * cos, plane.y_m * sin);
    let across_rate = plane.y_rate_m_s * cos - up * plane.inclination_rate;
    let up_rate = plane.y_rate_m_s * sin + across * plane.inclination_rate;
    let x = along * node_cos - across * node_sin;
    let y = along * node_sin + across * node_cos;
    Orbit {
        position_m: Vector3::new(x, y, up),
        velocity_m_s: Vector3::new(
            plane.x_rate_m_s * node_cos - across_rate * node_sin - y * node_rate,
            plane.x_rate_m_s * node_sin + across_rate * node_cos + x * node_rate,
            up_rate,
        ),
    }
}

/// R_z(ω_e·t)·R_x(−5°) of the orbit before rotation; BDS-SIS-ICD-B1I-3.0, table 5-11.
fn geostationary_orbit(
    e: &KeplerianEphemeris,
    plane: &OrbitalPlane,
    constants: &Constants,
    t: f64,
) -> Orbit {
    let node = e.omega0_rad + e.omega_dot_rad_s * t
        - constants.rotation * constants.seconds_of_week(e.toe);
    let tilted = earth_fixed(plane, node, e.omega_dot_rad_s);
    let (sin, cos) = (constants.rotation * t).sin_cos();
    let turn = |v: Vector3<f64>| {
        let y = GEO_TILT_COS * v.y + GEO_TILT_SIN * v.z;
        let z = GEO_TILT_COS * v.z - GEO_TILT_SIN * v.y;
        Vector3::new(cos * v.x + sin * y, cos * y - sin * v.x, z)
    };
    let position_m = turn(tilted.position_m);
    let carried = Vector3::new(position_m.y, -position_m.x, 0.0) * constants.rotation;
    Orbit { position_m, velocity_m_s: turn(tilted.velocity_m_s) + carried }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::sample;

    /// Position 3000 s after toe, velocity and relativistic term.
    struct Expected {
        ephemeris: KeplerianEphemeris,
        position_m: [f64; 3],
        velocity_m_s: [f64; 3],
        relativity_m: f64,
        relativity_rate_m_s: f64,
    }

    /// Computed independently with 30 digits (Python's mpmath): the true anomaly by `atan2`,
    /// velocities as differences over 2 µs.
    fn expected() -> [Expected; 4] {
        [
            Expected {
                ephemeris: sample::gps(),
                position_m: [-15_818_338.818_756_89, -9_102_854.272_342_28, 19_116_793.257_559_29],
                velocity_m_s: [-435.986_123_540_17, -2_445.617_256_121, -1_466.250_121_454_7],
                relativity_m: -7.513_594_956_095_01,
                relativity_rate_m_s: -0.000_494_836_988_529,
            },
            Expected {
                ephemeris: sample::galileo(),
                position_m: [-17_813_522.605_185_43, -7_786_018.961_189_452, 22_314_923.161_300_19],
                velocity_m_s: [-521.332_291_756_64, -2_177.767_229_918_6, -1_174.667_466_216_7],
                relativity_m: -0.190_926_416_500_047,
                relativity_rate_m_s: -1.289_016_524_27e-5,
            },
            Expected {
                ephemeris: sample::beidou_geostationary(),
                position_m: [-42_096_295.413_565_87, -1_239_300.206_026_396, 1_717_516.179_810_148],
                velocity_m_s: [-14.381_631_151_088, 10.015_734_463_904, -308.417_117_975_39],
                relativity_m: -0.412_619_915_047_008,
                relativity_rate_m_s: -2.295_662_329_57e-5,
            },
            Expected {
                ephemeris: sample::beidou(),
                position_m: [-25_116_853.344_780_01, -5_123_597.908_934_985, 33_348_220.553_856_41],
                velocity_m_s: [-609.622_363_280_06, -1_176.715_072_21, -627.522_831_811_37],
                relativity_m: -2.756_474_709_730_76,
                relativity_rate_m_s: -0.000_152_813_615_054,
            },
        ]
    }

    #[test]
    fn orbits_agree_with_a_computation_in_30_digits() {
        for case in expected() {
            let e = &case.ephemeris;
            let (orbit, clock) = state(e, e.toe + 3_000.0);
            let polynomial = clock_polynomial(e, e.toe + 3_000.0);
            let moved = (orbit.position_m - Vector3::from(case.position_m)).norm();
            assert!(moved < 1e-6, "{}: {moved} m", e.satellite);
            let faster = (orbit.velocity_m_s - Vector3::from(case.velocity_m_s)).norm();
            assert!(faster < 1e-8, "{}: {faster} m/s", e.satellite);
            let relativity_m = (clock.bias_s - polynomial.bias_s) * SPEED_OF_LIGHT;
            assert!((relativity_m - case.relativity_m).abs() < 1e-9, "{relativity_m}");
            let rate = (clock.drift - polynomial.drift) * SPEED_OF_LIGHT;
            assert!((rate - case.relativity_rate_m_s).abs() < 1e-12, "{rate}");
        }
    }

    #[test]
    fn the_polynomial_worked_by_hand() {
        // 2.5e-4 − 4.5e-12·1000 + 1e-18·1000² and −4.5e-12 + 2·1e-18·1000.
        let clock = clock_polynomial(&sample::gps(), sample::toe() + 1_000.0);
        assert!((clock.bias_s - 2.499_955_010e-4).abs() < 1e-18);
        assert!((clock.drift + 4.498e-12).abs() < 1e-24);
    }
}
