//! Plain and encrypted connections to allowed hosts.

use std::fmt;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

use crate::tls::Connection;

use crate::tenant::Tenant;

use super::{FetchError, FetchPolicy};

/// Time limits for a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeLimits {
    /// Time to accept a connection at one address, and time for the TLS handshake.
    pub connecting: Duration,
    /// Time to send the whole head of its answer.
    pub answering: Duration,
    /// Time to send a whole list or file.
    pub listing: Duration,
}

impl TimeLimits {
    /// Suitable for slow public hosts.
    pub(crate) const fn standard() -> Self {
        Self {
            connecting: Duration::from_secs(10),
            answering: Duration::from_secs(15),
            listing: Duration::from_secs(60),
        }
    }
}

/// Connects to allowed hosts. All clones share it.
#[derive(Clone)]
pub struct Connector {
    policy: Arc<FetchPolicy>,
    tls: TlsConnector,
    time_limits: TimeLimits,
}

impl Connector {
    /// A connector under a policy. It trusts Mozilla's certificate authorities, and those in the
    /// PEM file `authorities`.
    ///
    /// # Errors
    /// The file of certificates cannot be read.
    pub fn new(
        policy: FetchPolicy,
        time_limits: TimeLimits,
        authorities: Option<&Path>,
    ) -> Result<Self, FetchError> {
        let mut roots = RootCertStore { roots: webpki_roots::TLS_SERVER_ROOTS.to_vec() };
        if let Some(path) = authorities {
            let refused = |why: String| FetchError::CertificatesInvalid {
                file: path.display().to_string(),
                why,
            };
            let all = CertificateDer::pem_file_iter(path).map_err(|e| refused(e.to_string()))?;
            for certificate in all {
                let certificate = certificate.map_err(|error| refused(error.to_string()))?;
                roots.add(certificate).map_err(|error| refused(error.to_string()))?;
            }
        }
        let configuration = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .expect("ring's provider has every version")
            .with_root_certificates(roots)
            .with_no_client_auth();
        Ok(Self { policy: Arc::new(policy), tls: Arc::new(configuration).into(), time_limits })
    }

    /// The same connector, for hosts that a tenant names.
    pub(crate) fn of(&self, tenant: &Tenant) -> Self {
        Self { policy: Arc::new(self.policy.of(tenant)), ..self.clone() }
    }

    /// The hosts that may be contacted.
    pub(crate) fn policy(&self) -> &FetchPolicy {
        &self.policy
    }

    /// The time limits.
    pub(crate) const fn time_limits(&self) -> &TimeLimits {
        &self.time_limits
    }

    /// Connects to a host at a checked address.
    ///
    /// # Errors
    /// The policy refuses the host, or it does not answer.
    pub(crate) async fn connect(
        &self,
        host: &str,
        port: u16,
        is_tls: bool,
    ) -> Result<Connection, FetchError> {
        let addresses = self.policy.resolve(host, port).await?;
        let connecting = self.time_limits.connecting;
        let stream = plain(host, &addresses, connecting).await?;
        // Err: only latency is lost.
        stream.set_nodelay(true).ok();
        if !is_tls {
            return Ok(Connection::Plain(stream));
        }
        let failed = |why: String| FetchError::Tls { host: host.to_owned(), why };
        let bare = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let name = ServerName::try_from(bare).map_err(|error| failed(error.to_string()))?;
        let agreed = tokio::time::timeout(connecting, self.tls.connect(name, stream)).await;
        let agreed = agreed.map_err(|_| failed("no answer".to_owned()))?;
        Ok(Connection::Tls(Box::new(agreed.map_err(|error| failed(error.to_string()))?)))
    }
}

impl fmt::Debug for Connector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Connector").field("policy", &self.policy).finish_non_exhaustive()
    }
}

async fn plain(
    host: &str,
    addresses: &[SocketAddr],
    connecting: Duration,
) -> Result<TcpStream, FetchError> {
    let mut why = String::new();
    for address in addresses {
        match tokio::time::timeout(connecting, TcpStream::connect(address)).await {
            Ok(Ok(stream)) => return Ok(stream),
            Ok(Err(error)) => why = format!("{address}: {error}"),
            Err(_) => why = format!("{address}: no answer"),
        }
    }
    Err(FetchError::Unreachable { host: host.to_owned(), why })
}
