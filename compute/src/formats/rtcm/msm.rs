//! Multiple signal messages, MSM4 to MSM7; RTCM 10403.3, 3.5.16.
//!
//! A range is a sum: whole light-milliseconds and 1024ths of one for the satellite, and a fine part
//! for the signal. A value is missing if its field has the most negative value.

use crate::formats::binary::{Bits, Clock, Refusal};
use crate::gnss::constants::{BEIDOU_LAG_S, LIGHT_MILLISECOND_M, SPEED_OF_LIGHT};
use crate::gnss::{Constellation, Cycles, GpsTime, Observation, ObservationCode, SatelliteId};

use super::ephemeris::GlonassChannels;
use super::lock::{LockTable, LockTime};
use super::msm_signals::code;
use super::{Notes, ObservationMessage};

/// Number of satellites in a mask.
const SATELLITES: usize = 64;
/// Number of signals in a mask.
const SIGNALS: usize = 32;
/// Largest number of cells in a message.
const CELLS: usize = 64;

const MESSAGE_BITS: usize = 12;
/// Value of an unknown day of week (DF416).
const UNKNOWN_DAY: u64 = 7;
/// Value of missing whole light-milliseconds (DF397).
const NO_ROUGH_RANGE: i64 = 255;
/// Value of the extended information without a channel (DF419); 0 … 13 are channels −7 … 6.
const NO_CHANNEL: i64 = 15;

/// Type of a multiple signal message.
#[derive(Clone, Copy, Debug)]
pub(super) struct MsmKind {
    constellation: Constellation,
    fields: &'static SignalFields,
    /// Whether the message has extended information and range rates: MSM5 and MSM7.
    has_rates: bool,
}

/// Widths and units of the signal fields.
#[derive(Debug)]
struct SignalFields {
    range_bits: u32,
    /// Number of units in one light-millisecond.
    range_units: f64,
    phase_bits: u32,
    phase_units: f64,
    lock_bits: u32,
    cn0_bits: u32,
    /// Unit of C/N0 (dB-Hz).
    cn0_unit: f64,
}

/// Fields DF400 to DF403.
const STANDARD: SignalFields = SignalFields {
    range_bits: 15,
    range_units: (1_u64 << 24) as f64,
    phase_bits: 22,
    phase_units: (1_u64 << 29) as f64,
    lock_bits: 4,
    cn0_bits: 6,
    cn0_unit: 1.0,
};

/// Fields DF405 to DF408.
const EXTENDED: SignalFields = SignalFields {
    range_bits: 20,
    range_units: (1_u64 << 29) as f64,
    phase_bits: 24,
    phase_units: (1_u64 << 31) as f64,
    lock_bits: 10,
    cn0_bits: 10,
    cn0_unit: 0.0625,
};

const RATE_BITS: u32 = 15;
/// Unit of DF404 (m/s).
const FINE_RATE_M_S: f64 = 1e-4;

impl MsmKind {
    /// The type of a message number; `None` for other messages.
    pub(super) const fn of(number: u16) -> Option<Result<Self, Refusal>> {
        if !matches!(number, 1071..=1137) {
            return None;
        }
        let constellation = match number / 10 {
            107 => Constellation::Gps,
            108 => Constellation::Glonass,
            109 => Constellation::Galileo,
            111 => Constellation::Qzss,
            112 => Constellation::BeiDou,
            _ => return None,
        };
        let (fields, has_rates) = match number % 10 {
            1..=3 => return Some(Err(Refusal::AmbiguousPseudorange)),
            4 => (&STANDARD, false),
            5 => (&STANDARD, true),
            6 => (&EXTENDED, false),
            7 => (&EXTENDED, true),
            _ => return None,
        };
        Some(Ok(Self { constellation, fields, has_rates }))
    }
}

/// Whether a message is the MSM of a system that is not decoded (SBAS, NavIC); if so, whether it is
/// the last message of its epoch.
pub(super) fn of_other_system(number: u16, mut bits: Bits<'_>) -> Option<bool> {
    let is_other = matches!(number / 10, 110 | 113) && matches!(number % 10, 1..=7);
    bits.skip(12 + 30);
    let more = bits.flag();
    is_other.then_some(!more && bits.require_sound().is_ok())
}

/// The fields before the masks.
struct Header {
    station: u16,
    time: GpsTime,
    more: bool,
}

impl Header {
    fn read(
        bits: &mut Bits<'_>,
        constellation: Constellation,
        clock: &Clock,
        open_epoch: Option<GpsTime>,
    ) -> Result<Self, Refusal> {
        let station = bits.unsigned(12) as u16;
        let time = match constellation {
            Constellation::Glonass => {
                let day = Some(bits.unsigned(3)).filter(|day| *day != UNKNOWN_DAY);
                clock.of_glonass_day(bits.unsigned(27), day)?
            }
            Constellation::BeiDou => {
                let ms = bits.unsigned(30);
                let label = clock.of_week(ms)?;
                if open_epoch == Some(label) { label } else { label + BEIDOU_LAG_S }
            }
            _ => clock.of_week(bits.unsigned(30))?,
        };
        let more = bits.flag();
        // Issue of station, reserved, clock steering, external clock and smoothing.
        bits.skip(3 + 7 + 2 + 2 + 1 + 3);
        Ok(Self { station, time, more })
    }
}

/// One signal of one satellite.
#[derive(Clone, Copy, Default)]
struct Cell {
    /// Index of its satellite in the satellite data.
    row: u8,
    /// Number of the signal in the mask.
    signal: u8,
}

/// Satellites and signals of the message.
struct Masks {
    /// Satellite numbers by index.
    satellites: [u8; SATELLITES],
    rows: usize,
    cells: [Cell; CELLS],
    cell_count: usize,
}

impl Masks {
    fn read(bits: &mut Bits<'_>) -> Result<Self, Refusal> {
        let satellite_mask = bits.unsigned(32) << 32 | bits.unsigned(32);
        let signal_mask = bits.unsigned(32) << 32;
        let mut satellites = [0; SATELLITES];
        let rows = numbers(satellite_mask, &mut satellites);
        let mut signals = [0; SIGNALS];
        let columns = numbers(signal_mask, &mut signals);
        if CELLS < rows * columns {
            return Err(Refusal::TooManyCells);
        }
        let mut masks = Self { satellites, rows, cells: [Cell::default(); CELLS], cell_count: 0 };
        for row in 0..rows {
            for &signal in &signals[..columns] {
                if bits.flag() {
                    masks.cells[masks.cell_count] = Cell { row: row as u8, signal };
                    masks.cell_count += 1;
                }
            }
        }
        Ok(masks)
    }
}

/// Writes the numbers (from 1) of the set bits, from the most significant one; returns their count.
fn numbers(mask: u64, out: &mut [u8]) -> usize {
    let mut left = mask;
    let mut count = 0;
    while left != 0 {
        let bit = left.leading_zeros();
        out[count] = bit as u8 + 1;
        left &= !(1 << (63 - bit));
        count += 1;
    }
    count
}

/// The fields common to the signals of a satellite, by index.
struct SatelliteData {
    rough_ms: [i64; SATELLITES],
    extended: [i64; SATELLITES],
    rough_1024th_ms: [i64; SATELLITES],
    rough_rate_m_s: [i64; SATELLITES],
}

impl SatelliteData {
    fn read(bits: &mut Bits<'_>, rows: usize, has_rates: bool) -> Self {
        let none = [0; SATELLITES];
        Self {
            rough_ms: column(bits, rows, |bits| bits.unsigned(8) as i64),
            extended: if has_rates {
                column(bits, rows, |bits| bits.unsigned(4) as i64)
            } else {
                [NO_CHANNEL; SATELLITES]
            },
            rough_1024th_ms: column(bits, rows, |bits| bits.unsigned(10) as i64),
            rough_rate_m_s: if has_rates { column(bits, rows, |b| b.signed(14)) } else { none },
        }
    }

    /// Rough range (light-milliseconds).
    fn rough_range_ms(&self, row: usize) -> Option<f64> {
        let whole = self.rough_ms[row];
        (whole != NO_ROUGH_RANGE).then(|| whole as f64 + self.rough_1024th_ms[row] as f64 / 1024.0)
    }

    fn rough_rate_m_s(&self, row: usize) -> Option<f64> {
        present(self.rough_rate_m_s[row], 14).map(|rate| rate as f64)
    }
}

/// The fields of each signal, by cell.
struct CellData {
    fine_range: [i64; CELLS],
    fine_phase: [i64; CELLS],
    lock: [i64; CELLS],
    half_cycle: [i64; CELLS],
    cn0: [i64; CELLS],
    fine_rate: [i64; CELLS],
}

impl CellData {
    fn read(bits: &mut Bits<'_>, count: usize, kind: MsmKind) -> Self {
        let fields = kind.fields;
        Self {
            fine_range: column(bits, count, |bits| bits.signed(fields.range_bits)),
            fine_phase: column(bits, count, |bits| bits.signed(fields.phase_bits)),
            lock: column(bits, count, |bits| bits.unsigned(fields.lock_bits) as i64),
            half_cycle: column(bits, count, |bits| bits.unsigned(1) as i64),
            cn0: column(bits, count, |bits| bits.unsigned(fields.cn0_bits) as i64),
            fine_rate: if kind.has_rates {
                column(bits, count, |bits| bits.signed(RATE_BITS))
            } else {
                [i64::MIN; CELLS]
            },
        }
    }
}

/// Reads one field of all satellites or cells, which are consecutive.
fn column<const N: usize>(
    bits: &mut Bits<'_>,
    count: usize,
    read: impl Fn(&mut Bits<'_>) -> i64,
) -> [i64; N] {
    let mut values = [0; N];
    for value in &mut values[..count] {
        *value = read(bits);
    }
    values
}

/// The value of a field; `None` for the most negative one of its width.
const fn present(value: i64, width: u32) -> Option<i64> {
    if value == -1 << (width - 1) { None } else { Some(value) }
}

/// The data of a message while its observations are built.
struct Measurements<'a> {
    kind: MsmKind,
    satellites: &'a SatelliteData,
    cells: &'a CellData,
}

impl Measurements<'_> {
    /// The observation of a cell, without its loss of lock.
    fn observation(
        &self,
        (row, cell): (usize, usize),
        empty: Observation,
        frequency_hz: Option<f64>,
    ) -> Observation {
        let fields = self.kind.fields;
        let rough_ms = self.satellites.rough_range_ms(row);
        let fine_ms = |value, width, units| {
            present(value, width).and_then(|value| Some(rough_ms? + value as f64 / units))
        };
        let cells = self.cells;
        let range_ms = fine_ms(cells.fine_range[cell], fields.range_bits, fields.range_units);
        let phase_ms = fine_ms(cells.fine_phase[cell], fields.phase_bits, fields.phase_units);
        let cn0 = cells.cn0[cell];
        Observation {
            pseudorange_m: range_ms.map(|ms| ms * LIGHT_MILLISECOND_M),
            carrier_phase: phase_ms
                .zip(frequency_hz)
                .map(|(ms, hz)| Cycles(ms * LIGHT_MILLISECOND_M * hz / SPEED_OF_LIGHT)),
            doppler_hz: self
                .rate_m_s(row, cell)
                .zip(frequency_hz)
                .map(|(rate, hz)| -rate * hz / SPEED_OF_LIGHT),
            cn0_db_hz: (cn0 != 0).then_some(cn0 as f64 * fields.cn0_unit),
            ..empty
        }
    }

    fn rate_m_s(&self, row: usize, cell: usize) -> Option<f64> {
        if !self.kind.has_rates {
            return None;
        }
        let fine = present(self.cells.fine_rate[cell], RATE_BITS)?;
        Some(self.satellites.rough_rate_m_s(row)? + fine as f64 * FINE_RATE_M_S)
    }

    fn lock_time(&self, cell: usize) -> LockTime {
        let indicator = self.cells.lock[cell] as u64;
        match self.kind.fields.lock_bits {
            4 => LockTime::of_four_bits(indicator),
            _ => LockTime::of_ten_bits(indicator),
        }
    }
}

/// Decodes a message; `payload` includes the message number.
pub(super) fn decode(
    payload: &[u8],
    kind: MsmKind,
    clock: &Clock,
    memory: Memory<'_>,
    notes: Notes<'_>,
) -> Result<ObservationMessage, Refusal> {
    let mut bits = Bits::starting_at(payload, MESSAGE_BITS);
    let header = Header::read(&mut bits, kind.constellation, clock, memory.open_epoch)?;
    let masks = Masks::read(&mut bits)?;
    let satellites = SatelliteData::read(&mut bits, masks.rows, kind.has_rates);
    let cells = CellData::read(&mut bits, masks.cell_count, kind);
    bits.require_sound()?;
    let measurements = Measurements { kind, satellites: &satellites, cells: &cells };
    if kind.constellation == Constellation::Glonass {
        learn_channels(memory.channels, &masks, &satellites.extended);
    }
    let mut observations = Vec::with_capacity(masks.cell_count);
    for (index, cell) in masks.cells[..masks.cell_count].iter().enumerate() {
        let row = usize::from(cell.row);
        let number = masks.satellites[row];
        let signal = match known_signal(kind.constellation, number, cell.signal) {
            Ok(signal) => signal,
            Err(refusal) => {
                notes(refusal);
                continue;
            }
        };
        let empty = Observation::empty(signal.0, signal.1);
        let channel = memory.channels[usize::from(number) % SATELLITES];
        let frequency_hz = empty.signal().frequency_hz(channel);
        if frequency_hz.is_none() {
            notes(Refusal::UnknownChannel);
        }
        let mut observation = measurements.observation((row, index), empty, frequency_hz);
        if observation.carrier_phase.is_some() {
            let satellite = kind.constellation.index() * SATELLITES + usize::from(number) - 1;
            let slot = satellite * SIGNALS + usize::from(cell.signal) - 1;
            let lock = measurements.lock_time(index);
            observation.loss_of_lock = memory.locks.is_lost(slot, header.time, lock);
            observation.half_cycle = cells.half_cycle[index] == 1;
        }
        if !observation.is_empty() {
            observations.push(observation);
        }
    }
    let Header { station, time, more } = header;
    Ok(ObservationMessage { station, time, more, is_msm: true, observations })
}

/// State of the decoder between messages.
pub(super) struct Memory<'a> {
    pub(super) locks: &'a mut LockTable,
    pub(super) channels: &'a mut GlonassChannels,
    /// The epoch for which the last message announced more messages.
    pub(super) open_epoch: Option<GpsTime>,
}

fn learn_channels(channels: &mut GlonassChannels, masks: &Masks, extended: &[i64]) {
    for (&number, &channel) in masks.satellites[..masks.rows].iter().zip(extended) {
        if let (Some(known), 0..=13) = (channels.get_mut(usize::from(number)), channel) {
            *known = Some(channel as i8 - 7);
        }
    }
}

fn known_signal(
    constellation: Constellation,
    number: u8,
    signal: u8,
) -> Result<(SatelliteId, ObservationCode), Refusal> {
    let satellite = super::satellite(constellation, u64::from(number))?;
    let unknown = Refusal::UnknownSignal { constellation, index: signal };
    Ok((satellite, code(constellation, signal).ok_or(unknown)?))
}
