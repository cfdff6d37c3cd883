//! From observations to corrected, weighted measurements.
//!
//! [`Measurements::gather`] selects one main signal per satellite and, if the options require it, a
//! second one on another frequency. It finds the ephemeris and the satellite's state at
//! transmission, and subtracts clock and group delay. [`Measurements::place`] adds the corrections
//! that depend on the receiver's position: angles, atmosphere and variance. The remaining
//! pseudorange is ρ + c·δt_r + noise.

mod atmosphere;
mod bands;
mod corrected;
mod ephemeris_steps;
mod inter_frequency;
mod signals;
mod weights;

use crate::config::{IonosphereModel, PositioningOptions};
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Band, Constellation, Ecef, Ephemeris, EphemerisIssue, Epoch, GpsTime, Meters, Navigation,
    Observation, ObservationCode, Odometry, Reason, SatelliteId, Signal,
};
use crate::models::{
    LookAngles, SatelliteState, UNSTATED_DELAY_M, closest_ephemerides, ephemerides_in_force,
    group_delay_m, state_at_transmission, unstated_delay_m,
};

use atmosphere::Atmosphere;
use inter_frequency::InterFrequencyBiases;

pub(super) use atmosphere::RELATIVE_HUMIDITY;
pub(super) use bands::ReceiverBands;
pub(super) use corrected::CorrectedRanges;
pub(super) use signals::preference;
pub(super) use weights::{constellation_factor, receiver_weights};

/// Valid pseudoranges of a receiver on Earth (m): its clock may be off by 0.2 s.
pub(super) const PSEUDORANGES_M: std::ops::Range<f64> = 1e6..1e8;

/// A pseudorange on a second frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondFrequency {
    /// Observation code of the second signal.
    pub code: ObservationCode,
    /// Pseudorange free of satellite clock and group delay (m).
    pub pseudorange_m: f64,
    /// γ = (f_1/f_2)²: ratio of the ionospheric delays on the second and on the main frequency.
    pub gamma: f64,
    /// C/N0 (dB-Hz).
    pub cn0_db_hz: Option<f64>,
    /// Variance of receiver noise and multipath (m²).
    pub noise_m2: f64,
    /// Carrier phase, if measured.
    pub phase: Option<CarrierPhase>,
}

/// A carrier phase in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarrierPhase {
    /// λφ without the satellite's clock (m): ρ + c·δt_r + λN, advanced by the ionosphere.
    pub range_m: f64,
    /// A cycle slip was possible since the previous epoch.
    pub loss_of_lock: bool,
    /// Whether the phase may be off by half a cycle.
    pub half_cycle: bool,
    /// What a change to another ephemeris since the previous epoch adds to the range of the orbit
    /// and takes from `range_m` (m); zero without a change.
    pub ephemeris_step_m: f64,
}

/// The measurements of one satellite at one epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// The measured satellite.
    pub satellite: SatelliteId,
    /// Observation code of the main signal.
    pub code: ObservationCode,
    /// Carrier frequency of the main signal (Hz).
    pub frequency_hz: f64,
    /// Ephemeris that gives the satellite's state.
    pub ephemeris: EphemerisIssue,
    /// State of the satellite at transmission.
    pub state: SatelliteState,
    /// Main pseudorange without satellite clock and group delay (m).
    pub pseudorange_m: f64,
    /// Variance of that group delay (m²); zero if the message states the delay.
    pub group_delay_m2: f64,
    /// The second frequency, if there is one.
    pub second: Option<SecondFrequency>,
    /// Range rate from Doppler without the satellite's clock drift (m/s): ρ̇ + c·δṫ_r.
    pub range_rate_m_s: Option<f64>,
    /// Carrier phase of the main signal, if measured.
    pub phase: Option<CarrierPhase>,
    /// C/N0 of the main signal (dB-Hz).
    pub cn0_db_hz: Option<f64>,
    /// Azimuth and elevation from the latest position.
    pub look: LookAngles,
    /// Variance of the main signal's receiver noise and multipath (m²).
    pub noise_m2: f64,
    /// Modelled ionospheric delay on the main frequency (m).
    pub ionosphere_m: f64,
    /// Variance of the ionospheric delay (m²); infinite without a model.
    pub ionosphere_m2: f64,
    /// Modelled tropospheric slant delay (m).
    pub troposphere_m: f64,
    /// Pseudorange corrected for the atmosphere, too (m): ρ + c·δt_r.
    pub corrected_range_m: f64,
    /// Variance of `corrected_range_m` (m²).
    pub variance_m2: f64,
    /// Standard deviation of `corrected_range_m` due to the ionosphere model (m).
    pub ionosphere_sigma_m: f64,
    /// Standard deviation of `corrected_range_m` due to the troposphere model (m).
    pub troposphere_sigma_m: f64,
    /// Whether the satellite is above the elevation mask.
    pub is_above_mask: bool,
    /// Whether the satellite is excluded because it contradicts the others.
    pub is_excluded: bool,
}

/// The measurements of one epoch; the memory is reused.
#[derive(Clone, Debug, Default)]
pub struct Measurements {
    /// One measurement for each usable satellite, in the order of the observations.
    pub list: Vec<Measurement>,
    /// Observed satellites without a valid healthy ephemeris, sorted.
    pub without_ephemeris: Vec<SatelliteId>,
    /// Coefficients for the chosen ionosphere model are missing; this model is used instead.
    pub ionosphere_fallback: Option<&'static str>,
    /// Displacement since the previous epoch by another sensor.
    pub odometry: Option<Odometry>,
    biases: InterFrequencyBiases,
}

impl Measurements {
    /// Takes the usable measurements of `epoch` under `options`, corrected for satellites and
    /// clocks.
    ///
    /// If a satellite or signal appears twice, the first one counts. A signal whose group delay no
    /// message contains is used only if the receiver's bands agree.
    pub(super) fn gather(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
        bands: ReceiverBands,
    ) {
        self.list.clear();
        self.without_ephemeris.clear();
        self.ionosphere_fallback = None; // Known once they are placed.
        self.odometry = epoch.odometry;
        let mut seen = [0_u128; Constellation::COUNT];
        for (satellite, observations) in epoch.by_satellite() {
            let bits = &mut seen[satellite.constellation.index()];
            let bit = 1_u128 << satellite.number;
            let wanted = options.systems.contains(satellite.constellation)
                && options.excluded_satellites.binary_search(&satellite).is_err();
            if !wanted || *bits & bit != 0 {
                continue;
            }
            *bits |= bit;
            let reach_s = options.ephemeris_beidou_s;
            let closest = closest_ephemerides(navigation, satellite, epoch.time, reach_s);
            if closest.clone().next().is_none() {
                self.without_ephemeris.push(satellite);
                continue;
            }
            // D1 has no group delay of B1C and B2a, B-CNAV has. LNAV has none of L5, CNAV has.
            let measured = |delays| {
                closest.clone().find_map(|ephemeris| {
                    measurement(epoch, ephemeris, observations, options, delays)
                })
            };
            let stated = measured(Delays::Stated);
            self.list.extend(stated.or_else(|| measured(Delays::allowed(bands))));
        }
        self.without_ephemeris.sort_unstable();
    }

    /// Adds what depends on the receiver's position: angles, atmosphere, variance and mask.
    ///
    /// `None` for a position where no receiver can be: far below the ground or in space.
    pub fn place(
        &mut self,
        position: Ecef,
        time: GpsTime,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Option<()> {
        let atmosphere = Atmosphere::at(position, time, navigation, options)?;
        self.ionosphere_fallback = atmosphere.correct(&mut self.list, &mut self.biases, options);
        Some(())
    }

    /// Replaces the placed pseudoranges by those that a base corrected, in which the errors of
    /// orbit, clock and atmosphere cancel. The others are excluded.
    pub(super) fn correct(&mut self, ranges: &CorrectedRanges) {
        for measurement in &mut self.list {
            match ranges.range_m(measurement.satellite, measurement.code) {
                Some(range_m) => {
                    measurement.corrected_range_m = range_m;
                    measurement.variance_m2 = measurement.noise_m2;
                    measurement.ionosphere_sigma_m = 0.0;
                    measurement.troposphere_sigma_m = 0.0;
                }
                None => measurement.is_excluded = true,
            }
        }
    }

    /// Appends the reasons for missing data that are known before the position to `reasons`.
    pub(super) fn aiding_reasons(&self, reasons: &mut Vec<Reason>) {
        aiding_reasons(&self.without_ephemeris, self.ionosphere_fallback, reasons);
    }
}

/// Appends the reasons for missing data to `reasons`: satellites without an ephemeris, and the
/// replacement of the chosen ionosphere model.
pub(super) fn aiding_reasons(
    without_ephemeris: &[SatelliteId],
    ionosphere_fallback: Option<&'static str>,
    reasons: &mut Vec<Reason>,
) {
    if !without_ephemeris.is_empty() {
        reasons.push(Reason::EphemerisMissing { satellites: without_ephemeris.to_vec() });
    }
    reasons.extend(ionosphere_fallback.map(|used| Reason::IonosphereFallback { used }));
}

impl Measurement {
    /// This measurement with the first other ephemeris in force for which `agrees` is true. Its
    /// atmospheric delays stay those of this measurement until [`Measurements::place`].
    pub(super) fn with_other_ephemeris(
        &self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
        bands: ReceiverBands,
        agrees: impl Fn(&Self) -> bool,
    ) -> Option<Self> {
        let reach_s = options.ephemeris_beidou_s;
        let mut satellites = epoch.by_satellite();
        let (_, observations) = satellites.find(|(satellite, _)| *satellite == self.satellite)?;
        let atmosphere_m = self.corrected_range_m - self.pseudorange_m;
        let in_force = ephemerides_in_force(navigation, self.satellite, epoch.time, reach_s);
        let delays = Delays::allowed(bands);
        let others = in_force.filter_map(|ephemeris| {
            let other = measurement(epoch, ephemeris, observations, options, delays)?;
            Some(Self {
                corrected_range_m: other.pseudorange_m + atmosphere_m,
                variance_m2: self.variance_m2,
                is_above_mask: self.is_above_mask,
                look: self.look,
                ..other
            })
        });
        others.filter(|other| other.state != self.state).find(|other| agrees(other))
    }
}

/// The group delays that a measurement may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Delays {
    /// Those that the message states.
    Stated,
    /// Also those of [`unstated_delay_m`].
    StatedOrNot,
}

impl Delays {
    /// The delays that are allowed if the receiver has these bands.
    fn allowed(bands: ReceiverBands) -> Self {
        if bands.agree() { Self::StatedOrNot } else { Self::Stated }
    }
}

/// The measurement of one satellite, before [`Measurements::place`].
fn measurement(
    epoch: &Epoch,
    ephemeris: &Ephemeris,
    observations: &[Observation],
    options: &PositioningOptions,
    delays: Delays,
) -> Option<Measurement> {
    let main = best_of_first_band(ephemeris, observations, options, delays, None)?;
    let wants_second =
        options.dual_frequency || options.ionosphere == IonosphereModel::IonosphereFree;
    let second = match wants_second {
        true => best_of_first_band(ephemeris, observations, options, delays, Some(main.band)),
        false => None,
    };
    if options.ionosphere == IonosphereModel::IonosphereFree && second.is_none() {
        return None;
    }
    let state = state_at_transmission(ephemeris, epoch.time, main.pseudorange_m);
    let phase = |observation: &Observation, frequency_hz| {
        let phase = carrier_phase(observation, frequency_hz, &state)?;
        let loss_of_lock = phase.loss_of_lock || epoch.power_failure;
        Some(CarrierPhase { loss_of_lock, ..phase })
    };
    let observation = main.observation;
    let wavelength_m = SPEED_OF_LIGHT / main.frequency_hz;
    Some(Measurement {
        satellite: observation.satellite,
        code: observation.code,
        frequency_hz: main.frequency_hz,
        ephemeris: EphemerisIssue {
            satellite: observation.satellite,
            toe: ephemeris.toe(),
            issue: ephemeris.issue(),
        },
        state,
        pseudorange_m: main.pseudorange_m - main.group_delay_m + state.clock_m,
        group_delay_m2: main.group_delay_m2,
        second: second.map(|second| SecondFrequency {
            code: second.observation.code,
            pseudorange_m: second.pseudorange_m - second.group_delay_m + state.clock_m,
            gamma: (main.frequency_hz / second.frequency_hz).powi(2),
            cn0_db_hz: second.observation.cn0_db_hz,
            noise_m2: f64::INFINITY,
            phase: phase(second.observation, second.frequency_hz),
        }),
        range_rate_m_s: observation
            .doppler_hz
            .filter(|doppler_hz| doppler_hz.is_finite())
            .map(|doppler_hz| -wavelength_m * doppler_hz + state.clock_drift_m_s),
        phase: phase(observation, main.frequency_hz),
        cn0_db_hz: observation.cn0_db_hz,
        look: LookAngles { azimuth_rad: 0.0, elevation_rad: 0.0 },
        noise_m2: f64::INFINITY,
        ionosphere_m: 0.0,
        ionosphere_m2: f64::INFINITY,
        troposphere_m: 0.0,
        corrected_range_m: 0.0,
        variance_m2: f64::INFINITY,
        ionosphere_sigma_m: 0.0,
        troposphere_sigma_m: 0.0,
        is_above_mask: false,
        is_excluded: false,
    })
}

/// The carrier phase of one signal as a length.
fn carrier_phase(
    observation: &Observation,
    frequency_hz: f64,
    satellite: &SatelliteState,
) -> Option<CarrierPhase> {
    let phase = observation.carrier_phase.filter(|phase| phase.is_resolved())?;
    Some(CarrierPhase {
        range_m: phase.to_meters(Meters(SPEED_OF_LIGHT / frequency_hz)).0 + satellite.clock_m,
        loss_of_lock: observation.loss_of_lock,
        half_cycle: observation.half_cycle,
        ephemeris_step_m: 0.0,
    })
}

/// A usable pseudorange with the properties of its signal.
struct Candidate<'a> {
    observation: &'a Observation,
    pseudorange_m: f64,
    band: Band,
    place: u8,
    frequency_hz: f64,
    group_delay_m: f64,
    /// Its variance (m²); zero if the message states it.
    group_delay_m2: f64,
}

/// The group delay of a signal, and its variance (m²).
fn group_delay(
    ephemeris: &Ephemeris,
    code: ObservationCode,
    options: &PositioningOptions,
) -> Option<(f64, f64)> {
    if ephemeris.satellite().constellation == Constellation::BeiDou && !options.group_delay_beidou {
        return Some((0.0, 0.0));
    }
    let stated = group_delay_m(ephemeris, code).map(|delay_m| (delay_m, 0.0));
    stated.or_else(|| {
        let delay_m = unstated_delay_m(ephemeris, code)?;
        Some((delay_m, UNSTATED_DELAY_M * UNSTATED_DELAY_M))
    })
}

/// The preferred signal of the first band, in the order of [`Band::ALL`], in which the satellite
/// was observed; with `other_than`, of the first other band.
fn best_of_first_band<'a>(
    ephemeris: &Ephemeris,
    observations: &'a [Observation],
    options: &PositioningOptions,
    delays: Delays,
    other_than: Option<Band>,
) -> Option<Candidate<'a>> {
    let usable = observations.iter().filter_map(|observation| {
        let signal = Signal::of(observation.satellite, observation.code);
        let band = signal.band()?;
        let pseudorange_m = observation.pseudorange_m?;
        let is_wanted = options.frequencies.contains(band)
            && other_than != Some(band)
            && PSEUDORANGES_M.contains(&pseudorange_m)
            && observation.cn0_db_hz.is_none_or(|cn0| options.cn0_mask_db_hz <= cn0);
        if !is_wanted {
            return None;
        }
        let (group_delay_m, group_delay_m2) = group_delay(ephemeris, observation.code, options)?;
        // The second pseudorange corrects the first, so its group delay must be known.
        if 0.0 < group_delay_m2 && (other_than.is_some() || delays == Delays::Stated) {
            return None;
        }
        Some(Candidate {
            observation,
            pseudorange_m,
            band,
            place: signals::preference(signal, band)?,
            frequency_hz: signal.frequency_hz(ephemeris.glonass_channel())?,
            group_delay_m,
            group_delay_m2,
        })
    });
    usable.min_by_key(|candidate| (candidate.band, candidate.place))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, Profile};
    use crate::gnss::{Cycles, GroupDelays, KeplerianEphemeris, NavigationMessage};
    use crate::simulation::{Scenario, navigation};

    /// D1 has no group delay of B1C, B-CNAV has one of 4 ns. B1I is measured with D1, and with
    /// B-CNAV, which has no delay of B1I, it would not be measured.
    #[test]
    fn the_message_is_one_that_has_the_delay_of_the_observed_signal() {
        let broadcast = navigation(&Scenario::open_sky());
        let d1_of = |ephemeris: &Ephemeris| match ephemeris {
            Ephemeris::Keplerian(e) if e.message == NavigationMessage::D1 => Some(e.clone()),
            _ => None,
        };
        let all = broadcast.satellites().flat_map(|(_, list)| list);
        let d1 = all.filter_map(d1_of).next().expect("the scenario has BeiDou");
        let GroupDelays::BeiDou { tgd1_s, .. } = d1.group_delays else { panic!("D1") };
        let cnav = KeplerianEphemeris {
            message: NavigationMessage::Cnv1,
            group_delays: GroupDelays::BeiDouCnav {
                tgd_b1cp_s: Some(4e-9),
                tgd_b2ap_s: None,
                tgd_b2bi_s: None,
                isc_b1cd_s: None,
                isc_b2ad_s: None,
            },
            ..d1.clone()
        };
        let (satellite, time) = (d1.satellite, d1.toe);
        let mut known = Navigation::default();
        known.insert_all([d1, cnav].map(Ephemeris::Keplerian));
        let options = PositioningOptions::new(Mode::Fgo, Profile::General);
        for (code, delay_s) in [("1P", 4e-9), ("2I", tgd1_s)] {
            let code = ObservationCode::parse(code).unwrap();
            let mut observation = Observation::empty(satellite, code);
            observation.pseudorange_m = Some(2.2e7);
            let epoch = Epoch { observations: vec![observation], ..Epoch::new(time) };
            let mut measurements = Measurements::default();
            measurements.gather(&epoch, &known, &options, ReceiverBands::AGREEING);
            let [measured] = &measurements.list[..] else { panic!("{code:?} is not measured") };
            let delay_m = 2.2e7 + measured.state.clock_m - measured.pseudorange_m;
            assert!((delay_m - delay_s * SPEED_OF_LIGHT).abs() < 1e-6, "{code:?} {delay_m}");
        }
    }

    /// After a power failure no phase continues that of the epoch before.
    #[test]
    fn a_power_failure_loses_all_phases() {
        let broadcast = navigation(&Scenario::open_sky());
        let (satellite, list) = broadcast.satellites().next().unwrap();
        let code = ObservationCode::parse("1C").unwrap();
        let observation = Observation {
            pseudorange_m: Some(2.2e7),
            carrier_phase: Some(Cycles(1e8)),
            ..Observation::empty(satellite, code)
        };
        for power_failure in [false, true] {
            let observations = vec![observation];
            let epoch = Epoch { observations, power_failure, ..Epoch::new(list[0].toe()) };
            let options = PositioningOptions::new(Mode::Fgo, Profile::General);
            let mut measurements = Measurements::default();
            measurements.gather(&epoch, &broadcast, &options, ReceiverBands::AGREEING);
            assert_eq!(measurements.list[0].phase.unwrap().loss_of_lock, power_failure);
        }
    }

    /// A GPS satellite that is received on L5 alone. LNAV states no delay of L5, so one is assumed;
    /// CNAV states T_GD − ISC_L5Q5.
    #[test]
    fn a_stated_delay_goes_before_an_assumed_one() {
        let broadcast = navigation(&Scenario::open_sky());
        let lnav_of = |ephemeris: &Ephemeris| match ephemeris {
            Ephemeris::Keplerian(e) if e.message == NavigationMessage::Lnav => Some(e.clone()),
            _ => None,
        };
        let all = broadcast.satellites().flat_map(|(_, list)| list);
        let lnav = all.filter_map(lnav_of).next().expect("the scenario has GPS");
        let (tgd_s, isc_s) = (-5e-9, 3e-9);
        let delays = |isc_l5q_s| GroupDelays::Gps {
            tgd_s,
            isc_l1ca_s: None,
            isc_l2c_s: None,
            isc_l5i_s: None,
            isc_l5q_s,
            isc_l1cd_s: None,
            isc_l1cp_s: None,
        };
        let lnav = KeplerianEphemeris { group_delays: delays(None), ..lnav };
        let message = NavigationMessage::Cnav;
        let cnav =
            KeplerianEphemeris { message, group_delays: delays(Some(isc_s)), ..lnav.clone() };
        let mut observation =
            Observation::empty(lnav.satellite, ObservationCode::parse("5Q").unwrap());
        observation.pseudorange_m = Some(2.2e7);
        let epoch = Epoch { observations: vec![observation], ..Epoch::new(lnav.toe) };
        let options = PositioningOptions::new(Mode::Fgo, Profile::General);
        let measured = |list: &[&KeplerianEphemeris], bands| {
            let mut known = Navigation::default();
            known.insert_all(list.iter().map(|e| Ephemeris::Keplerian((*e).clone())));
            let mut measurements = Measurements::default();
            measurements.gather(&epoch, &known, &options, bands);
            let delay = |m: &Measurement| {
                let delay_m = 2.2e7 + m.state.clock_m - m.pseudorange_m;
                (delay_m / SPEED_OF_LIGHT, m.group_delay_m2)
            };
            measurements.list.first().map(delay)
        };
        let (agreeing, unknown) = (ReceiverBands::AGREEING, ReceiverBands::default());
        for bands in [agreeing, unknown] {
            let (delay_s, variance_m2) = measured(&[&lnav, &cnav], bands).expect("by CNAV");
            assert!((delay_s - (tgd_s - isc_s)).abs() < 1e-14, "{delay_s}");
            assert_eq!(variance_m2, 0.0);
        }
        let (delay_s, variance_m2) = measured(&[&lnav], agreeing).expect("by LNAV");
        assert!((delay_s - (154.0_f64 / 115.0).powi(2) * tgd_s).abs() < 1e-14, "{delay_s}");
        assert_eq!(variance_m2, UNSTATED_DELAY_M * UNSTATED_DELAY_M);
        assert_eq!(measured(&[&lnav], unknown), None);
    }
}
