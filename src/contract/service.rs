//! The service as the doors see it: desks, limits, and whether it is about to stop.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

use crate::aiding::{AidingDesk, BaseBroker, NavigationBroker};
use crate::config::{DashboardConfiguration, Limits};
use crate::feeds::Feeds;
use crate::jobs::Jobs;
use crate::keys::Keys;
use crate::quotas::TenantQuotas;
use crate::refusal::Code;
use crate::session::Sessions;
use crate::tls::ServerTls;
use crate::traces::Tracer;

use super::nodes::Nodes;
use super::places::{Place, Places};
use super::refused_acts::RefusedActs;
use super::{Budget, Refusal, RequestMeters, WebOrigins};

/// Most uploaded files that are read at the same time. More would take processor time from the
/// estimators.
const FILE_READERS: usize = 1;

/// The desks behind the doors. All clones share them. It is only a pointer, because the doors clone
/// it several times for each request.
#[derive(Clone)]
pub struct Service(Arc<Desks>);

/// Map tiles for the dashboard.
pub(crate) struct Tiles {
    /// Address of a tile, with `{z}`, `{x}` and `{y}`.
    pub(crate) template: String,
    /// Scheme, host and port of this address.
    pub(crate) origin: String,
    /// The credit line of their owner.
    pub(crate) attribution: String,
}

#[derive(Clone)]
struct Desks {
    sessions: Sessions,
    aiding: AidingDesk,
    feeds: Feeds,
    jobs: Jobs,
    keys: Keys,
    quotas: TenantQuotas,
    limits: Arc<Limits>,
    budget: Budget,
    /// Limits how many uploaded files are read at the same time.
    file_readers: Arc<Semaphore>,
    /// Host names that requests may use, besides `localhost` and loopback addresses.
    hosts: Arc<[String]>,
    /// Origins of web pages on other hosts that may call the service.
    web_origins: WebOrigins,
    draining: Arc<watch::Sender<bool>>,
    node: Arc<str>,
    meters: RequestMeters,
    /// Limits the entries of refused calls in the audit log.
    refused_acts: Arc<RefusedActs>,
    /// TLS of the port; `None` if it is not encrypted.
    tls: Option<ServerTls>,
    /// The dashboard.
    dashboard: DashboardConfiguration,
    /// The other nodes; `None` for a service without a cluster.
    nodes: Option<Nodes>,
    /// Begins traces; `None` if there is no collector.
    tracer: Option<Tracer>,
    /// Places of open streams.
    streams: Places,
    /// Places of open watches.
    watches: Places,
}

impl Service {
    /// A service with these desks.
    pub(crate) fn new(
        sessions: Sessions,
        aiding: AidingDesk,
        feeds: Feeds,
        jobs: Jobs,
        keys: Keys,
        quotas: TenantQuotas,
        limits: Limits,
    ) -> Self {
        let budget = Budget::new(limits.request_memory_bytes, limits.intake());
        let streams = Places::new(limits.streams, limits.streams_per_key);
        let watches = Places::new(limits.watches, limits.watches_per_key);
        Self(Arc::new(Desks {
            sessions,
            aiding,
            feeds,
            jobs,
            keys,
            quotas,
            budget,
            file_readers: Arc::new(Semaphore::new(FILE_READERS)),
            hosts: Arc::default(),
            web_origins: WebOrigins::default(),
            limits: Arc::new(limits),
            draining: Arc::new(watch::Sender::new(false)),
            node: "".into(),
            meters: RequestMeters::new(),
            refused_acts: Arc::default(),
            tls: None,
            dashboard: DashboardConfiguration::default(),
            nodes: None,
            tracer: None,
            streams,
            watches,
        }))
    }

    /// The service with the name of its node.
    #[must_use]
    pub(crate) fn named(mut self, node: String) -> Self {
        Arc::make_mut(&mut self.0).node = node.into();
        self
    }

    /// Name of the node.
    pub(crate) fn node(&self) -> &str {
        &self.0.node
    }

    /// The service with further host names that requests may use.
    #[must_use]
    pub fn with_hosts(mut self, hosts: &[String]) -> Self {
        Arc::make_mut(&mut self.0).hosts = hosts.into();
        self
    }

    /// The service with origins of web pages on other hosts that may call it.
    #[must_use]
    pub(crate) fn with_web_origins(mut self, origins: WebOrigins) -> Self {
        Arc::make_mut(&mut self.0).web_origins = origins;
        self
    }

    /// The origins of web pages on other hosts that may call the service.
    pub(crate) fn web_origins(&self) -> &WebOrigins {
        &self.0.web_origins
    }

    /// The service with an encrypted port, unless `tls` is `None`.
    #[must_use]
    pub(crate) fn with_tls(mut self, tls: Option<ServerTls>) -> Self {
        Arc::make_mut(&mut self.0).tls = tls;
        self
    }

    /// The service with these options of the dashboard.
    #[must_use]
    pub(crate) fn with_dashboard(mut self, dashboard: DashboardConfiguration) -> Self {
        Arc::make_mut(&mut self.0).dashboard = dashboard;
        self
    }

    /// Tiles for the maps of the dashboard, if the operator names any.
    pub(crate) fn tiles(&self) -> Option<Tiles> {
        let options = &self.0.dashboard;
        Some(Tiles {
            template: options.tiles.clone()?,
            origin: options.tiles_origin()?,
            attribution: options.attribution.trim().to_owned(),
        })
    }

    /// The service with traces, unless `tracer` is `None`.
    #[must_use]
    pub(crate) fn with_tracer(mut self, tracer: Option<Tracer>) -> Self {
        Arc::make_mut(&mut self.0).tracer = tracer;
        self
    }

    /// Begins traces; `None` if there is no collector.
    pub(crate) fn tracer(&self) -> Option<&Tracer> {
        self.0.tracer.as_ref()
    }

    /// TLS of the port; `None` if it is not encrypted.
    pub(crate) fn tls(&self) -> Option<&ServerTls> {
        self.0.tls.as_ref()
    }

    /// The service as a node of a cluster, unless `nodes` is `None`.
    #[must_use]
    pub(crate) fn with_nodes(mut self, nodes: Option<Nodes>) -> Self {
        Arc::make_mut(&mut self.0).nodes = nodes;
        self
    }

    /// The cluster; `None` without one.
    pub(crate) fn nodes(&self) -> Option<&Nodes> {
        self.0.nodes.as_ref()
    }

    /// Whether the operator lists this host name of the service.
    pub(crate) fn is_listed_host(&self, name: &str) -> bool {
        self.0.hosts.iter().any(|host| host.eq_ignore_ascii_case(name))
    }

    /// The memory of all requests.
    pub fn budget(&self) -> &Budget {
        &self.0.budget
    }

    /// Meters of the requests and connections of both doors.
    pub(crate) fn meters(&self) -> &RequestMeters {
        &self.0.meters
    }

    /// The limit of entries of refused calls in the audit log.
    pub(super) fn refused_acts(&self) -> &RefusedActs {
        &self.0.refused_acts
    }

    /// Number of open streams, and of open watches.
    pub(super) fn open_streams(&self) -> (usize, usize) {
        (self.0.streams.taken(), self.0.watches.taken())
    }

    /// Waits until another uploaded file may be read. The caller keeps the permit while it reads.
    pub(super) async fn file_reader(&self) -> OwnedSemaphorePermit {
        let permit = self.0.file_readers.clone().acquire_owned().await;
        permit.expect("the semaphore is never closed")
    }

    /// The place of another stream of the holder of a key. The stream keeps it until it ends.
    ///
    /// # Errors
    /// The limit of open streams is reached, in all or of the key.
    pub(super) fn stream_place(&self, key: Option<&str>) -> Result<Place, Refusal> {
        let taken = self.0.streams.take(key);
        taken.map_err(|full| Refusal::new(Code::TooManyStreams, full.message("streams")))
    }

    /// The place of another watch of the holder of a key. The watch keeps it until it ends.
    ///
    /// # Errors
    /// The limit of open watches is reached, in all or of the key.
    pub(super) fn watch_place(&self, key: Option<&str>) -> Result<Place, Refusal> {
        let taken = self.0.watches.take(key);
        taken.map_err(|full| Refusal::new(Code::TooManyWatches, full.message("watches")))
    }

    /// The desk for sessions.
    pub fn sessions(&self) -> &Sessions {
        &self.0.sessions
    }

    /// The desk for ephemerides.
    pub fn navigation(&self) -> &NavigationBroker {
        &self.0.aiding.navigation
    }

    /// The desk for base stations.
    pub fn bases(&self) -> &BaseBroker {
        &self.0.aiding.bases
    }

    /// The desks for ephemerides and base stations, and the table of the geoid.
    pub(super) fn aiding(&self) -> &AidingDesk {
        &self.0.aiding
    }

    /// The desk for streams and archives.
    pub fn feeds(&self) -> &Feeds {
        &self.0.feeds
    }

    /// The desk for batch jobs.
    pub fn jobs(&self) -> &Jobs {
        &self.0.jobs
    }

    /// The API keys.
    pub fn keys(&self) -> &Keys {
        &self.0.keys
    }

    /// The quotas of tenants.
    pub fn quotas(&self) -> &TenantQuotas {
        &self.0.quotas
    }

    /// The limits in force.
    pub(crate) fn limits(&self) -> &Limits {
        &self.0.limits
    }

    /// Makes the service not ready, because it is about to stop.
    pub fn drain(&self) {
        self.0.draining.send_replace(true);
    }

    /// Whether the service is about to stop.
    pub(crate) fn is_draining(&self) -> bool {
        *self.0.draining.borrow()
    }

    /// Waits until the service is about to stop, or no longer exists.
    pub(crate) fn drained(&self) -> impl Future<Output = ()> + use<> {
        let mut draining = self.0.draining.subscribe();
        async move {
            // Err: the service no longer exists.
            draining.wait_for(|draining| *draining).await.ok();
        }
    }
}
