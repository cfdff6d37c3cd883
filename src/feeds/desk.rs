//! The desk: which streams and archives run, and which bases they fill.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;

use crate::aiding::bases::{BaseFeed, BaseId};
use crate::aiding::{AidingDesk, tenant_source};
use crate::gnss::{Ecef, GpsTime};
use crate::tenant::Tenant;

use super::base_archive::{ArchiveStatus, BaseArchive};
use super::network::{NetworkHealth, NetworkRequest, RunningNetwork, Streams};
use super::ntrip::{Credentials, NtripVersion, StreamRequest};
use super::sources::{NavigationSources, Source, SourceStatus};
use super::stream::{Stream, StreamHints, StreamMeans, StreamStatus};
use super::{ArchiveTemplate, BaseArchiveHealth, Connector, FeedHealth, FeedOptions, FetchError};

/// The identity of a stream. Bases with the same key share one connection.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct StreamKey {
    /// Tenant that owns the bases. No tenant learns of the streams of another.
    tenant: Tenant,
    request: StreamRequest,
    near: Option<GpsTime>,
    /// The bits of the coordinates, which are only compared.
    position: Option<[u64; 3]>,
    /// The base whose rovers' position is reported to the caster. The stream fills this base only.
    follows: Option<BaseId>,
}

struct RunningStream {
    status: Arc<StreamStatus>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

/// Most files of bases that are unpacked at the same time.
const UNPACKED_AT_ONCE: usize = 2;

/// A running archive that fills a base.
struct RunningArchive {
    status: Arc<ArchiveStatus>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

/// The desk for streams of casters and for archives. All clones share it.
#[derive(Clone)]
pub struct Feeds {
    desk: Arc<Desk>,
}

struct Desk {
    connector: Connector,
    aiding: AidingDesk,
    options: FeedOptions,
    streams: Mutex<BTreeMap<StreamKey, RunningStream>>,
    sources: Mutex<Vec<Source>>,
    archives: Mutex<BTreeMap<BaseId, RunningArchive>>,
    reading: Arc<Semaphore>,
    networks: Mutex<Vec<RunningNetwork>>,
}

impl Feeds {
    /// Opens the desk. Nothing runs yet.
    pub(crate) fn open(connector: Connector, aiding: AidingDesk, options: FeedOptions) -> Self {
        let (streams, sources, archives, networks) = Default::default();
        let reading = Arc::new(Semaphore::new(UNPACKED_AT_ONCE));
        let desk =
            Desk { connector, aiding, options, streams, sources, archives, reading, networks };
        Self { desk: Arc::new(desk) }
    }

    /// Requests the streams and archives of all bases, except those of networks, which start on
    /// demand.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub(crate) fn fill_bases(&self) {
        let bases = &self.desk.aiding.bases;
        let (fed, filled) = (bases.feeds(), bases.archives());
        for (base, tenant, feed) in fed.into_iter().filter(|(.., feed)| !feed.is_on_demand) {
            if let Err(error) = self.start(&tenant, &base, &feed) {
                let code = error.code();
                tracing::error!(%code, %base, %error, "the stream of a base cannot start");
            }
        }
        for (base, tenant, template) in filled {
            if let Err(error) = self.fill(&tenant, &base, &template) {
                let code = error.code();
                tracing::error!(%code, %base, %error, "the archive of a base cannot start");
            }
        }
    }

    /// Starts to fetch ephemerides from `sources`, with the operator's own connector.
    ///
    /// # Errors
    /// An address is invalid.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn bring_navigation(
        &self,
        sources: NavigationSources,
        connector: &Connector,
    ) -> Result<(), FetchError> {
        let NavigationSources { archives, interval, streams } = sources;
        let Desk { aiding, options, .. } = &*self.desk;
        let mut running = self.sources();
        for template in archives {
            let name = template.to_string();
            running.push(Source::archive(template, name, interval, connector, aiding));
        }
        for request in streams {
            if request.mountpoint.is_empty() || !request.is_sound() {
                return Err(FetchError::MountpointInvalid { text: request.mountpoint });
            }
            running.push(Source::stream(request, *options, connector, aiding));
        }
        Ok(())
    }

    /// Starts to connect bases of these casters' sourcetables when rovers need them.
    ///
    /// # Errors
    /// A host is not allowed.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn bring_bases(&self, requests: Vec<NetworkRequest>) -> Result<(), FetchError> {
        let connector = &self.desk.connector;
        for NetworkRequest { caster, .. } in &requests {
            connector.policy().check(&caster.host, caster.port)?;
        }
        let start = |request| {
            let (bases, filling) = (self.desk.aiding.bases.clone(), Arc::downgrade(&self.desk));
            RunningNetwork::start(request, connector.clone(), bases, filling)
        };
        self.running_networks().extend(requests.into_iter().map(start));
        Ok(())
    }

    /// The health of the casters whose sourcetables bring bases.
    pub fn networks(&self) -> Vec<NetworkHealth> {
        self.running_networks().iter().map(RunningNetwork::health).collect()
    }

    fn running_networks(&self) -> MutexGuard<'_, Vec<RunningNetwork>> {
        self.desk.networks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The address and health of each source of ephemerides.
    pub(crate) fn navigation_sources(&self) -> Vec<(String, SourceStatus)> {
        self.sources().iter().map(|source| (source.name.clone(), source.status())).collect()
    }

    /// Checks whether a tenant may request a stream.
    ///
    /// # Errors
    /// The caster's address or the mountpoint is invalid, or the operator does not list the host.
    pub(crate) fn check(&self, tenant: &Tenant, feed: &BaseFeed) -> Result<(), FetchError> {
        let caster = request_of(feed)?.caster;
        self.desk.connector.of(tenant).policy().check(&caster.host, caster.port)
    }

    /// Starts to fill a base of a tenant from a stream.
    ///
    /// # Errors
    /// The caster's address or the mountpoint is invalid.
    pub(crate) fn start(
        &self,
        tenant: &Tenant,
        base: &BaseId,
        feed: &BaseFeed,
    ) -> Result<(), FetchError> {
        let bits = |Ecef(p): Ecef| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()];
        let follows = feed.follows_rover.then(|| base.clone());
        let key = StreamKey {
            tenant: tenant.clone(),
            request: request_of(feed)?,
            near: feed.near,
            position: feed.position.map(bits),
            follows: follows.clone(),
        };
        let mut streams = self.streams();
        if let Some(running) = streams.get(&key) {
            running.status.add(base.clone());
            return Ok(());
        }
        let (stop, stopped) = watch::channel(false);
        let status = Arc::new(StreamStatus::new(Some(base.clone())));
        let Desk { connector, aiding, options, .. } = &*self.desk;
        let stream = Stream::new(
            key.request.clone(),
            StreamHints {
                near: feed.near,
                position: feed.position,
                follows,
                source: tenant_source(tenant),
            },
            status.clone(),
            StreamMeans {
                connector: connector.of(tenant),
                aiding: aiding.clone(),
                options: *options,
            },
            stopped,
        );
        let task = tokio::spawn(stream.run());
        streams.insert(key, RunningStream { status, stop, task });
        Ok(())
    }

    /// Checks whether an archive's host may be contacted for the files of a tenant's base.
    ///
    /// # Errors
    /// The address is invalid or has no day, or the operator does not list the host.
    pub(crate) fn check_archive(&self, tenant: &Tenant, template: &str) -> Result<(), FetchError> {
        let template = ArchiveTemplate::new(template)?;
        if template.period_s().is_none() {
            return Err(FetchError::TemplateWithoutDay { text: template.to_string() });
        }
        let url = template.at(GpsTime::EPOCH)?;
        self.desk.connector.of(tenant).policy().check(&url.host, url.port)
    }

    /// Starts to fill a tenant's base from an archive's files, each fetched when rovers need it.
    ///
    /// # Errors
    /// The address is invalid.
    pub(crate) fn fill(
        &self,
        tenant: &Tenant,
        base: &BaseId,
        template: &str,
    ) -> Result<(), FetchError> {
        let (stop, stopped) = watch::channel(false);
        let status = Arc::new(ArchiveStatus::new());
        let Desk { connector, aiding, options, reading, .. } = &*self.desk;
        let archive = BaseArchive {
            base: base.clone(),
            template: ArchiveTemplate::new(template)?,
            connector: connector.of(tenant),
            bases: aiding.bases.clone(),
            options: *options,
            status: status.clone(),
            reading: reading.clone(),
            stopped,
        };
        let task = tokio::spawn(archive.run());
        self.archives().insert(base.clone(), RunningArchive { status, stop, task });
        Ok(())
    }

    /// The health of the archive that fills a base.
    pub(crate) fn archive_health(&self, base: &BaseId) -> Option<BaseArchiveHealth> {
        self.archives().get(base).map(|archive| archive.status.read())
    }

    /// Stops filling a base. A stream that fills no other base is closed.
    pub(crate) fn stop(&self, base: &BaseId) {
        if let Some(RunningArchive { stop, .. }) = self.archives().remove(base) {
            // Err: the task has ended, because the base is deleted.
            stop.send(true).ok();
        }
        self.streams().retain(|_, running| {
            let is_used = running.status.remove(base);
            if !is_used {
                // Err: the task has ended.
                running.stop.send(true).ok();
            }
            is_used
        });
    }

    /// The health of the stream that fills a base.
    pub(crate) fn health(&self, base: &BaseId) -> Option<FeedHealth> {
        let streams = self.streams();
        let fills = |running: &&RunningStream| running.status.fills(base);
        streams.values().find(fills).map(|running| running.status.health_of(base))
    }

    /// Closes all streams and archives. Returns when their last epochs are stored.
    pub async fn close(&self) {
        let networks = std::mem::take(&mut *self.running_networks());
        for network in networks {
            network.close().await; // First, because networks start streams.
        }
        let running = std::mem::take(&mut *self.streams());
        for (_, RunningStream { stop, task, .. }) in running {
            // Err: the task has ended, or it panicked.
            stop.send(true).ok();
            task.await.ok();
        }
        let archives = std::mem::take(&mut *self.archives());
        for (_, RunningArchive { stop, task, .. }) in archives {
            stop.send(true).ok();
            task.await.ok();
        }
        let sources = std::mem::take(&mut *self.sources());
        for source in sources {
            source.close().await;
        }
    }

    fn sources(&self) -> MutexGuard<'_, Vec<Source>> {
        self.desk.sources.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn archives(&self) -> MutexGuard<'_, BTreeMap<BaseId, RunningArchive>> {
        self.desk.archives.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn streams(&self) -> MutexGuard<'_, BTreeMap<StreamKey, RunningStream>> {
        self.desk.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The desk as its networks see it. They do not keep it alive, and start nothing once it is
/// dropped.
impl Streams for Weak<Desk> {
    fn start(&self, base: &BaseId, feed: &BaseFeed) -> Result<(), FetchError> {
        self.upgrade().map_or(Ok(()), |desk| Feeds { desk }.start(&Tenant::operator(), base, feed))
    }

    fn stop(&self, base: &BaseId) {
        if let Some(desk) = self.upgrade() {
            Feeds { desk }.stop(base);
        }
    }
}

fn request_of(feed: &BaseFeed) -> Result<StreamRequest, FetchError> {
    let BaseFeed { caster, mountpoint, name, password, version, .. } = feed;
    let credentials = Credentials { name: name.clone(), password: password.clone() };
    let request = StreamRequest {
        caster: caster.parse()?,
        mountpoint: mountpoint.clone(),
        credentials: (!name.is_empty()).then_some(credentials),
        version: if *version == 1 { NtripVersion::One } else { NtripVersion::Two },
    };
    if mountpoint.is_empty() || !request.is_sound() {
        return Err(FetchError::MountpointInvalid { text: mountpoint.clone() });
    }
    Ok(request)
}
