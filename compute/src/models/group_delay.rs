//! Group delays of a satellite's signals relative to its broadcast clock.

use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Ephemeris, GroupDelays, KeplerianEphemeris, NavigationMessage, ObservationCode, Signal,
};

/// γ of L2 and L1: (f_L1/f_L2)² = (77/60)²; IS-GPS-200N, 20.3.3.3.3.2.
const GAMMA_L2: f64 = (77.0 / 60.0) * (77.0 / 60.0);
/// (f_L1/f_L5)² = (154/115)², also of E1 and E5a.
const GAMMA_L5: f64 = (154.0 / 115.0) * (154.0 / 115.0);
/// (f_E1/f_E5b)² = (154/118)².
const GAMMA_E5B: f64 = (154.0 / 118.0) * (154.0 / 118.0);

/// Group delay τ of a signal (m): the signal leaves later than the broadcast clock by τ, so its
/// pseudorange is longer by τ. `None` where the message has no value for the signal.
///
/// - GPS, QZSS: T_GD for L1, γ·T_GD for L2 P(Y); L2C too, whose inter-signal correction LNAV does
///   not carry; T_GD − ISC with CNAV (IS-GPS-200N, 20.3.3.3.3.2 and 30.3.3.3.1.1; IS-GPS-705J,
///   20.3.3.3.1.2).
/// - Galileo: the clock of I/NAV is that of the pair E1, E5b, of F/NAV that of E1, E5a; BGD of that
///   pair for E1, γ·BGD for its other signal (Galileo OS SIS ICD 2.1, 5.1.5), the third through E1.
/// - BeiDou: the clock is that of B3I; T_GD1, T_GD2 (BDS-SIS-ICD-B1I-3.0, 5.2.4.10), or T_GD of a
///   pilot and T_GD + ISC of its data channel (BDS-SIS-ICD-B1C-1.0, 7.6; B2a-1.0, 7.6).
/// - GLONASS: the clock is taken as that of G1; Δτ_n for G2 (GLONASS ICD 5.1, 4.4).
pub fn group_delay_m(ephemeris: &Ephemeris, code: ObservationCode) -> Option<f64> {
    let delay_s = match ephemeris {
        Ephemeris::Glonass(e) => match code.band_digit() {
            1 => Some(0.0),
            2 => e.delta_tau_s,
            _ => None,
        },
        Ephemeris::Keplerian(e) => {
            let signal = Signal::of(e.satellite, code);
            signal.frequency_hz(None)?;
            match e.group_delays {
                GroupDelays::Gps { .. } => gps_s(&e.group_delays, code),
                GroupDelays::Galileo { bgd_e5a_s, bgd_e5b_s } => {
                    galileo_s(e.message, bgd_e5a_s, bgd_e5b_s, code)
                }
                GroupDelays::BeiDou { tgd1_s, tgd2_s } => match code.band_digit() {
                    2 => Some(tgd1_s),
                    // 7I, 7Q and 7X are B2I; 7D, 7P and 7Z are B2b of the third generation.
                    7 if matches!(code.attribute(), b'I' | b'Q' | b'X') => Some(tgd2_s),
                    6 => Some(0.0),
                    _ => None,
                },
                GroupDelays::BeiDouCnav { .. } => beidou_cnav_s(&e.group_delays, code),
            }
        }
    };
    delay_s.map(|s| s * SPEED_OF_LIGHT)
}

/// Standard deviation of [`unstated_delay_m`] (m). At two stations that received L1 C/A, L2
/// P(Y) and L5 (`klt-2021`, `meijo-static`), C5 − C1 − (γ₅ − 1)/(γ₂ − 1)·(C2 − C1) differed between
/// five and six GPS satellites by 2.0 to 2.5 m (standard deviation).
pub(crate) const UNSTATED_DELAY_M: f64 = 2.5;

/// Approximate group delay τ (m) of a signal for which the message has no correction: γ·T_GD of L5
/// for GPS and QZSS, as if its delay were in proportion to that of L2 P(Y). LNAV has no correction
/// of L5. `None` for all other signals.
pub(crate) fn unstated_delay_m(ephemeris: &Ephemeris, code: ObservationCode) -> Option<f64> {
    match ephemeris {
        Ephemeris::Keplerian(KeplerianEphemeris {
            group_delays: GroupDelays::Gps { tgd_s, .. },
            ..
        }) if code.band_digit() == 5 => Some(GAMMA_L5 * tgd_s * SPEED_OF_LIGHT),
        _ => None,
    }
}

/// The constellation's group delays are `GroupDelays::Gps`.
fn gps_s(delays: &GroupDelays, code: ObservationCode) -> Option<f64> {
    let &GroupDelays::Gps {
        tgd_s,
        isc_l1ca_s,
        isc_l2c_s,
        isc_l5i_s,
        isc_l5q_s,
        isc_l1cd_s,
        isc_l1cp_s,
    } = delays
    else {
        return None;
    };
    let corrected = |isc: Option<f64>| isc.map(|isc_s| tgd_s - isc_s);
    match (code.band_digit(), code.attribute()) {
        (1, b'S') => corrected(isc_l1cd_s),
        (1, b'L' | b'X') => corrected(isc_l1cp_s),
        (1, b'C') => corrected(isc_l1ca_s).or(Some(tgd_s)),
        (1, _) => Some(tgd_s),
        (2, b'C' | b'S' | b'L' | b'X') => corrected(isc_l2c_s).or(Some(GAMMA_L2 * tgd_s)),
        (2, _) => Some(GAMMA_L2 * tgd_s),
        (5, b'I') => corrected(isc_l5i_s),
        (5, b'Q' | b'X') => corrected(isc_l5q_s),
        _ => None,
    }
}

fn galileo_s(
    message: NavigationMessage,
    e5a_s: f64,
    e5b_s: Option<f64>,
    code: ObservationCode,
) -> Option<f64> {
    // Delay of E1 against this message's clock; E5a and E5b follow from it by their own BGD.
    let e1_s = if message == NavigationMessage::Fnav { e5a_s } else { e5b_s? };
    match code.band_digit() {
        1 => Some(e1_s),
        5 => Some(e1_s + (GAMMA_L5 - 1.0) * e5a_s),
        7 => e5b_s.map(|bgd_s| e1_s + (GAMMA_E5B - 1.0) * bgd_s),
        _ => None,
    }
}

/// A combined data and pilot channel (`X`) is treated as its pilot, which has most of the power.
fn beidou_cnav_s(delays: &GroupDelays, code: ObservationCode) -> Option<f64> {
    let &GroupDelays::BeiDouCnav { tgd_b1cp_s, tgd_b2ap_s, tgd_b2bi_s, isc_b1cd_s, isc_b2ad_s } =
        delays
    else {
        return None;
    };
    match (code.band_digit(), code.attribute()) {
        (1, b'P' | b'X') => tgd_b1cp_s,
        (1, b'D') => Some(tgd_b1cp_s? + isc_b1cd_s?),
        (5, b'P' | b'X') => tgd_b2ap_s,
        (5, b'D') => Some(tgd_b2ap_s? + isc_b2ad_s?),
        (7, b'D') => tgd_b2bi_s,
        (6, _) => Some(0.0),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::sample;

    fn delay_ns(ephemeris: &Ephemeris, code: &str) -> Option<f64> {
        let code = ObservationCode::parse(code).unwrap();
        group_delay_m(ephemeris, code).map(|m| m / SPEED_OF_LIGHT * 1e9)
    }

    fn check(ephemeris: KeplerianEphemeris, expected: &[(&str, Option<f64>)]) {
        let ephemeris = Ephemeris::Keplerian(ephemeris);
        for (code, expected_ns) in expected {
            match (delay_ns(&ephemeris, code), expected_ns) {
                (Some(ns), Some(expected)) => {
                    assert!((ns - expected).abs() < 1e-9, "{code}: {ns}, not {expected}");
                }
                (ns, expected) => assert_eq!(ns, *expected, "{code}"),
            }
        }
    }

    /// T_GD = −5 ns; γ = (77/60)².
    #[test]
    fn gps_legacy() {
        let gamma = 5_929.0 / 3_600.0;
        check(
            sample::gps(),
            &[
                ("1C", Some(-5.0)),
                ("1W", Some(-5.0)),
                ("2W", Some(-5.0 * gamma)),
                ("2L", Some(-5.0 * gamma)),
                ("5Q", None),
                ("1L", None),
            ],
        );
    }

    /// T_GD = −5 ns and γ = (154/115)² = 1.793270: −2.688045 m. L2 has a delay of its own, and the
    /// messages of Galileo state that of E5a.
    #[test]
    fn an_unstated_delay_worked_by_hand() {
        let delay_m = |ephemeris: KeplerianEphemeris, code: &str| {
            let code = ObservationCode::parse(code).unwrap();
            unstated_delay_m(&Ephemeris::Keplerian(ephemeris), code)
        };
        let l5_m = delay_m(sample::gps(), "5Q").unwrap();
        assert!((l5_m + 2.688_045).abs() < 1e-5, "{l5_m}");
        assert_eq!(delay_m(sample::gps(), "2W"), None);
        assert_eq!(delay_m(sample::galileo(), "5Q"), None);
    }

    /// T_GD − ISC.
    #[test]
    fn gps_civil() {
        let mut e = sample::gps();
        e.message = NavigationMessage::Cnav;
        e.group_delays = GroupDelays::Gps {
            tgd_s: -5e-9,
            isc_l1ca_s: Some(1e-9),
            isc_l2c_s: Some(-2e-9),
            isc_l5i_s: Some(3e-9),
            isc_l5q_s: Some(3.5e-9),
            isc_l1cd_s: None,
            isc_l1cp_s: Some(0.5e-9),
        };
        let expected = [
            ("1C", Some(-6.0)),
            ("2L", Some(-3.0)),
            ("5I", Some(-8.0)),
            ("5Q", Some(-8.5)),
            ("1L", Some(-5.5)),
            ("1S", None),
        ];
        check(e, &expected);
    }

    /// BGD(E1, E5a) = 2 ns, BGD(E1, E5b) = 3 ns; BGD = (τ_E1 − τ_E5)/(1 − γ) must come back out,
    /// and the clock's own pair be free of delay: (τ_E5 − γ·τ_E1)/(1 − γ) = 0 with γ of f_E1/f_E5.
    #[test]
    fn galileo_messages_differ_in_their_clock() {
        for message in [NavigationMessage::Inav, NavigationMessage::Fnav] {
            let e = Ephemeris::Keplerian(KeplerianEphemeris { message, ..sample::galileo() });
            let [e1, e5a, e5b] = ["1C", "5Q", "7Q"].map(|code| delay_ns(&e, code).unwrap());
            assert!(((e1 - e5a) / (1.0 - GAMMA_L5) - 2.0).abs() < 1e-9);
            assert!(((e1 - e5b) / (1.0 - GAMMA_E5B) - 3.0).abs() < 1e-9);
            let of_pair = match message {
                NavigationMessage::Fnav => GAMMA_L5 * e1 - e5a,
                _ => GAMMA_E5B * e1 - e5b,
            };
            assert!(of_pair.abs() < 1e-9, "{message:?}: {of_pair}");
            assert_eq!(delay_ns(&e, "6C"), None);
        }
    }

    #[test]
    fn galileo_without_the_other_pair() {
        let mut e = sample::galileo();
        e.group_delays = GroupDelays::Galileo { bgd_e5a_s: 2e-9, bgd_e5b_s: None };
        e.message = NavigationMessage::Fnav;
        check(e, &[("1C", Some(2.0)), ("5Q", Some(2.0 * GAMMA_L5)), ("7Q", None)]);
    }

    #[test]
    fn beidou_refers_to_b3i() {
        let expected =
            [("2I", Some(4.0)), ("7I", Some(-2.0)), ("6I", Some(0.0)), ("7D", None), ("1P", None)];
        check(sample::beidou(), &expected);
        let mut e = sample::beidou();
        e.message = NavigationMessage::Cnv1;
        e.group_delays = GroupDelays::BeiDouCnav {
            tgd_b1cp_s: Some(1e-9),
            tgd_b2ap_s: Some(2e-9),
            tgd_b2bi_s: None,
            isc_b1cd_s: Some(0.5e-9),
            isc_b2ad_s: None,
        };
        let expected = [
            ("1P", Some(1.0)),
            ("1D", Some(1.5)),
            ("5P", Some(2.0)),
            ("5D", None),
            ("6I", Some(0.0)),
            ("7D", None),
        ];
        check(e, &expected);
    }

    #[test]
    fn glonass_second_frequency() {
        let e = Ephemeris::Glonass(sample::glonass());
        assert_eq!(delay_ns(&e, "1C"), Some(0.0));
        assert!((delay_ns(&e, "2C").unwrap() + 3.0).abs() < 1e-9);
        assert_eq!(delay_ns(&e, "3Q"), None);
    }
}
