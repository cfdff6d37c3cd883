//! Bit fields, most significant bit first.

use super::Refusal;

/// Widest field that is read in one step (bits).
const WIDTH_LIMIT: u32 = 56;

/// Reads the fields of a message one after another.
///
/// Fields beyond the end of the message are zero. [`Bits::require_sound`] checks at the end whether
/// a field exceeded it, so that a message is checked once instead of field by field.
#[derive(Clone, Debug)]
pub(in crate::formats) struct Bits<'a> {
    bytes: &'a [u8],
    /// Index of the next bit.
    at: usize,
}

impl<'a> Bits<'a> {
    pub(in crate::formats) const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// A reader of the same bytes from bit `at` on.
    pub(in crate::formats) const fn starting_at(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at }
    }

    /// An unsigned field of at most 56 bits.
    #[inline]
    pub(in crate::formats) fn unsigned(&mut self, width: u32) -> u64 {
        debug_assert!((1..=WIDTH_LIMIT).contains(&width));
        let (first, shift) = (self.at / 8, self.at % 8);
        self.at += width as usize;
        let word = match self.bytes.get(first..).and_then(|rest| rest.first_chunk::<8>()) {
            Some(eight) => u64::from_be_bytes(*eight),
            None => self.last_word(first),
        };
        (word << shift) >> (u64::BITS - width)
    }

    /// A signed field in two's complement.
    #[inline]
    pub(in crate::formats) fn signed(&mut self, width: u32) -> i64 {
        let unused = i64::BITS - width;
        ((self.unsigned(width) << unused) as i64) >> unused
    }

    /// A signed field with sign bit and magnitude, as in GLONASS.
    pub(in crate::formats) fn sign_magnitude(&mut self, width: u32) -> i64 {
        let is_negative = self.flag();
        let magnitude = self.unsigned(width - 1) as i64;
        if is_negative { -magnitude } else { magnitude }
    }

    pub(in crate::formats) fn flag(&mut self) -> bool {
        self.unsigned(1) == 1
    }

    pub(in crate::formats) const fn skip(&mut self, width: usize) {
        self.at += width;
    }

    /// An unsigned field times a unit.
    pub(in crate::formats) fn scaled(&mut self, width: u32, unit: f64) -> f64 {
        self.unsigned(width) as f64 * unit
    }

    /// A signed field in two's complement times a unit.
    pub(in crate::formats) fn signed_scaled(&mut self, width: u32, unit: f64) -> f64 {
        self.signed(width) as f64 * unit
    }

    /// Refuses a message whose fields exceeded its end.
    pub(in crate::formats) const fn require_sound(&self) -> Result<(), Refusal> {
        if self.at <= self.bytes.len() * 8 { Ok(()) } else { Err(Refusal::Truncated) }
    }

    #[cold]
    fn last_word(&self, first: usize) -> u64 {
        let mut word = [0; 8];
        let rest = self.bytes.get(first..).unwrap_or(&[]);
        word[..rest.len()].copy_from_slice(rest);
        u64::from_be_bytes(word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_follow_one_another() {
        let bytes = [0b1010_0110, 0b1111_0000, 0xff, 0x80, 1, 2, 3, 4, 5, 6];
        let mut bits = Bits::new(&bytes);
        assert_eq!((bits.unsigned(3), bits.signed(2), bits.flag()), (0b101, 0, true));
        assert_eq!((bits.signed(4), bits.sign_magnitude(3)), (-5, -2));
        bits.skip(3);
        assert_eq!((bits.signed(16), bits.unsigned(48)), (-128, 0x0102_0304_0506));
        assert!(bits.require_sound().is_ok());
        assert_eq!(bits.unsigned(5), 0);
        assert_eq!(bits.require_sound(), Err(Refusal::Truncated));
    }

    #[test]
    fn magnitudes_have_a_sign_bit() {
        let mut bits = Bits::starting_at(&[0b0101_1010, 0b1000_0000], 1);
        assert_eq!((bits.sign_magnitude(4), bits.sign_magnitude(5)), (-3, 10));
    }
}
