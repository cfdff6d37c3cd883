//! Scenarios: sky, surroundings, rover, receivers and atmosphere, with their parameters.

use super::city::CityPlan;
use super::motion::{Motion, Traffic};
use super::oddities::Oddities;
use crate::gnss::constants::{SECONDS_PER_DAY, SECONDS_PER_HOUR};
use crate::gnss::{Constellation, Enu, Geodetic, GpsTime, KlobucharCoefficients, ObservationCode};

/// All parameters of a simulation except its seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Time tag of the first epoch.
    pub start: GpsTime,
    /// Time from the first epoch to the last (s).
    pub duration_s: f64,
    /// Interval of the epochs (s).
    pub interval_s: f64,
    /// Start of the rover, at street level or on the ground.
    pub origin: Geodetic,
    /// Height of the rover's antenna above the ground (m).
    pub antenna_height_m: f64,
    /// Motion of the rover.
    pub motion: Motion,
    /// The city around the rover; `None`: open sky.
    pub city: Option<CityPlan>,
    /// Base station relative to the origin, under open sky; `None`: no base.
    pub base: Option<Enu>,
    /// Constellations that the receivers track.
    pub constellations: Vec<Constellation>,
    /// Number of signals received of each satellite, 1 or 2.
    pub frequencies: usize,
    /// Band of the second signal.
    pub second_band: SecondBand,
    /// Satellites below this elevation are not received (rad).
    pub elevation_mask_rad: f64,
    /// Whether broadcast orbits and clocks have errors of `signal_in_space_sigma_m`.
    pub broadcast_errors: bool,
    /// Atmosphere; `None`: vacuum.
    pub atmosphere: Option<Atmosphere>,
    /// Errors of the rover's receiver; `None`: error-free.
    pub rover_errors: Option<ReceiverErrors>,
    /// Errors of the base's receiver; `None`: error-free.
    pub base_errors: Option<ReceiverErrors>,
    /// Behaviour of the rover's receiver beyond noise; `None` for an ordinary receiver.
    pub oddities: Option<Oddities>,
    /// Clocks of both receivers.
    pub clock: ReceiverClock,
}

/// The band of a receiver's second signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SecondBand {
    /// L2, G2, E5b or B3.
    L2,
    /// L5, E5a or B2a, whose code is ten times as fast. GLONASS has no such signal.
    L5,
}

/// Delays in the atmosphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Atmosphere {
    /// Broadcast Klobuchar coefficients.
    pub klobuchar: KlobucharCoefficients,
    /// True over broadcast ionospheric delay, mean of all seeds.
    pub ionosphere_ratio: f64,
    /// Standard deviation of this ratio between seeds.
    pub ionosphere_spread: f64,
    /// Gradient of the zenith delay on L1 towards east and north of the origin (m/m; 1 mm/km is
    /// 1e-6). The delays of base and rover differ in proportion to their distance.
    pub ionosphere_gradient: [f64; 2],
    /// Relative humidity, 0 … 1.
    pub relative_humidity: f64,
}

/// Measurement errors of a receiver and its surroundings. Standard deviations refer to 45 dB-Hz and
/// grow by 10^(−(S − 45)/20) with C/N0 S, as thermal noise of tracking loops does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverErrors {
    /// Thermal noise of pseudoranges (m).
    pub code_m: f64,
    /// Thermal noise of carrier phases (m).
    pub phase_m: f64,
    /// Thermal noise of Doppler as range rate (m/s).
    pub doppler_m_s: f64,
    /// Multipath of pseudoranges at the horizon, proportional to the cosine of elevation (m).
    pub code_multipath_m: f64,
    /// Multipath of carrier phases at the horizon, proportional to the cosine of elevation (m).
    pub phase_multipath_m: f64,
    /// Correlation time of multipath at rest (s): satellites move slowly.
    pub multipath_correlation_s: f64,
    /// Distance over which multipath decorrelates (m).
    pub multipath_correlation_m: f64,
    /// Loss of the antenna relative to a good one (dB).
    pub antenna_loss_db: f64,
    /// Standard deviation of slow fading of C/N0 (dB).
    pub fading_db: f64,
    /// Correlation time of fading (s).
    pub fading_correlation_s: f64,
    /// Cycle slips per satellite and hour at 45 dB-Hz; ten times more at 10 dB less.
    pub slips_per_hour: f64,
    /// Share of slips that the receiver reports.
    pub slips_reported: f64,
    /// Smallest and largest slip (cycles).
    pub slip_cycles: (f64, f64),
    /// Whether both signals of a satellite slip together, by the same number of cycles.
    pub slips_together: bool,
    /// Mean time to resolve the half cycle after a loss of lock, flagged until then (s); 0: at
    /// once.
    pub half_cycle_s: f64,
    /// C/N0 below which signals are lost (dB-Hz).
    pub tracking_threshold_db_hz: f64,
    /// Time from a signal's return to its first measurements (s).
    pub reacquisition_s: f64,
}

/// Offset, drift and random walks of a receiver's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverClock {
    /// Largest offset at the start (s).
    pub offset_s: f64,
    /// Largest drift at the start (s/s).
    pub drift: f64,
    /// Random walk of the offset (m/√s).
    pub offset_walk_m: f64,
    /// Random walk of the drift (m/s/√s).
    pub drift_walk_m_s: f64,
    /// Whether an offset beyond half a millisecond is corrected by one millisecond.
    pub millisecond_jumps: bool,
    /// Step by which the rover steers its tags to GPS time (s); 0 for no steering. Phones steer in
    /// steps of 100 ns. Pseudoranges refer to the steered tag, Dopplers to the oscillator: the
    /// Doppler clock drift is then not the derivative of the pseudorange clock.
    pub tag_step_s: f64,
    /// Whether carrier phases refer to the steered tag; otherwise to the oscillator.
    pub phase_follows_tag: bool,
}

/// Standard deviation of the range error of broadcast orbits and clocks (m): an assumption, of the
/// size that operators and monitors report.
pub(crate) const fn signal_in_space_sigma_m(constellation: Constellation) -> f64 {
    match constellation {
        Constellation::Gps | Constellation::Qzss => 0.6,
        Constellation::Galileo => 0.3,
        Constellation::BeiDou => 1.0,
        Constellation::Glonass => 1.8,
    }
}

/// Height of an antenna on a car or a pole (m).
const ANTENNA_HEIGHT_M: f64 = 1.6;

impl ReceiverErrors {
    /// A receiver with a good antenna under open sky.
    pub(crate) const fn open_sky() -> Self {
        Self {
            code_m: 0.25,
            phase_m: 0.001_5,
            doppler_m_s: 0.03,
            code_multipath_m: 0.6,
            phase_multipath_m: 0.004,
            multipath_correlation_s: 100.0,
            multipath_correlation_m: 100.0,
            antenna_loss_db: 0.0,
            fading_db: 0.7,
            fading_correlation_s: 20.0,
            slips_per_hour: 0.05,
            slips_reported: 0.9,
            slip_cycles: (1.0, 20.0),
            slips_together: true,
            half_cycle_s: 0.0,
            tracking_threshold_db_hz: 25.0,
            reacquisition_s: 1.0,
        }
    }

    /// A low-cost receiver on a car between walls.
    pub(crate) const fn urban() -> Self {
        Self {
            code_m: 0.4,
            phase_m: 0.002,
            doppler_m_s: 0.05,
            code_multipath_m: 3.0,
            phase_multipath_m: 0.012,
            multipath_correlation_s: 100.0,
            multipath_correlation_m: 40.0,
            antenna_loss_db: 0.0,
            fading_db: 3.0,
            fading_correlation_s: 4.0,
            slips_per_hour: 2.0,
            slips_reported: 0.8,
            slip_cycles: (1.0, 20.0),
            slips_together: true,
            half_cycle_s: 0.0,
            tracking_threshold_db_hz: 20.0,
            reacquisition_s: 1.0,
        }
    }

    /// The same with independent slips of each signal and with half cycles.
    pub(super) const fn slipping(self) -> Self {
        Self { slip_cycles: (1.0, 5.0), slips_together: false, half_cycle_s: 3.0, ..self }
    }
}

impl Scenario {
    /// Names and descriptions of the scenarios.
    pub const NAMES: [(&'static str, &'static str); 5] = [
        ("open-sky", "a car on a figure of eight under open sky, base 2.5 km away"),
        (
            "urban-canyon",
            "a car in streets of 22 m between buildings of 15 to 60 m, base 3 km away",
        ),
        (
            "rtk-open",
            "the figure of eight with slips, half cycles and a sloping ionosphere, base 8 km away",
        ),
        (
            "rtk-canyon",
            "the streets with slips, half cycles and a sloping ionosphere, base 3 km away",
        ),
        ("clean", "the figure of eight without noise and without atmosphere"),
    ];

    /// The scenario with this name; `None` if [`Scenario::NAMES`] lacks it.
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "open-sky" => Some(Self::open_sky()),
            "urban-canyon" => Some(Self::urban_canyon()),
            "rtk-open" => Some(Self::rtk_open()),
            "rtk-canyon" => Some(Self::rtk_canyon()),
            "clean" => Some(Self::clean()),
            _ => None,
        }
    }

    /// Observation codes tracked of a constellation.
    pub fn signals(&self, constellation: Constellation) -> impl Iterator<Item = ObservationCode> {
        let all = signals(constellation, self.second_band);
        all.into_iter().flatten().take(self.frequencies)
    }

    /// Five minutes at 1 Hz on a figure of eight under open sky, two frequencies, with base.
    pub fn open_sky() -> Self {
        Self {
            // An afternoon (2026-01-01), when the ionosphere is strong.
            start: GpsTime::from_week_seconds(2399, 4.0 * SECONDS_PER_DAY + 6.0 * SECONDS_PER_HOUR),
            duration_s: 300.0,
            interval_s: 1.0,
            origin: Geodetic::from_degrees(22.3, 114.17, 8.0),
            antenna_height_m: ANTENNA_HEIGHT_M,
            motion: Motion::Loop { half_length_m: 250.0, speed_m_s: 10.0 },
            city: None,
            base: Some(Enu(nalgebra::Vector3::new(1_900.0, 1_600.0, 25.0))),
            constellations: vec![
                Constellation::Gps,
                Constellation::Glonass,
                Constellation::Galileo,
                Constellation::BeiDou,
            ],
            frequencies: 2,
            second_band: SecondBand::L2,
            elevation_mask_rad: 5_f64.to_radians(),
            broadcast_errors: true,
            atmosphere: Some(Atmosphere {
                klobuchar: KlobucharCoefficients {
                    alpha: [1.2e-8, 1.5e-8, -6.0e-8, -1.2e-7],
                    beta: [1.0e5, 1.0e5, -6.6e4, -3.9e5],
                },
                ionosphere_ratio: 1.15,
                ionosphere_spread: 0.25,
                ionosphere_gradient: [0.0; 2],
                relative_humidity: 0.6,
            }),
            rover_errors: Some(ReceiverErrors::open_sky()),
            base_errors: Some(ReceiverErrors::open_sky()),
            oddities: None,
            clock: ReceiverClock {
                offset_s: 1e-5,
                drift: 3e-8,
                offset_walk_m: 0.05,
                drift_walk_m_s: 0.02,
                millisecond_jumps: false,
                tag_step_s: 0.0,
                phase_follows_tag: true,
            },
        }
    }

    /// Ten minutes at 1 Hz through the streets of a dense city.
    pub fn urban_canyon() -> Self {
        Self {
            duration_s: 600.0,
            motion: Motion::Streets(Traffic::town()),
            city: Some(CityPlan::dense()),
            base: Some(Enu(nalgebra::Vector3::new(-2_400.0, 1_800.0, 60.0))),
            rover_errors: Some(ReceiverErrors::urban()),
            ..Self::open_sky()
        }
    }

    /// Ten minutes under open sky for relative positioning: base 8 km away, ionosphere with a
    /// gradient of 2 mm/km, independent slips of each signal.
    pub fn rtk_open() -> Self {
        Self { duration_s: 600.0, ..Self::open_sky().for_rtk() }.with_baseline(8_000.0)
    }

    /// The streets of [`urban_canyon`](Self::urban_canyon), with the errors of relative
    /// positioning.
    pub fn rtk_canyon() -> Self {
        Self::urban_canyon().for_rtk()
    }

    /// The scenario with the base at this distance from the origin (m), in its present direction,
    /// or due north of it if the scenario has no base. The height is kept.
    pub fn with_baseline(self, baseline_m: f64) -> Self {
        let Enu(before) = self.base.unwrap_or(Enu(nalgebra::Vector3::zeros()));
        let horizontal_m = before.xy().norm();
        let direction = match 0.0 < horizontal_m {
            true => before.xy() / horizontal_m,
            false => nalgebra::Vector2::new(0.0, 1.0),
        };
        let flat = direction * baseline_m;
        Self { base: Some(Enu(nalgebra::Vector3::new(flat.x, flat.y, before.z))), ..self }
    }

    /// The scenario with slips, half cycles and an ionospheric gradient.
    ///
    /// The gradient is 2 mm/km, towards the north-east.
    fn for_rtk(self) -> Self {
        let atmosphere = self
            .atmosphere
            .map(|atmosphere| Atmosphere { ionosphere_gradient: [1.2e-6, 1.6e-6], ..atmosphere });
        Self {
            atmosphere,
            rover_errors: self.rover_errors.map(ReceiverErrors::slipping),
            base_errors: self.base_errors.map(ReceiverErrors::slipping),
            ..self
        }
    }

    /// Open sky with error-free receivers in a vacuum: geometry and clocks only.
    pub fn clean() -> Self {
        Self {
            broadcast_errors: false,
            atmosphere: None,
            rover_errors: None,
            base_errors: None,
            ..Self::open_sky()
        }
    }
}
/// Observation codes received of a constellation, in order of preference.
fn signals(constellation: Constellation, second: SecondBand) -> [Option<ObservationCode>; 2] {
    use Constellation as C;
    let names = match (constellation, second) {
        (C::Gps | C::Qzss, SecondBand::L2) => [Some("1C"), Some("2L")],
        (C::Gps | C::Qzss | C::Galileo, SecondBand::L5) => [Some("1C"), Some("5Q")],
        (C::Glonass, SecondBand::L2) => [Some("1C"), Some("2C")],
        (C::Glonass, SecondBand::L5) => [Some("1C"), None],
        (C::Galileo, SecondBand::L2) => [Some("1C"), Some("7Q")],
        (C::BeiDou, SecondBand::L2) => [Some("2I"), Some("6I")],
        (C::BeiDou, SecondBand::L5) => [Some("2I"), Some("5P")],
    };
    let parse = |name| ObservationCode::parse(name).expect("the codes are RINEX 3's");
    names.map(|name| name.map(parse))
}
