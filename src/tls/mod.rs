//! TLS: the certificate of the service and its renewal, and the authorities that the program trusts
//! as a client.
//!
//! Cryptography and protocol are those of rustls, with *ring*. Files are read here, and
//! certificates of the service are checked before use. The handshakes of the service are in `http`.

mod client;
mod connection;
mod error;
mod files;
mod renewal;
mod server;
mod validity;

use std::sync::{Arc, LazyLock};

use tokio_rustls::rustls::crypto::{CryptoProvider, ring};

pub(crate) use client::{ClientFiles, ClientTls};
pub use connection::Connection;
pub use error::TlsError;
pub(crate) use server::ServerTls;

/// The cryptography of all connections.
static PROVIDER: LazyLock<Arc<CryptoProvider>> =
    LazyLock::new(|| Arc::new(ring::default_provider()));
/// Why a configuration with every version of TLS in rustls can be built.
const HAS_VERSIONS: &str = "ring's provider has every version";
