//! CRINEX, Hatanaka's compact form of observation files, versions 1 (RINEX 2) and 3.
//!
//! An epoch is a line with all satellites, a line for the receiver clock, and one line per
//! satellite. Epoch lines and indicator columns are text differences: blank keeps a character, `&`
//! blanks it, others replace it. Numbers are in thousandths: `3&value` begins an arc of order 3;
//! the following fields are differences of rising order up to that of the arc.
//!
//! Source: Hatanaka (2008), *A compression format and tools for GNSS observation data*, Bulletin of
//! the Geographical Survey Institute 55.

use std::io::BufRead;

use super::columns::{ColumnTable, drop_empty, set_loss_of_lock, set_value};
use super::epoch2;
use super::epoch3::EpochLine;
use super::fields::columns;
use super::observation::{SATELLITES_LIMIT, SeenSatellites};
use super::{ObservationReader, RinexError, SkipReason};
use crate::gnss::{Constellation, Epoch, Observation, SatelliteId};

/// Highest order of differences in CRINEX.
const ORDER_LIMIT: usize = 9;
const SATELLITES_COLUMN_2: usize = 32;
const SATELLITES_COLUMN_3: usize = 41;
const NUMBERS: usize = 100;

/// The values that the differences refer to.
#[derive(Clone, Debug, Default)]
pub(super) struct CompactState {
    /// The complete epoch line; empty if the next one must be complete.
    epoch_line: Vec<u8>,
    /// Running number of the epoch.
    ordinal: u64,
    /// States by constellation and number.
    satellites: Vec<SatelliteState>,
}

#[derive(Clone, Debug, Default)]
struct SatelliteState {
    /// Running number of the last epoch with this satellite.
    ordinal: u64,
    arcs: Vec<Arc>,
    /// Loss-of-lock indicator and signal strength of each column.
    indicators: Vec<u8>,
}

/// The difference state of one column.
#[derive(Clone, Copy, Debug, Default)]
struct Arc {
    /// Order of the arc; `None` without an arc.
    order: Option<usize>,
    /// Highest order of differences so far.
    reached: usize,
    /// Value and its differences, in thousandths.
    differences: [i64; ORDER_LIMIT + 1],
}

/// The field does not continue its arc.
struct BrokenArc;

impl Arc {
    /// Applies a field and returns the value in thousandths; `None` for a missing value.
    fn advance(&mut self, field: &[u8]) -> Result<Option<i64>, BrokenArc> {
        if field.is_empty() {
            self.order = None;
            return Ok(None);
        }
        if let [order @ b'0'..=b'9', b'&', value @ ..] = field {
            *self = Self { order: Some(usize::from(order - b'0')), ..Self::default() };
            self.differences[0] = self.integer(value)?;
            return Ok(Some(self.differences[0]));
        }
        let order = self.order.ok_or(BrokenArc)?;
        self.reached = order.min(self.reached + 1);
        self.differences[self.reached] = self.integer(field)?;
        for lower in (0..self.reached).rev() {
            let sum = self.differences[lower].checked_add(self.differences[lower + 1]);
            let Some(sum) = sum else {
                self.order = None;
                return Err(BrokenArc);
            };
            self.differences[lower] = sum;
        }
        Ok(Some(self.differences[0]))
    }

    /// Parses a whole number of up to 18 digits; anything else ends the arc.
    fn integer(&mut self, text: &[u8]) -> Result<i64, BrokenArc> {
        let digits = text.strip_prefix(b"-").unwrap_or(text);
        if digits.is_empty() || 18 < digits.len() || !digits.iter().all(u8::is_ascii_digit) {
            self.order = None;
            return Err(BrokenArc);
        }
        let magnitude = digits.iter().fold(0, |sum, digit| sum * 10 + i64::from(digit - b'0'));
        Ok(if digits.len() < text.len() { -magnitude } else { magnitude })
    }
}

/// Applies a text difference.
fn apply_difference(text: &mut Vec<u8>, difference: &[u8]) {
    if text.len() < difference.len() {
        text.resize(difference.len(), b' ');
    }
    for (old, new) in text.iter_mut().zip(difference) {
        match new {
            b' ' => {}
            b'&' => *old = b' ',
            _ => *old = *new,
        }
    }
}

/// Whether the line is a complete epoch line.
fn is_full(line: &[u8]) -> bool {
    matches!(line.first(), Some(b'&' | b'>'))
}

impl<R: BufRead> ObservationReader<R> {
    pub(super) fn read_compact_epoch(
        &mut self,
        state: &mut CompactState,
        epoch: &mut Epoch,
    ) -> Result<bool, RinexError> {
        loop {
            let Some(line) = self.lines.next()? else { return Ok(false) };
            if line.is_empty() && state.epoch_line.is_empty() {
                continue;
            }
            let Some(head) = self.compact_epoch_line(state) else {
                self.skip_compact(state)?;
                continue;
            };
            if 2 <= head.flag {
                self.read_event(head.flag, head.count, is_full)?;
                state.epoch_line.clear();
                continue;
            }
            let time = head.civil.and_then(|civil| self.gps_time(&civil));
            let (Some(time), true) = (time, head.count <= SATELLITES_LIMIT) else {
                self.skip_compact(state)?;
                continue;
            };
            epoch.time = time;
            epoch.power_failure = head.flag == 1;
            // The receiver clock is not used.
            if self.lines.next()?.is_none()
                || !self.read_compact_satellites(state, head.count, epoch)?
            {
                self.note(SkipReason::TruncatedEpoch);
                return Ok(false);
            }
            return Ok(true);
        }
    }

    /// The complete epoch line that corresponds to the line last read.
    fn compact_epoch_line(&self, state: &mut CompactState) -> Option<EpochLine> {
        let line = self.lines.current();
        let rinex2 = self.state.header.version.major == 2;
        if is_full(line) {
            state.epoch_line.clear();
            state.epoch_line.extend_from_slice(line);
            if rinex2 {
                state.epoch_line[0] = b' ';
            }
        } else if state.epoch_line.is_empty() {
            return None;
        } else {
            apply_difference(&mut state.epoch_line, line);
        }
        if rinex2 {
            epoch2::parse_epoch_line(&state.epoch_line)
        } else {
            EpochLine::parse(&state.epoch_line)
        }
    }

    /// Skips lines up to the next complete epoch line.
    fn skip_compact(&mut self, state: &mut CompactState) -> Result<(), RinexError> {
        self.note(SkipReason::BrokenDifferences);
        state.epoch_line.clear();
        while let Some(line) = self.lines.next()? {
            if is_full(line) {
                self.lines.unread();
                break;
            }
        }
        Ok(())
    }

    /// Reads one line per satellite; `false` if the file ends before.
    fn read_compact_satellites(
        &mut self,
        state: &mut CompactState,
        count: usize,
        epoch: &mut Epoch,
    ) -> Result<bool, RinexError> {
        epoch.observations.clear();
        self.seen = SeenSatellites::default();
        state.ordinal += 1;
        let rinex2 = self.state.header.version.major == 2;
        let first = if rinex2 { SATELLITES_COLUMN_2 } else { SATELLITES_COLUMN_3 };
        for index in 0..count {
            if self.lines.next()?.is_none() {
                return Ok(false);
            }
            let from = first + index * 3;
            let mut field = [b' '; 3];
            field
                .iter_mut()
                .zip(columns(&state.epoch_line, from, from + 3))
                .for_each(|(to, b)| *to = *b);
            if let Some(satellite) = self.decoded_satellite(&field) {
                self.read_compact_satellite(state, satellite, epoch);
            }
        }
        Ok(true)
    }

    fn read_compact_satellite(
        &mut self,
        state: &mut CompactState,
        satellite: SatelliteId,
        epoch: &mut Epoch,
    ) {
        let Some(table) = &self.tables[satellite.constellation.index()] else { return };
        let ordinal = state.ordinal;
        let differences = state.of(satellite, table);
        differences.ordinal = ordinal;
        let start = epoch.observations.len();
        epoch.observations.extend(table.codes.iter().map(|c| Observation::empty(satellite, *c)));
        let slots = &mut epoch.observations[start..];
        let broken = differences.advance(self.lines.current(), table, slots);
        table.hand_over(slots);
        self.state.mark_half_cycles(satellite, slots);
        drop_empty(&mut epoch.observations, start);
        for _ in 0..broken {
            self.note(SkipReason::BrokenDifferences);
        }
    }
}

impl CompactState {
    /// The difference state of a satellite, empty if it was not in the previous epoch.
    fn of(&mut self, satellite: SatelliteId, table: &ColumnTable) -> &mut SatelliteState {
        if self.satellites.is_empty() {
            self.satellites = vec![SatelliteState::default(); Constellation::COUNT * NUMBERS];
        }
        let index = satellite.constellation.index() * NUMBERS + usize::from(satellite.number);
        let state = &mut self.satellites[index];
        let width = table.columns.len();
        if state.ordinal + 1 < self.ordinal || state.arcs.len() != width {
            state.arcs.clear();
            state.arcs.resize(width, Arc::default());
            state.indicators.clear();
            state.indicators.resize(2 * width, b' ');
        }
        state
    }
}

impl SatelliteState {
    /// Applies a line and fills the slots; returns the number of invalid fields.
    fn advance(&mut self, line: &[u8], table: &ColumnTable, slots: &mut [Observation]) -> usize {
        let mut rest = line;
        let mut broken = 0;
        for (column, arc) in table.columns.iter().zip(&mut self.arcs) {
            let end = memchr::memchr(b' ', rest).unwrap_or(rest.len());
            let (field, behind) = rest.split_at(end);
            rest = behind.get(1..).unwrap_or(&[]);
            match arc.advance(field) {
                Ok(Some(thousandths)) if thousandths != 0 => {
                    set_value(column, Some(thousandths as f64 / 1000.0), slots);
                }
                Ok(_) => {}
                Err(BrokenArc) => broken += 1,
            }
        }
        let width = self.indicators.len();
        apply_difference(&mut self.indicators, columns(rest, 0, width));
        for (column, indicators) in table.columns.iter().zip(self.indicators.chunks_exact(2)) {
            set_loss_of_lock(column, indicators[0], slots);
        }
        broken
    }
}
