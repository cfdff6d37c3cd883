//! What the service is told: where it listens, where it stores, how much it takes.
//!
//! Every value has a default here; a TOML file, `GRAPHFIX_…` variables and arguments override it,
//! in this order. The command line reads them; a file's unknown key is refused by name.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;

use serde::Deserialize;

/// Nobody needs ephemerides more often, and archives are for everybody (s).
const ARCHIVE_INTERVAL_MIN_S: u64 = 60;

/// What the service is told.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServiceConfiguration {
    /// Address and port to listen on; loopback only, as long as there are no keys and no TLS.
    pub listen: SocketAddr,
    /// `sqlite://FILE` or `postgres://…`.
    pub database: String,
    /// How the log is written.
    pub log: LogConfiguration,
    /// Whom the service may ask for data.
    pub fetch: FetchConfiguration,
    /// What brings ephemerides.
    pub navigation: NavigationConfiguration,
    /// What brings bases.
    pub bases: BasesConfiguration,
    /// How much the service takes.
    pub limits: Limits,
}

/// What brings ephemerides beside uploads, bases and devices.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NavigationConfiguration {
    /// Addresses of RINEX navigation files, plain or gzip, one a day: `{yyyy}`, `{yy}`, `{mm}`,
    /// `{dd}`, `{ddd}` and `{hh}` stand for year, month, day, day of year and hour of GPS time.
    pub archives: Vec<String>,
    /// Seconds between requests for such a file.
    pub archive_interval_s: u64,
    /// Streams of NTRIP casters with ephemerides.
    pub casters: Vec<CasterConfiguration>,
}

/// What brings bases beside those that are created.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BasesConfiguration {
    /// Casters whose sourcetable says where bases stand: those nearest to rovers of sessions that
    /// take the nearest of all are connected while they are needed. Their hosts must be among those
    /// that may be asked.
    pub networks: Vec<NetworkConfiguration>,
    /// Seconds between requests for a sourcetable.
    pub table_interval_s: u64,
    /// Seconds after which a stream that no rover has needed is disconnected.
    pub idle_s: u64,
}

/// An NTRIP caster with many streams.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfiguration {
    /// Such as `ntrip://caster.example.org:2101`; `ntrips://` for TLS.
    pub caster: String,
    /// The caster's user; empty for none.
    #[serde(default)]
    pub user: String,
    /// The password.
    #[serde(default)]
    pub password: String,
}

impl fmt::Debug for NetworkConfiguration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.user, self.caster)
    }
}

/// A stream of an NTRIP caster.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CasterConfiguration {
    /// Such as `ntrip://caster.example.org:2101`; `ntrips://` for TLS.
    pub caster: String,
    /// The stream's name.
    pub mountpoint: String,
    /// The caster's user; empty for none.
    #[serde(default)]
    pub user: String,
    /// The password.
    #[serde(default)]
    pub password: String,
}

impl fmt::Debug for CasterConfiguration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}/{}", self.user, self.caster, self.mountpoint)
    }
}

/// Whom the service may ask for data by a client's wish, such as casters.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FetchConfiguration {
    /// Hosts that may be asked: `host`, `host:port`, or `*.domain` for all below a domain.
    pub hosts: Vec<String>,
    /// Whether they may be at addresses of private networks.
    pub private_addresses: bool,
    /// PEM file of certificate authorities that are trusted beside the usual ones.
    pub ca_file: Option<PathBuf>,
}

/// How the log is written.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LogConfiguration {
    /// One JSON object a line instead of text.
    pub json: bool,
    /// What is logged, such as `info` or `graphfix=debug,tower_http=info`.
    pub filter: String,
}

/// How much the service takes; each is a refusal with its own code when exceeded.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Bytes of a request's body or message, after decompression in transit.
    pub body_bytes: usize,
    /// Bytes of an upload once unpacked.
    pub decompressed_bytes: u64,
    /// Epochs in one push.
    pub epochs_per_push: usize,
    /// Bytes in one piece of a receiver's stream.
    pub raw_piece_bytes: usize,
    /// Satellites in one epoch.
    pub satellites_per_epoch: usize,
    /// Observations in one epoch.
    pub observations_per_epoch: usize,
    /// Sessions that hold an estimator in memory; idle ones are parked.
    pub active_sessions: usize,
    /// Epochs that may wait in one session's mailbox.
    pub mailbox_epochs: usize,
    /// Epochs that may wait in all mailboxes together.
    pub waiting_epochs: usize,
    /// Ephemerides held of one satellite.
    pub ephemerides_per_satellite: usize,
    /// Base stations.
    pub bases: usize,
    /// Epochs held of one base; further ones push out the oldest.
    pub epochs_per_base: usize,
    /// Bytes held of one base, about 26 a signal and epoch; further epochs push out the oldest.
    pub bytes_per_base: usize,
    /// Seconds for which a stopping service still serves while `/readyz` says no, so that a
    /// balancer looks elsewhere.
    pub drain_notice_s: u64,
    /// Seconds that running requests have to finish when the service stops.
    pub drain_s: u64,
}

/// The limits of what one push carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IntakeLimits {
    /// Epochs in one push.
    pub epochs_per_push: usize,
    /// Satellites in one epoch.
    pub satellites_per_epoch: usize,
    /// Observations in one epoch.
    pub observations_per_epoch: usize,
}

impl Limits {
    /// Those of one push.
    pub const fn intake(&self) -> IntakeLimits {
        IntakeLimits {
            epochs_per_push: self.epochs_per_push,
            satellites_per_epoch: self.satellites_per_epoch,
            observations_per_epoch: self.observations_per_epoch,
        }
    }
}

/// Why the service does not start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ServiceConfigurationError {
    /// The file is not the TOML it should be.
    #[error("{0}")]
    Malformed(String),
    /// An address that others can reach.
    #[error("refusing to listen on {0}: without keys and TLS only this machine may be served")]
    NotLoopback(SocketAddr),
    /// Archives would be asked all the time.
    #[error("navigation.archive_interval_s must be at least {ARCHIVE_INTERVAL_MIN_S}")]
    ArchiveInterval,
    /// Sourcetables would be asked for all the time.
    #[error("bases.table_interval_s must be at least {ARCHIVE_INTERVAL_MIN_S}")]
    TableInterval,
    /// A limit that would refuse everything.
    #[error("limits.{0} must be at least 1")]
    ZeroLimit(&'static str),
}

impl ServiceConfigurationError {
    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Malformed(_) => "CONFIGURATION_MALFORMED",
            Self::NotLoopback(_) => "LISTEN_NOT_LOOPBACK",
            Self::ArchiveInterval => "ARCHIVE_INTERVAL_TOO_SHORT",
            Self::TableInterval => "TABLE_INTERVAL_TOO_SHORT",
            Self::ZeroLimit(_) => "LIMIT_ZERO",
        }
    }

    /// What the operator can do about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::Malformed(_) => "correct the named line of the configuration file",
            Self::NotLoopback(_) => {
                "listen on 127.0.0.1 or [::1], behind a proxy that authenticates if others need it"
            }
            Self::ArchiveInterval => "ask archives seldom: an hour is usual",
            Self::TableInterval => "ask for sourcetables seldom: an hour is usual",
            Self::ZeroLimit(_) => "give a limit of at least 1, or leave it out",
        }
    }
}

impl ServiceConfiguration {
    /// What holds where nothing else is said.
    pub fn standard() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            database: "sqlite://graphfix.db".to_owned(),
            log: LogConfiguration { json: false, filter: "info".to_owned() },
            fetch: FetchConfiguration {
                hosts: Vec::new(),
                private_addresses: false,
                ca_file: None,
            },
            navigation: NavigationConfiguration {
                archives: Vec::new(),
                archive_interval_s: 3600,
                casters: Vec::new(),
            },
            bases: BasesConfiguration { networks: Vec::new(), table_interval_s: 3600, idle_s: 300 },
            limits: Limits::standard(),
        }
    }

    /// From the text of a TOML file; what it does not name is standard.
    ///
    /// # Errors
    /// [`ServiceConfigurationError::Malformed`] with line, key and what would be accepted.
    pub fn from_toml(text: &str) -> Result<Self, ServiceConfigurationError> {
        toml::from_str(text).map_err(|e| ServiceConfigurationError::Malformed(e.to_string()))
    }

    /// Checks what must hold before anything is opened.
    ///
    /// # Errors
    /// An address that is not loopback, or a limit of zero.
    pub fn check(&self) -> Result<(), ServiceConfigurationError> {
        if !self.listen.ip().is_loopback() {
            return Err(ServiceConfigurationError::NotLoopback(self.listen));
        }
        if self.navigation.archive_interval_s < ARCHIVE_INTERVAL_MIN_S {
            return Err(ServiceConfigurationError::ArchiveInterval);
        }
        if self.bases.table_interval_s < ARCHIVE_INTERVAL_MIN_S {
            return Err(ServiceConfigurationError::TableInterval);
        }
        let limits = &self.limits;
        let must_be_positive = [
            ("body_bytes", limits.body_bytes),
            (
                "decompressed_bytes",
                usize::try_from(limits.decompressed_bytes).unwrap_or(usize::MAX),
            ),
            ("epochs_per_push", limits.epochs_per_push),
            ("raw_piece_bytes", limits.raw_piece_bytes),
            ("satellites_per_epoch", limits.satellites_per_epoch),
            ("observations_per_epoch", limits.observations_per_epoch),
            ("active_sessions", limits.active_sessions),
            ("mailbox_epochs", limits.mailbox_epochs),
            ("waiting_epochs", limits.waiting_epochs),
            ("ephemerides_per_satellite", limits.ephemerides_per_satellite),
            ("bases", limits.bases),
            ("epochs_per_base", limits.epochs_per_base),
            ("bytes_per_base", limits.bytes_per_base),
        ];
        match must_be_positive.into_iter().find(|(_, value)| *value == 0) {
            Some((name, _)) => Err(ServiceConfigurationError::ZeroLimit(name)),
            None => Ok(()),
        }
    }
}

impl Limits {
    /// Limits for one small machine.
    pub const fn standard() -> Self {
        Self {
            body_bytes: 16 << 20,
            decompressed_bytes: 128 << 20,
            epochs_per_push: 1024,
            raw_piece_bytes: 256 << 10,
            satellites_per_epoch: 128,
            observations_per_epoch: 512,
            active_sessions: 4096,
            mailbox_epochs: 2048,
            waiting_epochs: 32_768,
            ephemerides_per_satellite: 480,
            bases: 64,
            epochs_per_base: 100_000,
            bytes_per_base: 32 << 20,
            drain_notice_s: 0,
            drain_s: 20,
        }
    }
}

// `serde(default)` asks for `Default`: here it is the standard, and nothing else uses it.
impl Default for ServiceConfiguration {
    fn default() -> Self {
        Self::standard()
    }
}

impl Default for LogConfiguration {
    fn default() -> Self {
        ServiceConfiguration::standard().log
    }
}

impl Default for NavigationConfiguration {
    fn default() -> Self {
        ServiceConfiguration::standard().navigation
    }
}

impl Default for BasesConfiguration {
    fn default() -> Self {
        ServiceConfiguration::standard().bases
    }
}

impl Default for FetchConfiguration {
    fn default() -> Self {
        ServiceConfiguration::standard().fetch
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self::standard()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_changes_what_it_names() {
        let text = "listen = \"127.0.0.1:9000\"\n[limits]\nepochs_per_push = 7\n";
        let read = ServiceConfiguration::from_toml(text).unwrap();
        assert_eq!(read.listen.port(), 9000);
        assert_eq!(read.limits.epochs_per_push, 7);
        assert_eq!(read.limits.active_sessions, Limits::standard().active_sessions);
    }

    #[test]
    fn an_unknown_key_is_refused_by_name() {
        let error = ServiceConfiguration::from_toml("[limits]\nepochs = 7\n").unwrap_err();
        assert!(error.to_string().contains("epochs_per_push"), "{error}");
        assert!(error.to_string().contains("line 2"), "{error}");
    }

    #[test]
    fn only_loopback_is_listened_on() {
        for (address, allowed) in
            [("127.0.0.1:80", true), ("[::1]:80", true), ("0.0.0.0:80", false)]
        {
            let listen = address.parse().unwrap();
            let check = ServiceConfiguration { listen, ..ServiceConfiguration::standard() }.check();
            assert_eq!(check.is_ok(), allowed, "{address}");
        }
    }

    #[test]
    fn a_limit_of_zero_is_refused() {
        let mut configuration = ServiceConfiguration::standard();
        configuration.limits.mailbox_epochs = 0;
        assert_eq!(
            configuration.check(),
            Err(ServiceConfigurationError::ZeroLimit("mailbox_epochs"))
        );
    }
}
