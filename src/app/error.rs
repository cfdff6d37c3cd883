//! Why a service does not open, or stops.

use std::path::PathBuf;

use crate::aiding::AidingError;
use crate::feeds::FetchError;
use crate::refusal::Code;
use crate::store::StoreError;

/// Why a service does not open, or stops.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// The database.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Stored ephemerides or bases.
    #[error(transparent)]
    Aiding(#[from] AidingError),
    /// A source of data.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// The operator's calibrations of antennas.
    #[error("{}: {reason}", path.display())]
    Antex {
        /// The file.
        path: PathBuf,
        /// The error in it.
        reason: String,
    },
}

impl AppError {
    /// The stable code.
    pub(crate) fn code(&self) -> Code {
        match self {
            Self::Store(error) => error.code(),
            Self::Aiding(error) => error.code(),
            Self::Fetch(error) => error.code(),
            Self::Antex { .. } => Code::AntexInvalid,
        }
    }
}
