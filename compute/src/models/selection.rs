//! Selection of the broadcast ephemeris of a satellite.

use crate::gnss::constants::SECONDS_PER_HOUR;
use crate::gnss::{Constellation, Ephemeris, GpsTime, Navigation, NavigationMessage, SatelliteId};

/// Largest distance from toe at which any message is used (s).
const LONGEST_S: f64 = 24.0 * SECONDS_PER_HOUR;
/// Validity of Galileo ephemerides around toe (s); a list has one every ten minutes.
const GALILEO_S: f64 = 4.0 * SECONDS_PER_HOUR;
/// Validity of GLONASS ephemerides around t_b (s).
const GLONASS_S: f64 = 0.5 * SECONDS_PER_HOUR;
/// Validity of BeiDou ephemerides around toe (s): updated hourly, plus one hour of margin.
const BEIDOU_S: f64 = 2.0 * SECONDS_PER_HOUR;

/// The ephemeris to use for `satellite` at `time`: the closest valid one, if it is healthy.
///
/// *Valid*: no further from toe than half the broadcast fit interval; without one GPS and QZSS 2 h
/// (CNAV 1.5 h), Galileo 4 h, BeiDou 2 h (one hour of validity, one of margin), GLONASS 30 min. The
/// orbit must be one of an Earth satellite. *Closest*: by |time − toe|; among equals the later toe,
/// then the later toc, then the later entry of the list. *Healthy*: the health bits of the
/// message's own signals are zero, and also those of the latest one that the satellite had sent at
/// `time`, by its time of transmission. A valid one whose time of transmission is unknown counts as
/// sent. If they are not zero, an older healthy ephemeris is not used either.
/// *Message*: in the order LNAV, CNAV, CNAV-2; I/NAV, F/NAV; D1 or D2, B-CNAV1, 2, 3: the first is
/// what every satellite of the system sends, and a later one is used only if the earlier ones have
/// nothing valid and healthy, or no group delay of an observed signal.
pub fn select_ephemeris(
    navigation: &Navigation,
    satellite: SatelliteId,
    time: GpsTime,
) -> Option<&Ephemeris> {
    select_ephemeris_within(navigation, satellite, time, BEIDOU_S)
}

/// As [`select_ephemeris`], with BeiDou ephemerides valid to `beidou_s` from toe (s).
pub(crate) fn select_ephemeris_within(
    navigation: &Navigation,
    satellite: SatelliteId,
    time: GpsTime,
    beidou_s: f64,
) -> Option<&Ephemeris> {
    closest_ephemerides(navigation, satellite, time, beidou_s).next()
}

/// The closest valid ephemeris of each message that is healthy, in the order of preference; see
/// [`select_ephemeris`]. Those of BeiDou are valid to `beidou_s` from toe (s).
pub(crate) fn closest_ephemerides(
    navigation: &Navigation,
    satellite: SatelliteId,
    time: GpsTime,
    beidou_s: f64,
) -> impl Iterator<Item = &Ephemeris> + Clone {
    let reach_s = |ephemeris: &Ephemeris| match satellite.constellation {
        Constellation::BeiDou => beidou_s,
        _ => validity_s(ephemeris),
    };
    let longest_s = match satellite.constellation {
        Constellation::BeiDou => beidou_s,
        Constellation::Galileo => GALILEO_S,
        Constellation::Glonass => GLONASS_S,
        _ => LONGEST_S,
    };
    let list = navigation.of(satellite);
    let first = list.partition_point(|e| e.toe() < time - longest_s);
    let mut closest: [Option<(f64, &Ephemeris)>; RANKS] = [None; RANKS];
    // The health that the satellite had stated last, in the order of toe.
    let mut was_healthy = [true; RANKS];
    for ephemeris in &list[first..] {
        let ahead = ephemeris.toe() - time;
        if longest_s < ahead {
            break;
        }
        if !is_orbit(ephemeris) {
            continue;
        }
        let (rank, distance_s, reach_s) = (preference(ephemeris), ahead.abs(), reach_s(ephemeris));
        let is_sent = match transmission_time(ephemeris) {
            // Sent, and not expired: it may be the next one, which is not valid yet.
            Some(sent) => sent <= time && -reach_s <= ahead,
            None => distance_s <= reach_s,
        };
        if is_sent {
            was_healthy[rank] = is_healthy(ephemeris);
        }
        let of_message = &mut closest[rank];
        let is_closer = of_message.is_none_or(|(least_s, _)| distance_s <= least_s);
        if is_closer && distance_s <= reach_s {
            *of_message = Some((distance_s, ephemeris));
        }
    }
    let closest = closest.into_iter().zip(was_healthy);
    closest
        .filter_map(|(closest, was_healthy)| closest.filter(|_| was_healthy))
        .map(|(_, closest)| closest)
        .filter(|closest| is_healthy(closest))
}

const fn transmission_time(ephemeris: &Ephemeris) -> Option<GpsTime> {
    match ephemeris {
        Ephemeris::Keplerian(e) => e.transmission_time,
        Ephemeris::Glonass(e) => e.transmission_time,
    }
}

/// All healthy and valid ephemerides of `satellite` at `time`, in order of toe, those of BeiDou
/// valid to `beidou_s` from toe (s).
pub(crate) fn ephemerides_in_force(
    navigation: &Navigation,
    satellite: SatelliteId,
    time: GpsTime,
    beidou_s: f64,
) -> impl Iterator<Item = &Ephemeris> {
    navigation.of(satellite).iter().filter(move |ephemeris| {
        let reach_s = match satellite.constellation {
            Constellation::BeiDou => beidou_s,
            _ => validity_s(ephemeris),
        };
        (ephemeris.toe() - time).abs() <= reach_s && is_usable(ephemeris)
    })
}

/// Number of ranks of messages.
const RANKS: usize = 4;

/// Rank of the message in the order of preference, 0 first.
fn preference(ephemeris: &Ephemeris) -> usize {
    use NavigationMessage as M;
    match ephemeris {
        Ephemeris::Glonass(_) => 0,
        Ephemeris::Keplerian(e) => match e.message {
            M::Lnav | M::Inav | M::D1 | M::D2 | M::Fdma => 0,
            M::Cnav | M::Fnav | M::Cnv1 => 1,
            M::Cnav2 | M::Cnv2 => 2,
            M::Cnv3 => 3,
        },
    }
}

/// Largest distance from toe at which an ephemeris is used (s).
///
/// IS-GPS-200N 20.3.4.4 (4 h fit interval or a stated longer one, toe in its middle) and 30.3.4.4
/// (3 h); Galileo OS SDD 1.3, C.4.4.1 (4 h); BDS-SIS-ICD-B1I-3.0 (hourly); GLONASS ICD 5.1, 4.4
/// (half-hourly, t_b in the middle; used for one interval more).
pub fn validity_s(ephemeris: &Ephemeris) -> f64 {
    use NavigationMessage as M;
    let Ephemeris::Keplerian(e) = ephemeris else {
        return GLONASS_S;
    };
    let unstated = match e.message {
        M::D1 | M::D2 | M::Cnv1 | M::Cnv2 | M::Cnv3 => BEIDOU_S,
        M::Lnav | M::Fdma => 2.0 * SECONDS_PER_HOUR,
        M::Cnav | M::Cnav2 => 1.5 * SECONDS_PER_HOUR,
        M::Inav | M::Fnav => GALILEO_S,
    };
    match (e.message, e.fit_interval_h) {
        // No GPS fit interval is shorter; RINEX 2 writers put the flag (0 or 1) in its place.
        (M::Lnav, Some(hours)) if e.satellite.constellation == Constellation::Gps => {
            (0.5 * hours.max(4.0) * SECONDS_PER_HOUR).min(LONGEST_S)
        }
        _ => unstated,
    }
}

/// Whether an ephemeris is healthy and its orbit is one of an Earth satellite.
pub fn is_usable(ephemeris: &Ephemeris) -> bool {
    is_healthy(ephemeris) && is_orbit(ephemeris)
}

fn is_healthy(ephemeris: &Ephemeris) -> bool {
    use NavigationMessage as M;
    match ephemeris {
        Ephemeris::Glonass(e) => e.health == 0,
        Ephemeris::Keplerian(e) => match (e.satellite.constellation, e.message) {
            // RINEX 3.05, table A8: bits 0–2 E1-B, 3–5 E5a, 6–8 E5b (validity, then status).
            (Constellation::Galileo, M::Fnav) => e.health & 0b000_111_000 == 0,
            (Constellation::Galileo, _) => e.health & 0b111_000_111 == 0,
            // The last bit is that of L1C/B, which a satellite sends in place of L1C/A.
            (Constellation::Qzss, M::Lnav) => e.health & !1 == 0,
            // Bits of L1, L2 and L5 (IS-GPS-200N, 30.3.3.1.1.2). GPS has set the last one on all
            // satellites since L5 is on the air. LNAV has none for it.
            (_, M::Cnav) => e.health & 0b110 == 0,
            _ => e.health == 0,
        },
    }
}

/// Whether the elements describe an orbit at all, so that a damaged record gives no position.
fn is_orbit(ephemeris: &Ephemeris) -> bool {
    match ephemeris {
        // From low orbits to above the geosynchronous ones: 6 400 to 50 000 km.
        Ephemeris::Keplerian(e) => {
            (2_530.0..7_072.0).contains(&e.sqrt_a) && (0.0..0.9).contains(&e.eccentricity)
        }
        Ephemeris::Glonass(e) => (6.4e6..5e7).contains(&e.position_m.norm()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::KeplerianEphemeris;
    use crate::models::sample;

    fn shifted(base: KeplerianEphemeris, hours: f64, issue: u32) -> Ephemeris {
        let (toe, toc) = (base.toe + hours * SECONDS_PER_HOUR, base.toc + hours * SECONDS_PER_HOUR);
        Ephemeris::Keplerian(KeplerianEphemeris { toe, toc, iode: issue, ..base })
    }

    fn navigation(list: impl IntoIterator<Item = Ephemeris>) -> Navigation {
        let mut navigation = Navigation::default();
        for ephemeris in list {
            navigation.insert(ephemeris);
        }
        navigation
    }

    /// Issue of the selected ephemeris, `hours` after the toe of the samples.
    fn chosen(navigation: &Navigation, name: &str, hours: f64) -> Option<u32> {
        let time = sample::toe() + hours * SECONDS_PER_HOUR;
        select_ephemeris(navigation, name.parse().unwrap(), time).map(Ephemeris::issue)
    }

    #[test]
    fn the_closest_and_of_two_as_close_the_later() {
        let gps = sample::gps;
        let navigation =
            navigation([shifted(gps(), 0.0, 1), shifted(gps(), 2.0, 2), shifted(gps(), 4.0, 3)]);
        assert_eq!(chosen(&navigation, "G05", 0.9), Some(1));
        assert_eq!(chosen(&navigation, "G05", 1.0), Some(2));
        assert_eq!(chosen(&navigation, "G05", 3.2), Some(3));
        assert_eq!(chosen(&navigation, "G06", 1.0), None);
    }

    #[test]
    fn each_message_has_its_validity() {
        let limits = [
            (shifted(sample::gps(), 0.0, 1), 2.0),
            (shifted(sample::galileo(), 0.0, 1), 4.0),
            (shifted(sample::beidou(), 0.0, 1), 2.0),
            (shifted(sample::qzss(), 0.0, 1), 2.0),
            (Ephemeris::Glonass(sample::glonass()), 0.5),
        ];
        for (ephemeris, hours) in limits {
            let name = ephemeris.satellite().to_string();
            let navigation = navigation([ephemeris]);
            for side in [-1.0, 1.0] {
                assert!(chosen(&navigation, &name, side * (hours - 0.01)).is_some(), "{name}");
                assert!(chosen(&navigation, &name, side * (hours + 0.01)).is_none(), "{name}");
            }
            // Months old, as real navigation files hold them.
            assert_eq!(chosen(&navigation, &name, 2_000.0), None);
        }
    }

    #[test]
    fn beidou_may_be_used_for_longer() {
        let list = [shifted(sample::beidou(), 0.0, 1), shifted(sample::gps(), 0.0, 2)];
        let navigation = navigation(list);
        let time = sample::toe() - 5.9 * SECONDS_PER_HOUR;
        let issue = |name: &str, reach_s: f64| {
            let satellite = name.parse().unwrap();
            select_ephemeris_within(&navigation, satellite, time, reach_s).map(Ephemeris::issue)
        };
        assert_eq!(issue("C08", 6.0 * SECONDS_PER_HOUR), Some(1));
        assert_eq!(issue("C08", 5.8 * SECONDS_PER_HOUR), None);
        assert_eq!(issue("G05", 6.0 * SECONDS_PER_HOUR), None);
    }

    #[test]
    fn a_stated_fit_interval_is_respected() {
        let mut e = sample::gps();
        for (stated, hours) in [(Some(6.0), 3.0), (Some(1.0), 2.0), (None, 2.0)] {
            e.fit_interval_h = stated;
            let navigation = navigation([shifted(e.clone(), 0.0, 1)]);
            assert_eq!(chosen(&navigation, "G05", hours - 0.01), Some(1));
            assert_eq!(chosen(&navigation, "G05", hours + 0.01), None);
        }
    }

    #[test]
    fn the_preferred_message_goes_before_a_closer_one() {
        let fnav = KeplerianEphemeris { message: NavigationMessage::Fnav, ..sample::galileo() };
        let both = navigation([shifted(sample::galileo(), 0.0, 1), shifted(fnav, 1.0, 2)]);
        assert_eq!(chosen(&both, "E12", 1.0), Some(1));
        assert_eq!(chosen(&both, "E12", 4.5), Some(2));
    }

    #[test]
    fn health_is_that_of_the_message_and_its_signals() {
        let with = |base: KeplerianEphemeris, health| {
            let name = base.satellite.to_string();
            let navigation =
                navigation([Ephemeris::Keplerian(KeplerianEphemeris { health, ..base })]);
            chosen(&navigation, &name, 0.0).is_some()
        };
        assert!(!with(sample::gps(), 1) && !with(sample::beidou(), 1));
        let fnav = || KeplerianEphemeris { message: NavigationMessage::Fnav, ..sample::galileo() };
        assert!(with(sample::galileo(), 0b000_010_000) && !with(fnav(), 0b000_010_000));
        assert!(!with(sample::galileo(), 0b000_000_010) && with(fnav(), 0b000_000_010));
        assert!(with(sample::qzss(), 1) && !with(sample::qzss(), 0b10_0000));
        let cnav = || KeplerianEphemeris { message: NavigationMessage::Cnav, ..sample::gps() };
        assert!(with(cnav(), 0b001) && !with(cnav(), 0b100) && !with(cnav(), 0b010));
        let sick =
            Ephemeris::Glonass(crate::gnss::GlonassEphemeris { health: 1, ..sample::glonass() });
        assert_eq!(chosen(&navigation([sick]), "R07", 0.0), None);
    }

    #[test]
    fn a_satellite_whose_closest_message_is_unhealthy_is_not_used() {
        let sick = KeplerianEphemeris { health: 1, ..sample::gps() };
        let list = navigation([shifted(sample::gps(), 0.0, 1), shifted(sick, 2.0, 2)]);
        assert_eq!(chosen(&list, "G05", -0.1), Some(1));
        assert_eq!(chosen(&list, "G05", 1.1), None);
        // The health of I/NAV is not that of F/NAV.
        let sick = KeplerianEphemeris { health: 0b000_000_010, ..sample::galileo() };
        let fnav = KeplerianEphemeris { message: NavigationMessage::Fnav, ..sample::galileo() };
        let list = [shifted(sample::galileo(), 0.0, 1), shifted(sick, 2.0, 2)];
        let list = navigation(list.into_iter().chain([shifted(fnav, 1.0, 3)]));
        assert_eq!(chosen(&list, "E12", 1.1), Some(3));
    }

    /// A GPS satellite sends an ephemeris up to two hours before its toe. From then on its health
    /// is the one that it states there, although the ephemeris before is closer.
    #[test]
    fn health_is_that_of_the_message_sent_last() {
        let sent = |health, hours: f64, issue, at_hours: f64| {
            let transmission_time = Some(sample::toe() + at_hours * SECONDS_PER_HOUR);
            let e = KeplerianEphemeris { health, transmission_time, ..sample::gps() };
            shifted(e, hours, issue)
        };
        let list = navigation([sent(0, 0.0, 1, -2.0), sent(63, 2.0, 2, -0.2)]);
        let used = [(-1.0, Some(1)), (-0.25, Some(1)), (-0.15, None), (0.1, None), (1.9, None)];
        for (hours, issue) in used {
            assert_eq!(chosen(&list, "G05", hours), issue, "{hours}");
        }
        // Healthy again with the next one; the one after it, which is not sent yet, says nothing.
        let later = [sent(0, 4.0, 3, 2.1), sent(63, 6.0, 4, 4.1)];
        let list = navigation(list.of("G05".parse().unwrap()).iter().cloned().chain(later));
        for (hours, issue) in [(2.9, None), (3.1, Some(3)), (4.05, Some(3)), (4.15, None)] {
            assert_eq!(chosen(&list, "G05", hours), issue, "{hours}");
        }
        // One that has expired says nothing about the next one.
        let list = navigation([sent(63, 0.0, 1, -2.0), sent(0, 4.0, 2, 3.0)]);
        assert_eq!(chosen(&list, "G05", 2.1), Some(2));
        // A time of transmission is unknown in RTCM 3.
        let unknown = KeplerianEphemeris { health: 63, ..sample::gps() };
        let list = navigation([sent(0, 0.0, 1, -2.0), shifted(unknown, 2.0, 2)]);
        assert_eq!((chosen(&list, "G05", -0.1), chosen(&list, "G05", 0.1)), (Some(1), None));
    }

    #[test]
    fn a_damaged_record_is_no_orbit() {
        let damaged = [
            KeplerianEphemeris { sqrt_a: 0.0, ..sample::gps() },
            KeplerianEphemeris { eccentricity: 1.5, ..sample::gps() },
            KeplerianEphemeris { sqrt_a: f64::NAN, ..sample::gps() },
        ];
        for e in damaged {
            let navigation = navigation([Ephemeris::Keplerian(e)]);
            assert_eq!(chosen(&navigation, "G05", 0.0), None);
        }
    }
}
