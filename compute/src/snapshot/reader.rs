//! Bytes to values.

use super::SnapshotError;
use super::writer::HASH;

/// Reads a snapshot.
#[derive(Debug)]
pub struct SnapshotReader<'a> {
    bytes: &'a [u8],
    offset: usize,
}

impl<'a> SnapshotReader<'a> {
    /// Opens a snapshot of `layout`.
    ///
    /// # Errors
    /// It is of another layout, or its bytes are not those that were written.
    pub fn open(snapshot: &'a [u8], layout: u16) -> Result<Self, SnapshotError> {
        let Some((bytes, hash)) = snapshot.split_last_chunk::<HASH>() else {
            return Err(SnapshotError::Truncated { offset: snapshot.len() });
        };
        if blake3::hash(bytes).as_bytes()[..HASH] != *hash {
            return Err(SnapshotError::Corrupt);
        }
        Self::open_unsealed(bytes, layout)
    }

    /// Opens a snapshot without a hash, whose bytes have not left the memory of the process.
    ///
    /// # Errors
    /// It is of another layout.
    pub fn open_unsealed(bytes: &'a [u8], layout: u16) -> Result<Self, SnapshotError> {
        let mut reader = Self { bytes, offset: 0 };
        let found = reader.take::<2>().map(|bytes| u16::from_le_bytes(*bytes))?;
        match found == layout {
            true => Ok(reader),
            false => Err(SnapshotError::UnknownLayout { found, known: layout }),
        }
    }

    /// Ends the reading: nothing may be left.
    ///
    /// # Errors
    /// There are more bytes.
    pub fn finish(self) -> Result<(), SnapshotError> {
        match self.left() {
            0 => Ok(()),
            extra => Err(SnapshotError::TrailingBytes { extra }),
        }
    }

    /// The error that the value last read is out of its range.
    pub fn invalid(&self, what: &'static str) -> SnapshotError {
        SnapshotError::Invalid { what, offset: self.offset }
    }

    /// Number of bytes that are left.
    pub(super) fn left(&self) -> usize {
        self.bytes.len() - self.offset
    }

    #[inline]
    fn take<const N: usize>(&mut self) -> Result<&'a [u8; N], SnapshotError> {
        let taken = self.bytes[self.offset..].first_chunk::<N>();
        let taken = taken.ok_or(SnapshotError::Truncated { offset: self.bytes.len() })?;
        self.offset += N;
        Ok(taken)
    }

    /// One byte.
    ///
    /// # Errors
    /// The bytes end.
    #[inline]
    pub fn u8(&mut self) -> Result<u8, SnapshotError> {
        self.take::<1>().map(|[byte]| *byte)
    }

    /// An integer.
    ///
    /// # Errors
    /// The bytes end, or it has more than 64 bits.
    #[inline]
    pub fn unsigned(&mut self) -> Result<u64, SnapshotError> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.u8()?;
            let bits = u64::from(byte & 0x7f);
            if bits << shift >> shift != bits {
                break;
            }
            value |= bits << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(self.invalid("integer"))
    }

    /// A number.
    ///
    /// # Errors
    /// The bytes end.
    #[inline]
    pub fn f64(&mut self) -> Result<f64, SnapshotError> {
        self.take::<8>().map(|bytes| f64::from_le_bytes(*bytes))
    }

    /// Bytes of another form.
    ///
    /// # Errors
    /// The bytes end.
    pub fn bytes(&mut self) -> Result<&'a [u8], SnapshotError> {
        let length = self.count()?;
        let taken = &self.bytes[self.offset..self.offset + length];
        self.offset += length;
        Ok(taken)
    }

    /// How many items follow, each at least one byte: never more than bytes are left.
    ///
    /// # Errors
    /// The bytes end, or would within the items.
    pub fn count(&mut self) -> Result<usize, SnapshotError> {
        let count = self.unsigned()?;
        let possible = usize::try_from(count).ok().filter(|count| *count <= self.left());
        possible.ok_or_else(|| self.invalid("number of items"))
    }
}
