//! Conversion between bytes and the vocabulary; takes readers and writers, opens nothing.

pub mod antex;
mod binary;
mod broadcast;
mod csv;
mod damage;
mod decimal;
mod encoder;
pub mod geoid;
mod geojson;
pub mod gnss_logger;
mod gpx;
mod gunzip;
mod kml;
mod nmea;
pub mod observations;
pub mod odometry;
#[cfg(feature = "parquet")]
mod parquet;
pub mod pos;
pub mod receiver;
pub mod result;
pub mod rinex;
mod rtcm;
pub(crate) mod skipped;
pub mod track;
pub mod truth;
mod ubx;
mod unpack;

use std::io::{BufRead, Chain, Cursor, Read, Result};

pub use damage::{DamageReport, GzipDamage, WholeLines};
pub(crate) use gunzip::Gunzip;
use gunzip::GunzipReader;
pub use gunzip::{GunzipError, read_block};
pub use unpack::{UnpackError, check_ratio, unpack_error, unpack_reader_within, unpack_within};

/// First bytes of a gzip member; RFC 1952, 2.3.1.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// The bytes of `input`, inflated if they begin as gzip does.
///
/// The content decides, not the file name. One block and one window are held, for input of any
/// length. The content before an error is read first; where the gzip data are cut off or damaged,
/// the error has a [`GunzipError`] inside.
pub fn decompress<R: BufRead>(mut input: R) -> impl BufRead {
    let mut head = Vec::with_capacity(GZIP_MAGIC.len());
    // An error here occurs again, and is reported, when the caller reads on.
    let _ = input.by_ref().take(GZIP_MAGIC.len() as u64).read_to_end(&mut head);
    let is_gzip = head == GZIP_MAGIC;
    let whole = Cursor::new(head).chain(input);
    if is_gzip {
        Decompressed::Gzip(Box::new(GunzipReader::new(whole)))
    } else {
        Decompressed::Plain(whole)
    }
}

type Whole<R> = Chain<Cursor<Vec<u8>>, R>;

enum Decompressed<R> {
    Plain(Whole<R>),
    Gzip(Box<GunzipReader<Whole<R>>>),
}

impl<R: BufRead> Read for Decompressed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        match self {
            Self::Plain(input) => input.read(buffer),
            Self::Gzip(input) => input.read(buffer),
        }
    }
}

impl<R: BufRead> BufRead for Decompressed<R> {
    fn fill_buf(&mut self) -> Result<&[u8]> {
        match self {
            Self::Plain(input) => input.fill_buf(),
            Self::Gzip(input) => input.fill_buf(),
        }
    }

    fn consume(&mut self, amount: usize) {
        match self {
            Self::Plain(input) => input.consume(amount),
            Self::Gzip(input) => input.consume(amount),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn read(bytes: &[u8]) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        decompress(bytes).read_to_end(&mut out).map(|_| out)
    }

    #[test]
    fn gzip_members_are_joined_and_other_bytes_pass() {
        let mut packed = Vec::new();
        for part in [b"first ".as_slice(), b"second"] {
            let mut encoder = flate2::write::GzEncoder::new(&mut packed, Default::default());
            encoder.write_all(part).unwrap();
            encoder.finish().unwrap();
        }
        assert_eq!(read(&packed).unwrap(), b"first second");
        for plain in [b"".as_slice(), b"\x1f", b"\x1f\x9dZ", b"text"] {
            assert_eq!(read(plain).unwrap(), plain);
        }
        assert!(read(&packed[..packed.len() - 3]).is_err(), "a cut member passed");
    }
}
