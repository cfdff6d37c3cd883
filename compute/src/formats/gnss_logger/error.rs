//! Why a log is refused as a whole.

use std::io;

use crate::refusal::Code;

/// Why a log cannot be decoded, with the number of the line (from 1).
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GnssLoggerError {
    /// A `Raw` record comes before the line that names its columns.
    #[error("line {line}: a Raw record before the line \"# Raw,…\" that names its columns")]
    NoColumns {
        /// Number of the line.
        line: u64,
    },
    /// A required column is absent.
    #[error("line {line}: no column is named {column}")]
    MissingColumn {
        /// Number of the line.
        line: u64,
        /// Name of the column.
        column: &'static str,
    },
    /// The columns change inside the log.
    #[error("line {line}: the columns of Raw records change inside the log")]
    ColumnsChange {
        /// Number of the line.
        line: u64,
    },
    /// A line is longer than any valid line.
    #[error("line {line}: the line is longer than {limit} bytes")]
    LineTooLong {
        /// Number of the line.
        line: u64,
        /// Longest accepted line (bytes).
        limit: usize,
    },
}

impl GnssLoggerError {
    /// The stable code.
    pub(crate) const fn code(&self) -> Code {
        match self {
            Self::NoColumns { .. } | Self::MissingColumn { .. } | Self::ColumnsChange { .. } => {
                Code::GnssLoggerHeaderInvalid
            }
            Self::LineTooLong { .. } => Code::GnssLoggerLineTooLong,
        }
    }

    /// Number (from 1) of the line with the error.
    pub const fn line(&self) -> u64 {
        match self {
            Self::NoColumns { line }
            | Self::MissingColumn { line, .. }
            | Self::ColumnsChange { line }
            | Self::LineTooLong { line, .. } => *line,
        }
    }
}

/// Why a file with a log is refused.
#[derive(Debug, thiserror::Error)]
pub enum LogFileError {
    /// The log cannot be decoded.
    #[error(transparent)]
    Log(#[from] GnssLoggerError),
    /// The bytes cannot be read or inflated.
    #[error("line {line}: reading failed: {source}")]
    ReadFailed {
        /// Number of lines read before.
        line: u64,
        /// Error of the input.
        source: io::Error,
    },
    /// No measurement of the log is usable.
    #[error("no measurement is usable in {records} Raw records{why}")]
    NothingUsable {
        /// Number of `Raw` records.
        records: u64,
        /// The most frequent cause, with its count and first line.
        why: String,
    },
    /// Navigation data was expected.
    #[error("an Android GnssLogger log has no navigation data that is decoded")]
    NoNavigation,
}

impl LogFileError {
    /// What the user can do about it.
    pub(crate) const fn remedy(&self) -> &'static str {
        match self {
            Self::Log(_) => "name the log as the app wrote it, from its first line",
            Self::ReadFailed { .. } => "copy the log from the phone again",
            Self::NothingUsable { .. } => "record under open sky until the phone has a position",
            Self::NoNavigation => "name a RINEX navigation file, or receiver data with ephemerides",
        }
    }
}
