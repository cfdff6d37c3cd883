//! Ephemerides: 1019 (GPS), 1020 (GLONASS), 1042 (BeiDou), 1044 (QZSS), 1045 and 1046 (Galileo);
//! RTCM 10403.3, 3.5.9 to 3.5.14. Units are the broadcast messages'.

use nalgebra::Vector3;

use crate::formats::binary::{Bits, Clock, Refusal};
use crate::formats::broadcast::{
    GLONASS_ACCURACY_M, GLONASS_UNITS, SEMICIRCLE_RAD, blank, is_plausible, legacy_ura_m,
    per_power, sent_legacy_delay, sisa_m,
};
use crate::gnss::constants::{
    BEIDOU_FIRST_WEEK, BEIDOU_LAG_S, GALILEO_FIRST_WEEK, SECONDS_PER_DAY, SECONDS_PER_WEEK,
};
use crate::gnss::{
    Constellation, Ephemeris, GlonassEphemeris, GpsTime, GroupDelays, KeplerianEphemeris,
    NavigationMessage,
};

/// FDMA channel by GLONASS slot, where known.
pub(super) type GlonassChannels = [Option<i8>; 64];

/// Weeks after which the week counts of GPS, Galileo and BeiDou roll over.
const WEEKS_GPS: i32 = 1024;
const WEEKS_GALILEO: i32 = 4096;
const WEEKS_BEIDOU: i32 = 8192;
/// Largest distance between an ephemeris and the clock, where the week is ambiguous (s).
const NEAR_S: f64 = SECONDS_PER_DAY;

/// Decodes the message that follows its number.
pub(super) fn decode(number: u16, mut bits: Bits<'_>, clock: &Clock) -> Result<Ephemeris, Refusal> {
    let ephemeris = match number {
        1019 => gps(&mut bits, clock).map(Ephemeris::Keplerian),
        1020 => glonass(&mut bits, clock).map(Ephemeris::Glonass),
        1042 => beidou(&mut bits, clock).map(Ephemeris::Keplerian),
        1044 => qzss(&mut bits, clock).map(Ephemeris::Keplerian),
        _ => galileo(&mut bits, clock, number == 1046).map(Ephemeris::Keplerian),
    };
    // A truncated message is refused as such, independent of its content.
    bits.require_sound()?;
    let ephemeris = ephemeris?;
    if is_plausible(&ephemeris) { Ok(ephemeris) } else { Err(Refusal::ImplausibleEphemeris) }
}

/// The instant of a GPS week and second of week (s).
///
/// A message has one week for transmission, toc and toe. Near the end of the week the instant may
/// belong to the neighbouring one; then the instant close to the clock is taken.
fn dated(week: i32, second: f64, clock: &Clock) -> GpsTime {
    let given = GpsTime::from_week_seconds(week, second);
    let Some(now) = clock.time() else { return given };
    let behind_s = now - given;
    let turn_s = SECONDS_PER_WEEK.copysign(behind_s);
    let is_a_week_off =
        0.5 * SECONDS_PER_WEEK < behind_s.abs() && (behind_s - turn_s).abs() < NEAR_S;
    if is_a_week_off { given + turn_s } else { given }
}

/// The GPS week of a count that is unique without a clock.
fn long_week(count: u64, start: i32, modulus: i32, clock: &Clock) -> i32 {
    let week = count as i32 + start;
    clock.week(week as u64, modulus).unwrap_or(week)
}

fn gps(bits: &mut Bits<'_>, clock: &Clock) -> Result<KeplerianEphemeris, Refusal> {
    let satellite = super::satellite(Constellation::Gps, bits.unsigned(6))?;
    let week = clock.week(bits.unsigned(10), WEEKS_GPS)?;
    let accuracy_m = Some(legacy_ura_m(bits.unsigned(4)));
    bits.skip(2);
    let idot_rad_s = bits.signed_scaled(14, per_power(43) * SEMICIRCLE_RAD);
    let iode = bits.unsigned(8) as u32;
    let toc = dated(week, bits.scaled(16, 16.0), clock);
    let af2_per_s = bits.signed_scaled(8, per_power(55));
    let af1 = bits.signed_scaled(16, per_power(43));
    let af0_s = bits.signed_scaled(22, per_power(31));
    let iodc = bits.unsigned(10) as u32;
    let mut ephemeris =
        orbit_gps(bits, week, clock, blank(satellite, NavigationMessage::Lnav, toc));
    ephemeris.omega_dot_rad_s = bits.signed_scaled(24, per_power(43) * SEMICIRCLE_RAD);
    let tgd = bits.signed(8);
    let health = bits.unsigned(6) as u32;
    bits.skip(1);
    let fits_long = bits.flag();
    Ok(KeplerianEphemeris {
        accuracy_m,
        idot_rad_s,
        iode,
        af2_per_s,
        af1,
        af0_s,
        iodc,
        health,
        group_delays: sent_legacy_delay(Constellation::Gps, tgd),
        fit_interval_h: (!fits_long).then_some(4.0),
        ..ephemeris
    })
}

fn qzss(bits: &mut Bits<'_>, clock: &Clock) -> Result<KeplerianEphemeris, Refusal> {
    let satellite = super::satellite(Constellation::Qzss, bits.unsigned(4))?;
    let toc_s = bits.scaled(16, 16.0);
    let af2_per_s = bits.signed_scaled(8, per_power(55));
    let af1 = bits.signed_scaled(16, per_power(43));
    let af0_s = bits.signed_scaled(22, per_power(31));
    let iode = bits.unsigned(8) as u32;
    // The week follows the orbit, whose toe needs it.
    let mut ahead = Bits::clone(bits);
    ahead.skip(QZSS_BITS_BEFORE_WEEK);
    let week = clock.week(ahead.unsigned(10), WEEKS_GPS)?;
    let toc = dated(week, toc_s, clock);
    let mut ephemeris =
        orbit_gps(bits, week, clock, blank(satellite, NavigationMessage::Lnav, toc));
    ephemeris.omega_dot_rad_s = bits.signed_scaled(24, per_power(43) * SEMICIRCLE_RAD);
    ephemeris.idot_rad_s = bits.signed_scaled(14, per_power(43) * SEMICIRCLE_RAD);
    bits.skip(2 + 10);
    let accuracy_m = Some(legacy_ura_m(bits.unsigned(4)));
    let health = bits.unsigned(6) as u32;
    let tgd = bits.signed(8);
    let iodc = bits.unsigned(10) as u32;
    let fits_long = bits.flag();
    Ok(KeplerianEphemeris {
        accuracy_m,
        iode,
        af2_per_s,
        af1,
        af0_s,
        iodc,
        health,
        group_delays: sent_legacy_delay(Constellation::Qzss, tgd),
        fit_interval_h: (!fits_long).then_some(2.0),
        ..ephemeris
    })
}

/// Bits of the orbit, the rates of node and inclination, and the codes on L2.
const QZSS_BITS_BEFORE_WEEK: usize = 8 * 16 + 6 * 32 + 24 + 14 + 2;

/// Reads C_rs to ω, which GPS and QZSS have in the same order.
fn orbit_gps(
    bits: &mut Bits<'_>,
    week: i32,
    clock: &Clock,
    blank: KeplerianEphemeris,
) -> KeplerianEphemeris {
    KeplerianEphemeris {
        crs_m: bits.signed_scaled(16, per_power(5)),
        delta_n_rad_s: bits.signed_scaled(16, per_power(43) * SEMICIRCLE_RAD),
        m0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        cuc_rad: bits.signed_scaled(16, per_power(29)),
        eccentricity: bits.scaled(32, per_power(33)),
        cus_rad: bits.signed_scaled(16, per_power(29)),
        sqrt_a: bits.scaled(32, per_power(19)),
        toe: dated(week, bits.scaled(16, 16.0), clock),
        cic_rad: bits.signed_scaled(16, per_power(29)),
        omega0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        cis_rad: bits.signed_scaled(16, per_power(29)),
        i0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        crc_m: bits.signed_scaled(16, per_power(5)),
        omega_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        ..blank
    }
}

fn galileo(
    bits: &mut Bits<'_>,
    clock: &Clock,
    is_inav: bool,
) -> Result<KeplerianEphemeris, Refusal> {
    let satellite = super::satellite(Constellation::Galileo, bits.unsigned(6))?;
    let week = long_week(bits.unsigned(12), GALILEO_FIRST_WEEK, WEEKS_GALILEO, clock);
    let iode = bits.unsigned(10) as u32;
    let accuracy_m = Some(sisa_m(bits.unsigned(8)));
    let message = if is_inav { NavigationMessage::Inav } else { NavigationMessage::Fnav };
    let idot_rad_s = bits.signed_scaled(14, per_power(43) * SEMICIRCLE_RAD);
    let toc = dated(week, bits.scaled(14, 60.0), clock);
    let ephemeris = KeplerianEphemeris {
        accuracy_m,
        iode,
        iodc: iode,
        idot_rad_s,
        af2_per_s: bits.signed_scaled(6, per_power(59)),
        af1: bits.signed_scaled(21, per_power(46)),
        af0_s: bits.signed_scaled(31, per_power(34)),
        crs_m: bits.signed_scaled(16, per_power(5)),
        delta_n_rad_s: bits.signed_scaled(16, per_power(43) * SEMICIRCLE_RAD),
        m0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        cuc_rad: bits.signed_scaled(16, per_power(29)),
        eccentricity: bits.scaled(32, per_power(33)),
        cus_rad: bits.signed_scaled(16, per_power(29)),
        sqrt_a: bits.scaled(32, per_power(19)),
        toe: dated(week, bits.scaled(14, 60.0), clock),
        cic_rad: bits.signed_scaled(16, per_power(29)),
        omega0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        cis_rad: bits.signed_scaled(16, per_power(29)),
        i0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        crc_m: bits.signed_scaled(16, per_power(5)),
        omega_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        omega_dot_rad_s: bits.signed_scaled(24, per_power(43) * SEMICIRCLE_RAD),
        ..blank(satellite, message, toc)
    };
    let bgd_e5a_s = bits.signed_scaled(10, per_power(32));
    let bgd_e5b_s = is_inav.then(|| bits.signed_scaled(10, per_power(32)));
    // Health word as in RINEX: data validity, then signal health, of E1-B, E5a and E5b.
    let mut status = |shift: u32| {
        let health = bits.unsigned(2) as u32;
        (health << 1 | bits.unsigned(1) as u32) << shift
    };
    let health = if is_inav { status(6) | status(0) } else { status(3) };
    let group_delays = GroupDelays::Galileo { bgd_e5a_s, bgd_e5b_s };
    Ok(KeplerianEphemeris { health, group_delays, ..ephemeris })
}

fn beidou(bits: &mut Bits<'_>, clock: &Clock) -> Result<KeplerianEphemeris, Refusal> {
    let satellite = super::satellite(Constellation::BeiDou, bits.unsigned(6))?;
    let week = long_week(bits.unsigned(13), BEIDOU_FIRST_WEEK, WEEKS_BEIDOU, clock);
    let geostationary = satellite.is_beidou_geo();
    let message = if geostationary { NavigationMessage::D2 } else { NavigationMessage::D1 };
    let accuracy_m = Some(legacy_ura_m(bits.unsigned(4)));
    let idot_rad_s = bits.signed_scaled(14, per_power(43) * SEMICIRCLE_RAD);
    let iode = bits.unsigned(5) as u32;
    let toc = dated(week, bits.scaled(17, 8.0) + BEIDOU_LAG_S, clock);
    let ephemeris = KeplerianEphemeris {
        accuracy_m,
        idot_rad_s,
        iode,
        af2_per_s: bits.signed(11) as f64 * (per_power(33) * per_power(33)),
        af1: bits.signed_scaled(22, per_power(50)),
        af0_s: bits.signed_scaled(24, per_power(33)),
        iodc: bits.unsigned(5) as u32,
        crs_m: bits.signed_scaled(18, per_power(6)),
        delta_n_rad_s: bits.signed_scaled(16, per_power(43) * SEMICIRCLE_RAD),
        m0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        cuc_rad: bits.signed_scaled(18, per_power(31)),
        eccentricity: bits.scaled(32, per_power(33)),
        cus_rad: bits.signed_scaled(18, per_power(31)),
        sqrt_a: bits.scaled(32, per_power(19)),
        toe: dated(week, bits.scaled(17, 8.0) + BEIDOU_LAG_S, clock),
        cic_rad: bits.signed_scaled(18, per_power(31)),
        omega0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        cis_rad: bits.signed_scaled(18, per_power(31)),
        i0_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        crc_m: bits.signed_scaled(18, per_power(6)),
        omega_rad: bits.signed_scaled(32, per_power(31) * SEMICIRCLE_RAD),
        omega_dot_rad_s: bits.signed_scaled(24, per_power(43) * SEMICIRCLE_RAD),
        group_delays: GroupDelays::BeiDou {
            tgd1_s: bits.signed_scaled(10, 1e-10),
            tgd2_s: bits.signed_scaled(10, 1e-10),
        },
        ..blank(satellite, message, toc)
    };
    Ok(KeplerianEphemeris { health: bits.unsigned(1) as u32, ..ephemeris })
}

/// Number of days in four years; N_T counts in such intervals.
const DAYS_OF_FOUR_YEARS: i64 = 1461;

fn glonass(bits: &mut Bits<'_>, clock: &Clock) -> Result<GlonassEphemeris, Refusal> {
    let satellite = super::satellite(Constellation::Glonass, bits.unsigned(6))?;
    let channel = bits.unsigned(5) as i8 - 7;
    // Almanac health, P1 and t_k.
    bits.skip(2 + 2 + 12);
    let health = bits.unsigned(1) as u32;
    bits.skip(1);
    let tb_s = bits.scaled(7, 900.0);
    let mut axis = || {
        let velocity = bits.sign_magnitude(24) as f64 * GLONASS_UNITS[1];
        let position = bits.sign_magnitude(27) as f64 * GLONASS_UNITS[0];
        let acceleration = bits.sign_magnitude(5) as f64 * GLONASS_UNITS[2];
        [position, velocity, acceleration]
    };
    let axes = [axis(), axis(), axis()];
    let vector = |order: usize| Vector3::from(axes.map(|axis| axis[order]));
    bits.skip(1);
    let gamma = bits.sign_magnitude(11) as f64 * per_power(40);
    bits.skip(2);
    let is_malfunctioning = bits.flag();
    let tau_s = bits.sign_magnitude(22) as f64 * per_power(30);
    let delta_tau_s = bits.sign_magnitude(5) as f64 * per_power(30);
    let age_days = bits.unsigned(5) as u8;
    bits.skip(1);
    let accuracy = bits.unsigned(4) as usize;
    let day = bits.unsigned(11) as i64;
    let is_modern = bits.unsigned(2) == 1;
    let has_additional = bits.flag();
    bits.skip(11 + 32);
    let four_years = bits.unsigned(5) as i64;
    bits.skip(22 + 1 + 7);
    let dated =
        has_additional && (1..=DAYS_OF_FOUR_YEARS).contains(&day) && (1..=31).contains(&four_years);
    let toe = match clock.of_glonass_day((tb_s * 1e3) as u64, None) {
        Err(Refusal::NoReferenceTime) if dated => {
            clock.of_glonass_date(four_years, day, tb_s as i64)
        }
        found => found?,
    };
    Ok(GlonassEphemeris {
        satellite,
        toe,
        transmission_time: None,
        position_m: vector(0),
        velocity_m_s: vector(1),
        acceleration_m_s2: vector(2),
        clock_bias_s: -tau_s,
        gamma,
        delta_tau_s: Some(delta_tau_s),
        channel,
        health: health | u32::from(is_malfunctioning) << 1,
        accuracy_m: GLONASS_ACCURACY_M.get(accuracy).copied().filter(|_| is_modern),
        age_days,
    })
}
