//! Writes navigation files of version 3.05.

use std::fmt::Write as _;
use std::io::Write;

use super::RinexWriteError;
use super::header_writer::{Label, header_line};
use super::navigation::glonass_accuracy_index;
use crate::gnss::{
    Constellation, Ephemeris, GlonassEphemeris, GpsTime, GroupDelays, KeplerianEphemeris,
    KlobucharCoefficients, LeapSeconds, NO_PREDICTION_M, Navigation, NavigationMessage, TimeScale,
};

const KM_PER_METRE: f64 = 1e-3;
/// A week after all known leap seconds, at which the newest count is in force.
const FAR_WEEK: i32 = 10_000;
/// Galileo data sources: I/NAV of E1-B and E5b-I, clock of E5b and E1.
const SOURCES_INAV: f64 = 517.0;
/// Galileo data sources: F/NAV of E5a-I, clock of E5a and E1.
const SOURCES_FNAV: f64 = 258.0;
/// Galileo data sources: F/NAV with I/NAV merged in, which has BGD(E1, E5b).
const SOURCES_MERGED: f64 = 263.0;
const UNKNOWN_DELTA_TAU_S: f64 = 0.999_999_999_999e9;
const UNUSED_ACCURACY_INDEX: f64 = 15.0;

type Rows = [[Option<f64>; 4]; 7];

/// Writes ephemerides, ionosphere coefficients and leap seconds as RINEX 3.05.
///
/// Elements keep 13 significant digits, ionosphere coefficients five.
///
/// # Errors
/// Civil messages (CNAV, B-CNAV) have no record in version 3.
pub fn write_navigation<W: Write>(
    mut output: W,
    navigation: &Navigation,
) -> Result<(), RinexWriteError> {
    let mut text = header_text(navigation);
    for (_, ephemerides) in navigation.satellites() {
        for ephemeris in ephemerides {
            match ephemeris {
                Ephemeris::Keplerian(e) => write_keplerian(&mut text, e)?,
                Ephemeris::Glonass(e) => write_glonass(&mut text, e, &navigation.leap_seconds),
            }
        }
        output.write_all(text.as_bytes())?;
        text.clear();
    }
    output.write_all(text.as_bytes())?;
    output.flush()?;
    Ok(())
}

fn header_text(navigation: &Navigation) -> String {
    let mut text = String::new();
    let first = format!("{:>9}{:11}{:20}M", "3.05", "", "N: GNSS NAV DATA");
    header_line(&mut text, &first, Label("RINEX VERSION / TYPE"));
    header_line(&mut text, "Graphfix", Label("PGM / RUN BY / DATE"));
    let models = [
        ("GPS", navigation.klobuchar_gps),
        ("BDS", navigation.klobuchar_beidou),
        ("QZS", navigation.klobuchar_qzss),
    ];
    for (name, model) in models {
        if let Some(KlobucharCoefficients { alpha, beta }) = model {
            write_coefficients(&mut text, &format!("{name}A"), &alpha);
            write_coefficients(&mut text, &format!("{name}B"), &beta);
        }
    }
    if let Some(model) = navigation.nequick {
        write_coefficients(&mut text, "GAL ", &model.ai);
    }
    let leap_seconds = navigation.leap_seconds.at(GpsTime::from_week_seconds(FAR_WEEK, 0.0));
    header_line(&mut text, &format!("{leap_seconds:6}"), Label("LEAP SECONDS"));
    header_line(&mut text, "", Label("END OF HEADER"));
    text
}

fn write_coefficients(text: &mut String, name: &str, values: &[f64]) {
    let numbers: String = values.iter().map(|value| scientific(*value, 12, 4)).collect();
    header_line(text, &format!("{name} {numbers}"), Label("IONOSPHERIC CORR"));
}

/// A number with a two-digit exponent; values too small for one become zero.
fn scientific(value: f64, width: usize, decimals: usize) -> String {
    let value = if value.abs() < 1e-99 { 0.0 } else { value };
    let text = format!("{value:.decimals$e}");
    let (mantissa, exponent) = text.split_once('e').expect("the format writes an e");
    let (sign, digits) = exponent.strip_prefix('-').map_or(('+', exponent), |digits| ('-', digits));
    format!("{:>width$}", format!("{mantissa}E{sign}{digits:0>2}"))
}

fn element(value: Option<f64>) -> String {
    value.map_or_else(|| " ".repeat(19), |value| scientific(value, 19, 12))
}

fn write_rows(text: &mut String, rows: &[[Option<f64>; 4]]) {
    for row in rows {
        let line: String = row.iter().map(|value| element(*value)).collect();
        writeln!(text, "    {}", line.trim_end()).expect("a String takes all");
    }
}

/// The line with satellite, date and three numbers.
fn write_start(
    text: &mut String,
    ephemeris: &Ephemeris,
    (scale, leap): (TimeScale, &LeapSeconds),
    numbers: [Option<f64>; 3],
) {
    let c = ephemeris.toc().to_civil(scale, leap);
    let (satellite, year) = (ephemeris.satellite(), c.year);
    let (month, day, hour, minute, second) = (c.month, c.day, c.hour, c.minute, c.second);
    let numbers: String = numbers.iter().map(|value| element(*value)).collect();
    let date = format!("{year:04} {month:02} {day:02} {hour:02} {minute:02} {second:02}");
    writeln!(text, "{satellite} {date}{}", numbers.trim_end()).expect("a String takes all");
}

fn write_keplerian(text: &mut String, e: &KeplerianEphemeris) -> Result<(), RinexWriteError> {
    let beidou = e.satellite.constellation == Constellation::BeiDou;
    let scale = if beidou { TimeScale::BeiDou } else { TimeScale::Gps };
    let second = |time: GpsTime| if beidou { time.to_beidou().1 } else { time.seconds_of_week() };
    let week = if beidou { e.toe.to_beidou().0 } else { e.toe.week() };
    let (source, tail) = tail(e)?;
    let some = |a, b, c, d| [Some(a), Some(b), Some(c), Some(d)];
    let rows: Rows = [
        some(f64::from(e.iode), e.crs_m, e.delta_n_rad_s, e.m0_rad),
        some(e.cuc_rad, e.eccentricity, e.cus_rad, e.sqrt_a),
        some(second(e.toe), e.cic_rad, e.omega0_rad, e.cis_rad),
        some(e.i0_rad, e.crc_m, e.omega_rad, e.omega_dot_rad_s),
        [Some(e.idot_rad_s), source, Some(f64::from(week)), None],
        [written_accuracy(e), Some(f64::from(e.health)), tail[0], tail[1]],
        [e.transmission_time.map(second), tail[2], None, None],
    ];
    let start = [Some(e.af0_s), Some(e.af1), Some(e.af2_per_s)];
    let leap = LeapSeconds::table();
    write_start(text, &Ephemeris::Keplerian(e.clone()), (scale, &leap), start);
    // A last row that is all blank would not be recognised as a row.
    let shown = if rows[6].iter().all(Option::is_none) { &rows[..6] } else { &rows[..] };
    write_rows(text, shown);
    Ok(())
}

/// The accuracy; −1 for a Galileo satellite without a prediction (RINEX 3.05, table A8).
fn written_accuracy(e: &KeplerianEphemeris) -> Option<f64> {
    let is_galileo = e.satellite.constellation == Constellation::Galileo;
    e.accuracy_m.map(|metres| if is_galileo && NO_PREDICTION_M <= metres { -1.0 } else { metres })
}

/// The second number of row 5, and the last two of row 6 with the second of row 7.
fn tail(e: &KeplerianEphemeris) -> Result<(Option<f64>, [Option<f64>; 3]), RinexWriteError> {
    use NavigationMessage as M;
    let iodc = Some(f64::from(e.iodc));
    Ok(match (e.message, e.group_delays) {
        (M::Lnav, GroupDelays::Gps { tgd_s, .. }) => {
            let qzss = e.satellite.constellation == Constellation::Qzss;
            // QZSS writes a flag: zero means two hours.
            let fit = e.fit_interval_h.map(|hours| if qzss && hours == 2.0 { 0.0 } else { hours });
            (None, [Some(tgd_s), iodc, fit])
        }
        (M::Inav, GroupDelays::Galileo { bgd_e5a_s, bgd_e5b_s }) => {
            (Some(SOURCES_INAV), [Some(bgd_e5a_s), bgd_e5b_s, None])
        }
        (M::Fnav, GroupDelays::Galileo { bgd_e5a_s, bgd_e5b_s }) => {
            let sources = if bgd_e5b_s.is_some() { SOURCES_MERGED } else { SOURCES_FNAV };
            (Some(sources), [Some(bgd_e5a_s), bgd_e5b_s, None])
        }
        (M::D1 | M::D2, GroupDelays::BeiDou { tgd1_s, tgd2_s }) => {
            (None, [Some(tgd1_s), Some(tgd2_s), iodc])
        }
        (message, _) => {
            return Err(RinexWriteError::MessageUnsupported { satellite: e.satellite, message });
        }
    })
}

fn write_glonass(text: &mut String, e: &GlonassEphemeris, leap: &LeapSeconds) {
    let utc_second = |time: GpsTime| (time - leap.at(time) as f64).seconds_of_week();
    let frame = e.transmission_time.map(utc_second);
    let start = [Some(e.clock_bias_s), Some(e.gamma), frame];
    write_start(text, &Ephemeris::Glonass(e.clone()), (TimeScale::Utc, leap), start);
    let last = [f64::from(e.health), f64::from(e.channel), f64::from(e.age_days)];
    let axis = |index: usize| {
        let in_km = [e.position_m[index], e.velocity_m_s[index], e.acceleration_m_s2[index]]
            .map(|metres| Some(metres * KM_PER_METRE));
        [in_km[0], in_km[1], in_km[2], Some(last[index])]
    };
    let accuracy = e.accuracy_m.map_or(UNUSED_ACCURACY_INDEX, glonass_accuracy_index);
    let delta_tau_s = e.delta_tau_s.unwrap_or(UNKNOWN_DELTA_TAU_S);
    write_rows(text, &[axis(0), axis(1), axis(2), [None, Some(delta_tau_s), Some(accuracy), None]]);
}
