//! The stream itself.

mod packed;

use std::ops::Range;

use crate::formats::receiver::{Decoder, TimeReference};
use crate::formats::rinex::PieceReader;
use crate::gnss::{Epoch, GpsTime, Navigation};

use super::{Received, ReceptionError, StreamFormat};

use packed::Packed;

/// How much of a stream of frames is decoded again to restore it (bytes): at one epoch a second
/// and 32 satellites about half a minute, in which each signal's lock time and each subframe of an
/// ephemeris comes.
const RECALL_BYTES: u64 = 128 << 10;
/// In so many bytes at the start a frame must stand: receivers say something every second.
const UNRECOGNISED_LIMIT: u64 = 32 << 10;
/// Longest text of an epoch with what surrounds it (bytes): 300 satellites of 999 observations
/// would have 5 MB, real ones 60 kB.
const EPOCH_TEXT_LIMIT: usize = 256 << 10;
/// Longest stream that is read again from its beginning to restore it (bytes): a day of CRINEX at
/// 30 s with all systems has 8 MB.
const REREAD_LIMIT: u64 = 16 << 20;
/// In such pieces (bytes).
const REREAD_PIECE: usize = 1 << 16;
/// Columns of RINEX's first line, which tell it.
const FIRST_LINE_BYTES: usize = 80;
const LABEL_COLUMN: usize = 60;
const CRINEX: &[u8] = b"CRINEX VERS";
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// A receiver's stream, as far as it has come.
#[derive(Debug)]
pub struct Stream {
    /// Offset of its first byte among all that came from the device.
    start: u64,
    /// Offset of the byte that comes next.
    through: u64,
    /// Within half a day of what comes.
    time: GpsTime,
    form: Form,
    /// It comes out of a packed one.
    is_unpacked: bool,
}

#[derive(Debug)]
enum Form {
    /// Too few bytes have come to tell.
    Unknown(Vec<u8>),
    Receiver {
        decoder: Box<Decoder>,
        /// Offset at which it began.
        from: u64,
        is_recognised: bool,
    },
    Rinex(PieceReader),
    Gzip(Box<Packed>),
}

/// What the first bytes tell.
enum Kind {
    Plain(StreamFormat),
    Gzip,
}

/// What must be stored of a stream so that it can be restored, as offsets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Needed {
    /// The header of RINEX; empty for other streams.
    pub header: Range<u64>,
    /// The end of the stream.
    pub tail: Range<u64>,
}

impl Stream {
    /// A stream whose first byte is the device's byte `start`; `time`, within half a day of its
    /// first message, dates those that tell no week.
    pub const fn new(start: u64, time: GpsTime) -> Self {
        Self { start, through: start, time, form: Form::Unknown(Vec::new()), is_unpacked: false }
    }

    /// What comes out of a packed stream.
    fn unpacked(time: GpsTime) -> Self {
        Self { is_unpacked: true, ..Self::new(0, time) }
    }

    /// The stream as it was after the bytes before `needed.tail.end`, from the bytes of `needed`.
    ///
    /// # Errors
    /// The bytes are not of one stream.
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
                // In the middle any bytes may come first.
                stream.form = stream.form_of(StreamFormat::Receiver, of_tail.start);
            }
            if !header.is_empty() {
                stream.push(header, &Navigation::default(), &mut Received::default())?;
            }
            stream.through = of_tail.start;
            for piece in tail.chunks(REREAD_PIECE) {
                stream.push(piece, &Navigation::default(), &mut Received::default())?;
            }
        }
        stream.through = of_tail.end;
        Ok(stream)
    }

    /// Offset of its first byte.
    pub const fn start(&self) -> u64 {
        self.start
    }

    /// Offset of the byte that comes next.
    pub const fn through(&self) -> u64 {
        self.through
    }

    /// The newest time known: the one given, or one that the stream told.
    pub const fn time(&self) -> GpsTime {
        self.time
    }

    /// Its format, once the first bytes have told.
    const fn format(&self) -> Option<StreamFormat> {
        match &self.form {
            Form::Receiver { .. } => Some(StreamFormat::Receiver),
            Form::Rinex(_) => Some(StreamFormat::Rinex),
            Form::Unknown(_) | Form::Gzip(_) => None,
        }
    }

    /// Gives a time within half a day of what comes.
    pub fn date(&mut self, time: GpsTime) {
        self.time = time;
        match &mut self.form {
            Form::Receiver { decoder, .. } => decoder.date(time),
            Form::Gzip(packed) => packed.content.date(time),
            Form::Unknown(_) | Form::Rinex(_) => {}
        }
    }

    /// Takes the next bytes; what they complete is added to `received`. The FDMA channels of
    /// GLONASS that the stream does not tell are those of `navigation`.
    ///
    /// # Errors
    /// Bytes of no known format; the stream is then spoilt.
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

    /// Ends the stream: what is incomplete is taken as it is.
    pub fn finish(&mut self, received: &mut Received) {
        match &mut self.form {
            Form::Unknown(_) => {}
            Form::Receiver { decoder, from, .. } => {
                let mut events = Vec::new();
                decoder.finish(&mut events);
                received.take(events);
                received.count(&decoder.take_statistics(), *from);
            }
            Form::Rinex(reader) => {
                reader.finish();
                // What cannot be read at the very end is left out.
                read_epochs(reader, received).ok();
            }
            Form::Gzip(packed) => packed.finish(received),
        }
    }

    /// What must be stored to restore it as it is now.
    pub fn needed(&self) -> Needed {
        let Self { start, through, .. } = *self;
        let (header_bytes, tail_bytes) = match &self.form {
            Form::Unknown(head) => (0, head.len() as u64),
            Form::Receiver { .. } => (0, RECALL_BYTES),
            Form::Rinex(reader) if reader.is_compact() => (reader.header_bytes() as u64, u64::MAX),
            Form::Rinex(reader) => (reader.header_bytes() as u64, reader.untaken_bytes() as u64),
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
                // What is restored from the middle on was recognised before.
                let is_recognised = self.start < from;
                Form::Receiver { decoder: Box::new(decoder), from, is_recognised }
            }
            StreamFormat::Rinex => Form::Rinex(PieceReader::default()),
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
                received.take(events);
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

fn read_epochs(reader: &mut PieceReader, received: &mut Received) -> Result<(), ReceptionError> {
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    while reader.read_epoch(&mut epoch)? {
        received.epochs.push(epoch.clone());
    }
    received.skip(&reader.take_skipped());
    Ok(())
}

/// What a stream is that begins with `head`; `None` where more of it must be seen.
fn kind_of(head: &[u8]) -> Option<Kind> {
    match head {
        [] | [0x1f] => None,
        _ if head.starts_with(&GZIP) => Some(Kind::Gzip),
        // The version, at the right of its columns.
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
        _ => Some(Kind::Plain(StreamFormat::Receiver)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    /// A member of gzip may begin with a comment of any length, which gives nothing.
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
