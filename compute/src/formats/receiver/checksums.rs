//! Checksums of slices of a buffer, from the sums of its beginnings: each byte is summed once, for
//! any number of slices.

use std::ops::Range;

use crate::formats::binary::{crc24q_after, crc24q_shifted};

/// A checksum of the beginning of a buffer.
pub(super) trait Checksum: Copy {
    /// The sum of no byte.
    const EMPTY: Self;

    /// The sum with one byte more.
    fn after(self, byte: u8) -> Self;

    /// The sum of the last `length` of the bytes of this sum; `before` is that of those before.
    fn since(self, before: Self, length: usize) -> Self;
}

/// Fletcher's checksum of UBX; u-blox interface descriptions, 3.4.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fletcher {
    pub(super) a: u8,
    pub(super) b: u8,
}

impl Checksum for Fletcher {
    const EMPTY: Self = Self { a: 0, b: 0 };

    fn after(self, byte: u8) -> Self {
        let a = self.a.wrapping_add(byte);
        Self { a, b: self.b.wrapping_add(a) }
    }

    fn since(self, before: Self, length: usize) -> Self {
        let excess = before.a.wrapping_mul(length as u8);
        let b = self.b.wrapping_sub(before.b).wrapping_sub(excess);
        Self { a: self.a.wrapping_sub(before.a), b }
    }
}

/// CRC-24Q.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Crc24q(pub(super) u32);

impl Checksum for Crc24q {
    const EMPTY: Self = Self(0);

    fn after(self, byte: u8) -> Self {
        Self(crc24q_after(self.0, byte))
    }

    fn since(self, before: Self, length: usize) -> Self {
        Self(self.0 ^ crc24q_shifted(before.0, length))
    }
}

/// The sums of the beginnings of a part of a buffer.
#[derive(Debug)]
pub(super) struct Beginnings<S> {
    /// Index in the buffer at which the part begins.
    first: usize,
    /// The sum of no byte, of the first byte of the part, of the first two, and so on.
    sums: Vec<S>,
}

impl<S: Checksum> Beginnings<S> {
    pub(super) const fn new() -> Self {
        Self { first: 0, sums: Vec::new() }
    }

    /// Forgets all sums, and frees their memory.
    pub(super) fn clear(&mut self) {
        self.sums = Vec::new();
    }

    /// Forgets the first `count` bytes of the buffer, which are removed.
    pub(super) fn remove(&mut self, count: usize) {
        let gone = count.saturating_sub(self.first).min(self.sums.len());
        self.sums.drain(..gone);
        self.first = self.first.max(count) - count;
    }

    /// The checksum of a slice of the buffer, and the number of bytes that were summed for it. No
    /// slice begins before the one of the call after [`Self::clear`].
    pub(super) fn of(&mut self, buffer: &[u8], slice: Range<usize>) -> (S, usize) {
        if self.sums.is_empty() {
            self.first = slice.start;
            self.sums.push(S::EMPTY);
        }
        let known = self.first + self.sums.len() - 1;
        let new = buffer.get(known..slice.end).unwrap_or_default();
        let mut sum = self.sums.last().copied().unwrap_or(S::EMPTY);
        self.sums.extend(new.iter().map(|byte| {
            sum = sum.after(*byte);
            sum
        }));
        let at = |index: usize| self.sums[index - self.first];
        (at(slice.end).since(at(slice.start), slice.len()), new.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whole<S: Checksum>(bytes: &[u8]) -> S {
        bytes.iter().fold(S::EMPTY, |sum, byte| sum.after(*byte))
    }

    #[test]
    fn slices_have_the_sum_of_their_bytes() {
        let buffer: Vec<u8> = (0..2000_u32).map(|n| (n * n / 7) as u8).collect();
        let (mut fletcher, mut crc) = (Beginnings::new(), Beginnings::<Crc24q>::new());
        let mut summed = 0;
        for (start, length) in [(10, 700), (11, 0), (300, 1029), (301, 1), (900, 1000)] {
            let slice = start..start + length;
            let (sum, count) = fletcher.of(&buffer, slice.clone());
            assert_eq!(sum, whole::<Fletcher>(&buffer[slice.clone()]));
            if length <= 1029 {
                assert_eq!(crc.of(&buffer, slice.clone()).0, whole(&buffer[slice]));
            }
            summed += count;
        }
        assert_eq!(summed, 1900 - 10);
        fletcher.remove(500);
        let (sum, count) = fletcher.of(&buffer[500..], 450..1500);
        assert_eq!((sum, count), (whole::<Fletcher>(&buffer[950..]), 100));
    }
}
