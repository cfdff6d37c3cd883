//! Gzip data that arrives in chunks of any size. Source: RFC 1952, section 2.2 (members).

use flate2::{Decompress, FlushDecompress, Status};

/// Size of deflate's window as a power of two (bytes), the largest one.
const WINDOW_BITS: u8 = 15;
const BLOCK_BYTES: usize = 1 << 16;

/// The bytes are not gzip, or damaged.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("gzip: {why}")]
pub struct GunzipError {
    /// What is wrong with the data.
    pub why: String,
}

/// Unpacks gzip data as it arrives, one member after another.
///
/// The result is independent of the size of the chunks: the output of the first n packed bytes is
/// complete once byte n has arrived.
#[derive(Debug)]
pub(crate) struct Gunzip {
    member: Decompress,
    /// Whether no byte of the next member has arrived.
    is_between: bool,
}

impl Gunzip {
    /// A decoder before the first byte.
    pub(crate) fn new() -> Self {
        Self { member: Decompress::new_gzip(WINDOW_BITS), is_between: true }
    }

    /// Unpacks the next bytes and passes the output to `take`, in blocks of up to 64 kB.
    ///
    /// # Errors
    /// Damaged bytes, and the errors of `take`.
    pub(crate) fn push<E: From<GunzipError>>(
        &mut self,
        mut packed: &[u8],
        mut take: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut block = vec![0; BLOCK_BYTES];
        loop {
            if self.is_between {
                if packed.is_empty() {
                    return Ok(());
                }
                *self = Self { is_between: false, ..Self::new() };
            }
            let (read, written) = (self.member.total_in(), self.member.total_out());
            let before = packed.len();
            let status = self.member.decompress(packed, &mut block, FlushDecompress::None);
            let status = status.map_err(|error| GunzipError { why: error.to_string() })?;
            packed = &packed[(self.member.total_in() - read) as usize..];
            let length = (self.member.total_out() - written) as usize;
            take(&block[..length])?;
            self.is_between = status == Status::StreamEnd;
            // A block that is not full means that the bytes so far give no more output.
            if !self.is_between && packed.is_empty() && length < block.len() {
                return Ok(());
            }
            if !self.is_between && packed.len() == before && length == 0 {
                return Err(GunzipError { why: "its content cannot be unpacked".to_owned() }.into());
            }
        }
    }

    /// Whether the data so far ends at the end of a member.
    pub(crate) const fn is_whole(&self) -> bool {
        self.is_between
    }
}

impl Default for Gunzip {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn member(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn push(gunzip: &mut Gunzip, packed: &[u8], text: &mut Vec<u8>) -> Result<(), GunzipError> {
        gunzip.push(packed, |block| {
            text.extend_from_slice(block);
            Ok(())
        })
    }

    /// After each byte as much is given as those before it give at once: a stream that is read
    /// again from its beginning is where it was.
    #[test]
    fn so_many_bytes_give_the_same_however_split() {
        let text: Vec<u8> =
            (0..40_000_u32).flat_map(|n| (n * n % 977).to_string().into_bytes()).collect();
        let packed = [member(&text), member(b""), member(&text[..70_000].repeat(3))].concat();
        let (mut gunzip, mut found) = (Gunzip::new(), Vec::new());
        for (index, byte) in packed.iter().enumerate() {
            push(&mut gunzip, &[*byte], &mut found).unwrap();
            if index % 997 == 0 || packed.len() - index < 20 {
                let (mut other, mut at_once) = (Gunzip::new(), Vec::new());
                push(&mut other, &packed[..=index], &mut at_once).unwrap();
                assert_eq!((found.len(), gunzip.is_whole()), (at_once.len(), other.is_whole()));
            }
        }
        assert_eq!(found, [&text[..], &text[..70_000].repeat(3)].concat());
        assert!(gunzip.is_whole());
    }

    #[test]
    fn damaged_bytes_are_refused() {
        let whole = member(b"some text that is packed");
        for at in [0, 2, whole.len() - 6, whole.len() - 1] {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x55;
            let mut text = Vec::new();
            let outcome = push(&mut Gunzip::new(), &damaged, &mut text);
            assert!(outcome.is_err(), "byte {at}");
        }
        let garbage = [&whole[..], b"behind"].concat();
        assert!(push(&mut Gunzip::new(), &garbage, &mut Vec::new()).is_err());
    }
}
