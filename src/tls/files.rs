//! The files of certificates and keys: PEM, as text in base64 (RFC 7468).

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{
    CertificateDer, CertificateRevocationListDer, PrivateKeyDer,
};
use tokio_rustls::rustls::{Error, RootCertStore};

use super::TlsError;

/// Largest file that is read (bytes). The authorities of all browsers together have 0.3 MB.
const FILE_BYTES: u64 = 1 << 20;

/// The content of a file.
pub(super) struct PemFile {
    pub(super) path: PathBuf,
    pub(super) content: Vec<u8>,
}

impl PemFile {
    /// Reads a file.
    ///
    /// # Errors
    /// [`TlsError::File`].
    pub(super) fn read(path: &Path) -> Result<Self, TlsError> {
        let file = Self { path: path.to_owned(), content: Vec::new() };
        let mut content = Vec::new();
        let read = File::open(path).and_then(|f| f.take(FILE_BYTES + 1).read_to_end(&mut content));
        match read {
            Err(error) => Err(file.invalid(error.to_string())),
            Ok(length) if FILE_BYTES < length as u64 => {
                Err(file.invalid(format!("the file has more than {FILE_BYTES} bytes")))
            }
            Ok(_) => Ok(Self { content, ..file }),
        }
    }

    /// The certificates in the file, at least one.
    ///
    /// # Errors
    /// [`TlsError::File`].
    pub(super) fn certificates(&self) -> Result<Vec<CertificateDer<'static>>, TlsError> {
        let read: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&self.content).collect();
        match read {
            Ok(certificates) if certificates.is_empty() => {
                Err(self.invalid("the file has no certificate"))
            }
            Ok(certificates) => Ok(certificates),
            Err(error) => Err(self.invalid(error.to_string())),
        }
    }

    /// The first private key in the file.
    ///
    /// # Errors
    /// [`TlsError::File`].
    pub(super) fn key(&self) -> Result<PrivateKeyDer<'static>, TlsError> {
        PrivateKeyDer::from_pem_slice(&self.content)
            .map_err(|error| self.invalid(format!("no private key without a password: {error}")))
    }

    /// The certificates in the file as authorities.
    ///
    /// # Errors
    /// [`TlsError::File`].
    pub(super) fn authorities(&self) -> Result<RootCertStore, TlsError> {
        let mut authorities = RootCertStore::empty();
        for certificate in self.certificates()? {
            authorities.add(certificate).map_err(|error| self.invalid(error.to_string()))?;
        }
        Ok(authorities)
    }

    /// The lists of revoked certificates in the file, at least one.
    ///
    /// # Errors
    /// [`TlsError::File`].
    pub(super) fn lists(&self) -> Result<Vec<CertificateRevocationListDer<'static>>, TlsError> {
        let read: Result<Vec<_>, _> =
            CertificateRevocationListDer::pem_slice_iter(&self.content).collect();
        match read {
            Ok(lists) if lists.is_empty() => {
                Err(self.invalid("the file has no list of revoked certificates"))
            }
            Ok(lists) => Ok(lists),
            Err(error) => Err(self.invalid(error.to_string())),
        }
    }

    /// The error of a certificate in this file and a key in another file that do not fit.
    pub(super) fn refused(&self, key: &Self, error: &Error) -> TlsError {
        match error {
            Error::InconsistentKeys(_) => {
                TlsError::KeyMismatch { key: key.path.clone(), certificate: self.path.clone() }
            }
            Error::InvalidCertificate(_) => self.invalid(error.to_string()),
            _ => key.invalid(error.to_string()),
        }
    }

    /// The error that the file does not contain what it should.
    pub(super) fn invalid(&self, why: impl Into<String>) -> TlsError {
        TlsError::File { file: self.path.clone(), why: why.into() }
    }
}
