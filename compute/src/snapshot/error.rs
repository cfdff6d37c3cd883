//! Why a snapshot is refused.

/// Why a snapshot is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    /// The bytes end too early.
    #[error("the snapshot ends at byte {offset}")]
    Truncated {
        /// Where they end.
        offset: usize,
    },
    /// Its hash is not that of its bytes.
    #[error("the snapshot's bytes are not those that were written")]
    Corrupt,
    /// It is of another layout, so of another version of the program.
    #[error("the snapshot has layout {found}, known is {known}")]
    UnknownLayout {
        /// Its layout.
        found: u16,
        /// The layout known here.
        known: u16,
    },
    /// A value is out of its range.
    #[error("{what} before byte {offset} is out of range")]
    Invalid {
        /// Which value.
        what: &'static str,
        /// Where it ends.
        offset: usize,
    },
    /// There are more bytes than values.
    #[error("{extra} bytes too many")]
    TrailingBytes {
        /// How many.
        extra: usize,
    },
}
