//! Options of the service: where it listens, where it stores, and its limits.
//!
//! Every value has a default here. A TOML file, `GRAPHFIX_…` variables and arguments override it,
//! in this order. The command line reads them; an unknown key in the file is refused by name.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;

use serde::Deserialize;

use crate::refusal::Code;

use super::jobs::JobsConfiguration;

/// Shortest interval between requests (s): ephemerides change once an hour, and archives serve
/// everybody.
const ARCHIVE_INTERVAL_MIN_S: u64 = 60;

/// Longest retention (days): a century.
pub(crate) const RETENTION_MAX_DAYS: u32 = 36_500;

/// Options of the service.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServiceConfiguration {
    /// Address and port to listen on; beyond loopback only once a key exists.
    pub listen: SocketAddr,
    /// Name of this node in the log, in answers, and to another service on the same database.
    /// Empty: the name of the host and a random mark.
    pub node: String,
    /// Names under which the service may be asked, beside `localhost` and its address: those of a
    /// proxy that passes the name on. Web pages of these hosts may ask it, too.
    pub hosts: Vec<String>,
    /// URL of the database: `sqlite://FILE` or `postgres://…`.
    pub database: String,
    /// Format and filter of the log.
    pub log: LogConfiguration,
    /// Hosts that the service may connect to at a client's request.
    pub fetch: FetchConfiguration,
    /// Sources of ephemerides besides uploads.
    pub navigation: NavigationConfiguration,
    /// Sources of base stations.
    pub bases: BasesConfiguration,
    /// Phase centres of antennas.
    pub antennas: AntennasConfiguration,
    /// Batch jobs.
    pub jobs: JobsConfiguration,
    /// Limits on what the service accepts.
    pub limits: Limits,
}

/// Sources of ephemerides besides uploads, bases and devices.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NavigationConfiguration {
    /// Addresses of RINEX navigation files, plain or gzip, one a day: `{yyyy}`, `{yy}`, `{mm}`,
    /// `{dd}`, `{ddd}` and `{hh}` become year, month, day, day of year and hour of GPS time.
    pub archives: Vec<String>,
    /// Time between requests for one file (s).
    pub archive_interval_s: u64,
    /// NTRIP streams that carry ephemerides.
    pub casters: Vec<CasterConfiguration>,
}

/// Sources of base stations besides those that clients create.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BasesConfiguration {
    /// Casters whose sourcetables give base positions. The streams nearest to rovers whose session
    /// takes the nearest base are connected while needed. Their hosts must be listed in
    /// `fetch.hosts`.
    pub networks: Vec<NetworkConfiguration>,
    /// Time between requests for a sourcetable (s).
    pub table_interval_s: u64,
    /// Time without need after which a stream is disconnected (s).
    pub idle_s: u64,
}

/// Phase centres of antennas.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AntennasConfiguration {
    /// ANTEX file of absolute calibrations, plain or gzip. Sessions that name the rover's antenna
    /// correct observations for it and for the base's.
    pub antex: Option<PathBuf>,
}

/// An NTRIP caster with many streams.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfiguration {
    /// The caster's URL, such as `ntrip://caster.example.org:2101`; `ntrips://` for TLS.
    pub caster: String,
    /// The caster's user; empty for none.
    #[serde(default)]
    pub user: String,
    /// Password of the caster's user; empty for none.
    #[serde(default)]
    pub password: String,
}

impl fmt::Debug for NetworkConfiguration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.user, self.caster)
    }
}

/// One stream of an NTRIP caster.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CasterConfiguration {
    /// The caster's URL, such as `ntrip://caster.example.org:2101`; `ntrips://` for TLS.
    pub caster: String,
    /// The mountpoint, without a slash.
    pub mountpoint: String,
    /// The caster's user; empty for none.
    #[serde(default)]
    pub user: String,
    /// Password of the caster's user; empty for none.
    #[serde(default)]
    pub password: String,
}

impl fmt::Debug for CasterConfiguration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}/{}", self.user, self.caster, self.mountpoint)
    }
}

/// Hosts that the service may connect to at a client's request, such as casters.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FetchConfiguration {
    /// Allowed hosts: `host`, `host:port`, or `*.domain` for all hosts below a domain.
    pub hosts: Vec<String>,
    /// Whether these hosts may have addresses of private networks.
    pub private_addresses: bool,
    /// PEM file of certificate authorities trusted besides the system's.
    pub ca_file: Option<PathBuf>,
}

/// Format and filter of the log.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LogConfiguration {
    /// Whether each line is a JSON object, instead of text.
    pub json: bool,
    /// Filter directives, such as `info` or `graphfix=debug,tower_http=info`.
    pub filter: String,
}

/// Limits on what the service accepts; each has its own refusal code.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Bytes of a request body or message, after decompression in transit.
    pub body_bytes: usize,
    /// Bytes of memory for all requests together: their bodies, unpacked and decoded, and answers.
    pub request_memory_bytes: usize,
    /// Open connections. At most as many as the process may open files, less a reserve.
    pub connections: usize,
    /// Open connections from one address.
    pub connections_per_address: usize,
    /// Time for the head of a request, from the connection or the previous answer's next byte (s).
    pub head_s: u64,
    /// Longest time without a byte of a body or without progress of an answer (s).
    pub body_silence_s: u64,
    /// Time after which a connection without a request is closed (s).
    pub idle_s: u64,
    /// Bytes of an upload after unpacking.
    pub decompressed_bytes: u64,
    /// Epochs in one push.
    pub epochs_per_push: usize,
    /// Bytes in one chunk of a receiver's stream.
    pub raw_piece_bytes: usize,
    /// Satellites in one epoch.
    pub satellites_per_epoch: usize,
    /// Observations in one epoch.
    pub observations_per_epoch: usize,
    /// Time that an epoch may be ahead of the service's clock (s).
    pub future_s: u64,
    /// For how long epochs and solutions are kept (days), unless a session names a time of its own;
    /// 0 for ever.
    pub retention_days: u32,
    /// Epochs in the window of `Solve` and `SolveOnce`.
    pub solve_window_epochs: usize,
    /// Time that one `Solve` or `SolveOnce` may compute (s).
    pub solve_s: u64,
    /// Sessions with an estimator in memory; idle ones are parked.
    pub active_sessions: usize,
    /// Bytes of the encoded states of parked sessions in memory; others are restored from the
    /// database.
    pub parked_bytes: usize,
    /// Epochs that wait in the mailbox of one session.
    pub mailbox_epochs: usize,
    /// Epochs that wait in all mailboxes together.
    pub waiting_epochs: usize,
    /// Streams that are open.
    pub streams: usize,
    /// Epochs, or chunks of raw bytes, that may be on their way on one stream.
    pub stream_epochs: usize,
    /// Bytes of messages that may be on their way on one stream.
    pub stream_bytes: usize,
    /// Time after which a stream without a message is ended (s).
    pub stream_idle_s: u64,
    /// Watches that are open.
    pub watches: usize,
    /// Newly committed solutions in memory for those who watch; who is further behind reads the
    /// database.
    pub live_solutions: usize,
    /// Ephemerides kept in memory for one satellite.
    pub ephemerides_per_satellite: usize,
    /// Number of base stations.
    pub bases: usize,
    /// Epochs kept in memory for one base; newer ones push out the oldest.
    pub epochs_per_base: usize,
    /// Bytes kept in memory for one base: 11 or 12 a signal and epoch from RINEX, up to 42 else.
    /// Newer epochs push out the oldest.
    pub bytes_per_base: usize,
    /// Bytes that the disk of a SQLite database must have left; with fewer `/readyz` answers 503.
    pub disk_free_min_bytes: u64,
    /// Time for which a stopping service still serves while `/readyz` answers 503, so that a load
    /// balancer looks elsewhere (s).
    pub drain_notice_s: u64,
    /// Time that running requests have to finish when the service stops (s).
    pub drain_s: u64,
}

/// Limits on the content of one push.
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
    /// The limits that apply to one push.
    pub(crate) const fn intake(&self) -> IntakeLimits {
        IntakeLimits {
            epochs_per_push: self.epochs_per_push,
            satellites_per_epoch: self.satellites_per_epoch,
            observations_per_epoch: self.observations_per_epoch,
        }
    }
}

/// Why the service does not start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum ServiceConfigurationError {
    /// The file is not valid TOML, or holds an unknown key or a value of the wrong type.
    #[error("{0}")]
    Malformed(String),
    /// The interval between requests to archives is too short.
    #[error("navigation.archive_interval_s must be at least {ARCHIVE_INTERVAL_MIN_S}")]
    ArchiveInterval,
    /// The interval between requests for sourcetables is too short.
    #[error("bases.table_interval_s must be at least {ARCHIVE_INTERVAL_MIN_S}")]
    TableInterval,
    /// A limit of zero would refuse everything.
    #[error("limits.{0} must be at least 1")]
    ZeroLimit(&'static str),
    /// The same of batch jobs.
    #[error("jobs.{0} must be at least 1")]
    ZeroJobLimit(&'static str),
}

impl ServiceConfigurationError {
    /// The stable code.
    pub(crate) const fn code(&self) -> Code {
        match self {
            Self::Malformed(_) => Code::ConfigurationMalformed,
            Self::ArchiveInterval => Code::ArchiveIntervalTooShort,
            Self::TableInterval => Code::TableIntervalTooShort,
            Self::ZeroLimit(_) | Self::ZeroJobLimit(_) => Code::LimitZero,
        }
    }
}

impl ServiceConfiguration {
    /// The default configuration.
    pub fn standard() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            node: String::new(),
            hosts: Vec::new(),
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
            antennas: AntennasConfiguration { antex: None },
            jobs: JobsConfiguration::standard(),
            limits: Limits::standard(),
        }
    }

    /// Parses a TOML file; keys that it lacks keep their default.
    ///
    /// # Errors
    /// [`ServiceConfigurationError::Malformed`] with the line, the key and the accepted values.
    pub(crate) fn from_toml(text: &str) -> Result<Self, ServiceConfigurationError> {
        toml::from_str(text).map_err(|e| ServiceConfigurationError::Malformed(e.to_string()))
    }

    /// Checks the values before anything is opened.
    ///
    /// # Errors
    /// A name, interval or retention out of range, or a limit of zero.
    pub(crate) fn check(&self) -> Result<(), ServiceConfigurationError> {
        if 100 < self.node.len() || !self.node.chars().all(|c| c.is_ascii_graphic()) {
            let why = "node must have at most 100 visible ASCII characters and no space";
            return Err(ServiceConfigurationError::Malformed(why.to_owned()));
        }
        if self.navigation.archive_interval_s < ARCHIVE_INTERVAL_MIN_S {
            return Err(ServiceConfigurationError::ArchiveInterval);
        }
        if self.bases.table_interval_s < ARCHIVE_INTERVAL_MIN_S {
            return Err(ServiceConfigurationError::TableInterval);
        }
        if let Some(name) = self.jobs.zero() {
            return Err(ServiceConfigurationError::ZeroJobLimit(name));
        }
        let limits = &self.limits;
        if RETENTION_MAX_DAYS < limits.retention_days {
            let why = format!("limits.retention_days must be at most {RETENTION_MAX_DAYS}");
            return Err(ServiceConfigurationError::Malformed(why));
        }
        let must_be_positive = [
            ("body_bytes", limits.body_bytes),
            ("request_memory_bytes", limits.request_memory_bytes),
            ("connections", limits.connections),
            ("connections_per_address", limits.connections_per_address),
            ("head_s", limits.head_s as usize),
            ("body_silence_s", limits.body_silence_s as usize),
            ("idle_s", limits.idle_s as usize),
            (
                "decompressed_bytes",
                usize::try_from(limits.decompressed_bytes).unwrap_or(usize::MAX),
            ),
            ("epochs_per_push", limits.epochs_per_push),
            ("raw_piece_bytes", limits.raw_piece_bytes),
            ("satellites_per_epoch", limits.satellites_per_epoch),
            ("observations_per_epoch", limits.observations_per_epoch),
            ("solve_window_epochs", limits.solve_window_epochs),
            ("solve_s", limits.solve_s as usize),
            ("active_sessions", limits.active_sessions),
            ("mailbox_epochs", limits.mailbox_epochs),
            ("waiting_epochs", limits.waiting_epochs),
            ("streams", limits.streams),
            ("stream_epochs", limits.stream_epochs),
            ("stream_bytes", limits.stream_bytes),
            ("stream_idle_s", limits.stream_idle_s as usize),
            ("watches", limits.watches),
            ("live_solutions", limits.live_solutions),
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
            request_memory_bytes: 128 << 20,
            connections: 16_384,
            connections_per_address: 8_192,
            head_s: 10,
            body_silence_s: 10,
            idle_s: 300,
            decompressed_bytes: 128 << 20,
            epochs_per_push: 1024,
            raw_piece_bytes: 256 << 10,
            satellites_per_epoch: 128,
            observations_per_epoch: 512,
            future_s: 86_400,
            retention_days: 90,
            solve_window_epochs: 300,
            solve_s: 5,
            active_sessions: 4096,
            parked_bytes: 512 << 20,
            mailbox_epochs: 2048,
            waiting_epochs: 32_768,
            streams: 16_384,
            stream_epochs: 256,
            stream_bytes: 512 << 10,
            stream_idle_s: 300,
            watches: 1024,
            live_solutions: 4096,
            ephemerides_per_satellite: 480,
            bases: 64,
            epochs_per_base: 100_000,
            bytes_per_base: 32 << 20,
            disk_free_min_bytes: 64 << 20,
            drain_notice_s: 0,
            drain_s: 20,
        }
    }
}

// `serde(default)` asks for `Default`. Nothing else uses it.
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
    fn a_node_has_a_name_for_headers_and_logs() {
        for (node, allowed) in [("", true), ("rover-hub-3", true), ("a b", false), ("a\nb", false)]
        {
            let configuration =
                ServiceConfiguration { node: node.to_owned(), ..ServiceConfiguration::standard() };
            assert_eq!(configuration.check().is_ok(), allowed, "{node:?}");
        }
    }

    #[test]
    fn a_retention_is_at_most_a_century() {
        for (days, allowed) in [(0, true), (36_500, true), (36_501, false)] {
            let mut configuration = ServiceConfiguration::standard();
            configuration.limits.retention_days = days;
            assert_eq!(configuration.check().is_ok(), allowed, "{days}");
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
