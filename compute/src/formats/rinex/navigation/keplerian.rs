//! Records of orbital elements: GPS, QZSS, Galileo and BeiDou, legacy and civil messages.
//!
//! Rows 1 to 4 and the first number of row 5 have the same layout in all of them, except for the
//! first numbers of rows 1 and 3 (issue or Ȧ; toe or top). Sources: RINEX 2.11 and 4.01, tables of
//! navigation records.

use super::record::Record;
use crate::formats::broadcast::ura_m;
use crate::formats::rinex::fields::constellation;
use crate::gnss::constants::SECONDS_PER_DAY;
use crate::gnss::{
    Constellation, GpsTime, GroupDelays, KeplerianEphemeris, LeapSeconds, NO_PREDICTION_M,
    NavigationMessage, SatelliteId, TimeScale, wrap_half_week,
};

/// Valid square roots of semi-major axes of navigation satellites (√m), with a wide margin.
const SQRT_A_LIMITS: std::ops::Range<f64> = 4000.0..8000.0;
const ECCENTRICITY_LIMIT: f64 = 0.5;
/// A transmission time farther from toe than this (s) is a filler: zero, or 0.9999e9 for unknown.
const TRANSMISSION_LIMIT_S: f64 = SECONDS_PER_DAY;

/// Data sources of a Galileo record; zero if blank or invalid.
pub(super) fn galileo_data_sources(record: &Record) -> u32 {
    record.word(5, 1).unwrap_or(0)
}

/// Whether the record belongs to a BeiDou satellite in geostationary orbit.
pub(super) fn is_geostationary(record: &Record) -> bool {
    SatelliteId::new(Constellation::BeiDou, record.number).is_some_and(SatelliteId::is_beidou_geo)
}

/// The ephemeris of a record; `None` if a number is missing or out of bounds.
pub(super) fn ephemeris(
    record: &Record,
    message: NavigationMessage,
    leap: &LeapSeconds,
) -> Option<KeplerianEphemeris> {
    let constellation = constellation(record.letter)?;
    let scale = match constellation {
        Constellation::BeiDou => TimeScale::BeiDou,
        _ => TimeScale::Gps,
    };
    let toc = GpsTime::from_civil(&record.civil?, scale, leap)?;
    let civil_message = is_civil(message);
    // Civil messages of GPS and QZSS have top instead of toe; their toe equals toc.
    let toe = match message {
        NavigationMessage::Cnav | NavigationMessage::Cnav2 => toc,
        _ => near(toc, record.need(3, 0)?, constellation)?,
    };
    let need = |row, column| record.need(row, column);
    let mut ephemeris = KeplerianEphemeris {
        satellite: SatelliteId::new(constellation, record.number)?,
        message,
        toc,
        toe,
        transmission_time: None,
        af0_s: need(0, 1)?,
        af1: need(0, 2)?,
        af2_per_s: need(0, 3)?,
        iode: 0,
        iodc: 0,
        sqrt_a: need(2, 3)?,
        a_dot_m_s: if civil_message { need(1, 0)? } else { 0.0 },
        eccentricity: need(2, 1)?,
        m0_rad: need(1, 3)?,
        delta_n_rad_s: need(1, 2)?,
        delta_n_dot_rad_s2: if civil_message { need(5, 1)? } else { 0.0 },
        omega_rad: need(4, 2)?,
        omega0_rad: need(3, 2)?,
        omega_dot_rad_s: need(4, 3)?,
        i0_rad: need(4, 0)?,
        idot_rad_s: need(5, 0)?,
        cuc_rad: need(2, 0)?,
        cus_rad: need(2, 2)?,
        crc_m: need(4, 1)?,
        crs_m: need(1, 1)?,
        cic_rad: need(3, 1)?,
        cis_rad: need(3, 3)?,
        accuracy_m: None,
        health: 0,
        fit_interval_h: None,
        group_delays: GroupDelays::BeiDou { tgd1_s: 0.0, tgd2_s: 0.0 },
    };
    let plausible = SQRT_A_LIMITS.contains(&ephemeris.sqrt_a)
        && (0.0..ECCENTRICITY_LIMIT).contains(&ephemeris.eccentricity);
    if !plausible {
        return None;
    }
    read_tail(record, &mut ephemeris)?;
    Some(ephemeris)
}

const fn is_civil(message: NavigationMessage) -> bool {
    use NavigationMessage as M;
    matches!(message, M::Cnav | M::Cnav2 | M::Cnv1 | M::Cnv2 | M::Cnv3)
}

/// Reads the fields that differ between messages.
fn read_tail(record: &Record, ephemeris: &mut KeplerianEphemeris) -> Option<()> {
    use NavigationMessage as M;
    match ephemeris.message {
        M::Lnav => read_lnav(record, ephemeris),
        M::Cnav => read_cnav(record, ephemeris, 8),
        M::Cnav2 => read_cnav(record, ephemeris, 9),
        M::Inav | M::Fnav => read_galileo(record, ephemeris),
        M::D1 | M::D2 => read_beidou(record, ephemeris),
        M::Cnv1 | M::Cnv2 => read_beidou_cnav(record, ephemeris),
        M::Cnv3 => read_beidou_cnav3(record, ephemeris),
        M::Fdma => None,
    }
}

fn read_lnav(record: &Record, ephemeris: &mut KeplerianEphemeris) -> Option<()> {
    ephemeris.iode = record.word(1, 0)?;
    ephemeris.iodc = record.word(6, 3)?;
    ephemeris.accuracy_m = stated_accuracy(record.optional(6, 0)?);
    ephemeris.health = record.word(6, 1)?;
    ephemeris.group_delays = GroupDelays::Gps {
        tgd_s: record.or_zero(6, 2)?,
        isc_l1ca_s: None,
        isc_l2c_s: None,
        isc_l5i_s: None,
        isc_l5q_s: None,
        isc_l1cd_s: None,
        isc_l1cp_s: None,
    };
    ephemeris.transmission_time = transmission_time(record, 7, ephemeris)?;
    ephemeris.fit_interval_h = match (ephemeris.satellite.constellation, record.optional(7, 1)?) {
        // QZSS writes a flag: zero means two hours (RINEX 3.05), one more than two.
        (Constellation::Qzss, Some(0.0)) => Some(2.0),
        // A value below two hours is the flag of the message, not hours.
        (_, hours) => hours.filter(|hours| 2.0 <= *hours),
    };
    Some(())
}

fn read_cnav(record: &Record, ephemeris: &mut KeplerianEphemeris, last: usize) -> Option<()> {
    ephemeris.accuracy_m = record.optional(6, 0)?.map(ura_m);
    ephemeris.health = record.word(6, 1)?;
    let l1c = |column| if last == 9 { record.optional(8, column) } else { Some(None) };
    ephemeris.group_delays = GroupDelays::Gps {
        tgd_s: record.or_zero(6, 2)?,
        isc_l1ca_s: record.optional(7, 0)?,
        isc_l2c_s: record.optional(7, 1)?,
        isc_l5i_s: record.optional(7, 2)?,
        isc_l5q_s: record.optional(7, 3)?,
        isc_l1cd_s: l1c(0)?,
        isc_l1cp_s: l1c(1)?,
    };
    ephemeris.transmission_time = transmission_time(record, last, ephemeris)?;
    Some(())
}

fn read_galileo(record: &Record, ephemeris: &mut KeplerianEphemeris) -> Option<()> {
    ephemeris.iode = record.word(1, 0)?;
    ephemeris.iodc = ephemeris.iode;
    ephemeris.accuracy_m = stated_accuracy(record.optional(6, 0)?);
    ephemeris.health = record.word(6, 1)?;
    // An F/NAV record has BGD(E1, E5b) only if I/NAV was merged into it (bits 0 and 2).
    let from_inav =
        ephemeris.message == NavigationMessage::Inav || galileo_data_sources(record) & 5 != 0;
    ephemeris.group_delays = GroupDelays::Galileo {
        bgd_e5a_s: record.or_zero(6, 2)?,
        bgd_e5b_s: record.optional(6, 3)?.filter(|_| from_inav),
    };
    ephemeris.transmission_time = transmission_time(record, 7, ephemeris)?;
    Some(())
}

fn read_beidou(record: &Record, ephemeris: &mut KeplerianEphemeris) -> Option<()> {
    ephemeris.iode = record.word(1, 0)?;
    ephemeris.iodc = record.word(7, 1)?;
    ephemeris.accuracy_m = stated_accuracy(record.optional(6, 0)?);
    ephemeris.health = record.word(6, 1)?;
    ephemeris.group_delays =
        GroupDelays::BeiDou { tgd1_s: record.or_zero(6, 2)?, tgd2_s: record.or_zero(6, 3)? };
    ephemeris.transmission_time = transmission_time(record, 7, ephemeris)?;
    Some(())
}

/// Reads B-CNAV1 and B-CNAV2. No document gives lengths for their accuracy indices.
fn read_beidou_cnav(record: &Record, ephemeris: &mut KeplerianEphemeris) -> Option<()> {
    let cnv1 = ephemeris.message == NavigationMessage::Cnv1;
    ephemeris.health = record.word(8, 1)?;
    ephemeris.iodc = record.word(8, 3)?;
    ephemeris.iode = record.word(9, 3)?;
    ephemeris.group_delays = GroupDelays::BeiDouCnav {
        tgd_b1cp_s: record.optional(7, 2)?,
        tgd_b2ap_s: record.optional(7, 3)?,
        tgd_b2bi_s: None,
        isc_b1cd_s: if cnv1 { record.optional(7, 0)? } else { None },
        isc_b2ad_s: if cnv1 { None } else { record.optional(7, 1)? },
    };
    ephemeris.transmission_time = transmission_time(record, 9, ephemeris)?;
    Some(())
}

fn read_beidou_cnav3(record: &Record, ephemeris: &mut KeplerianEphemeris) -> Option<()> {
    ephemeris.health = record.word(7, 1)?;
    ephemeris.group_delays = GroupDelays::BeiDouCnav {
        tgd_b1cp_s: None,
        tgd_b2ap_s: None,
        tgd_b2bi_s: record.optional(7, 3)?,
        isc_b1cd_s: None,
        isc_b2ad_s: None,
    };
    ephemeris.transmission_time = transmission_time(record, 8, ephemeris)?;
    Some(())
}

/// The instant nearest to `reference` with this second of the constellation's week (s).
fn near(reference: GpsTime, second_of_week: f64, constellation: Constellation) -> Option<GpsTime> {
    let reference_second = match constellation {
        Constellation::BeiDou => reference.to_beidou().1,
        _ => reference.seconds_of_week(),
    };
    let ahead_s = wrap_half_week(second_of_week - reference_second);
    (second_of_week.abs() <= 1e6).then(|| reference + ahead_s)
}

fn transmission_time(
    record: &Record,
    row: usize,
    ephemeris: &KeplerianEphemeris,
) -> Option<Option<GpsTime>> {
    let constellation = ephemeris.satellite.constellation;
    Some(
        record
            .optional(row, 0)?
            .and_then(|second| near(ephemeris.toe, second, constellation))
            .filter(|time| (*time - ephemeris.toe).abs() < TRANSMISSION_LIMIT_S),
    )
}

/// Accuracy as written (m). Converters write zero where they do not state it. A negative value
/// means no prediction (Galileo, RINEX 3.05, table A8), as does URA index 15.
fn stated_accuracy(metres: Option<f64>) -> Option<f64> {
    let metres = metres.filter(|metres| *metres != 0.0)?;
    Some(if (0.0..NO_PREDICTION_M).contains(&metres) { metres } else { NO_PREDICTION_M })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_accuracy_is_stated_or_not_or_warns() {
        assert_eq!([None, Some(0.0)].map(stated_accuracy), [None; 2]);
        assert_eq!([Some(2.0), Some(3.12)].map(stated_accuracy), [Some(2.0), Some(3.12)]);
        let warnings = [-1.0, 6_144.0, 8_192.0].map(|metres| stated_accuracy(Some(metres)));
        assert_eq!(warnings, [Some(NO_PREDICTION_M); 3]);
    }
}
