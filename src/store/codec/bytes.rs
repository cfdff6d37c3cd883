//! Primitive types as bytes: integers, floats, texts, times, satellites.

use nalgebra::{Matrix3, Vector3};

use crate::gnss::constants::NS_PER_SECOND;
use crate::gnss::{Constellation, GpsTime, SatelliteId};

use super::CodecError;

/// Below this number of thousandths, a value takes no more bytes than an `f64`.
const THOUSANDTHS_MAX: u64 = 1 << 55;
/// Below 2⁵¹ an `f64` represents every multiple of one half.
const HALVES_MAX: f64 = (1_u64 << 51) as f64;
const NS_PER_MS: i64 = 1_000_000;
/// Written where the span is not a whole number of milliseconds; those are written doubled.
const NOT_WHOLE: i64 = 1;

/// A signed integer as an unsigned one that is small if its magnitude is.
pub(super) const fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

/// The inverse of [`zigzag`].
pub(super) const fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

const SIGN: u64 = 1 << 63;
/// Distances of a solution with velocity: three of each covariance, two of dilutions of precision.
const DISTANCES: usize = 8;

/// Maps the bits of an `f64` to an integer with the same order.
const fn ordered(bits: u64) -> u64 {
    if bits & SIGN == 0 { bits | SIGN } else { !bits }
}

/// The inverse of [`ordered`].
const fn unordered(ordered: u64) -> u64 {
    if ordered & SIGN == 0 { !ordered } else { ordered & !SIGN }
}

/// Distance of an `f64` from another one in the order of all `f64`, small if they are close to each
/// other. Both are given by their bits.
pub(super) const fn distance(bits: u64, from: u64) -> u64 {
    zigzag(ordered(bits).wrapping_sub(ordered(from)) as i64)
}

/// The bits of the `f64` at this [`distance`] from another one.
pub(super) const fn at_distance(from: u64, distance: u64) -> u64 {
    unordered(ordered(from).wrapping_add(unzigzag(distance) as u64))
}

/// The bits of an expected value. NaN is replaced, because its bits depend on the processor.
fn expected_bits(expected: f64) -> u64 {
    if expected.is_nan() { 0 } else { expected.to_bits() }
}

/// A value in thousandths, if it is a whole number of them.
pub(super) fn thousandths(value: f64) -> Option<i64> {
    let scaled = value * 1e3;
    // The cast saturates and turns NaN into zero; the comparison of bits excludes both. `round` is
    // a function call on processors that cannot round; adding a half is exact below `HALVES_MAX`.
    let thousandths = match scaled.abs() < HALVES_MAX {
        true => (scaled + 0.5_f64.copysign(scaled)) as i64,
        false => scaled.round() as i64,
    };
    let exact = (thousandths as f64 / 1e3).to_bits() == value.to_bits();
    (exact && thousandths.unsigned_abs() < THOUSANDTHS_MAX).then_some(thousandths)
}

/// Appends primitives to a buffer.
pub(super) struct Encoder {
    bytes: Vec<u8>,
    /// The `f64` values, if they are kept apart from everything else.
    floats: Option<Vec<u8>>,
    /// Distances of values from expected ones, if they are written so.
    distances: Option<Vec<u64>>,
}

impl Encoder {
    pub(super) fn new(version: u8, capacity: usize) -> Self {
        let mut bytes = Vec::with_capacity(capacity);
        bytes.push(version);
        Self { bytes, floats: None, distances: None }
    }

    /// An encoder without version that keeps `f64` apart, and also distances if they are asked for,
    /// for [`Self::parts`].
    pub(super) fn in_parts(capacity: usize, with_distances: bool) -> Self {
        Self {
            bytes: Vec::with_capacity(capacity),
            floats: Some(Vec::with_capacity(capacity)),
            distances: with_distances.then(|| Vec::with_capacity(DISTANCES)),
        }
    }

    pub(super) fn finish(self) -> Vec<u8> {
        self.bytes
    }

    /// The bytes of everything else, the bytes of the `f64` values, and the distances.
    pub(super) fn parts(self) -> (Vec<u8>, Vec<u8>, Option<Vec<u64>>) {
        (self.bytes, self.floats.unwrap_or_default(), self.distances)
    }

    pub(super) fn slice(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub(super) fn unsigned(&mut self, mut value: u64) {
        while 0x80 <= value {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    pub(super) fn signed(&mut self, value: i64) {
        self.unsigned(zigzag(value));
    }

    pub(super) fn count(&mut self, value: usize) {
        self.unsigned(value as u64);
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.floats.as_mut().unwrap_or(&mut self.bytes).extend_from_slice(&value.to_le_bytes());
    }

    /// A value that the reader expects to be close to `expected`: its distance, if distances are
    /// kept.
    pub(super) fn f64_near(&mut self, value: f64, expected: f64) {
        match &mut self.distances {
            Some(distances) => distances.push(distance(value.to_bits(), expected_bits(expected))),
            None => self.f64(value),
        }
    }

    pub(super) fn optional_f64(&mut self, value: Option<f64>) {
        self.u8(u8::from(value.is_some()));
        if let Some(value) = value {
            self.f64(value);
        }
    }

    pub(super) fn text(&mut self, text: &str) {
        self.count(text.len());
        self.bytes.extend_from_slice(text.as_bytes());
    }

    /// A span of time: whole milliseconds in few bytes, others in more.
    pub(super) fn span(&mut self, ns: i64) {
        if ns % NS_PER_MS == 0 {
            self.signed(2 * (ns / NS_PER_MS));
        } else {
            self.signed(NOT_WHOLE);
            self.signed(ns);
        }
    }

    /// A GPS time: a whole second in few bytes, other times in more.
    pub(super) fn time(&mut self, time: GpsTime) {
        let ns = time.as_ns();
        let whole = ns % NS_PER_SECOND == 0;
        self.u8(u8::from(whole));
        self.signed(if whole { ns / NS_PER_SECOND } else { ns });
    }

    pub(super) fn optional_time(&mut self, time: Option<GpsTime>) {
        match time {
            Some(time) => self.time(time),
            None => self.u8(2),
        }
    }

    pub(super) fn satellite(&mut self, satellite: SatelliteId) {
        self.u8(constellation_number(satellite.constellation));
        self.u8(satellite.number);
    }

    pub(super) fn vector(&mut self, vector: &Vector3<f64>) {
        vector.iter().for_each(|value| self.f64(*value));
    }

    /// A covariance: its upper triangle and the distances of the lower one from it. Without
    /// distances the lower triangle is left out if it has the same bits.
    pub(super) fn covariance(&mut self, matrix: &Matrix3<f64>) {
        let same = |(i, j): (usize, usize)| matrix[(i, j)].to_bits() == matrix[(j, i)].to_bits();
        let mut has_lower = true;
        if self.distances.is_none() {
            has_lower = ![(0, 1), (0, 2), (1, 2)].into_iter().all(same);
            self.u8(u8::from(!has_lower));
        }
        for row in 0..3 {
            for column in 0..3 {
                if row <= column {
                    self.f64(matrix[(row, column)]);
                } else if has_lower {
                    self.f64_near(matrix[(row, column)], matrix[(column, row)]);
                }
            }
        }
    }
}

/// Reads primitives from the front of a slice.
pub(super) struct Decoder<'a> {
    bytes: &'a [u8],
    offset: usize,
    /// The unread `f64` values, if they are kept apart.
    floats: Option<&'a [u8]>,
    /// The unread distances, if there are any.
    distances: Option<&'a [u64]>,
}

impl<'a> Decoder<'a> {
    /// Starts after the version, which must be `version`.
    pub(super) fn new(bytes: &'a [u8], version: u8) -> Result<Self, CodecError> {
        match Self::of_versions(bytes, version)? {
            (decoder, found) if found == version => Ok(decoder),
            (_, found) => Err(CodecError::UnknownVersion { version: found }),
        }
    }

    /// For an encoding with several versions: also returns the version, 1 to `newest`.
    pub(super) fn of_versions(bytes: &'a [u8], newest: u8) -> Result<(Self, u8), CodecError> {
        let mut decoder = Self { bytes, offset: 0, floats: None, distances: None };
        match decoder.u8()? {
            found if (1..=newest).contains(&found) => Ok((decoder, found)),
            found => Err(CodecError::UnknownVersion { version: found }),
        }
    }

    /// Reads the parts that [`Encoder::parts`] returned.
    pub(super) const fn of_parts(
        bytes: &'a [u8],
        floats: &'a [u8],
        distances: Option<&'a [u64]>,
    ) -> Self {
        Self { bytes, offset: 0, floats: Some(floats), distances }
    }

    pub(super) fn finish(self) -> Result<(), CodecError> {
        let apart = self.floats.map_or(0, <[u8]>::len) + self.distances.map_or(0, <[u64]>::len);
        match self.bytes.len() - self.offset + apart {
            0 => Ok(()),
            extra => Err(CodecError::TrailingBytes { extra }),
        }
    }

    /// All bytes that are left.
    pub(super) fn rest(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.offset..];
        self.offset = self.bytes.len();
        rest
    }

    pub(super) fn invalid(&self, what: &'static str) -> CodecError {
        CodecError::Invalid { what, offset: self.offset }
    }

    pub(super) fn take(&mut self, length: usize) -> Result<&'a [u8], CodecError> {
        let rest = &self.bytes[self.offset..];
        let Some(taken) = rest.get(..length) else {
            return Err(CodecError::Truncated { offset: self.bytes.len() });
        };
        self.offset += length;
        Ok(taken)
    }

    pub(super) fn u8(&mut self) -> Result<u8, CodecError> {
        Ok(self.take(1)?[0])
    }

    pub(super) fn flag(&mut self, what: &'static str) -> Result<bool, CodecError> {
        match self.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(self.invalid(what)),
        }
    }

    pub(super) fn unsigned(&mut self) -> Result<u64, CodecError> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.u8()?;
            let bits = u64::from(byte & 0x7f);
            if bits << shift >> shift != bits {
                return Err(self.invalid("integer"));
            }
            value |= bits << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(self.invalid("integer"))
    }

    pub(super) fn signed(&mut self) -> Result<i64, CodecError> {
        self.unsigned().map(unzigzag)
    }

    pub(super) fn u32(&mut self, what: &'static str) -> Result<u32, CodecError> {
        let value = self.unsigned()?;
        u32::try_from(value).map_err(|_| self.invalid(what))
    }

    pub(super) fn usize(&mut self, what: &'static str) -> Result<usize, CodecError> {
        let value = self.unsigned()?;
        usize::try_from(value).map_err(|_| self.invalid(what))
    }

    /// The number of items that follow. Each has at least one byte, so it is at most the bytes
    /// left.
    pub(super) fn count(&mut self, what: &'static str) -> Result<usize, CodecError> {
        let count = self.usize(what)?;
        let left = self.bytes.len() - self.offset;
        if left < count { Err(self.invalid(what)) } else { Ok(count) }
    }

    /// Like [`Self::count`], for items of at least one bit.
    pub(super) fn count_of_bits(&mut self, what: &'static str) -> Result<usize, CodecError> {
        let count = self.usize(what)?;
        let left = self.bytes.len() - self.offset;
        if 8 * left < count { Err(self.invalid(what)) } else { Ok(count) }
    }

    pub(super) fn f64(&mut self) -> Result<f64, CodecError> {
        let bytes = match &mut self.floats {
            None => self.take(8)?,
            Some(floats) => {
                let (bytes, rest) =
                    floats.split_at_checked(8).ok_or(CodecError::Truncated { offset: 0 })?;
                *floats = rest;
                bytes
            }
        };
        Ok(f64::from_le_bytes(bytes.try_into().expect("eight bytes were taken")))
    }

    /// A value that was written as close to `expected`.
    pub(super) fn f64_near(&mut self, expected: f64) -> Result<f64, CodecError> {
        let Some(distances) = &mut self.distances else { return self.f64() };
        let (distance, rest) =
            distances.split_first().ok_or(CodecError::Truncated { offset: self.offset })?;
        *distances = rest;
        Ok(f64::from_bits(at_distance(expected_bits(expected), *distance)))
    }

    pub(super) fn optional_f64(&mut self) -> Result<Option<f64>, CodecError> {
        if self.flag("presence")? { self.f64().map(Some) } else { Ok(None) }
    }

    /// A measured value with this 2-bit tag.
    pub(super) fn measured(&mut self, tag: u8) -> Result<Option<f64>, CodecError> {
        match tag & 3 {
            0 => Ok(None),
            1 => Ok(Some(self.signed()? as f64 / 1e3)),
            2 => self.f64().map(Some),
            _ => Err(self.invalid("measured value")),
        }
    }

    pub(super) fn text(&mut self) -> Result<&'a str, CodecError> {
        let length = self.count("text length")?;
        let bytes = self.take(length)?;
        std::str::from_utf8(bytes).map_err(|_| self.invalid("text"))
    }

    pub(super) fn time(&mut self) -> Result<GpsTime, CodecError> {
        self.optional_time()?.ok_or_else(|| self.invalid("time"))
    }

    pub(super) fn span(&mut self) -> Result<i64, CodecError> {
        match self.signed()? {
            NOT_WHOLE => self.signed(),
            doubled if doubled % 2 == 0 => {
                (doubled / 2).checked_mul(NS_PER_MS).ok_or_else(|| self.invalid("span of time"))
            }
            _ => Err(self.invalid("span of time")),
        }
    }

    pub(super) fn optional_time(&mut self) -> Result<Option<GpsTime>, CodecError> {
        let ns = match self.u8()? {
            0 => self.signed()?,
            1 => {
                let seconds = self.signed()?;
                seconds.checked_mul(NS_PER_SECOND).ok_or_else(|| self.invalid("time"))?
            }
            2 => return Ok(None),
            _ => return Err(self.invalid("time")),
        };
        Ok(Some(GpsTime::from_ns(ns)))
    }

    pub(super) fn constellation(&mut self) -> Result<Constellation, CodecError> {
        let number = self.u8()?;
        let mut all = Constellation::ALL.into_iter();
        all.find(|c| constellation_number(*c) == number)
            .ok_or_else(|| self.invalid("constellation"))
    }

    pub(super) fn satellite(&mut self) -> Result<SatelliteId, CodecError> {
        let constellation = self.constellation()?;
        let number = self.u8()?;
        SatelliteId::new(constellation, number).ok_or_else(|| self.invalid("satellite"))
    }

    pub(super) fn satellites(&mut self) -> Result<Vec<SatelliteId>, CodecError> {
        let count = self.count("number of satellites")?;
        (0..count).map(|_| self.satellite()).collect()
    }

    pub(super) fn vector(&mut self) -> Result<Vector3<f64>, CodecError> {
        Ok(Vector3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    pub(super) fn covariance(&mut self) -> Result<Matrix3<f64>, CodecError> {
        let has_lower = self.distances.is_some() || !self.flag("symmetry")?;
        let mut matrix = Matrix3::zeros();
        for row in 0..3 {
            for column in 0..3 {
                matrix[(row, column)] = match (row <= column, has_lower) {
                    (true, _) => self.f64()?,
                    (false, true) => self.f64_near(matrix[(column, row)])?,
                    (false, false) => matrix[(column, row)],
                };
            }
        }
        Ok(matrix)
    }
}

/// The stored number of a constellation. It never changes.
pub(super) const fn constellation_number(constellation: Constellation) -> u8 {
    match constellation {
        Constellation::Gps => 0,
        Constellation::Glonass => 1,
        Constellation::Galileo => 2,
        Constellation::BeiDou => 3,
        Constellation::Qzss => 4,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn round_trip<T>(
        write: impl Fn(&mut Encoder),
        read: impl Fn(&mut Decoder<'_>) -> Result<T, CodecError>,
    ) -> T {
        let mut encoder = Encoder::new(1, 0);
        write(&mut encoder);
        let bytes = encoder.finish();
        let mut decoder = Decoder::new(&bytes, 1).unwrap();
        let value = read(&mut decoder).unwrap();
        decoder.finish().unwrap();
        value
    }

    #[test]
    fn integers_too_long_are_refused() {
        let bytes = [&[1_u8][..], &[0xff; 9], &[2]].concat();
        let error = Decoder::new(&bytes, 1).unwrap().unsigned().unwrap_err();
        assert_eq!(error, CodecError::Invalid { what: "integer", offset: 11 });
    }

    /// An asymmetry of one ulp is the distance 1, which the sign makes 2.
    #[test]
    fn a_covariance_has_distances_from_its_upper_triangle() {
        let mut matrix = Matrix3::new(4.0, 1.0, 0.5, 1.0, 9.0, -0.25, 0.5, -0.25, 1.0);
        matrix[(1, 0)] = f64::from_bits(1.0_f64.to_bits() + 1);
        let mut encoder = Encoder::in_parts(0, true);
        encoder.covariance(&matrix);
        let (bytes, floats, distances) = encoder.parts();
        assert_eq!((bytes.len(), floats.len()), (0, 6 * 8));
        assert_eq!(distances.as_deref(), Some(&[2, 0, 0][..]));
        let mut decoder = Decoder::of_parts(&bytes, &floats, distances.as_deref());
        assert_eq!(decoder.covariance(), Ok(matrix));
        decoder.finish().unwrap();
    }

    proptest! {
        #[test]
        fn the_order_is_that_of_values(a: f64, b: f64) {
            prop_assume!(!a.is_nan() && !b.is_nan());
            let (first, second) = (ordered(a.to_bits()), ordered(b.to_bits()));
            prop_assert_eq!(first.cmp(&second), a.total_cmp(&b));
        }

        #[test]
        fn a_value_is_found_at_its_distance(bits: u64, from: u64) {
            prop_assert_eq!(at_distance(from, distance(bits, from)), bits);
            prop_assert_eq!(distance(from, from), 0);
        }

        #[test]
        fn integers(value: i64) {
            prop_assert_eq!(round_trip(|e| e.signed(value), |d| d.signed()), value);
            let unsigned = value as u64;
            prop_assert_eq!(round_trip(|e| e.unsigned(unsigned), |d| d.unsigned()), unsigned);
        }

        #[test]
        fn thousandths_keep_the_bits(bits: u64, decimal in -1e12_f64..1e12) {
            let whole = (decimal * 1e3).round() / 1e3;
            prop_assert!(thousandths(whole).is_some());
            // Always rounds with `round`, unlike `thousandths`.
            let rounded = |value: f64| Some((value * 1e3).round() as i64).filter(|thousandths| {
                let is_exact = (*thousandths as f64 / 1e3).to_bits() == value.to_bits();
                is_exact && thousandths.unsigned_abs() < THOUSANDTHS_MAX
            });
            let large = f64::from_bits(bits >> 12 | (0x427 + (bits & 1)) << 52); // 2⁴⁰ to 2⁴².
            for value in [f64::from_bits(bits), whole, large, -large, -0.0, f64::NAN] {
                prop_assert_eq!(thousandths(value), rounded(value));
                if let Some(thousandths) = thousandths(value) {
                    prop_assert_eq!((thousandths as f64 / 1e3).to_bits(), value.to_bits());
                }
            }
        }

        #[test]
        fn spans(ns: i64, ms in -9_000_000_000_i64..9_000_000_000) {
            for span in [ns, ms * NS_PER_MS] {
                prop_assert_eq!(round_trip(|e| e.span(span), |d| d.span()), span);
            }
        }

        #[test]
        fn times(ns: i64, seconds in -9_000_000_000_i64..9_000_000_000) {
            for time in [GpsTime::from_ns(ns), GpsTime::from_ns(seconds * NS_PER_SECOND)] {
                prop_assert_eq!(round_trip(|e| e.time(time), |d| d.time()), time);
            }
        }
    }
}
