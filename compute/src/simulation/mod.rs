//! Observations with known truth, from a seed.
//!
//! [`Simulator`] makes one epoch after another: the position of the rover and the measurements of
//! rover and base. Satellites follow their generated broadcast [`Navigation`], evaluated by
//! [`models`](crate::models), so that the truth is exact. A measurement is
//!
//! P = ρ + c·δt_r − c·δtˢ + τ + T + I + ε + reflection + multipath + noise,
//! λφ = ρ + c·δt_r − c·δtˢ + T − I + λN + ε + reflection + multipath + noise.
//!
//! [`Scenario`] can switch off each term. ε is the range error of broadcast orbit and clock, one
//! number for a satellite and seed. The same scenario and seed give the same bits. The navigation
//! data depends on the scenario alone, so that a fleet of many seeds shares it. Antenna phase
//! patterns are not modelled.

mod city;
mod constellation;
mod kinematics;
mod motion;
mod oddities;
mod odometry;
mod phase_truth;
mod random;
mod random_drive;
mod receiver;
mod scenario;
mod track;

pub use city::CityPlan;
pub use motion::{Motion, Traffic};
pub use oddities::Oddities;
pub use phase_truth::PhaseTruth;
pub use random_drive::{DriveKind, RandomDrive};
pub use scenario::{Atmosphere, ReceiverClock, ReceiverErrors, Scenario, SecondBand};

use std::sync::Arc;

use nalgebra::Vector3;

use self::city::City;
use self::kinematics::Kinematics;
use self::motion::Path;
use self::oddities::OddReceiver;
use self::odometry::Odometer;
use self::random::Random;
use self::receiver::{Receiver, Surroundings};
use crate::gnss::{Ecef, Enu, Epoch, GpsTime, LocalFrame, Navigation, Odometry};

const ROVER_STREAM: u64 = 1;
const BASE_STREAM: u64 = 2;
const ODOMETRY_STREAM: u64 = 3;
const ODDITIES_STREAM: u64 = 4;
const IONOSPHERE_STREAM: u64 = 21;

/// One epoch of a simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedEpoch {
    /// Observations of the rover.
    pub rover: Epoch,
    /// Observations of the base at its own due tag; `None` without base.
    pub base: Option<Epoch>,
    /// The truth of the rover's carrier phases, in the order of its observations.
    pub rover_phases: Vec<PhaseTruth>,
    /// The truth of the base's carrier phases; empty without base.
    pub base_phases: Vec<PhaseTruth>,
    /// Displacement since the previous epoch, from wheels and compass; `None` at the first epoch.
    pub odometry: Option<Odometry>,
    /// True position of the rover's antenna at the GPS time that equals the tag, ECEF (m).
    pub position: Ecef,
    /// True velocity at that time, ECEF (m/s).
    pub velocity_m_s: Vector3<f64>,
    /// True offset of the rover's clock (m).
    pub clock_m: f64,
}

/// A running simulation: an iterator over its epochs.
#[derive(Clone, Debug)]
pub struct Simulator {
    scenario: Scenario,
    seed: u64,
    navigation: Arc<Navigation>,
    frame: LocalFrame,
    path: Path,
    city: Option<City>,
    rover: Receiver,
    oddities: Option<OddReceiver>,
    base: Option<(Receiver, Ecef)>,
    odometer: Odometer,
    next_index: u64,
}

/// The broadcast navigation data of a scenario, from its start to its end.
pub fn navigation(scenario: &Scenario) -> Navigation {
    let end = scenario.start + scenario.duration_s;
    let klobuchar = scenario.atmosphere.map(|atmosphere| atmosphere.klobuchar);
    constellation::navigation(&scenario.constellations, scenario.start, end, klobuchar)
}

impl Simulator {
    /// A simulation with its own navigation data.
    pub fn new(scenario: Scenario, seed: u64) -> Self {
        let navigation = Arc::new(navigation(&scenario));
        Self::with_navigation(scenario, seed, navigation)
    }

    /// One of several simulations under the same sky; `navigation` belongs to their scenario.
    pub fn with_navigation(mut scenario: Scenario, seed: u64, navigation: Arc<Navigation>) -> Self {
        if let Some(atmosphere) = &mut scenario.atmosphere {
            let drawn = Random::new(seed, IONOSPHERE_STREAM).normal();
            let ratio = atmosphere.ionosphere_ratio + atmosphere.ionosphere_spread * drawn;
            atmosphere.ionosphere_ratio = ratio.max(0.0);
        }
        let frame = LocalFrame::at(scenario.origin.to_ecef());
        let city = scenario.city.map(|plan| City::new(plan, seed));
        let path = Path::new(scenario.motion, city.as_ref(), scenario.duration_s, seed);
        let receiver =
            |errors, stream| Receiver::new(errors, scenario.clock, Random::new(seed, stream));
        let rover = receiver(scenario.rover_errors, ROVER_STREAM);
        let base = scenario
            .base
            .map(|enu| (receiver(scenario.base_errors, BASE_STREAM), frame.to_ecef(enu)));
        let odometer = Odometer::new(Random::new(seed, ODOMETRY_STREAM));
        let oddities = scenario
            .oddities
            .map(|oddities| OddReceiver::new(oddities, seed, Random::new(seed, ODDITIES_STREAM)));
        Self {
            scenario,
            seed,
            navigation,
            frame,
            path,
            city,
            rover,
            oddities,
            base,
            odometer,
            next_index: 0,
        }
    }

    /// The broadcast navigation data.
    pub fn navigation(&self) -> &Arc<Navigation> {
        &self.navigation
    }

    /// True position of the base's antenna; `None` without base.
    pub fn base_position(&self) -> Option<Ecef> {
        self.base.as_ref().map(|(_, position)| *position)
    }

    /// The rover's antenna position and velocity at an instant, in ECEF and in the local frame.
    fn rover_at(&self, time: GpsTime) -> (Ecef, Vector3<f64>, Kinematics) {
        let mut kinematics = self.path.at(time - self.scenario.start);
        kinematics.position_m.z += self.scenario.antenna_height_m;
        let velocity = self.frame.rotation.transpose() * kinematics.velocity_m_s;
        (self.frame.to_ecef(Enu(kinematics.position_m)), velocity, kinematics)
    }
}

impl Iterator for Simulator {
    type Item = SimulatedEpoch;

    fn next(&mut self) -> Option<SimulatedEpoch> {
        let elapsed_s = self.next_index as f64 * self.scenario.interval_s;
        if self.scenario.duration_s < elapsed_s {
            return None;
        }
        self.next_index += 1;
        let due = self.scenario.start + elapsed_s;
        let received = self.rover.advance_clock(due);
        let tag = due + self.rover.steering_s();
        let (position, velocity_m_s, local) = self.rover_at(received);
        let open = Surroundings {
            navigation: &self.navigation,
            atmosphere: self.scenario.atmosphere.as_ref(),
            city: None,
            scenario: &self.scenario,
            seed: self.seed,
        };
        let around = Surroundings { city: self.city.as_ref().map(|city| (city, local)), ..open };
        let (mut rover, mut rover_phases) =
            self.rover.observe(tag, position, velocity_m_s, &around);
        if let Some(oddities) = &mut self.oddities {
            oddities.disturb(&mut rover, &mut rover_phases, &self.navigation);
        }
        let base = self.base.as_mut().map(|(receiver, position)| {
            receiver.advance_clock(due);
            receiver.observe(due, *position, Vector3::zeros(), &open)
        });
        let (base, base_phases) = base.unzip();
        let base_phases = base_phases.unwrap_or_default();
        let (position, velocity_m_s, _) = self.rover_at(tag);
        let clock_m = self.rover.clock_m();
        let odometry = self.odometer.measure(&self.path, elapsed_s);
        Some(SimulatedEpoch {
            rover,
            base,
            rover_phases,
            base_phases,
            odometry,
            position,
            velocity_m_s,
            clock_m,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::scenario::signal_in_space_sigma_m;
    use super::*;
    use crate::gnss::Observation;
    use crate::gnss::constants::SPEED_OF_LIGHT;
    use crate::models::{
        geometric_range, group_delay_m, range_rate, select_ephemeris, state_at_transmission,
    };

    /// Pseudorange, phase and range rate minus their models without atmosphere (m, m/s).
    fn residuals(
        observation: &Observation,
        navigation: &Navigation,
        tag: GpsTime,
        (position, velocity): (Ecef, Vector3<f64>),
    ) -> (f64, f64, f64) {
        let ephemeris = select_ephemeris(navigation, observation.satellite, tag).unwrap();
        let pseudorange_m = observation.pseudorange_m.unwrap();
        let state = state_at_transmission(ephemeris, tag, pseudorange_m);
        let (range_m, _) = geometric_range(state.position, position);
        let modelled_m = range_m - state.clock_m;
        let frequency = observation.signal().frequency_hz(ephemeris.glonass_channel()).unwrap();
        let wavelength_m = SPEED_OF_LIGHT / frequency;
        let rate = range_rate(state.position, &state.velocity_m_s, position, &velocity);
        let rate_m_s = rate.rate_m_s - state.clock_drift_m_s;
        (
            pseudorange_m - modelled_m - group_delay_m(ephemeris, observation.code).unwrap(),
            observation.carrier_phase.unwrap().0 * wavelength_m - modelled_m,
            -observation.doppler_hz.unwrap() * wavelength_m - rate_m_s,
        )
    }

    #[test]
    fn the_same_seed_gives_the_same_bits_and_another_others() {
        for (name, _) in Scenario::NAMES {
            let run = |seed| {
                let scenario = Scenario { duration_s: 40.0, ..Scenario::by_name(name).unwrap() };
                Simulator::new(scenario, seed).collect::<Vec<_>>()
            };
            assert_eq!(run(7), run(7), "{name}");
            assert_ne!(run(7), run(8), "{name}");
        }
    }

    /// Without noise and atmosphere the models explain every measurement at the truth: code to
    /// 1 mm, phase to an integer, Doppler to 0.1 mm/s.
    #[test]
    fn clean_measurements_are_what_the_models_say() {
        let mut simulator = Simulator::new(Scenario::clean(), 3);
        let navigation = simulator.navigation().clone();
        let mut count = 0;
        while let Some(epoch) = simulator.next() {
            let tag = epoch.rover.time;
            let (position, velocity, _) = simulator.rover_at(tag - epoch.clock_m / SPEED_OF_LIGHT);
            for observation in &epoch.rover.observations {
                let (code, phase, rate) =
                    residuals(observation, &navigation, tag, (position, velocity));
                assert!((code - epoch.clock_m).abs() < 1e-3, "{observation:?}: {code}");
                let channel = navigation.of(observation.satellite)[0].glonass_channel();
                let frequency = observation.signal().frequency_hz(channel).unwrap();
                let cycles = (phase - epoch.clock_m) * frequency / SPEED_OF_LIGHT;
                assert!((cycles - cycles.round()).abs() < 5e-3, "{observation:?}: {cycles}");
                let drift = simulator.rover.drift_m_s();
                assert!((rate - drift).abs() < 1e-4, "{observation:?}: {rate} {drift}");
                count += 1;
            }
        }
        assert!(300 * 40 < count, "{count} observations");
    }

    /// Thermal noise alone, at its stated size: code, phase (after a mean per arc) and Doppler.
    #[test]
    fn noise_has_its_stated_size() {
        let errors = ReceiverErrors {
            code_multipath_m: 0.0,
            phase_multipath_m: 0.0,
            fading_db: 0.0,
            slips_per_hour: 0.0,
            ..ReceiverErrors::open_sky()
        };
        let scenario = Scenario { rover_errors: Some(errors), ..Scenario::clean() };
        let mut simulator = Simulator::new(scenario, 9);
        let navigation = simulator.navigation().clone();
        let (mut codes, mut rates) = (Vec::new(), Vec::new());
        let mut phases: BTreeMap<_, Vec<(f64, f64)>> = BTreeMap::new();
        while let Some(epoch) = simulator.next() {
            let tag = epoch.rover.time;
            let (position, velocity, _) = simulator.rover_at(tag - epoch.clock_m / SPEED_OF_LIGHT);
            for observation in &epoch.rover.observations {
                let (code, phase, rate) =
                    residuals(observation, &navigation, tag, (position, velocity));
                let scale = 10_f64.powf((observation.cn0_db_hz.unwrap() - 45.0) / 20.0);
                codes.push((code - epoch.clock_m) * scale / errors.code_m);
                rates.push((rate - simulator.rover.drift_m_s()) * scale / errors.doppler_m_s);
                let arc = phases.entry((observation.satellite, observation.code)).or_default();
                arc.push((phase - epoch.clock_m, scale / errors.phase_m));
            }
        }
        let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>();
        for (name, values) in [("code", codes), ("Doppler", rates)] {
            let sigma = (square(&values) / values.len() as f64).sqrt();
            assert!((sigma - 1.0).abs() < 0.02, "{name}: {sigma}");
        }
        // Differences of neighbours leave √2 of the noise and no ambiguity; scales change slowly.
        let steps: Vec<f64> = phases
            .values()
            .flat_map(|arc| arc.windows(2).map(|pair| (pair[1].0 - pair[0].0) * pair[1].1))
            .filter(|step| step.abs() < 50.0)
            .collect();
        let sigma = (square(&steps) / steps.len() as f64 / 2.0).sqrt();
        assert!((sigma - 1.0).abs() < 0.05, "phase: {sigma}");
    }

    /// A satellite's broadcast errs alike for rover and base and all the time; over satellites and
    /// seeds by its constellation's deviation.
    #[test]
    fn broadcasts_err_by_satellite() {
        let scenario = Scenario { broadcast_errors: true, duration_s: 10.0, ..Scenario::clean() };
        let mut scaled = Vec::new();
        for seed in 0..20 {
            let mut simulator = Simulator::new(scenario.clone(), seed);
            let navigation = simulator.navigation().clone();
            let mut errors: BTreeMap<_, Vec<f64>> = BTreeMap::new();
            while let Some(epoch) = simulator.next() {
                let tag = epoch.rover.time;
                let (at, velocity, _) = simulator.rover_at(tag - epoch.clock_m / SPEED_OF_LIGHT);
                for observation in &epoch.rover.observations {
                    let (code, ..) = residuals(observation, &navigation, tag, (at, velocity));
                    errors.entry(observation.satellite).or_default().push(code - epoch.clock_m);
                }
            }
            for (satellite, of_one) in errors {
                assert!(of_one.iter().all(|error| (error - of_one[0]).abs() < 1e-2));
                scaled.push(of_one[0] / signal_in_space_sigma_m(satellite.constellation));
            }
        }
        let variance = scaled.iter().map(|e| e * e).sum::<f64>() / scaled.len() as f64;
        assert!((variance.sqrt() - 1.0).abs() < 0.15, "{variance} of {}", scaled.len());
    }

    /// Multipath after ten seconds: nearly the same at rest, nearly independent at 10 m/s.
    #[test]
    fn multipath_stands_with_the_car() {
        let correlation = |motion| {
            let errors = ReceiverErrors {
                code_m: 0.0,
                multipath_correlation_m: 20.0,
                fading_db: 0.0,
                slips_per_hour: 0.0,
                ..ReceiverErrors::urban()
            };
            let scenario = Scenario { rover_errors: Some(errors), motion, ..Scenario::clean() };
            let mut simulator = Simulator::new(scenario, 2);
            let navigation = simulator.navigation().clone();
            let mut series: BTreeMap<_, Vec<f64>> = BTreeMap::new();
            while let Some(epoch) = simulator.next() {
                let tag = epoch.rover.time;
                let (at, velocity, _) = simulator.rover_at(tag - epoch.clock_m / SPEED_OF_LIGHT);
                for observation in &epoch.rover.observations {
                    let (code, ..) = residuals(observation, &navigation, tag, (at, velocity));
                    let key = (observation.satellite, observation.code);
                    series.entry(key).or_default().push(code - epoch.clock_m);
                }
            }
            let product = |lag: usize| -> f64 {
                series
                    .values()
                    .flat_map(|s| s.iter().zip(s.iter().skip(lag)))
                    .map(|(a, b)| a * b)
                    .sum()
            };
            product(10) / product(0)
        };
        let driving = Motion::Loop { half_length_m: 250.0, speed_m_s: 10.0 };
        let (standing, driving) = (correlation(Motion::Static), correlation(driving));
        // e^(−10/100) and e^(−10/100 − 100/20).
        assert!((0.8..0.97).contains(&standing), "{standing}");
        assert!(driving.abs() < 0.2, "{driving}");
    }

    /// The canyon hides a good part of the sky; what it lets through late is late and never early.
    #[test]
    fn the_canyon_blocks_and_delays() {
        let quiet = |scenario: Scenario| Scenario {
            broadcast_errors: false,
            atmosphere: None,
            rover_errors: None,
            duration_s: 300.0,
            ..scenario
        };
        let in_city = Simulator::new(quiet(Scenario::urban_canyon()), 4);
        let navigation = in_city.navigation().clone();
        let mut simulator = in_city.clone();
        let open = Scenario { city: None, ..quiet(Scenario::urban_canyon()) };
        let path = in_city.path.clone();
        let mut free = Simulator { city: None, path, ..Simulator::new(open, 4) };
        let (mut seen, mut late, mut all) = (0_usize, 0_usize, 0_usize);
        while let Some(epoch) = simulator.next() {
            all += free.next().unwrap().rover.observations.len();
            let tag = epoch.rover.time;
            let (position, velocity, _) = simulator.rover_at(tag - epoch.clock_m / SPEED_OF_LIGHT);
            for observation in &epoch.rover.observations {
                let (code, ..) = residuals(observation, &navigation, tag, (position, velocity));
                let excess_m = code - epoch.clock_m;
                assert!((-1e-3..200.1).contains(&excess_m), "{observation:?}: {excess_m}");
                seen += 1;
                late += usize::from(1.0 < excess_m);
            }
        }
        let (seen_share, late_share) = (seen as f64 / all as f64, late as f64 / seen as f64);
        assert!((0.2..0.8).contains(&seen_share), "{seen_share} of the sky is received");
        assert!((0.05..0.6).contains(&late_share), "{late_share} of it late");
    }
}
