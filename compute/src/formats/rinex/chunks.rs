//! Observation files that arrive in chunks of any size.

use std::io::{self, BufRead, ErrorKind, Read};
use std::sync::Arc;

use super::{ObservationReader, RinexError, Skipped};
use crate::gnss::Epoch;

/// Longest accepted header (bytes).
const HEADER_LIMIT: usize = 1 << 16;

/// Reads a file as it arrives. Incomplete records wait for the chunks that follow.
#[derive(Debug, Default)]
pub struct ChunkReader {
    /// The reader, once the header is complete.
    reader: Option<Box<ObservationReader<Arrived>>>,
    /// The bytes of the header while it is incomplete.
    head: Vec<u8>,
    header_bytes: usize,
}

impl ChunkReader {
    /// Appends bytes.
    ///
    /// # Errors
    /// The header cannot be read.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), RinexError> {
        if let Some(reader) = &mut self.reader {
            reader.lines.input_mut().extend(bytes);
            return Ok(());
        }
        self.head.extend_from_slice(bytes);
        if !bytes.contains(&b'\n') && self.head.len() <= HEADER_LIMIT {
            return Ok(());
        }
        match ObservationReader::new(Arrived::new(&self.head)) {
            Ok(reader) => {
                self.header_bytes = self.head.len() - untaken(&reader);
                self.reader = Some(Box::new(reader));
                self.head = Vec::new();
                Ok(())
            }
            Err(error) if is_waiting(&error) && self.head.len() <= HEADER_LIMIT => Ok(()),
            Err(error) if is_waiting(&error) => Err(RinexError::Truncated { line: error.line() }),
            Err(error) => Err(error),
        }
    }

    /// Ends the file: incomplete records are used as they are.
    pub fn finish(&mut self) {
        if let Some(reader) = &mut self.reader {
            reader.lines.input_mut().is_end = true;
        }
    }

    /// Reads the next epoch into `epoch`; `false` if it has not arrived completely.
    ///
    /// # Errors
    /// As [`ObservationReader::read_epoch`], and observation types that change inside the file: a
    /// reader that resumes later knows the header only.
    pub fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, RinexError> {
        let Some(reader) = &mut self.reader else { return Ok(false) };
        // Discarded if the bytes end inside the epoch.
        let mut attempt = reader.clone();
        match attempt.read_epoch(epoch) {
            Ok(is_read) => {
                if attempt.state.layout() != reader.state.layout() {
                    return Err(attempt.state.changed_inside(attempt.lines.number()));
                }
                *reader = attempt;
                Ok(is_read)
            }
            Err(error) if is_waiting(&error) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Length of the header (bytes); zero before it is complete.
    pub(crate) const fn header_bytes(&self) -> usize {
        self.header_bytes
    }

    /// Whether the file is CRINEX, in which an epoch depends on all previous ones.
    pub(crate) fn is_compact(&self) -> bool {
        self.reader.as_ref().is_some_and(|reader| reader.is_compact())
    }

    /// Number of bytes at the end that belong to no epoch yet.
    pub(crate) fn untaken_bytes(&self) -> usize {
        self.reader.as_ref().map_or(self.head.len(), |reader| untaken(reader))
    }

    /// What was left out since the last call.
    pub(crate) fn take_skipped(&mut self) -> Skipped {
        self.reader.as_mut().map(|r| std::mem::take(&mut r.skipped)).unwrap_or_default()
    }
}

fn untaken(reader: &ObservationReader<Arrived>) -> usize {
    reader.lines.untaken() + reader.lines.input().rest()
}

/// Whether a reader stopped because bytes are missing that may still arrive.
fn is_waiting(error: &RinexError) -> bool {
    matches!(error, RinexError::ReadFailed { source, .. } if source.kind() == ErrorKind::WouldBlock)
}

/// The bytes that have arrived. Clones share them and have their own position.
#[derive(Clone, Debug)]
pub(super) struct Arrived {
    bytes: Arc<[u8]>,
    at: usize,
    is_end: bool,
}

impl Arrived {
    fn new(bytes: &[u8]) -> Self {
        Self { bytes: bytes.into(), at: 0, is_end: false }
    }

    fn extend(&mut self, bytes: &[u8]) {
        self.bytes = [&self.bytes[self.at..], bytes].concat().into();
        self.at = 0;
    }

    fn rest(&self) -> usize {
        self.bytes.len() - self.at
    }
}

impl BufRead for Arrived {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        match &self.bytes[self.at..] {
            [] if !self.is_end => Err(ErrorKind::WouldBlock.into()),
            rest => Ok(rest),
        }
    }

    fn consume(&mut self, amount: usize) {
        self.at += amount;
    }
}

impl Read for Arrived {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let rest = self.fill_buf()?;
        let length = rest.len().min(buffer.len());
        buffer[..length].copy_from_slice(&rest[..length]);
        self.consume(length);
        Ok(length)
    }
}
