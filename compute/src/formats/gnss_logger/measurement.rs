//! One `Raw` record: the reading of the phone's clock, and the observation.

use super::columns::{Column as C, Row};
use super::signals::{self, Tracked};
use super::{Cause, state};
use crate::gnss::constants::{BEIDOU_LAG_S, GLONASS_AHEAD_OF_UTC_S, NS_PER_SECOND, SPEED_OF_LIGHT};
use crate::gnss::{Constellation, Cycles, GpsTime, LeapSeconds, Observation, SatelliteId, Signal};

const NS_PER_MS: i128 = 1_000_000;
/// A larger uncertainty of GPS time is a coarse time from the network (ns); `SetDataFilter.m`.
const TIME_UNCERTAINTY_NS: f64 = 1e7;
/// A larger uncertainty of ReceivedSvTimeNanos is not usable (ns); `GnssThresholds.m`.
const TRANSMISSION_UNCERTAINTY_NS: f64 = 500.0;
/// A larger uncertainty of the rate may be the width of a search bin (m/s); `GnssThresholds.m`.
const RATE_UNCERTAINTY_M_S: f64 = 10.0;
/// Shortest and longest time of flight (ns): from 63 ms (GLONASS in the zenith) to 140 ms
/// (geostationary at the horizon), and three standard deviations of the worst accepted clock.
const FLIGHT_NS: std::ops::RangeInclusive<i128> = 30 * NS_PER_MS..=170 * NS_PER_MS;
/// Offsets up to this need no rate (ns): a range changes by less than 1 mm.
const NEGLIGIBLE_OFFSET_NS: f64 = 1e3;
/// Largest plausible values: offset from the epoch (ns), rate (m/s), accumulated range (m).
const OFFSET_LIMIT_NS: f64 = 1e7;
const RATE_LIMIT_M_S: f64 = 1e5;
const ACCUMULATED_LIMIT_M: f64 = 1e10;
const CN0_LIMIT_DB_HZ: f64 = 100.0;
const FREQUENCY_LIMIT_HZ: f64 = 1e10;
/// An uncertainty may have any size.
const ANY: f64 = f64::INFINITY;
/// Leap seconds that can be true.
const LEAP_SECONDS: std::ops::Range<i64> = 0..100;

/// The reading of the phone's clock; equal for all records of an epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ClockReading {
    /// TimeNanos less the bias in whole milliseconds: the epoch's time tag.
    pub(super) time: GpsTime,
    pub(super) discontinuities: Option<i64>,
}

impl ClockReading {
    /// # Errors
    /// The record does not give GPS time.
    pub(super) fn of(row: &Row<'_>) -> Result<Self, Cause> {
        let clock_ns = i128::from(row.required(C::TimeNanos)?);
        let full_bias_ns = row.integer(C::FullBiasNanos)?.unwrap_or(0);
        if 0 <= full_bias_ns || full_bias_ns == i64::MIN {
            return Err(Cause::TimeUnknown);
        }
        let uncertainty_ns = row.number(C::BiasUncertaintyNanos, ANY)?;
        if uncertainty_ns.is_some_and(|ns| TIME_UNCERTAINTY_NS < ns) {
            return Err(Cause::TimeUncertain);
        }
        let bias_ns = row.number(C::BiasNanos, TIME_UNCERTAINTY_NS)?.unwrap_or(0.0);
        let bias_ns = i128::from(full_bias_ns) + bias_ns.round() as i128;
        let whole_ns = (bias_ns + NS_PER_MS / 2).div_euclid(NS_PER_MS) * NS_PER_MS;
        let time = i64::try_from(clock_ns - whole_ns).ok().filter(|ns| 0 < *ns);
        let time = GpsTime::from_ns(time.ok_or(Cause::TimeUnknown)?);
        let discontinuities = row.integer(C::HardwareClockDiscontinuityCount)?;
        Ok(Self { time, discontinuities })
    }
}

/// FDMA channels of GLONASS satellites, by slot.
#[derive(Clone, Debug, Default)]
pub(super) struct Channels([Option<i8>; 32]);

impl Channels {
    pub(super) fn set(&mut self, slot: u8, channel: i8) {
        if let Some(known) = self.0.get_mut(usize::from(slot)) {
            *known = Some(channel);
        }
    }

    pub(super) fn of(&self, satellite: SatelliteId) -> Option<i8> {
        self.0.get(usize::from(satellite.number)).copied().flatten()
    }
}

/// The observation of a record of the epoch at `time`. `note` receives the causes of parts that are
/// left out.
///
/// # Errors
/// The measurement is not usable.
pub(super) fn observation(
    row: &Row<'_>,
    time: GpsTime,
    channels: &Channels,
    note: &mut impl FnMut(Cause),
) -> Result<Observation, Cause> {
    let constellation = signals::constellation(row.required(C::ConstellationType)?)?;
    let satellite = signals::satellite(constellation, row.required(C::Svid)?)?;
    let tracked = tracked(row, satellite, channels)?;
    let rate_m_s = row.number(C::PseudorangeRate, RATE_LIMIT_M_S)?;
    let offset_ns = row.number(C::TimeOffsetNanos, OFFSET_LIMIT_NS)?.unwrap_or(0.0);
    let moved_m = moved_m(rate_m_s, offset_ns)?;
    let flight_ns = flight_ns(row, constellation, time)? + offset_ns;
    let cn0_db_hz = match row.number(C::Cn0DbHz, CN0_LIMIT_DB_HZ)? {
        Some(cn0_db_hz) => Some(cn0_db_hz),
        None => row.number(C::BasebandCn0DbHz, CN0_LIMIT_DB_HZ)?,
    };
    let mut observation = Observation {
        pseudorange_m: Some(SPEED_OF_LIGHT * 1e-9 * flight_ns - moved_m),
        cn0_db_hz: cn0_db_hz.filter(|cn0| 0.0 < *cn0),
        ..Observation::empty(satellite, tracked.code)
    };
    let accumulated = Accumulated::of(row, moved_m)?;
    match tracked.frequency_hz {
        Some(frequency_hz) => {
            let cycles_per_m = frequency_hz / SPEED_OF_LIGHT;
            let rate_m_s = certain_rate_m_s(row, rate_m_s, note)?;
            observation.doppler_hz = rate_m_s.map(|rate| -rate * cycles_per_m);
            accumulated.apply_to(&mut observation, cycles_per_m);
        }
        None if rate_m_s.is_some() || accumulated.range_m.is_some() => note(Cause::ChannelUnknown),
        None => {}
    }
    Ok(observation)
}

/// The signal, with its frequency from the record or from a known GLONASS channel.
fn tracked(row: &Row<'_>, satellite: SatelliteId, channels: &Channels) -> Result<Tracked, Cause> {
    let constellation = satellite.constellation;
    let stated_hz = row.number(C::CarrierFrequencyHz, FREQUENCY_LIMIT_HZ)?;
    let tracked = signals::tracked(constellation, stated_hz, row.text(C::CodeType))?;
    let signal = Signal { constellation, code: tracked.code };
    let known_hz = || signal.frequency_hz(channels.of(satellite));
    Ok(Tracked { frequency_hz: tracked.frequency_hz.or_else(known_hz), ..tracked })
}

/// How far the range changes from the epoch to the measurement, `offset_ns` later (m).
fn moved_m(rate_m_s: Option<f64>, offset_ns: f64) -> Result<f64, Cause> {
    match rate_m_s {
        Some(rate_m_s) => Ok(rate_m_s * offset_ns * 1e-9),
        None if offset_ns.abs() <= NEGLIGIBLE_OFFSET_NS => Ok(0.0),
        None => Err(Cause::OffsetWithoutRate),
    }
}

/// From transmission to the time tag of the epoch (ns).
fn flight_ns(row: &Row<'_>, constellation: Constellation, time: GpsTime) -> Result<f64, Cause> {
    let period_ns = state::period_ns(constellation, row.required(C::State)?)?;
    let uncertainty_ns = row.number(C::ReceivedSvTimeUncertaintyNanos, ANY)?;
    if uncertainty_ns.is_some_and(|ns| TRANSMISSION_UNCERTAINTY_NS < ns) {
        return Err(Cause::TransmissionUncertain);
    }
    let transmitted_ns = row.required(C::ReceivedSvTimeNanos)?;
    let received_ns = received_ns(row, constellation, time)?;
    let flight_ns = (received_ns - i128::from(transmitted_ns)).rem_euclid(period_ns.into());
    if !FLIGHT_NS.contains(&flight_ns) {
        return Err(Cause::ImpossibleFlight);
    }
    Ok(flight_ns as f64)
}

/// The time tag in the scale of ReceivedSvTimeNanos (ns), up to whole weeks, of GLONASS days.
fn received_ns(row: &Row<'_>, constellation: Constellation, time: GpsTime) -> Result<i128, Cause> {
    let ahead_s = match constellation {
        Constellation::Gps | Constellation::Galileo | Constellation::Qzss => 0,
        Constellation::BeiDou => -(BEIDOU_LAG_S as i64),
        Constellation::Glonass => {
            let stated = row.integer(C::LeapSecond)?.filter(|s| LEAP_SECONDS.contains(s));
            let leap = stated.map_or_else(LeapSeconds::table, LeapSeconds::with_broadcast);
            GLONASS_AHEAD_OF_UTC_S as i64 - leap.at(time)
        }
    };
    Ok(i128::from(time.as_ns()) + i128::from(ahead_s * NS_PER_SECOND))
}

/// The rate for Doppler (m/s), if it is certain enough.
fn certain_rate_m_s(
    row: &Row<'_>,
    rate_m_s: Option<f64>,
    note: &mut impl FnMut(Cause),
) -> Result<Option<f64>, Cause> {
    let uncertainty_m_s = row.number(C::PseudorangeRateUncertainty, ANY)?;
    let is_uncertain = uncertainty_m_s.is_some_and(|u| RATE_UNCERTAINTY_M_S < u);
    if is_uncertain && rate_m_s.is_some() {
        note(Cause::RateUncertain);
    }
    Ok(rate_m_s.filter(|_| !is_uncertain))
}

/// The accumulated delta range.
struct Accumulated {
    /// At the epoch's time (m), if valid.
    range_m: Option<f64>,
    state: i64,
}

impl Accumulated {
    fn of(row: &Row<'_>, moved_m: f64) -> Result<Self, Cause> {
        let state = row.integer(C::AccumulatedDeltaRangeState)?.unwrap_or(0);
        let range_m = row.number(C::AccumulatedDeltaRange, ACCUMULATED_LIMIT_M)?;
        let range_m = range_m.filter(|_| state & state::ADR_VALID != 0);
        Ok(Self { range_m: range_m.map(|range_m| range_m - moved_m), state })
    }

    fn apply_to(&self, observation: &mut Observation, cycles_per_m: f64) {
        let Some(range_m) = self.range_m else { return };
        let slips = state::ADR_RESET | state::ADR_CYCLE_SLIP;
        observation.carrier_phase = Some(Cycles(range_m * cycles_per_m));
        observation.loss_of_lock = self.state & slips != 0;
        observation.half_cycle = self.state & state::ADR_HALF_CYCLE_RESOLVED == 0;
    }
}

#[cfg(test)]
mod tests {
    use super::super::columns::Columns;
    use super::*;

    const TITLE: &str = "# Raw,TimeNanos,FullBiasNanos,BiasNanos,LeapSecond,Svid,ConstellationType,\
         State,ReceivedSvTimeNanos,TimeOffsetNanos,PseudorangeRateMetersPerSecond,\
         AccumulatedDeltaRangeState,AccumulatedDeltaRangeMeters,CarrierFrequencyHz";

    fn read(record: &str) -> Result<(GpsTime, Observation), Cause> {
        let columns = Columns::of_line(TITLE.as_bytes(), 1).unwrap().unwrap();
        let row = columns.row(record.as_bytes());
        let clock = ClockReading::of(&row)?;
        let observation = observation(&row, clock.time, &Channels::default(), &mut |_| ())?;
        Ok((clock.time, observation))
    }

    /// Section 2.4 of the white paper, worked by hand. Week 2000, 100 000 s of the week; the phone
    /// counts 5000 s since it was started and its bias is 300 µs beyond a whole millisecond.
    ///
    /// GPS: 99 999.93 s of the week were received, P = c·(100 000.000 3 − 99 999.93) less the
    /// 300 µs that stay in the clock. BeiDou: 14 s less. GLONASS: the second of the day is
    /// 100 000 − 86 400 + 10 800 − 18 = 24 382. Galileo E1C: 99 999.92 modulo 100 ms is 20 ms.
    #[test]
    fn pseudoranges_worked_by_hand() {
        const WEEK_2000_NS: i64 = 2_000 * 604_800 * 1_000_000_000;
        let bias_ns = 5_000_000_000_000 - (WEEK_2000_NS + 100_000_000_000_000) - 300_000;
        let read = |rest: &str| read(&format!("Raw,5000000000000,{bias_ns},0.25,18,{rest}"));
        let seventy_ms_m = SPEED_OF_LIGHT * 0.07;
        for (rest, name, expected_m) in [
            ("5,1,16393,99999930000000,0.0,,,,1575420030", "G05", seventy_ms_m),
            ("30,5,16393,99985930000000,0.0,,,,1561097980", "C30", seventy_ms_m),
            ("7,3,32897,24381930000000,0.0,,,,1602000000", "R07", seventy_ms_m),
            ("11,6,3073,20000000,0.0,,,,1575420030", "E11", SPEED_OF_LIGHT * 0.08),
            ("193,4,16393,99999870000000,,,,,", "J01", SPEED_OF_LIGHT * 0.13),
            // Measured 1 ms after the time tag, from which the range has grown by 0.5 m.
            ("5,1,16393,99999931000000,1e6,500.0,,,", "G05", seventy_ms_m - 0.5),
        ] {
            let (time, observation) = read(rest).unwrap();
            assert_eq!(time, GpsTime::from_week_seconds(2000, 100_000.0));
            assert_eq!(observation.satellite.to_string(), name);
            let error_m = observation.pseudorange_m.unwrap() - expected_m;
            assert!(error_m.abs() < 1e-6, "{rest}: {error_m}");
        }
    }

    /// The first second of a week and of a GLONASS day (18 s − 3 h into the GPS day) receives what
    /// was sent before midnight.
    #[test]
    fn weeks_and_days_roll_over() {
        let week_ns = 604_800_000_000_000_i64;
        let bias_ns = -2_001 * week_ns;
        let (_, gps) =
            read(&format!("Raw,20000000,{bias_ns},,18,5,1,16393,604799950000000")).unwrap();
        assert!((gps.pseudorange_m.unwrap() - SPEED_OF_LIGHT * 0.07).abs() < 1e-6);
        let midnight_ns = (86_400 - 10_800 + 18) * 1_000_000_000_i64 + 20_000_000;
        let glonass = format!("Raw,{midnight_ns},{bias_ns},,18,7,3,32897,86399950000000,,,,,");
        let (_, glonass) = read(&glonass).unwrap();
        assert!((glonass.pseudorange_m.unwrap() - SPEED_OF_LIGHT * 0.07).abs() < 1e-6);
    }

    /// Signs and bits of the API reference: a receding satellite has a positive rate and a growing
    /// accumulated range; bit 1 reset, bit 2 slip, bit 3 half cycle resolved.
    #[test]
    fn phase_and_doppler_by_their_bits() {
        let read = |state: i64| {
            let bias_ns = -2_000 * 604_800_000_000_000_i64;
            let fields = format!("5,1,16393,99999930000000,,-200.0,{state},1000.0,1575420030");
            read(&format!("Raw,100000000000000,{bias_ns},,,{fields}")).unwrap().1
        };
        let cycles_per_m = 1_575.42e6 / SPEED_OF_LIGHT;
        let full = read(1 + 8 + 16);
        assert_eq!(full.doppler_hz, Some(200.0 * cycles_per_m));
        assert_eq!(full.carrier_phase, Some(Cycles(1000.0 * cycles_per_m)));
        assert!(!full.loss_of_lock && !full.half_cycle);
        for (state, slipped, half) in
            [(1 + 2 + 8, true, false), (1 + 4, true, true), (1 + 16, false, true)]
        {
            let read = read(state);
            assert_eq!((read.loss_of_lock, read.half_cycle), (slipped, half), "{state}");
        }
        let invalid = read(2 + 4 + 8);
        assert_eq!((invalid.carrier_phase, invalid.loss_of_lock), (None, false));
    }

    #[test]
    fn what_is_not_usable_has_its_cause() {
        let bias_ns = -2_000 * 604_800_000_000_000_i64;
        for (record, cause) in [
            ("Raw,1,0,,,5,1,9,1".to_owned(), Cause::TimeUnknown),
            ("Raw,1,5,,,5,1,9,1".to_owned(), Cause::TimeUnknown),
            (format!("Raw,1,{},,,5,1,9,1", i64::MIN), Cause::TimeUnknown),
            (format!("Raw,{},{bias_ns},,,5,1,9,1", i64::MIN), Cause::TimeUnknown),
            (format!("Raw,,{bias_ns},,,5,1,9,1"), Cause::Blank { column: "TimeNanos" }),
            (format!("Raw,1,{bias_ns},,,5,1,9,{}", i64::MIN), Cause::ImpossibleFlight),
            (format!("Raw,1,{bias_ns},,,5,2,9,1"), Cause::OtherConstellation(2)),
            (format!("Raw,1,{bias_ns},,,5,1,1,1"), Cause::Ambiguous),
            (format!("Raw,100000000,{bias_ns},,,5,1,9,1,2000"), Cause::OffsetWithoutRate),
        ] {
            assert_eq!(read(&record).unwrap_err(), cause, "{record}");
        }
    }
}
