//! A receiver's stream.

mod packed;

use std::ops::Range;

use crate::formats::gnss_logger::{Decoder as LogDecoder, is_gnss_logger};
use crate::formats::receiver::{Decoder, TimeReference};
use crate::formats::rinex::ChunkReader;
use crate::gnss::{Epoch, GpsTime, Navigation};

use super::{Received, ReceptionError, StreamFormat};

use packed::Packed;

/// Bytes at the end of a stream of frames that are decoded again to restore it. At 1 Hz and 32
/// satellites this is about half a minute, in which the lock time of each signal and each subframe
/// of an ephemeris is repeated.
const RECALL_BYTES: u64 = 128 << 10;
/// The first frame must begin within this many bytes. Receivers send a frame every second.
const UNRECOGNISED_LIMIT: u64 = 32 << 10;
/// Longest text of one epoch (bytes). The largest possible one, 300 satellites with 999
/// observations, has 5 MB; real ones have 60 kB.
const EPOCH_TEXT_LIMIT: usize = 256 << 10;
/// Longest stream that is read again from its beginning to restore it (bytes). A day of CRINEX at
/// 30 s with all systems has 8 MB.
const REREAD_LIMIT: u64 = 16 << 20;
/// Bytes per read while restoring.
const REREAD_BYTES: usize = 1 << 16;
/// Columns of a RINEX file's first line that identify it.
const FIRST_LINE_BYTES: usize = 80;
const LABEL_COLUMN: usize = 60;
const CRINEX: &[u8] = b"CRINEX VERS";
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// A receiver's stream up to the bytes that have arrived.
#[derive(Debug)]
pub struct Stream {
    /// Offset of its first byte among all bytes of the device.
    start: u64,
    /// Offset of the next byte.
    through: u64,
    /// A time within half a day of the next message.
    time: GpsTime,
    form: Form,
    /// The stream is the content of a packed one.
    is_unpacked: bool,
}

#[derive(Debug)]
enum Form {
    /// Too few bytes have arrived to recognise the format.
    Unknown(Vec<u8>),
    Receiver {
        decoder: Box<Decoder>,
        /// Offset at which the frames begin.
        from: u64,
        is_recognised: bool,
    },
    Rinex(ChunkReader),
    GnssLogger(Box<LogDecoder>),
    Gzip(Box<Packed>),
}

/// The format according to the first bytes.
enum Kind {
    Plain(StreamFormat),
    Gzip,
}

/// The offsets of the bytes that must be stored to restore a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Needed {
    /// The header of a RINEX stream or a GnssLogger log; empty for other streams.
    pub header: Range<u64>,
    /// The end of the stream.
    pub tail: Range<u64>,
}

impl Stream {
    /// A stream whose first byte is byte `start` of the device. `time` is within half a day of its
    /// first message, and dates messages without a week number.
    pub const fn new(start: u64, time: GpsTime) -> Self {
        Self { start, through: start, time, form: Form::Unknown(Vec::new()), is_unpacked: false }
    }

    /// The content of a packed stream.
    fn unpacked(time: GpsTime) -> Self {
        Self { is_unpacked: true, ..Self::new(0, time) }
    }

    /// Restores the stream as it was after byte `needed.tail.end`, from the bytes of `needed`.
    ///
    /// # Errors
    /// The bytes do not belong to one stream.
    pub fn restore(
        needed: &Needed,
        header: &[u8],
        tail: &[u8],
        time: GpsTime,
    ) -> Result<Self, ReceptionError> {
        let Needed { header: Range { start, end: header_end }, tail: of_tail } = needed.clone();
        let mut stream = Self::new(start, time);
        if of_tail.start == start && tail.starts_with(&GZIP) {
            stream.form = Form::Gzip(Box::new(Packed::restore(tail, time)?));
        } else {
            if header_end == start && start < of_tail.start {
                // After the beginning, any bytes may come first.
                stream.form = stream.form_of(StreamFormat::Receiver, of_tail.start);
            }
            if !header.is_empty() {
                stream.push(header, &Navigation::default(), &mut Received::default())?;
            }
            stream.through = of_tail.start;
            for chunk in tail.chunks(REREAD_BYTES) {
                stream.push(chunk, &Navigation::default(), &mut Received::default())?;
            }
        }
        stream.through = of_tail.end;
        Ok(stream)
    }

    /// Offset of its first byte.
    pub const fn start(&self) -> u64 {
        self.start
    }

    /// Offset of the next byte.
    pub const fn through(&self) -> u64 {
        self.through
    }

    /// The newest known time: the given one, or one from the stream.
    pub const fn time(&self) -> GpsTime {
        self.time
    }

    /// Whether it is known to consist of frames. They are not packed, so the time to decode a chunk
    /// depends on its length only.
    pub const fn is_of_frames(&self) -> bool {
        matches!(self.form, Form::Receiver { is_recognised: true, .. })
    }

    /// The format, once recognised.
    const fn format(&self) -> Option<StreamFormat> {
        match &self.form {
            Form::Receiver { .. } => Some(StreamFormat::Receiver),
            Form::Rinex(_) => Some(StreamFormat::Rinex),
            Form::GnssLogger(_) => Some(StreamFormat::GnssLogger),
            Form::Unknown(_) | Form::Gzip(_) => None,
        }
    }

    /// Sets a time within half a day of the next message.
    pub fn date(&mut self, time: GpsTime) {
        self.time = time;
        match &mut self.form {
            Form::Receiver { decoder, .. } => decoder.date(time),
            Form::Gzip(packed) => packed.content.date(time),
            Form::Unknown(_) | Form::Rinex(_) | Form::GnssLogger(_) => {}
        }
    }

    /// Decodes the next bytes and adds complete data to `received`. `navigation` gives the FDMA
    /// channels of GLONASS satellites that the stream does not contain.
    ///
    /// # Errors
    /// The format is not known. The stream is then unusable.
    pub fn push(
        &mut self,
        bytes: &[u8],
        navigation: &Navigation,
        received: &mut Received,
    ) -> Result<(), ReceptionError> {
        let from = self.through;
        self.through += bytes.len() as u64;
        match &mut self.form {
            Form::Unknown(head) => {
                head.extend_from_slice(bytes);
                let Some(kind) = kind_of(head) else { return Ok(()) };
                let head = std::mem::take(head);
                let from = self.through - head.len() as u64;
                self.form = match kind {
                    Kind::Plain(format) => self.form_of(format, from),
                    Kind::Gzip if self.is_unpacked => return Err(ReceptionError::PackedTwice),
                    Kind::Gzip => Form::Gzip(Box::new(Packed::new(self.time))),
                };
                self.decode(from, &head, navigation, received)
            }
            _ => self.decode(from, bytes, navigation, received),
        }
    }

    /// Ends the stream: incomplete data is decoded as it is.
    pub fn finish(&mut self, received: &mut Received) {
        match &mut self.form {
            Form::Unknown(_) => {}
            Form::Receiver { decoder, from, .. } => {
                let mut events = Vec::new();
                decoder.finish(&mut events);
                // At most the last epoch, which a full chunk leaves out.
                received.take(events).ok();
                received.count(&decoder.take_statistics(), *from);
            }
            Form::Rinex(reader) => {
                reader.finish();
                // An unreadable rest at the very end is skipped.
                read_epochs(reader, received).ok();
            }
            Form::GnssLogger(decoder) => {
                // An unreadable rest at the very end is skipped.
                decoder.finish(&mut received.epochs).ok();
                received.skip(&decoder.take_skipped());
            }
            Form::Gzip(packed) => packed.finish(received),
        }
    }

    /// The bytes that must be stored to restore the stream in its present state.
    pub fn needed(&self) -> Needed {
        let Self { start, through, .. } = *self;
        let (header_bytes, tail_bytes) = match &self.form {
            Form::Unknown(head) => (0, head.len() as u64),
            Form::Receiver { .. } => (0, RECALL_BYTES),
            Form::Rinex(reader) if reader.is_compact() => (reader.header_bytes() as u64, u64::MAX),
            Form::Rinex(reader) => (reader.header_bytes() as u64, reader.untaken_bytes() as u64),
            Form::GnssLogger(decoder) => (decoder.header_bytes(), decoder.tail_bytes()),
            Form::Gzip(_) => (0, u64::MAX),
        };
        let header = start..start + header_bytes;
        let tail = through.saturating_sub(tail_bytes).max(header.end)..through;
        Needed { header, tail }
    }

    fn form_of(&self, format: StreamFormat, from: u64) -> Form {
        match format {
            StreamFormat::Receiver => {
                let decoder = Decoder::new(Some(TimeReference::Day(self.time)));
                // A stream restored from the middle was recognised before.
                let is_recognised = self.start < from;
                Form::Receiver { decoder: Box::new(decoder), from, is_recognised }
            }
            StreamFormat::Rinex => Form::Rinex(ChunkReader::default()),
            StreamFormat::GnssLogger => Form::GnssLogger(Box::default()),
        }
    }

    fn decode(
        &mut self,
        at: u64,
        bytes: &[u8],
        navigation: &Navigation,
        received: &mut Received,
    ) -> Result<(), ReceptionError> {
        match &mut self.form {
            Form::Unknown(_) => {}
            Form::Receiver { decoder, from, is_recognised } => {
                received.format = Some(StreamFormat::Receiver);
                decoder.learn_channels(navigation);
                let mut events = Vec::new();
                decoder.push(bytes, &mut events);
                received.take(events)?;
                let statistics = decoder.take_statistics();
                *is_recognised |= statistics.messages().next().is_some();
                let seen = at + bytes.len() as u64 - *from;
                if !*is_recognised && UNRECOGNISED_LIMIT < seen {
                    return Err(ReceptionError::Unrecognised { bytes: seen });
                }
                received.count(&statistics, *from);
                self.time = decoder.time().unwrap_or(self.time);
            }
            Form::Rinex(reader) => {
                received.format = Some(StreamFormat::Rinex);
                reader.push(bytes)?;
                read_epochs(reader, received)?;
                self.time = received.epochs.last().map_or(self.time, |epoch| epoch.time);
                let bytes = reader.untaken_bytes();
                if EPOCH_TEXT_LIMIT < bytes {
                    return Err(ReceptionError::EpochTooLong { bytes });
                }
                if reader.is_compact() && !self.is_unpacked {
                    return self.check_length("CRINEX");
                }
            }
            Form::GnssLogger(decoder) => {
                received.format = Some(StreamFormat::GnssLogger);
                decoder.learn_channels(navigation);
                decoder.push(bytes, &mut received.epochs)?;
                received.skip(&decoder.take_skipped());
                self.time = received.epochs.last().map_or(self.time, |epoch| epoch.time);
            }
            Form::Gzip(packed) => {
                packed.push(bytes, navigation, received)?;
                self.time = packed.content.time();
                return self.check_length("gzip");
            }
        }
        Ok(())
    }

    fn check_length(&self, format: &'static str) -> Result<(), ReceptionError> {
        let limit = REREAD_LIMIT;
        match self.through - self.start <= limit {
            true => Ok(()),
            false => Err(ReceptionError::StreamTooLong { format, limit }),
        }
    }
}

fn read_epochs(reader: &mut ChunkReader, received: &mut Received) -> Result<(), ReceptionError> {
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    while reader.read_epoch(&mut epoch)? {
        received.add(epoch.clone())?;
    }
    received.skip(&reader.take_skipped());
    Ok(())
}

/// The format of a stream that begins with `head`; `None` if more bytes are needed.
fn kind_of(head: &[u8]) -> Option<Kind> {
    match head {
        [] | [0x1f] => None,
        _ if head.starts_with(&GZIP) => Some(Kind::Gzip),
        // The version, right-aligned in its columns.
        [b' ' | b'0'..=b'9', ..] => {
            let line = head.split(|byte| *byte == b'\n').next().unwrap_or(head);
            if line.len() == head.len() && head.len() < FIRST_LINE_BYTES {
                return None;
            }
            let label = line.get(LABEL_COLUMN..).unwrap_or_default();
            let is_rinex = label.starts_with(b"RINEX VERSION / TYPE") || label.starts_with(CRINEX);
            let format = if is_rinex { StreamFormat::Rinex } else { StreamFormat::Receiver };
            Some(Kind::Plain(format))
        }
        _ => match is_gnss_logger(head) {
            Some(true) => Some(Kind::Plain(StreamFormat::GnssLogger)),
            None if head.len() as u64 <= UNRECOGNISED_LIMIT => None,
            Some(false) | None => Some(Kind::Plain(StreamFormat::Receiver)),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    /// A gzip member may begin with a comment of any length, which unpacks to nothing.
    #[test]
    fn packed_streams_have_a_longest_length() {
        let mut stream = Stream::new(5, GpsTime::EPOCH);
        let mut push =
            |bytes: &[u8]| stream.push(bytes, &Navigation::default(), &mut Received::default());
        push(&[0x1f, 0x8b, 8, 0x10, 0, 0, 0, 0, 0, 3]).unwrap();
        let comment = [b'x'; 1 << 16];
        let outcomes: Vec<_> = (0..260).map(|_| push(&comment)).collect();
        let refused = outcomes.iter().position(Result::is_err);
        assert_eq!(refused, Some((REREAD_LIMIT >> 16) as usize - 1));
        let error = outcomes.into_iter().find_map(Result::err).unwrap();
        assert_eq!(error.code(), Code::RawStreamTooLong);
    }
}
