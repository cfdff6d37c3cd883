//! The fields of a navigation record.

use std::io::Read;

use crate::formats::rinex::RinexError;
use crate::formats::rinex::fields::{columns, date, decimal, integer, satellite};
use crate::formats::rinex::header_lines::FirstLine;
use crate::formats::rinex::lines::Lines;
use crate::gnss::CivilTime;

/// Number of lines of the longest record: CNAV-2 has ten.
const ROWS: usize = 10;
const VALUE_WIDTH: usize = 19;

/// The content of one field.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Field {
    Blank,
    Number(f64),
    Malformed,
}

/// One record; row 0 holds three numbers in columns 1 to 3, the others four.
#[derive(Debug)]
pub(super) struct Record {
    /// System letter; blank for an ionosphere record.
    pub(super) letter: u8,
    pub(super) number: u8,
    /// Date of the first line, if it has one.
    pub(super) civil: Option<CivilTime>,
    rows: [[Field; 4]; ROWS],
    row_count: usize,
}

impl Record {
    /// A number that must be present.
    pub(super) fn need(&self, row: usize, column: usize) -> Option<f64> {
        self.optional(row, column)?
    }

    /// A number that may be blank: `None` if malformed, `Some(None)` if blank.
    pub(super) fn optional(&self, row: usize, column: usize) -> Option<Option<f64>> {
        match self.rows[row][column] {
            Field::Blank => Some(None),
            Field::Number(value) => Some(Some(value)),
            Field::Malformed => None,
        }
    }

    /// A number; zero if blank.
    pub(super) fn or_zero(&self, row: usize, column: usize) -> Option<f64> {
        self.optional(row, column).map(|value| value.unwrap_or(0.0))
    }

    /// A count or bit field; zero if blank.
    pub(super) fn word(&self, row: usize, column: usize) -> Option<u32> {
        let value = self.or_zero(row, column)?;
        (0.0..=f64::from(u32::MAX)).contains(&value).then_some(value as u32)
    }

    /// Number of lines of the record.
    pub(super) const fn row_count(&self) -> usize {
        self.row_count
    }
}

/// Layout of the records of a file.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordLayout {
    rinex2: bool,
    /// System letter of a file of one system.
    system: u8,
}

impl RecordLayout {
    /// The layout that the first line of the file defines.
    pub(super) fn of(first: FirstLine, line: u64) -> Result<Self, RinexError> {
        let system = match (first.version.major, first.kind, first.system) {
            (2, b'N', system @ (b'E' | b'J' | b'C')) => system,
            (2, b'N', _) => b'G',
            (2, b'G', _) => b'R',
            (2, b'L', _) => b'E',
            (3.., b'N', system) => system,
            _ => {
                return Err(RinexError::WrongKind {
                    line,
                    found: format!("{:?}", char::from(first.kind)),
                    expected: "navigation",
                });
            }
        };
        Ok(Self { rinex2: first.version.major == 2, system })
    }

    const fn indent(self) -> usize {
        if self.rinex2 { 3 } else { 4 }
    }

    /// Parses the first line of a record.
    pub(super) fn parse_start(self, line: &[u8]) -> Option<Record> {
        if self.rinex2 { self.parse_start2(line) } else { self.parse_start3(line) }
    }

    /// ` 1 18  1  1  0  0  0.0-0.207438133657D-04…`; RINEX 2.11.
    fn parse_start2(self, line: &[u8]) -> Option<Record> {
        let number = u8::try_from(integer(columns(line, 0, 2))?).ok().filter(|n| 0 < *n)?;
        let fields =
            [(6, 8), (9, 11), (12, 14), (15, 17)].map(|(from, to)| columns(line, from, to));
        let civil = date(columns(line, 2, 5), fields, columns(line, 17, 22))?;
        Some(start(self.system, number, Some(civil), columns(line, 22, usize::MAX)))
    }

    /// `G01 2019 04 27 12 00 00-3.328546881676D-06…`; RINEX 3.05.
    fn parse_start3(self, line: &[u8]) -> Option<Record> {
        let (letter, number) = satellite(columns(line, 0, 3), self.system)?;
        let fields =
            [(9, 11), (12, 14), (15, 17), (18, 20)].map(|(from, to)| columns(line, from, to));
        let civil = date(columns(line, 4, 8), fields, columns(line, 21, 23))?;
        Some(start(letter, number, Some(civil), columns(line, 23, usize::MAX)))
    }

    /// First line of a version 4 record for no single satellite; its date is not used.
    pub(super) fn parse_undated(self, line: &[u8]) -> Record {
        start(b' ', 0, None, columns(line, 23, usize::MAX))
    }

    /// Reads the indented lines that follow the first one.
    pub(super) fn read_continuation<R: Read>(
        self,
        record: &mut Record,
        lines: &mut Lines<R>,
    ) -> Result<(), RinexError> {
        while let Some(line) = lines.next()? {
            if !self.is_continuation(line) {
                lines.unread();
                break;
            }
            if let Some(row) = record.rows.get_mut(record.row_count) {
                let values = columns(line, self.indent(), usize::MAX);
                fill_row(row, 0, values);
                record.row_count += 1;
            }
        }
        Ok(())
    }

    /// Skips the rest of a record whose first line cannot be read.
    pub(super) fn skip_continuation<R: Read>(self, lines: &mut Lines<R>) -> Result<(), RinexError> {
        while let Some(line) = lines.next()? {
            if !self.is_continuation(line) {
                lines.unread();
                break;
            }
        }
        Ok(())
    }

    fn is_continuation(self, line: &[u8]) -> bool {
        let (indent, rest) = line.split_at(self.indent().min(line.len()));
        indent.iter().all(|byte| *byte == b' ') && !rest.trim_ascii().is_empty()
    }
}

fn start(letter: u8, number: u8, civil: Option<CivilTime>, values: &[u8]) -> Record {
    let mut rows = [[Field::Blank; 4]; ROWS];
    fill_row(&mut rows[0], 1, values);
    Record { letter, number, civil, rows, row_count: 1 }
}

fn fill_row(row: &mut [Field; 4], first: usize, values: &[u8]) {
    for (field, text) in row[first..].iter_mut().zip(values.chunks(VALUE_WIDTH)) {
        *field = match decimal(text) {
            Some(None) => Field::Blank,
            Some(Some(value)) => Field::Number(value),
            None => Field::Malformed,
        };
    }
}
