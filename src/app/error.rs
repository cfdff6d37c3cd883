//! Why a service does not open, or stops.

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
    /// The folder of batch jobs.
    #[error(transparent)]
    Jobs(#[from] JobError),
    /// Stored keys.
    #[error(transparent)]
    Keys(#[from] KeyError),
    /// Others can reach the address, and anybody could call without a key.
    #[error("refusing to listen on {0}: without a key only this machine may be served")]
    NotLoopback(SocketAddr),
    /// Others can reach the address, and could read keys on their way.
    #[error("refusing to listen on {0} without TLS: keys could be read on their way")]
    NotEncrypted(SocketAddr),
    /// The certificate of the service.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The origins of web pages.
    #[error(transparent)]
    WebOrigins(#[from] WebOriginError),
    /// A key of stored secrets.
    #[error(transparent)]
    Secrets(#[from] SecretsError),
    /// The traces.
    #[error(transparent)]
    Traces(#[from] TracesError),
    /// The operator's calibrations of antennas.
    #[error("{}: {reason}", path.display())]
    Antex {
        /// The file.
        path: PathBuf,
        /// The error in it.
        reason: String,
    },
    /// The operator's table of the geoid.
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
