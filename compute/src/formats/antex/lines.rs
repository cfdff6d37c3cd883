//! The lines of an ANTEX file, with their columns and labels.

use std::io::{self, BufRead};

use super::AntexError;

const LABEL_COLUMN: usize = 60;
/// Longest line (bytes): 181 variations of eight columns, with room.
const LINE_LIMIT: usize = 4_096;

/// Reads the lines of a file one at a time.
pub(super) struct Lines<R> {
    input: R,
    bytes: Vec<u8>,
    /// The current line without its end; bytes that are not UTF-8 are replaced.
    line: String,
    number: u64,
}

impl<R: BufRead> Lines<R> {
    /// Before the first line.
    pub(super) const fn new(input: R) -> Self {
        Self { input, bytes: Vec::new(), line: String::new(), number: 0 }
    }

    /// Goes to the next line; `false` at the end of the file.
    pub(super) fn next(&mut self) -> Result<bool, AntexError> {
        self.bytes.clear();
        let mut limited = io::Read::take(&mut self.input, LINE_LIMIT as u64 + 1);
        let read = limited.read_until(b'\n', &mut self.bytes);
        read.map_err(|source| AntexError::Read { line: self.number, source })?;
        if self.bytes.is_empty() {
            return Ok(false);
        }
        self.number += 1;
        if LINE_LIMIT < self.bytes.len() {
            return Err(self.malformed("line", "it is longer than 4096 bytes"));
        }
        // Columns count bytes: other letters become question marks, one a byte.
        let ascii = self.bytes.iter().map(|b| if b.is_ascii() { char::from(*b) } else { '?' });
        self.line.clear();
        self.line.extend(ascii);
        let end = self.line.trim_end_matches(['\n', '\r']).len();
        self.line.truncate(end);
        Ok(true)
    }

    /// Goes to the next line inside a section.
    pub(super) fn next_of(&mut self, section: &'static str) -> Result<(), AntexError> {
        match self.next()? {
            true => Ok(()),
            false => Err(AntexError::Truncated { line: self.number, section }),
        }
    }

    /// Number of the current line, from 1.
    pub(super) const fn number(&self) -> u64 {
        self.number
    }

    /// The current line without blanks around.
    pub(super) fn text(&self) -> &str {
        self.line.trim()
    }

    pub(super) fn label(&self) -> &str {
        self.columns(LABEL_COLUMN, LABEL_COLUMN + 20)
    }

    /// Columns `from` … `to`, without blanks around.
    pub(super) fn columns(&self, from: usize, to: usize) -> &str {
        self.line.get(from..to.min(self.line.len())).unwrap_or("").trim()
    }

    pub(super) fn number_in(&self, from: usize, to: usize) -> Option<f64> {
        self.columns(from, to).parse().ok().filter(|number: &f64| number.is_finite())
    }

    pub(super) fn malformed(&self, label: &'static str, reason: &'static str) -> AntexError {
        AntexError::Malformed { line: self.number, label, reason }
    }

    pub(super) fn unexpected(&self) -> AntexError {
        let found = match self.label() {
            "" => self.line.trim(),
            label => label,
        };
        AntexError::Unexpected { line: self.number, found: found.chars().take(40).collect() }
    }
}
