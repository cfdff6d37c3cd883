//! Writes observation files of version 3.05.

use std::fmt::Write as _;
use std::io::Write;

use super::header_writer::{Label, header_line};
use super::{ObservationHeader, RinexWriteError};
use crate::gnss::{
    CivilTime, Constellation, Epoch, GpsTime, LeapSeconds, Observation, ObservationCode, Signal,
    TimeScale,
};

const TYPES_PER_LINE: usize = 13;
const CHANNELS_PER_LINE: usize = 8;
/// The quantities of a signal, in the order of their columns.
const QUANTITIES: [char; 4] = ['C', 'L', 'D', 'S'];
const FIELD_WIDTH: usize = 16;
const SATELLITES_LIMIT: usize = 999;
/// Seven decimals of seconds are 100 ns.
const TICK_NS: i64 = 100;

/// Writes epochs of observations, tagged in GPS time, as RINEX 3.05.
///
/// A value that rounds to zero is read as missing: RINEX has no zero. Pseudoranges, phases,
/// Dopplers and C/N0 have three decimals, time tags a resolution of 100 ns.
#[derive(Debug)]
pub struct ObservationWriter<W> {
    output: W,
    codes: [Vec<ObservationCode>; Constellation::COUNT],
    text: String,
}

impl<W: Write> ObservationWriter<W> {
    /// Writes the header; only signals that it lists can be written later.
    pub fn new(mut output: W, header: &ObservationHeader) -> Result<Self, RinexWriteError> {
        output.write_all(header_text(header).as_bytes())?;
        Ok(Self { output, codes: header.codes.clone(), text: String::new() })
    }

    /// Writes one epoch.
    ///
    /// # Errors
    /// A signal that the header does not list, or a number too large for its columns. Then nothing
    /// of the epoch is written.
    pub fn write_epoch(&mut self, epoch: &Epoch) -> Result<(), RinexWriteError> {
        self.text.clear();
        let satellites = epoch.by_satellite().count();
        if SATELLITES_LIMIT < satellites {
            return Err(RinexWriteError::TooManySatellites { satellites });
        }
        let flag = u8::from(epoch.power_failure);
        let tag = date_text(epoch.time);
        writeln!(self.text, "> {tag}  {flag}{satellites:3}").expect("a String takes all");
        for (satellite, observations) in epoch.by_satellite() {
            let codes = &self.codes[satellite.constellation.index()];
            write!(self.text, "{satellite}").expect("a String takes all");
            let start = self.text.len();
            for observation in observations {
                if !codes.contains(&observation.code) {
                    return Err(RinexWriteError::UndeclaredSignal { signal: observation.signal() });
                }
            }
            for code in codes {
                match observations.iter().find(|o| o.code == *code) {
                    Some(observation) => write_signal(&mut self.text, observation)?,
                    None => blank(&mut self.text, QUANTITIES.len() * FIELD_WIDTH),
                }
            }
            let used = self.text[start..].trim_end().len();
            self.text.truncate(start + used);
            self.text.push('\n');
        }
        self.output.write_all(self.text.as_bytes())?;
        Ok(())
    }

    /// Writes one epoch, without the values that are too large for their columns or not finite: a
    /// receiver may send any number.
    ///
    /// # Errors
    /// A signal that the header does not list.
    pub fn write_what_fits(&mut self, mut epoch: Epoch) -> Result<(), RinexWriteError> {
        for observation in &mut epoch.observations {
            let phase = observation.carrier_phase;
            observation.carrier_phase = phase.filter(|phase| fits(phase.0));
            for value in [
                &mut observation.pseudorange_m,
                &mut observation.doppler_hz,
                &mut observation.cn0_db_hz,
            ] {
                *value = value.filter(|value| fits(*value));
            }
        }
        self.write_epoch(&epoch)
    }

    /// The output, with what is written so far.
    pub(crate) const fn output(&self) -> &W {
        &self.output
    }

    /// Takes what is written so far out of the output.
    pub fn take(&mut self) -> W
    where
        W: Default,
    {
        std::mem::take(&mut self.output)
    }

    /// Flushes and returns the output.
    pub fn finish(mut self) -> Result<W, RinexWriteError> {
        self.output.flush()?;
        Ok(self.output)
    }
}

fn blank(text: &mut String, width: usize) {
    write!(text, "{:width$}", "").expect("a String takes all");
}

fn write_signal(text: &mut String, observation: &Observation) -> Result<(), RinexWriteError> {
    let signal = observation.signal();
    let phase = observation.carrier_phase.map(|phase| phase.0);
    let lli = u8::from(observation.loss_of_lock) | u8::from(observation.half_cycle) << 1;
    write_field(text, observation.pseudorange_m, 0, signal)?;
    write_field(text, phase, lli, signal)?;
    write_field(text, observation.doppler_hz, 0, signal)?;
    write_field(text, observation.cn0_db_hz, 0, signal)
}

fn write_field(
    text: &mut String,
    value: Option<f64>,
    lli: u8,
    signal: Signal,
) -> Result<(), RinexWriteError> {
    match value {
        Some(value) if !fits(value) => {
            return Err(RinexWriteError::ValueTooLarge { signal, value });
        }
        Some(value) => write!(text, "{value:14.3}").expect("a String takes all"),
        None => blank(text, FIELD_WIDTH - 2),
    }
    text.push(if lli == 0 { ' ' } else { char::from(b'0' + lli) });
    text.push(' ');
    Ok(())
}

/// Whether a number fits into the 14 columns of a value.
fn fits(value: f64) -> bool {
    (-999_999_999.999..=9_999_999_999.999).contains(&value)
}

/// `2019 04 28 12 44 33.9970000`, rounded to 100 ns.
fn date_text(time: GpsTime) -> String {
    let c = rounded_civil(time);
    let ticks = i64::from(c.nanosecond) / TICK_NS;
    let (year, month, day, hour, minute) = (c.year, c.month, c.day, c.hour, c.minute);
    format!("{year:04} {month:02} {day:02} {hour:02} {minute:02} {:2}.{ticks:07}", c.second)
}

fn rounded_civil(time: GpsTime) -> CivilTime {
    let ticks = (time.as_ns() + TICK_NS / 2).div_euclid(TICK_NS);
    GpsTime::from_ns(ticks * TICK_NS).to_civil(TimeScale::Gps, &LeapSeconds::table())
}

fn header_text(header: &ObservationHeader) -> String {
    let mut text = String::new();
    let system = header.constellation.map_or('M', Constellation::letter);
    let first = format!("{:>9}{:11}{:20}{system}", "3.05", "", "OBSERVATION DATA");
    header_line(&mut text, &first, Label("RINEX VERSION / TYPE"));
    header_line(&mut text, "Graphfix", Label("PGM / RUN BY / DATE"));
    header_line(&mut text, &header.marker, Label("MARKER NAME"));
    header_line(&mut text, "", Label("OBSERVER / AGENCY"));
    header_line(
        &mut text,
        &format!("{:20}{:.20}", "", header.receiver),
        Label("REC # / TYPE / VERS"),
    );
    header_line(&mut text, &format!("{:20}{:.20}", "", header.antenna), Label("ANT # / TYPE"));
    if let Some(position) = header.approximate_position {
        header_line(&mut text, &three(position.0.into()), Label("APPROX POSITION XYZ"));
    }
    header_line(&mut text, &three(header.antenna_delta_hen_m), Label("ANTENNA: DELTA H/E/N"));
    write_types(&mut text, header);
    if let Some(interval) = header.interval_s {
        header_line(&mut text, &format!("{interval:10.3}"), Label("INTERVAL"));
    }
    if let Some(time) = header.first_observation {
        let c = rounded_civil(time);
        let seconds = f64::from(c.second) + f64::from(c.nanosecond) * 1e-9;
        let date = format!("{:6}{:6}{:6}{:6}{:6}", c.year, c.month, c.day, c.hour, c.minute);
        header_line(
            &mut text,
            &format!("{date}{seconds:13.7}     GPS"),
            Label("TIME OF FIRST OBS"),
        );
    }
    write_channels(&mut text, header);
    if let Some(leap_seconds) = header.leap_seconds {
        header_line(&mut text, &format!("{leap_seconds:6}"), Label("LEAP SECONDS"));
    }
    header_line(&mut text, "", Label("END OF HEADER"));
    text
}

fn three([a, b, c]: [f64; 3]) -> String {
    format!("{a:14.4}{b:14.4}{c:14.4}")
}

fn write_types(text: &mut String, header: &ObservationHeader) {
    for constellation in Constellation::ALL {
        let codes = header.codes_of(constellation);
        let types: Vec<String> =
            codes.iter().flat_map(|code| QUANTITIES.map(|q| format!(" {q}{code}"))).collect();
        for (index, line) in types.chunks(TYPES_PER_LINE).enumerate() {
            let start = match index {
                0 => format!("{}  {:3}", constellation.letter(), types.len()),
                _ => format!("{:6}", ""),
            };
            header_line(text, &(start + &line.concat()), Label("SYS / # / OBS TYPES"));
        }
    }
}

fn write_channels(text: &mut String, header: &ObservationHeader) {
    let channels: Vec<String> = header
        .glonass_channels
        .iter()
        .map(|(slot, channel)| format!("R{slot:02} {channel:2} "))
        .collect();
    for (index, line) in channels.chunks(CHANNELS_PER_LINE).enumerate() {
        let count = if index == 0 { format!("{:3} ", channels.len()) } else { " ".repeat(4) };
        header_line(text, &(count + &line.concat()), Label("GLONASS SLOT / FRQ #"));
    }
}
