//! Maps the columns of observation records to observations.
//!
//! RINEX 2 types name band and quantity but not always the tracking. Each gets its most likely
//! RINEX 3 code (RINEX 2.11 and 3.05):
//! | type | GPS | GLONASS | Galileo | BeiDou | QZSS |
//! |---|---|---|---|---|---|
//! | C1 | 1C | 1C | 1X | 2I | 1C |
//! | P1 | 1W | 1P | – | – | – |
//! | C2 | 2X | 2C | – | 2I | 2X |
//! | P2 | 2W | 2P | – | – | – |
//! | C5 | 5X | – | 5X | 5X | 5X |
//! | C6, C7, C8 | – | – | 6X, 7X, 8X | 6I, 7I, – | 6X, –, – |
//!
//! P1 and P2 of GPS become semi-codeless W, not P: anti-spoofing has been on since 1994. A phase,
//! Doppler or C/N0 (L1, D1, S1) belongs to a pseudorange of its band. On band 1 that is C1 if
//! declared, else P1. On band 2 it is P2, else C2, since the format was made when P(Y) was the only
//! carrier there. If the preferred pseudorange is blank in a record and the other is not, the phase
//! belongs to the other. BeiDou's B1I is in band 1 or 2, by the program that wrote the file: where
//! both are declared, it is the number that is not blank.

use super::RinexVersion;
use super::fields::{Value, observation_value};
use crate::gnss::{Constellation, Cycles, Observation, ObservationCode};

/// Width of an observation: F14.3, loss-of-lock indicator, signal strength.
const FIELD_WIDTH: usize = 16;
const NUMBER_WIDTH: usize = 14;

/// The quantity of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quantity {
    Ignored,
    Pseudorange,
    CarrierPhase,
    Doppler,
    Cn0,
}

impl Quantity {
    const fn from_letter(letter: u8) -> Self {
        match letter {
            b'C' | b'P' => Self::Pseudorange,
            b'L' => Self::CarrierPhase,
            b'D' => Self::Doppler,
            b'S' => Self::Cn0,
            _ => Self::Ignored,
        }
    }
}

/// What the digits of a phase's loss-of-lock indicator mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Indicator {
    /// Bit 0 is loss of lock, bit 1 half-cycle ambiguity (RINEX 3.05).
    #[default]
    Rinex,
    /// Loss of lock, plus 3 for half-cycle ambiguity: RTKLIB's convbin 2.4 writes it of RTCM 3.
    Convbin,
}

impl Indicator {
    /// Loss of lock, and half-cycle ambiguity, by a digit.
    const fn flags(self, digit: u8) -> (bool, bool) {
        match (self, digit) {
            (Self::Convbin, b'3') => (false, true),
            (Self::Convbin, b'4') => (true, true),
            _ => (digit & 1 != 0, digit & 2 != 0),
        }
    }
}

/// The destination of a column's number.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    quantity: Quantity,
    indicator: Indicator,
    /// Index into the table's codes.
    slot: u8,
    /// Divisor from `SYS / SCALE FACTOR`.
    divisor: f64,
}

/// A scale factor of some types of a constellation, or of all if the list is empty.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ScaleFactor {
    pub(super) constellation: Constellation,
    pub(super) divisor: f64,
    pub(super) types: Vec<[u8; 3]>,
}

/// The columns of one constellation's records.
#[derive(Clone, Debug, Default)]
pub(super) struct ColumnTable {
    pub(super) codes: Vec<ObservationCode>,
    pub(super) columns: Vec<Column>,
    /// Slots (preferred, other) of one band: RINEX 2 phases move to the pseudorange that is
    /// present.
    handovers: Vec<(u8, u8)>,
    /// Types that are unknown or repeated.
    pub(super) unknown_types: usize,
}

impl ColumnTable {
    /// The table of RINEX 3 or 4 types such as `C1C`.
    pub(super) fn of_rinex3(
        constellation: Constellation,
        version: RinexVersion,
        types: &[[u8; 3]],
        scales: &[ScaleFactor],
    ) -> Self {
        let mut table = Self::default();
        for kind in types {
            let code = rinex3_code(constellation, version, kind);
            let divisor = scales
                .iter()
                .filter(|s| s.constellation == constellation)
                .filter(|s| s.types.is_empty() || s.types.contains(kind))
                .fold(1.0, |_, s| s.divisor);
            table.push(Quantity::from_letter(kind[0]), code, divisor);
        }
        table
    }

    /// The table of RINEX 2 types such as `P2`.
    pub(super) fn of_rinex2(constellation: Constellation, types: &[[u8; 2]]) -> Self {
        let mut table = Self::default();
        for &[letter, band] in types {
            let [preferred, other] = rinex2_pseudoranges(constellation, band);
            let declared = |kind: &Option<([u8; 2], ObservationCode)>| {
                kind.is_some_and(|(name, _)| types.contains(&name))
            };
            let code = match letter {
                b'C' | b'P' => [preferred, other].into_iter().flatten().find(|k| k.0[0] == letter),
                b'L' | b'D' | b'S' => {
                    [preferred, other].into_iter().find(declared).unwrap_or(preferred)
                }
                _ => None,
            };
            let may_share = constellation == Constellation::BeiDou;
            let code = code.map(|(_, code)| code);
            table.push_column(Quantity::from_letter(letter), code, 1.0, may_share);
        }
        table.find_handovers(constellation);
        table
    }

    fn push(&mut self, quantity: Quantity, code: Option<ObservationCode>, divisor: f64) {
        self.push_column(quantity, code, divisor, false);
    }

    /// Adds a column. With `may_share` it may be the second one of its signal.
    fn push_column(
        &mut self,
        quantity: Quantity,
        code: Option<ObservationCode>,
        divisor: f64,
        may_share: bool,
    ) {
        let indicator = Indicator::Rinex;
        let code = code.filter(|_| quantity != Quantity::Ignored);
        let slot = code.map(|code| self.slot(code));
        let taken = |slot| self.columns.iter().any(|c| (c.quantity, c.slot) == (quantity, slot));
        let column = match slot {
            Some(slot) if may_share || !taken(slot) => {
                Column { quantity, indicator, slot, divisor }
            }
            _ => {
                self.unknown_types += 1;
                Column { quantity: Quantity::Ignored, indicator, slot: 0, divisor }
            }
        };
        self.columns.push(column);
    }

    fn slot(&mut self, code: ObservationCode) -> u8 {
        let known = self.codes.iter().position(|c| *c == code);
        let index = known.unwrap_or_else(|| {
            self.codes.push(code);
            self.codes.len() - 1
        });
        u8::try_from(index).expect("nine bands of 26 attributes are 234 codes")
    }

    fn find_handovers(&mut self, constellation: Constellation) {
        for band in b'1'..=b'2' {
            if let [Some((_, a)), Some((_, b))] = rinex2_pseudoranges(constellation, band) {
                let slot_of = |code| self.codes.iter().position(|c| *c == code).map(|i| i as u8);
                if let (Some(a), Some(b)) = (slot_of(a), slot_of(b)) {
                    self.handovers.push((a, b));
                }
            }
        }
    }

    /// The same columns with another meaning of the loss-of-lock indicators.
    pub(super) fn with_indicator(mut self, indicator: Indicator) -> Self {
        self.columns.iter_mut().for_each(|column| column.indicator = indicator);
        self
    }

    /// Moves phase, Doppler and C/N0 to the pseudorange of their band that is present.
    pub(super) fn hand_over(&self, slots: &mut [Observation]) {
        for &(preferred, other) in &self.handovers {
            let from = slots[usize::from(preferred)];
            let to = &mut slots[usize::from(other)];
            if from.pseudorange_m.is_none() && to.pseudorange_m.is_some() {
                *to = Observation { code: to.code, pseudorange_m: to.pseudorange_m, ..from };
                let emptied = &mut slots[usize::from(preferred)];
                *emptied = Observation::empty(emptied.satellite, emptied.code);
            }
        }
    }
}

/// The code of a RINEX 3 type. BeiDou B1I was called band 1 in version 3.02 (RINEX 3.05).
fn rinex3_code(
    constellation: Constellation,
    version: RinexVersion,
    kind: &[u8; 3],
) -> Option<ObservationCode> {
    let [_, band, attribute] = *kind;
    let renamed = match (constellation, band, attribute) {
        (Constellation::BeiDou, b'1', b'I' | b'Q') => b'2',
        (Constellation::BeiDou, b'1', b'X') if version < RinexVersion::new(3, 3) => b'2',
        _ => band,
    };
    ObservationCode::new(renamed, attribute)
}

/// The pseudoranges of a band in RINEX 2, first the one that the phase belongs to.
fn rinex2_pseudoranges(
    constellation: Constellation,
    band: u8,
) -> [Option<([u8; 2], ObservationCode)>; 2] {
    use Constellation as C;
    let kinds: [Option<(&[u8; 2], [u8; 2])>; 2] = match (constellation, band) {
        (C::Gps, b'1') => [Some((b"C1", *b"1C")), Some((b"P1", *b"1W"))],
        (C::Gps, b'2') => [Some((b"P2", *b"2W")), Some((b"C2", *b"2X"))],
        (C::Glonass, b'1') => [Some((b"C1", *b"1C")), Some((b"P1", *b"1P"))],
        (C::Glonass, b'2') => [Some((b"P2", *b"2P")), Some((b"C2", *b"2C"))],
        (C::Qzss, b'1') => [Some((b"C1", *b"1C")), None],
        (C::Qzss, b'2') => [Some((b"C2", *b"2X")), None],
        (C::Qzss, b'6') => [Some((b"C6", *b"6X")), None],
        (C::Galileo, b'1') => [Some((b"C1", *b"1X")), None],
        (C::Galileo, b'6') => [Some((b"C6", *b"6X")), None],
        (C::Galileo, b'7') => [Some((b"C7", *b"7X")), None],
        (C::Galileo, b'8') => [Some((b"C8", *b"8X")), None],
        (C::BeiDou, b'1') => [Some((b"C1", *b"2I")), None],
        (C::BeiDou, b'2') => [Some((b"C2", *b"2I")), None],
        (C::BeiDou, b'6') => [Some((b"C6", *b"6I")), None],
        (C::BeiDou, b'7') => [Some((b"C7", *b"7I")), None],
        (C::Gps | C::Qzss | C::Galileo | C::BeiDou, b'5') => [Some((b"C5", *b"5X")), None],
        _ => [None, None],
    };
    kinds.map(|kind| kind.and_then(|(name, [b, a])| Some((*name, ObservationCode::new(b, a)?))))
}

/// Stores the fields of a line in their slots; returns whether each was a number or blank.
pub(super) fn fill(columns: &[Column], mut fields: &[u8], slots: &mut [Observation]) -> bool {
    let mut sound = true;
    for column in columns {
        let mut padded = [b' '; FIELD_WIDTH];
        let field = match fields.split_first_chunk::<FIELD_WIDTH>() {
            Some((field, rest)) => {
                fields = rest;
                field
            }
            None if fields.is_empty() => break,
            None => {
                padded[..fields.len()].copy_from_slice(fields);
                // A truncated number would be read as another number.
                let cut = fields.len() < NUMBER_WIDTH && !fields.trim_ascii().is_empty();
                sound &= !cut;
                if cut {
                    break;
                }
                fields = &[];
                &padded
            }
        };
        if column.quantity == Quantity::Ignored {
            continue;
        }
        match observation_value(field) {
            Value::Number(value) => set_value(column, value, slots),
            Value::Missing => {}
            Value::Malformed => {
                sound = false;
                continue;
            }
        }
        set_loss_of_lock(column, field[NUMBER_WIDTH], slots);
    }
    sound
}

/// Stores a number in its slot.
#[inline]
pub(super) fn set_value(column: &Column, value: f64, slots: &mut [Observation]) {
    let Some(slot) = slots.get_mut(usize::from(column.slot)) else { return };
    let value = if column.divisor == 1.0 { value } else { value / column.divisor };
    match column.quantity {
        Quantity::Ignored => {}
        Quantity::Pseudorange => slot.pseudorange_m = Some(value),
        Quantity::CarrierPhase => slot.carrier_phase = Some(Cycles(value)),
        Quantity::Doppler => slot.doppler_hz = Some(value),
        Quantity::Cn0 => slot.cn0_db_hz = Some(value),
    }
}

/// Stores the loss-of-lock indicator of a carrier phase; those of other quantities are unused.
#[inline]
pub(super) fn set_loss_of_lock(column: &Column, lli: u8, slots: &mut [Observation]) {
    if column.quantity == Quantity::CarrierPhase && lli.is_ascii_digit() {
        let Some(slot) = slots.get_mut(usize::from(column.slot)) else { return };
        (slot.loss_of_lock, slot.half_cycle) = column.indicator.flags(lli);
    }
}

/// Removes empty observations from `start` on, keeping the order.
pub(super) fn drop_empty(observations: &mut Vec<Observation>, start: usize) {
    let mut kept = start;
    for index in start..observations.len() {
        if !observations[index].is_empty() {
            if kept < index {
                observations[kept] = observations[index];
            }
            kept += 1;
        }
    }
    observations.truncate(kept);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::SatelliteId;

    /// B1I is in band 1 or 2, and the columns of the other band are blank.
    #[test]
    fn beidou_has_its_numbers_in_either_band() {
        let types = [*b"C1", *b"L1", *b"S1", *b"C2", *b"L2", *b"S2"];
        let table = ColumnTable::of_rinex2(Constellation::BeiDou, &types);
        let field = |number: &str, lli: &str| format!("{number:>14}{lli:>1} ");
        let numbers = ["36000000.123", "187000000.456", "45.000"];
        let written = [field(numbers[0], ""), field(numbers[1], "1"), field(numbers[2], "")];
        let blank = " ".repeat(3 * FIELD_WIDTH);
        for line in [written.concat() + &blank, blank.clone() + &written.concat()] {
            let satellite = SatelliteId::new(Constellation::BeiDou, 1).unwrap();
            let mut slots = [Observation::empty(satellite, table.codes[0])];
            assert!(fill(&table.columns, line.as_bytes(), &mut slots));
            let [found] = slots;
            assert_eq!(found.code, ObservationCode::parse("2I").unwrap());
            assert_eq!(found.pseudorange_m, Some(36_000_000.123));
            assert_eq!(found.carrier_phase, Some(Cycles(187_000_000.456)));
            assert_eq!((found.cn0_db_hz, found.loss_of_lock), (Some(45.0), true));
        }
        assert_eq!((table.codes.len(), table.unknown_types), (1, 0));
    }
}
