//! The differences of CRINEX, and the values that they refer to.
//!
//! Epoch lines and indicator columns are text differences: blank keeps a character, `&` blanks it,
//! others replace it. Numbers are in thousandths: `3&value` begins an arc of order 3; the following
//! fields are differences of rising order up to that of the arc.
//!
//! Source: Hatanaka (2008), *A compression format and tools for GNSS observation data*, Bulletin of
//! the Geographical Survey Institute 55.

use super::columns::{ColumnTable, set_loss_of_lock, set_value};
use super::fields::columns;
use crate::gnss::{Constellation, Observation, SatelliteId};

/// Highest order of differences in CRINEX.
const ORDER_LIMIT: usize = 9;
/// Satellite numbers of a constellation.
const NUMBERS: usize = 100;

/// The values that the differences refer to.
#[derive(Clone, Debug, Default)]
pub(super) struct CompactState {
    /// The complete epoch line; empty if the next one must be complete.
    pub(super) epoch_line: Vec<u8>,
    /// Running number of the epoch.
    pub(super) ordinal: u64,
    /// States by constellation and number.
    satellites: Vec<SatelliteState>,
}

/// The difference state of one satellite.
#[derive(Clone, Debug, Default)]
pub(super) struct SatelliteState {
    /// Running number of the last epoch with this satellite.
    pub(super) ordinal: u64,
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
pub(super) fn apply_difference(text: &mut Vec<u8>, difference: &[u8]) {
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

impl CompactState {
    /// The difference state of a satellite, empty if it was not in the previous epoch.
    pub(super) fn of(
        &mut self,
        satellite: SatelliteId,
        table: &ColumnTable,
    ) -> &mut SatelliteState {
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
    pub(super) fn advance(
        &mut self,
        line: &[u8],
        table: &ColumnTable,
        slots: &mut [Observation],
    ) -> usize {
        let mut rest = line;
        let mut broken = 0;
        for (column, arc) in table.columns.iter().zip(&mut self.arcs) {
            let end = memchr::memchr(b' ', rest).unwrap_or(rest.len());
            let (field, behind) = rest.split_at(end);
            rest = behind.get(1..).unwrap_or(&[]);
            match arc.advance(field) {
                Ok(Some(thousandths)) if thousandths != 0 => {
                    set_value(column, thousandths as f64 / 1000.0, slots);
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
