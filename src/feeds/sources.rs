//! Sources of ephemerides that the operator names: archives, and streams that fill no base.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;

use crate::aiding::AidingDesk;
use crate::clock::unix_ms;

use super::archive::{Archive, ArchiveTemplate};
use super::health::{ArchiveHealth, FeedHealth, SourceHealth};
use super::ntrip::{Caster, StreamRequest};
use super::stream::{Stream, StreamHints, StreamMeans, StreamStatus};
use super::{Connector, FeedOptions, FetchError, FetchPolicy};

/// The operator's sources of ephemerides.
#[derive(Clone, Debug)]
pub struct NavigationSources {
    /// Archives of RINEX navigation files.
    pub archives: Vec<ArchiveTemplate>,
    /// Interval between two requests to an archive.
    pub interval: Duration,
    /// Streams of casters.
    pub streams: Vec<StreamRequest>,
}

impl NavigationSources {
    /// A policy that allows these hosts and no others. Private addresses are allowed, because the
    /// operator has chosen the hosts.
    ///
    /// # Errors
    /// A host is invalid.
    pub fn policy(&self) -> Result<FetchPolicy, FetchError> {
        let mut hosts = Vec::new();
        for template in &self.archives {
            let url = template.at(crate::gnss::GpsTime::EPOCH)?;
            hosts.push(format!("{}:{}", url.host, url.port));
        }
        for StreamRequest { caster: Caster { host, port, .. }, .. } in &self.streams {
            hosts.push(format!("{host}:{port}"));
        }
        FetchPolicy::new(&hosts, true)
    }
}

/// Health of a source.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum SourceStatus {
    /// An archive.
    Archive(ArchiveHealth),
    /// A stream.
    Stream(FeedHealth),
}

/// A running source.
pub(super) struct Source {
    /// Its address, without a password.
    pub(super) name: String,
    health: Health,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

enum Health {
    Archive(Arc<SourceHealth>),
    Stream(Arc<StreamStatus>),
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
        let status = Arc::new(StreamStatus::new(None));
        let name = format!("{}/{}", request.caster, request.mountpoint);
        let (connector, aiding) = (connector.clone(), aiding.clone());
        // Streams of ephemerides may have no epochs.
        let options = FeedOptions { no_epochs: Duration::MAX, ..options };
        let stream = Stream::new(
            request,
            StreamHints::default(),
            status.clone(),
            StreamMeans { connector, aiding, options },
            stopped,
        );
        let task = tokio::spawn(stream.run());
        Self { name, health: Health::Stream(status), stop, task }
    }

    pub(super) fn status(&self) -> SourceStatus {
        match &self.health {
            Health::Archive(health) => SourceStatus::Archive(health.read()),
            Health::Stream(status) => SourceStatus::Stream(status.health()),
        }
    }

    pub(super) async fn close(self) {
        // Err: the task has ended, or it panicked.
        self.stop.send(true).ok();
        self.task.await.ok();
    }
}
