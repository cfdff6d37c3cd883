//! Why a service cannot open, or stops.

use std::net::SocketAddr;
use std::path::PathBuf;

use crate::aiding::AidingError;
use crate::contract::WebOriginError;
use crate::feeds::FetchError;
use crate::formats::geoid::GeoidError;
use crate::jobs::JobError;
use crate::keys::KeyError;
use crate::refusal::Code;
use crate::secrets::SecretsError;
use crate::store::StoreError;
use crate::tls::TlsError;
use crate::traces::TracesError;

/// Why a service cannot open, or stops.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// The database fails.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Stored ephemerides or bases cannot be read.
    #[error(transparent)]
    Aiding(#[from] AidingError),
    /// A source of data is invalid or not allowed.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// The folder of batch jobs cannot be used.
    #[error(transparent)]
    Jobs(#[from] JobError),
    /// Stored keys cannot be read.
    #[error(transparent)]
    Keys(#[from] KeyError),
    /// Other machines could reach the address and call without a key.
    #[error("refusing to listen on {0}: without a key only this machine may be served")]
    NotLoopback(SocketAddr),
    /// Other machines could reach the address, and keys could be read in transit.
    #[error("refusing to listen on {0} without TLS: keys could be read on their way")]
    NotEncrypted(SocketAddr),
    /// The certificate of the service cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The origins of web pages are invalid.
    #[error(transparent)]
    WebOrigins(#[from] WebOriginError),
    /// A key of stored secrets cannot be used.
    #[error(transparent)]
    Secrets(#[from] SecretsError),
    /// Traces cannot be sent.
    #[error(transparent)]
    Traces(#[from] TracesError),
    /// The file with the operator's calibrations of antennas is invalid.
    #[error("{}: {reason}", path.display())]
    Antex {
        /// The file.
        path: PathBuf,
        /// The error in it.
        reason: String,
    },
    /// The operator's table of the geoid is invalid.
    #[error("{}: {error}", path.display())]
    Geoid {
        /// The file.
        path: PathBuf,
        /// The error in it.
        error: GeoidError,
    },
}

impl AppError {
    /// The stable code.
    pub(crate) fn code(&self) -> Code {
        match self {
            Self::Store(error) => error.code(),
            Self::Aiding(error) => error.code(),
            Self::Fetch(error) => error.code(),
            Self::Jobs(error) => error.code(),
            Self::Keys(error) => error.code(),
            Self::NotLoopback(_) => Code::ListenNotLoopback,
            Self::NotEncrypted(_) => Code::ListenNotEncrypted,
            Self::Tls(error) => error.code(),
            Self::WebOrigins(_) => Code::ConfigurationMalformed,
            Self::Secrets(error) => error.code(),
            Self::Traces(error) => error.code(),
            Self::Antex { .. } => Code::AntexInvalid,
            Self::Geoid { .. } => Code::GeoidInvalid,
        }
    }
}
