//! Why a RINEX file is refused as a whole.

use std::io;

/// What makes a file unreadable, with the line (from 1) where it showed.
#[derive(Debug, thiserror::Error)]
pub enum RinexError {
    /// The first line is not a RINEX or CRINEX first line.
    #[error("line {line}: not a RINEX file: {found:?} where RINEX VERSION / TYPE should be")]
    NotRinex {
        /// Line number.
        line: u64,
        /// What stands there, shortened.
        found: String,
    },
    /// RINEX, but of another kind than asked for.
    #[error("line {line}: this is a RINEX {found} file, {expected} data was expected")]
    WrongKind {
        /// Line number.
        line: u64,
        /// The file's kind.
        found: String,
        /// The kind asked for.
        expected: &'static str,
    },
    /// A version that is not read.
    #[error("line {line}: {format} version {version} is not supported")]
    UnsupportedVersion {
        /// Line number.
        line: u64,
        /// RINEX or CRINEX.
        format: &'static str,
        /// The version as written.
        version: String,
    },
    /// A header record without which the data cannot be understood is missing or wrong.
    #[error("line {line}: header record {label:?}: {reason}")]
    HeaderInvalid {
        /// Line number.
        line: u64,
        /// Label of the record.
        label: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The file ends inside its header.
    #[error("line {line}: the file ends inside its header")]
    Truncated {
        /// Number of the last line.
        line: u64,
    },
    /// Compressed by a method that is not read.
    #[error("line 1: the file is compressed with {method}, which is not supported")]
    CompressionUnsupported {
        /// Name of the method.
        method: &'static str,
    },
    /// A line longer than any RINEX line can be.
    #[error("line {line}: the line is longer than {limit} bytes")]
    LineTooLong {
        /// Line number.
        line: u64,
        /// The limit (bytes).
        limit: usize,
    },
    /// The bytes could not be read or inflated.
    #[error("line {line}: reading failed: {source}")]
    ReadFailed {
        /// Number of the last line read.
        line: u64,
        /// What the reader said.
        source: io::Error,
    },
}

impl RinexError {
    /// Stable name for interfaces.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::NotRinex { .. } => "RINEX_NOT_RINEX",
            Self::WrongKind { .. } => "RINEX_WRONG_KIND",
            Self::UnsupportedVersion { .. } => "RINEX_UNSUPPORTED_VERSION",
            Self::HeaderInvalid { .. } => "RINEX_HEADER_INVALID",
            Self::Truncated { .. } => "RINEX_TRUNCATED",
            Self::CompressionUnsupported { .. } => "RINEX_COMPRESSION_UNSUPPORTED",
            Self::LineTooLong { .. } => "RINEX_LINE_TOO_LONG",
            Self::ReadFailed { .. } => "RINEX_READ_FAILED",
        }
    }

    /// The line (from 1) where it showed.
    pub const fn line(&self) -> u64 {
        match self {
            Self::NotRinex { line, .. }
            | Self::WrongKind { line, .. }
            | Self::UnsupportedVersion { line, .. }
            | Self::HeaderInvalid { line, .. }
            | Self::Truncated { line }
            | Self::LineTooLong { line, .. }
            | Self::ReadFailed { line, .. } => *line,
            Self::CompressionUnsupported { .. } => 1,
        }
    }

    /// What the sender can do about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::NotRinex { .. } => "send a RINEX or CRINEX file, plain or gzip-compressed",
            Self::WrongKind { .. } => "send observation and navigation files each in their place",
            Self::UnsupportedVersion { .. } => {
                "convert the file to RINEX 2, 3 or 4, or CRINEX 1 or 3"
            }
            Self::HeaderInvalid { .. } => {
                "correct the header record, or convert the raw data again"
            }
            Self::Truncated { .. } => "fetch the file again: its end is missing",
            Self::CompressionUnsupported { .. } => {
                "unpack it first (uncompress for .Z, unzip for .zip), or compress it with gzip"
            }
            Self::LineTooLong { .. } => "check that the file is text with line ends",
            Self::ReadFailed { .. } => "fetch the file again: it could not be read to its end",
        }
    }
}
