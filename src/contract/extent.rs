//! The memory of a decoded protobuf message, computed from its encoded form.
//!
//! An empty epoch has two bytes encoded and 200 bytes decoded. So the fields are counted, and their
//! memory is reserved, before anything is decoded. Source: Protocol Buffers, *Encoding*
//! (protobuf.dev/programming-guides/encoding).

use std::any::TypeId;

use crate::refusal::Code;

use super::{Lease, Refusal, v1};

/// Number of the field `observations` of an epoch.
const OBSERVATIONS: u32 = 3;
/// Most fields of a message other than its epochs: entries of maps and ids of bases.
const FIELDS_MAX: usize = 4096;
/// Most fields of an epoch besides its observations, with a margin for unknown ones.
const FIELDS_OF_EPOCH: usize = 16;
/// Memory of a decoded epoch without its observations (bytes).
const EPOCH_BYTES: usize = 512;
/// Memory of a decoded observation: as a message, and as a measurement (bytes).
const OBSERVATION_BYTES: usize = 256;
/// Memory of any other decoded field without its content (bytes).
const FIELD_BYTES: usize = 128;

/// What a request contains, counted before it is decoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Extent {
    epochs: usize,
    observations: usize,
    /// Index of the epoch with the most observations, and their number.
    largest: (usize, usize),
    /// Fields that are neither epochs nor observations.
    others: usize,
}

impl Extent {
    /// Adds an epoch.
    pub(crate) fn add_epoch(&mut self, observations: usize) {
        if self.largest.1 < observations {
            self.largest = (self.epochs, observations);
        }
        self.epochs += 1;
        self.observations += observations;
    }

    /// Adds fields that are neither epochs nor observations.
    pub(crate) fn add_fields(&mut self, count: usize) {
        self.others += count;
    }

    /// Checks the counts, and reserves the memory of the decoded request: that of the counted
    /// fields, and `text_bytes` for its texts.
    ///
    /// # Errors
    /// A request has more epochs, observations or other fields than allowed, or memory is short.
    pub(crate) fn reserve(self, text_bytes: usize, lease: &Lease) -> Result<(), Refusal> {
        let Self { epochs, observations, largest: (index, count), others } = self;
        let limits = lease.limits();
        let refused =
            |code, message: String, field: String| Err(Refusal::new(code, message).at(field));
        let most = limits.epochs_per_push;
        if most < epochs {
            let message = format!("{epochs} epochs, at most {most} in a push");
            return refused(Code::TooManyEpochs, message, "epochs".to_owned());
        }
        let most = limits.observations_per_epoch;
        if most < count {
            let message = format!("{count} observations, at most {most} an epoch");
            return refused(
                Code::TooManyObservations,
                message,
                format!("epochs[{index}].observations"),
            );
        }
        if FIELDS_MAX + FIELDS_OF_EPOCH * epochs < others {
            let message = format!("the message has {others} fields, at most {FIELDS_MAX}");
            return Err(Refusal::new(Code::InvalidField, message));
        }
        let decoded =
            EPOCH_BYTES * epochs + OBSERVATION_BYTES * observations + FIELD_BYTES * others;
        lease.reserve(decoded + text_bytes)
    }
}

/// Counts the content of an encoded message `M`. Invalid bytes are left to the decoder.
pub(crate) fn extent_of<M: 'static>(bytes: &[u8]) -> Extent {
    let of_epochs = epochs_field(TypeId::of::<M>());
    let mut extent = Extent::default();
    for (field, content) in Fields(bytes) {
        if Some(field) != of_epochs {
            extent.add_fields(1);
            continue;
        }
        let (mut observations, mut others) = (0, 0);
        for (field, _) in Fields(content) {
            let count = if field == OBSERVATIONS { &mut observations } else { &mut others };
            *count += 1;
        }
        extent.add_epoch(observations);
        extent.add_fields(others);
    }
    extent
}

/// Number of the field with the epochs of a message of this type.
fn epochs_field(message: TypeId) -> Option<u32> {
    let fields = [
        (TypeId::of::<v1::PushEpochsRequest>(), 2),
        (TypeId::of::<v1::PushBaseEpochsRequest>(), 2),
        (TypeId::of::<v1::SolveOnceRequest>(), 4),
        (TypeId::of::<v1::StreamRequest>(), 2),
    ];
    fields.into_iter().find(|(of, _)| *of == message).map(|(_, field)| field)
}

/// The fields of a message: number, and content if it has a length. It ends at invalid bytes.
struct Fields<'a>(&'a [u8]);

impl<'a> Iterator for Fields<'a> {
    type Item = (u32, &'a [u8]);

    fn next(&mut self) -> Option<Self::Item> {
        let mut depth = 0_usize;
        let mut first = None;
        loop {
            let key = self.varint()?;
            let number = *first.get_or_insert(u32::try_from(key >> 3).ok()?);
            let mut content: &[u8] = &[];
            match key & 7 {
                0 => drop(self.varint()?),
                1 => drop(self.take(8)?),
                2 => {
                    let length = usize::try_from(self.varint()?).ok()?;
                    content = self.take(length)?;
                }
                3 => depth += 1,
                4 => depth = depth.checked_sub(1)?,
                5 => drop(self.take(4)?),
                _ => return None,
            }
            if depth == 0 {
                return Some((number, content));
            }
        }
    }
}

impl<'a> Fields<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let [byte] = *self.take(1)? else { return None };
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use prost::Message;

    use super::*;
    use crate::config::IntakeLimits;
    use crate::contract::Budget;

    fn lease() -> Lease {
        let limits =
            IntakeLimits { epochs_per_push: 3, satellites_per_epoch: 2, observations_per_epoch: 4 };
        Budget::new(64 << 20, limits).lease(None).unwrap()
    }

    fn push(epochs: usize, observations: usize) -> Vec<u8> {
        let observations = vec![v1::Observation::default(); observations];
        let time = Some(v1::GpsTime { week: 2051, ns_of_week: 9 });
        let epoch = v1::Epoch { seq: 7, time, observations, ..Default::default() };
        let session = "ses_1".to_owned();
        v1::PushEpochsRequest { session, epochs: vec![epoch; epochs] }.encode_to_vec()
    }

    fn refused<M: 'static>(bytes: &[u8]) -> (Code, String) {
        let refusal = extent_of::<M>(bytes).reserve(bytes.len(), &lease()).unwrap_err();
        (refusal.code, refusal.field.unwrap_or_default())
    }

    #[test]
    fn counts_are_checked_before_decoding() {
        type Push = v1::PushEpochsRequest;
        extent_of::<Push>(&push(3, 4)).reserve(9, &lease()).unwrap();
        assert_eq!(refused::<Push>(&push(4, 0)), (Code::TooManyEpochs, "epochs".to_owned()));
        let many = (Code::TooManyObservations, "epochs[0].observations".to_owned());
        assert_eq!(refused::<Push>(&push(1, 5)), many);
        // Two bytes each: field 2 with length 0.
        assert_eq!(refused::<Push>(&[0x12, 0].repeat(8_000_000)).0, Code::TooManyEpochs);
        let bases = v1::SolveRequest { bases: vec![String::new(); 5000], ..Default::default() };
        assert_eq!(refused::<v1::SolveRequest>(&bases.encode_to_vec()).0, Code::InvalidField);
    }

    /// Epochs after a group of unknown fields and before a damaged end are counted, as the decoder
    /// reads them.
    #[test]
    fn unknown_and_damaged_fields_hide_nothing() {
        let group = [0x7b, 0x12, 2, 9, 9, 0x08, 1, 0x7c];
        let bytes = [&group[..], &push(4, 0)].concat();
        assert_eq!(refused::<v1::PushEpochsRequest>(&bytes).0, Code::TooManyEpochs);
        for end in 0..bytes.len() {
            let cut = &bytes[..end];
            let (walked, decoded) = (Fields(cut).count(), v1::PushEpochsRequest::decode(cut));
            assert!(decoded.is_err() || decoded.unwrap().epochs.len() <= walked, "cut at {end}");
        }
    }
}
