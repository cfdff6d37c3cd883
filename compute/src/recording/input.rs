//! The bytes of one file of a recording.

use std::fmt;
use std::io::{self, BufRead, Cursor};
use std::sync::Arc;

use crate::formats::decompress;
use crate::formats::observations::{FileError, FileFormat, Observations, Recognised};
use crate::formats::receiver::TimeReference;
use crate::gnss::Navigation;

use super::RecordingError;

/// A reader of one file's bytes.
pub(super) type Reader = Box<dyn BufRead>;

/// A file of a recording: its name for messages, and a way to read it from its first byte.
pub struct Input {
    name: String,
    open: Box<dyn Fn() -> io::Result<Reader>>,
    is_unpacked: bool,
}

impl Input {
    /// An input that `open` opens, at its first byte each time.
    pub fn new(name: String, open: impl Fn() -> io::Result<Reader> + 'static) -> Self {
        Self { name, open: Box::new(open), is_unpacked: false }
    }

    /// The same of bytes that `open` has unpacked, if they were gzip.
    pub fn unpacked(name: String, open: impl Fn() -> io::Result<Reader> + 'static) -> Self {
        Self { name, open: Box::new(open), is_unpacked: true }
    }

    /// Bytes in memory.
    pub fn from_bytes(name: String, bytes: Arc<[u8]>) -> Self {
        Self::new(name, move || Ok(Box::new(Cursor::new(bytes.clone()))))
    }

    /// The name, for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Opens it, and unpacks gzip.
    ///
    /// # Errors
    /// It cannot be opened.
    pub fn open(&self) -> Result<Reader, RecordingError> {
        let opened = (self.open)();
        let reader = opened.map_err(|source| {
            let name = self.name.clone();
            RecordingError::NotReadable { name, source }
        })?;
        Ok(if self.is_unpacked { reader } else { Box::new(decompress(reader)) })
    }

    /// Its format.
    ///
    /// # Errors
    /// It cannot be opened.
    pub fn format(&self) -> Result<FileFormat, RecordingError> {
        Ok(self.recognised()?.format())
    }

    /// Opens it and recognises its format.
    pub(super) fn recognised(&self) -> Result<Recognised<Reader>, RecordingError> {
        self.open().map(Recognised::new)
    }

    /// Opens it, and its observations.
    pub(super) fn observations(
        &self,
        reference: Option<TimeReference>,
        navigation: &Navigation,
    ) -> Result<Observations<Reader>, RecordingError> {
        let remedy = "name a RINEX observation file, UBX or RTCM 3 data, or a GnssLogger log";
        Observations::new(self.recognised()?, reference, navigation)
            .map_err(|error| self.not_understood(&error, error.remedy().unwrap_or(remedy)))
    }

    /// The error of a file that cannot be read to its end.
    pub(super) fn damaged(&self, error: &FileError) -> RecordingError {
        let remedy =
            error.remedy().unwrap_or("repair the file at that position, or cut it off there");
        self.not_understood(error, remedy)
    }

    /// The error of a file that is not of the required kind.
    pub(super) fn not_understood(
        &self,
        error: &dyn fmt::Display,
        remedy: &'static str,
    ) -> RecordingError {
        let (name, reason) = (self.name.clone(), error.to_string());
        RecordingError::NotUnderstood { name, reason, remedy }
    }
}
