//! Gzip data that arrives in chunks of any size, or is read. Source: RFC 1952, section 2.2
//! (members).

use std::io::{BufRead, Error, ErrorKind, Read};

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
    /// Number of packed bytes before it is found.
    pub offset: u64,
}

impl GunzipError {
    /// The error of the gzip data that an error of a reader reports; `None` for other errors.
    pub fn of(error: &Error) -> Option<&Self> {
        error.get_ref()?.downcast_ref()
    }
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
    /// Number of packed bytes so far.
    taken: u64,
}

impl Gunzip {
    /// A decoder before the first byte.
    pub(crate) fn new() -> Self {
        Self { member: Decompress::new_gzip(WINDOW_BITS), is_between: true, taken: 0 }
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
            if self.is_between && packed.is_empty() {
                return Ok(());
            }
            let Step { read, written, outcome } = self.step(packed, &mut block);
            outcome?;
            packed = &packed[read..];
            take(&block[..written])?;
            // A block that is not full means that the bytes so far give no more output.
            if !self.is_between && packed.is_empty() && written < block.len() {
                return Ok(());
            }
        }
    }

    /// Unpacks bytes into `block`, up to the end of a member. Between two members there must be
    /// some.
    fn step(&mut self, packed: &[u8], block: &mut [u8]) -> Step {
        if self.is_between {
            *self = Self { is_between: false, taken: self.taken, ..Self::new() };
        }
        let (bytes_in, bytes_out) = (self.member.total_in(), self.member.total_out());
        let status = self.member.decompress(packed, block, FlushDecompress::None);
        let read = (self.member.total_in() - bytes_in) as usize;
        let written = (self.member.total_out() - bytes_out) as usize;
        self.taken += read as u64;
        let outcome = match status {
            Ok(status) => {
                self.is_between = status == Status::StreamEnd;
                let is_stuck = !packed.is_empty() && read == 0 && written == 0;
                let why = "its content cannot be unpacked";
                if is_stuck && !self.is_between { Err(why.to_owned()) } else { Ok(()) }
            }
            Err(error) => Err(error.to_string()),
        };
        let outcome = outcome.map_err(|why| GunzipError { why, offset: self.taken });
        Step { read, written, outcome }
    }

    /// Whether the data so far ends at the end of a member.
    pub(crate) const fn is_whole(&self) -> bool {
        self.is_between
    }
}

/// What one step has read and written, also before an error.
struct Step {
    /// Packed bytes.
    read: usize,
    /// Unpacked bytes.
    written: usize,
    outcome: Result<(), GunzipError>,
}

/// Reads gzip data unpacked. The content up to an error is read before the error is returned.
///
/// Data that are cut off or damaged are an error with a [`GunzipError`] inside, of the kind
/// `UnexpectedEof` where they are cut off. Other errors are those of `packed`.
#[derive(Debug)]
pub(super) struct GunzipReader<R> {
    packed: R,
    gunzip: Gunzip,
    block: Vec<u8>,
    /// Index of the first unpacked byte in `block` that is not consumed.
    next: usize,
    /// Index after the last one.
    end: usize,
    /// The error after these bytes.
    failure: Option<(ErrorKind, GunzipError)>,
}

impl<R: BufRead> GunzipReader<R> {
    pub(super) fn new(packed: R) -> Self {
        let block = vec![0; BLOCK_BYTES];
        Self { packed, gunzip: Gunzip::new(), block, next: 0, end: 0, failure: None }
    }

    /// Unpacks the next bytes, perhaps none; false at the end.
    fn unpack(&mut self) -> Result<bool, Error> {
        if let Some((kind, error)) = &self.failure {
            return Err(Error::new(*kind, error.clone()));
        }
        let packed = self.packed.fill_buf()?;
        let is_end = packed.is_empty();
        if is_end && self.gunzip.is_whole() {
            return Ok(false);
        }
        let Step { read, written, outcome } = self.gunzip.step(packed, &mut self.block);
        self.packed.consume(read);
        (self.next, self.end) = (0, written);
        if let Err(error) = outcome {
            self.failure = Some((ErrorKind::InvalidData, error));
        } else if is_end && written == 0 && !self.gunzip.is_whole() {
            let why = "the data are cut off".to_owned();
            let cut = GunzipError { why, offset: self.gunzip.taken };
            self.failure = Some((ErrorKind::UnexpectedEof, cut));
        }
        Ok(true)
    }
}

impl<R: BufRead> BufRead for GunzipReader<R> {
    fn fill_buf(&mut self) -> Result<&[u8], Error> {
        while self.next == self.end && self.unpack()? {}
        Ok(&self.block[self.next..self.end])
    }

    fn consume(&mut self, amount: usize) {
        self.next = self.end.min(self.next + amount);
    }
}

/// Reads by the blocks of a buffered reader.
///
/// # Errors
/// The reader fails.
pub fn read_block(reader: &mut impl BufRead, buffer: &mut [u8]) -> Result<usize, Error> {
    let length = reader.fill_buf()?.read(buffer)?;
    reader.consume(length);
    Ok(length)
}

impl<R: BufRead> Read for GunzipReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Error> {
        read_block(self, buffer)
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
