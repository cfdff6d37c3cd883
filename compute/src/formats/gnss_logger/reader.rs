//! Reads files with a log epoch by epoch.

use std::collections::VecDeque;
use std::io::{self, BufRead};

use super::{Decoder, LogFileError, Skipped};
use crate::gnss::{Epoch, Navigation};

/// Reads the epochs of a file one by one; [`Decoder`] does the same with a stream.
#[derive(Debug)]
pub struct LogReader<R> {
    input: R,
    decoder: Decoder,
    epochs: VecDeque<Epoch>,
    has_epochs: bool,
    is_at_end: bool,
}

impl<R: BufRead> LogReader<R> {
    /// A reader at the file's start.
    pub fn new(input: R) -> Self {
        let (decoder, epochs) = (Decoder::new(), VecDeque::new());
        Self { input, decoder, epochs, has_epochs: false, is_at_end: false }
    }

    /// Adds known FDMA channels of GLONASS satellites.
    pub(crate) fn learn_channels(&mut self, navigation: &Navigation) {
        self.decoder.learn_channels(navigation);
    }

    /// Reads the next epoch into `epoch`; false at the end.
    ///
    /// # Errors
    /// The rest of the file cannot be read, or no measurement of the file is usable.
    pub fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, LogFileError> {
        let mut found = Vec::new();
        while self.epochs.is_empty() && !self.is_at_end {
            let line = self.decoder.lines();
            let bytes = match self.input.fill_buf() {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                bytes => bytes.map_err(|source| LogFileError::ReadFailed { line, source })?,
            };
            let length = bytes.len();
            if length == 0 {
                self.is_at_end = true;
                self.decoder.finish(&mut found)?;
            } else {
                self.decoder.push(bytes, &mut found)?;
                self.input.consume(length);
            }
            self.epochs.extend(found.drain(..));
        }
        match self.epochs.pop_front() {
            Some(read) => *epoch = read,
            None if self.has_epochs => return Ok(false),
            None => return Err(self.nothing_usable()),
        }
        self.has_epochs = true;
        Ok(true)
    }

    /// What was left out so far.
    pub const fn skipped(&self) -> &Skipped {
        self.decoder.skipped()
    }

    fn nothing_usable(&self) -> LogFileError {
        let most = self.skipped().entries().iter().max_by_key(|entry| entry.count);
        let why = most.map_or_else(String::new, |entry| {
            format!(", {} times: {} (first on line {})", entry.count, entry.reason, entry.lines[0])
        });
        LogFileError::NothingUsable { records: self.decoder.records(), why }
    }
}
