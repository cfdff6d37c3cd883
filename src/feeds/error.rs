//! Why something cannot be fetched.

use std::net::IpAddr;

/// Why a host is not asked, or does not answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FetchError {
    /// A text in the list of hosts that names none.
    #[error("{text:?} is no host, host:port or *.domain")]
    PatternInvalid {
        /// The text.
        text: String,
    },
    /// A text that is no address of a caster.
    #[error("{text:?} is no address such as ntrip://caster.example.org:2101")]
    AddressInvalid {
        /// The text.
        text: String,
    },
    /// A text that is no address of a file.
    #[error("{text:?} is no address such as https://archive.example.org/{{yyyy}}/{{ddd}}/file.gz")]
    LocationInvalid {
        /// The text.
        text: String,
    },
    /// An address of files that does not tell of which time each is.
    #[error("{text:?} names no day: {{yyyy}} or {{yy}}, with {{ddd}} or {{mm}} and {{dd}}")]
    TemplateWithoutDay {
        /// The text.
        text: String,
    },
    /// A text that names no mountpoint.
    #[error("{text:?} is no mountpoint: one to 100 printable characters without / ? # %")]
    MountpointInvalid {
        /// The text.
        text: String,
    },
    /// The operator does not list the host.
    #[error("the operator does not allow {host}:{port}")]
    HostNotAllowed {
        /// The host.
        host: String,
        /// The port.
        port: u16,
    },
    /// The name leads nowhere.
    #[error("{host} cannot be resolved: {why}")]
    Unresolved {
        /// The host.
        host: String,
        /// What the resolver said.
        why: String,
    },
    /// The name leads into a private network.
    #[error("{host} is at {address}, which is no public address")]
    AddressRefused {
        /// The host.
        host: String,
        /// Its address.
        address: IpAddr,
    },
    /// No connection.
    #[error("{host} cannot be reached: {why}")]
    Unreachable {
        /// The host.
        host: String,
        /// What the last attempt said.
        why: String,
    },
    /// No encrypted connection.
    #[error("TLS with {host} failed: {why}")]
    Tls {
        /// The host.
        host: String,
        /// What is wrong.
        why: String,
    },
    /// Certificates that cannot be read.
    #[error("certificates of {file}: {why}")]
    CertificatesInvalid {
        /// The file.
        file: String,
        /// What is wrong.
        why: String,
    },
}

impl FetchError {
    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::PatternInvalid { .. } => "FETCH_HOST_INVALID",
            Self::AddressInvalid { .. } => "CASTER_ADDRESS_INVALID",
            Self::LocationInvalid { .. } | Self::TemplateWithoutDay { .. } => "LOCATION_INVALID",
            Self::MountpointInvalid { .. } => "MOUNTPOINT_INVALID",
            Self::HostNotAllowed { .. } => "HOST_NOT_ALLOWED",
            Self::Unresolved { .. } => "HOST_UNRESOLVED",
            Self::AddressRefused { .. } => "ADDRESS_REFUSED",
            Self::Unreachable { .. } => "HOST_UNREACHABLE",
            Self::Tls { .. } => "TLS_FAILED",
            Self::CertificatesInvalid { .. } => "CERTIFICATES_INVALID",
        }
    }

    /// What can be done about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::PatternInvalid { .. } => "list hosts as host, host:port or *.domain",
            Self::AddressInvalid { .. } => "write ntrip://HOST:PORT, or ntrips:// for TLS",
            Self::LocationInvalid { .. } | Self::TemplateWithoutDay { .. } => {
                "write http:// or https://, host, path and placeholders"
            }
            Self::MountpointInvalid { .. } => "choose a mountpoint of the caster's sourcetable",
            Self::HostNotAllowed { .. } => "let the operator list the host in fetch.hosts",
            Self::Unresolved { .. } => "check the host's name",
            Self::AddressRefused { .. } => {
                "name a public host, or let the operator set fetch.private_addresses"
            }
            Self::Unreachable { .. } => "check host and port; it is tried again",
            Self::Tls { .. } => {
                "check the host's certificate, or list its authority in fetch.ca_file"
            }
            Self::CertificatesInvalid { .. } => "name a PEM file of certificates",
        }
    }
}
