//! Why a certificate is not used, or a connection is not encrypted.

use std::path::PathBuf;

use crate::refusal::Code;

/// Why a certificate is not used, or a connection is not encrypted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read, or does not contain what it should.
    #[error("{}: {why}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The private key does not belong to the certificate.
    #[error("{}: this is not the private key of {}", key.display(), certificate.display())]
    KeyMismatch {
        /// The file of the key.
        key: PathBuf,
        /// The file of the certificate.
        certificate: PathBuf,
    },
    /// The certificate has expired.
    #[error("{}: the certificate has expired at {not_after}", file.display())]
    Expired {
        /// The file of the certificate.
        file: PathBuf,
        /// Date and time of its end.
        not_after: String,
    },
    /// The certificate is not valid yet.
    #[error("{}: the certificate is not valid before {not_before}", file.display())]
    NotYetValid {
        /// The file of the certificate.
        file: PathBuf,
        /// Date and time of its beginning.
        not_before: String,
    },
    /// A list of revoked certificates has expired; its authority has published a newer one.
    #[error("{}: the list of revoked certificates has expired at {next_update}", file.display())]
    ListExpired {
        /// The file of the list.
        file: PathBuf,
        /// Date and time by which the authority publishes the next one.
        next_update: String,
    },
    /// A handshake with a service failed.
    #[error("{host}: {why}")]
    Handshake {
        /// Name or address of the service.
        host: String,
        /// Why one side refuses the other.
        why: String,
    },
}

impl TlsError {
    /// The stable code.
    pub(crate) const fn code(&self) -> Code {
        match self {
            Self::File { .. } => Code::TlsFileInvalid,
            Self::KeyMismatch { .. } => Code::TlsKeyMismatch,
            Self::Expired { .. } | Self::NotYetValid { .. } | Self::ListExpired { .. } => {
                Code::TlsCertificateExpired
            }
            Self::Handshake { .. } => Code::TlsFailed,
        }
    }
}
