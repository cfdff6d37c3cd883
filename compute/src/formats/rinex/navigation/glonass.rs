//! GLONASS FDMA records.

use nalgebra::Vector3;

use super::record::Record;
use crate::formats::broadcast::GLONASS_ACCURACY_M;
use crate::formats::rinex::RinexVersion;
use crate::gnss::constants::SECONDS_PER_DAY;
use crate::gnss::{Constellation, GlonassEphemeris, GpsTime, LeapSeconds, SatelliteId, TimeScale};

const METRES_PER_KM: f64 = 1000.0;
/// Valid distances of GLONASS satellites from the geocentre (m); the orbit is at 25 500 km.
const RADIUS_LIMITS_M: std::ops::Range<f64> = 2.0e7..3.0e7;
/// Value of an unknown Δτ_n in RINEX 3.05.
const UNKNOWN_DELTA_TAU: f64 = 0.999_999_999_999e9;

/// The ephemeris of a record; RINEX 2.11 and 3.05.
pub(super) fn ephemeris(
    record: &Record,
    version: RinexVersion,
    leap: &LeapSeconds,
) -> Option<GlonassEphemeris> {
    let vector = |column| {
        let in_km = [record.need(1, column)?, record.need(2, column)?, record.need(3, column)?];
        Some(Vector3::from(in_km) * METRES_PER_KM)
    };
    let position_m = vector(0)?;
    // Some receivers write negative numbers as bytes without a sign.
    let channel = record.need(2, 3).map(|channel| wrapped(channel, 128.0, 256.0))?;
    if !RADIUS_LIMITS_M.contains(&position_m.norm()) || !(-7.0..=13.0).contains(&channel) {
        return None;
    }
    let toe = GpsTime::from_civil(&record.civil?, TimeScale::Utc, leap)?;
    let has_status = RinexVersion::new(3, 5) <= version && 5 <= record.row_count();
    Some(GlonassEphemeris {
        satellite: SatelliteId::new(Constellation::Glonass, record.number)?,
        toe,
        transmission_time: record.optional(0, 3)?.and_then(|s| frame_time(toe, s, leap)),
        position_m,
        velocity_m_s: vector(1)?,
        acceleration_m_s2: acceleration_m_s2(record)?,
        clock_bias_s: record.need(0, 1)?,
        gamma: record.need(0, 2)?,
        delta_tau_s: if has_status { delta_tau_s(record)? } else { None },
        channel: channel as i8,
        health: record.word(1, 3)?,
        accuracy_m: if has_status { accuracy_m(record)? } else { None },
        age_days: record.word(3, 3)?.min(255) as u8,
    })
}

/// A number that is negative from `limit` on.
fn wrapped(number: f64, limit: f64, modulus: f64) -> f64 {
    if number < limit { number } else { number - modulus }
}

/// The acceleration; blank is zero: a program that does not know it leaves it out.
fn acceleration_m_s2(record: &Record) -> Option<Vector3<f64>> {
    let in_km = [record.or_zero(1, 2)?, record.or_zero(2, 2)?, record.or_zero(3, 2)?];
    Some(Vector3::from(in_km) * METRES_PER_KM)
}

/// Message frame time nearest to `toe`, from seconds of the UTC week, or of its day in RINEX 2.
fn frame_time(toe: GpsTime, seconds: f64, leap: &LeapSeconds) -> Option<GpsTime> {
    // A week has whole days, so both forms agree in the seconds of the day.
    let toe_of_day_s = (toe - leap.at(toe) as f64).seconds_of_week() % SECONDS_PER_DAY;
    let ahead_s = seconds - toe_of_day_s;
    let nearest_s = ahead_s - SECONDS_PER_DAY * (ahead_s / SECONDS_PER_DAY).round();
    (seconds.abs() <= 8.0 * SECONDS_PER_DAY).then(|| toe + nearest_s)
}

fn delta_tau_s(record: &Record) -> Option<Option<f64>> {
    Some(record.optional(4, 1)?.filter(|seconds| seconds.abs() < UNKNOWN_DELTA_TAU))
}

fn accuracy_m(record: &Record) -> Option<Option<f64>> {
    let index = record.optional(4, 2)?.filter(|index| (0.0..15.0).contains(index));
    Some(index.map(|index| GLONASS_ACCURACY_M[index as usize]))
}

/// The index of the smallest F_T that is not below this accuracy (m).
pub(in crate::formats::rinex) fn accuracy_index(metres: f64) -> f64 {
    GLONASS_ACCURACY_M.iter().position(|step| metres <= *step).unwrap_or(GLONASS_ACCURACY_M.len())
        as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// −7 is written as 249 by programs that write bytes without a sign.
    #[test]
    fn frequency_numbers_may_be_bytes_without_a_sign() {
        let channels = [249.0, 255.0, 0.0, 6.0, 13.0].map(|number| wrapped(number, 128.0, 256.0));
        assert_eq!(channels, [-7.0, -1.0, 0.0, 6.0, 13.0]);
    }
}
