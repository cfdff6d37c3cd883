//! Single differences rover − base of modelled residuals.
//!
//! For each satellite and carrier that both receivers observe, with P or λφ for m,
//!
//! z = (m_r + c·δtˢ(t_r) − T_r) − (m_b + c·δtˢ(t_b) − ρ(s(t_b), p_b) − T_b)
//!
//! so that z = ρ(s(t_r), p_r) + o + λN: o, what the receivers' clocks and delays leave, is common
//! to all satellites of one signal; N (cycles) is there for carrier phases only. Each receiver
//! has its own time of reception, its own satellite state at transmission and its own troposphere;
//! both use one ephemeris, so that its error cancels. The variance includes the residual
//! ionospheric delay.
//!
//! Differences between satellites are not formed here. The graph eliminates o in each group of
//! rows, which is equivalent and needs no reference satellite.

mod corrected;
mod pairing;
mod signal_levels;
mod variances;

use crate::config::{
    PositioningOptions, REFERENCE_CN0_DB_HZ, TroposphereMapping, TroposphereModel,
};
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Band, BaseStation, Constellation, Cycles, Ecef, Ephemeris, EphemerisIssue, Epoch, GpsTime,
    LocalFrame, Meters, Navigation, Observation, ObservationCode, SatelliteId,
};
use crate::models::troposphere::{Mapping, Troposphere};
use crate::models::{
    LookAngles, SatelliteState, geometric_range, look_angles, select_ephemeris_within,
    state_at_transmission,
};

use crate::snapshot::snapshot_fields;

use super::measurements::{PSEUDORANGES_M, RELATIVE_HUMIDITY};
use super::pseudorange_error::WILD_M;
use super::velocity::{CN0_IF_MISSING_DB_HZ, variance_m2_s2};
use crate::graph::median;
pub(super) use corrected::BaseClock;
use pairing::{Pair, pairs};
pub(super) use signal_levels::SignalLevels;
use variances::{DifferenceVariances, PairQuality};

/// Satellite states this close in time are extrapolated by velocity (s): a²t/2 is then 0.03 mm.
const CARRIED_S: f64 = 0.01;

/// A difference with its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Differenced {
    /// z (m).
    pub(super) range_m: f64,
    /// (m²).
    pub(super) variance_m2: f64,
}

/// A range rate, corrected for the satellite's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RangeRate {
    pub(super) rate_m_s: f64,
    pub(super) variance_m2_s2: f64,
}

/// A satellite that both receivers observe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CommonSatellite {
    pub(super) satellite: SatelliteId,
    /// State at the transmission of the signal that the rover received.
    pub(super) state: SatelliteState,
    /// −λD + c·δṫˢ by the rover's least noisy Doppler shift, of the signals that both receive.
    pub(super) range_rate: Option<RangeRate>,
    /// Direction from the rover.
    pub(super) look: LookAngles,
    /// C/N0 of the rover's strongest signal, of those that both receive (dB-Hz).
    pub(super) cn0_db_hz: Option<f64>,
    pub(super) ephemeris: EphemerisIssue,
    /// The rover's pseudorange without satellite clock and troposphere (m): ρ + c·δt_r + I.
    pub(super) rover_range_m: f64,
    /// The base's pseudorange corrected in the same way, without its range ρ (m): c·δt_b + I.
    pub(super) base_offset_m: f64,
}

/// Identifies the differences that have a common offset.
///
/// Geostationary BeiDou satellites are a group of their own: their navigation messages are
/// modulated differently. With receivers of different makers their phases differ by half a cycle
/// from those of the other satellites (Nadarajah, Teunissen & Raziq 2013, *BeiDou
/// inter-satellite-type bias evaluation and calibration for mixed receiver attitude determination*,
/// Sensors 13).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct DifferenceGroup {
    pub(super) constellation: Constellation,
    is_geostationary: bool,
    band: Band,
    codes: [ObservationCode; 2],
}

snapshot_fields!(DifferenceGroup { constellation, is_geostationary, band, codes });

impl DifferenceGroup {
    pub(super) fn of(satellite: SatelliteId, band: Band, codes: [ObservationCode; 2]) -> Self {
        let constellation = satellite.constellation;
        Self { constellation, is_geostationary: satellite.is_beidou_geo(), band, codes }
    }
}

/// A carrier of one satellite that both receivers observe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SingleDifference {
    /// Index in [`SingleDifferences::satellites`].
    pub(super) common: usize,
    pub(super) satellite: SatelliteId,
    pub(super) band: Band,
    /// Codes at rover and base.
    pub(super) codes: [ObservationCode; 2],
    /// Whether both pseudoranges are of one ranging code, so that the satellite's delay cancels.
    pub(super) shares_code: bool,
    pub(super) frequency_hz: f64,
    pub(super) pseudorange: Option<Differenced>,
    pub(super) carrier: Option<Differenced>,
    /// The phase of either receiver may be off by half a cycle.
    pub(super) half_cycle: bool,
}

impl SingleDifference {
    /// λ (m).
    pub(super) fn wavelength_m(&self) -> f64 {
        SPEED_OF_LIGHT / self.frequency_hz
    }

    /// The group, whose differences have a common offset.
    pub(super) fn group(&self) -> DifferenceGroup {
        DifferenceGroup::of(self.satellite, self.band, self.codes)
    }
}

/// Inputs for differencing a rover's epoch.
#[derive(Clone, Copy, Debug)]
pub(super) struct BaseSide<'a> {
    pub(super) station: &'a BaseStation,
    pub(super) epoch: &'a Epoch,
    /// C/N0 levels of the rover's signals.
    pub(super) levels: &'a SignalLevels,
}

/// The single differences of one epoch; the memory is used again for the next.
#[derive(Clone, Debug, Default)]
pub(super) struct SingleDifferences {
    /// In the order the rover observed them.
    pub(super) satellites: Vec<CommonSatellite>,
    /// By group, then by satellite.
    pub(super) list: Vec<SingleDifference>,
    /// Satellites that both observe and that have no valid healthy ephemeris, sorted.
    pub(super) without_ephemeris: Vec<SatelliteId>,
    /// Satellites of the base with the range of their observations, sorted.
    base: Vec<(SatelliteId, usize, usize)>,
    numbers: Vec<f64>,
}

impl SingleDifferences {
    /// Differences `rover`, whose antenna is approximately at `position`, against a base.
    ///
    /// `None` for a position where no receiver can be: far below the ground or in space.
    pub(super) fn gather(
        &mut self,
        rover: &Epoch,
        position: Ecef,
        base: &BaseSide<'_>,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Option<()> {
        self.satellites.clear();
        self.list.clear();
        self.without_ephemeris.clear();
        self.index(base.epoch);
        let baseline_m = position.distance_m(base.station.antenna_reference_point);
        let at = base.station.antenna_reference_point;
        let scene = Scene {
            rover: Receiver::at(position, rover.time, options)?,
            base: Receiver::at(at, base.epoch.time, options)?,
            variances: DifferenceVariances::new(options, baseline_m, rover.time - base.epoch.time),
        };
        let mut common = Vec::new();
        for (satellite, observations) in rover.by_satellite() {
            let wanted = options.systems.contains(satellite.constellation)
                && options.excluded_satellites.binary_search(&satellite).is_err()
                && self.satellites.iter().all(|known| known.satellite != satellite);
            let place = self.base.binary_search_by_key(&satellite, |entry| entry.0);
            let (Ok(place), true) = (place, wanted) else { continue };
            let reach_s = options.ephemeris_beidou_s;
            let closest = select_ephemeris_within(navigation, satellite, rover.time, reach_s);
            let Some(ephemeris) = closest else {
                self.without_ephemeris.push(satellite);
                continue;
            };
            let (_, begin, end) = self.base[place];
            let others = &base.epoch.observations[begin..end];
            pairs(observations, others, ephemeris.glonass_channel(), options, &mut common);
            self.add(&scene, &common, (ephemeris, base.levels), options);
        }
        self.without_ephemeris.sort_unstable();
        self.receive_at_once(&scene);
        self.mask(options);
        self.list.sort_unstable_by_key(|difference| (difference.group(), difference.satellite));
        self.drop_wild(&scene.rover);
        Some(())
    }

    fn index(&mut self, base: &Epoch) {
        self.base.clear();
        let mut begin = 0;
        for (satellite, observations) in base.by_satellite() {
            let end = begin + observations.len();
            self.base.push((satellite, begin, end));
            begin = end;
        }
        self.base.sort_unstable();
        self.base.dedup_by_key(|entry| entry.0);
    }

    /// The differences of one satellite. There are none if a receiver has no pseudorange of it,
    /// because the time of transmission follows from the pseudorange.
    fn add(
        &mut self,
        scene: &Scene,
        common: &[Pair<'_>],
        (ephemeris, levels): (&Ephemeris, &SignalLevels),
        options: &PositioningOptions,
    ) {
        let Some((rover_m, base_m)) = ranges_m(common) else { return };
        let [state, base_state] = scene.states(ephemeris, rover_m, base_m);
        let look = look_angles(&scene.rover.frame, state.position);
        let base_look = look_angles(&scene.base.frame, base_state.position);
        let rover_part_m = state.clock_m - scene.rover.slant_delay_m(look.elevation_rad);
        let (base_range_m, _) = geometric_range(base_state.position, scene.base.frame.origin);
        let base_part_m =
            base_state.clock_m - scene.base.slant_delay_m(base_look.elevation_rad) - base_range_m;
        let satellite = ephemeris.satellite();
        for pair in common {
            let quality = PairQuality {
                constellation: satellite.constellation,
                frequency_hz: pair.frequency_hz,
                elevation_rad: look.elevation_rad,
                relative_cn0_db: [
                    levels.relative_db(pair.rover),
                    pair.base.cn0_db_hz.map(|cn0_db_hz| cn0_db_hz - REFERENCE_CN0_DB_HZ),
                ],
            };
            let difference = |(rover_m, base_m): (f64, f64), variance_m2: f64| Differenced {
                range_m: (rover_m + rover_part_m) - (base_m + base_part_m),
                variance_m2,
            };
            let pseudoranges = valid_m(pair.rover).zip(valid_m(pair.base));
            let carriers = carrier_m(pair.rover, pair).zip(carrier_m(pair.base, pair));
            let variances = &scene.variances;
            self.list.push(SingleDifference {
                common: self.satellites.len(),
                satellite,
                band: pair.band,
                codes: [pair.rover.code, pair.base.code],
                shares_code: pair.shares_code(),
                frequency_hz: pair.frequency_hz,
                pseudorange: pseudoranges
                    .map(|ranges| difference(ranges, variances.pseudorange_m2(&quality))),
                carrier: carriers.map(|ranges| difference(ranges, variances.carrier_m2(&quality))),
                half_cycle: pair.rover.half_cycle || pair.base.half_cycle,
            });
        }
        self.satellites.push(CommonSatellite {
            satellite,
            state,
            range_rate: range_rate(common, &state, options),
            look,
            cn0_db_hz: strongest_db_hz(common),
            ephemeris: EphemerisIssue { satellite, toe: ephemeris.toe(), issue: ephemeris.issue() },
            rover_range_m: rover_m + rover_part_m,
            base_offset_m: base_m + base_part_m,
        });
    }

    /// Corrects times of transmission that were computed from wild pseudoranges.
    ///
    /// A receiver samples all signals at one time, which follows from its clock offset: the median
    /// of pseudoranges minus ranges, if most of them agree with it. A pseudorange that is off by
    /// more than W = 440 m, the most that multipath can cause, gives the phases of its satellite an
    /// error above a millimetre: ρ̇·W/c with ρ̇ of 800 m/s.
    fn receive_at_once(&mut self, scene: &Scene) {
        let Self { satellites, list, numbers, .. } = self;
        let range_m = |state: &SatelliteState, from: &Receiver| {
            geometric_range(state.position, from.frame.origin).0
        };
        let offset_m = |s: &CommonSatellite| s.rover_range_m - range_m(&s.state, &scene.rover);
        if let Some(clock_m) = agreed_m(satellites.iter().map(offset_m), numbers) {
            for satellite in satellites.iter_mut() {
                let wild_m = offset_m(satellite) - clock_m;
                if WILD_M < wild_m.abs() {
                    satellite.state = carried(&satellite.state, wild_m / SPEED_OF_LIGHT);
                }
            }
        }
        if let Some(clock_m) = agreed_m(satellites.iter().map(|s| s.base_offset_m), numbers) {
            for (common, satellite) in satellites.iter_mut().enumerate() {
                let wild_m = satellite.base_offset_m - clock_m;
                if wild_m.abs() <= WILD_M {
                    continue;
                }
                let moved = carried(&satellite.state, wild_m / SPEED_OF_LIGHT);
                let farther_m =
                    range_m(&moved, &scene.base) - range_m(&satellite.state, &scene.base);
                satellite.base_offset_m -= farther_m;
                for difference in list.iter_mut().filter(|d| d.common == common) {
                    let differenced = [&mut difference.pseudorange, &mut difference.carrier];
                    differenced.into_iter().flatten().for_each(|z| z.range_m += farther_m);
                }
            }
        }
    }

    /// Drops the pseudoranges that are off by more than W from those of their group.
    fn drop_wild(&mut self, rover: &Receiver) {
        let Self { satellites, list, numbers, .. } = self;
        let offset_m = |d: &SingleDifference| {
            let state = &satellites[d.common].state;
            let (range_m, _) = geometric_range(state.position, rover.frame.origin);
            Some(d.pseudorange?.range_m - range_m)
        };
        for group in list.chunk_by_mut(|a, b| a.group() == b.group()) {
            let Some(clock_m) = agreed_m(group.iter().filter_map(offset_m), numbers) else {
                continue;
            };
            for difference in group {
                let is_wild = |m: f64| WILD_M < (m - clock_m).abs();
                difference.pseudorange =
                    difference.pseudorange.filter(|_| !offset_m(difference).is_some_and(is_wild));
            }
        }
    }

    /// Drops satellites below the elevation mask: the lower mask while few satellites are above the
    /// upper one.
    fn mask(&mut self, options: &PositioningOptions) {
        let satellites = &self.satellites;
        let upper = options.elevation_mask_rad;
        let high = satellites.iter().filter(|s| upper <= s.look.elevation_rad).count();
        let mask_rad = match high < options.sparse_below {
            true => upper.min(options.sparse_elevation_mask_rad),
            false => upper,
        };
        self.list.retain(|d| mask_rad <= satellites[d.common].look.elevation_rad);
    }

    /// Number of satellites with a pseudorange, and how many are needed for a position and one
    /// offset for each constellation.
    pub(super) fn used_and_needed(&self) -> (usize, usize) {
        let mut seen = [0_u128; Constellation::COUNT];
        for difference in self.list.iter().filter(|d| d.pseudorange.is_some()) {
            let satellite = difference.satellite;
            seen[satellite.constellation.index()] |= 1 << satellite.number;
        }
        let used: u32 = seen.iter().map(|bits| bits.count_ones()).sum();
        (used as usize, 3 + seen.iter().filter(|bits| **bits != 0).count().max(1))
    }
}

/// One receiver and the atmosphere above it.
struct Receiver {
    time: GpsTime,
    frame: LocalFrame,
    troposphere: Option<Troposphere>,
}

impl Receiver {
    fn at(position: Ecef, time: GpsTime, options: &PositioningOptions) -> Option<Self> {
        let mapping = match options.troposphere_mapping {
            TroposphereMapping::Niell => Mapping::Niell,
            TroposphereMapping::Cosecant => Mapping::Cosecant,
        };
        let geodetic = position.to_geodetic();
        let modelled = Troposphere::saastamoinen(&geodetic, time, RELATIVE_HUMIDITY, mapping)?;
        let troposphere =
            (options.troposphere == TroposphereModel::Saastamoinen).then_some(modelled);
        Some(Self { time, frame: LocalFrame::at(position), troposphere })
    }

    fn slant_delay_m(&self, elevation_rad: f64) -> f64 {
        self.troposphere.as_ref().map_or(0.0, |model| model.slant_delay_m(elevation_rad))
    }
}

/// Values that are common to the differences of all satellites of an epoch.
struct Scene {
    rover: Receiver,
    base: Receiver,
    variances: DifferenceVariances,
}

impl Scene {
    /// The satellite at the transmission of the signals that the rover and the base received.
    fn states(&self, ephemeris: &Ephemeris, rover_m: f64, base_m: f64) -> [SatelliteState; 2] {
        let state = state_at_transmission(ephemeris, self.rover.time, rover_m);
        let tags_s = self.base.time - self.rover.time;
        let apart_s = tags_s - (base_m - rover_m) / SPEED_OF_LIGHT;
        let other = match apart_s.abs() < CARRIED_S {
            true => carried(&state, apart_s),
            false => state_at_transmission(ephemeris, self.base.time, base_m),
        };
        [state, other]
    }
}

/// The median of clock offsets (m), if most of them are within W of it.
fn agreed_m(offsets_m: impl Iterator<Item = f64>, numbers: &mut Vec<f64>) -> Option<f64> {
    numbers.clear();
    numbers.extend(offsets_m);
    let middle_m = median(numbers)?;
    let near = numbers.iter().filter(|offset_m| (*offset_m - middle_m).abs() <= WILD_M).count();
    (numbers.len() < 2 * near).then_some(middle_m)
}

/// The first pseudorange of each receiver (m), used only for the time of transmission.
fn ranges_m(common: &[Pair<'_>]) -> Option<(f64, f64)> {
    let rover = common.iter().find_map(|pair| valid_m(pair.rover))?;
    Some((rover, common.iter().find_map(|pair| valid_m(pair.base))?))
}

fn valid_m(observation: &Observation) -> Option<f64> {
    observation.pseudorange_m.filter(|range_m| PSEUDORANGES_M.contains(range_m))
}

/// The carrier phase as a range (m).
///
/// A phase that lost lock and whose half cycle is unresolved is not used: its tracking loop has not
/// settled.
fn carrier_m(observation: &Observation, pair: &Pair<'_>) -> Option<f64> {
    let wavelength = Meters(SPEED_OF_LIGHT / pair.frequency_hz);
    let is_settled = !(observation.loss_of_lock && observation.half_cycle);
    let is_phase = |phase: &Cycles| is_settled && phase.is_resolved() && phase.0 != 0.0;
    let phase = observation.carrier_phase.filter(is_phase)?;
    Some(phase.to_meters(wavelength).0)
}

/// C/N0 of the rover's strongest signal (dB-Hz).
fn strongest_db_hz(common: &[Pair<'_>]) -> Option<f64> {
    common.iter().filter_map(|pair| pair.rover.cn0_db_hz).max_by(f64::total_cmp)
}

/// The range rate of the signal whose Doppler shift is the least noisy.
fn range_rate(
    common: &[Pair<'_>],
    state: &SatelliteState,
    options: &PositioningOptions,
) -> Option<RangeRate> {
    let measured = common.iter().filter_map(|pair| {
        let doppler_hz = pair.rover.doppler_hz.filter(|doppler_hz| doppler_hz.is_finite())?;
        let wavelength_m = SPEED_OF_LIGHT / pair.frequency_hz;
        let cn0_db_hz = pair.rover.cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ);
        Some(RangeRate {
            rate_m_s: -wavelength_m * doppler_hz + state.clock_drift_m_s,
            variance_m2_s2: variance_m2_s2(options.doppler_sigma_m_s, cn0_db_hz),
        })
    });
    measured.min_by(|a, b| a.variance_m2_s2.total_cmp(&b.variance_m2_s2))
}

/// The state a moment later, by constant velocity.
fn carried(state: &SatelliteState, seconds: f64) -> SatelliteState {
    SatelliteState {
        position: Ecef(state.position.0 + state.velocity_m_s * seconds),
        clock_m: state.clock_m + state.clock_drift_m_s * seconds,
        ..*state
    }
}
