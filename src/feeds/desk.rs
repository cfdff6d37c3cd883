//! The desk itself: which streams there are, and which bases they fill.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use tokio::sync::{Semaphore, watch};
use tokio::task::JoinHandle;

use crate::aiding::AidingDesk;
use crate::aiding::bases::{BaseFeed, BaseId};
use crate::gnss::{Ecef, GpsTime};

use super::base_archive::{BaseArchive, Note};
use super::network::{NetworkHealth, NetworkRequest, RunningNetwork, Streams};
use super::ntrip::{Credentials, NtripVersion, StreamRequest};
use super::sources::{NavigationSources, Source, SourceStatus};
use super::stream::{Shared, Stream, Told};
use super::{ArchiveTemplate, BaseArchiveHealth, Connector, FeedHealth, FeedOptions, FetchError};

/// What tells streams apart: those that are alike are one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    request: StreamRequest,
    near: Option<GpsTime>,
    /// Bits of the position, which is compared and no more.
    position: Option<[u64; 3]>,
    /// The base whose rovers the caster is told of: it computes the stream for them alone.
    follows: Option<BaseId>,
}

struct Running {
    shared: Arc<Shared>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

/// Files of bases that are unpacked at a time.
const READ_AT_A_TIME: usize = 2;

/// An archive that fills a base.
struct Filling {
    note: Arc<Note>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

/// The desk for streams of casters and for archives. Clones share it.
#[derive(Clone)]
pub struct Feeds {
    desk: Arc<Desk>,
}

struct Desk {
    connector: Connector,
    aiding: AidingDesk,
    options: FeedOptions,
    streams: Mutex<BTreeMap<Key, Running>>,
    sources: Mutex<Vec<Source>>,
    archives: Mutex<BTreeMap<BaseId, Filling>>,
    reading: Arc<Semaphore>,
    networks: Mutex<Vec<RunningNetwork>>,
}

impl Feeds {
    /// Opens the desk; streams that fill bases are asked for at once, but for those of networks.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn open(connector: Connector, aiding: AidingDesk, options: FeedOptions) -> Self {
        let (streams, sources, archives, networks) = Default::default();
        let reading = Arc::new(Semaphore::new(READ_AT_A_TIME));
        let (fed, filled) = (aiding.bases.feeds(), aiding.bases.archives());
        let desk =
            Desk { connector, aiding, options, streams, sources, archives, reading, networks };
        let feeds = Self { desk: Arc::new(desk) };
        for (base, feed) in fed.into_iter().filter(|(_, feed)| !feed.is_on_demand) {
            if let Err(error) = feeds.start(&base, &feed) {
                tracing::error!(code = error.code(), %base, %error, "a base is not fed");
            }
        }
        for (base, template) in filled {
            if let Err(error) = feeds.fill(&base, &template) {
                tracing::error!(code = error.code(), %base, %error, "a base is not filled");
            }
        }
        feeds
    }

    /// Has ephemerides brought by these sources from now on, through a connector of their own.
    ///
    /// # Errors
    /// An address that is none.
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

    /// Has bases brought by the sourcetables of these casters from now on.
    ///
    /// # Errors
    /// A host that may not be asked.
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

    /// How the casters are doing whose sourcetables bring bases.
    pub fn networks(&self) -> Vec<NetworkHealth> {
        self.running_networks().iter().map(RunningNetwork::health).collect()
    }

    fn running_networks(&self) -> MutexGuard<'_, Vec<RunningNetwork>> {
        self.desk.networks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The sources of ephemerides, each with its address and how it is doing.
    pub fn navigation_sources(&self) -> Vec<(String, SourceStatus)> {
        self.sources().iter().map(|source| (source.name.clone(), source.status())).collect()
    }

    /// Whether a stream may be asked for.
    ///
    /// # Errors
    /// A caster or mountpoint that is none, or a host that the operator does not list.
    pub fn check(&self, feed: &BaseFeed) -> Result<(), FetchError> {
        let request = request_of(feed)?;
        self.desk.connector.policy().check(&request.caster.host, request.caster.port)
    }

    /// Fills a base from a stream from now on.
    ///
    /// # Errors
    /// A caster or mountpoint that is none.
    pub fn start(&self, base: &BaseId, feed: &BaseFeed) -> Result<(), FetchError> {
        let bits = |Ecef(p): Ecef| [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()];
        let follows = feed.follows_rover.then(|| base.clone());
        let key = Key {
            request: request_of(feed)?,
            near: feed.near,
            position: feed.position.map(bits),
            follows: follows.clone(),
        };
        let mut streams = self.streams();
        if let Some(running) = streams.get(&key) {
            running.shared.add(base.clone());
            return Ok(());
        }
        let (stop, stopped) = watch::channel(false);
        let shared = Arc::new(Shared::new(Some(base.clone())));
        let Desk { connector, aiding, options, .. } = &*self.desk;
        let stream = Stream::new(
            key.request.clone(),
            Told { near: feed.near, position: feed.position, follows },
            shared.clone(),
            connector.clone(),
            aiding.clone(),
            *options,
            stopped,
        );
        let task = tokio::spawn(stream.run());
        streams.insert(key, Running { shared, stop, task });
        Ok(())
    }

    /// Whether an archive may be asked for a base's files.
    ///
    /// # Errors
    /// An address that is none or names no day, or a host that the operator does not list.
    pub fn check_archive(&self, template: &str) -> Result<(), FetchError> {
        let template = ArchiveTemplate::new(template)?;
        if template.period_s().is_none() {
            return Err(FetchError::TemplateWithoutDay { text: template.to_string() });
        }
        let place = template.at(GpsTime::EPOCH)?;
        self.desk.connector.policy().check(&place.host, place.port)
    }

    /// Fills a base from an archive's files from now on, each when rovers need it.
    ///
    /// # Errors
    /// An address that is none.
    pub fn fill(&self, base: &BaseId, template: &str) -> Result<(), FetchError> {
        let (stop, stopped) = watch::channel(false);
        let note = Arc::new(Note::new());
        let Desk { connector, aiding, options, reading, .. } = &*self.desk;
        let archive = BaseArchive {
            base: base.clone(),
            template: ArchiveTemplate::new(template)?,
            connector: connector.clone(),
            bases: aiding.bases.clone(),
            options: *options,
            note: note.clone(),
            reading: reading.clone(),
            stopped,
        };
        let task = tokio::spawn(archive.run());
        self.archives().insert(base.clone(), Filling { note, stop, task });
        Ok(())
    }

    /// How the archive is doing that fills a base.
    pub fn archive_health(&self, base: &BaseId) -> Option<BaseArchiveHealth> {
        self.archives().get(base).map(|filling| filling.note.read())
    }

    /// Fills a base no more; a stream that fills none is given up.
    pub fn stop(&self, base: &BaseId) {
        if let Some(Filling { stop, .. }) = self.archives().remove(base) {
            // Err: it has ended by itself, for the base is gone.
            stop.send(true).ok();
        }
        self.streams().retain(|_, running| {
            let is_used = running.shared.remove(base);
            if !is_used {
                // Err: it has ended by itself.
                running.stop.send(true).ok();
            }
            is_used
        });
    }

    /// How the stream is doing that fills a base.
    pub fn health(&self, base: &BaseId) -> Option<FeedHealth> {
        let streams = self.streams();
        streams.values().find(|running| running.shared.fills(base)).map(|r| r.shared.health())
    }

    /// Gives up all streams; returns when what they brought is stored.
    pub async fn close(&self) {
        let networks = std::mem::take(&mut *self.running_networks());
        for network in networks {
            network.close().await; // Else it would connect again what is given up.
        }
        let running = std::mem::take(&mut *self.streams());
        for (_, Running { stop, task, .. }) in running {
            // Err: it has ended by itself, or it panicked.
            stop.send(true).ok();
            task.await.ok();
        }
        let archives = std::mem::take(&mut *self.archives());
        for (_, Filling { stop, task, .. }) in archives {
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

    fn archives(&self) -> MutexGuard<'_, BTreeMap<BaseId, Filling>> {
        self.desk.archives.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn streams(&self) -> MutexGuard<'_, BTreeMap<Key, Running>> {
        self.desk.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Of a desk that its networks do not keep alive: once it is gone nothing is started.
impl Streams for Weak<Desk> {
    fn start(&self, base: &BaseId, feed: &BaseFeed) -> Result<(), FetchError> {
        self.upgrade().map_or(Ok(()), |desk| Feeds { desk }.start(base, feed))
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
