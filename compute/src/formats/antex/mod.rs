//! ANTEX 1.3 and 1.4: phase centres of antennas.
//!
//! Rothacher & Schmid (2010), *ANTEX: The Antenna Exchange Format, Version 1.4*. Offsets and
//! variations are millimetres in the file. Sections of standard deviations and frequencies of
//! unknown systems are skipped. So are satellite antennas, after the same checks: broadcast
//! ephemerides refer to their phase centres. Calibrations relative to a reference antenna cannot be
//! mixed with absolute ones and are refused.

mod error;
mod grid;
mod lines;

use std::io::BufRead;

use crate::gnss::{
    AntennaCalibration, AntennaCatalogue, CivilTime, GpsTime, LeapSeconds, PhaseCentrePattern,
    TimeScale, split_antenna_name,
};

pub use error::AntexError;
use grid::{Grid, offset_m};
use lines::Lines;

const ANTENNAS_LIMIT: usize = 50_000;
const FREQUENCIES_LIMIT: usize = 32;
/// Largest number of zenith angles: a grid of half a degree.
const ZENITHS_LIMIT: usize = 361;
const AZIMUTHS_LIMIT: usize = 721;
/// Nadir angles of satellites end below this (deg), zenith angles of receivers above.
const NADIR_LIMIT_DEG: f64 = 45.0;

/// Reads a whole file.
///
/// # Errors
/// Any record of the header or of an antenna that is not understood: a partly read calibration
/// would shift positions.
///
/// # Example
/// ```
/// let record = |contents: &str, label: &str| format!("{contents:<60}{label}\n");
/// let file = [
///     record("     1.4            M", "ANTEX VERSION / SYST"),
///     record("", "END OF HEADER"),
///     record("", "START OF ANTENNA"),
///     record("MAKER123.00     DOME", "TYPE / SERIAL NO"),
///     record("     0.0", "DAZI"),
///     record("     0.0  90.0  45.0", "ZEN1 / ZEN2 / DZEN"),
///     record("   G01", "START OF FREQUENCY"),
///     record("      1.00     -2.00    100.00", "NORTH / EAST / UP"),
///     "   NOAZI    0.00   -0.50   -2.00\n".to_owned(),
///     record("   G01", "END OF FREQUENCY"),
///     record("", "END OF ANTENNA"),
/// ];
/// let catalogue = graphfix_compute::formats::antex::read(file.concat().as_bytes())?;
/// assert_eq!(catalogue.receivers.len(), 1);
/// # Ok::<(), graphfix_compute::formats::antex::AntexError>(())
/// ```
pub fn read(input: impl BufRead) -> Result<AntennaCatalogue, AntexError> {
    let mut lines = Lines::new(input);
    read_header(&mut lines)?;
    let mut catalogue = AntennaCatalogue::default();
    let mut count = 0;
    while lines.next()? {
        match lines.label() {
            "START OF ANTENNA" => {
                if ANTENNAS_LIMIT <= count {
                    return Err(lines.malformed("START OF ANTENNA", "too many antennas"));
                }
                count += 1;
                catalogue.receivers.extend(read_antenna(&mut lines)?);
            }
            "COMMENT" => {}
            _ if lines.text().is_empty() => {}
            _ => return Err(lines.unexpected()),
        }
    }
    Ok(catalogue)
}

fn read_header<R: BufRead>(lines: &mut Lines<R>) -> Result<(), AntexError> {
    if !lines.next()? || lines.label() != "ANTEX VERSION / SYST" {
        let found = lines.text().chars().take(40).collect();
        return Err(AntexError::NotAntex { found });
    }
    if !matches!(lines.columns(0, 8), "1.3" | "1.4") {
        return Err(AntexError::UnsupportedVersion { version: lines.columns(0, 8).to_owned() });
    }
    loop {
        lines.next_of("its header")?;
        match lines.label() {
            "PCV TYPE / REFANT" => match lines.columns(0, 1) {
                "A" => {}
                "R" => return Err(AntexError::Relative { line: lines.number() }),
                _ => return Err(lines.malformed("PCV TYPE / REFANT", "neither A nor R")),
            },
            "COMMENT" => {}
            "END OF HEADER" => return Ok(()),
            _ => return Err(lines.unexpected()),
        }
    }
}

/// The records of an antenna before and between its frequencies.
#[derive(Default)]
struct Description {
    /// Type and radome, columns 1 to 20.
    name: Option<String>,
    /// Serial number; of a satellite antenna the satellite.
    serial: String,
    azimuth_step_deg: Option<f64>,
    zeniths_deg: Option<[f64; 3]>,
    frequencies: Option<usize>,
    patterns: Vec<PhaseCentrePattern>,
    /// Number of frequencies read, unknown systems included.
    read: usize,
}

/// Reads an antenna to its end; `None` for a satellite's.
fn read_antenna<R: BufRead>(
    lines: &mut Lines<R>,
) -> Result<Option<AntennaCalibration>, AntexError> {
    let mut description = Description::default();
    loop {
        lines.next_of("an antenna")?;
        match lines.label() {
            "TYPE / SERIAL NO" => {
                description.name = Some(lines.columns(0, 20).to_owned());
                description.serial = lines.columns(20, 40).to_owned();
            }
            "DAZI" => description.azimuth_step_deg = Some(azimuth_step_deg(lines)?),
            "ZEN1 / ZEN2 / DZEN" => description.zeniths_deg = Some(zeniths_deg(lines)?),
            "# OF FREQUENCIES" => {
                let count = lines.columns(0, 6).parse().ok();
                let count = count.filter(|count| (1..=FREQUENCIES_LIMIT).contains(count));
                let wrong = lines.malformed("# OF FREQUENCIES", "not a count from 1 to 32");
                description.frequencies = Some(count.ok_or(wrong)?);
            }
            "VALID FROM" => drop(time(lines, "VALID FROM")?),
            "VALID UNTIL" => drop(time(lines, "VALID UNTIL")?),
            "START OF FREQUENCY" => read_frequency(lines, &mut description)?,
            "START OF FREQ RMS" => pass_over(lines, "END OF FREQ RMS")?,
            "METH / BY / # / DATE" | "SINEX CODE" | "COMMENT" => {}
            "END OF ANTENNA" => return finish(lines, description),
            _ => return Err(lines.unexpected()),
        }
    }
}

fn finish<R: BufRead>(
    lines: &Lines<R>,
    description: Description,
) -> Result<Option<AntennaCalibration>, AntexError> {
    const LABEL: &str = "END OF ANTENNA";
    let name = description.name.ok_or(lines.malformed(LABEL, "TYPE / SERIAL NO is missing"))?;
    let zeniths = description.zeniths_deg;
    let zeniths = zeniths.ok_or(lines.malformed(LABEL, "ZEN1 / ZEN2 / DZEN is missing"))?;
    if description.frequencies.is_some_and(|count| count != description.read) {
        return Err(lines.malformed(LABEL, "the number of frequencies differs from the stated one"));
    }
    if zeniths[1] < NADIR_LIMIT_DEG {
        return Ok(None);
    }
    let (antenna, radome) = split_antenna_name(&name);
    Ok(Some(AntennaCalibration {
        antenna: antenna.to_owned(),
        radome: radome.to_owned(),
        serial: description.serial,
        patterns: description.patterns,
    }))
}

/// Step of the azimuth grid (deg); zero without a grid.
fn azimuth_step_deg<R: BufRead>(lines: &Lines<R>) -> Result<f64, AntexError> {
    let step = lines.number_in(2, 8).ok_or(lines.malformed("DAZI", "not a number"))?;
    let steps = 360.0 / step;
    let is_grid = step == 0.0
        || (0.0 < step && steps < AZIMUTHS_LIMIT as f64 && (steps - steps.round()).abs() < 1e-6);
    if is_grid { Ok(step) } else { Err(lines.malformed("DAZI", "it does not divide 360 degrees")) }
}

/// First and last zenith angle and their step (deg).
fn zeniths_deg<R: BufRead>(lines: &Lines<R>) -> Result<[f64; 3], AntexError> {
    const LABEL: &str = "ZEN1 / ZEN2 / DZEN";
    let number = |at: usize| {
        lines.number_in(2 + 6 * at, 8 + 6 * at).ok_or(lines.malformed(LABEL, "not three numbers"))
    };
    let [first, last, step] = [number(0)?, number(1)?, number(2)?];
    let steps = (last - first) / step;
    let is_grid = 0.0 <= first
        && first < last
        && last <= 180.0
        && 0.0 < step
        && steps < ZENITHS_LIMIT as f64
        && (steps - steps.round()).abs() < 1e-6;
    let wrong = lines.malformed(LABEL, "not a grid from 0 to 180 degrees");
    if is_grid { Ok([first, last, step]) } else { Err(wrong) }
}

fn time<R: BufRead>(lines: &Lines<R>, label: &'static str) -> Result<GpsTime, AntexError> {
    let part = |at: usize| lines.columns(6 * at, 6 * at + 6).parse::<u16>().ok();
    let seconds = lines.number_in(30, 43).filter(|seconds| (0.0..60.0).contains(seconds));
    let read = || {
        let seconds = seconds?;
        let byte = |at: usize| u8::try_from(part(at)?).ok();
        let civil = CivilTime {
            year: i32::from(part(0)?),
            month: byte(1)?,
            day: byte(2)?,
            hour: byte(3)?,
            minute: byte(4)?,
            second: seconds as u8,
            nanosecond: (seconds.fract() * 1e9) as u32,
        };
        GpsTime::from_civil(&civil, TimeScale::Gps, &LeapSeconds::table())
    };
    read().ok_or(lines.malformed(label, "not a date and time"))
}

/// Skips the lines up to and including the label `end`.
fn pass_over<R: BufRead>(lines: &mut Lines<R>, end: &str) -> Result<(), AntexError> {
    loop {
        lines.next_of("a frequency")?;
        match lines.label() {
            label if label == end => return Ok(()),
            "END OF ANTENNA" => return Err(lines.unexpected()),
            _ => {}
        }
    }
}

fn read_frequency<R: BufRead>(
    lines: &mut Lines<R>,
    description: &mut Description,
) -> Result<(), AntexError> {
    const LABEL: &str = "START OF FREQUENCY";
    let code = lines.columns(3, 6).to_owned();
    let zeniths = description.zeniths_deg;
    let zeniths = zeniths.ok_or(lines.malformed(LABEL, "ZEN1 / ZEN2 / DZEN must come before"))?;
    description.read += 1;
    if FREQUENCIES_LIMIT < description.read {
        return Err(lines.malformed(LABEL, "more than 32 frequencies"));
    }
    let mut grid = Grid::new(zeniths, description.azimuth_step_deg.unwrap_or(0.0));
    loop {
        lines.next_of("a frequency")?;
        match lines.label() {
            "END OF FREQUENCY" if lines.columns(3, 6) == code => break,
            "END OF FREQUENCY" => {
                return Err(lines.malformed("END OF FREQUENCY", "it ends another frequency"));
            }
            "NORTH / EAST / UP" => grid.offset_m = Some(offset_m(lines)?),
            "COMMENT" => {}
            _ => grid.read_row(lines)?,
        }
    }
    let pattern = grid.finish(lines, &code)?;
    if let Some(pattern) = pattern {
        let same = |other: &PhaseCentrePattern| {
            (other.constellation, other.band_digit) == (pattern.constellation, pattern.band_digit)
        };
        if description.patterns.iter().any(same) {
            return Err(lines.malformed("END OF FREQUENCY", "the frequency appears twice"));
        }
        description.patterns.push(pattern);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// One labelled record.
    fn record(contents: &str, label: &str) -> String {
        format!("{contents:<60}{label}\n")
    }

    fn row(head: &str, values: &[f64]) -> String {
        let numbers: String = values.iter().map(|value| format!("{value:8.2}")).collect();
        format!("{head:>8}{numbers}\n")
    }

    /// Invented numbers in the layout of the format's description: a receiver antenna with azimuths
    /// on two frequencies, one without, and a satellite.
    fn sample() -> String {
        let frequency = |code: &str, offset: &str, rows: &str| {
            record(&format!("   {code}"), "START OF FREQUENCY")
                + &record(offset, "NORTH / EAST / UP")
                + rows
                + &record(&format!("   {code}"), "END OF FREQUENCY")
        };
        let azimuths: String = [0.0, 120.0, 240.0, 360.0]
            .map(|azimuth| row(&format!("{azimuth:.1}"), &[0.0, azimuth / 100.0, -2.5]))
            .concat();
        let with_azimuths = row("NOAZI", &[0.0, -0.5, -2.0]) + &azimuths;
        let plain = row("NOAZI", &[0.0, 1.0, 2.0]);
        let start = || record("", "START OF ANTENNA");
        let end = || record("", "END OF ANTENNA");
        [
            record(&format!("{:>8}{:12}M", "1.4", ""), "ANTEX VERSION / SYST"),
            record("A", "PCV TYPE / REFANT"),
            record("", "END OF HEADER"),
            start(),
            record(&format!("{:<20}{:<20}{:<10}", "BLOCK X", "G07", "G048"), "TYPE / SERIAL NO"),
            record("", "METH / BY / # / DATE"),
            record("     0.0", "DAZI"),
            record("     0.0  14.0   7.0", "ZEN1 / ZEN2 / DZEN"),
            record("     1", "# OF FREQUENCIES"),
            record("  2008     3    24     0     0    0.0000000", "VALID FROM"),
            record("  2019     2     1    23    59   59.9999999", "VALID UNTIL"),
            frequency("G01", "      0.00      0.00   1000.00", &plain),
            end(),
            start(),
            record(&format!("{:<16}{:<4}", "MAKER123.00", "DOME"), "TYPE / SERIAL NO"),
            record("   120.0", "DAZI"),
            record("     0.0  90.0  45.0", "ZEN1 / ZEN2 / DZEN"),
            record("     3", "# OF FREQUENCIES"),
            frequency("G01", "      1.00     -2.00    100.00", &with_azimuths),
            frequency("G02", "      0.50      0.25    110.00", &with_azimuths),
            frequency("S01", "      0.50      0.25    110.00", &with_azimuths),
            record("   G01", "START OF FREQ RMS"),
            record("      0.10      0.10      0.10", "NORTH / EAST / UP"),
            record("   G01", "END OF FREQ RMS"),
            end(),
            start(),
            record(&format!("{:<20}{:<20}", "MAKER77", "4711"), "TYPE / SERIAL NO"),
            record("     0.0", "DAZI"),
            record("     0.0  90.0  45.0", "ZEN1 / ZEN2 / DZEN"),
            record("     1", "# OF FREQUENCIES"),
            frequency("R01", "      0.00      0.00     55.00", &plain),
            end(),
        ]
        .concat()
    }

    #[test]
    fn antennas_are_read() {
        let catalogue = read(sample().as_bytes()).unwrap();
        assert_eq!(catalogue.receivers.len(), 2, "without the satellite's");
        let dome = catalogue.receiver("MAKER123.00     DOME", "").unwrap();
        let bands: Vec<_> = dome.patterns.iter().map(|pattern| pattern.band_digit).collect();
        assert_eq!(bands, [1, 2]);
        let first = &dome.patterns[0];
        assert!((first.offset_m - Vector3::new(0.001, -0.002, 0.1)).norm() < 1e-12);
        assert_eq!(first.variations_m, [0.0, -0.000_5, -0.002]);
        assert_eq!(first.azimuth_variations_m.len(), 4);
        assert_eq!(first.azimuth_variations_m[2], [0.0, 0.002_4, -0.002_5]);
        assert_eq!(first.zenith_step_rad, 45_f64.to_radians());
        assert_eq!(catalogue.receiver("MAKER77", "4711").unwrap().serial, "4711");
        assert_eq!(catalogue.receiver("MAKER123.00     NONE", ""), None);
    }

    #[test]
    fn wrong_files_are_refused_with_their_line() {
        let text = sample();
        let refused = |from: &str, to: &str| {
            assert!(text.contains(from), "{from:?}");
            read(text.replacen(from, to, 1).as_bytes()).unwrap_err().to_string()
        };
        assert!(refused("ANTEX VERSION / SYST", "RINEX VERSION / TYPE").starts_with("line 1: not"));
        assert!(refused("     1.4", "     0.9").starts_with("line 1: ANTEX version \"0.9\""));
        assert!(refused("A    ", "R    ").starts_with("line 2: calibrations relative"));
        assert!(refused("   1000.00", "   1OOO.00").starts_with("line 13: \"NORTH / EAST / UP\""));
        assert!(
            refused("    1.00    2.00", "    1.00").starts_with("line 14: \"START OF FREQUENCY\"")
        );
        assert!(refused("   120.0", "    90.0").contains("neither NOAZI nor the next azimuth"));
        assert!(refused("  14.0   7.0", "  14.0   4.0").contains("ZEN1"));
        assert!(refused("     3     ", "     2     ").contains("differs from the stated one"));
        assert!(refused("  2008     3    24", "  2008     2    31").contains("not a date"));
        assert!(refused("SYST\n", "SYST\nwhat\n").contains("line 2: unexpected record \"what\""));
        let cut = &text[..text.len() - record("", "END OF ANTENNA").len()];
        assert!(read(cut.as_bytes()).unwrap_err().to_string().contains("the file ends inside"));
        assert!(matches!(read(&b""[..]), Err(AntexError::NotAntex { .. })));
    }

    /// Bytes changed, lines cut, joined and repeated, thousands of times: an answer or an error
    /// that names a line of the file, never a panic.
    #[test]
    fn mutations_never_panic() {
        let original = sample().into_bytes();
        let mut state = 0x2545_f491_4f6c_dd1d_u64;
        let mut below = |limit: usize| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state % limit as u64) as usize
        };
        let (mut read_well, mut refused) = (0, 0);
        for _ in 0..20_000 {
            let mut bytes = original.clone();
            for _ in 0..=below(3) {
                let at = below(bytes.len());
                match below(5) {
                    0 => bytes[at] = below(256) as u8,
                    1 => bytes[at] = b"0123456789.-+eE \nAGN"[below(20)],
                    2 => bytes.truncate(at.max(1)),
                    3 => drop(bytes.remove(at)),
                    _ => {
                        let end = (at + below(200)).min(bytes.len());
                        let piece = bytes[at..end].to_vec();
                        bytes.splice(at..at, piece);
                    }
                }
            }
            match read(bytes.as_slice()) {
                Ok(_) => read_well += 1,
                Err(error) => {
                    refused += 1;
                    let text = error.to_string();
                    let line = text.strip_prefix("line ").and_then(|rest| rest.split(':').next());
                    let line: usize = line.unwrap().parse().unwrap();
                    let lines = bytes.split(|b| *b == b'\n').count();
                    assert!((1..=lines).contains(&line), "{text}");
                }
            }
        }
        assert!(1_000 < read_well && 5_000 < refused, "{read_well} {refused}");
    }
}
