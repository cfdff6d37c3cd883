//! Rows as bytes: a compact binary form of epochs, solutions, ephemerides and calibrations of
//! antennas.
//!
//! Each form starts with the number of its layout and is canonical: equal values give equal bytes,
//! and each `f64` is restored bit by bit. Earlier layouts can still be read. Integers are LEB128
//! with variable length (signed ones zigzag), times are nanoseconds, `f64` is little-endian
//! IEEE 754. Corrupt bytes give a [`CodecError`].

mod antenna;
mod bits;
mod bytes;
mod columns;
mod ephemeris;
mod epoch;
mod lists;
mod measures;
mod observations;
mod parts;
#[cfg(test)]
mod sample;
mod signals;
mod solution;

pub(super) use antenna::{decode_calibration, encode_calibration};
pub(super) use columns::{
    SolutionColumns, SolutionSummary, solution_columns, solution_summary, status_number,
};
pub(super) use ephemeris::{
    NavigationRecord, decode_ephemeris, decode_record, encode_ephemeris, encode_record,
};
pub(super) use epoch::{
    Distances, decode_epoch, decode_relative_epoch, distances, encode_epoch, encode_relative_epoch,
};
pub(super) use measures::{Measures, solution_measures};
pub(super) use solution::{decode_solution, encode_revision, encode_solution, is_relative};

/// Why bytes cannot be decoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The bytes end too early.
    #[error("the bytes end at {offset}")]
    Truncated {
        /// Number of bytes.
        offset: usize,
    },
    /// The version of the bytes is unknown.
    #[error("version {version} is not known")]
    UnknownVersion {
        /// The version found.
        version: u8,
    },
    /// A value is out of range.
    #[error("{what} at byte {offset} is out of range")]
    Invalid {
        /// Name of the value.
        what: &'static str,
        /// Offset of its end.
        offset: usize,
    },
    /// The epoch or solution to which another is relative is not stored.
    #[error("that to which it is relative is missing")]
    ReferenceMissing,
    /// Bytes follow the last value.
    #[error("{extra} bytes too many")]
    TrailingBytes {
        /// Number of these bytes.
        extra: usize,
    },
}

#[cfg(test)]
mod tests {
    use std::fmt::Debug;

    use proptest::prelude::*;

    use crate::gnss::{KlobucharCoefficients, NeQuickCoefficients, Solution};

    use super::solution::DecodedSolution;
    use super::*;

    /// Compares the printed values, and the bytes of the value encoded again. Printing shows all
    /// bits but the payload of NaN, which the bytes contain.
    fn assert_round_trip<T: Debug>(
        value: &T,
        encode: impl Fn(&T) -> Vec<u8>,
        decode: impl Fn(&[u8]) -> Result<T, CodecError>,
    ) {
        let bytes = encode(value);
        let read = decode(&bytes).unwrap();
        assert_eq!(format!("{read:?}"), format!("{value:?}"));
        assert_eq!(encode(&read), bytes);
        for length in 0..bytes.len() {
            assert!(decode(&bytes[..length]).is_err(), "cut to {length} of {}", bytes.len());
        }
        let longer = [&bytes[..], &[0]].concat();
        assert_eq!(decode(&longer).unwrap_err(), CodecError::TrailingBytes { extra: 1 });
    }

    #[test]
    fn a_later_version_is_named() {
        assert_eq!(decode_epoch(&[9]), Err(CodecError::UnknownVersion { version: 9 }));
        assert_eq!(decode_epoch(&[]), Err(CodecError::Truncated { offset: 0 }));
    }

    #[test]
    fn records_round_trip() {
        let klobuchar = KlobucharCoefficients {
            alpha: [1.1e-8, -7.4e-9, -5.9e-8, 1.1e-7],
            beta: [1.1e5, -6.5e4, -6.5e4, 3.2e5],
        };
        let nequick = NeQuickCoefficients { ai: [65.5, -0.1, 0.01] };
        for record in [
            NavigationRecord::Klobuchar(klobuchar),
            NavigationRecord::NeQuick(nequick),
            NavigationRecord::LeapSeconds(19),
        ] {
            assert_round_trip(&record, encode_record, decode_record);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn epochs_round_trip(epoch in sample::epoch()) {
            assert_round_trip(&epoch, encode_epoch, decode_epoch);
        }

        #[test]
        fn solutions_round_trip(solution in sample::solution()) {
            let columns = solution_columns(&solution);
            let decode = |bytes: &[u8]| decode_solution(bytes, columns, None).map(|d| d.solution);
            assert_round_trip(&solution, encode_solution, decode);
        }

        /// A revision is read with the first answer, whatever the two have in common.
        #[test]
        fn revisions_round_trip(first in sample::solution(), other in sample::solution()) {
            let bytes = encode_solution(&first);
            for revision in [&first, &other] {
                let columns = solution_columns(revision);
                let encode = |revision: &Solution| encode_revision(revision, &bytes);
                let decode = |revision: &[u8]| {
                    decode_solution(revision, columns, Some(&bytes)).map(|d| d.solution)
                };
                assert_round_trip(revision, encode, decode);
            }
            let columns = solution_columns(&first);
            let same = encode_revision(&first, &bytes);
            if 32 < bytes.len() {
                // Distances of arbitrary values take 84 bits each: up to eight of an estimate.
                let most = if first.estimate.is_some() { 16 + 8 * 84 / 8 } else { 16 };
                prop_assert!(is_relative(&same) && same.len() < most, "{} bytes", same.len());
                let alone = decode_solution(&same, columns, None);
                prop_assert_eq!(alone, Err(CodecError::ReferenceMissing));
            }
        }

        #[test]
        fn calibrations_round_trip(calibration in sample::calibration()) {
            assert_round_trip(&calibration, encode_calibration, decode_calibration);
        }

        #[test]
        fn ephemerides_round_trip(ephemeris in sample::ephemeris()) {
            assert_round_trip(&ephemeris, encode_ephemeris, decode_ephemeris);
        }

        /// Bytes changed anywhere give an error or another valid value, but no panic.
        #[test]
        fn corrupted_bytes_never_panic(
            epoch in sample::epoch(),
            solution in sample::solution(),
            ephemeris in sample::ephemeris(),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        ) {
            let corrupted = |mut bytes: Vec<u8>| {
                for (index, byte) in &changes {
                    let index = index.index(bytes.len());
                    bytes[index] = *byte;
                }
                bytes
            };
            if let Ok(read) = decode_epoch(&corrupted(encode_epoch(&epoch))) {
                prop_assert!(decode_epoch(&encode_epoch(&read)).is_ok());
            }
            let columns = solution_columns(&solution);
            let bytes = corrupted(encode_solution(&solution));
            let decode = |bytes: &[u8], columns| decode_solution(bytes, columns, None);
            if let Ok(DecodedSolution { solution: read, .. }) = decode(&bytes, columns) {
                let columns = solution_columns(&read);
                prop_assert!(decode(&encode_solution(&read), columns).is_ok());
            }
            let revision = encode_revision(&solution, &encode_solution(&solution));
            let first = corrupted(encode_solution(&solution));
            decode_solution(&corrupted(revision.clone()), columns, Some(&first)).ok();
            decode_solution(&revision, columns, Some(&first)).ok();
            if let Ok(read) = decode_ephemeris(&corrupted(encode_ephemeris(&ephemeris))) {
                prop_assert!(decode_ephemeris(&encode_ephemeris(&read)).is_ok());
            }
        }
    }
}
