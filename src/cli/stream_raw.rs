//! Sends the bytes of a receiver or of a GnssLogger log unchanged.

use std::io::{BufRead, Read};
use std::path::Path;
use std::time::Duration;

use bytes::Bytes;

use crate::contract::v1;
use crate::formats::gnss_logger;
use crate::formats::observations::FileFormat;
use crate::formats::receiver::{Decoder, Event, TimeReference};
use crate::gnss::GpsTime;
use crate::refusal::Code;

use super::Failure;
use super::device::Device;
use super::files;
use super::progress::{Progress, Speed};

/// Bytes of a chunk at full speed.
const CHUNK_BYTES: usize = 64 << 10;
/// Bytes of a chunk that is searched for the end of an epoch; an epoch has more.
const PACE_BYTES: usize = 256;

/// A receiver's file that is being sent.
pub(super) struct Bytestream<'a> {
    path: &'a Path,
    input: Box<dyn BufRead>,
    offset: u64,
    near: Option<GpsTime>,
    pace: Pace,
}

/// Finds the times of the epochs in the bytes that are sent.
enum Pace {
    Receiver(Box<Decoder>),
    GnssLogger(Box<gnss_logger::Decoder>),
}

impl Pace {
    /// The time of the last epoch that `bytes` complete. The service reports what it refuses.
    fn push(&mut self, bytes: &[u8]) -> Option<GpsTime> {
        match self {
            Self::Receiver(decoder) => {
                let mut events = Vec::new();
                decoder.push(bytes, &mut events);
                events.iter().rev().find_map(|event| match event {
                    Event::Epoch(epoch) => Some(epoch.time),
                    _ => None,
                })
            }
            Self::GnssLogger(decoder) => {
                let mut epochs = Vec::new();
                decoder.push(bytes, &mut epochs).ok()?;
                epochs.last().map(|epoch| epoch.time)
            }
        }
    }
}

impl<'a> Bytestream<'a> {
    /// The file after its first `skipped` bytes; `near` dates data without a GPS week.
    pub(super) fn open(
        (path, format): (&'a Path, FileFormat),
        skipped: u64,
        near: Option<GpsTime>,
    ) -> Result<Self, Failure> {
        let input = files::input(path).open()?;
        let pace = match format {
            FileFormat::GnssLogger => Pace::GnssLogger(Box::default()),
            FileFormat::Rinex | FileFormat::Receiver => {
                Pace::Receiver(Box::new(Decoder::new(near.map(TimeReference::Day))))
            }
        };
        let mut stream = Self { path, input, offset: skipped, near, pace };
        let mut left = skipped;
        while 0 < left {
            // The header of a log is among these bytes.
            let bytes = stream.read(CHUNK_BYTES.min(left as usize))?;
            stream.pace.push(&bytes);
            left = if bytes.is_empty() { 0 } else { left - bytes.len() as u64 };
        }
        Ok(stream)
    }

    /// Reads `length` bytes, or fewer at the end.
    fn read(&mut self, length: usize) -> Result<Vec<u8>, Failure> {
        let mut bytes = Vec::with_capacity(length);
        let read = self.input.by_ref().take(length as u64).read_to_end(&mut bytes);
        read.map_err(|error| unreadable(self.path, &error))?;
        Ok(bytes)
    }

    /// Sends the file to its end.
    ///
    /// # Errors
    /// The file cannot be read, or the service refuses its bytes or does not answer again.
    pub(super) async fn play(
        mut self,
        device: &mut Device,
        speed: Speed,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        match speed {
            Speed::Max => loop {
                let bytes = self.read(CHUNK_BYTES)?;
                let is_end = bytes.len() < CHUNK_BYTES;
                self.push(bytes, is_end, device, progress).await?;
                if is_end {
                    return Ok(());
                }
            },
            Speed::Factor(factor) => self.paced(factor, device, progress).await,
        }
    }

    /// Sends the bytes of each epoch when they are due. Epochs that became due during a push go
    /// together.
    async fn paced(
        &mut self,
        factor: f64,
        device: &mut Device,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        let start = tokio::time::Instant::now();
        let (mut due, mut first): (Vec<u8>, Option<GpsTime>) = (Vec::new(), None);
        loop {
            let bytes = self.read(PACE_BYTES)?;
            let is_end = bytes.len() < PACE_BYTES;
            let epoch = self.pace.push(&bytes);
            due.extend(bytes);
            if let Some(time) = epoch {
                let after_s = (time - *first.get_or_insert(time)) / factor;
                let when = start + Duration::from_secs_f64(after_s.max(0.0));
                let is_ahead = tokio::time::Instant::now() < when;
                if is_ahead || CHUNK_BYTES < due.len() {
                    tokio::time::sleep_until(when).await;
                    self.push(std::mem::take(&mut due), false, device, progress).await?;
                }
            }
            if is_end {
                return self.push(due, true, device, progress).await;
            }
        }
    }

    async fn push(
        &mut self,
        bytes: Vec<u8>,
        end: bool,
        device: &mut Device,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        let (offset, content) = (self.offset, Bytes::from(bytes));
        self.offset += content.len() as u64;
        let session = device.session().session.clone();
        let near = self.near.map(Into::into);
        let chunk = v1::PushRawRequest { session, offset, content, end, near };
        progress.count(&device.push_raw(chunk).await?);
        Ok(())
    }
}

fn unreadable(path: &Path, error: &std::io::Error) -> Failure {
    let message = format!("{}: {error}", path.display());
    Failure::of(Code::FileNotReadable, message)
}
