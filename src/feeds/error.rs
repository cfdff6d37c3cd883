//! Why a host is not contacted, or cannot be reached.

use std::net::IpAddr;

use crate::refusal::Code;

/// Why a host is not contacted, or cannot be reached.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FetchError {
    /// The text is not a host, `host:port` or `*.domain`.
    #[error("{text:?} is not host, host:port or *.domain")]
    PatternInvalid {
        /// The text as given.
        text: String,
    },
    /// The text is not the address of a caster.
    #[error("{text:?} is not a caster's address such as ntrip://caster.example.org:2101")]
    CasterInvalid {
        /// The text as given.
        text: String,
    },
    /// The text is no URL of HTTP.
    #[error(
        "{text:?} is not a URL such as https://host.example.org/folder/file.gz, in ASCII, with \
         blanks as %20, without user and password"
    )]
    UrlInvalid {
        /// The text as given, shortened, without user and password.
        text: String,
    },
    /// The address of an archive's files has no placeholders for the day.
    #[error(
        "{text:?} has no placeholders for the day: {{yyyy}} or {{yy}}, with {{ddd}} or {{mm}} and \
         {{dd}}"
    )]
    TemplateWithoutDay {
        /// The text as given.
        text: String,
    },
    /// The text is not a valid name of a mountpoint.
    #[error("{text:?} is not a mountpoint: one to 100 printable characters without / ? # %")]
    MountpointInvalid {
        /// The text as given.
        text: String,
    },
    /// Hosts are listed for a text that is not the name of a tenant.
    #[error("{text:?} in fetch.tenants is not the name of a tenant")]
    TenantInvalid {
        /// The text as given.
        text: String,
    },
    /// The operator does not list the host.
    #[error("the operator does not allow {host}:{port}")]
    HostNotAllowed {
        /// Name or address of the host.
        host: String,
        /// TCP port.
        port: u16,
    },
    /// The host's name cannot be resolved.
    #[error("{host} cannot be resolved: {why}")]
    Unresolved {
        /// Name of the host.
        host: String,
        /// Message of the resolver.
        why: String,
    },
    /// The host's name resolves only to addresses that are not public.
    #[error("{host} has the address {address}, which is not public")]
    AddressRefused {
        /// Name of the host.
        host: String,
        /// The first of these addresses.
        address: IpAddr,
    },
    /// The host accepts no connection.
    #[error("{host} cannot be reached: {why}")]
    Unreachable {
        /// Name of the host.
        host: String,
        /// Message of the last attempt.
        why: String,
    },
    /// The TLS handshake failed.
    #[error("TLS with {host} failed: {why}")]
    Tls {
        /// Name of the host.
        host: String,
        /// Message of the TLS library.
        why: String,
    },
    /// A file of certificates cannot be read.
    #[error("certificates of {file}: {why}")]
    CertificatesInvalid {
        /// Path of the file.
        file: String,
        /// Message of the reader.
        why: String,
    },
}

impl FetchError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::PatternInvalid { .. } | Self::TenantInvalid { .. } => Code::FetchHostInvalid,
            Self::CasterInvalid { .. } => Code::CasterAddressInvalid,
            Self::UrlInvalid { .. } | Self::TemplateWithoutDay { .. } => Code::LocationInvalid,
            Self::MountpointInvalid { .. } => Code::MountpointInvalid,
            Self::HostNotAllowed { .. } => Code::HostNotAllowed,
            Self::Unresolved { .. } => Code::HostUnresolved,
            Self::AddressRefused { .. } => Code::AddressRefused,
            Self::Unreachable { .. } => Code::HostUnreachable,
            Self::Tls { .. } => Code::TlsFailed,
            Self::CertificatesInvalid { .. } => Code::CertificatesInvalid,
        }
    }
}
