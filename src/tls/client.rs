//! Encrypted connections from a command to a service.

use std::path::PathBuf;
use std::sync::Arc;

use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{ClientConfig, Error, RootCertStore};

use super::files::PemFile;
use super::{Connection, HAS_VERSIONS, PROVIDER, TlsError};

/// The files that are named for a client.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClientFiles {
    /// Authorities of services; `None` for Mozilla's.
    pub(crate) ca: Option<PathBuf>,
    /// The client's own certificate and its private key.
    pub(crate) identity: Option<(PathBuf, PathBuf)>,
}

/// Connects to services, encrypted if the address is `https://`. All clones share it.
#[derive(Clone)]
pub(crate) struct ClientTls(Arc<ClientConfig>);

impl ClientTls {
    /// A client that speaks `protocol` (the name of RFC 7301), with these files.
    ///
    /// # Errors
    /// A file cannot be read, or the key is not that of the certificate.
    pub(crate) fn new(files: &ClientFiles, protocol: &[u8]) -> Result<Self, TlsError> {
        let authorities = match &files.ca {
            Some(path) => PemFile::read(path)?.authorities()?,
            None => RootCertStore { roots: webpki_roots::TLS_SERVER_ROOTS.to_vec() },
        };
        let builder = ClientConfig::builder_with_provider(PROVIDER.clone())
            .with_safe_default_protocol_versions()
            .expect(HAS_VERSIONS)
            .with_root_certificates(authorities);
        let mut configuration = match &files.identity {
            None => builder.with_no_client_auth(),
            Some((certificate, key)) => {
                let (certificate, key) = (PemFile::read(certificate)?, PemFile::read(key)?);
                builder
                    .with_client_auth_cert(certificate.certificates()?, key.key()?)
                    .map_err(|error| certificate.refused(&key, &error))?
            }
        };
        configuration.alpn_protocols = vec![protocol.to_vec()];
        Ok(Self(Arc::new(configuration)))
    }

    /// Connects to `host`, whose certificate must have the name `name`.
    ///
    /// # Errors
    /// The host does not answer, or one of the two refuses the other's certificate
    /// ([`TlsError::Handshake`] within the error).
    pub(crate) async fn connect(
        &self,
        (host, port): (&str, u16),
        name: Option<&str>,
    ) -> std::io::Result<Connection> {
        let bare = |host: &str| host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let stream = TcpStream::connect((bare(host), port)).await?;
        // Err: only latency is lost.
        stream.set_nodelay(true).ok();
        let Some(name) = name else { return Ok(Connection::Plain(stream)) };
        let refused =
            |why: String| std::io::Error::other(TlsError::Handshake { host: host.to_owned(), why });
        let name = ServerName::try_from(bare(name)).map_err(|error| refused(error.to_string()))?;
        let agreed = TlsConnector::from(self.0.clone()).connect(name, stream).await;
        match agreed {
            Ok(stream) => Ok(Connection::Tls(Box::new(stream))),
            Err(error) if error.get_ref().is_some_and(|inner| inner.is::<Error>()) => {
                Err(refused(error.to_string()))
            }
            Err(error) => Err(error),
        }
    }
}
