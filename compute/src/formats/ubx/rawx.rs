//! RXM-RAWX: pseudorange, carrier phase, Doppler and C/N0 of all signals at one epoch.
//!
//! Loss of lock is reported if a signal first appears, if its lock time is zero, decreases or does
//! not reach back to its last phase, if the half-cycle correction of the phase changes
//! (`subHalfCyc`), and if the receiver states the largest phase standard deviation. A loss of lock
//! without a phase is reported with the next phase. A half-cycle ambiguity is reported if `halfCyc`
//! is not set.

use std::collections::BTreeMap;

use crate::formats::binary::Refusal;
use crate::gnss::{Constellation, Cycles, GpsTime, Observation, ObservationCode, SatelliteId};

use super::{Notes, field};

pub(super) const HEADER_BYTES: usize = 16;
pub(super) const MEASUREMENT_BYTES: usize = 32;
const VERSION_LIMIT: u8 = 1;
/// Valid GPS weeks of a log, up to the year 2171.
const WEEKS: std::ops::RangeInclusive<i32> = 1..=9999;
/// Value of `cpStdev` for 0.06 cycles or more.
const WORST_PHASE: u8 = 15;
/// Numbers of constellations, and of signals, are below these.
const SYSTEMS: u8 = 8;
const SIGNALS: u8 = 16;
/// Slot of GLONASS satellites whose slot is unknown.
const UNKNOWN_SLOT: u8 = 255;

pub(super) const PSEUDORANGE_VALID: u8 = 1;
pub(super) const PHASE_VALID: u8 = 2;
pub(super) const HALF_CYCLE_RESOLVED: u8 = 4;
/// Largest lock time, at which the counter stays (ms).
pub(super) const LOCK_MAX_MS: u16 = 64_500;
/// Resolution of lock times (ms).
const LOCK_STEP_MS: f64 = 1.0;
const HALF_CYCLE_SUBTRACTED: u8 = 8;

/// The last lock state of a signal.
#[derive(Clone, Copy, Debug, Default)]
struct Lock {
    time_ms: u16,
    /// Time of its last phase.
    phase: Option<GpsTime>,
    is_half_subtracted: bool,
    /// Whether a loss of lock has not been reported yet.
    is_lost: bool,
}

/// Lock states of all signals.
#[derive(Debug)]
pub(super) struct RawxState {
    locks: BTreeMap<(SatelliteId, ObservationCode), Lock>,
}

impl RawxState {
    pub(super) const fn new() -> Self {
        Self { locks: BTreeMap::new() }
    }

    /// Decodes the epoch of a payload.
    pub(super) fn decode(
        &mut self,
        payload: &[u8],
        notes: Notes<'_>,
    ) -> Result<(GpsTime, Vec<Observation>), Refusal> {
        let second = f64::from_le_bytes(field(payload, 0)?);
        let week = i32::from(u16::from_le_bytes(field(payload, 8)?));
        let [count] = field(payload, 11)?;
        let [version] = field(payload, 13)?;
        let measurements = payload.get(HEADER_BYTES..).ok_or(Refusal::Truncated)?;
        if VERSION_LIMIT < version {
            return Err(Refusal::UnknownVersion(version));
        }
        if measurements.len() < usize::from(count) * MEASUREMENT_BYTES {
            return Err(Refusal::Truncated);
        }
        // The week is zero until the receiver knows it.
        if !WEEKS.contains(&week) || !(0.0..604_801.0).contains(&second) {
            return Err(Refusal::InvalidTime);
        }
        let time = GpsTime::from_week_seconds(week, second);
        let (measurements, _) = measurements.as_chunks::<MEASUREMENT_BYTES>();
        let mut observations = Vec::with_capacity(usize::from(count));
        for measurement in &measurements[..usize::from(count)] {
            match self.observation(time, measurement, version) {
                Ok(observation) if observation.is_empty() => {}
                Ok(observation) => observations.push(observation),
                Err(refusal) => notes(refusal),
            }
        }
        Ok((time, observations))
    }

    fn observation(
        &mut self,
        time: GpsTime,
        measurement: &[u8; MEASUREMENT_BYTES],
        version: u8,
    ) -> Result<Observation, Refusal> {
        let [system, number, signal, _] = field(measurement, 20)?;
        let (satellite, code) = identify(system, number, (1 <= version).then_some(signal))?;
        let lock_ms = u16::from_le_bytes(field(measurement, 24)?);
        let [cn0, _, phase_deviation, _, status] = field(measurement, 26)?;
        let has = |bit: u8| status & bit != 0;
        let phase = f64::from_le_bytes(field(measurement, 8)?);
        let has_phase = has(PHASE_VALID) && phase.is_finite() && phase != 0.0;
        let unknown = Lock { is_lost: true, ..Lock::default() };
        let lock = self.locks.entry((satellite, code)).or_insert(unknown);
        let is_half_subtracted = has(HALF_CYCLE_SUBTRACTED);
        let since_ms = lock.phase.map_or(0.0, |phase| (time - phase) * 1e3);
        lock.is_lost |= lock_ms == 0
            || lock_ms < lock.time_ms
            || (lock_ms < LOCK_MAX_MS && f64::from(lock_ms) + LOCK_STEP_MS < since_ms)
            || is_half_subtracted != lock.is_half_subtracted
            || phase_deviation & 15 == WORST_PHASE;
        lock.time_ms = lock_ms;
        lock.is_half_subtracted = is_half_subtracted;
        let loss_of_lock = has_phase && lock.is_lost;
        lock.is_lost &= !has_phase;
        if has_phase {
            lock.phase = Some(time);
        }
        let pseudorange_m = f64::from_le_bytes(field(measurement, 0)?);
        let doppler_hz = f64::from(f32::from_le_bytes(field(measurement, 16)?));
        let is_range = has(PSEUDORANGE_VALID) && pseudorange_m.is_finite();
        Ok(Observation {
            loss_of_lock,
            half_cycle: has_phase && !has(HALF_CYCLE_RESOLVED),
            pseudorange_m: is_range.then_some(pseudorange_m),
            carrier_phase: has_phase.then_some(Cycles(phase)),
            doppler_hz: (doppler_hz.is_finite() && doppler_hz != 0.0).then_some(doppler_hz),
            cn0_db_hz: (cn0 != 0).then(|| f64::from(cn0)),
            ..Observation::empty(satellite, code)
        })
    }
}

/// Satellite and signal of the receiver's numbers; without a signal number the first signal.
fn identify(
    system: u8,
    number: u8,
    signal: Option<u8>,
) -> Result<(SatelliteId, ObservationCode), Refusal> {
    let satellite = satellite(system, number)?;
    let constellation = satellite.constellation;
    let index = signal.unwrap_or(0);
    let code = match (constellation, index) {
        (Constellation::BeiDou, _) if signal.is_none() => Some("2I"),
        _ => code(constellation, index),
    };
    let code = code.and_then(ObservationCode::parse);
    Ok((satellite, code.ok_or(Refusal::UnknownSignal { constellation, index })?))
}

/// The satellite of the receiver's numbers; UBX-22008968, 1.5.2.
pub(super) fn satellite(system: u8, number: u8) -> Result<SatelliteId, Refusal> {
    let (constellation, highest) = match system {
        0 => (Constellation::Gps, 32),
        2 => (Constellation::Galileo, 36),
        3 => (Constellation::BeiDou, 63),
        5 => (Constellation::Qzss, 10),
        6 if number == UNKNOWN_SLOT => return Err(Refusal::UnknownSatellite),
        6 => (Constellation::Glonass, 32),
        _ => return Err(Refusal::OtherConstellation),
    };
    SatelliteId::new(constellation, number)
        .filter(|satellite| satellite.number <= highest)
        .ok_or(Refusal::UnknownSatellite)
}

/// The receiver's numbers of constellation, satellite and signal; the inverse of [`identify`].
pub(super) fn numbers(satellite: SatelliteId, code: ObservationCode) -> Option<[u8; 3]> {
    let is_of = |system: &u8| self::satellite(*system, satellite.number) == Ok(satellite);
    let system = (0..SYSTEMS).find(is_of)?;
    let is_code = |signal: &u8| {
        self::code(satellite.constellation, *signal).and_then(ObservationCode::parse) == Some(code)
    };
    Some([system, satellite.number, (0..SIGNALS).find(is_code)?])
}

/// The RINEX code of a signal number; UBX-22008968, 1.5.4.
const fn code(constellation: Constellation, signal: u8) -> Option<&'static str> {
    Some(match (constellation, signal) {
        (Constellation::Gps | Constellation::Qzss | Constellation::Glonass, 0) => "1C",
        (Constellation::Gps, 3) => "2L",
        (Constellation::Gps, 4) => "2S",
        (Constellation::Gps, 6) => "5I",
        (Constellation::Gps, 7) => "5Q",
        (Constellation::Galileo, 0) => "1C",
        (Constellation::Galileo, 1) => "1B",
        (Constellation::Galileo, 3) => "5I",
        (Constellation::Galileo, 4) => "5Q",
        (Constellation::Galileo, 5) => "7I",
        (Constellation::Galileo, 6) => "7Q",
        (Constellation::Galileo, 8) => "6B",
        (Constellation::Galileo, 9) => "6C",
        (Constellation::Galileo, 10) => "6A",
        (Constellation::BeiDou, 0 | 1) => "2I",
        (Constellation::BeiDou, 2 | 3) => "7I",
        (Constellation::BeiDou, 4 | 10) => "6I",
        (Constellation::BeiDou, 5) => "1P",
        (Constellation::BeiDou, 6) => "1D",
        (Constellation::BeiDou, 7) => "5P",
        (Constellation::BeiDou, 8) => "5D",
        (Constellation::Qzss, 1) => "1Z",
        (Constellation::Qzss, 4) => "2S",
        (Constellation::Qzss, 5) => "2L",
        (Constellation::Qzss, 8) => "5I",
        (Constellation::Qzss, 9) => "5Q",
        (Constellation::Qzss, 12) => "1E",
        (Constellation::Glonass, 2) => "2C",
        _ => return None,
    })
}
