//! Finds frames in a byte stream and checks that they are complete.

use memchr::memchr3;

use crate::formats::binary::{CRC24Q_SHIFT_LIMIT, crc24q};

use super::checksums::{Beginnings, Checksum, Crc24q, Fletcher};

const RTCM_PREAMBLE: u8 = 0xd3;
const RTCM_HEADER_BYTES: usize = 3;
const RTCM_CRC_BYTES: usize = 3;
/// The six reserved bits between preamble and length, which are zero.
const RTCM_RESERVED: u8 = 0xfc;
const UBX_SYNC: [u8; 2] = [0xb5, 0x62];
const UBX_HEADER_BYTES: usize = 6;
const UBX_CHECKSUM_BYTES: usize = 2;
const _: () = assert!(
    RTCM_HEADER_BYTES + 1023 + RTCM_CRC_BYTES <= CRC24Q_SHIFT_LIMIT,
    "the CRC of each frame follows from sums"
);
/// Longest accepted UBX payload: RXM-RAWX with 255 measurements has 8176 bytes. Without the limit a
/// damaged length would stop a stream for 64 kB.
const UBX_PAYLOAD_LIMIT: usize = 8192;
/// Longest recognised NMEA sentence; the standard allows 82 characters, receivers exceed it.
const NMEA_LIMIT: usize = 256;

/// A complete frame with a valid checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frame<'a> {
    /// Payload of an RTCM 3 frame.
    Rtcm(&'a [u8]),
    /// A UBX message with class, id and payload.
    Ubx { class: u8, id: u8, payload: &'a [u8] },
    /// An NMEA sentence, whose content is not used.
    Nmea,
}

/// The content of the stream from a position on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scan<'a> {
    /// A frame that begins `at` bytes after the stream's start.
    Frame { at: u64, frame: Frame<'a> },
    /// A frame with a wrong checksum; its bytes are scanned again.
    Broken { at: u64, is_ubx: bool },
    /// Bytes outside frames.
    Garbage { at: u64, length: usize },
}

/// The result of checking a possible start of a frame.
enum Candidate {
    Whole(usize),
    WrongChecksum,
    Incomplete,
    NoFrame,
}

/// Bytes that have not been split into frames yet.
///
/// Hostile bytes may have a possible start of a frame at every second byte, each of a frame of up
/// to 8 kB with a wrong checksum. So a frame's checksum is computed from its bytes only outside of
/// such frames. Within them it follows from the sums of the beginnings ([`Beginnings`]): each byte
/// is summed at most three times, once for its frame, and once for each kind of checksum.
#[derive(Debug)]
pub(super) struct FrameBuffer {
    bytes: Vec<u8>,
    /// Index of the first byte where the next frame may begin.
    start: usize,
    /// Number of bytes of the stream before `bytes`.
    dropped: u64,
    /// End of the frames with a wrong checksum that begin before `start`.
    broken_until: usize,
    fletcher: Beginnings<Fletcher>,
    crc: Beginnings<Crc24q>,
    sentence: Sentence,
    /// Number of bytes that were summed or searched: a test bounds it.
    work: usize,
}

/// The text after a `$`, as far as it was searched for its end.
#[derive(Debug)]
struct Sentence {
    /// Index of the `$`.
    start: usize,
    /// Index of the first `*` or byte that is not text, if `is_ended`; otherwise that of the first
    /// byte that was not searched.
    end: usize,
    is_ended: bool,
    /// Exclusive or of the bytes between.
    xor: u8,
}

impl FrameBuffer {
    pub(super) const fn new() -> Self {
        Self {
            bytes: Vec::new(),
            start: 0,
            dropped: 0,
            broken_until: 0,
            fletcher: Beginnings::new(),
            crc: Beginnings::new(),
            sentence: Sentence::NONE,
            work: 0,
        }
    }

    /// Appends bytes and drops those of previous frames.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        let gone = std::mem::take(&mut self.start);
        self.dropped += gone as u64;
        self.bytes.drain(..gone);
        self.broken_until = self.broken_until.saturating_sub(gone);
        self.fletcher.remove(gone);
        self.crc.remove(gone);
        self.sentence.remove(gone);
        self.bytes.extend_from_slice(bytes);
    }

    /// The next frame or garbage; `None` if more bytes are needed.
    ///
    /// With `is_end` no bytes follow, so that an incomplete frame is garbage.
    pub(super) fn next(&mut self, is_end: bool) -> Option<Scan<'_>> {
        let from = self.start;
        let first = *self.bytes.get(from)?;
        let at = self.dropped + from as u64;
        match self.candidate(first) {
            Candidate::Whole(length) => {
                self.start += length;
                let frame = frame(&self.bytes[from..from + length]);
                Some(Scan::Frame { at, frame })
            }
            Candidate::Incomplete if !is_end => None,
            Candidate::WrongChecksum => {
                self.start += 1;
                Some(Scan::Broken { at, is_ubx: first == UBX_SYNC[0] })
            }
            Candidate::Incomplete | Candidate::NoFrame => {
                let rest = &self.bytes[from..];
                let next = memchr3(RTCM_PREAMBLE, UBX_SYNC[0], b'$', &rest[1..]);
                let length = next.map_or(rest.len(), |next| next + 1);
                self.start += length;
                Some(Scan::Garbage { at, length })
            }
        }
    }

    fn candidate(&mut self, first: u8) -> Candidate {
        let rest = &self.bytes[self.start..];
        let announced = match first {
            RTCM_PREAMBLE => rtcm(rest),
            first if first == UBX_SYNC[0] => ubx(rest),
            b'$' => return self.nmea(),
            _ => return Candidate::NoFrame,
        };
        let Candidate::Whole(length) = announced else { return announced };
        if self.is_sound(first, length) {
            return Candidate::Whole(length);
        }
        self.broken_until = self.broken_until.max(self.start + length);
        Candidate::WrongChecksum
    }

    /// Whether the frame of this length has a valid checksum.
    fn is_sound(&mut self, first: u8, length: usize) -> bool {
        let (start, end) = (self.start, self.start + length);
        let is_ubx = first == UBX_SYNC[0];
        if self.broken_until <= start {
            self.fletcher.clear();
            self.crc.clear();
            self.work += length;
            let frame = &self.bytes[start..end];
            return if is_ubx { is_ubx_sound(frame) } else { crc24q(frame) == 0 };
        }
        let (is_sound, summed) = if is_ubx {
            let message = start + UBX_SYNC.len()..end - UBX_CHECKSUM_BYTES;
            let (Fletcher { a, b }, summed) = self.fletcher.of(&self.bytes, message);
            (self.bytes[end - UBX_CHECKSUM_BYTES..end] == [a, b], summed)
        } else {
            let (crc, summed) = self.crc.of(&self.bytes, start..end);
            (crc == Crc24q::EMPTY, summed)
        };
        self.work += summed;
        is_sound
    }

    /// Checks for a sentence `$` … `*hh` with its line end. Bytes that were searched for the end of
    /// an earlier sentence are not searched again.
    fn nmea(&mut self) -> Candidate {
        let (start, bytes) = (self.start, &self.bytes);
        self.work += self.sentence.search(bytes, start);
        let Sentence { end, is_ended, xor, .. } = self.sentence;
        if !is_ended {
            let is_long = NMEA_LIMIT <= bytes.len() - start;
            return if is_long { Candidate::NoFrame } else { Candidate::Incomplete };
        }
        if bytes[end] != b'*' {
            return Candidate::NoFrame;
        }
        let digit = |value: u8| b"0123456789ABCDEF"[usize::from(value)];
        let tail = [digit(xor >> 4), digit(xor & 15), b'\r', b'\n'];
        let found = &bytes[end + 1..];
        let length = found.len().min(tail.len());
        if !found[..length].eq_ignore_ascii_case(&tail[..length]) {
            Candidate::NoFrame
        } else if length < tail.len() {
            Candidate::Incomplete
        } else {
            Candidate::Whole(end + 1 + tail.len() - start)
        }
    }
}

impl Sentence {
    const NONE: Self = Self { start: 0, end: 0, is_ended: false, xor: 0 };

    /// Forgets the first `count` bytes of the buffer, which are removed.
    fn remove(&mut self, count: usize) {
        let Self { start, end, .. } = *self;
        match start.checked_sub(count) {
            Some(start) => (self.start, self.end) = (start, end.saturating_sub(count)),
            None => *self = Self::NONE,
        }
    }

    /// Searches the end of the sentence whose `$` has the index `start`. Returns the number of
    /// bytes that were searched.
    fn search(&mut self, bytes: &[u8], start: usize) -> usize {
        let mut searched = 0;
        if (self.start..self.end).contains(&start) {
            let gone = &bytes[self.start + 1..=start];
            self.xor = gone.iter().fold(self.xor, |xor, byte| xor ^ byte);
            self.start = start;
            searched += gone.len();
        } else {
            *self = Self { start, end: start + 1, is_ended: false, xor: 0 };
        }
        if self.is_ended {
            return searched;
        }
        let until = bytes.len().min(start + NMEA_LIMIT);
        for byte in bytes.get(self.end..until).unwrap_or_default() {
            searched += 1;
            if *byte == b'*' || !is_text(*byte) {
                self.is_ended = true;
                break;
            }
            self.xor ^= byte;
            self.end += 1;
        }
        searched
    }
}

/// The frame that `rest` announces, with its checksum unchecked.
fn rtcm(rest: &[u8]) -> Candidate {
    match *rest {
        [_, second, ..] if second & RTCM_RESERVED != 0 => Candidate::NoFrame,
        [_, second, third, ..] => {
            let payload = usize::from(second & 3) << 8 | usize::from(third);
            announced(rest, RTCM_HEADER_BYTES + payload + RTCM_CRC_BYTES)
        }
        _ => Candidate::Incomplete,
    }
}

/// The frame that `rest` announces, with its checksum unchecked.
fn ubx(rest: &[u8]) -> Candidate {
    match *rest {
        [_, second, ..] if second != UBX_SYNC[1] => Candidate::NoFrame,
        [_, _, _, _, low, high, ..] => {
            let payload = usize::from(u16::from_le_bytes([low, high]));
            if UBX_PAYLOAD_LIMIT < payload {
                return Candidate::NoFrame;
            }
            announced(rest, UBX_HEADER_BYTES + payload + UBX_CHECKSUM_BYTES)
        }
        _ => Candidate::Incomplete,
    }
}

const fn announced(rest: &[u8], length: usize) -> Candidate {
    if rest.len() < length { Candidate::Incomplete } else { Candidate::Whole(length) }
}

/// Fletcher's checksum over class, id, length and payload; u-blox interface descriptions, 3.4.
fn is_ubx_sound(frame: &[u8]) -> bool {
    let (message, checksum) = frame.split_at(frame.len() - UBX_CHECKSUM_BYTES);
    let sum = message[UBX_SYNC.len()..].iter();
    let Fletcher { a, b } = sum.fold(Fletcher::EMPTY, |sum, byte| sum.after(*byte));
    checksum == [a, b]
}

const fn is_text(byte: u8) -> bool {
    matches!(byte, b' '..=b'~')
}

fn frame(bytes: &[u8]) -> Frame<'_> {
    match bytes[0] {
        RTCM_PREAMBLE => Frame::Rtcm(&bytes[RTCM_HEADER_BYTES..bytes.len() - RTCM_CRC_BYTES]),
        b'$' => Frame::Nmea,
        _ => Frame::Ubx {
            class: bytes[2],
            id: bytes[3],
            payload: &bytes[UBX_HEADER_BYTES..bytes.len() - UBX_CHECKSUM_BYTES],
        },
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::{collection, sample};

    use super::*;

    const UBX: [u8; 10] = [0xb5, 0x62, 0x0a, 0x04, 2, 0, 7, 9, 0x20, 0x6f];
    const RTCM: [u8; 25] = [
        0xd3, 0x00, 0x13, 0x3e, 0xd7, 0xd3, 0x02, 0x02, 0x98, 0x0e, 0xde, 0xef, 0x34, 0xb4, 0xbd,
        0x62, 0xac, 0x09, 0x41, 0x98, 0x6f, 0x33, 0x36, 0x0b, 0x98,
    ];
    const NMEA: &[u8] = b"$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n";

    fn scans(parts: &[&[u8]]) -> Vec<String> {
        let mut buffer = FrameBuffer::new();
        let mut found = Vec::new();
        for part in parts {
            buffer.push(part);
            while let Some(scan) = buffer.next(false) {
                found.push(format!("{scan:?}"));
            }
        }
        while let Some(scan) = buffer.next(true) {
            found.push(format!("{scan:?}"));
        }
        found
    }

    #[test]
    fn frames_of_three_kinds_between_garbage() {
        let all = [b"junk".as_slice(), &UBX, NMEA, b"$", &RTCM, &UBX[..7]].concat();
        let found = scans(&[&all]);
        let payload = &RTCM[3..22];
        assert_eq!(
            found,
            [
                "Garbage { at: 0, length: 4 }".to_owned(),
                "Frame { at: 4, frame: Ubx { class: 10, id: 4, payload: [7, 9] } }".to_owned(),
                "Frame { at: 14, frame: Nmea }".to_owned(),
                "Garbage { at: 57, length: 1 }".to_owned(),
                format!("Frame {{ at: 58, frame: Rtcm({payload:?}) }}"),
                "Garbage { at: 83, length: 7 }".to_owned(),
            ]
        );
        let bytewise: Vec<&[u8]> = all.chunks(1).collect();
        let whole = |found: &[String]| {
            let frames = found.iter().filter(|scan| scan.starts_with("Frame"));
            frames.cloned().collect::<Vec<_>>()
        };
        assert_eq!(whole(&scans(&bytewise)), whole(&found));
    }

    #[test]
    fn a_frame_inside_a_broken_one_is_found() {
        // A preamble that announces 1023 bytes, a sync that announces 200, and a frame behind.
        let broken = [[0xd3, 0x03, 0xff].as_slice(), &[0xb5, 0x62, 1, 7, 200, 0], &UBX].concat();
        assert!(scans(&[&broken]).last().unwrap().contains("id: 4"));
        let mut wrong = UBX;
        wrong[7] ^= 1;
        let found = scans(&[&wrong, &UBX]);
        assert_eq!(found[0], "Broken { at: 0, is_ubx: true }");
        assert!(found[2].contains("Frame { at: 10"));
    }
    /// The checks of [`FrameBuffer`] by the plain method, which sums each possible frame.
    fn plain(rest: &[u8]) -> Candidate {
        let announced = match rest[0] {
            RTCM_PREAMBLE => rtcm(rest),
            first if first == UBX_SYNC[0] => ubx(rest),
            b'$' => return plain_nmea(rest),
            _ => Candidate::NoFrame,
        };
        let Candidate::Whole(length) = announced else { return announced };
        let frame = &rest[..length];
        let is_sound =
            if rest[0] == RTCM_PREAMBLE { crc24q(frame) == 0 } else { is_ubx_sound(frame) };
        if is_sound { announced } else { Candidate::WrongChecksum }
    }

    fn plain_nmea(rest: &[u8]) -> Candidate {
        let sentence = &rest[1..rest.len().min(NMEA_LIMIT)];
        let Some(star) = sentence.iter().position(|byte| *byte == b'*' || !is_text(*byte)) else {
            let is_long = NMEA_LIMIT <= rest.len();
            return if is_long { Candidate::NoFrame } else { Candidate::Incomplete };
        };
        let xor = sentence[..star].iter().fold(0, |xor, byte| xor ^ byte);
        let end = format!("*{xor:02X}\r\n").into_bytes();
        let tail = &rest[star + 1..];
        let length = tail.len().min(end.len());
        match tail[..length].eq_ignore_ascii_case(&end[..length]) {
            false => Candidate::NoFrame,
            true if length < end.len() => Candidate::Incomplete,
            true => Candidate::Whole(star + 1 + end.len()),
        }
    }

    /// As [`scans`], by the plain method.
    fn plain_scans(parts: &[&[u8]]) -> Vec<String> {
        let (mut bytes, mut at, mut found) = (Vec::new(), 0, Vec::new());
        let ends = parts.iter().map(|_| false).chain([true]);
        for (part, is_end) in parts.iter().copied().chain([[].as_slice()]).zip(ends) {
            bytes.extend_from_slice(part);
            while at < bytes.len() {
                let (rest, first) = (&bytes[at..], at as u64);
                let (scan, length) = match plain(rest) {
                    Candidate::Whole(length) => {
                        (Scan::Frame { at: first, frame: frame(&rest[..length]) }, length)
                    }
                    Candidate::Incomplete if !is_end => break,
                    Candidate::WrongChecksum => {
                        (Scan::Broken { at: first, is_ubx: rest[0] == UBX_SYNC[0] }, 1)
                    }
                    Candidate::Incomplete | Candidate::NoFrame => {
                        let next = memchr3(RTCM_PREAMBLE, UBX_SYNC[0], b'$', &rest[1..]);
                        let length = next.map_or(rest.len(), |next| next + 1);
                        (Scan::Garbage { at: first, length }, length)
                    }
                };
                found.push(format!("{scan:?}"));
                at += length;
            }
        }
        found
    }

    fn ubx_frame(payload: &[u8]) -> Vec<u8> {
        let length = (payload.len() as u16).to_le_bytes();
        let mut frame = [&[0xb5, 0x62, 0x02, 0x15], length.as_slice(), payload].concat();
        let sum = frame[2..].iter().fold(Fletcher::EMPTY, |sum, byte| sum.after(*byte));
        frame.extend([sum.a, sum.b]);
        frame
    }

    fn rtcm_frame(payload: &[u8]) -> Vec<u8> {
        let length = (payload.len() as u16).to_be_bytes();
        let mut frame = [&[0xd3], length.as_slice(), payload].concat();
        frame.extend_from_slice(&crc24q(&frame).to_be_bytes()[1..]);
        frame
    }

    fn nmea_frame(text: &str) -> Vec<u8> {
        let xor = text.bytes().fold(0, |xor, byte| xor ^ byte);
        format!("${text}*{xor:02x}\r\n").into_bytes()
    }

    /// Bytes that occur in the beginnings and ends of frames.
    const SIGNS: [u8; 12] = [0xb5, 0x62, 0xd3, 0, 1, 3, 0x20, b'$', b'*', b'4', b'\r', b'\n'];

    fn part() -> impl Strategy<Value = Vec<u8>> {
        let bytes = |most: usize| collection::vec(any::<u8>(), 0..most);
        let signs = |most: usize| collection::vec(sample::select(SIGNS.to_vec()), 0..most);
        prop_oneof![
            bytes(300).prop_map(|payload| ubx_frame(&payload)),
            signs(300).prop_map(|payload| ubx_frame(&payload)),
            bytes(600).prop_map(|payload| rtcm_frame(&payload)),
            signs(600).prop_map(|payload| rtcm_frame(&payload)),
            "[ -)+-~]{0,300}".prop_map(|text| nmea_frame(&text)),
            bytes(50),
            signs(400),
        ]
    }

    proptest! {
        /// The same frames, broken frames and garbage as by the plain method, in damaged streams
        /// that arrive in parts of any length.
        #[test]
        fn sums_of_beginnings_find_the_same_frames(
            parts in collection::vec(part(), 1..12),
            damage in collection::vec((any::<sample::Index>(), sample::select(SIGNS.to_vec())), 0..8),
            lengths in collection::vec(1_usize..900, 1..8),
        ) {
            let mut stream = parts.concat();
            for (index, byte) in damage {
                if !stream.is_empty() {
                    let index = index.index(stream.len());
                    stream[index] = byte;
                }
            }
            let (mut arriving, mut rest) = (Vec::new(), &*stream);
            for length in lengths.iter().cycle() {
                let (part, later) = rest.split_at(rest.len().min(*length));
                arriving.push(part);
                rest = later;
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert_eq!(scans(&arriving), plain_scans(&arriving));
        }
    }

    /// Bytes that were summed or searched for each byte of a stream that repeats `unit`.
    fn work_per_byte(unit: &[u8]) -> f64 {
        let stream = unit.repeat((1 << 18) / unit.len());
        let mut buffer = FrameBuffer::new();
        for part in stream.chunks(1 << 16) {
            buffer.push(part);
            while buffer.next(false).is_some() {}
        }
        while buffer.next(true).is_some() {}
        buffer.work as f64 / stream.len() as f64
    }

    /// No bytes cost much more than a real stream, in which each byte is summed once. By the plain
    /// method the first of these streams costs 1368 sums for each byte.
    #[test]
    fn the_work_for_a_byte_is_bounded() {
        let sentence = [[b'$'; 200].as_slice(), b"*24\r\n"].concat();
        let hostile: [&[u8]; 8] = [
            &[0xb5, 0x62, 0x02, 0x15, 0x00, 0x20],
            &[0xd3, 0x03],
            &[0xb5, 0x62, 0xd3, 0x00, 0x00, 0x20],
            &[0xd3, 0x03, 0xb5, 0x62, 0x01, 0x00, 0x00, 0x1f],
            b"$",
            &sentence,
            b"$ $*",
            &[b'$', 0xd3, 0x00, 0xd3, 0x03, 0xb5, 0x62, 0xb5, 0x62, 0x00, 0x08],
        ];
        for unit in hostile {
            let work = work_per_byte(unit);
            assert!(work <= 5.0, "{work} for {unit:x?}");
        }
        for unit in [ubx_frame(&[7; 500]), rtcm_frame(&[7; 500]), nmea_frame("GPGLL")] {
            assert!(work_per_byte(&unit) <= 1.0);
        }
    }
}
