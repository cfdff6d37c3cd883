//! Finds frames in a byte stream and checks that they are complete.

use memchr::memchr3;

use crate::formats::binary::crc24q;

const RTCM_PREAMBLE: u8 = 0xd3;
const RTCM_HEADER_BYTES: usize = 3;
const RTCM_CRC_BYTES: usize = 3;
/// The six reserved bits between preamble and length, which are zero.
const RTCM_RESERVED: u8 = 0xfc;
const UBX_SYNC: [u8; 2] = [0xb5, 0x62];
const UBX_HEADER_BYTES: usize = 6;
const UBX_CHECKSUM_BYTES: usize = 2;
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
#[derive(Debug)]
pub(super) struct FrameBuffer {
    bytes: Vec<u8>,
    /// Index of the first byte where the next frame may begin.
    start: usize,
    /// Number of bytes of the stream before `bytes`.
    dropped: u64,
}

impl FrameBuffer {
    pub(super) const fn new() -> Self {
        Self { bytes: Vec::new(), start: 0, dropped: 0 }
    }

    /// Appends bytes and drops those of previous frames.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.dropped += self.start as u64;
        self.bytes.drain(..self.start);
        self.start = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The next frame or garbage; `None` if more bytes are needed.
    ///
    /// With `is_end` no bytes follow, so that an incomplete frame is garbage.
    pub(super) fn next(&mut self, is_end: bool) -> Option<Scan<'_>> {
        let from = self.start;
        let rest = self.bytes.get(from..).filter(|rest| !rest.is_empty())?;
        let at = self.dropped + from as u64;
        match candidate(rest) {
            Candidate::Whole(length) => {
                self.start += length;
                let frame = frame(&self.bytes[from..from + length]);
                Some(Scan::Frame { at, frame })
            }
            Candidate::Incomplete if !is_end => None,
            Candidate::WrongChecksum => {
                self.start += 1;
                Some(Scan::Broken { at, is_ubx: rest[0] == UBX_SYNC[0] })
            }
            Candidate::Incomplete | Candidate::NoFrame => {
                let next = memchr3(RTCM_PREAMBLE, UBX_SYNC[0], b'$', &rest[1..]);
                let length = next.map_or(rest.len(), |next| next + 1);
                self.start += length;
                Some(Scan::Garbage { at, length })
            }
        }
    }
}

fn candidate(rest: &[u8]) -> Candidate {
    match rest[0] {
        RTCM_PREAMBLE => rtcm(rest),
        first if first == UBX_SYNC[0] => ubx(rest),
        b'$' => nmea(rest),
        _ => Candidate::NoFrame,
    }
}

fn rtcm(rest: &[u8]) -> Candidate {
    match *rest {
        [_, second, ..] if second & RTCM_RESERVED != 0 => Candidate::NoFrame,
        [_, second, third, ..] => {
            let payload = usize::from(second & 3) << 8 | usize::from(third);
            match rest.get(..RTCM_HEADER_BYTES + payload + RTCM_CRC_BYTES) {
                None => Candidate::Incomplete,
                Some(frame) if crc24q(frame) == 0 => Candidate::Whole(frame.len()),
                Some(_) => Candidate::WrongChecksum,
            }
        }
        _ => Candidate::Incomplete,
    }
}

fn ubx(rest: &[u8]) -> Candidate {
    match *rest {
        [_, second, ..] if second != UBX_SYNC[1] => Candidate::NoFrame,
        [_, _, _, _, low, high, ..] => {
            let payload = usize::from(u16::from_le_bytes([low, high]));
            if UBX_PAYLOAD_LIMIT < payload {
                return Candidate::NoFrame;
            }
            match rest.get(..UBX_HEADER_BYTES + payload + UBX_CHECKSUM_BYTES) {
                None => Candidate::Incomplete,
                Some(frame) if is_ubx_sound(frame) => Candidate::Whole(frame.len()),
                Some(_) => Candidate::WrongChecksum,
            }
        }
        _ => Candidate::Incomplete,
    }
}

/// Fletcher's checksum over class, id, length and payload; u-blox interface descriptions, 3.4.
fn is_ubx_sound(frame: &[u8]) -> bool {
    let (message, checksum) = frame.split_at(frame.len() - UBX_CHECKSUM_BYTES);
    let (mut a, mut b) = (0_u8, 0_u8);
    for byte in &message[UBX_SYNC.len()..] {
        a = a.wrapping_add(*byte);
        b = b.wrapping_add(a);
    }
    checksum == [a, b]
}

/// Checks for a sentence `$` … `*hh` with its line end.
fn nmea(rest: &[u8]) -> Candidate {
    let sentence = &rest[1..rest.len().min(NMEA_LIMIT)];
    let Some(star) = sentence.iter().position(|byte| *byte == b'*' || !is_text(*byte)) else {
        return if rest.len() < NMEA_LIMIT { Candidate::Incomplete } else { Candidate::NoFrame };
    };
    if sentence[star] != b'*' {
        return Candidate::NoFrame;
    }
    let xor = sentence[..star].iter().fold(0, |xor, byte| xor ^ byte);
    let end = format!("{xor:02X}\r\n").into_bytes();
    let tail = &rest[star + 2..];
    let length = tail.len().min(end.len());
    if !tail[..length].eq_ignore_ascii_case(&end[..length]) {
        Candidate::NoFrame
    } else if length < end.len() {
        Candidate::Incomplete
    } else {
        Candidate::Whole(star + 2 + end.len())
    }
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
}
