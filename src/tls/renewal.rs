//! Renewal: the served certificate follows its files, without a restart.

use std::convert::Infallible;
use std::time::Duration;

use blake3::Hash;

use super::TlsError;
use super::server::{Accepting, ServerTls};

/// Interval at which the files are compared with the served certificate.
const INTERVAL: Duration = Duration::from_secs(2);

/// The result of reading the files: a hash of their contents, and the new configuration.
struct Look {
    /// Hash of the contents; of the error, if they cannot be read.
    hash: Hash,
    /// The new configuration; `None` if the files have not changed.
    found: Result<Option<Accepting>, TlsError>,
}

impl ServerTls {
    /// Compares the files with the served certificate, for ever. A valid new certificate serves new
    /// connections. An invalid one changes nothing and is reported once.
    pub(crate) async fn follow_files(&self) -> Infallible {
        let mut served = self.first();
        // Hashes of the invalid contents at the last look, and of those that were reported.
        let (mut seen, mut reported) = (None, None);
        loop {
            tokio::time::sleep(INTERVAL).await;
            let tls = self.clone();
            let look = tokio::task::spawn_blocking(move || tls.look(served)).await;
            // Err: it panicked, which is already reported, or the runtime ends.
            let Ok(Look { hash, found }) = look else { continue };
            match found {
                Ok(accepting) => {
                    if let Some(accepting) = accepting {
                        let not_after = accepting.not_after;
                        tracing::info!(%not_after, "new connections have the renewed certificate");
                        self.serve(accepting);
                        served = hash;
                    }
                    self.meters().renewal_failed.set(0);
                    (seen, reported) = (None, None);
                }
                // The files are written one after another, so contents that are invalid once are no
                // failure.
                Err(_) if seen != Some(hash) => seen = Some(hash),
                Err(error) => {
                    self.meters().renewal_failed.set(1);
                    if reported.replace(hash) != Some(hash) {
                        let code = error.code();
                        tracing::error!(%code, %error, "the certificate is not renewed");
                    }
                }
            }
        }
    }

    /// Reads the files, and checks them unless their hash is `served`.
    fn look(&self, served: Hash) -> Look {
        let contents = match self.files().read() {
            Ok(contents) => contents,
            Err(error) => {
                return Look {
                    hash: blake3::hash(error.to_string().as_bytes()),
                    found: Err(error),
                };
            }
        };
        let hash = contents.hash();
        let is_new = hash != served;
        Look { hash, found: is_new.then(|| contents.accepting()).transpose() }
    }
}
