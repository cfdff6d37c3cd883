//! Options of TLS on the port of the service.

use std::path::PathBuf;

use serde::Deserialize;

/// TLS on the port of the service. Without a certificate the port is not encrypted.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TlsConfiguration {
    /// PEM file of the service's certificate, and behind it those up to its authority.
    pub certificate_file: Option<PathBuf>,
    /// PEM file of the certificate's private key, without a password.
    pub key_file: Option<PathBuf>,
    /// PEM file of authorities. Each client then needs a certificate that one of them has signed.
    pub client_ca_file: Option<PathBuf>,
    /// PEM file of the revocation lists of these authorities, one of each. Certificates on them are
    /// refused.
    pub client_crl_file: Option<PathBuf>,
}

impl TlsConfiguration {
    /// What is missing; `None` if TLS is complete or off.
    pub(super) fn missing(&self) -> Option<&'static str> {
        if self.client_crl_file.is_some() && self.client_ca_file.is_none() {
            return Some("tls.client_crl_file needs tls.client_ca_file, whose lists it has");
        }
        match (&self.certificate_file, &self.key_file, &self.client_ca_file) {
            (Some(_), Some(_), _) | (None, None, None) => None,
            (Some(_), None, _) => Some("tls.certificate_file needs tls.key_file, its private key"),
            (None, Some(_), _) => Some("tls.key_file needs tls.certificate_file"),
            (None, None, Some(_)) => {
                Some("tls.client_ca_file needs tls.certificate_file and tls.key_file")
            }
        }
    }
}
