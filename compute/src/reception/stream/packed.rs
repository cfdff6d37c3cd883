//! A stream that is packed by gzip.

use crate::formats::Gunzip;
use crate::gnss::{GpsTime, Navigation};
use crate::reception::{Received, ReceptionError, StreamFormat};

use super::{Needed, RECALL_BYTES, Stream};

/// Largest unpacked content of one chunk (bytes). Text unpacks to about ten times its size, blanks
/// to a thousand times.
const CHUNK_LIMIT: u64 = 8 << 20;
/// Largest unpacked content of a stream (bytes).
const STREAM_LIMIT: u64 = 128 << 20;

/// The packed bytes and their unpacker.
#[derive(Debug)]
pub(super) struct Packed {
    gunzip: Gunzip,
    pub(super) content: Stream,
}

impl Packed {
    pub(super) fn new(time: GpsTime) -> Self {
        Self { gunzip: Gunzip::new(), content: Stream::unpacked(time) }
    }

    /// The stream after `bytes`, all of its bytes so far.
    pub(super) fn restore(bytes: &[u8], time: GpsTime) -> Result<Self, ReceptionError> {
        let Self { mut gunzip, mut content } = Self::new(time);
        let mut recalled: Vec<u8> = Vec::new();
        gunzip.push(bytes, |block| {
            recalled.extend_from_slice(block);
            let surplus = recalled.len().saturating_sub(RECALL_BYTES as usize);
            recalled.drain(..surplus);
            content.push(block, &Navigation::default(), &mut Received::default())
        })?;
        if content.format() == Some(StreamFormat::Receiver) {
            // Messages without a week number are dated from the end, as in plain frames.
            let through = content.through();
            let tail = through - recalled.len() as u64..through;
            content = Stream::restore(&Needed { header: 0..0, tail }, &[], &recalled, time)?;
        }
        Ok(Self { gunzip, content })
    }

    pub(super) fn push(
        &mut self,
        bytes: &[u8],
        navigation: &Navigation,
        received: &mut Received,
    ) -> Result<(), ReceptionError> {
        let Self { gunzip, content } = self;
        let before = content.through();
        let within = |what, bytes: u64, limit| match bytes <= limit {
            true => Ok(()),
            false => Err(ReceptionError::UnpackedTooLarge { what, limit }),
        };
        gunzip.push(bytes, |block| {
            content.push(block, navigation, received)?;
            within("chunk", content.through() - before, CHUNK_LIMIT)?;
            within("stream", content.through(), STREAM_LIMIT)
        })
    }

    pub(super) fn finish(&mut self, received: &mut Received) {
        if !self.gunzip.is_whole() {
            let why = "gzip ends before its end".to_owned();
            received.leave_out(None, why, 1, self.content.through());
        }
        self.content.finish(received);
    }
}
