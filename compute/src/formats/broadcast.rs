//! Units and indices of broadcast messages, common to all formats.

use crate::gnss::{
    Constellation, Ephemeris, GpsTime, GroupDelays, KeplerianEphemeris, NO_PREDICTION_M,
    NavigationMessage, SatelliteId, wrap_half_week,
};

/// A semicircle (rad), with the value of π that the messages use; IS-GPS-200N, 20.3.3.4.3.3;
/// Galileo OS SIS ICD 2.1, 5.1.1; BDS-SIS-ICD-B1I-3.0, 5.2.4.
#[expect(clippy::approx_constant, reason = "the messages are made with these digits")]
pub(super) const SEMICIRCLE_RAD: f64 = 3.141_592_653_589_8;

/// The scale factor 2^−n of a broadcast field.
pub(super) const fn per_power(n: u32) -> f64 {
    1.0 / (1_u64 << n) as f64
}

/// F_T by its index (m); index 15 is unused; GLONASS ICD 5.1, table 4.4.
pub(super) const GLONASS_ACCURACY_M: [f64; 15] =
    [1.0, 2.0, 2.5, 4.0, 5.0, 7.0, 10.0, 12.0, 14.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0];

/// Units of GLONASS positions, velocities and accelerations (m, m/s, m/s²).
pub(super) const GLONASS_UNITS: [f64; 3] =
    [1e3 * per_power(11), 1e3 * per_power(20), 1e3 * per_power(30)];
/// Valid square roots of semi-major axes of navigation satellites (√m), with a wide margin.
const SQRT_A_LIMITS: std::ops::Range<f64> = 4000.0..8000.0;
const ECCENTRICITY_LIMIT: f64 = 0.5;
/// Valid distances of GLONASS satellites from the geocentre (m); the orbit is at 25 500 km.
const GLONASS_RADIUS_LIMITS_M: std::ops::Range<f64> = 2.0e7..3.0e7;

/// Whether the orbit is one of a navigation satellite.
pub(super) fn is_plausible(ephemeris: &Ephemeris) -> bool {
    match ephemeris {
        Ephemeris::Keplerian(e) => {
            SQRT_A_LIMITS.contains(&e.sqrt_a) && (0.0..ECCENTRICITY_LIMIT).contains(&e.eccentricity)
        }
        Ephemeris::Glonass(e) => {
            GLONASS_RADIUS_LIMITS_M.contains(&e.position_m.norm()) && (-7..=13).contains(&e.channel)
        }
    }
}

/// Nominal URA_ED (m) of an index; [`NO_PREDICTION_M`] for others than −15 to 14; IS-GPS-200N,
/// 30.3.3.1.1.4.
pub(super) fn ura_m(index: f64) -> f64 {
    match index {
        -15.0..=6.0 => (1.0 + index / 2.0).exp2(),
        6.0..15.0 => (index - 2.0).exp2(),
        _ => NO_PREDICTION_M,
    }
}

/// URA (m) of the index in a legacy message, rounded as in IS-GPS-200N, 20.3.3.3.1.3.
pub(super) fn legacy_ura_m(index: u64) -> f64 {
    match index {
        1 => 2.8,
        3 => 5.7,
        5 => 11.3,
        _ => ura_m(index as f64),
    }
}

/// SISA (m) of an index; [`NO_PREDICTION_M`] for spare indices and 255; Galileo OS SIS ICD 2.1,
/// table 92.
pub(super) fn sisa_m(index: u64) -> f64 {
    let step = index as f64;
    match index {
        0..=49 => step * 0.01,
        50..=74 => 0.5 + (step - 50.0) * 0.02,
        75..=99 => 1.0 + (step - 75.0) * 0.04,
        100..=125 => 2.0 + (step - 100.0) * 0.16,
        _ => NO_PREDICTION_M,
    }
}

/// The instant nearest to `near` with this second of the week (s). The week begins `lag_s` after
/// the GPS week: 0, or 14 for BeiDou.
pub(super) fn nearest_second(near: GpsTime, second_of_week: f64, lag_s: f64) -> GpsTime {
    near + wrap_half_week(second_of_week - (near - lag_s).seconds_of_week())
}

/// Group delay T_GD of a legacy message of GPS or QZSS.
pub(super) fn legacy_delay(tgd_s: f64) -> GroupDelays {
    GroupDelays::Gps {
        tgd_s,
        isc_l1ca_s: None,
        isc_l2c_s: None,
        isc_l5i_s: None,
        isc_l5q_s: None,
        isc_l1cd_s: None,
        isc_l1cp_s: None,
    }
}

/// Group delay T_GD of a legacy message of GPS or QZSS, from the eight bits as they are sent.
///
/// QZSS sends −128 for a delay that is not available. It becomes zero, as in RTKLIB 2.4.3
/// (`decode_subfrm1`), and as a blank field of RINEX does.
pub(super) fn sent_legacy_delay(constellation: Constellation, sent: i64) -> GroupDelays {
    let is_absent = constellation == Constellation::Qzss && sent == -128;
    legacy_delay(if is_absent { 0.0 } else { sent as f64 * per_power(31) })
}

/// An ephemeris whose elements are zero, to be filled in.
pub(super) fn blank(
    satellite: SatelliteId,
    message: NavigationMessage,
    toc: GpsTime,
) -> KeplerianEphemeris {
    KeplerianEphemeris {
        satellite,
        message,
        toc,
        toe: toc,
        transmission_time: None,
        af0_s: 0.0,
        af1: 0.0,
        af2_per_s: 0.0,
        iode: 0,
        iodc: 0,
        sqrt_a: 0.0,
        a_dot_m_s: 0.0,
        eccentricity: 0.0,
        m0_rad: 0.0,
        delta_n_rad_s: 0.0,
        delta_n_dot_rad_s2: 0.0,
        omega_rad: 0.0,
        omega0_rad: 0.0,
        omega_dot_rad_s: 0.0,
        i0_rad: 0.0,
        idot_rad_s: 0.0,
        cuc_rad: 0.0,
        cus_rad: 0.0,
        crc_m: 0.0,
        crs_m: 0.0,
        cic_rad: 0.0,
        cis_rad: 0.0,
        accuracy_m: None,
        health: 0,
        fit_interval_h: None,
        group_delays: legacy_delay(0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_of_the_icds() {
        assert_eq!((ura_m(0.0), ura_m(6.0), ura_m(7.0)), (2.0, 16.0, 32.0));
        assert_eq!((ura_m(14.0), ura_m(15.0)), (4096.0, NO_PREDICTION_M));
        assert_eq!((legacy_ura_m(3), legacy_ura_m(4)), (5.7, 8.0));
        // Galileo OS SIS ICD 2.1, table 92: 107 is 3.12 m.
        assert!((sisa_m(107) - 3.12).abs() < 1e-12);
        let none = NO_PREDICTION_M;
        assert_eq!((sisa_m(50), sisa_m(126), sisa_m(255)), (0.5, none, none));
    }

    #[test]
    fn a_delay_that_qzss_does_not_state_is_zero() {
        let tgd_s = |constellation, sent| match sent_legacy_delay(constellation, sent) {
            GroupDelays::Gps { tgd_s, .. } => tgd_s,
            other => panic!("{other:?}"),
        };
        let (gps, qzss) = (Constellation::Gps, Constellation::Qzss);
        assert_eq!(tgd_s(qzss, -128), 0.0);
        assert_eq!(tgd_s(qzss, -127), -127.0 / 2_147_483_648.0);
        // GPS has no such value: −59.6 ns.
        assert_eq!(tgd_s(gps, -128), -128.0 / 2_147_483_648.0);
    }

    #[test]
    fn seconds_find_their_week() {
        let end = GpsTime::from_week_seconds(2100, 604_790.0);
        assert_eq!(nearest_second(end, 0.0, 0.0), GpsTime::from_week_seconds(2101, 0.0));
        assert_eq!(nearest_second(end, 0.0, 14.0), GpsTime::from_week_seconds(2101, 14.0));
    }
}
