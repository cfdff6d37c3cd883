//! A service in this process: its desks opened, served on a listener, closed in order.

use std::future::Future;
use std::num::NonZeroUsize;
use std::thread::available_parallelism;
use std::time::Duration;

use tokio::net::TcpListener;

use crate::aiding::{AidingDesk, AidingError, AidingLimits};
use crate::config::{
    BasesConfiguration, CasterConfiguration, FetchConfiguration, Limits, NavigationConfiguration,
    NetworkConfiguration, ServiceConfiguration, ServiceConfigurationError,
};
use crate::contract::Service;
use crate::feeds::ntrip::{Credentials, NtripVersion, StreamRequest};
use crate::feeds::{
    ArchiveTemplate, Connector, FeedOptions, Feeds, FetchError, FetchPolicy, NavigationSources,
    NetworkRequest, Patience,
};
use crate::http::{self, ServerError};
use crate::refusal::Code;
use crate::session::{SessionLimits, Sessions};
use crate::store::{Store, StoreError};

use super::Failure;

/// How often is looked which streams of a network are needed.
const DEMAND_INTERVAL: Duration = Duration::from_secs(2);

/// A service whose desks are open.
pub(super) struct Host {
    store: Store,
    service: Service,
}

impl Host {
    /// Opens the database and the desks.
    ///
    /// # Errors
    /// The database cannot be opened or read, or a host that may be asked is none.
    pub(super) async fn open(
        database: &str,
        limits: &Limits,
        fetch: &FetchConfiguration,
        navigation: &NavigationConfiguration,
    ) -> Result<Self, Failure> {
        let sources = navigation_sources(navigation)?;
        let policy = FetchPolicy::new(&fetch.hosts, fetch.private_addresses)?;
        let connector = Connector::new(policy, Patience::standard(), fetch.ca_file.as_deref())?;
        let store = Store::open(database).await?;
        let aiding = AidingDesk::open(store.clone(), aiding_limits(limits)).await?;
        let sessions = Sessions::open(store.clone(), aiding.clone(), session_limits(limits));
        let feeds = Feeds::open(connector, aiding.clone(), FeedOptions::standard());
        let own =
            Connector::new(sources.policy()?, Patience::standard(), fetch.ca_file.as_deref())?;
        feeds.bring_navigation(sources, &own)?;
        Ok(Self { store, service: Service::new(sessions, aiding, feeds, limits.clone()) })
    }

    /// Has bases brought by the sourcetables of casters from now on.
    ///
    /// # Errors
    /// An address that is none, or a host that may not be asked.
    pub(super) fn bring_bases(&self, configuration: &BasesConfiguration) -> Result<(), Failure> {
        let request = |named: &NetworkConfiguration| {
            let NetworkConfiguration { caster, user, password } = named;
            let credentials = Credentials { name: user.clone(), password: password.clone() };
            Ok(NetworkRequest {
                caster: caster.parse()?,
                credentials: (!user.is_empty()).then_some(credentials),
                near: None,
                table_interval: Duration::from_secs(configuration.table_interval_s),
                idle: Duration::from_secs(configuration.idle_s),
                demand_interval: DEMAND_INTERVAL,
            })
        };
        let requests: Result<_, FetchError> = configuration.networks.iter().map(request).collect();
        Ok(self.service.feeds().bring_bases(requests?)?)
    }

    /// Serves until `stop` is ready; then refuses what comes, finishes what runs, and closes the
    /// database.
    ///
    /// # Errors
    /// The listener fails.
    pub(super) async fn serve(
        self,
        listener: TcpListener,
        stop: impl Future<Output = ()> + Send + 'static,
    ) -> Result<(), Failure> {
        let served = http::serve(listener, &self.service, stop).await;
        self.service.sessions().drain().await;
        self.service.feeds().close().await;
        self.store.close().await;
        Ok(served?)
    }
}

fn navigation_sources(
    configuration: &NavigationConfiguration,
) -> Result<NavigationSources, FetchError> {
    let archives = configuration.archives.iter().map(|text| ArchiveTemplate::new(text));
    let stream = |named: &CasterConfiguration| {
        let CasterConfiguration { caster, mountpoint, user, password } = named;
        let credentials = Credentials { name: user.clone(), password: password.clone() };
        Ok(StreamRequest {
            caster: caster.parse()?,
            mountpoint: mountpoint.clone(),
            credentials: (!user.is_empty()).then_some(credentials),
            version: NtripVersion::Two,
        })
    };
    Ok(NavigationSources {
        archives: archives.collect::<Result<_, _>>()?,
        interval: Duration::from_secs(configuration.archive_interval_s),
        streams: configuration.casters.iter().map(stream).collect::<Result<_, FetchError>>()?,
    })
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
        active_sessions: limits.active_sessions,
        solver_threads: available_parallelism().unwrap_or(NonZeroUsize::MIN),
        ..SessionLimits::service()
    }
}

/// Runs asynchronous work to its end on all cores.
///
/// # Errors
/// The work's own failure, or threads that cannot be started.
pub(super) fn block_on<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime
        .map_err(|error| Failure::new("NO_THREADS", error, "let the process start threads"))?;
    runtime.block_on(work)
}

/// Waits for the user or the system to ask the process to stop.
pub(super) async fn interrupted() {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate()).expect("SIGTERM can be listened to");
    tokio::select! {
        _ = tokio::signal::ctrl_c() => {}
        _ = terminate.recv() => {}
    }
}

/// Sends the log of `configuration` to standard error.
///
/// # Errors
/// A filter that is none.
pub(super) fn start_log(configuration: &ServiceConfiguration) -> Result<(), Failure> {
    use tracing_subscriber::EnvFilter;
    let filter = EnvFilter::try_new(&configuration.log.filter).map_err(|error| {
        let message = format!("log filter {:?}: {error}", configuration.log.filter);
        Failure::of(Code::LogFilterInvalid, message)
    })?;
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    if configuration.log.json {
        log.json().init();
    } else {
        log.init();
    }
    Ok(())
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<AidingError> for Failure {
    fn from(error: AidingError) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<FetchError> for Failure {
    fn from(error: FetchError) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<ServerError> for Failure {
    fn from(error: ServerError) -> Self {
        Self::of(Code::ListenerFailed, error)
    }
}

impl From<ServiceConfigurationError> for Failure {
    fn from(error: ServiceConfigurationError) -> Self {
        Self::of(error.code(), &error)
    }
}
