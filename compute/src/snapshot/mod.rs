//! The state of a computation as bytes, and back with the same bits: what survives a restart.
//!
//! Knows nothing of what it stores. A type names its fields with `snapshot_fields!` or
//! `snapshot_variants!`, or with `state_fields!` where copies reuse storage. Each names every
//! field: one that is added later and not named does not compile.
//!
//! # Form
//! A snapshot is `layout` (16 bits, little-endian), the values one after the other without names,
//! and the first eight bytes of the BLAKE3 hash of all that. `f64` are little-endian IEEE 754,
//! integers LEB128, lists preceded by their length. A change of the stored fields must raise the
//! layout, so that older snapshots are refused and not misread. A snapshot that stays in memory
//! needs no hash. Corrupt bytes give a
//! [`SnapshotError`] with their position; reading allocates at most a small multiple of their
//! length.

mod error;
mod plain;
mod reader;
mod writer;

pub use error::SnapshotError;
pub use reader::SnapshotReader;
pub use writer::{SnapshotWriter, seal};

/// A value that can be stored and read back bit by bit.
pub trait Snapshot: Sized {
    /// Writes the value.
    fn save(&self, writer: &mut SnapshotWriter);

    /// Reads a value that [`Self::save`] wrote.
    ///
    /// # Errors
    /// The bytes end early, or hold a value out of its range.
    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError>;
}

/// Implements [`Snapshot`] for a struct: all its fields in the order they are stored. `checked by`
/// names a method `fn(&self) -> bool`; a value that fails it is refused on loading.
#[macro_export]
macro_rules! snapshot_fields {
    (
        generic [$($generic:tt)*] $type:ty { $($field:ident),* $(,)? }
        $(checked by $check:ident)?
    ) => {
        impl<$($generic)*> $crate::snapshot::Snapshot for $type {
            fn save(&self, writer: &mut $crate::snapshot::SnapshotWriter) {
                let Self { $($field),* } = self;
                $($crate::snapshot::Snapshot::save($field, writer);)*
            }

            fn load(
                reader: &mut $crate::snapshot::SnapshotReader<'_>,
            ) -> Result<Self, $crate::snapshot::SnapshotError> {
                let value = Self { $($field: $crate::snapshot::Snapshot::load(reader)?),* };
                $(if !value.$check() {
                    return Err(reader.invalid(stringify!($type)));
                })?
                Ok(value)
            }
        }
    };
    ($type:ty { $($field:ident),* $(,)? } $(checked by $check:ident)?) => {
        $crate::snapshot::snapshot_fields!(
            generic [] $type { $($field),* } $(checked by $check)?
        );
    };
}

/// Implements [`Clone`] for a struct, with a `clone_from` that copies every field into the storage
/// that is there already.
#[macro_export]
macro_rules! clone_fields {
    (generic [$($generic:tt)*] $type:ty { $($field:ident),* $(,)? }) => {
        impl<$($generic)*> Clone for $type {
            fn clone(&self) -> Self {
                Self { $($field: Clone::clone(&self.$field)),* }
            }

            fn clone_from(&mut self, source: &Self) {
                let Self { $($field),* } = self;
                $(Clone::clone_from($field, &source.$field);)*
            }
        }
    };
    ($type:ty { $($field:ident),* $(,)? }) => {
        $crate::snapshot::clone_fields!(generic [] $type { $($field),* });
    };
}

/// `snapshot_fields!` and `clone_fields!` in one.
macro_rules! state_fields {
    (
        generic [$($generic:tt)*] $type:ty { $($field:ident),* $(,)? }
        $(checked by $check:ident)?
    ) => {
        $crate::snapshot::snapshot_fields!(
            generic [$($generic)*] $type { $($field),* } $(checked by $check)?
        );
        $crate::snapshot::clone_fields!(generic [$($generic)*] $type { $($field),* });
    };
    ($type:ty { $($field:ident),* $(,)? } $(checked by $check:ident)?) => {
        $crate::snapshot::state_fields!(
            generic [] $type { $($field),* } $(checked by $check)?
        );
    };
}

/// Implements [`Snapshot`] for an enumeration: a number that never changes for each variant, and
/// all its fields.
macro_rules! snapshot_variants {
    ($type:ty { $($number:literal => $variant:ident { $($field:ident),* }),* $(,)? }) => {
        impl $crate::snapshot::Snapshot for $type {
            fn save(&self, writer: &mut $crate::snapshot::SnapshotWriter) {
                match self {
                    $(Self::$variant { $($field),* } => {
                        writer.u8($number);
                        $($crate::snapshot::Snapshot::save($field, writer);)*
                    })*
                }
            }

            fn load(
                reader: &mut $crate::snapshot::SnapshotReader<'_>,
            ) -> Result<Self, $crate::snapshot::SnapshotError> {
                match reader.u8()? {
                    $($number => Ok(Self::$variant {
                        $($field: $crate::snapshot::Snapshot::load(reader)?),*
                    }),)*
                    _ => Err(reader.invalid(stringify!($type))),
                }
            }
        }
    };
}

pub use {clone_fields, snapshot_fields};
pub(crate) use {snapshot_variants, state_fields};
