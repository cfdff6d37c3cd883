//! Arguments of commands that call a service: the authorities they trust, and their certificate.

use std::error::Error;
use std::io;
use std::iter::successors;
use std::path::PathBuf;

use clap::Args;

use crate::feeds::Url;
use crate::tls::{ClientFiles, ClientTls, TlsError};

use super::Failure;

/// Beginning of rustls's message about an alert of the peer; the name of the alert follows.
const ALERT: &str = "received fatal alert: ";

/// Files for addresses that begin with https://.
#[derive(Clone, Debug, Default, Args)]
pub(super) struct TrustArguments {
    /// Authority that has signed the certificate of the service (PEM). Default: those of browsers.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_CA")]
    ca: Option<PathBuf>,
    /// Own certificate (PEM), where the service asks for one.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_CLIENT_CERT", requires = "client_key")]
    client_cert: Option<PathBuf>,
    /// Private key of the own certificate (PEM), without a password.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_CLIENT_KEY", requires = "client_cert")]
    client_key: Option<PathBuf>,
}

impl TrustArguments {
    /// A client that speaks `protocol`, such as `h2`.
    ///
    /// # Errors
    /// A file cannot be read, or the key is not that of the certificate.
    pub(super) fn client(&self, protocol: &[u8]) -> Result<ClientTls, Failure> {
        let identity = self.client_cert.clone().zip(self.client_key.clone());
        Ok(ClientTls::new(&ClientFiles { ca: self.ca.clone(), identity }, protocol)?)
    }
}

/// The address of a service.
pub(super) fn address(text: &str) -> Result<Url, String> {
    text.parse().map_err(|_| format!("{text:?} is not an address such as http://127.0.0.1:8080"))
}

/// Why client and service do not agree on TLS, if TLS is among the causes of an error.
pub(super) fn tls_failure(error: &(dyn Error + 'static)) -> Option<Failure> {
    let mut causes = successors(Some(error), |error: &&(dyn Error + 'static)| (*error).source());
    causes.find_map(|cause| {
        let inner = cause.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        if let Some(error) = inner.and_then(|inner| inner.downcast_ref::<TlsError>()) {
            return Some(error.clone().into());
        }
        // The service refuses a client's certificate after the client has finished its handshake.
        // The client then has an error of HTTP/2, which keeps only the text of the cause.
        let text = cause.to_string();
        let (_, alert) = text.split_once(ALERT)?;
        let alert = alert.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
        let (host, why) = ("the service".to_owned(), format!("{ALERT}{alert}"));
        Some(TlsError::Handshake { host, why }.into())
    })
}

impl From<TlsError> for Failure {
    fn from(error: TlsError) -> Self {
        match error {
            TlsError::Handshake { .. } => {
                let remedy = "check the certificates, or give --ca, --client-cert and --client-key";
                Self::new(error.code(), &error, remedy)
            }
            error => Self::of(error.code(), &error),
        }
    }
}
