//! A receiver: its clock, the signals that it tracks, and their measurements.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::city::{Arrival, City};
use super::kinematics::Kinematics;
use super::phase_truth::PhaseTruth;
use super::random::{Random, normal_of_cell};
use super::scenario::{
    Atmosphere, ReceiverClock, ReceiverErrors, Scenario, signal_in_space_sigma_m,
};
use super::track::{Measured, Reception, Track};
use crate::gnss::constants::{GPS_L1_HZ, LIGHT_MILLISECOND_M, SPEED_OF_LIGHT};
use crate::gnss::{
    Cycles, Ecef, Ephemeris, Epoch, Geodetic, GpsTime, LocalFrame, Navigation, Observation,
    ObservationCode, SatelliteId, Signal,
};
use crate::models::troposphere::{Mapping, Troposphere};
use crate::models::{
    LookAngles, SatelliteState, geometric_range, group_delay_m, ionosphere, look_angles,
    range_rate, satellite_state, select_ephemeris,
};

/// The second signal is weaker by this (dB).
const SECOND_SIGNAL_LOSS_DB: f64 = 2.0;
/// A satellite this far below the mask is checked again only after a while (rad, s).
const FAR_BELOW_RAD: f64 = 0.07;
const LOOK_AGAIN_S: f64 = 120.0;
/// Over a shorter time a satellite moves on a straight line at constant velocity, to 0.01 mm/s (s).
const STRAIGHT_S: f64 = 1e-5;
/// Number of the random property of a satellite that is its signal-in-space error.
const SIGNAL_IN_SPACE: u64 = 32;
/// Height of the thin ionospheric shell above a mean Earth (m).
const SHELL_HEIGHT_M: f64 = 350e3;
const EARTH_RADIUS_M: f64 = 6_371e3;

/// Code errors on L5, E5a and B2a relative to L1: the code is ten times as fast, which divides
/// thermal noise by √10 and the bound of multipath by 10.
const FAST_CODE_SCALE: f64 = 0.3;
const FAST_CODE_BAND: u8 = 5;

/// A receiver and the state on which its next epoch depends.
#[derive(Clone, Debug)]
pub(super) struct Receiver {
    errors: Option<ReceiverErrors>,
    clock_options: ReceiverClock,
    random: Random,
    /// Offset of the oscillator from GPS time (m).
    clock_m: f64,
    drift_m_s: f64,
    /// Written tag less due tag (s).
    steering_s: f64,
    last: Option<GpsTime>,
    tracks: BTreeMap<SatelliteId, Track>,
}

/// Surroundings of an antenna at an instant.
pub(super) struct Surroundings<'a> {
    pub(super) navigation: &'a Navigation,
    pub(super) atmosphere: Option<&'a Atmosphere>,
    /// The city, and the antenna's position in it.
    pub(super) city: Option<(&'a City, Kinematics)>,
    pub(super) scenario: &'a Scenario,
    /// Seed of the errors of broadcast orbits and clocks.
    pub(super) seed: u64,
}

impl Surroundings<'_> {
    /// Range error of a satellite's broadcast orbit and clock (m).
    fn signal_in_space_m(&self, satellite: SatelliteId) -> f64 {
        if !self.scenario.broadcast_errors {
            return 0.0;
        }
        let constellation = satellite.constellation;
        let cell = (constellation.index() as i64, i64::from(satellite.number));
        signal_in_space_sigma_m(constellation)
            * normal_of_cell(self.seed, cell.0, cell.1, SIGNAL_IN_SPACE)
    }

    /// Zenith delay due to the ionosphere's gradient at a position (m on L1).
    fn gradient_m(&self, position: Ecef) -> f64 {
        let gradient = self.atmosphere.map_or([0.0; 2], |a| a.ionosphere_gradient);
        if gradient == [0.0; 2] {
            return 0.0;
        }
        let enu = LocalFrame::at(self.scenario.origin.to_ecef()).to_enu(position).0;
        gradient[0] * enu.x + gradient[1] * enu.y
    }
}

/// The receiver's clock error as each kind of measurement contains it.
struct Clock {
    /// In pseudoranges (m).
    code_m: f64,
    /// Pseudorange clock less carrier-phase clock (m).
    code_minus_phase_m: f64,
    /// In Dopplers (m/s).
    drift_m_s: f64,
}

/// Geometry and delays of a satellite's direct path.
struct DirectPath {
    state: SatelliteState,
    range_m: f64,
    rate_m_s: f64,
    look: LookAngles,
    troposphere_m: f64,
}

/// Quantities common to all satellites of an epoch.
struct Sky<'a> {
    receiver: Geodetic,
    frame: LocalFrame,
    troposphere: Option<Troposphere>,
    /// Zenith delay due to the ionosphere's gradient (m on L1).
    gradient_m: f64,
    surroundings: &'a Surroundings<'a>,
    velocity_m_s: Vector3<f64>,
    /// True time of reception.
    time: GpsTime,
}

impl Receiver {
    pub(super) fn new(
        errors: Option<ReceiverErrors>,
        clock_options: ReceiverClock,
        mut random: Random,
    ) -> Self {
        let clock_m = SPEED_OF_LIGHT * random.uniform(-1.0, 1.0) * clock_options.offset_s;
        let drift_m_s = SPEED_OF_LIGHT * random.uniform(-1.0, 1.0) * clock_options.drift;
        let tracks = BTreeMap::new();
        let steering_s = 0.0;
        Self { errors, clock_options, random, clock_m, drift_m_s, steering_s, last: None, tracks }
    }

    /// Propagates the clock to the tag that is due; returns the true time of reception.
    pub(super) fn advance_clock(&mut self, tag: GpsTime) -> GpsTime {
        if let Some(last) = self.last {
            let dt = tag - last;
            let walks = (self.clock_options.offset_walk_m, self.clock_options.drift_walk_m_s);
            self.clock_m += self.drift_m_s * dt + walks.0 * dt.sqrt() * self.random.normal();
            self.drift_m_s += walks.1 * dt.sqrt() * self.random.normal();
            if self.clock_options.millisecond_jumps
                && 0.5 * LIGHT_MILLISECOND_M < self.clock_m.abs()
            {
                self.clock_m -= LIGHT_MILLISECOND_M.copysign(self.clock_m);
            }
        }
        let step_s = self.clock_options.tag_step_s;
        if 0.0 < step_s {
            self.steering_s = -(self.clock_m / SPEED_OF_LIGHT / step_s).round() * step_s;
        }
        tag - self.clock_m / SPEED_OF_LIGHT
    }

    /// Written tag less due tag (s).
    pub(super) fn steering_s(&self) -> f64 {
        self.steering_s
    }

    /// Offset of the written tag from GPS time (m).
    pub(super) fn clock_m(&self) -> f64 {
        self.clock_m + SPEED_OF_LIGHT * self.steering_s
    }

    /// Drift of the clock (m/s).
    #[cfg(test)]
    pub(super) fn drift_m_s(&self) -> f64 {
        self.drift_m_s
    }

    /// The observations at `tag`, with the antenna at `position` at the true time of reception, and
    /// the truth of each observation's phase.
    pub(super) fn observe(
        &mut self,
        tag: GpsTime,
        position: Ecef,
        velocity_m_s: Vector3<f64>,
        surroundings: &Surroundings<'_>,
    ) -> (Epoch, Vec<PhaseTruth>) {
        let time = tag - self.clock_m() / SPEED_OF_LIGHT;
        let receiver = position.to_geodetic();
        let troposphere = surroundings.atmosphere.and_then(|atmosphere| {
            let humidity = atmosphere.relative_humidity;
            Troposphere::saastamoinen(&receiver, time, humidity, Mapping::Niell)
        });
        let frame = LocalFrame::at(position);
        let gradient_m = surroundings.gradient_m(position);
        let sky =
            Sky { receiver, frame, troposphere, gradient_m, surroundings, velocity_m_s, time };
        let elapsed_s = self.last.map_or(0.0, |last| tag - last);
        let mut epoch = Epoch::new(tag);
        let mut truth = Vec::new();
        for (satellite, _) in surroundings.navigation.satellites() {
            self.observe_satellite(satellite, &sky, elapsed_s, &mut epoch, &mut truth);
        }
        self.last = Some(tag);
        (epoch, truth)
    }

    fn observe_satellite(
        &mut self,
        satellite: SatelliteId,
        sky: &Sky<'_>,
        elapsed_s: f64,
        epoch: &mut Epoch,
        truth: &mut Vec<PhaseTruth>,
    ) {
        let random = &mut self.random;
        let track = self.tracks.entry(satellite).or_insert_with(|| Track::new(random));
        if sky.time < track.asleep_until {
            return;
        }
        let scenario = sky.surroundings.scenario;
        let navigation = sky.surroundings.navigation;
        let Some(ephemeris) = select_ephemeris(navigation, satellite, sky.time) else {
            track.since = None;
            return;
        };
        let path = sky.direct_path(ephemeris);
        if path.look.elevation_rad < scenario.elevation_mask_rad {
            track.since = None;
            if path.look.elevation_rad < scenario.elevation_mask_rad - FAR_BELOW_RAD {
                track.asleep_until = sky.time + LOOK_AGAIN_S;
            }
            return;
        }
        let arrival =
            sky.surroundings.city.map_or(Arrival::Direct { reflected: false }, |(city, at)| {
                city.arrival(&at, path.look.azimuth_rad, path.look.elevation_rad)
            });
        let errors = self.errors.as_ref();
        let way_m = elapsed_s * sky.velocity_m_s.norm();
        let reception = Reception { time: sky.time, look: &path.look, arrival: &arrival, errors };
        let cn0 = track.advance((elapsed_s, way_m), &reception, random);
        let is_first = self.last.is_none();
        if !track.is_received(&reception, cn0, is_first, random) {
            return;
        }
        let steered_m = SPEED_OF_LIGHT * self.steering_s;
        let clock = Clock {
            code_m: self.clock_m + steered_m,
            code_minus_phase_m: if self.clock_options.phase_follows_tag { 0.0 } else { steered_m },
            drift_m_s: self.drift_m_s,
        };
        for (index, code) in scenario.signals(satellite.constellation).enumerate() {
            let half_cycle = sky.time < track.resolved_at[index];
            let half_cycles = if half_cycle { track.half_cycles[index] } else { 0.0 };
            let ambiguity_cycles = track.ambiguities[index] + half_cycles;
            let ideal = sky.ideal(ephemeris, code, &path, &clock, ambiguity_cycles);
            let cn0 = cn0 - SECOND_SIGNAL_LOSS_DB * index as f64;
            let measured = track.disturb(ideal, index, cn0, &reception, random);
            let doppler_hz = Some(measured.doppler_m_s / measured.wavelength_m);
            epoch.observations.push(Observation {
                loss_of_lock: track.lost_lock[index],
                half_cycle,
                pseudorange_m: Some(measured.pseudorange_m),
                carrier_phase: Some(Cycles(measured.phase_m / measured.wavelength_m)),
                doppler_hz,
                cn0_db_hz: Some(cn0),
                ..Observation::empty(satellite, code)
            });
            truth.push(PhaseTruth {
                ambiguity_cycles,
                elevation_rad: path.look.elevation_rad,
                is_reflected: matches!(arrival, Arrival::Reflected(_)),
            });
        }
        track.lost_lock = [false; 2];
    }
}

impl Sky<'_> {
    /// Solves for the time of transmission, t − (ρ + T)/c. The ionosphere's delay moves a satellite
    /// by some 10 µm and is neglected.
    fn direct_path(&self, ephemeris: &Ephemeris) -> DirectPath {
        let mut travel_s = 0.075;
        let mut state = satellite_state(ephemeris, self.time - travel_s);
        let mut look = look_angles(&self.frame, state.position);
        let mut troposphere_m = 0.0;
        for _ in 0..3 {
            look = look_angles(&self.frame, state.position);
            // Below the horizon there is no mapping function, and nothing is received.
            let elevation = look.elevation_rad;
            let above = self.troposphere.filter(|_| 0.0 < elevation);
            troposphere_m = above.map_or(0.0, |model| model.slant_delay_m(elevation));
            let (range_m, _) = geometric_range(state.position, self.frame.origin);
            let needed_s = (range_m + troposphere_m) / SPEED_OF_LIGHT;
            let later_s = travel_s - needed_s;
            if STRAIGHT_S < later_s.abs() {
                state = satellite_state(ephemeris, self.time - needed_s);
            } else {
                state.position.0 += state.velocity_m_s * later_s;
                state.clock_m += state.clock_drift_m_s * later_s;
            }
            travel_s = needed_s;
        }
        let (range_m, _) = geometric_range(state.position, self.frame.origin);
        let rate =
            range_rate(state.position, &state.velocity_m_s, self.frame.origin, &self.velocity_m_s);
        DirectPath { state, range_m, rate_m_s: rate.rate_m_s, look, troposphere_m }
    }

    /// The measurements of an error-free receiver on the direct path.
    fn ideal(
        &self,
        ephemeris: &Ephemeris,
        code: ObservationCode,
        path: &DirectPath,
        clock: &Clock,
        ambiguity: f64,
    ) -> Measured {
        let satellite = ephemeris.satellite();
        let frequency_hz = Signal::of(satellite, code)
            .frequency_hz(ephemeris.glonass_channel())
            .expect("the signals received have a frequency");
        let ionosphere_m = self.surroundings.atmosphere.map_or(0.0, |atmosphere| {
            let delay = ionosphere::klobuchar_delay_m(
                &atmosphere.klobuchar,
                frequency_hz,
                &self.receiver,
                &path.look,
                self.time,
            );
            let gradient_m = self.gradient_m * thin_shell(path.look.elevation_rad);
            atmosphere.ionosphere_ratio * delay + gradient_m * (GPS_L1_HZ / frequency_hz).powi(2)
        });
        let wavelength_m = SPEED_OF_LIGHT / frequency_hz;
        let group_delay_m = group_delay_m(ephemeris, code).unwrap_or(0.0);
        let signal_in_space_m = self.surroundings.signal_in_space_m(satellite);
        let common_m = path.range_m + clock.code_m - path.state.clock_m
            + path.troposphere_m
            + signal_in_space_m;
        let phase_m = common_m - ionosphere_m + ambiguity * wavelength_m;
        Measured {
            wavelength_m,
            code_scale: if code.band_digit() == FAST_CODE_BAND { FAST_CODE_SCALE } else { 1.0 },
            pseudorange_m: common_m + ionosphere_m + group_delay_m,
            phase_m: phase_m - clock.code_minus_phase_m,
            doppler_m_s: -(path.rate_m_s + clock.drift_m_s - path.state.clock_drift_m_s),
        }
    }
}

/// Slant over zenith delay of a thin shell 350 km high; Hofmann-Wellenhof et al. (2008), *GNSS*,
/// 5.3.2.
fn thin_shell(elevation_rad: f64) -> f64 {
    let inside = EARTH_RADIUS_M / (EARTH_RADIUS_M + SHELL_HEIGHT_M) * elevation_rad.cos();
    1.0 / (1.0 - inside * inside).sqrt()
}
