//! Files of others, unpacked within limits while they are read.

use std::io::{BufRead, Error, Read, Result};

use super::gunzip::read_block;
use super::{GZIP_MAGIC, decompress};

/// Unpacked content may be this many times larger than packed. RINEX packs to a fifth, and text
/// that repeats itself to a thirtieth.
const PACKED_RATIO_MAX: u64 = 100;
/// Unpacked content up to this size may have any ratio (bytes).
const ANY_RATIO_BYTES: u64 = 1 << 20;

/// Why a file is not read to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnpackError {
    /// The unpacked content is larger than allowed.
    #[error("unpacked, the file exceeds {limit} bytes")]
    TooLarge {
        /// Size allowed (bytes).
        limit: u64,
    },
    /// The content is packed too much.
    #[error(
        "{packed} packed bytes unpack to more than {unpacked}; the ratio is at most \
         {PACKED_RATIO_MAX}"
    )]
    Ratio {
        /// Size as received (bytes).
        packed: u64,
        /// Size unpacked so far (bytes).
        unpacked: u64,
    },
}

/// Checks the ratio of unpacked to packed content.
///
/// # Errors
/// [`UnpackError::Ratio`].
pub fn check_ratio(packed: u64, unpacked: u64) -> std::result::Result<(), UnpackError> {
    let allowed = packed.saturating_mul(PACKED_RATIO_MAX).max(ANY_RATIO_BYTES);
    if unpacked <= allowed { Ok(()) } else { Err(UnpackError::Ratio { packed, unpacked }) }
}

/// The bytes of a file, unpacked if it is gzip. Reading fails with an [`UnpackError`] inside the
/// error of the reader where the content exceeds `limit` bytes or the largest ratio.
pub fn unpack_within(content: &[u8], limit: u64) -> impl BufRead {
    let packed = content.starts_with(&GZIP_MAGIC).then_some(content.len() as u64);
    Bounded { input: decompress(content), packed, limit, read: 0 }
}

/// The [`UnpackError`] inside an error of a reader.
pub fn unpack_error(error: &Error) -> Option<UnpackError> {
    error.get_ref()?.downcast_ref().copied()
}

/// The same of a file that is read from a reader, and has `length` bytes.
///
/// # Errors
/// Its first bytes cannot be read.
pub fn unpack_reader_within(
    mut input: impl BufRead,
    length: u64,
    limit: u64,
) -> Result<impl BufRead> {
    let packed = input.fill_buf()?.starts_with(&GZIP_MAGIC).then_some(length);
    Ok(Bounded { input: decompress(input), packed, limit, read: 0 })
}

struct Bounded<R> {
    input: R,
    /// Size of the file as received, if it is packed.
    packed: Option<u64>,
    limit: u64,
    read: u64,
}

impl<R: BufRead> BufRead for Bounded<R> {
    fn fill_buf(&mut self) -> Result<&[u8]> {
        let Self { input, packed, limit, read } = self;
        let block = input.fill_buf()?;
        let unpacked = *read + block.len() as u64;
        if *limit < unpacked {
            return Err(Error::other(UnpackError::TooLarge { limit: *limit }));
        }
        if let Some(packed) = *packed {
            check_ratio(packed, unpacked).map_err(Error::other)?;
        }
        Ok(block)
    }

    fn consume(&mut self, amount: usize) {
        self.read += amount as u64;
        self.input.consume(amount);
    }
}

impl<R: BufRead> Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        read_block(self, buffer)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn gzip(content: &[u8]) -> Vec<u8> {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        packer.write_all(content).unwrap();
        packer.finish().unwrap()
    }

    fn unpacked(content: &[u8], limit: u64) -> std::result::Result<Vec<u8>, UnpackError> {
        let mut text = Vec::new();
        match unpack_within(content, limit).read_to_end(&mut text) {
            Ok(_) => Ok(text),
            Err(error) => Err(unpack_error(&error).unwrap()),
        }
    }

    #[test]
    fn content_is_bounded_in_size_and_ratio() {
        let text: Vec<u8> = (0..60_000_u32).flat_map(|n| n.to_string().into_bytes()).collect();
        let whole = text.len() as u64;
        for content in [text.clone(), gzip(&text)] {
            assert_eq!(unpacked(&content, whole).unwrap(), text);
            let limit = whole - 1;
            assert_eq!(unpacked(&content, limit), Err(UnpackError::TooLarge { limit }));
        }
        let bomb = unpacked(&gzip(&vec![b' '; 64 << 20]), 128 << 20).unwrap_err();
        assert!(matches!(bomb, UnpackError::Ratio { unpacked, .. } if unpacked < 8 << 20));
        assert_eq!(unpacked(&gzip(&[b' '; 900_000]), 1 << 20).unwrap().len(), 900_000);
    }
}
