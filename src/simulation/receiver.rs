//! A receiver: its clock, what it tracks, and the measurements it makes of it.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::city::{Arrival, City};
use super::place::Place;
use super::random::{GaussMarkov, Random, normal_of_place};
use super::scenario::{
    Atmosphere, ReceiverClock, ReceiverErrors, Scenario, signal_in_space_sigma_m,
};
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Constellation, Cycles, Ecef, Ephemeris, Epoch, Geodetic, GpsTime, LocalFrame, Navigation,
    Observation, ObservationCode, SatelliteId, Signal,
};
use crate::models::troposphere::{Mapping, Troposphere};
use crate::models::{
    LookAngles, SatelliteState, geometric_range, group_delay_m, ionosphere, look_angles,
    range_rate, satellite_state, select_ephemeris,
};

/// C/N0 at which standard deviations of errors are stated (dB-Hz).
const REFERENCE_CN0: f64 = 45.0;
/// C/N0 in the zenith, and what is lost towards the horizon (dB-Hz, dB).
const ZENITH_CN0: f64 = 48.0;
const HORIZON_LOSS_DB: f64 = 14.0;
/// The second signal is received weaker (dB).
const SECOND_SIGNAL_LOSS_DB: f64 = 2.0;
/// A satellite this far below the mask is looked at again only after a while (rad, s).
const FAR_BELOW_RAD: f64 = 0.07;
const LOOK_AGAIN_S: f64 = 120.0;
/// Share of the error of a direct signal's multipath when no wall reflects the satellite.
const CALM_SHARE: f64 = 0.25;
/// Carrier multipath cannot exceed a quarter of a wavelength.
const PHASE_MULTIPATH_LIMIT: f64 = 0.25;
/// Over less than this a satellite moves on a line and keeps its velocity, to 0.01 mm/s (s).
const STRAIGHT_S: f64 = 1e-5;
const MILLISECOND_M: f64 = 1e-3 * SPEED_OF_LIGHT;
/// What is drawn of a satellite's number for its signal-in-space error.
const SIGNAL_IN_SPACE: u64 = 32;

/// Signals received of a constellation, in order of preference.
pub fn signals(constellation: Constellation) -> [ObservationCode; 2] {
    let names = match constellation {
        Constellation::Gps | Constellation::Qzss => ["1C", "2L"],
        Constellation::Glonass => ["1C", "2C"],
        Constellation::Galileo => ["1C", "7Q"],
        Constellation::BeiDou => ["2I", "6I"],
    };
    names.map(|name| ObservationCode::parse(name).expect("the codes are RINEX 3's"))
}

/// A receiver and all that its next epoch depends on.
#[derive(Clone, Debug)]
pub(super) struct Receiver {
    errors: Option<ReceiverErrors>,
    clock_options: ReceiverClock,
    random: Random,
    clock_m: f64,
    drift_m_s: f64,
    last: Option<GpsTime>,
    tracks: BTreeMap<SatelliteId, Track>,
}

/// What surrounds an antenna at an instant.
pub(super) struct Surroundings<'a> {
    pub(super) navigation: &'a Navigation,
    pub(super) atmosphere: Option<&'a Atmosphere>,
    /// The city, and the antenna in it.
    pub(super) city: Option<(&'a City, Place)>,
    pub(super) scenario: &'a Scenario,
    /// Seed of what the satellites broadcast wrongly.
    pub(super) seed: u64,
}

impl Surroundings<'_> {
    /// What a satellite's broadcast orbit and clock put into every range to it (m).
    fn signal_in_space_m(&self, satellite: SatelliteId) -> f64 {
        if !self.scenario.broadcast_errors {
            return 0.0;
        }
        let constellation = satellite.constellation;
        let place = (constellation.index() as i64, i64::from(satellite.number));
        signal_in_space_sigma_m(constellation)
            * normal_of_place(self.seed, place.0, place.1, SIGNAL_IN_SPACE)
    }
}

/// What is kept of a satellite between epochs.
#[derive(Clone, Debug)]
struct Track {
    /// Not looked at before.
    asleep_until: GpsTime,
    /// Since when it is received in the present manner; `None` while it is not.
    since: Option<GpsTime>,
    is_reflected: bool,
    /// Integer ambiguity of each signal (cycles).
    ambiguities: [f64; 2],
    lost_lock: bool,
    multipath: [GaussMarkov; 2],
    phase_multipath: [GaussMarkov; 2],
    fading: GaussMarkov,
}

/// The geometry and delays of one satellite's direct path.
struct DirectPath {
    state: SatelliteState,
    range_m: f64,
    rate_m_s: f64,
    look: LookAngles,
    troposphere_m: f64,
}

/// The delays that all satellites of an epoch share.
struct Sky<'a> {
    receiver: Geodetic,
    frame: LocalFrame,
    troposphere: Option<Troposphere>,
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
        Self { errors, clock_options, random, clock_m, drift_m_s, last: None, tracks }
    }

    /// Moves the clock on to an epoch's tag; returns the true time of reception.
    pub(super) fn advance_clock(&mut self, tag: GpsTime) -> GpsTime {
        if let Some(last) = self.last {
            let dt = tag - last;
            let walks = (self.clock_options.offset_walk_m, self.clock_options.drift_walk_m_s);
            self.clock_m += self.drift_m_s * dt + walks.0 * dt.sqrt() * self.random.normal();
            self.drift_m_s += walks.1 * dt.sqrt() * self.random.normal();
            if self.clock_options.millisecond_jumps && 0.5 * MILLISECOND_M < self.clock_m.abs() {
                self.clock_m -= MILLISECOND_M.copysign(self.clock_m);
            }
        }
        tag - self.clock_m / SPEED_OF_LIGHT
    }

    /// Offset of the clock (m).
    pub(super) fn clock_m(&self) -> f64 {
        self.clock_m
    }

    /// Drift of the clock (m/s).
    #[cfg(test)]
    pub(super) fn drift_m_s(&self) -> f64 {
        self.drift_m_s
    }

    /// What is measured at `tag`, the antenna being at `position` at the true time of reception.
    pub(super) fn observe(
        &mut self,
        tag: GpsTime,
        position: Ecef,
        velocity_m_s: Vector3<f64>,
        surroundings: &Surroundings<'_>,
    ) -> Epoch {
        let time = tag - self.clock_m / SPEED_OF_LIGHT;
        let receiver = position.to_geodetic();
        let troposphere = surroundings.atmosphere.and_then(|atmosphere| {
            let humidity = atmosphere.relative_humidity;
            Troposphere::saastamoinen(&receiver, time, humidity, Mapping::Niell)
        });
        let frame = LocalFrame::at(position);
        let sky = Sky { receiver, frame, troposphere, surroundings, velocity_m_s, time };
        let elapsed_s = self.last.map_or(0.0, |last| tag - last);
        let mut epoch = Epoch::new(tag);
        for (satellite, _) in surroundings.navigation.satellites() {
            self.observe_satellite(satellite, &sky, elapsed_s, &mut epoch);
        }
        self.last = Some(tag);
        epoch
    }

    fn observe_satellite(
        &mut self,
        satellite: SatelliteId,
        sky: &Sky<'_>,
        elapsed_s: f64,
        epoch: &mut Epoch,
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
        let cn0 = track.advance((elapsed_s, way_m), &path.look, &arrival, errors, random);
        let is_first = self.last.is_none();
        if !track.is_received(sky.time, cn0, &arrival, is_first, errors, random) {
            return;
        }
        for (index, code) in
            signals(satellite.constellation).into_iter().take(scenario.frequencies).enumerate()
        {
            let clock = (self.clock_m, self.drift_m_s);
            let ideal = sky.ideal(ephemeris, code, &path, clock, track.ambiguities[index]);
            let cn0 = cn0 - SECOND_SIGNAL_LOSS_DB * index as f64;
            let measured = track.disturb(ideal, index, cn0, &path.look, &arrival, errors, random);
            let doppler_hz = Some(measured.doppler_m_s / measured.wavelength_m);
            epoch.observations.push(Observation {
                loss_of_lock: track.lost_lock,
                pseudorange_m: Some(measured.pseudorange_m),
                carrier_phase: Some(Cycles(measured.phase_m / measured.wavelength_m)),
                doppler_hz,
                cn0_db_hz: Some(cn0),
                ..Observation::empty(satellite, code)
            });
        }
        track.lost_lock = false;
    }
}

/// Measurements of one signal in metres; the Doppler with RINEX's sign, positive on approach.
struct Measured {
    wavelength_m: f64,
    pseudorange_m: f64,
    phase_m: f64,
    doppler_m_s: f64,
}

impl Sky<'_> {
    /// Solves for the time of transmission: t − (ρ + T)/c; the ionosphere's metres move a satellite
    /// by some 10 µm and are left out of it.
    fn direct_path(&self, ephemeris: &Ephemeris) -> DirectPath {
        let mut travel_s = 0.075;
        let mut state = satellite_state(ephemeris, self.time - travel_s);
        let mut look = look_angles(&self.frame, state.position);
        let mut troposphere_m = 0.0;
        for _ in 0..3 {
            look = look_angles(&self.frame, state.position);
            // Below the horizon there is no mapping function; nothing is received there.
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

    /// What a perfect receiver measures of a direct signal.
    fn ideal(
        &self,
        ephemeris: &Ephemeris,
        code: ObservationCode,
        path: &DirectPath,
        (clock_m, drift_m_s): (f64, f64),
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
            atmosphere.ionosphere_ratio * delay
        });
        let wavelength_m = SPEED_OF_LIGHT / frequency_hz;
        let group_delay_m = group_delay_m(ephemeris, code).unwrap_or(0.0);
        let signal_in_space_m = self.surroundings.signal_in_space_m(satellite);
        let common_m =
            path.range_m + clock_m - path.state.clock_m + path.troposphere_m + signal_in_space_m;
        Measured {
            wavelength_m,
            pseudorange_m: common_m + ionosphere_m + group_delay_m,
            phase_m: common_m - ionosphere_m + ambiguity * wavelength_m,
            doppler_m_s: -(path.rate_m_s + drift_m_s - path.state.clock_drift_m_s),
        }
    }
}

impl Track {
    fn new(random: &mut Random) -> Self {
        let mut process = || GaussMarkov::new(random);
        Self {
            asleep_until: GpsTime::EPOCH,
            since: None,
            is_reflected: false,
            ambiguities: [0.0; 2],
            lost_lock: false,
            multipath: [process(), process()],
            phase_multipath: [process(), process()],
            fading: process(),
        }
    }

    /// Moves the slow processes on; returns the C/N0 of the first signal (dB-Hz).
    fn advance(
        &mut self,
        (elapsed_s, way_m): (f64, f64),
        look: &LookAngles,
        arrival: &Arrival,
        errors: Option<&ReceiverErrors>,
        random: &mut Random,
    ) -> f64 {
        let lost_db = HORIZON_LOSS_DB * (1.0 - look.elevation_rad.sin()).powi(2);
        let reflection_db = match arrival {
            Arrival::Reflected(reflection) => reflection.loss_db,
            Arrival::Diffracted(bent) => bent.loss_db,
            Arrival::Direct { .. } | Arrival::Blocked => 0.0,
        };
        let clear_db = ZENITH_CN0 - lost_db - reflection_db;
        let Some(errors) = errors else {
            return clear_db;
        };
        // Reflectors pass by as the antenna moves.
        let passed_s = way_m / errors.multipath_correlation_m * errors.multipath_correlation_s;
        for process in self.multipath.iter_mut().chain(&mut self.phase_multipath) {
            process.advance(elapsed_s + passed_s, errors.multipath_correlation_s, random);
        }
        let fading = self.fading.advance(elapsed_s, errors.fading_correlation_s, random);
        clear_db + errors.fading_db * fading
    }

    /// Whether there are measurements; a new way of arrival begins new ambiguities.
    fn is_received(
        &mut self,
        time: GpsTime,
        cn0: f64,
        arrival: &Arrival,
        is_first: bool,
        errors: Option<&ReceiverErrors>,
        random: &mut Random,
    ) -> bool {
        let threshold = errors.map_or(f64::NEG_INFINITY, |e| e.tracking_threshold_db_hz);
        if matches!(arrival, Arrival::Blocked) || cn0 < threshold {
            self.since = None;
            return false;
        }
        let is_reflected = matches!(arrival, Arrival::Reflected(_));
        let continues = self.since.is_some() && self.is_reflected == is_reflected;
        if !continues {
            let was_tracked = self.since.is_some();
            self.begin_arc(random);
            // A signal that only changes its way stays in the loops; others are acquired anew.
            // So does what the receiver tracked before the simulation began.
            let stays = was_tracked || is_first;
            self.since = Some(if stays { GpsTime::EPOCH } else { time });
            self.is_reflected = is_reflected;
        } else if let Some(errors) = errors {
            self.slip(cn0, errors, random);
        }
        let wait_s = errors.map_or(0.0, |e| e.reacquisition_s);
        self.since.is_some_and(|since| wait_s <= time - since)
    }

    fn begin_arc(&mut self, random: &mut Random) {
        self.ambiguities = self.ambiguities.map(|_| random.uniform(-1e5, 1e5).round());
        self.lost_lock = true;
    }

    /// Slips now and then by some cycles, more often when the signal is weak.
    fn slip(&mut self, cn0: f64, errors: &ReceiverErrors, random: &mut Random) {
        let per_second =
            errors.slips_per_hour / 3_600.0 * 10_f64.powf((REFERENCE_CN0 - cn0) / 10.0);
        if random.chance(per_second.min(0.5)) {
            let cycles = random.uniform(1.0, 20.0).round();
            let sign = if random.chance(0.5) { 1.0 } else { -1.0 };
            self.ambiguities = self.ambiguities.map(|ambiguity| ambiguity + sign * cycles);
            self.lost_lock |= random.chance(errors.slips_reported);
        }
    }

    /// Adds reflection, multipath and noise.
    #[expect(clippy::too_many_arguments, reason = "each is another cause of an error")]
    fn disturb(
        &self,
        ideal: Measured,
        index: usize,
        cn0: f64,
        look: &LookAngles,
        arrival: &Arrival,
        errors: Option<&ReceiverErrors>,
        random: &mut Random,
    ) -> Measured {
        let (excess_m, excess_rate_m_s) = match arrival {
            Arrival::Reflected(reflection) => (reflection.excess_m, reflection.excess_rate_m_s),
            // Centimetres, whose rate is within the noise.
            Arrival::Diffracted(bent) => (bent.excess_m, 0.0),
            Arrival::Direct { .. } | Arrival::Blocked => (0.0, 0.0),
        };
        let Measured { wavelength_m, pseudorange_m, phase_m, doppler_m_s } = ideal;
        let late = Measured {
            wavelength_m,
            pseudorange_m: pseudorange_m + excess_m,
            phase_m: phase_m + excess_m,
            doppler_m_s: doppler_m_s - excess_rate_m_s,
        };
        let Some(errors) = errors else {
            return late;
        };
        let share = match arrival {
            Arrival::Direct { reflected: true }
            | Arrival::Reflected(_)
            | Arrival::Diffracted(_) => 1.0,
            Arrival::Direct { reflected: false } | Arrival::Blocked => CALM_SHARE,
        };
        let low = share * look.elevation_rad.cos();
        let thermal = 10_f64.powf((REFERENCE_CN0 - cn0) / 20.0);
        let limit_m = PHASE_MULTIPATH_LIMIT * wavelength_m;
        let phase_multipath_m =
            errors.phase_multipath_m * low * self.phase_multipath[index].value();
        Measured {
            wavelength_m,
            pseudorange_m: late.pseudorange_m
                + errors.code_multipath_m * low * self.multipath[index].value()
                + errors.code_m * thermal * random.normal(),
            phase_m: late.phase_m
                + phase_multipath_m.clamp(-limit_m, limit_m)
                + errors.phase_m * thermal * random.normal(),
            doppler_m_s: late.doppler_m_s + errors.doppler_m_s * thermal * random.normal(),
        }
    }
}
