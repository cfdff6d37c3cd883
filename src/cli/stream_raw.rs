//! Sends the bytes of a receiver unchanged.

use std::io::{BufRead, Read};
use std::path::Path;
use std::time::Duration;

use bytes::Bytes;

use crate::contract::v1;
use crate::formats::receiver::{Decoder, Event, TimeReference};
use crate::gnss::GpsTime;
use crate::refusal::Code;

use super::Failure;
use super::device::Device;
use super::files;
use super::progress::{Progress, Speed};

/// Bytes of a chunk at full speed.
const PIECE_BYTES: usize = 64 << 10;
/// Bytes of a chunk that is searched for the end of an epoch; an epoch has more.
const PACE_BYTES: usize = 256;

/// A receiver's file that is being sent.
pub(super) struct Bytestream<'a> {
    path: &'a Path,
    input: Box<dyn BufRead>,
    offset: u64,
    near: Option<GpsTime>,
}

impl<'a> Bytestream<'a> {
    /// The file after its first `skipped` bytes; `near` dates data without a GPS week.
    pub(super) fn open(
        path: &'a Path,
        skipped: u64,
        near: Option<GpsTime>,
    ) -> Result<Self, Failure> {
        let mut input = files::input(path).open()?;
        let passed = std::io::copy(&mut input.by_ref().take(skipped), &mut std::io::sink());
        passed.map_err(|error| unreadable(path, &error))?;
        Ok(Self { path, input, offset: skipped, near })
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
                let bytes = self.read(PIECE_BYTES)?;
                let is_end = bytes.len() < PIECE_BYTES;
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
        let mut decoder = Decoder::new(self.near.map(TimeReference::Day));
        let (mut due, mut first): (Vec<u8>, Option<GpsTime>) = (Vec::new(), None);
        loop {
            let bytes = self.read(PACE_BYTES)?;
            let is_end = bytes.len() < PACE_BYTES;
            let mut events = Vec::new();
            decoder.push(&bytes, &mut events);
            due.extend(bytes);
            let epoch = events.iter().rev().find_map(|event| match event {
                Event::Epoch(epoch) => Some(epoch.time),
                _ => None,
            });
            if let Some(time) = epoch {
                let after_s = (time - *first.get_or_insert(time)) / factor;
                let when = start + Duration::from_secs_f64(after_s.max(0.0));
                let is_ahead = tokio::time::Instant::now() < when;
                if is_ahead || PIECE_BYTES < due.len() {
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
