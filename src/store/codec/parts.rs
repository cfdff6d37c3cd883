//! Solutions in three parts, and a revision relative to the first answer.
//!
//! The first part contains everything but the `f64` values: flags, counts, lists. The second part
//! contains these values, eight bytes each. The third part contains values that hardly differ from
//! what the others say, such as the lower triangle of a covariance: each as its distance from the
//! expected value in the order of all `f64`, as Rice codes.
//!
//! Two solutions of an epoch have nearly the same first part, and similar values. So the smoothed
//! solution is written as its difference from the first answer: the bytes between the longest
//! common beginning and end of the first part, and for each value of the second part its distance
//! from that of the first answer, in as many bits as the distance needs. The third part is written
//! as it is.
//!
//! Former layouts have no third part.

use std::borrow::Cow;

use super::CodecError;
use super::bits::{BitReader, BitWriter, rice_parameter};
use super::bytes::{Decoder, Encoder, at_distance, distance};

const FLOAT_BYTES: usize = 8;
/// Bits of the length of a non-zero distance. The length is written less one.
const LENGTH_BITS: u32 = 6;
const PARAMETER_BITS: u32 = 6;

/// The bytes of everything else, the bytes of the `f64` values, and the distances; without the
/// last in former layouts.
pub(super) struct Parts<'a> {
    pub(super) bytes: Cow<'a, [u8]>,
    pub(super) floats: Cow<'a, [u8]>,
    pub(super) distances: Option<Vec<u64>>,
}

impl Parts<'static> {
    /// The parts of an encoder that keeps `f64` values apart.
    pub(super) fn of(out: Encoder) -> Self {
        let (bytes, floats, distances) = out.parts();
        Self { bytes: bytes.into(), floats: floats.into(), distances }
    }
}

impl Parts<'_> {
    /// Reads the parts as the content of a solution.
    pub(super) fn decoder(&self) -> Decoder<'_> {
        Decoder::of_parts(&self.bytes, &self.floats, self.distances.as_deref())
    }
}

/// Writes all parts as they are.
pub(super) fn encode_whole(out: &mut Encoder, parts: &Parts<'_>) {
    out.count(parts.bytes.len());
    out.slice(&parts.bytes);
    encode_distances(out, parts);
    out.slice(&parts.floats);
}

/// Reads what [`encode_whole`] wrote.
pub(super) fn decode_whole<'a>(
    input: &mut Decoder<'a>,
    has_distances: bool,
) -> Result<Parts<'a>, CodecError> {
    let length = input.count("length of the first part")?;
    let bytes = Cow::Borrowed(input.take(length)?);
    let distances = has_distances.then(|| decode_distances(input)).transpose()?;
    Ok(Parts { bytes, floats: Cow::Borrowed(input.rest()), distances })
}

fn encode_distances(out: &mut Encoder, parts: &Parts<'_>) {
    let Some(distances) = &parts.distances else { return };
    out.count(distances.len());
    if distances.is_empty() {
        return;
    }
    let parameter = rice_parameter(&mut distances.clone());
    let mut bits = BitWriter::new(out);
    bits.bits(parameter.into(), PARAMETER_BITS);
    distances.iter().for_each(|distance| bits.rice(*distance, parameter));
    bits.finish();
}

fn decode_distances(input: &mut Decoder<'_>) -> Result<Vec<u64>, CodecError> {
    let count = input.count_of_bits("number of distances")?;
    if count == 0 {
        return Ok(Vec::new());
    }
    let mut bits = BitReader::new(input);
    let parameter = bits.bits(PARAMETER_BITS)? as u32;
    let distances = (0..count).map(|_| bits.rice(parameter)).collect::<Result<_, _>>()?;
    bits.finish()?;
    Ok(distances)
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
    encode_distances(out, parts);
    out.count(parts.floats.len() / FLOAT_BYTES);
    let mut reference = values(&reference.floats);
    let mut bits = BitWriter::new(out);
    for value in values(&parts.floats) {
        let distance = distance(value, reference.next().unwrap_or(0));
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
    has_distances: bool,
) -> Result<Parts<'static>, CodecError> {
    let (beginning, end) = (input.usize("beginning")?, input.usize("end")?);
    let length = input.count("length of the difference")?;
    let between = input.take(length)?;
    let other = &reference.bytes;
    let (beginning, after) =
        other.split_at_checked(beginning).ok_or_else(|| input.invalid("beginning"))?;
    let start = after.len().checked_sub(end).ok_or_else(|| input.invalid("end"))?;
    let bytes = [beginning, between, &after[start..]].concat();
    let distances = has_distances.then(|| decode_distances(input)).transpose()?;
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
        let value = at_distance(reference.next().unwrap_or(0), distance);
        floats.extend_from_slice(&value.to_le_bytes());
    }
    bits.finish()?;
    Ok(Parts { bytes: bytes.into(), floats: floats.into(), distances })
}

/// The bits of the values.
fn values(floats: &[u8]) -> impl Iterator<Item = u64> {
    let bits = |chunk: &[u8]| u64::from_le_bytes(chunk.try_into().expect("chunks of eight bytes"));
    floats.chunks_exact(FLOAT_BYTES).map(bits)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn parts(bytes: &[u8], values: &[f64], distances: Option<&[u64]>) -> Parts<'static> {
        let floats = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let distances = distances.map(<[u64]>::to_vec);
        Parts { bytes: bytes.to_vec().into(), floats: Cow::Owned(floats), distances }
    }

    fn relative(parts: &Parts<'_>, reference: &Parts<'_>) -> Vec<u8> {
        let mut out = Encoder::new(1, 0);
        encode_relative(&mut out, parts, reference);
        out.finish()
    }

    fn read(
        bytes: &[u8],
        reference: &Parts<'_>,
        has_distances: bool,
    ) -> Result<Parts<'static>, CodecError> {
        let mut input = Decoder::new(bytes, 1)?;
        let parts = decode_relative(&mut input, reference, has_distances)?;
        input.finish()?;
        Ok(parts)
    }

    /// A difference of one ulp is the distance 1, which the sign makes 2. It takes a flag, six bits
    /// of length and one bit of value. Equal values take one bit.
    #[test]
    fn close_values_take_few_bits() {
        let next = f64::from_bits(4e6_f64.to_bits() + 1);
        let reference = parts(b"equal part", &[4e6, -1.5, 0.25], None);
        let changed = parts(b"equal, Part", &[next, -1.5, 0.25], None);
        let bytes = relative(&changed, &reference);
        assert_eq!(bytes[..4], [1, 5, 3, 3]);
        assert_eq!(bytes[4..8], *b", P\x03");
        assert_eq!(bytes[8..], [0b1000_0010, 0]);
    }

    /// Three distances with the Rice parameter 0 (six bits): 2 is 110, and 0 is 0.
    #[test]
    fn distances_take_few_bits() {
        let mut out = Encoder::new(1, 0);
        encode_whole(&mut out, &parts(b"", &[], Some(&[2, 0, 0])));
        assert_eq!(out.finish(), [1, 0, 3, 0b0000_0011, 0b0000_0000]);
    }

    proptest! {
        #[test]
        fn parts_round_trip(
            bytes: Vec<u8>,
            values in prop::collection::vec(any::<u64>(), 0..20),
            distances in prop::option::of(prop::collection::vec(any::<u64>(), 0..9)),
            other_bytes: Vec<u8>,
            other_values in prop::collection::vec(any::<u64>(), 0..20),
        ) {
            let values: Vec<f64> = values.into_iter().map(f64::from_bits).collect();
            let other: Vec<f64> = other_values.into_iter().map(f64::from_bits).collect();
            let own = parts(&bytes, &values, distances.as_deref());
            let other = parts(&other_bytes, &other, None);
            for reference in [&other, &own] {
                let encoded = relative(&own, reference);
                let decoded = read(&encoded, reference, distances.is_some()).unwrap();
                prop_assert_eq!(&decoded.bytes, &own.bytes);
                prop_assert_eq!(&decoded.floats, &own.floats);
                prop_assert_eq!(&decoded.distances, &own.distances);
                for length in 0..encoded.len() {
                    let cut = read(&encoded[..length], reference, distances.is_some());
                    prop_assert!(cut.is_err());
                }
            }
            let mut out = Encoder::new(1, 0);
            encode_whole(&mut out, &own);
            let encoded = out.finish();
            let mut input = Decoder::new(&encoded, 1).unwrap();
            let decoded = decode_whole(&mut input, distances.is_some()).unwrap();
            prop_assert_eq!(&decoded.bytes, &own.bytes);
            prop_assert_eq!(&decoded.floats, &own.floats);
            prop_assert_eq!(&decoded.distances, &own.distances);
        }

        #[test]
        fn corrupted_bytes_never_panic(bytes: Vec<u8>, other: Vec<u8>, values: Vec<f64>) {
            let reference = parts(&other, &values, None);
            let bytes = [&[1], &bytes[..]].concat();
            for has_distances in [false, true] {
                read(&bytes, &reference, has_distances).ok();
                decode_whole(&mut Decoder::new(&bytes, 1).unwrap(), has_distances).ok();
            }
        }
    }
}
