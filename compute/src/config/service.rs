//! Options of the service: where it listens, where it stores, and its limits.
//!
//! Every value has a default here. A TOML file, `GRAPHFIX_…` variables and arguments override it,
//! in this order. The command line reads them; an unknown key in the file is refused by name.

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;

use serde::Deserialize;

use crate::refusal::Code;

use super::cluster::ClusterConfiguration;
use super::dashboard::DashboardConfiguration;
use super::jobs::JobsConfiguration;
use super::limits::Limits;
use super::s3::S3Configuration;
use super::secrets::SecretsConfiguration;
use super::telemetry::TelemetryConfiguration;
use super::tls::TlsConfiguration;

/// Shortest interval between requests (s): ephemerides change once an hour, and archives serve
/// everybody.
const ARCHIVE_INTERVAL_MIN_S: u64 = 60;

/// Longest retention (days): a century.
pub const RETENTION_MAX_DAYS: u32 = 36_500;
/// Longest duration (s): a century.
const DURATION_MAX_S: u64 = RETENTION_MAX_DAYS as u64 * 86_400;
/// Largest number of connections, sessions, epochs or streams.
const NUMBER_MAX: u64 = 1 << 32;
/// Largest number of jobs that run at once; each has a connection to the database.
const RUNNING_MAX: u64 = 1024;

/// The database if none is named.
pub const STANDARD_DATABASE: &str = "sqlite://graphfix.db";

/// Options of the service.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ServiceConfiguration {
    /// Address and port to listen on; beyond loopback only once a key exists, and with TLS or
    /// `plaintext`.
    pub listen: SocketAddr,
    /// Whether the port may be reached from beyond this machine without TLS, since a proxy or
    /// balancer before it has TLS.
    pub plaintext: bool,
    /// TLS of the port.
    pub tls: TlsConfiguration,
    /// Name of this node in the log, in answers, and to another service on the same database.
    /// Empty: the name of the host and a random mark.
    pub node: String,
    /// Names under which the service may be asked, beside `localhost` and its address: those of a
    /// proxy that passes the name on. Web pages of these hosts may ask it, too.
    pub hosts: Vec<String>,
    /// Origins of web pages of other hosts that may call the service with a key of a tenant
    /// (CORS), by the tenant's name: `https://HOST` or `https://HOST:PORT`.
    pub cors: BTreeMap<String, Vec<String>>,
    /// URL of the database: `sqlite://FILE` or `postgres://…`.
    pub database: String,
    /// The other nodes on the same database.
    pub cluster: ClusterConfiguration,
    /// File with the URL of the database, in place of `database`: a URL may have a password.
    pub database_file: Option<PathBuf>,
    /// Keys that encrypt stored secrets.
    pub secrets: SecretsConfiguration,
    /// Format and filter of the log.
    pub log: LogConfiguration,
    /// Traces for OpenTelemetry.
    pub telemetry: TelemetryConfiguration,
    /// Hosts that the service may connect to at a client's request.
    pub fetch: FetchConfiguration,
    /// Sources of ephemerides besides uploads.
    pub navigation: NavigationConfiguration,
    /// Sources of base stations.
    pub bases: BasesConfiguration,
    /// Phase centres of antennas.
    pub antennas: AntennasConfiguration,
    /// Table of the geoid's heights: PGM of GeographicLib, GTX or ISG, plain or gzip. Sessions and
    /// jobs with the option `geoid` state heights above it.
    pub geoid_file: Option<PathBuf>,
    /// The dashboard.
    pub dashboard: DashboardConfiguration,
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
    /// Further hosts that one tenant alone may name, by the tenant's name.
    pub tenants: BTreeMap<String, Vec<String>>,
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

/// Why the service does not start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ServiceConfigurationError {
    /// The file is not valid TOML, or holds an unknown key or a value of the wrong type.
    #[error("{0}")]
    Malformed(String),
    /// The interval between requests to archives is too short.
    #[error("navigation.archive_interval_s must be at least {ARCHIVE_INTERVAL_MIN_S}")]
    ArchiveInterval,
    /// The interval between requests for sourcetables is too short.
    #[error("bases.table_interval_s must be at least {ARCHIVE_INTERVAL_MIN_S}")]
    TableInterval,
    /// The nodes of a cluster share a server.
    #[error("cluster.address is set, and the database is not on Postgres")]
    ClusterOfFile,
    /// The other nodes cannot reach this address.
    #[error("cluster.address is {0:?}, not http://HOST:PORT or https://HOST:PORT")]
    ClusterAddress(String),
    /// An option whose work one node cannot do for the others.
    #[error("{0} is set, and a node of a cluster does not support it")]
    NotInCluster(&'static str),
    /// A limit of zero would refuse everything.
    #[error("limits.{0} must be at least 1")]
    ZeroLimit(&'static str),
    /// The same of batch jobs.
    #[error("jobs.{0} must be at least 1")]
    ZeroJobLimit(&'static str),
}

impl ServiceConfigurationError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Malformed(_) => Code::ConfigurationMalformed,
            Self::ArchiveInterval => Code::ArchiveIntervalTooShort,
            Self::TableInterval => Code::TableIntervalTooShort,
            Self::ClusterOfFile => Code::ClusterNeedsPostgres,
            Self::ClusterAddress(_) => Code::ClusterAddressInvalid,
            Self::NotInCluster(_) => Code::NotInCluster,
            Self::ZeroLimit(_) | Self::ZeroJobLimit(_) => Code::LimitZero,
        }
    }
}

impl ServiceConfiguration {
    /// The default configuration.
    pub fn standard() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            plaintext: false,
            tls: TlsConfiguration::default(),
            node: String::new(),
            hosts: Vec::new(),
            cors: BTreeMap::new(),
            database: STANDARD_DATABASE.to_owned(),
            database_file: None,
            secrets: SecretsConfiguration::default(),
            cluster: ClusterConfiguration::default(),
            log: LogConfiguration { json: false, filter: "info".to_owned() },
            telemetry: TelemetryConfiguration::standard(),
            fetch: FetchConfiguration {
                hosts: Vec::new(),
                tenants: BTreeMap::new(),
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
            geoid_file: None,
            dashboard: DashboardConfiguration::default(),
            jobs: JobsConfiguration::standard(),
            limits: Limits::standard(),
        }
    }

    /// Parses a TOML file; keys that it lacks keep their default.
    ///
    /// # Errors
    /// [`ServiceConfigurationError::Malformed`] with the line, the key and the accepted values.
    pub fn from_toml(text: &str) -> Result<Self, ServiceConfigurationError> {
        toml::from_str(text).map_err(|e| ServiceConfigurationError::Malformed(e.to_string()))
    }

    /// Checks the values before anything is opened.
    ///
    /// # Errors
    /// A name, interval or retention out of range, or a limit of zero.
    pub fn check(&self) -> Result<(), ServiceConfigurationError> {
        if 100 < self.node.len() || !self.node.chars().all(|c| c.is_ascii_graphic()) {
            let why = "node must have at most 100 visible ASCII characters and no space";
            return Err(ServiceConfigurationError::Malformed(why.to_owned()));
        }
        if let Some(missing) = self.tls.missing() {
            return Err(ServiceConfigurationError::Malformed(missing.to_owned()));
        }
        if let Some(wrong) = self.secrets.wrong().or_else(|| self.telemetry.wrong()) {
            return Err(ServiceConfigurationError::Malformed(wrong.to_owned()));
        }
        if self.database_file.is_some() && self.database != STANDARD_DATABASE {
            let why = "database and database_file are given, and one of them is to be left out";
            return Err(ServiceConfigurationError::Malformed(why.to_owned()));
        }
        if self.navigation.archive_interval_s < ARCHIVE_INTERVAL_MIN_S {
            return Err(ServiceConfigurationError::ArchiveInterval);
        }
        if self.bases.table_interval_s < ARCHIVE_INTERVAL_MIN_S {
            return Err(ServiceConfigurationError::TableInterval);
        }
        self.check_cluster()?;
        if let Some(name) = self.jobs.zero() {
            return Err(ServiceConfigurationError::ZeroJobLimit(name));
        }
        if self.jobs.folder.as_ref().is_some_and(|folder| folder.as_os_str().is_empty()) {
            let why = "jobs.folder is empty: name a folder, or leave it out";
            return Err(ServiceConfigurationError::Malformed(why.to_owned()));
        }
        let wrong = self.jobs.s3.as_ref().and_then(S3Configuration::wrong);
        if let Some(wrong) = wrong.or_else(|| self.dashboard.wrong()) {
            return Err(ServiceConfigurationError::Malformed(wrong.to_owned()));
        }
        if self.jobs.running == 0 && self.database.starts_with("sqlite:") {
            let why = "jobs.running must be at least 1 on SQLite, where no worker takes jobs";
            return Err(ServiceConfigurationError::Malformed(why.to_owned()));
        }
        let limits = &self.limits;
        for (name, days) in [
            ("retention_days", limits.retention_days),
            ("audit_days", limits.audit_days),
            ("history_days", limits.history_days),
        ] {
            if RETENTION_MAX_DAYS < days {
                let why = format!("limits.{name} must be at most {RETENTION_MAX_DAYS}");
                return Err(ServiceConfigurationError::Malformed(why));
            }
        }
        if let Some((name, most)) = self.too_large() {
            let why = format!("{name} must be at most {most}");
            return Err(ServiceConfigurationError::Malformed(why));
        }
        match limits.zero() {
            Some(name) => Err(ServiceConfigurationError::ZeroLimit(name)),
            None => Ok(()),
        }
    }

    /// The name of a duration or number that no clock or queue can hold, with its largest value.
    fn too_large(&self) -> Option<(&'static str, u64)> {
        let Self { limits, jobs, navigation, bases, .. } = self;
        let durations_s = [
            ("limits.head_s", limits.head_s),
            ("limits.body_silence_s", limits.body_silence_s),
            ("limits.idle_s", limits.idle_s),
            ("limits.future_s", limits.future_s),
            ("limits.solve_s", limits.solve_s),
            ("limits.stream_idle_s", limits.stream_idle_s),
            ("limits.drain_notice_s", limits.drain_notice_s),
            ("limits.drain_s", limits.drain_s),
            ("navigation.archive_interval_s", navigation.archive_interval_s),
            ("bases.table_interval_s", bases.table_interval_s),
            ("bases.idle_s", bases.idle_s),
            ("jobs.silent_s", jobs.silent_s),
            ("jobs.run_s", jobs.run_s),
            ("jobs.checkpoint_s", jobs.checkpoint_s),
            ("jobs.fetch_s", jobs.fetch_s),
            ("jobs.webhook_delay_s", jobs.webhook_delay_s),
        ];
        let numbers = [
            ("limits.connections", limits.connections),
            ("limits.active_sessions", limits.active_sessions),
            ("limits.mailbox_epochs", limits.mailbox_epochs),
            ("limits.waiting_epochs", limits.waiting_epochs),
            ("limits.streams", limits.streams),
            ("limits.stream_epochs", limits.stream_epochs),
            ("limits.watches", limits.watches),
        ];
        let durations_s = durations_s.map(|(name, value)| (name, value, DURATION_MAX_S));
        let numbers = numbers.map(|(name, value)| (name, value as u64, NUMBER_MAX));
        let running = ("jobs.running", jobs.running as u64, RUNNING_MAX);
        let mut all = durations_s.into_iter().chain(numbers).chain([running]);
        all.find(|(_, value, most)| most < value).map(|(name, _, most)| (name, most))
    }
}

impl ServiceConfiguration {
    fn check_cluster(&self) -> Result<(), ServiceConfigurationError> {
        if !self.cluster.is_on() {
            return Ok(());
        }
        // What a file names is checked when the database is opened.
        if self.database_file.is_none() && !self.database.starts_with("postgres") {
            return Err(ServiceConfigurationError::ClusterOfFile);
        }
        if self.cluster.authority().is_none() {
            let address = self.cluster.address.clone();
            return Err(ServiceConfigurationError::ClusterAddress(address));
        }
        for (name, is_set) in [
            ("bases.networks", !self.bases.networks.is_empty()),
            ("tls.client_ca_file", self.tls.client_ca_file.is_some()),
        ] {
            if is_set {
                return Err(ServiceConfigurationError::NotInCluster(name));
            }
        }
        Ok(())
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
            let mut configuration = ServiceConfiguration::standard();
            configuration.limits.audit_days = days;
            assert_eq!(configuration.check().is_ok(), allowed, "{days}");
            let mut configuration = ServiceConfiguration::standard();
            configuration.limits.history_days = days;
            assert_eq!(configuration.check().is_ok(), allowed, "{days}");
        }
    }

    #[test]
    fn a_limit_beyond_clocks_and_queues_is_refused() {
        let refused = |change: fn(&mut ServiceConfiguration)| {
            let mut configuration = ServiceConfiguration::standard();
            change(&mut configuration);
            configuration.check().unwrap_err().to_string()
        };
        let head = refused(|configuration| configuration.limits.head_s = u64::MAX);
        assert!(head.contains("limits.head_s must be at most 3153600000"), "{head}");
        let mailbox = refused(|configuration| configuration.limits.mailbox_epochs = usize::MAX);
        assert!(mailbox.contains("limits.mailbox_epochs must be at most 4294967296"), "{mailbox}");
        let folder = refused(|configuration| configuration.jobs.folder = Some("".into()));
        assert!(folder.contains("jobs.folder is empty"), "{folder}");
        let running = refused(|configuration| configuration.jobs.running = usize::MAX);
        assert!(running.contains("jobs.running must be at most 1024"), "{running}");
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
