//! Reasons for refusing a RINEX file as a whole.

use std::io;

use crate::gnss::SatelliteId;
use crate::refusal::Code;

/// Why a file cannot be read, with the number of the line (from 1).
#[derive(Debug, thiserror::Error)]
pub enum RinexError {
    /// The first line is not that of a RINEX or CRINEX file.
    #[error(
        "line {line}: not a RINEX file: {} where RINEX VERSION / TYPE should be",
        shown(.found)
    )]
    NotRinex {
        /// Number of the line.
        line: u64,
        /// The text found instead, shortened.
        found: String,
    },
    /// The file is RINEX of another kind than expected.
    #[error("line {line}: this is a RINEX {found} file, {expected} data was expected")]
    WrongKind {
        /// Number of the line.
        line: u64,
        /// The kind of the file.
        found: String,
        /// The kind that the reader expects.
        expected: &'static str,
    },
    /// The version is not supported.
    #[error("line {line}: {format} version {version} is not supported")]
    UnsupportedVersion {
        /// Number of the line.
        line: u64,
        /// Name of the format: RINEX or CRINEX.
        format: &'static str,
        /// The version as written in the file.
        version: String,
    },
    /// A required header record is missing or invalid.
    #[error("line {line}: header record {label:?}: {reason}")]
    HeaderInvalid {
        /// Number of the line.
        line: u64,
        /// Label of the record.
        label: &'static str,
        /// What is wrong with the record.
        reason: String,
    },
    /// The file ends before the end of its header.
    #[error("line {line}: the file ends inside its header")]
    Truncated {
        /// Number of the last line.
        line: u64,
    },
    /// The compression method is not supported.
    #[error("line 1: the file is compressed with {method}, which is not supported")]
    CompressionUnsupported {
        /// Name of the method.
        method: &'static str,
    },
    /// A line is longer than any valid line.
    #[error("line {line}: the line is longer than {limit} bytes")]
    LineTooLong {
        /// Number of the line.
        line: u64,
        /// Longest accepted line (bytes).
        limit: usize,
    },
    /// The file has more ephemerides of one satellite than are taken.
    #[error("line {line}: the file has more than {limit} ephemerides of {satellite}")]
    TooManyEphemerides {
        /// Number of the line.
        line: u64,
        /// The satellite.
        satellite: SatelliteId,
        /// Number of ephemerides that are taken of one satellite.
        limit: usize,
    },
    /// The bytes cannot be read or inflated.
    #[error("line {line}: reading failed: {source}")]
    ReadFailed {
        /// Number of the line that was being read.
        line: u64,
        /// Error of the input.
        source: io::Error,
    },
}

/// The text found in a file, or that there is none.
fn shown(found: &str) -> String {
    if found.is_empty() { "the file ends".to_owned() } else { format!("{found:?}") }
}

impl RinexError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::NotRinex { .. } => Code::RinexNotRinex,
            Self::WrongKind { .. } => Code::RinexWrongKind,
            Self::UnsupportedVersion { .. } => Code::RinexUnsupportedVersion,
            Self::HeaderInvalid { .. } => Code::RinexHeaderInvalid,
            Self::Truncated { .. } => Code::RinexTruncated,
            Self::CompressionUnsupported { .. } => Code::RinexCompressionUnsupported,
            Self::LineTooLong { .. } => Code::RinexLineTooLong,
            Self::TooManyEphemerides { .. } => Code::TooManyEphemerides,
            Self::ReadFailed { .. } => Code::RinexReadFailed,
        }
    }

    /// Number (from 1) of the line with the error.
    pub const fn line(&self) -> u64 {
        match self {
            Self::NotRinex { line, .. }
            | Self::WrongKind { line, .. }
            | Self::UnsupportedVersion { line, .. }
            | Self::HeaderInvalid { line, .. }
            | Self::Truncated { line }
            | Self::LineTooLong { line, .. }
            | Self::TooManyEphemerides { line, .. }
            | Self::ReadFailed { line, .. } => *line,
            Self::CompressionUnsupported { .. } => 1,
        }
    }
}
