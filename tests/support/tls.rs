//! A service with TLS in this process, certificates made for a test, and clients that trust them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use graphfix::app;
use graphfix::config::{Limits, ServiceConfiguration, TlsConfiguration};
use graphfix::contract::Service;
use graphfix::feeds::FeedOptions;
use hyper_util::rt::TokioIo;
use rcgen::{
    BasicConstraints, CertificateParams, CertificateRevocationListParams, DnType, IsCa, Issuer,
    KeyIdMethod, KeyPair, KeyUsagePurpose, RevokedCertParams, SerialNumber, date_time_ymd,
};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};
use tonic::transport::{Channel, Endpoint};

use super::casters::{BRISK, PATIENCE};

/// A name of the service besides `localhost`.
pub(crate) const NAME: &str = "gnss.example";

/// An authority that signs certificates.
pub(crate) struct Authority {
    issuer: Issuer<'static, KeyPair>,
    /// Its own certificate.
    pub(crate) pem: String,
}

/// A certificate with its key, both as PEM.
#[derive(Clone)]
pub(crate) struct Pair {
    pub(crate) certificate: String,
    pub(crate) key: String,
}

impl Authority {
    pub(crate) fn new(name: &str) -> Self {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
        let key = KeyPair::generate().unwrap();
        let pem = params.self_signed(&key).unwrap().pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// A certificate of the service, or of a client, that is valid now.
    pub(crate) fn signed(&self) -> Pair {
        self.signed_for(2020, 2090)
    }

    /// A certificate that is valid from the beginning of one year to that of another.
    pub(crate) fn signed_for(&self, first: i32, last: i32) -> Pair {
        let names = ["localhost", "127.0.0.1", NAME].map(str::to_owned);
        let mut params = CertificateParams::new(names).unwrap();
        params.not_before = date_time_ymd(first, 1, 1);
        params.not_after = date_time_ymd(last, 1, 1);
        let key = KeyPair::generate().unwrap();
        let certificate = params.signed_by(&key, &self.issuer).unwrap().pem();
        Pair { certificate, key: key.serialize_pem() }
    }

    /// The certificate of a client with a serial number of its own.
    pub(crate) fn signed_as(&self, serial: u64) -> Pair {
        let mut params = CertificateParams::new(vec![format!("rover-{serial}")]).unwrap();
        params.serial_number = Some(SerialNumber::from(serial));
        let key = KeyPair::generate().unwrap();
        let certificate = params.signed_by(&key, &self.issuer).unwrap().pem();
        Pair { certificate, key: key.serialize_pem() }
    }

    /// The list of revoked certificates (PEM) until the beginning of a year.
    pub(crate) fn revoked(&self, serials: &[u64], until: i32) -> String {
        let revoked = |serial: &u64| RevokedCertParams {
            serial_number: SerialNumber::from(*serial),
            revocation_time: date_time_ymd(2021, 1, 1),
            reason_code: None,
            invalidity_date: None,
        };
        let list = CertificateRevocationListParams {
            this_update: date_time_ymd(2021, 1, 1),
            next_update: date_time_ymd(until, 1, 1),
            crl_number: SerialNumber::from(1),
            issuing_distribution_point: None,
            revoked_certs: serials.iter().map(revoked).collect(),
            key_identifier_method: KeyIdMethod::Sha256,
        };
        list.signed_by(&self.issuer).unwrap().pem().unwrap()
    }

    /// A client that trusts this authority, speaks `protocol`, and has a certificate if `own`.
    pub(crate) fn client(&self, own: Option<&Pair>, protocol: &str) -> TlsConnector {
        let mut authorities = RootCertStore::empty();
        authorities.add(der(&self.pem)).unwrap();
        let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(authorities);
        let mut configuration = match own {
            None => builder.with_no_client_auth(),
            Some(Pair { certificate, key }) => {
                let key = PrivateKeyDer::from_pem_slice(key.as_bytes()).unwrap();
                builder.with_client_auth_cert(vec![der(certificate)], key).unwrap()
            }
        };
        configuration.alpn_protocols = vec![protocol.as_bytes().to_vec()];
        Arc::new(configuration).into()
    }
}

/// The first certificate of a PEM text.
pub(crate) fn der(pem: &str) -> CertificateDer<'static> {
    CertificateDer::from_pem_slice(pem.as_bytes()).unwrap()
}

/// The files of a service with TLS in a folder.
pub(crate) struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    /// Files in a new folder, with the pair of a service.
    pub(crate) fn new(pair: &Pair) -> Self {
        let files = Self { folder: tempfile::tempdir().unwrap() };
        files.put(pair);
        files
    }

    /// Replaces the pair of the service, the key first.
    pub(crate) fn put(&self, pair: &Pair) {
        self.write("service.key", &pair.key);
        self.write("service.pem", &pair.certificate);
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file as a whole.
    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let (path, new) = (self.path(name), self.path("new"));
        std::fs::write(&new, text).unwrap();
        std::fs::rename(&new, &path).unwrap();
        path
    }

    /// The options of a service with this pair.
    pub(crate) fn configuration(&self, client_ca: Option<&Authority>) -> TlsConfiguration {
        TlsConfiguration {
            certificate_file: Some(self.path("service.pem")),
            key_file: Some(self.path("service.key")),
            client_ca_file: client_ca.map(|authority| self.write("clients.pem", &authority.pem)),
            client_crl_file: None,
        }
    }

    /// A service with these options, and its port.
    pub(crate) async fn serve(&self, tls: TlsConfiguration, limits: Limits) -> (Service, u16) {
        let database = format!("sqlite://{}", self.path("test.db").display());
        let hosts = vec![NAME.to_owned(), "127.0.0.1".to_owned()];
        let configuration = ServiceConfiguration {
            database,
            tls,
            hosts,
            limits,
            ..ServiceConfiguration::standard()
        };
        let options: FeedOptions = BRISK;
        let app = app::open(&configuration, PATIENCE, options).await.unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let service = app.service().clone();
        tokio::spawn(app.serve(listener, std::future::pending()));
        (service, port)
    }
}

/// A connection after its handshake.
pub(crate) async fn connected(
    port: u16,
    client: &TlsConnector,
) -> std::io::Result<TlsStream<TcpStream>> {
    let stream = TcpStream::connect(("127.0.0.1", port)).await?;
    client.connect(ServerName::try_from("localhost").unwrap(), stream).await
}

/// The certificate that new connections see.
pub(crate) async fn seen(port: u16, client: &TlsConnector) -> CertificateDer<'static> {
    let stream = connected(port, client).await.unwrap();
    stream.get_ref().1.peer_certificates().unwrap()[0].clone()
}

/// The whole answer to a page that is asked for under the name `host`.
pub(crate) async fn page(port: u16, client: &TlsConnector, host: &str, path: &str) -> String {
    let mut stream = connected(port, client).await.unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    last_words(&mut stream).await
}

/// The value of a meter.
pub(crate) async fn meter(port: u16, authority: &Authority, name: &str) -> f64 {
    let page = page(port, &authority.client(None, "http/1.1"), "localhost", "/metrics").await;
    let lines = page.lines().filter(|line| line.starts_with(name));
    let value = lines.filter_map(|line| line.rsplit(' ').next()).next().unwrap_or_default();
    value.parse().unwrap_or_else(|_| panic!("{name} is not on the page: {page}"))
}

/// All that the service sends until it closes the connection.
pub(crate) async fn last_words(stream: &mut (impl AsyncRead + Unpin)) -> String {
    let mut answer = Vec::new();
    let read = stream.read_to_end(&mut answer);
    // Err: the service closed it while bytes were on their way.
    tokio::time::timeout(Duration::from_secs(30), read).await.expect("not closed").ok();
    String::from_utf8_lossy(&answer).into_owned()
}

/// A channel of gRPC.
pub(crate) fn channel(port: u16, client: &TlsConnector) -> Channel {
    let client = client.clone();
    let connector = tower::service_fn(move |_| {
        let client = client.clone();
        async move { connected(port, &client).await.map(TokioIo::new) }
    });
    let address = format!("https://localhost:{port}");
    Endpoint::from_shared(address).unwrap().connect_with_connector_lazy(connector)
}

/// The path as an argument.
pub(crate) fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
