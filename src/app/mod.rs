//! The composition root: opens the desks of a service from its configuration.
//!
//! `serve`, `demo`, `replay` and the tests of the doors open their desks here, so that limits and
//! sources of data are connected in one module.

mod error;
mod worker;

use std::fs::File;
use std::future::Future;
use std::io::BufReader;
use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::thread::available_parallelism;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::time::{sleep, timeout};
use uuid::Uuid;

use crate::aiding::{AidingDesk, AidingLimits};
use crate::cluster::Cluster;
use crate::config::{
    AntennasConfiguration, BasesConfiguration, CasterConfiguration, ClusterConfiguration,
    FetchConfiguration, Limits, NavigationConfiguration, NetworkConfiguration,
    SecretsConfiguration, ServiceConfiguration,
};
use crate::contract::nodes::Nodes;
use crate::contract::{Service, WebOrigins};
use crate::feeds::ntrip::{Credentials, NtripVersion, StreamRequest};
use crate::feeds::{
    ArchiveTemplate, Connector, FeedOptions, Feeds, FetchError, FetchPolicy, NavigationArchives,
    NavigationSources, NetworkRequest, TimeLimits,
};
use crate::formats::{antex, decompress, geoid};
use crate::gnss::{AntennaCatalogue, Geoid};
use crate::http;
use crate::jobs::Jobs;
use crate::keys::Keys;
use crate::quotas::TenantQuotas;
use crate::secrets::{Secrets, SecretsError, SecretsKey};
use crate::session::{SessionLimits, Sessions};
use crate::store::{DatabaseSetting, Store};
use crate::tls::{ClientFiles, ClientTls, ServerTls};
use crate::traces::Exporter;

pub use error::AppError;
pub use worker::{WorkerApp, open_worker};

/// Interval of the check for streams of a network that rovers need.
const DEMAND_INTERVAL: Duration = Duration::from_secs(2);

/// Interval at which watches of sessions of other nodes read the store.
const WATCH_INTERVAL: Duration = Duration::from_secs(1);

/// A service with open desks.
pub struct App {
    store: Store,
    service: Service,
    /// Sends traces; `None` without a collector.
    exporter: Option<Exporter>,
}

/// Opens the database and the desks, and starts the sources of ephemerides and bases. `time_limits`
/// and `feed_options` apply to the connections to other hosts.
///
/// # Errors
/// The database, the certificate, the ANTEX file or the table of the geoid cannot be read, or an
/// address of a source is invalid or not allowed.
pub async fn open(
    configuration: &ServiceConfiguration,
    time_limits: TimeLimits,
    feed_options: FeedOptions,
) -> Result<App, AppError> {
    let ServiceConfiguration { database, fetch, navigation, bases, antennas, limits, .. } =
        configuration;
    let tls = ServerTls::open(&configuration.tls)?;
    let catalogue = antenna_catalogue(antennas)?;
    let geoid = configuration.geoid_file.as_deref().map(geoid_table).transpose()?;
    let sources = navigation_sources(navigation)?;
    let templates = sources.archives.clone();
    let origins = WebOrigins::new(&configuration.cors)?;
    let connector = connector(fetch, time_limits)?;
    // The operator's sources may be on any host, those of clients only on the listed hosts.
    let operator_connector =
        Connector::new(sources.policy()?, time_limits, fetch.ca_file.as_deref())?;
    let archives = NavigationArchives::new(templates, operator_connector.clone());
    let node = node_name(configuration);
    let secrets = secrets(&configuration.secrets)?;
    let exporter = Exporter::start(&configuration.telemetry, &node)?;
    let store = open_store(database, &node, &configuration.cluster, secrets).await?;
    let aiding = AidingDesk::open_with(store.clone(), aiding_limits(limits), catalogue).await?;
    let aiding = aiding.with_geoid(geoid.clone());
    let sessions = Sessions::open(store.clone(), aiding.clone(), session_limits(limits));
    sessions.count_time().await;
    let cluster = Cluster::open(&store, &aiding).await?;
    let feeds = Feeds::open(connector.clone(), aiding.clone(), feed_options);
    match &cluster {
        None => {
            feeds.fill_bases();
            feeds.bring_navigation(sources, &operator_connector)?;
            feeds.bring_bases(network_requests(bases)?)?;
        }
        Some(cluster) => run_in_cluster(cluster, &sessions, &feeds, (sources, operator_connector)),
    }
    let nodes = cluster.map(|cluster| nodes(cluster, &configuration.cluster)).transpose()?;
    let (lane, jobs) = (sessions.batch_lane(), configuration.jobs.clone());
    let means = (lane, connector, archives);
    let desks = (store.clone(), aiding.clone(), sessions.meters().clone());
    let jobs = match Jobs::open(desks, means, jobs, node.clone(), geoid).await {
        Ok(jobs) => jobs,
        Err(error) => {
            store.close().await; // A node gives up its lease at once.
            return Err(error.into());
        }
    };
    let keys = Keys::open(store.clone()).await?;
    let quotas = TenantQuotas::open(store.clone(), sessions.meters().clone()).await?;
    let service = Service::new(sessions, aiding, feeds, jobs, keys, quotas, limits.clone());
    let service = service.named(node).with_hosts(&configuration.hosts).with_tls(tls);
    let service = service.with_web_origins(origins);
    let service = service.with_nodes(nodes).with_dashboard(configuration.dashboard.clone());
    let service = service.with_tracer(exporter.as_ref().map(Exporter::tracer).cloned());
    Ok(App { store, service, exporter })
}

/// Connects to the hosts that clients may name.
fn connector(fetch: &FetchConfiguration, time_limits: TimeLimits) -> Result<Connector, FetchError> {
    let policy = FetchPolicy::new(&fetch.hosts, fetch.private_addresses)?;
    let policy = policy.with_tenants(&fetch.tenants)?;
    Connector::new(policy, time_limits, fetch.ca_file.as_deref())
}

/// Starts the tasks of a node in a cluster: some each second, and others once it leads.
fn run_in_cluster(
    cluster: &Cluster,
    sessions: &Sessions,
    feeds: &Feeds,
    (sources, connector): (NavigationSources, Connector),
) {
    let (leading, feeds) = (cluster.clone(), feeds.clone());
    cluster.run(async move {
        leading.until_leader().await;
        feeds.fill_bases();
        if let Err(error) = feeds.bring_navigation(sources, &connector) {
            tracing::error!(%error, "the sources of ephemerides cannot start");
        }
    });
    let sessions = sessions.clone();
    cluster.run(async move {
        loop {
            sleep(WATCH_INTERVAL).await;
            sessions.wake_watches();
        }
    });
}

/// The other nodes, and the certificates that this node trusts when it calls them.
fn nodes(cluster: Cluster, configuration: &ClusterConfiguration) -> Result<Nodes, AppError> {
    let files = ClientFiles { ca: configuration.ca_file.clone(), identity: None };
    Ok(Nodes { cluster, tls: ClientTls::new(&files, b"h2")? })
}

/// Opens the database as its only service, or as a node of its cluster, and logs the settings on
/// which durability and space depend.
async fn open_store(
    database: &str,
    node: &str,
    cluster: &ClusterConfiguration,
    secrets: Secrets,
) -> Result<Store, AppError> {
    let store = match cluster.is_on() {
        false => Store::open_alone(database, node).await?,
        true => Store::open_in_cluster(database, node, &cluster.address).await?,
    };
    let store = store.with_secrets(secrets);
    match cluster.is_on() {
        false => tracing::info!(node, "this node has the lease of the database"),
        true => {
            let address = &cluster.address;
            tracing::info!(node, address, fence = store.fence(), "this node is in the cluster");
            tracing::warn!("clusters are a preview: docs/cluster.md lists what is not shown yet");
        }
    }
    for DatabaseSetting { name, value, risk } in store.settings() {
        match risk {
            None => tracing::info!(name, value, "database setting"),
            Some(risk) => tracing::warn!(name, value, "{}", risk.words()),
        }
    }
    if let Err(error) = encrypt_secrets(&store).await {
        store.close().await;
        return Err(error);
    }
    Ok(store)
}

/// Encrypts the stored secrets with the key in force, or warns that they are not encrypted.
async fn encrypt_secrets(store: &Store) -> Result<(), AppError> {
    match store.reseal().await? {
        0 => {}
        secrets => tracing::info!(secrets, "encrypted stored secrets with the key in force"),
    }
    let stored = store.secrets_by_key().await?;
    if let Some(plain) = stored.iter().find(|under| under.key.is_none()) {
        let secrets = plain.secrets;
        tracing::warn!(secrets, "secrets are stored as they are; name a key (secrets.key_file)");
    }
    Ok(())
}

/// The keys of stored secrets.
fn secrets(configuration: &SecretsConfiguration) -> Result<Secrets, SecretsError> {
    let SecretsConfiguration { key_file, former_key_files, key } = configuration;
    let current = match (key_file, key) {
        (Some(path), _) => SecretsKey::read(path)?,
        (None, Some(text)) => SecretsKey::parse(text)?,
        (None, None) => return Ok(Secrets::default()),
    };
    let former = former_key_files.iter().map(|path| SecretsKey::read(path));
    Ok(Secrets::new(current, former.collect::<Result<_, _>>()?))
}

/// Opens the database for reading, with the stored ephemerides, bases and antennas, for a
/// computation without sessions and sources. A service may be using the database.
///
/// # Errors
/// The database cannot be read.
pub(crate) async fn open_stored(
    database: &str,
    limits: &Limits,
    catalogue: AntennaCatalogue,
) -> Result<(Store, AidingDesk), AppError> {
    let store = Store::open_read_only(database).await?;
    let aiding = AidingDesk::open_with(store.clone(), aiding_limits(limits), catalogue).await?;
    Ok((store, aiding))
}

impl App {
    /// The desks, for the doors.
    pub const fn service(&self) -> &Service {
        &self.service
    }

    /// Checks that the service may listen on an address. Beyond loopback, requests must need a key
    /// and TLS must be on, unless a proxy in front of the service has TLS (`plaintext`).
    ///
    /// # Errors
    /// [`AppError::NotLoopback`], [`AppError::NotEncrypted`].
    pub fn check_address(&self, address: SocketAddr, plaintext: bool) -> Result<(), AppError> {
        if address.ip().is_loopback() {
            return Ok(());
        }
        if !self.service.keys().are_needed() {
            return Err(AppError::NotLoopback(address));
        }
        match (self.service.tls(), plaintext) {
            (Some(_), _) => {}
            (None, true) => {
                tracing::warn!(%address, "no TLS: what is before the port must have it");
            }
            (None, false) => return Err(AppError::NotEncrypted(address)),
        }
        Ok(())
    }

    /// Serves until `stop` is ready. Then it refuses new requests, finishes the running ones, and
    /// closes. Meanwhile the port reports that it is stopping.
    ///
    /// # Errors
    /// Another service has had the database meanwhile, so this one must start again.
    pub async fn serve(
        self,
        listener: TcpListener,
        stop: impl Future<Output = ()> + Send + 'static,
    ) -> Result<(), AppError> {
        let (store, lost) = (self.store.clone(), Arc::new(OnceLock::new()));
        let stop = {
            let lost = lost.clone();
            async move {
                tokio::select! {
                    () = stop => {}
                    error = store.lease_lost() => drop(lost.set(error)),
                }
            }
        };
        let service = self.service.clone();
        http::serve(listener, &service, stop, self.close()).await;
        match lost.get() {
            None => Ok(()),
            Some(error) => Err(error.clone().into()),
        }
    }

    /// Finishes the running requests and closes the database. Requests that take longer than
    /// `limits.drain_s` are ended; they were not acknowledged.
    pub async fn close(self) {
        let limit = Duration::from_secs(self.service.limits().drain_s);
        let service = &self.service;
        end_within(limit, service.sessions().drain(), "epochs were still positioned; cut off")
            .await;
        end_within(limit, service.jobs().close(), "a job still runs; it begins again later").await;
        let feeds = async {
            if let Some(nodes) = service.nodes() {
                nodes.cluster.close().await;
            }
            service.feeds().close().await;
            service.keys().close().await;
            service.quotas().close().await;
        };
        end_within(limit, feeds, "tasks beside the requests still run; cut off").await;
        if let Some(exporter) = self.exporter {
            exporter.close().await;
        }
        self.store.close().await;
    }
}

/// Waits until a part of the service has ended, and warns if it takes longer than `limit`.
async fn end_within(limit: Duration, ending: impl Future<Output = ()>, otherwise: &str) {
    if timeout(limit, ending).await.is_err() {
        tracing::warn!(seconds = limit.as_secs(), "{otherwise}");
    }
}

/// The configured name of the node, or a random one.
fn node_name(configuration: &ServiceConfiguration) -> String {
    match &configuration.node {
        configured if configured.is_empty() => random_node(),
        configured => configured.clone(),
    }
}

/// A name for a node: the host's name and a random suffix.
pub(crate) fn random_node() -> String {
    let mark = Uuid::new_v4().simple().to_string();
    format!("{}-{}", host_name(), &mark[..6])
}

/// The name of this host.
pub(crate) fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

/// The calibrations of the operator's file; none without one.
fn antenna_catalogue(configuration: &AntennasConfiguration) -> Result<AntennaCatalogue, AppError> {
    let Some(path) = &configuration.antex else { return Ok(AntennaCatalogue::default()) };
    let invalid = |reason: String| AppError::Antex { path: path.clone(), reason };
    let file = File::open(path).map_err(|error| invalid(error.to_string()))?;
    antex::read(decompress(BufReader::new(file))).map_err(|error| invalid(error.to_string()))
}

/// Reads a table of the geoid's heights.
///
/// # Errors
/// The file cannot be read, or is not such a table.
pub(crate) fn geoid_table(path: &Path) -> Result<Arc<Geoid>, AppError> {
    let read = File::open(path)
        .map_err(geoid::GeoidError::from)
        .and_then(|file| geoid::read(decompress(BufReader::new(file))));
    read.map(Arc::new).map_err(|error| AppError::Geoid { path: path.to_owned(), error })
}

fn navigation_sources(
    configuration: &NavigationConfiguration,
) -> Result<NavigationSources, FetchError> {
    let archives = configuration.archives.iter().map(|text| ArchiveTemplate::new(text));
    let stream = |named: &CasterConfiguration| {
        let CasterConfiguration { caster, mountpoint, user, password } = named;
        Ok(StreamRequest {
            caster: caster.parse()?,
            mountpoint: mountpoint.clone(),
            credentials: credentials(user, password),
            version: NtripVersion::Two,
        })
    };
    Ok(NavigationSources {
        archives: archives.collect::<Result<_, _>>()?,
        interval: Duration::from_secs(configuration.archive_interval_s),
        streams: configuration.casters.iter().map(stream).collect::<Result<_, FetchError>>()?,
    })
}

fn network_requests(configuration: &BasesConfiguration) -> Result<Vec<NetworkRequest>, FetchError> {
    let request = |named: &NetworkConfiguration| {
        let NetworkConfiguration { caster, user, password } = named;
        Ok(NetworkRequest {
            caster: caster.parse()?,
            credentials: credentials(user, password),
            near: None,
            table_interval: Duration::from_secs(configuration.table_interval_s),
            idle: Duration::from_secs(configuration.idle_s),
            demand_interval: DEMAND_INTERVAL,
        })
    };
    configuration.networks.iter().map(request).collect()
}

/// User and password; `None` if no user is named.
fn credentials(user: &str, password: &str) -> Option<Credentials> {
    let credentials = Credentials { name: user.to_owned(), password: password.to_owned() };
    (!user.is_empty()).then_some(credentials)
}

fn aiding_limits(limits: &Limits) -> AidingLimits {
    AidingLimits {
        ephemerides_per_satellite: limits.ephemerides_per_satellite,
        bases: limits.bases,
        epochs_per_base: limits.epochs_per_base,
        bytes_per_base: limits.bytes_per_base,
        observations_per_epoch: limits.observations_per_epoch,
        ..AidingLimits::service()
    }
}

fn session_limits(limits: &Limits) -> SessionLimits {
    SessionLimits {
        mailbox_epochs: limits.mailbox_epochs,
        waiting_epochs: limits.waiting_epochs,
        epochs_per_push: limits.epochs_per_push,
        raw_chunk_bytes: limits.raw_piece_bytes,
        observations_per_epoch: limits.observations_per_epoch,
        future_s: limits.future_s,
        retention_days: limits.retention_days,
        audit_days: limits.audit_days,
        history_days: limits.history_days,
        solve_window_epochs: limits.solve_window_epochs,
        solve_time: Duration::from_secs(limits.solve_s),
        live_solutions: limits.live_solutions,
        active_sessions: limits.active_sessions,
        parked_bytes: limits.parked_bytes,
        solver_threads: available_parallelism().unwrap_or(NonZeroUsize::MIN),
        ..SessionLimits::service()
    }
}
