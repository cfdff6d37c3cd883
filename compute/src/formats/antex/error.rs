//! Why an ANTEX file is refused.

use std::io;

/// Why an ANTEX file is refused, with the number of the line (from 1).
#[derive(Debug, thiserror::Error)]
pub enum AntexError {
    /// The input cannot be read.
    #[error("line {line}: reading failed: {source}")]
    Read {
        /// Number of the last line read.
        line: u64,
        /// Error of the input.
        source: io::Error,
    },
    /// The first line is not that of an ANTEX file.
    #[error("line 1: not an ANTEX file: {found:?} where ANTEX VERSION / SYST should be")]
    NotAntex {
        /// The text found instead, shortened.
        found: String,
    },
    /// The version is not supported.
    #[error("line 1: ANTEX version {version:?} is not supported")]
    UnsupportedVersion {
        /// The version as written in the file.
        version: String,
    },
    /// The phase centres are relative to those of another antenna.
    #[error(
        "line {line}: calibrations relative to an antenna are not supported, only absolute ones"
    )]
    Relative {
        /// Number of the line.
        line: u64,
    },
    /// The content of a record does not fit its label.
    #[error("line {line}: {label:?}: {reason}")]
    Malformed {
        /// Number of the line.
        line: u64,
        /// Label of the record, or of the section it belongs to.
        label: &'static str,
        /// What is wrong with the record.
        reason: &'static str,
    },
    /// A record is not allowed at this point.
    #[error("line {line}: unexpected record {found:?}")]
    Unexpected {
        /// Number of the line.
        line: u64,
        /// The label found, shortened.
        found: String,
    },
    /// The file ends inside an antenna or its header.
    #[error("line {line}: the file ends inside {section}")]
    Truncated {
        /// Number of the last line.
        line: u64,
        /// The section that has no end.
        section: &'static str,
    },
}
