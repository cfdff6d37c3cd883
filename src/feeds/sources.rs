//! What brings ephemerides by the operator's wish: archives, and streams that fill no base.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::aiding::AidingDesk;
use crate::clock::unix_ms;

use super::archive::{Archive, ArchiveTemplate};
use super::health::{ArchiveHealth, FeedHealth, SourceHealth};
use super::ntrip::{Caster, StreamRequest};
use super::stream::{Shared, Stream, Told};
use super::{Connector, FeedOptions, FetchError, FetchPolicy};

/// What is to bring ephemerides.
#[derive(Clone, Debug)]
pub struct NavigationSources {
    /// Archives of RINEX navigation files.
    pub archives: Vec<ArchiveTemplate>,
    /// How often an archive is asked.
    pub interval: Duration,
    /// Streams of casters.
    pub streams: Vec<StreamRequest>,
}

impl NavigationSources {
    /// The policy under which these and no other hosts may be asked: the operator has named them,
    /// whatever network they are in.
    ///
    /// # Errors
    /// A host that is none.
    pub fn policy(&self) -> Result<FetchPolicy, FetchError> {
        let mut hosts = Vec::new();
        for template in &self.archives {
            let place = template.at(crate::gnss::GpsTime::EPOCH)?;
            hosts.push(format!("{}:{}", place.host, place.port));
        }
        for StreamRequest { caster: Caster { host, port, .. }, .. } in &self.streams {
            hosts.push(format!("{host}:{port}"));
        }
        FetchPolicy::new(&hosts, true)
    }
}

/// How a source is doing.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceStatus {
    /// An archive.
    Archive(ArchiveHealth),
    /// A stream.
    Stream(FeedHealth),
}

/// A source that runs.
pub(super) struct Source {
    /// Its address, without a password.
    pub(super) name: String,
    health: Health,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

enum Health {
    Archive(Arc<SourceHealth>),
    Stream(Arc<Shared>),
}

impl Source {
    pub(super) fn archive(
        template: ArchiveTemplate,
        name: String,
        interval: Duration,
        connector: &Connector,
        aiding: &AidingDesk,
    ) -> Self {
        let (stop, stopped) = watch::channel(false);
        let health = Arc::new(SourceHealth::new(unix_ms()));
        let archive = Archive {
            template,
            interval,
            connector: connector.clone(),
            navigation: aiding.navigation.clone(),
            health: health.clone(),
            stopped,
        };
        let task = tokio::spawn(archive.run());
        Self { name, health: Health::Archive(health), stop, task }
    }

    pub(super) fn stream(
        request: StreamRequest,
        options: FeedOptions,
        connector: &Connector,
        aiding: &AidingDesk,
    ) -> Self {
        let (stop, stopped) = watch::channel(false);
        let shared = Arc::new(Shared::new(None));
        let name = format!("{}/{}", request.caster, request.mountpoint);
        let (connector, aiding) = (connector.clone(), aiding.clone());
        // Nobody waits for epochs of it.
        let options = FeedOptions { no_epochs: Duration::MAX, ..options };
        let stream = Stream::new(
            request,
            Told::default(),
            shared.clone(),
            connector,
            aiding,
            options,
            stopped,
        );
        let task = tokio::spawn(stream.run());
        Self { name, health: Health::Stream(shared), stop, task }
    }

    pub(super) fn status(&self) -> SourceStatus {
        match &self.health {
            Health::Archive(health) => SourceStatus::Archive(health.read()),
            Health::Stream(shared) => SourceStatus::Stream(shared.health()),
        }
    }

    pub(super) async fn close(self) {
        // Err: it has ended by itself, or it panicked.
        self.stop.send(true).ok();
        self.task.await.ok();
    }
}
