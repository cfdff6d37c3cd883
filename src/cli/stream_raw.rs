//! Sends the bytes of a receiver or of a GnssLogger log unchanged.

use std::io::{BufRead, Read};
use std::path::Path;
use std::time::Duration;

use bytes::Bytes;
use tokio::time::Instant;

use crate::contract::v1;
use crate::formats::gnss_logger;
use crate::formats::observations::FileFormat;
use crate::formats::receiver::{Decoder, Event, TimeReference};
use crate::gnss::GpsTime;
use crate::refusal::Code;

use super::Failure;
use super::cargo::RawBytes;
use super::device_stream::DeviceStream;
use super::files;
use super::progress::{Progress, Speed};

/// Bytes of a chunk at full speed.
const CHUNK_BYTES: usize = 64 << 10;
/// Bytes of a chunk that is searched for the end of an epoch. An epoch has more bytes than this.
const PACE_BYTES: usize = 256;

/// A receiver's file that is being sent.
pub(super) struct Bytestream<'a> {
    path: &'a Path,
    input: Box<dyn BufRead>,
    offset: u64,
    pace: Pace,
}

/// Finds the times of the epochs in the bytes that are sent.
enum Pace {
    Receiver(Box<Decoder>),
    GnssLogger(Box<gnss_logger::Decoder>),
}

impl Pace {
    /// The time of the last epoch that `bytes` complete. Errors in the bytes are left to the
    /// service.
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
    /// Opens the file after its first `skipped` bytes. `near` dates data without a GPS week.
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
        let mut stream = Self { path, input, offset: skipped, pace };
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
        mut device: DeviceStream<RawBytes>,
        speed: Speed,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        match speed {
            Speed::Max => self.at_full_speed(&mut device, progress).await?,
            Speed::Factor(factor) => self.paced(factor, &mut device, progress).await?,
        }
        progress.end(device).await
    }

    /// Sends the bytes as fast as the service answers.
    async fn at_full_speed(
        &mut self,
        device: &mut DeviceStream<RawBytes>,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        loop {
            let bytes = self.read(CHUNK_BYTES)?;
            let is_end = bytes.len() < CHUNK_BYTES;
            self.send(device, bytes, is_end, Instant::now());
            if is_end {
                return Ok(());
            }
            progress.until_room(device).await?;
        }
    }

    /// Sends the bytes of each epoch when they are due.
    async fn paced(
        &mut self,
        factor: f64,
        device: &mut DeviceStream<RawBytes>,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        let start = Instant::now();
        let (mut waiting, mut first): (Vec<u8>, Option<GpsTime>) = (Vec::new(), None);
        loop {
            let bytes = self.read(PACE_BYTES)?;
            let is_end = bytes.len() < PACE_BYTES;
            let epoch = self.pace.push(&bytes);
            waiting.extend(bytes);
            if let Some(time) = epoch {
                let after_s = (time - *first.get_or_insert(time)) / factor;
                let due = start + Duration::from_secs_f64(after_s.max(0.0));
                progress.until_room(device).await?;
                progress.until(device, due).await?;
                self.send(device, std::mem::take(&mut waiting), false, due);
            }
            if is_end {
                self.send(device, waiting, true, Instant::now());
                return Ok(());
            }
        }
    }

    fn send(
        &mut self,
        device: &mut DeviceStream<RawBytes>,
        bytes: Vec<u8>,
        end: bool,
        due: Instant,
    ) {
        let (offset, content) = (self.offset, Bytes::from(bytes));
        self.offset += content.len() as u64;
        let chunk = v1::StreamRawRequest { opening: None, offset, content, end };
        device.send(chunk, 1, self.offset, due);
    }
}

fn unreadable(path: &Path, error: &std::io::Error) -> Failure {
    let message = format!("{}: {error}", path.display());
    Failure::of(Code::FileNotReadable, message)
}
