//! Test skies: the estimators with observations whose truth is known exactly.

use nalgebra::Vector3;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    BaseStation, Constellation, Cycles, Ecef, Enu, Ephemeris, Epoch, Geodetic, GpsTime,
    GroupDelays, KeplerianEphemeris, LocalFrame, Navigation, NavigationMessage, Observation,
    ObservationCode, Reason, SatelliteId, Solution, Status,
};
use crate::models::{geometric_range, look_angles, range_rate, state_at_transmission};

use super::{Aiding, BaseAiding, Estimator, SatelliteRole, satellite_views};

const CLOCK_M: f64 = 1_234.5;
const DRIFT_M_S: f64 = 0.7;

fn tag() -> GpsTime {
    GpsTime::from_week_seconds(2244, 36_000.0)
}

fn receiver() -> Ecef {
    Geodetic::from_degrees(22.3, 114.2, 30.0).to_ecef()
}

fn velocity_m_s() -> Vector3<f64> {
    Vector3::new(3.0, -4.0, 1.5)
}

fn ephemeris(satellite: SatelliteId, node_rad: f64, anomaly_rad: f64) -> Ephemeris {
    let gps = satellite.to_string().starts_with('G');
    Ephemeris::Keplerian(KeplerianEphemeris {
        satellite,
        message: if gps { NavigationMessage::Lnav } else { NavigationMessage::Inav },
        toc: tag(),
        toe: tag(),
        transmission_time: None,
        af0_s: 1e-5,
        af1: 0.0,
        af2_per_s: 0.0,
        iode: 1,
        iodc: 1,
        sqrt_a: 5_153.6,
        a_dot_m_s: 0.0,
        eccentricity: 0.005,
        m0_rad: anomaly_rad,
        delta_n_rad_s: 0.0,
        delta_n_dot_rad_s2: 0.0,
        omega_rad: 0.3,
        omega0_rad: node_rad,
        omega_dot_rad_s: 0.0,
        i0_rad: 0.96,
        idot_rad_s: 0.0,
        cuc_rad: 0.0,
        cus_rad: 0.0,
        crc_m: 0.0,
        crs_m: 0.0,
        cic_rad: 0.0,
        cis_rad: 0.0,
        accuracy_m: Some(2.0),
        health: 0,
        fit_interval_h: Some(4.0),
        group_delays: match gps {
            true => GroupDelays::Gps {
                tgd_s: 0.0,
                isc_l1ca_s: None,
                isc_l2c_s: None,
                isc_l5i_s: None,
                isc_l5q_s: None,
                isc_l1cd_s: None,
                isc_l1cp_s: None,
            },
            false => GroupDelays::Galileo { bgd_e5a_s: 0.0, bgd_e5b_s: Some(0.0) },
        },
    })
}

/// The receiver's observation of a satellite: exact pseudorange and Doppler.
fn observation(ephemeris: &Ephemeris) -> Observation {
    let moment = Moment { time: tag(), receiver: receiver(), velocity_m_s: velocity_m_s() };
    Observation { carrier_phase: None, ..moment.observation(ephemeris) }
}

/// A receiver at one time.
struct Moment {
    time: GpsTime,
    receiver: Ecef,
    velocity_m_s: Vector3<f64>,
}

impl Moment {
    /// Exact pseudorange, phase and Doppler of a satellite.
    fn observation(&self, ephemeris: &Ephemeris) -> Observation {
        let Self { time, receiver, velocity_m_s } = self;
        let clock_m = CLOCK_M + DRIFT_M_S * (*time - tag());
        let mut pseudorange_m = 2.2e7;
        let mut state = state_at_transmission(ephemeris, *time, pseudorange_m);
        for _ in 0..8 {
            let range_m = geometric_range(state.position, *receiver).0;
            pseudorange_m = range_m + clock_m - state.clock_m;
            state = state_at_transmission(ephemeris, *time, pseudorange_m);
        }
        let rate = range_rate(state.position, &state.velocity_m_s, *receiver, velocity_m_s);
        let rate_m_s = rate.rate_m_s + DRIFT_M_S - state.clock_drift_m_s;
        let per_meter = 1_575.42e6 / SPEED_OF_LIGHT;
        Observation {
            pseudorange_m: Some(pseudorange_m),
            carrier_phase: Some(Cycles(pseudorange_m * per_meter)),
            doppler_hz: Some(-rate_m_s * per_meter),
            cn0_db_hz: Some(45.0),
            ..Observation::empty(ephemeris.satellite(), ObservationCode::parse("1C").unwrap())
        }
    }
}

/// Satellites of constellation `letter` above 20°, with their observations.
fn sky(letter: char, count: usize, navigation: &mut Navigation) -> Vec<Observation> {
    let frame = LocalFrame::at(receiver());
    let mut observations = Vec::new();
    let mut number = 1;
    for node in 0..12 {
        for slot in 0..12 {
            if observations.len() == count {
                return observations;
            }
            let satellite: SatelliteId = format!("{letter}{number:02}").parse().unwrap();
            let offset = if letter == 'G' { 0.0 } else { 0.31 };
            let (node_rad, anomaly_rad) =
                (f64::from(node) * 0.93 + offset, f64::from(slot) * 0.71 + offset);
            let ephemeris = ephemeris(satellite, node_rad, anomaly_rad);
            let state = state_at_transmission(&ephemeris, tag(), 2.2e7);
            if 20_f64.to_radians() < look_angles(&frame, state.position).elevation_rad {
                observations.push(observation(&ephemeris));
                navigation.insert(ephemeris);
                number += 1;
            }
        }
    }
    observations
}

fn options() -> PositioningOptions {
    let mut options = PositioningOptions::new(Mode::Spp, Profile::General);
    for (key, value) in [("ionosphere", "none"), ("troposphere", "none")] {
        options.set(key, value).unwrap();
    }
    options
}

fn solve(observations: Vec<Observation>, navigation: &Navigation) -> Solution {
    let epoch = Epoch { observations, ..Epoch::new(tag()) };
    Estimator::new(options()).advance(&epoch, &Aiding::alone(navigation))
}

fn error_m(solution: &Solution) -> f64 {
    solution.estimate.as_ref().unwrap().position.distance_m(receiver())
}

#[test]
fn exact_observations_give_the_exact_position_velocity_and_clocks() {
    let mut navigation = Navigation::default();
    let mut observations = sky('G', 7, &mut navigation);
    observations.extend(sky('E', 5, &mut navigation));
    let solution = solve(observations, &navigation);
    let estimate = solution.estimate.as_ref().unwrap();
    // 1 ns of transmission time is a few micrometres of orbit.
    assert!(error_m(&solution) < 1e-4, "{}", error_m(&solution));
    assert!((estimate.clock_m - CLOCK_M).abs() < 1e-4);
    assert!(estimate.inter_system_biases_m[0].1.abs() < 1e-4);
    let velocity = estimate.velocity.unwrap();
    assert!((velocity.velocity_m_s - velocity_m_s()).norm() < 1e-5);
    assert!((velocity.clock_drift_m_s - DRIFT_M_S).abs() < 1e-5);
    assert_eq!((solution.reasons.len(), estimate.satellites_used.len()), (0, 12));
}

#[test]
fn order_and_duplicates_change_nothing() {
    let mut navigation = Navigation::default();
    let observations = sky('G', 8, &mut navigation);
    let expected = solve(observations.clone(), &navigation).estimate.unwrap();
    let mut doubled = observations.clone();
    doubled.extend(observations.iter().rev().copied());
    let reversed: Vec<_> = observations.into_iter().rev().collect();
    for other in [reversed, doubled] {
        let estimate = solve(other, &navigation).estimate.unwrap();
        assert!(estimate.position.distance_m(expected.position) < 1e-6);
        assert_eq!(estimate.satellites_used, expected.satellites_used);
    }
}

#[test]
fn a_reflected_satellite_is_excluded_by_name() {
    let mut navigation = Navigation::default();
    let mut observations = sky('G', 9, &mut navigation);
    let reflected = observations[4].satellite;
    observations[4].pseudorange_m = observations[4].pseudorange_m.map(|range| range + 150.0);
    let solution = solve(observations, &navigation);
    assert!(error_m(&solution) < 1e-4);
    assert_eq!(solution.reasons, [Reason::SatellitesExcluded { satellites: vec![reflected] }]);
}

/// A view has the error as residual, the direction, and why a satellite is not used.
#[test]
fn satellites_are_viewed_from_the_answer() {
    let mut navigation = Navigation::default();
    let mut observations = sky('G', 9, &mut navigation);
    let reflected = observations[4].satellite;
    observations[4].pseudorange_m = observations[4].pseudorange_m.map(|range| range + 150.0);
    observations[5].loss_of_lock = true;
    let unknown: SatelliteId = "E30".parse().unwrap();
    observations.push(Observation { satellite: unknown, ..observations[0] });
    let solution = solve(observations.clone(), &navigation);
    let epoch = Epoch { observations, ..Epoch::new(tag()) };
    let views = satellite_views(&epoch, &solution, &navigation, &options());
    let frame = LocalFrame::at(receiver());
    for (index, view) in views.iter().enumerate() {
        let role = match index {
            4 => SatelliteRole::Excluded,
            9 => SatelliteRole::NoEphemeris,
            _ => SatelliteRole::Used,
        };
        assert_eq!((view.role, view.is_slipped), (role, index == 5), "{view:?}");
        if view.satellite == unknown {
            assert_eq!((view.look, view.residual_m), (None, None));
            continue;
        }
        let off_m = if view.satellite == reflected { 150.0 } else { 0.0 };
        assert!((view.residual_m.unwrap() - off_m).abs() < 1e-3, "{view:?}");
        let ephemeris = &navigation.of(view.satellite)[0];
        let state = state_at_transmission(ephemeris, tag(), 2.2e7);
        let look = look_angles(&frame, state.position);
        // Signals travel 70 to 90 ms, in which a satellite moves by 0.3 km.
        assert!((view.look.unwrap().azimuth_rad - look.azimuth_rad).abs() < 1e-3, "{view:?}");
        assert!((view.look.unwrap().elevation_rad - look.elevation_rad).abs() < 1e-4, "{view:?}");
    }
}

/// Three of twelve satellites have errors of a light-millisecond, an arbitrary range and 5 km.
/// Least squares from the Earth's centre converges hundreds of kilometres away because of them.
#[test]
fn wild_pseudoranges_are_left_out_by_name() {
    let mut navigation = Navigation::default();
    let mut observations = sky('G', 7, &mut navigation);
    observations.extend(sky('E', 5, &mut navigation));
    let mut wild = Vec::new();
    for (index, off_m) in [(1, SPEED_OF_LIGHT * 1e-3), (4, -3e6), (9, 5e3)] {
        let range_m = observations[index].pseudorange_m.as_mut().unwrap();
        *range_m += off_m;
        wild.push(observations[index].satellite);
    }
    wild.sort_unstable();
    let solution = solve(observations, &navigation);
    assert!(error_m(&solution) < 1e-4, "{} {:?}", error_m(&solution), solution.reasons);
    assert_eq!(solution.reasons, [Reason::SatellitesExcluded { satellites: wild }]);
}

/// Of two ephemerides with one toe the later in the list is used. If it is wrong, the pseudorange
/// shows that the other one is right.
#[test]
fn of_contradictory_ephemerides_the_pseudorange_decides() {
    let mut navigation = Navigation::default();
    let observations = sky('G', 8, &mut navigation);
    let satellite = observations[3].satellite;
    let Some(Ephemeris::Keplerian(right)) = navigation.of(satellite).first().cloned() else {
        panic!("the sky has ephemerides of Keplerian orbits");
    };
    let af0_s = right.af0_s - 1.3e-3;
    navigation.insert(Ephemeris::Keplerian(KeplerianEphemeris { af0_s, iode: 2, ..right }));
    let solution = solve(observations, &navigation);
    assert!(error_m(&solution) < 1e-4, "{} {:?}", error_m(&solution), solution.reasons);
    assert!(solution.reasons.is_empty(), "{:?}", solution.reasons);
    let issues = &solution.provenance.ephemerides;
    assert!(issues.iter().all(|issue| issue.issue == 1), "{issues:?}");
}

/// Galileo's clock is known from an epoch of many satellites, so that later three GPS and two
/// Galileo satellites give a position with redundancy.
#[test]
fn known_clocks_make_up_for_few_satellites() {
    let mut navigation = Navigation::default();
    let (mut gps, mut galileo) = (sky('G', 7, &mut navigation), sky('E', 5, &mut navigation));
    galileo.iter_mut().for_each(|o| o.pseudorange_m = o.pseudorange_m.map(|range| range + 250.0));
    let mut options = PositioningOptions::new(Mode::Spp, Profile::General);
    for (key, value) in [("ionosphere", "none"), ("troposphere", "none")] {
        options.set(key, value).unwrap();
    }
    let mut estimator = Estimator::new(options);
    let mut few = gps.split_off(4);
    few.push(galileo[0]);
    let mut answer = |observations: Vec<Observation>| {
        let epoch = Epoch { observations, ..Epoch::new(tag()) };
        estimator.advance(&epoch, &Aiding::alone(&navigation))
    };
    assert_eq!(answer(few.clone()).status, Status::None);
    answer([gps, galileo].concat());
    let solution = answer(few.clone());
    assert!(error_m(&solution) < 1e-2, "{}", error_m(&solution));
    assert_eq!(solution.reasons, [Reason::NoRedundancy]);
    assert!((solution.estimate.unwrap().inter_system_biases_m[0].1 - 250.0).abs() < 1e-2);
}

#[test]
fn too_few_satellites_are_answered_with_the_reason() {
    let mut navigation = Navigation::default();
    let mut observations = sky('G', 3, &mut navigation);
    let three = solve(observations.clone(), &navigation);
    assert_eq!(three.status, Status::None);
    assert_eq!(three.reasons, [Reason::TooFewSatellites { used: 3, needed: 4 }]);
    // A second constellation's only satellite brings its own unknown.
    observations.extend(sky('E', 1, &mut navigation));
    let four = solve(observations, &navigation);
    assert_eq!(four.reasons, [Reason::TooFewSatellites { used: 4, needed: 5 }]);
}

#[test]
fn four_satellites_give_a_position_that_cannot_be_checked() {
    let mut navigation = Navigation::default();
    let mut observations = sky('G', 4, &mut navigation);
    observations.extend(sky('E', 1, &mut navigation));
    let solution = solve(observations, &navigation);
    assert!(solution.reasons.contains(&Reason::NoRedundancy), "{:?}", solution.reasons);
    assert!(error_m(&solution) < 1e-2, "{}", error_m(&solution));
    assert_eq!(solution.estimate.unwrap().satellites_used.len(), 4);
}

#[test]
fn a_satellite_without_ephemeris_is_named() {
    let mut navigation = Navigation::default();
    let mut observations = sky('G', 6, &mut navigation);
    let unknown = "G31".parse().unwrap();
    observations.push(Observation { satellite: unknown, ..observations[0] });
    let solution = solve(observations, &navigation);
    assert_eq!(solution.reasons, [Reason::EphemerisMissing { satellites: vec![unknown] }]);
}

/// After ten minutes at rest a drone climbs with 5 m/s. Doppler, phases and pseudoranges agree on
/// it, and the learnt vertical velocity of millimetres a second does not outweigh them.
#[test]
fn a_climb_after_a_long_rest_is_followed() {
    let mut navigation = Navigation::default();
    sky('G', 8, &mut navigation);
    let options = PositioningOptions { mode: Mode::Fgo, ..options() };
    let (mut estimator, frame) = (Estimator::new(options), LocalFrame::at(receiver()));
    for second in 0..660 {
        let climbed_s = f64::from((second - 600).max(0));
        let up = Vector3::new(0.0, 0.0, 5.0);
        let at_m_s =
            if 0.0 < climbed_s { frame.rotation.transpose() * up } else { Vector3::zeros() };
        let moment = Moment {
            time: tag() + f64::from(second),
            receiver: frame.to_ecef(Enu(up * climbed_s)),
            velocity_m_s: at_m_s,
        };
        let all = navigation.satellites().flat_map(|(_, list)| list);
        let observations = all.map(|ephemeris| moment.observation(ephemeris)).collect();
        let epoch = Epoch { observations, ..Epoch::new(moment.time) };
        let solution = estimator.advance(&epoch, &Aiding::alone(&navigation));
        let off_m = solution.estimate.unwrap().position.distance_m(moment.receiver);
        assert!(off_m < 3.0, "{off_m} m after {second} s");
    }
}

/// A receiver is switched off for a minute and moved by five kilometres. A new chain begins at the
/// first epoch after that, and this epoch's Doppler measures the velocity.
#[test]
fn a_new_chain_has_the_doppler_of_its_first_epoch() {
    let mut navigation = Navigation::default();
    sky('G', 8, &mut navigation);
    let options = PositioningOptions { mode: Mode::Fgo, ..options() };
    let (mut estimator, frame) = (Estimator::new(options), LocalFrame::at(receiver()));
    for second in (0..60).chain(120..122) {
        let east_m = if second < 60 { 0.0 } else { 5_000.0 };
        let moment = Moment {
            time: tag() + f64::from(second),
            receiver: frame.to_ecef(Enu(Vector3::new(east_m, 0.0, 0.0))),
            velocity_m_s: Vector3::zeros(),
        };
        let all = navigation.satellites().flat_map(|(_, list)| list);
        let observations = all.map(|ephemeris| moment.observation(ephemeris)).collect();
        let epoch = Epoch { observations, ..Epoch::new(moment.time) };
        let estimate = estimator.advance(&epoch, &Aiding::alone(&navigation)).estimate.unwrap();
        let off_m = estimate.position.distance_m(moment.receiver);
        let sigma_m_s = estimate.velocity.unwrap().covariance.trace().sqrt();
        assert!(off_m < 1.0 && sigma_m_s < 0.5, "{off_m} m, {sigma_m_s} m/s after {second} s");
    }
}

/// The first twenty seconds have Galileo alone, whose clock is 100 m behind that of GPS. GPS then
/// has a clock of its own, and all its satellites are used at once.
#[test]
fn gps_that_appears_late_is_used() {
    let mut navigation = Navigation::default();
    sky('G', 6, &mut navigation);
    sky('E', 6, &mut navigation);
    for (mode, bias_m) in [(Mode::Fgo, 100.0), (Mode::Fgo, -500.0), (Mode::Ekf, 100.0)] {
        let mut estimator = Estimator::new(PositioningOptions { mode, ..options() });
        for second in 0..60 {
            let time = tag() + f64::from(second);
            let moment = Moment { time, receiver: receiver(), velocity_m_s: Vector3::zeros() };
            let observed = |ephemeris| {
                let observation: Observation = moment.observation(ephemeris);
                let is_gps = observation.satellite.constellation == Constellation::Gps;
                let later_m = if is_gps { 0.0 } else { bias_m };
                let pseudorange_m = observation.pseudorange_m.map(|range_m| range_m + later_m);
                let is_tracked = !is_gps || 20 <= second;
                is_tracked.then_some(Observation { pseudorange_m, ..observation })
            };
            let all = navigation.satellites().flat_map(|(_, list)| list);
            let observations: Vec<_> = all.filter_map(observed).collect();
            let expected = observations.len();
            let epoch = Epoch { observations, ..Epoch::new(time) };
            let solution = estimator.advance(&epoch, &Aiding::alone(&navigation));
            let off_m = error_m(&solution);
            let used = solution.estimate.unwrap().satellites_used.len();
            assert!(used == expected && off_m < 0.1, "{used} of {expected}, {off_m} m, {second} s");
        }
    }
}

/// The base's first epoch is 15 m off. It counts once in the check of the base's position, however
/// many epochs of the rover follow it.
#[test]
fn an_epoch_of_the_base_checks_its_position_once() {
    let mut navigation = Navigation::default();
    sky('G', 8, &mut navigation);
    let mut estimator = Estimator::new(PositioningOptions { mode: Mode::RtkFgo, ..options() });
    let frame = LocalFrame::at(receiver());
    let antenna_reference_point = frame.to_ecef(Enu(Vector3::new(40.0, -30.0, 2.0)));
    let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
    let epoch_at = |time: GpsTime, receiver: Ecef| {
        let moment = Moment { time, receiver, velocity_m_s: Vector3::zeros() };
        let all = navigation.satellites().flat_map(|(_, list)| list);
        let observations = all.map(|ephemeris| moment.observation(ephemeris)).collect();
        Epoch { observations, ..Epoch::new(time) }
    };
    let mut doubtful = Vec::new();
    for tenth in 0..100 {
        let time = tag() + 0.1 * f64::from(tenth);
        let off_m = if tenth == 0 { 15.0 } else { 0.0 };
        let base = frame.to_ecef(Enu(Vector3::new(40.0, -30.0 + off_m, 2.0)));
        let epochs = if tenth % 10 == 0 { vec![epoch_at(time, base)] } else { Vec::new() };
        let base = Some(BaseAiding { station: &station, epochs: &epochs });
        let aiding = Aiding { navigation: &navigation, base };
        let solution = estimator.advance(&epoch_at(time, receiver()), &aiding);
        let is_doubt = |reason: &Reason| matches!(reason, Reason::BasePositionDoubtful { .. });
        doubtful.push(solution.reasons.iter().any(is_doubt));
    }
    // The mean of two epochs is 7.5 m off, which is no reason for doubt.
    let expected: Vec<bool> = (0..100).map(|tenth| tenth < 10).collect();
    assert_eq!(doubtful, expected);
}
