//! Numbers, options, lists, arrays and matrices.

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::SMatrix;

use super::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

impl Snapshot for f64 {
    #[inline]
    fn save(&self, writer: &mut SnapshotWriter) {
        writer.f64(*self);
    }

    #[inline]
    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        reader.f64()
    }
}

impl Snapshot for u64 {
    #[inline]
    fn save(&self, writer: &mut SnapshotWriter) {
        writer.unsigned(*self);
    }

    #[inline]
    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        reader.unsigned()
    }
}

impl Snapshot for i64 {
    fn save(&self, writer: &mut SnapshotWriter) {
        writer.unsigned(((*self << 1) ^ (*self >> 63)) as u64);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let value = reader.unsigned()?;
        Ok((value >> 1) as i64 ^ -((value & 1) as i64))
    }
}

/// Implements it for an integer by way of a wider one.
macro_rules! narrow {
    ($($type:ty as $wide:ty),*) => {$(
        impl Snapshot for $type {
            #[inline]
            fn save(&self, writer: &mut SnapshotWriter) {
                (*self as $wide).save(writer);
            }

            #[inline]
            fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
                let value = <$wide>::load(reader)?;
                value.try_into().map_err(|_| reader.invalid(stringify!($type)))
            }
        }
    )*};
}

narrow!(u8 as u64, u16 as u64, u32 as u64, usize as u64, i32 as i64);

impl Snapshot for bool {
    fn save(&self, writer: &mut SnapshotWriter) {
        writer.u8(u8::from(*self));
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        match reader.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(reader.invalid("yes or no")),
        }
    }
}

impl<T: Snapshot> Snapshot for Option<T> {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.is_some().save(writer);
        if let Some(value) = self {
            value.save(writer);
        }
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        if bool::load(reader)? { T::load(reader).map(Some) } else { Ok(None) }
    }
}

/// Nothing.
impl Snapshot for () {
    fn save(&self, _writer: &mut SnapshotWriter) {}

    fn load(_reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        Ok(())
    }
}

impl<A: Snapshot, B: Snapshot> Snapshot for (A, B) {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.0.save(writer);
        self.1.save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        Ok((A::load(reader)?, B::load(reader)?))
    }
}

impl<T: Snapshot> Snapshot for Box<T> {
    fn save(&self, writer: &mut SnapshotWriter) {
        T::save(self, writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        T::load(reader).map(Self::new)
    }
}

/// Who shares it with whom is not kept.
impl<T: Snapshot> Snapshot for Arc<T> {
    fn save(&self, writer: &mut SnapshotWriter) {
        T::save(self, writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        T::load(reader).map(Self::new)
    }
}

/// In UTF-8.
impl Snapshot for String {
    fn save(&self, writer: &mut SnapshotWriter) {
        writer.bytes(self.as_bytes());
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let bytes = reader.bytes()?.to_vec();
        Self::from_utf8(bytes).map_err(|_| reader.invalid("text"))
    }
}

/// Largest usual ratio of an item's memory to its bytes.
const LOADED_TO_BYTES: usize = 4;

/// Every item takes a byte or more, which bounds what a corrupt length can ask for.
impl<T: Snapshot> Snapshot for Vec<T> {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.len().save(writer);
        self.iter().for_each(|item| item.save(writer));
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let count = reader.count()?;
        // Items in memory are larger than their bytes, and a corrupt count may be anything: at most
        // a multiple of the bytes that are left is allocated beforehand.
        let most = LOADED_TO_BYTES * reader.left() / size_of::<T>().max(1);
        let mut items = Self::with_capacity(count.min(most));
        for _ in 0..count {
            items.push(T::load(reader)?);
        }
        Ok(items)
    }
}

impl<T: Snapshot> Snapshot for VecDeque<T> {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.len().save(writer);
        self.iter().for_each(|item| item.save(writer));
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        Vec::load(reader).map(Self::from)
    }
}

impl<T: Snapshot, const N: usize> Snapshot for [T; N] {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.iter().for_each(|item| item.save(writer));
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let mut items = std::array::from_fn(|_| None);
        for item in &mut items {
            *item = Some(T::load(reader)?);
        }
        Ok(items.map(|item| item.expect("each was loaded")))
    }
}

/// Column by column.
impl<const R: usize, const C: usize> Snapshot for SMatrix<f64, R, C> {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.iter().for_each(|value| writer.f64(*value));
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let mut matrix = Self::zeros();
        for value in &mut matrix {
            *value = reader.f64()?;
        }
        Ok(matrix)
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use nalgebra::Matrix2x3;
    use proptest::prelude::*;

    use super::*;
    use crate::snapshot::{seal, snapshot_variants};

    #[derive(Clone, Debug, PartialEq)]
    enum Shape {
        Point {},
        Circle { radius: f64 },
    }

    snapshot_variants!(Shape { 0 => Point {}, 1 => Circle { radius } });

    fn bytes(value: &impl Snapshot) -> Vec<u8> {
        let mut writer = SnapshotWriter::new(7);
        value.save(&mut writer);
        writer.finish()
    }

    fn read<T: Snapshot>(snapshot: &[u8]) -> Result<T, SnapshotError> {
        let mut reader = SnapshotReader::open(snapshot, 7)?;
        let value = T::load(&mut reader)?;
        reader.finish()?;
        Ok(value)
    }

    fn assert_round_trip<T: Snapshot + PartialEq + Debug>(value: T) {
        let snapshot = bytes(&value);
        assert_eq!(read::<T>(&snapshot), Ok(value));
        for length in 0..snapshot.len() {
            assert!(read::<T>(&snapshot[..length]).is_err(), "cut to {length}");
        }
    }

    #[test]
    fn values_round_trip() {
        assert_round_trip((u64::MAX, i64::MIN));
        assert_round_trip(vec![Some(3_u32), None]);
        assert_round_trip(([true, false], -5_i32));
        assert_round_trip(Matrix2x3::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
        assert_round_trip(vec![Shape::Point {}, Shape::Circle { radius: -0.0 }]);
        assert_eq!(bytes(&f64::NAN), bytes(&read::<f64>(&bytes(&f64::NAN)).unwrap()));
    }

    #[test]
    fn what_was_not_written_is_refused_with_its_place() {
        let out_of_range = |what, offset| SnapshotError::Invalid { what, offset };
        assert_eq!(read::<bool>(&bytes(&2_u8)), Err(out_of_range("yes or no", 3)));
        assert_eq!(read::<u8>(&bytes(&256_u64)), Err(out_of_range("u8", 4)));
        assert_eq!(read::<Shape>(&bytes(&9_u8)), Err(out_of_range("Shape", 3)));
        assert_eq!(read::<Vec<f64>>(&bytes(&9_u8)), Err(out_of_range("number of items", 3)));
        assert_eq!(read::<u8>(&bytes(&[1_u8; 3])), Err(SnapshotError::TrailingBytes { extra: 2 }));
        let other = SnapshotWriter::new(8).finish();
        let error = SnapshotError::UnknownLayout { found: 8, known: 7 };
        assert_eq!(read::<u8>(&other), Err(error));
    }

    /// Only its hash distinguishes a snapshot from one that stays in memory.
    #[test]
    fn an_unsealed_snapshot_is_sealed_later() {
        let mut writer = SnapshotWriter::within(7, vec![9; 100]);
        vec![1.5_f64; 3].save(&mut writer);
        let unsealed = writer.finish_unsealed();
        let mut reader = SnapshotReader::open_unsealed(&unsealed, 7).unwrap();
        assert_eq!(Vec::<f64>::load(&mut reader), Ok(vec![1.5; 3]));
        let error = SnapshotError::UnknownLayout { found: 7, known: 8 };
        assert_eq!(SnapshotReader::open_unsealed(&unsealed, 8).unwrap_err(), error);
        assert_eq!(seal(unsealed), bytes(&vec![1.5_f64; 3]));
    }

    proptest! {
        /// A change of any byte changes the hash.
        #[test]
        fn a_changed_byte_is_noticed(place: prop::sample::Index, change in 1_u8..) {
            let mut snapshot = bytes(&vec![1.5_f64; 9]);
            let place = place.index(snapshot.len());
            snapshot[place] ^= change;
            prop_assert_eq!(read::<Vec<f64>>(&snapshot), Err(SnapshotError::Corrupt));
        }
    }
}
