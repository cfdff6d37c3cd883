//! The certificate of the service, read from its files, and the certificates required of clients.

use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};

use blake3::Hash;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::server::danger::ClientCertVerifier;

use crate::clock;
use crate::config::TlsConfiguration;
use crate::meters::{Counter, Gauge};

use super::files::PemFile;
use super::validity::{Moment, Validity, next_update, validity};
use super::{HAS_VERSIONS, PROVIDER, TlsError};

/// Protocols that clients may agree on (RFC 7301), the preferred one first.
const PROTOCOLS: [&[u8]; 2] = [b"h2", b"http/1.1"];

/// TLS of the port of a service. All clones share it.
#[derive(Clone)]
pub(crate) struct ServerTls(Arc<Shared>);

struct Shared {
    files: ServerFiles,
    /// Used for all handshakes from now on.
    accepting: RwLock<TlsAcceptor>,
    meters: TlsMeters,
    /// The contents of the files at the start.
    first: Hash,
}

/// Meters of TLS. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct TlsMeters {
    /// End of the certificate that is served (s since 1970-01-01 UTC).
    pub(crate) expiry_s: Gauge,
    /// End of the list of revoked certificates that ends first (s since 1970-01-01 UTC); 0 without
    /// one.
    pub(crate) list_expiry_s: Gauge,
    /// 1 while the files are invalid and the served certificate is an older one.
    pub(crate) renewal_failed: Gauge,
    /// Handshakes that did not succeed.
    pub(crate) failed_handshakes: Counter,
}

/// The files of [`TlsConfiguration`], if TLS is on.
pub(super) struct ServerFiles {
    certificate: PathBuf,
    key: PathBuf,
    client_ca: Option<PathBuf>,
    client_crl: Option<PathBuf>,
}

/// The contents of the files.
pub(super) struct Contents {
    certificate: PemFile,
    key: PemFile,
    client_ca: Option<PemFile>,
    client_crl: Option<PemFile>,
}

/// A configuration for handshakes, and the ends of its certificate and of its lists.
pub(super) struct Accepting {
    acceptor: TlsAcceptor,
    pub(super) not_after: Moment,
    lists_until: Option<Moment>,
}

impl ServerTls {
    /// TLS as configured; `None` if the configuration names no certificate.
    ///
    /// # Errors
    /// A file cannot be read, the key does not belong to the certificate, or the certificate is not
    /// valid now.
    pub(crate) fn open(configuration: &TlsConfiguration) -> Result<Option<Self>, TlsError> {
        let TlsConfiguration { certificate_file, key_file, client_ca_file, client_crl_file } =
            configuration;
        let (Some(certificate), Some(key)) = (certificate_file.clone(), key_file.clone()) else {
            return Ok(None);
        };
        let (client_ca, client_crl) = (client_ca_file.clone(), client_crl_file.clone());
        let files = ServerFiles { certificate, key, client_ca, client_crl };
        let contents = files.read()?;
        let Accepting { acceptor, not_after, lists_until } = contents.accepting()?;
        let meters = TlsMeters::default();
        meters.set_ends(&not_after, lists_until.as_ref());
        let file = files.certificate.display();
        tracing::info!(%file, %not_after, "TLS with this certificate");
        let (accepting, first) = (RwLock::new(acceptor), contents.hash());
        Ok(Some(Self(Arc::new(Shared { files, accepting, meters, first }))))
    }

    /// The acceptor for the next handshake.
    pub(crate) fn acceptor(&self) -> TlsAcceptor {
        self.0.accepting.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Meters of TLS.
    pub(crate) fn meters(&self) -> &TlsMeters {
        &self.0.meters
    }

    /// The files.
    pub(super) fn files(&self) -> &ServerFiles {
        &self.0.files
    }

    /// The contents of the files at the start.
    pub(super) fn first(&self) -> Hash {
        self.0.first
    }

    /// Serves new connections with another certificate.
    pub(super) fn serve(&self, Accepting { acceptor, not_after, lists_until }: Accepting) {
        *self.0.accepting.write().unwrap_or_else(PoisonError::into_inner) = acceptor;
        self.0.meters.set_ends(&not_after, lists_until.as_ref());
    }
}

impl TlsMeters {
    fn set_ends(&self, not_after: &Moment, lists_until: Option<&Moment>) {
        self.expiry_s.set(not_after.unix_s);
        self.list_expiry_s.set(lists_until.map_or(0, |until| until.unix_s));
    }
}

impl ServerFiles {
    /// Reads the files.
    ///
    /// # Errors
    /// [`TlsError::File`].
    pub(super) fn read(&self) -> Result<Contents, TlsError> {
        Ok(Contents {
            certificate: PemFile::read(&self.certificate)?,
            key: PemFile::read(&self.key)?,
            client_ca: self.client_ca.as_deref().map(PemFile::read).transpose()?,
            client_crl: self.client_crl.as_deref().map(PemFile::read).transpose()?,
        })
    }
}

impl Contents {
    /// A hash of all files, by which a change is recognised. The key is not kept.
    pub(super) fn hash(&self) -> Hash {
        let mut hasher = blake3::Hasher::new();
        let files = [Some(&self.certificate), Some(&self.key), self.client_ca.as_ref()];
        for PemFile { content, .. } in files.into_iter().flatten().chain(&self.client_crl) {
            hasher.update(&content.len().to_le_bytes()).update(content);
        }
        hasher.finalize()
    }

    /// The configuration for handshakes with these contents.
    ///
    /// # Errors
    /// As [`ServerTls::open`].
    pub(super) fn accepting(&self) -> Result<Accepting, TlsError> {
        let chain = self.certificate.certificates()?;
        let Some(Validity { not_before, not_after }) = chain.first().and_then(|own| validity(own))
        else {
            return Err(self.certificate.invalid("the first certificate has no validity"));
        };
        let (now_s, file) = (clock::unix_ms() / 1000, self.certificate.path.clone());
        if not_after.unix_s < now_s {
            return Err(TlsError::Expired { file, not_after: not_after.to_string() });
        }
        if now_s < not_before.unix_s {
            return Err(TlsError::NotYetValid { file, not_before: not_before.to_string() });
        }
        let builder = ServerConfig::builder_with_provider(PROVIDER.clone())
            .with_safe_default_protocol_versions()
            .expect(HAS_VERSIONS);
        let lists_until = self.lists_until(now_s)?;
        let builder = match self.verifier()? {
            Some(verifier) => builder.with_client_cert_verifier(verifier),
            None => builder.with_no_client_auth(),
        };
        let built = builder.with_single_cert(chain, self.key.key()?);
        let mut configuration =
            built.map_err(|error| self.certificate.refused(&self.key, &error))?;
        configuration.alpn_protocols = PROTOCOLS.map(<[u8]>::to_vec).to_vec();
        Ok(Accepting { acceptor: Arc::new(configuration).into(), not_after, lists_until })
    }

    /// The end of the list of revoked certificates that ends first; `None` without lists.
    fn lists_until(&self, now_s: i64) -> Result<Option<Moment>, TlsError> {
        let Some(file) = &self.client_crl else { return Ok(None) };
        let mut first: Option<Moment> = None;
        for list in file.lists()? {
            let Some(until) = next_update(&list) else {
                return Err(file.invalid("a list of revoked certificates does not say its end"));
            };
            if until.unix_s < now_s {
                let (file, next_update) = (file.path.clone(), until.to_string());
                return Err(TlsError::ListExpired { file, next_update });
            }
            if first.is_none_or(|first| until.unix_s < first.unix_s) {
                first = Some(until);
            }
        }
        Ok(first)
    }

    /// The verifier of client certificates. If there are lists of revoked certificates, a client is
    /// refused whose authority has no list in force, because it may be revoked.
    fn verifier(&self) -> Result<Option<Arc<dyn ClientCertVerifier>>, TlsError> {
        let Some(file) = &self.client_ca else { return Ok(None) };
        let authorities = Arc::new(file.authorities()?);
        let builder = WebPkiClientVerifier::builder_with_provider(authorities, PROVIDER.clone());
        let Some(lists) = &self.client_crl else {
            let verifier = builder.build().map_err(|error| file.invalid(error.to_string()))?;
            return Ok(Some(verifier));
        };
        let builder = builder.with_crls(lists.lists()?).enforce_revocation_expiration();
        let verifier = builder.build().map_err(|error| lists.invalid(error.to_string()))?;
        Ok(Some(verifier))
    }
}
