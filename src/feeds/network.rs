//! Networks: casters whose sourcetable lists bases. A base is connected while a rover needs it.
//!
//! The table is fetched at an interval. A stream in the table is usable if it is RTCM 3 with
//! observations that the decoder supports, and has a position. Sessions that use the nearest of all
//! bases record the position of their rover. The usable stream nearest to a rover becomes a base of
//! the service, with one connection for all its rovers. It is disconnected when no rover has needed
//! it for a while; its epochs stay.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use crate::aiding::AidingError;
use crate::aiding::bases::{BaseBroker, BaseFeed, BaseId, NearestBaseRequest, NewBase};
use crate::clock::unix_ms;
use crate::gnss::{Ecef, Geodetic, GpsTime};

use super::health::{FeedProblem, SourceState};
use super::ntrip::{
    self, Caster, Credentials, Mountpoint, NtripError, NtripVersion, StreamRequest,
};
use super::stop::stopped;
use super::{Backoff, Connector, FetchError};

/// Largest error of the positions in a table (m): they often have two decimals of a degree.
const TABLE_ERROR_M: f64 = 2_000.0;
/// First and longest delay before a table is requested again after a failure.
const DELAY: Duration = Duration::from_secs(30);
const DELAY_CEILING: Duration = Duration::from_secs(3_600);
/// Observation messages that the decoder supports: MSM4 to MSM7 of each constellation, and the
/// legacy messages of GPS and GLONASS with pseudoranges and carrier phases.
const OBSERVATIONS: [&str; 24] = [
    "1002", "1004", "1010", "1012", "1074", "1075", "1076", "1077", "1084", "1085", "1086", "1087",
    "1094", "1095", "1096", "1097", "1114", "1115", "1116", "1117", "1124", "1125", "1126", "1127",
];

/// A caster whose sourcetable lists bases, and how to use it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkRequest {
    /// Address of the caster.
    pub caster: Caster,
    /// User and password, if the caster asks for them.
    pub credentials: Option<Credentials>,
    /// A time within half a day of each stream's first message, for recorded streams; `None` for
    /// the service's clock.
    pub near: Option<GpsTime>,
    /// Interval between two requests for the table.
    pub table_interval: Duration,
    /// A stream that no rover has needed for this long is disconnected.
    pub idle: Duration,
    /// Interval at which the streams that rovers need are determined.
    pub demand_interval: Duration,
}

/// Health of a network.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkHealth {
    /// Address of the caster.
    pub caster: String,
    /// State of the table.
    pub state: SourceState,
    /// When this state began (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// Number of streams in the last table.
    pub listed: usize,
    /// Number of these streams that are usable.
    pub usable: usize,
    /// Number of connected bases.
    pub connected: usize,
    /// When the table was last received (ms since 1970-01-01 UTC).
    pub succeeded_unix_ms: Option<i64>,
    /// Why the table could not be fetched; `None` after a success.
    pub problem: Option<FeedProblem>,
    /// Why the stream that was last needed did not become a base; `None` after a success.
    pub refusal: Option<FeedProblem>,
    /// When the table is fetched again (ms since 1970-01-01 UTC).
    pub retry_unix_ms: Option<i64>,
}

/// Starts and stops the streams that fill bases.
pub(super) trait Streams: Send + Sync + 'static {
    /// Starts to fill a base from a stream.
    ///
    /// # Errors
    /// The caster's address or the mountpoint is invalid.
    fn start(&self, base: &BaseId, feed: &BaseFeed) -> Result<(), FetchError>;

    /// Stops filling a base.
    fn stop(&self, base: &BaseId);
}

/// A usable stream of the table.
#[derive(Clone, Debug, PartialEq)]
struct UsableStream {
    name: String,
    label: String,
    position: Ecef,
}

/// A connected base.
struct Connected {
    base: BaseId,
    /// When a rover last needed it (ms since 1970-01-01 UTC).
    needed_unix_ms: i64,
}

/// A running network.
pub(super) struct RunningNetwork {
    health: Arc<Mutex<NetworkHealth>>,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl RunningNetwork {
    pub(super) fn start(
        request: NetworkRequest,
        connector: Connector,
        bases: BaseBroker,
        filling: impl Streams,
    ) -> Self {
        let (stop, stopped) = watch::channel(false);
        let health = Arc::new(Mutex::new(NetworkHealth {
            caster: request.caster.to_string(),
            state: SourceState::Fetching,
            since_unix_ms: unix_ms(),
            listed: 0,
            usable: 0,
            connected: 0,
            succeeded_unix_ms: None,
            problem: None,
            refusal: None,
            retry_unix_ms: None,
        }));
        let network = Network {
            request,
            connector,
            bases,
            filling,
            health: health.clone(),
            stopped,
            streams: Arc::default(),
            connected: BTreeMap::new(),
        };
        Self { health, stop, task: tokio::spawn(network.run()) }
    }

    pub(super) fn health(&self) -> NetworkHealth {
        self.health.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) async fn close(self) {
        // Err: the task has ended, or it panicked.
        self.stop.send(true).ok();
        self.task.await.ok();
    }
}

/// The state of a network's task.
struct Network<S> {
    request: NetworkRequest,
    connector: Connector,
    bases: BaseBroker,
    filling: S,
    health: Arc<Mutex<NetworkHealth>>,
    stopped: watch::Receiver<bool>,
    /// The usable streams of the table.
    streams: Arc<Vec<UsableStream>>,
    /// Connected bases by mountpoint.
    connected: BTreeMap<String, Connected>,
}

impl<S: Streams> Network<S> {
    /// Runs until stopped, or until the desk is gone.
    async fn run(mut self) {
        let mut backoff = Backoff::new(DELAY, DELAY_CEILING);
        let mut due = Instant::now();
        let mut stop = self.stopped.clone();
        loop {
            if due <= Instant::now() {
                let delay = tokio::select! {
                    () = stopped(&mut stop) => return,
                    delay = self.fetch(&mut backoff) => delay,
                };
                due = Instant::now() + delay;
            }
            self.serve().await;
            tokio::select! {
                () = stopped(&mut stop) => return,
                () = sleep(self.request.demand_interval) => {}
            }
        }
    }

    /// Fetches the table; returns the delay until the next request.
    async fn fetch(&mut self, backoff: &mut Backoff) -> Duration {
        self.enter(SourceState::Fetching);
        let NetworkRequest { caster, credentials, table_interval, .. } = &self.request;
        let request = StreamRequest {
            caster: caster.clone(),
            mountpoint: String::new(),
            credentials: credentials.clone(),
            version: NtripVersion::Two,
        };
        let fetched = ntrip::sourcetable(&self.connector, &request).await;
        let delay = match &fetched {
            Ok(_) => {
                backoff.reset();
                *table_interval
            }
            Err(error) => backoff.next(error.retry_after()),
        };
        match fetched {
            Ok(table) => {
                self.enter(SourceState::Current);
                self.streams = Arc::new(table.mountpoints.iter().filter_map(usable).collect());
                let mut health = self.lock();
                health.listed = table.mountpoints.len();
                health.usable = self.streams.len();
                (health.succeeded_unix_ms, health.problem) = (Some(unix_ms()), None);
            }
            Err(error) => self.failed(&error),
        }
        self.lock().retry_unix_ms = Some(unix_ms() + delay.as_millis() as i64);
        delay
    }

    /// Records a failure. The previous table stays in use.
    fn failed(&self, error: &NtripError) {
        self.enter(SourceState::Waiting);
        let (code, caster) = (error.code(), &self.request.caster);
        // Logged once for each cause, not for each attempt.
        if self.lock().problem.as_ref().is_none_or(|problem| problem.code != code) {
            tracing::warn!(%code, %caster, %error, "a caster's sourcetable cannot be fetched");
        }
        self.lock().problem = Some(FeedProblem::from(error));
    }

    /// Connects the streams that rovers need, and disconnects those that no rover has needed for a
    /// while.
    async fn serve(&mut self) {
        let bases = self.bases.clone();
        let oldest_unix_ms = unix_ms() - self.request.idle.as_millis() as i64;
        let streams = self.streams.clone();
        let requests = bases.nearest_base_requests().since(oldest_unix_ms);
        let work = move || nearest_streams(&streams, &requests);
        // Err: it panicked, so no stream is known to be needed.
        let needed = tokio::task::spawn_blocking(work).await.unwrap_or_default();
        // A deleted base is no longer connected.
        self.connected.retain(|_, connected| bases.name(&connected.base).is_ok());
        for (index, needed_unix_ms) in needed {
            let Some(listed) = self.streams.get(index).cloned() else { continue };
            match self.connected.get_mut(&listed.name) {
                Some(known) => known.needed_unix_ms = known.needed_unix_ms.max(needed_unix_ms),
                None => self.connect(listed, needed_unix_ms).await,
            }
        }
        self.connected.retain(|_, connected| {
            let used_unix_ms = bases.used_unix_ms(&connected.base).unwrap_or(i64::MIN);
            let is_needed = oldest_unix_ms <= connected.needed_unix_ms.max(used_unix_ms);
            if !is_needed {
                self.filling.stop(&connected.base);
            }
            is_needed
        });
        self.lock().connected = self.connected.len();
    }

    async fn connect(&mut self, listed: UsableStream, needed_unix_ms: i64) {
        let NetworkRequest { caster, credentials, near, .. } = &self.request;
        let Credentials { name, password } = credentials.clone().unwrap_or_default();
        let (caster, mountpoint) = (caster.to_string(), listed.name.clone());
        // The password stays in the operator's configuration and is not stored.
        let kept = BaseFeed {
            caster,
            mountpoint,
            name,
            password: String::new(),
            version: 2,
            near: *near,
            position: None,
            follows_rover: false,
            is_on_demand: true,
        };
        let base = match base_of(&self.bases, &kept, listed.label).await {
            Ok(base) => base,
            Err(error) => {
                self.lock().refusal = Some(FeedProblem::from(&error));
                return;
            }
        };
        match self.filling.start(&base, &BaseFeed { password, ..kept }) {
            Ok(()) => {
                self.lock().refusal = None;
                self.connected.insert(listed.name, Connected { base, needed_unix_ms });
            }
            Err(error) => self.lock().refusal = Some(problem_of(&error)),
        }
    }

    fn enter(&self, state: SourceState) {
        let mut health = self.lock();
        (health.state, health.since_unix_ms, health.retry_unix_ms) = (state, unix_ms(), None);
    }

    fn lock(&self) -> MutexGuard<'_, NetworkHealth> {
        self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn problem_of(error: &FetchError) -> FeedProblem {
    FeedProblem { code: error.code(), message: error.to_string() }
}

/// The base that a stream fills: the existing base of this stream, or a new one.
async fn base_of(
    bases: &BaseBroker,
    feed: &BaseFeed,
    label: String,
) -> Result<BaseId, AidingError> {
    let is_same = |known: &BaseFeed| {
        known.is_on_demand
            && (&known.caster, &known.mountpoint, &known.name)
                == (&feed.caster, &feed.mountpoint, &feed.name)
    };
    let known = bases.feeds().into_iter().find(|(.., known)| is_same(known));
    if let Some((base, ..)) = known {
        return Ok(base);
    }
    let new = NewBase { label, feed: Some(feed.clone()), ..NewBase::default() };
    let created = bases.create(new).await?;
    Ok(BaseId::parse(&created.name.id).expect("a base's name is an id"))
}

/// The stream of a table's entry, if it is usable: RTCM 3, observations that the decoder supports,
/// and a fixed known position.
fn usable(mountpoint: &Mountpoint) -> Option<UsableStream> {
    let Mountpoint { name, identifier, format, details, position_deg, needs_position, .. } =
        mountpoint;
    let format: String = format.chars().filter(|c| !c.is_whitespace()).collect();
    let is_rtcm = format.to_ascii_uppercase().starts_with("RTCM3");
    // Messages with intervals, such as 1005(10),1077(1); many tables omit them.
    let messages = || details.split(|c: char| !c.is_ascii_digit()).filter(|n| n.len() == 4);
    let is_decoded =
        messages().next().is_none() || messages().any(|message| OBSERVATIONS.contains(&message));
    let (latitude_deg, longitude_deg) = position_deg.filter(|position| *position != (0.0, 0.0))?;
    let position = Geodetic::from_degrees(latitude_deg, longitude_deg, 0.0).to_ecef();
    let label = identifier.chars().filter(|c| !c.is_control()).take(100).collect();
    (is_rtcm && is_decoded && !needs_position).then(|| UsableStream {
        name: name.clone(),
        label,
        position,
    })
}

/// For each stream that is nearest to a rover: its index, and when it was last needed.
fn nearest_streams(
    streams: &[UsableStream],
    requests: &[NearestBaseRequest],
) -> BTreeMap<usize, i64> {
    let mut needed: BTreeMap<usize, i64> = BTreeMap::new();
    for NearestBaseRequest { position, baseline_max_m, unix_ms } in requests {
        let distances =
            streams.iter().map(|stream| stream.position.distance_m(*position)).enumerate();
        let nearest = distances.min_by(|(_, a), (_, b)| a.total_cmp(b));
        if let Some((index, _)) = nearest.filter(|(_, m)| *m <= baseline_max_m + TABLE_ERROR_M) {
            let last = needed.entry(index).or_insert(*unix_ms);
            *last = (*last).max(*unix_ms);
        }
    }
    needed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feeds::ntrip::Sourcetable;

    const TABLE: &[u8] =
        b"STR;WEST;West;RTCM 3.2;1005(10),1077(1);2;GPS;N;C;53.00;-9.00;0;0;x;none;B;N;9;\r\n\
        STR;EAST;East;RTCM3;;2;GPS;N;C;53.00;-8.00;0;0;x;none;B;N;9;\r\n\
        STR;OLD;Old;RTCM 2.3;1(1),3(10);2;GPS;N;C;53.00;-8.50;0;0;x;none;B;N;9;\r\n\
        STR;RAW;Raw;RAW;;2;GPS;N;C;53.00;-8.50;0;0;x;none;B;N;9;\r\n\
        STR;EPH;Ephemerides;RTCM 3.3;1019(5),1020(5);0;GPS;N;C;53.00;-8.50;0;0;x;none;B;N;9;\r\n\
        STR;SSR;Corrections;RTCM 3.1;1057(10),1077;0;GPS;N;C;0.00;0.00;0;0;x;none;B;N;9;\r\n\
        STR;VRS;Virtual;RTCM 3.2;1077(1);2;GPS;N;C;53.00;-8.50;1;1;x;none;B;N;9;\r\n\
        ENDSOURCETABLE\r\n";

    fn streams() -> Vec<UsableStream> {
        Sourcetable::parse(TABLE).mountpoints.iter().filter_map(usable).collect()
    }

    /// RTCM 2, raw bytes, ephemerides only, position (0, 0) and virtual bases are not usable.
    #[test]
    fn unusable_streams_are_skipped() {
        let names: Vec<_> = streams().into_iter().map(|listed| listed.name).collect();
        assert_eq!(names, ["WEST", "EAST"]);
    }

    /// Each rover needs the stream nearest to it, if that is near enough.
    #[test]
    fn the_nearest_stream_within_the_baseline_is_needed() {
        let at = |longitude_deg: f64, baseline_max_km: f64, unix_ms| NearestBaseRequest {
            position: Geodetic::from_degrees(53.0, longitude_deg, 50.0).to_ecef(),
            baseline_max_m: baseline_max_km * 1e3,
            unix_ms,
        };
        // A degree of longitude is 67 km here.
        let requests = [at(-8.9, 50.0, 3), at(-8.8, 50.0, 7), at(-8.1, 5.0, 8), at(-3.0, 50.0, 9)];
        assert_eq!(nearest_streams(&streams(), &requests), BTreeMap::from([(0, 7), (1, 8)]));
        assert_eq!(nearest_streams(&streams(), &[at(-8.1, 4.0, 8)]), BTreeMap::new());
        assert_eq!(nearest_streams(&[], &requests), BTreeMap::new());
    }
}
