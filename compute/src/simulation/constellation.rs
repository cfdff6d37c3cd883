//! Nominal constellations, as the broadcast ephemerides that describe them.
//!
//! Walker constellations as published by their operators (GPS SPS PS 2020, 3.2; Galileo OS SDD 1.3,
//! 2.2; BeiDou OS PS 3.0, 3.1; GLONASS ICD 5.1, 3.3.1). Clocks and group delays are invented and
//! depend on the satellite alone, so simulations of the same time have the same sky. The elements
//! of successive issues describe one orbit: a change of issue causes no step.

use std::ops::RangeInclusive;

use nalgebra::Vector3;

use super::random::of_cell;
use crate::gnss::constants::{
    EARTH_ROTATION_RATE, EARTH_ROTATION_RATE_BEIDOU, EARTH_ROTATION_RATE_GLONASS,
    GRAVITATIONAL_CONSTANT_BEIDOU, GRAVITATIONAL_CONSTANT_GALILEO, GRAVITATIONAL_CONSTANT_GLONASS,
    GRAVITATIONAL_CONSTANT_GPS, SECONDS_PER_HOUR,
};
use crate::gnss::{
    Constellation, Ephemeris, GlonassEphemeris, GpsTime, GroupDelays, KeplerianEphemeris,
    KlobucharCoefficients, LeapSeconds, Navigation, NavigationMessage, SatelliteId,
};
use crate::models::satellite_state;

/// Seed of the random properties of satellites.
const SATELLITE_SEED: u64 = 0x6772_6170_6866_6978;
/// Semi-major axis of a geosynchronous orbit (m).
const GEOSYNCHRONOUS_AXIS: f64 = 42_164_170.0;
const GLONASS_AXIS: f64 = 25_510_000.0;
const GLONASS_INCLINATION_DEG: f64 = 64.8;
const GLONASS_INTERVAL_S: f64 = 1_800.0;
/// Channels of the slots; antipodal satellites have the same one.
const GLONASS_CHANNELS: [i8; 24] =
    [1, -4, 5, 6, 1, -4, 5, 6, -2, -7, 0, -1, -2, -7, 0, -1, 4, -3, 3, 2, 4, -3, 3, 2];
/// Tilt of the frame in which GEO elements are given; BDS-SIS-ICD-B1I-3.0, table 5-12 (deg).
const GEO_TILT_DEG: f64 = 5.0;

/// The orbit of one satellite; angles at [`reference_time`], in degrees.
struct Orbit {
    satellite: SatelliteId,
    axis_m: f64,
    eccentricity: f64,
    inclination_deg: f64,
    /// Earth-fixed longitude of the ascending node.
    node_deg: f64,
    perigee_deg: f64,
    mean_anomaly_deg: f64,
    /// Rate of the node in inertial space (rad/s).
    node_rate: f64,
}

/// Reference time of the orbits' angles.
fn reference_time() -> GpsTime {
    GpsTime::from_week_seconds(2300, 0.0)
}

/// The broadcast data for positioning between two times.
pub(super) fn navigation(
    constellations: &[Constellation],
    start: GpsTime,
    end: GpsTime,
    klobuchar: Option<KlobucharCoefficients>,
) -> Navigation {
    let mut navigation = Navigation::default();
    navigation.klobuchar_gps = klobuchar;
    for constellation in constellations {
        if *constellation == Constellation::Glonass {
            glonass(start, end, &mut navigation);
            continue;
        }
        let interval_s = match constellation {
            Constellation::Gps | Constellation::Qzss => 2.0 * SECONDS_PER_HOUR,
            _ => SECONDS_PER_HOUR,
        };
        for orbit in orbits(*constellation) {
            let first = (start.seconds_of_week() / interval_s).floor() * interval_s;
            let mut toe = start + (first - start.seconds_of_week());
            while toe < end + interval_s {
                navigation.insert(Ephemeris::Keplerian(keplerian(&orbit, toe, interval_s)));
                toe = toe + interval_s;
            }
        }
    }
    navigation
}

fn orbits(constellation: Constellation) -> Vec<Orbit> {
    match constellation {
        Constellation::Gps => Walker {
            planes: 6,
            phasing: 2,
            axis_m: 26_559_710.0,
            inclination_deg: 55.0,
            eccentricity: 0.008,
        }
        .orbits(constellation, 1..=30),
        Constellation::Galileo => Walker {
            planes: 3,
            phasing: 1,
            axis_m: 29_599_800.0,
            inclination_deg: 56.0,
            eccentricity: 0.0002,
        }
        .orbits(constellation, 1..=24),
        Constellation::BeiDou => {
            let medium = Walker {
                planes: 3,
                phasing: 1,
                axis_m: 27_906_100.0,
                inclination_deg: 55.0,
                eccentricity: 0.0008,
            };
            let mut all = medium.orbits(constellation, 19..=42);
            let inclined = (0..3).map(|k| geosynchronous(constellation, 43 + k, k, 110.0, 55.0));
            all.extend(inclined);
            let longitudes = [(59, 140.0), (60, 80.0), (61, 110.5)];
            all.extend(longitudes.map(|(number, longitude)| geostationary(number, longitude)));
            all
        }
        Constellation::Qzss => {
            let inclined = (0..3).map(|k| geosynchronous(constellation, 1 + k, k, 139.0, 41.0));
            inclined.collect()
        }
        Constellation::Glonass => Vec::new(),
    }
}

/// Walker constellation t/p/f: t satellites in p planes, phase difference f·360°/t between
/// neighbouring planes; Walker (1984).
struct Walker {
    planes: usize,
    phasing: usize,
    axis_m: f64,
    inclination_deg: f64,
    eccentricity: f64,
}

impl Walker {
    fn orbits(&self, constellation: Constellation, numbers: RangeInclusive<u8>) -> Vec<Orbit> {
        let Self { planes, phasing, axis_m, inclination_deg, eccentricity } = *self;
        let total = numbers.clone().count();
        let per_plane = total / planes;
        let orbit = |(index, number): (usize, u8)| {
            let (plane, slot) = (index / per_plane, index % per_plane);
            let phase = 360.0 * (slot as f64 / per_plane as f64)
                + 360.0 * (phasing * plane) as f64 / total as f64;
            // Constellations are rotated against one another so that they fill each other's gaps.
            let rotation_deg = 17.0 * constellation.index() as f64;
            Orbit {
                satellite: satellite(constellation, number),
                axis_m,
                eccentricity,
                inclination_deg,
                node_deg: 360.0 * plane as f64 / planes as f64 + rotation_deg,
                perigee_deg: 0.0,
                mean_anomaly_deg: phase,
                node_rate: -8e-9,
            }
        };
        numbers.enumerate().map(orbit).collect()
    }
}

/// One of three satellites on a common figure of eight around a longitude.
fn geosynchronous(
    constellation: Constellation,
    number: u8,
    index: u8,
    longitude_deg: f64,
    inclination_deg: f64,
) -> Orbit {
    let turn = 120.0 * f64::from(index);
    Orbit {
        satellite: satellite(constellation, number),
        axis_m: GEOSYNCHRONOUS_AXIS,
        eccentricity: 0.002,
        inclination_deg,
        node_deg: longitude_deg + turn,
        perigee_deg: 0.0,
        mean_anomaly_deg: -turn,
        node_rate: 0.0,
    }
}

/// A geostationary BeiDou satellite, with elements in the tilted frame of the ICD: the node of the
/// equator is at 180°, and the argument of latitude is the longitude plus 180°.
fn geostationary(number: u8, longitude_deg: f64) -> Orbit {
    Orbit {
        satellite: satellite(Constellation::BeiDou, number),
        axis_m: (GRAVITATIONAL_CONSTANT_BEIDOU / EARTH_ROTATION_RATE_BEIDOU.powi(2)).cbrt(),
        eccentricity: 0.0,
        inclination_deg: GEO_TILT_DEG,
        node_deg: 180.0,
        perigee_deg: 0.0,
        mean_anomaly_deg: longitude_deg + 180.0,
        node_rate: 0.0,
    }
}

fn satellite(constellation: Constellation, number: u8) -> SatelliteId {
    SatelliteId::new(constellation, number).expect("the tables hold numbers from 1 to 99")
}

/// A random number in −1 … 1 that depends on the satellite only.
fn trait_of(satellite: SatelliteId, what: u64) -> f64 {
    let (index, number) = (satellite.constellation.index() as i64, i64::from(satellite.number));
    2.0 * of_cell(SATELLITE_SEED, index, number, what) - 1.0
}

fn keplerian(orbit: &Orbit, toe: GpsTime, interval_s: f64) -> KeplerianEphemeris {
    let satellite = orbit.satellite;
    let is_geo = satellite.is_beidou_geo();
    let (gravity, earth_rate, toe_s) = match satellite.constellation {
        Constellation::BeiDou => {
            (GRAVITATIONAL_CONSTANT_BEIDOU, EARTH_ROTATION_RATE_BEIDOU, toe.to_beidou().1)
        }
        Constellation::Galileo => {
            (GRAVITATIONAL_CONSTANT_GALILEO, EARTH_ROTATION_RATE, toe.seconds_of_week())
        }
        _ => (GRAVITATIONAL_CONSTANT_GPS, EARTH_ROTATION_RATE, toe.seconds_of_week()),
    };
    let elapsed_s = toe - reference_time();
    let motion = (gravity / orbit.axis_m.powi(3)).sqrt();
    // In the Earth-fixed frame a geostationary satellite has the same elements at every toe.
    let (turned, moved) = match is_geo {
        true => (0.0, 0.0),
        false => ((orbit.node_rate - earth_rate) * elapsed_s, motion * elapsed_s),
    };
    let (message, group_delays) = message_of(satellite);
    let drift = 5e-12 * trait_of(satellite, 1);
    let issue = (toe.seconds_of_week() / interval_s) as u32 % 240;
    KeplerianEphemeris {
        satellite,
        message,
        toc: toe,
        toe,
        transmission_time: Some(toe - 0.5 * interval_s),
        af0_s: 3e-4 * trait_of(satellite, 0) + drift * elapsed_s,
        af1: drift,
        af2_per_s: 0.0,
        iode: issue,
        iodc: issue,
        sqrt_a: orbit.axis_m.sqrt(),
        a_dot_m_s: 0.0,
        eccentricity: orbit.eccentricity,
        m0_rad: wrap(orbit.mean_anomaly_deg.to_radians() + moved),
        delta_n_rad_s: 0.0,
        delta_n_dot_rad_s2: 0.0,
        omega_rad: orbit.perigee_deg.to_radians(),
        omega0_rad: wrap(orbit.node_deg.to_radians() + turned + earth_rate * toe_s),
        omega_dot_rad_s: orbit.node_rate,
        i0_rad: orbit.inclination_deg.to_radians(),
        idot_rad_s: 0.0,
        cuc_rad: 2e-6 * trait_of(satellite, 2) * f64::from(u8::from(!is_geo)),
        cus_rad: 8e-6 * trait_of(satellite, 3) * f64::from(u8::from(!is_geo)),
        crc_m: 200.0 * trait_of(satellite, 4) * f64::from(u8::from(!is_geo)),
        crs_m: 80.0 * trait_of(satellite, 5) * f64::from(u8::from(!is_geo)),
        cic_rad: 0.0,
        cis_rad: 0.0,
        accuracy_m: Some(2.0),
        health: 0,
        fit_interval_h: (satellite.constellation == Constellation::Gps).then_some(4.0),
        group_delays,
    }
}

/// Wraps an angle to −π … π.
fn wrap(angle_rad: f64) -> f64 {
    angle_rad - std::f64::consts::TAU * (angle_rad / std::f64::consts::TAU).round()
}

fn message_of(satellite: SatelliteId) -> (NavigationMessage, GroupDelays) {
    let delay_s = 5e-9 * trait_of(satellite, 6);
    match satellite.constellation {
        Constellation::Galileo => (
            NavigationMessage::Inav,
            GroupDelays::Galileo { bgd_e5a_s: 0.9 * delay_s, bgd_e5b_s: Some(delay_s) },
        ),
        Constellation::BeiDou => {
            let geo = satellite.is_beidou_geo();
            let message = if geo { NavigationMessage::D2 } else { NavigationMessage::D1 };
            (message, GroupDelays::BeiDou { tgd1_s: 2.0 * delay_s, tgd2_s: delay_s })
        }
        _ => (
            NavigationMessage::Lnav,
            GroupDelays::Gps {
                tgd_s: delay_s,
                isc_l1ca_s: None,
                isc_l2c_s: None,
                isc_l5i_s: None,
                isc_l5q_s: None,
                isc_l1cd_s: None,
                isc_l1cp_s: None,
            },
        ),
    }
}

/// GLONASS 24/3/1; each issue is the propagated previous one.
fn glonass(start: GpsTime, end: GpsTime, navigation: &mut Navigation) {
    // t_b is at the quarters and three quarters of UTC hours; a day has a whole number of them.
    let leap_s = LeapSeconds::table().at(start) as f64;
    let label_s = start.seconds_of_week() - leap_s - 0.5 * GLONASS_INTERVAL_S;
    let first = start - label_s.rem_euclid(GLONASS_INTERVAL_S);
    for slot in 0..24_u8 {
        let mut ephemeris = glonass_at(slot, first);
        loop {
            navigation.insert(Ephemeris::Glonass(ephemeris.clone()));
            if end <= ephemeris.toe {
                break;
            }
            let next = ephemeris.toe + GLONASS_INTERVAL_S;
            let state = satellite_state(&Ephemeris::Glonass(ephemeris.clone()), next);
            ephemeris.toe = next;
            ephemeris.transmission_time = Some(next - 0.5 * GLONASS_INTERVAL_S);
            ephemeris.position_m = state.position.0;
            ephemeris.velocity_m_s = state.velocity_m_s;
            ephemeris.clock_bias_s += ephemeris.gamma * GLONASS_INTERVAL_S;
        }
    }
}

/// Position and velocity on the circular orbit of a slot (0 … 23) at a time.
fn glonass_at(slot: u8, toe: GpsTime) -> GlonassEphemeris {
    let satellite = satellite(Constellation::Glonass, slot + 1);
    let elapsed_s = toe - reference_time();
    let motion = (GRAVITATIONAL_CONSTANT_GLONASS / GLONASS_AXIS.powi(3)).sqrt();
    let plane = f64::from(slot / 8);
    let node = (120.0 * plane + 40.0).to_radians() - EARTH_ROTATION_RATE_GLONASS * elapsed_s;
    let phase = 45.0 * f64::from(slot % 8) + 15.0 * plane;
    let (sin_u, cos_u) = (phase.to_radians() + motion * elapsed_s).sin_cos();
    let (sin_i, cos_i) = GLONASS_INCLINATION_DEG.to_radians().sin_cos();
    let (sin_node, cos_node) = node.sin_cos();
    let along = Vector3::new(cos_node, sin_node, 0.0);
    let across = Vector3::new(-sin_node * cos_i, cos_node * cos_i, sin_i);
    let position_m = (along * cos_u + across * sin_u) * GLONASS_AXIS;
    let in_space = (across * cos_u - along * sin_u) * (GLONASS_AXIS * motion);
    let rotation = Vector3::new(0.0, 0.0, EARTH_ROTATION_RATE_GLONASS);
    GlonassEphemeris {
        satellite,
        toe,
        transmission_time: Some(toe - 0.5 * GLONASS_INTERVAL_S),
        position_m,
        velocity_m_s: in_space - rotation.cross(&position_m),
        acceleration_m_s2: Vector3::zeros(),
        clock_bias_s: 1e-4 * trait_of(satellite, 0),
        gamma: 2e-12 * trait_of(satellite, 1),
        delta_tau_s: Some(5e-9 * trait_of(satellite, 6)),
        channel: GLONASS_CHANNELS[usize::from(slot)],
        health: 0,
        accuracy_m: Some(2.0),
        age_days: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::constants::SECONDS_PER_WEEK;
    use crate::models::select_ephemeris;

    fn sky(hours: f64) -> (Navigation, GpsTime) {
        let start = GpsTime::from_week_seconds(2345, SECONDS_PER_WEEK - 5_000.0);
        (navigation(&Constellation::ALL, start, start + hours * SECONDS_PER_HOUR, None), start)
    }

    /// Consecutive issues agree half way between them, also across the end of a week.
    #[test]
    fn issues_continue_one_another() {
        let (navigation, _) = sky(6.0);
        for (satellite, issues) in navigation.satellites() {
            assert!(3 <= issues.len(), "{satellite}: {} issues", issues.len());
            for pair in issues.windows(2) {
                let between = pair[0].toe() + 0.5 * (pair[1].toe() - pair[0].toe());
                let (a, b) =
                    (satellite_state(&pair[0], between), satellite_state(&pair[1], between));
                let apart = a.position.distance_m(b.position);
                assert!(apart < 2e-3, "{satellite}: {apart} m");
                assert!((a.clock_m - b.clock_m).abs() < 1e-3, "{satellite}");
            }
        }
    }

    #[test]
    fn geostationary_satellites_stand_over_their_longitude() {
        let (navigation, start) = sky(3.0);
        let geo = satellite(Constellation::BeiDou, 61);
        for minutes in [0.0, 47.0, 133.0] {
            let time = start + 60.0 * minutes;
            let ephemeris = select_ephemeris(&navigation, geo, time).unwrap();
            let position = satellite_state(ephemeris, time).position.to_geodetic();
            assert!((position.longitude_rad.to_degrees() - 110.5).abs() < 1e-3);
            assert!(position.latitude_rad.abs() < 1e-5);
        }
    }

    #[test]
    fn every_satellite_has_a_valid_ephemeris_all_the_time() {
        let (navigation, start) = sky(5.0);
        assert_eq!(navigation.satellites().count(), 30 + 24 + 30 + 24 + 3);
        for (satellite, _) in navigation.satellites() {
            for step in 0..=20 {
                let time = start + 900.0 * f64::from(step);
                assert!(select_ephemeris(&navigation, satellite, time).is_some(), "{satellite}");
            }
        }
    }
}
