//! Bits within the bytes of a row: integers of few bits.
//!
//! A Rice code of parameter k writes v ≥ 0 as ⌊v/2ᵏ⌋ ones, a zero and the k lowest bits of v.
//! Source: Rice and Plaunt (1971), "Adaptive variable-length coding for efficient compression of
//! spacecraft television data".

use super::CodecError;
use super::bytes::{Decoder, Encoder};

/// This many ones mean that the value follows with all its bits.
const ESCAPE: u32 = 20;
const ALL_BITS: u32 = u64::BITS;
/// Bits of the length that [`BitWriter::sized`] writes.
const LENGTH_BITS: u32 = 6;

/// Most bits that are appended at once, so that they fit beside the bits in `held`. The encoder
/// receives this many bits at a time.
const AT_ONCE: u32 = 32;

/// Appends bits to an encoder, the highest first.
pub(super) struct BitWriter<'a> {
    out: &'a mut Encoder,
    /// The bits that are not in the encoder yet.
    held: u64,
    /// Number of them, below [`AT_ONCE`].
    count: u32,
}

impl<'a> BitWriter<'a> {
    pub(super) fn new(out: &'a mut Encoder) -> Self {
        Self { out, held: 0, count: 0 }
    }

    /// Fills the last byte with zeros.
    pub(super) fn finish(self) {
        let (held, count) = (self.held << (AT_ONCE - self.count), self.count.div_ceil(8));
        self.out.slice(&(held as u32).to_be_bytes()[..count as usize]);
    }

    pub(super) fn bit(&mut self, value: bool) {
        self.few_bits(u64::from(value), 1);
    }

    /// The lowest `count` bits of a value.
    pub(super) fn bits(&mut self, value: u64, count: u32) {
        if count <= AT_ONCE {
            return self.few_bits(value, count);
        }
        self.few_bits(value >> AT_ONCE, count - AT_ONCE);
        self.few_bits(value, AT_ONCE);
    }

    /// Like [`Self::bits`], for at most [`AT_ONCE`] bits.
    #[inline]
    fn few_bits(&mut self, value: u64, count: u32) {
        self.held = self.held << count | value & ((1 << count) - 1);
        self.count += count;
        if AT_ONCE <= self.count {
            self.count -= AT_ONCE;
            self.out.slice(&((self.held >> self.count) as u32).to_be_bytes());
        }
    }

    /// A value with its number of bits, below 2⁶³.
    pub(super) fn sized(&mut self, value: u64) {
        let length = ALL_BITS - value.leading_zeros();
        self.bits(u64::from(length), LENGTH_BITS);
        self.bits(value, length);
    }

    /// A Rice code of parameter `k`, below 64.
    pub(super) fn rice(&mut self, value: u64, k: u32) {
        let ones = value >> k;
        if ones < u64::from(ESCAPE) {
            let (ones, rest) = (ones as u32, value & ((1 << k) - 1));
            let unary = (1 << (ones + 1)) - 2;
            if ones + 1 + k <= AT_ONCE {
                return self.few_bits(unary << k | rest, ones + 1 + k);
            }
            self.few_bits(unary, ones + 1);
            self.bits(rest, k);
        } else {
            self.bits((1 << ESCAPE) - 1, ESCAPE);
            self.bits(value, ALL_BITS);
        }
    }
}

/// Length of the Rice code of a value (bits).
const fn rice_bits(value: u64, k: u32) -> u64 {
    let ones = value >> k;
    if ones < ESCAPE as u64 { ones + 1 + k as u64 } else { (ESCAPE + ALL_BITS) as u64 }
}

/// The parameter k that needs the fewest bits for these values. Reorders the values.
pub(super) fn rice_parameter(values: &mut [u64]) -> u32 {
    let middle = values.len() / 2;
    let median = if values.is_empty() { 0 } else { *values.select_nth_unstable(middle).1 };
    let length = ALL_BITS - median.leading_zeros();
    let candidates = length.saturating_sub(3)..(length + 4).min(ALL_BITS);
    let bits = |k: &u32| values.iter().map(|value| rice_bits(*value, *k)).sum::<u64>();
    candidates.min_by_key(bits).unwrap_or(0)
}

/// Reads bits from a decoder.
pub(super) struct BitReader<'d, 'a> {
    input: &'d mut Decoder<'a>,
    held: u8,
    left: u32,
}

impl<'d, 'a> BitReader<'d, 'a> {
    pub(super) fn new(input: &'d mut Decoder<'a>) -> Self {
        Self { input, held: 0, left: 0 }
    }

    /// Checks that less than a byte is left, and that its unread bits are zero.
    pub(super) fn finish(self) -> Result<(), CodecError> {
        match u64::from(self.held) & ((1 << self.left) - 1) {
            0 => Ok(()),
            _ => Err(self.input.invalid("last bits")),
        }
    }

    pub(super) fn invalid(&self, what: &'static str) -> CodecError {
        self.input.invalid(what)
    }

    pub(super) fn bit(&mut self) -> Result<bool, CodecError> {
        Ok(self.bits(1)? == 1)
    }

    pub(super) fn bits(&mut self, count: u32) -> Result<u64, CodecError> {
        let (mut value, mut wanted) = (0, count);
        while wanted != 0 {
            if self.left == 0 {
                (self.held, self.left) = (self.input.u8()?, 8);
            }
            let taken = wanted.min(self.left);
            let part = (u64::from(self.held) >> (self.left - taken)) & ((1 << taken) - 1);
            value = value << taken | part;
            self.left -= taken;
            wanted -= taken;
        }
        Ok(value)
    }

    pub(super) fn sized(&mut self) -> Result<u64, CodecError> {
        let length = self.bits(LENGTH_BITS)?;
        self.bits(length as u32)
    }

    pub(super) fn rice(&mut self, k: u32) -> Result<u64, CodecError> {
        let mut ones = 0;
        while self.bit()? {
            ones += 1;
            if ones == ESCAPE {
                return self.bits(ALL_BITS);
            }
        }
        let rest = self.bits(k)?;
        let high = u64::from(ones);
        if high << k >> k == high { Ok(high << k | rest) } else { Err(self.invalid("integer")) }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::store::codec::bytes::{unzigzag, zigzag};

    use super::*;

    #[test]
    fn a_rice_code_is_quotient_and_rest() {
        let mut out = Encoder::new(1, 0);
        let mut bits = BitWriter::new(&mut out);
        bits.rice(13, 2); // 13 = 3·4 + 1: 111 0 01.
        bits.finish();
        assert_eq!(out.finish(), [1, 0b1110_0100]);
        assert_eq!(rice_bits(13, 2), 6);
        assert_eq!(rice_parameter(&mut [5, 6, 4, 7, 5]), 2);
    }

    /// Bits across the limits of bytes, and more than are appended at once.
    #[test]
    fn bits_are_appended_the_highest_first() {
        let mut out = Encoder::new(1, 0);
        let mut bits = BitWriter::new(&mut out);
        bits.bits(0xfff5, 3); // Its lowest bits, 101.
        bits.bits(0x1234_5678_9abc_def0, 64);
        bits.bits(0, 0);
        bits.bits(0x1_ffff_ffff, 33);
        bits.bit(false);
        bits.finish();
        let expected: u128 = (0b101 << 98) | (0x1234_5678_9abc_def0 << 34) | (0x1_ffff_ffff << 1);
        assert_eq!(out.finish(), [&[1], &(expected << 27).to_be_bytes()[..13]].concat());
    }

    #[test]
    fn bits_after_the_last_value_are_refused() {
        for (last, is_valid) in [(0b1010_0000, true), (0b1010_0001, false)] {
            let bytes = [1, last];
            let mut input = Decoder::new(&bytes, 1).unwrap();
            let mut bits = BitReader::new(&mut input);
            assert_eq!(bits.bits(3), Ok(5));
            assert_eq!(bits.finish().is_ok(), is_valid);
        }
    }

    proptest! {
        #[test]
        fn integers_round_trip(value: u64, k in 0_u32..64, shift in 0_u32..64, count in 0_u32..64) {
            let (value, bits) = (value >> shift, value & ((1 << count) - 1));
            let mut out = Encoder::new(1, 0);
            let mut writer = BitWriter::new(&mut out);
            writer.bits(bits, count);
            writer.rice(value, k);
            writer.sized(value >> 1);
            writer.rice(zigzag(value as i64), k);
            writer.finish();
            let bytes = out.finish();
            let mut input = Decoder::new(&bytes, 1).unwrap();
            let mut reader = BitReader::new(&mut input);
            prop_assert_eq!(reader.bits(count), Ok(bits));
            prop_assert_eq!(reader.rice(k), Ok(value));
            prop_assert_eq!(reader.sized(), Ok(value >> 1));
            prop_assert_eq!(reader.rice(k).map(unzigzag), Ok(value as i64));
            prop_assert!(reader.finish().is_ok());
            input.finish().unwrap();
        }

        #[test]
        fn a_parameter_is_the_best(values in prop::collection::vec(0_u64..1 << 20, 1..40)) {
            let mut sorted = values.clone();
            let bits = |k: u32| values.iter().map(|value| rice_bits(*value, k)).sum::<u64>();
            let chosen = bits(rice_parameter(&mut sorted));
            let best = (0..63).map(bits).min().unwrap();
            prop_assert!(chosen <= best + best / 2, "{chosen} of {best} bits");
        }
    }
}
