//! Why no traces can be sent.

use crate::refusal::Code;
use crate::tls::TlsError;

/// Why no traces can be sent.
#[derive(Debug, thiserror::Error)]
pub enum TracesError {
    /// This program sends no traces.
    #[error("telemetry.otlp_endpoint is only in a build with the feature \"otlp\"")]
    NotBuilt,
    /// The address of the collector is invalid.
    #[error("telemetry.otlp_endpoint {endpoint:?}: {why}")]
    Endpoint {
        /// The address as given.
        endpoint: String,
        /// What is wrong with it.
        why: String,
    },
    /// The file of authorities cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
}

impl TracesError {
    /// The stable code.
    pub(crate) const fn code(&self) -> Code {
        match self {
            Self::NotBuilt => Code::FeatureNotBuilt,
            Self::Endpoint { .. } => Code::TelemetryEndpointInvalid,
            Self::Tls(error) => error.code(),
        }
    }
}
