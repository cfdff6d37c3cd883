//! Files whose gzip stream is cut off or damaged: they are read up to there.

use std::fmt;
use std::io::{BufRead, Error, ErrorKind, Read, Result};
use std::sync::{Arc, OnceLock};

use super::GunzipError;
use super::gunzip::read_block;

/// Where and why the gzip stream of a file ends early.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GzipDamage {
    /// Number of bytes unpacked before.
    pub unpacked_bytes: u64,
    /// What is wrong with the stream; `None` if it is cut off.
    pub why: Option<String>,
}

impl GzipDamage {
    /// What the user can do about it.
    pub(crate) const REMEDY: &str = "pack the file with gzip again, or fetch it again";

    /// The damage that an error of a reader reports; `None` for other errors.
    fn of(error: &Error, unpacked_bytes: u64) -> Option<Self> {
        let GunzipError { why, .. } = GunzipError::of(error)?;
        let is_cut = error.kind() == ErrorKind::UnexpectedEof;
        Some(Self { unpacked_bytes, why: (!is_cut).then(|| why.clone()) })
    }
}

impl fmt::Display for GzipDamage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { unpacked_bytes, why } = self;
        match why {
            None => write!(f, "the gzip stream is cut off after {unpacked_bytes} unpacked bytes"),
            Some(why) => {
                write!(
                    f,
                    "the gzip stream is damaged after {unpacked_bytes} unpacked bytes ({why})"
                )
            }
        }
    }
}

/// The damage that a reader has met, for those who report on the file.
#[derive(Clone, Debug, Default)]
pub struct DamageReport(Arc<OnceLock<GzipDamage>>);

impl DamageReport {
    /// The damage; `None` if the reader has met none so far.
    pub fn get(&self) -> Option<&GzipDamage> {
        self.0.get()
    }
}

/// The bytes of a file, which ends where its gzip stream is cut off or damaged. All other errors
/// are passed on: those of the disk, and the limits of unpacking.
#[derive(Debug)]
pub(super) struct UntilDamage<R> {
    input: R,
    /// Number of bytes read.
    read: u64,
    report: DamageReport,
}

impl<R: BufRead> UntilDamage<R> {
    pub(super) fn new(input: R) -> Self {
        Self { input, read: 0, report: DamageReport::default() }
    }

    /// The report, which has the damage once the reader has met it.
    pub(super) fn report(&self) -> DamageReport {
        self.report.clone()
    }
}

impl<R: BufRead> BufRead for UntilDamage<R> {
    fn fill_buf(&mut self) -> Result<&[u8]> {
        let Self { input, read, report } = self;
        match input.fill_buf() {
            Ok(block) => Ok(block),
            Err(error) => {
                let damage = GzipDamage::of(&error, *read).ok_or(error)?;
                report.0.get_or_init(|| damage);
                Ok(&[])
            }
        }
    }

    fn consume(&mut self, amount: usize) {
        self.read += amount as u64;
        self.input.consume(amount);
    }
}

impl<R: BufRead> Read for UntilDamage<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        read_block(self, buffer)
    }
}

/// The lines of a text, up to the last whole one where its gzip stream is cut off: a number that is
/// cut off is another number.
///
/// A damaged stream is an error: what is before the damage may have errors that nothing shows. All
/// other errors are passed on, too.
#[derive(Debug)]
pub struct WholeLines<R> {
    input: R,
    /// Number of bytes read from the input.
    read: u64,
    lines: Vec<u8>,
    /// Index of the first byte of `lines` that is not consumed.
    next: usize,
    /// The beginning of a line whose end is not read yet.
    begun: Vec<u8>,
    report: DamageReport,
}

/// Longer beginnings of lines are given as they are (bytes): the reader refuses such lines.
const BEGUN_BYTES_MAX: usize = 1 << 16;

impl<R: BufRead> WholeLines<R> {
    /// The lines of `input`.
    pub fn new(input: R) -> Self {
        let (lines, begun, report) = (Vec::new(), Vec::new(), DamageReport::default());
        Self { input, read: 0, lines, next: 0, begun, report }
    }

    /// The report, which has the cut once the reader has met it.
    pub fn report(&self) -> DamageReport {
        self.report.clone()
    }

    /// Reads the next lines, perhaps none; false at the end.
    fn advance(&mut self) -> Result<bool> {
        self.lines.clear();
        self.next = 0;
        let block = match self.input.fill_buf() {
            Ok(block) => block,
            Err(error) => {
                let damage = GzipDamage::of(&error, self.read);
                let cut = damage.filter(|damage| damage.why.is_none()).ok_or(error)?;
                self.report.0.get_or_init(|| cut);
                return Ok(false);
            }
        };
        let length = block.len();
        let is_given = length == 0 || BEGUN_BYTES_MAX < self.begun.len();
        let end = match memchr::memrchr(b'\n', block) {
            Some(last) => last + 1,
            None if is_given => length,
            None => 0,
        };
        if 0 < end || is_given {
            self.lines.append(&mut self.begun);
            self.lines.extend_from_slice(&block[..end]);
        }
        self.begun.extend_from_slice(&block[end..]);
        self.read += length as u64;
        self.input.consume(length);
        Ok(0 < length || !self.lines.is_empty())
    }
}

impl<R: BufRead> BufRead for WholeLines<R> {
    fn fill_buf(&mut self) -> Result<&[u8]> {
        while self.next == self.lines.len() && self.advance()? {}
        Ok(&self.lines[self.next..])
    }

    fn consume(&mut self, amount: usize) {
        self.next = self.lines.len().min(self.next + amount);
    }
}

impl<R: BufRead> Read for WholeLines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        read_block(self, buffer)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;
    use crate::formats::{UnpackError, decompress, unpack_error, unpack_within};

    fn gzip(content: &[u8]) -> Vec<u8> {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        packer.write_all(content).unwrap();
        packer.finish().unwrap()
    }

    /// The content up to the damage, and the damage.
    fn read(input: impl BufRead) -> Result<(Vec<u8>, Option<GzipDamage>)> {
        let mut reader = UntilDamage::new(input);
        let mut content = Vec::new();
        reader.read_to_end(&mut content)?;
        let damage = reader.report().get().cloned();
        Ok((content, damage))
    }

    fn text() -> Vec<u8> {
        (0..60_000_u32).flat_map(|n| (n * n % 977).to_string().into_bytes()).collect()
    }

    #[test]
    fn a_stream_that_is_cut_off_is_read_to_its_end() {
        let (text, packed) = (text(), gzip(&text()));
        assert_eq!(read(decompress(&*packed)).unwrap(), (text.clone(), None));
        assert_eq!(read(&*text).unwrap(), (text.clone(), None));
        let mut before = 0;
        for length in [2, 3, 12, 500, packed.len() / 2, packed.len() - 9, packed.len() - 1] {
            let (content, damage) = read(decompress(&packed[..length])).unwrap();
            assert_eq!(content, text[..content.len()]);
            assert!(before <= content.len(), "{length}");
            before = content.len();
            let damage = damage.unwrap();
            assert_eq!(damage, GzipDamage { unpacked_bytes: before as u64, why: None });
            let expected = format!("the gzip stream is cut off after {before} unpacked bytes");
            assert_eq!(damage.to_string(), expected);
        }
        assert_eq!(before, text.len(), "the last bytes cut off are the checksum and the length");
    }

    /// What is unpacked before the damage is found is read, also of the block that has it.
    #[test]
    fn a_damaged_stream_is_read_up_to_the_damage() {
        let text = text();
        let (first, second) = text.split_at(1000);
        let mut packed = [gzip(first), gzip(second)].concat();
        let start = gzip(first).len();
        packed[start] ^= 1;
        let (content, damage) = read(decompress(&*packed)).unwrap();
        assert_eq!(content, first);
        let damage = damage.unwrap();
        assert_eq!(damage.unpacked_bytes, 1000);
        assert!(damage.to_string().contains("damaged after 1000 unpacked bytes ("), "{damage}");

        let mut packed = gzip(&text);
        let checksum = packed.len() - 8;
        packed[checksum] ^= 1;
        let (content, damage) = read(decompress(&*packed)).unwrap();
        assert_eq!(content, text);
        let damage = damage.unwrap();
        assert_eq!(damage.unpacked_bytes, text.len() as u64);
        assert!(damage.to_string().ends_with("incorrect data check)"), "{damage}");
    }

    /// The text of a reader of lines, and its cut.
    fn lines(input: impl BufRead) -> Result<(Vec<u8>, Option<GzipDamage>)> {
        let mut reader = WholeLines::new(input);
        let mut content = Vec::new();
        reader.read_to_end(&mut content)?;
        let damage = reader.report().get().cloned();
        Ok((content, damage))
    }

    fn rows() -> Vec<u8> {
        (0..20_000_u32).flat_map(|n| format!("{}\n", n * n % 977).into_bytes()).collect()
    }

    #[test]
    fn a_text_that_is_cut_off_packed_ends_with_a_whole_line() {
        let unended = [&rows()[..], b"no end"].concat();
        for text in [rows(), unended, b"short".to_vec(), Vec::new()] {
            let packed = gzip(&text);
            assert_eq!(lines(decompress(&*packed)).unwrap(), (text.clone(), None));
            assert_eq!(lines(&*text).unwrap(), (text.clone(), None));
            let by_bytes = std::io::BufReader::with_capacity(1, &*text);
            assert_eq!(lines(by_bytes).unwrap(), (text.clone(), None));
            for length in [2, 12, packed.len() / 2, packed.len() - 9, packed.len() - 1] {
                let cut = &packed[..length.min(packed.len() - 1)];
                let (unpacked, damage) = read(decompress(cut)).unwrap();
                let end = unpacked.iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
                assert_eq!(lines(decompress(cut)).unwrap(), (text[..end].to_vec(), damage));
            }
        }
        let endless = vec![b' '; 1 << 20];
        assert_eq!(lines(&*endless).unwrap().0.len(), endless.len());
        let mut reader = WholeLines::new(std::io::BufReader::new(std::io::repeat(b' ')));
        assert!(reader.fill_buf().unwrap().len() < 4 * BEGUN_BYTES_MAX);
    }

    #[test]
    fn a_text_of_a_damaged_stream_is_an_error_with_its_byte() {
        let (first, second) = (gzip(&rows()), gzip(b"second\n"));
        let mut packed = [&first[..], &second].concat();
        packed[first.len()] ^= 1;
        let error = lines(decompress(&*packed)).unwrap_err();
        let offset = GunzipError::of(&error).unwrap().offset;
        let header = first.len() as u64..=first.len() as u64 + 10;
        assert!(header.contains(&offset), "{offset} of {header:?}");

        let error = lines(unpack_within(&first, 1000)).unwrap_err();
        assert_eq!(unpack_error(&error), Some(UnpackError::TooLarge { limit: 1000 }));
    }

    #[test]
    fn other_errors_are_passed_on() {
        struct Broken;
        impl Read for Broken {
            fn read(&mut self, _: &mut [u8]) -> Result<usize> {
                Err(ErrorKind::InvalidData.into())
            }
        }
        let packed = gzip(&text());
        let disk = packed[..packed.len() / 2].chain(std::io::BufReader::new(Broken));
        let error = read(decompress(disk)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidData);

        let limit = 1000;
        let error = read(unpack_within(&packed[..packed.len() / 2], limit)).unwrap_err();
        assert_eq!(unpack_error(&error), Some(UnpackError::TooLarge { limit }));
        let bomb = gzip(&vec![b' '; 64 << 20]);
        let error = read(unpack_within(&bomb[..bomb.len() - 9], 128 << 20)).unwrap_err();
        assert!(matches!(unpack_error(&error), Some(UnpackError::Ratio { .. })), "{error}");
    }
}
