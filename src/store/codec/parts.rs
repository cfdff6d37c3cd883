//! Solutions in two parts, and a revision relative to the first answer.
//!
//! The first part contains everything but the `f64` values: flags, counts, lists. The second part
//! contains these values, eight bytes each. Two solutions of an epoch have nearly the same first
//! part, and similar values. So the smoothed solution is written as its difference from the first
//! answer: the bytes between the longest common beginning and end of the first part, and for each
//! value its distance in the order of all `f64`, in as many bits as the distance needs.

use std::borrow::Cow;

use super::CodecError;
use super::bits::{BitReader, BitWriter};
use super::bytes::{Decoder, Encoder, unzigzag, zigzag};

const FLOAT_BYTES: usize = 8;
/// Bits of the length of a non-zero distance. The length is written less one.
const LENGTH_BITS: u32 = 6;
const SIGN: u64 = 1 << 63;

/// The bytes of everything but the `f64` values, and the bytes of the `f64` values.
pub(super) struct Parts<'a> {
    pub(super) bytes: Cow<'a, [u8]>,
    pub(super) floats: Cow<'a, [u8]>,
}

impl Parts<'static> {
    fn owned(bytes: Vec<u8>, floats: Vec<u8>) -> Self {
        Self { bytes: bytes.into(), floats: floats.into() }
    }

    /// The parts of an encoder that keeps `f64` values apart.
    pub(super) fn of(out: Encoder) -> Self {
        let (bytes, floats) = out.parts();
        Self::owned(bytes, floats)
    }
}

/// Writes both parts as they are.
pub(super) fn encode_whole(out: &mut Encoder, parts: &Parts<'_>) {
    out.count(parts.bytes.len());
    out.slice(&parts.bytes);
    out.slice(&parts.floats);
}

/// Reads what [`encode_whole`] wrote.
pub(super) fn decode_whole<'a>(input: &mut Decoder<'a>) -> Result<Parts<'a>, CodecError> {
    let length = input.count("length of the first part")?;
    let bytes = Cow::Borrowed(input.take(length)?);
    Ok(Parts { bytes, floats: Cow::Borrowed(input.rest()) })
}

/// Writes the difference from `reference`.
pub(super) fn encode_relative(out: &mut Encoder, parts: &Parts<'_>, reference: &Parts<'_>) {
    let (own, other) = (&parts.bytes[..], &reference.bytes[..]);
    let same = |(a, b): &(&u8, &u8)| a == b;
    let beginning = own.iter().zip(other).take_while(same).count();
    let (own, other) = (&own[beginning..], &other[beginning..]);
    let end = own.iter().rev().zip(other.iter().rev()).take_while(same).count();
    let between = &own[..own.len() - end];
    out.count(beginning);
    out.count(end);
    out.count(between.len());
    out.slice(between);
    out.count(parts.floats.len() / FLOAT_BYTES);
    let mut reference = values(&reference.floats);
    let mut bits = BitWriter::new(out);
    for value in values(&parts.floats) {
        let distance = ordered(value).wrapping_sub(ordered(reference.next().unwrap_or(0)));
        let distance = zigzag(distance as i64);
        bits.bit(distance != 0);
        if distance != 0 {
            let lower = distance.ilog2();
            bits.bits(lower.into(), LENGTH_BITS);
            bits.bits(distance, lower); // Its highest bit is one.
        }
    }
    bits.finish();
}

/// Reads what [`encode_relative`] wrote.
pub(super) fn decode_relative(
    input: &mut Decoder<'_>,
    reference: &Parts<'_>,
) -> Result<Parts<'static>, CodecError> {
    let (beginning, end) = (input.usize("beginning")?, input.usize("end")?);
    let length = input.count("length of the difference")?;
    let between = input.take(length)?;
    let other = &reference.bytes;
    let (beginning, after) =
        other.split_at_checked(beginning).ok_or_else(|| input.invalid("beginning"))?;
    let start = after.len().checked_sub(end).ok_or_else(|| input.invalid("end"))?;
    let bytes = [beginning, between, &after[start..]].concat();
    let count = input.count_of_bits("number of values")?;
    let mut reference = values(&reference.floats);
    let mut floats = Vec::with_capacity(FLOAT_BYTES * count);
    let mut bits = BitReader::new(input);
    for _ in 0..count {
        let mut distance = 0;
        if bits.bit()? {
            let lower = bits.bits(LENGTH_BITS)? as u32;
            distance = 1 << lower | bits.bits(lower)?;
        }
        let other = ordered(reference.next().unwrap_or(0));
        let value = other.wrapping_add(unzigzag(distance) as u64);
        floats.extend_from_slice(&unordered(value).to_le_bytes());
    }
    bits.finish()?;
    Ok(Parts::owned(bytes, floats))
}

/// The bits of the values.
fn values(floats: &[u8]) -> impl Iterator<Item = u64> {
    let bits = |chunk: &[u8]| u64::from_le_bytes(chunk.try_into().expect("chunks of eight bytes"));
    floats.chunks_exact(FLOAT_BYTES).map(bits)
}

/// Maps the bits of an `f64` to an integer with the same order.
const fn ordered(bits: u64) -> u64 {
    if bits & SIGN == 0 { bits | SIGN } else { !bits }
}

/// The inverse of [`ordered`].
const fn unordered(ordered: u64) -> u64 {
    if ordered & SIGN == 0 { !ordered } else { ordered & !SIGN }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parts(bytes: &[u8], values: &[f64]) -> Parts<'static> {
        let floats = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Parts::owned(bytes.to_vec(), floats)
    }

    fn relative(parts: &Parts<'_>, reference: &Parts<'_>) -> Vec<u8> {
        let mut out = Encoder::new(1, 0);
        encode_relative(&mut out, parts, reference);
        out.finish()
    }

    fn read(bytes: &[u8], reference: &Parts<'_>) -> Result<Parts<'static>, CodecError> {
        let mut input = Decoder::new(bytes, 1)?;
        let parts = decode_relative(&mut input, reference)?;
        input.finish()?;
        Ok(parts)
    }

    /// A difference of one ulp is the distance 1, which the sign makes 2. It takes a flag, six bits
    /// of length and one bit of value. Equal values take one bit.
    #[test]
    fn close_values_take_few_bits() {
        let next = f64::from_bits(4e6_f64.to_bits() + 1);
        let reference = parts(b"equal part", &[4e6, -1.5, 0.25]);
        let changed = parts(b"equal, Part", &[next, -1.5, 0.25]);
        let bytes = relative(&changed, &reference);
        assert_eq!(bytes[..4], [1, 5, 3, 3]);
        assert_eq!(bytes[4..8], *b", P\x03");
        assert_eq!(bytes[8..], [0b1000_0010, 0]);
    }

    proptest! {
        #[test]
        fn the_order_is_that_of_values(a: f64, b: f64) {
            prop_assume!(!a.is_nan() && !b.is_nan());
            let (first, second) = (ordered(a.to_bits()), ordered(b.to_bits()));
            prop_assert_eq!(first.cmp(&second), a.total_cmp(&b));
            prop_assert_eq!(unordered(first), a.to_bits());
        }

        #[test]
        fn relative_parts_round_trip(
            bytes: Vec<u8>,
            values in prop::collection::vec(any::<u64>(), 0..20),
            other_bytes: Vec<u8>,
            other_values in prop::collection::vec(any::<u64>(), 0..20),
        ) {
            let values: Vec<f64> = values.into_iter().map(f64::from_bits).collect();
            let other: Vec<f64> = other_values.into_iter().map(f64::from_bits).collect();
            let (own, other) = (parts(&bytes, &values), parts(&other_bytes, &other));
            for reference in [&other, &own] {
                let encoded = relative(&own, reference);
                let decoded = read(&encoded, reference).unwrap();
                prop_assert_eq!(&decoded.bytes, &own.bytes);
                prop_assert_eq!(&decoded.floats, &own.floats);
                for length in 0..encoded.len() {
                    prop_assert!(read(&encoded[..length], reference).is_err());
                }
            }
        }

        #[test]
        fn corrupted_bytes_never_panic(bytes: Vec<u8>, other: Vec<u8>, values: Vec<f64>) {
            let reference = parts(&other, &values);
            let bytes = [&[1], &bytes[..]].concat();
            read(&bytes, &reference).ok();
        }
    }
}
