//! Reads files of receivers' raw bytes epoch by epoch.

use std::collections::VecDeque;
use std::io::{self, BufRead};

use crate::gnss::{Epoch, Navigation};

use super::stream::{Decoder, Event};
use super::{Station, Statistics, TimeReference};

/// Why the rest of a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReceiverError {
    /// The bytes cannot be read or inflated.
    #[error("byte {offset}: reading failed: {source}")]
    ReadFailed {
        /// Number of bytes read before.
        offset: u64,
        /// Error of the input.
        source: io::Error,
    },
}

/// Reads the events of a file one by one; [`Decoder`] does the same with a stream.
#[derive(Debug)]
pub struct ReceiverReader<R> {
    input: R,
    decoder: Decoder,
    events: VecDeque<Event>,
    offset: u64,
    is_at_end: bool,
    station: Option<Station>,
}

impl<R: BufRead> ReceiverReader<R> {
    /// A reader at the file's start; see [`Decoder::new`].
    pub(crate) fn new(input: R, reference: Option<TimeReference>) -> Self {
        let decoder = Decoder::new(reference);
        let events = VecDeque::new();
        Self { input, decoder, events, offset: 0, is_at_end: false, station: None }
    }

    /// Adds known FDMA channels of GLONASS satellites; see [`Decoder::learn_channels`].
    pub(crate) fn learn_channels(&mut self, navigation: &Navigation) {
        self.decoder.learn_channels(navigation);
    }

    /// The next event; `None` at the end.
    ///
    /// # Errors
    /// The bytes cannot be read. Their content is never an error.
    pub(crate) fn read_event(&mut self) -> Result<Option<Event>, ReceiverError> {
        let mut found = Vec::new();
        while self.events.is_empty() && !self.is_at_end {
            let offset = self.offset;
            let bytes = match self.input.fill_buf() {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                bytes => bytes.map_err(|source| ReceiverError::ReadFailed { offset, source })?,
            };
            let length = bytes.len();
            if length == 0 {
                self.is_at_end = true;
                self.decoder.finish(&mut found);
            } else {
                self.decoder.push(bytes, &mut found);
                self.input.consume(length);
                self.offset += length as u64;
            }
            self.events.extend(found.drain(..));
        }
        let event = self.events.pop_front();
        if let Some(Event::Station(station)) = &event {
            self.station = Some(station.clone());
        }
        Ok(event)
    }

    /// Reads the next epoch into `epoch` and skips other events; false at the end.
    ///
    /// # Errors
    /// As `read_event`.
    pub(crate) fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, ReceiverError> {
        while let Some(event) = self.read_event()? {
            if let Event::Epoch(read) = event {
                *epoch = read;
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The station as described by the events read so far.
    pub(crate) const fn station(&self) -> Option<&Station> {
        self.station.as_ref()
    }

    /// Counts of what was read so far.
    pub(crate) const fn statistics(&self) -> &Statistics {
        self.decoder.statistics()
    }

    /// The decoder with its present state.
    pub(crate) const fn decoder(&self) -> &Decoder {
        &self.decoder
    }
}
