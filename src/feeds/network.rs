//! Networks: casters whose sourcetable says where bases stand, of which those are connected that a
//! rover needs.
//!
//! The table is fetched again on a schedule. Of the streams in it those serve that are RTCM 3 with
//! observations that are decoded, from a place that is told. A rover whose session takes the
//! nearest of all bases tells where it is; the stream nearest to it becomes a base of the service,
//! filled as others are: one connection, however many rovers it serves. What no rover has needed
//! for a while is disconnected; what it observed stays.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use crate::aiding::AidingError;
use crate::aiding::bases::{BaseBroker, BaseFeed, BaseId, NewBase, Seeker};
use crate::clock::unix_ms;
use crate::gnss::{Ecef, Geodetic, GpsTime};

use super::health::{FeedProblem, SourceState};
use super::ntrip::{
    self, Caster, Credentials, Mountpoint, NtripError, NtripVersion, StreamRequest,
};
use super::stop::stopped;
use super::{Backoff, Connector, FetchError};

/// Tables tell places to a hundredth of a degree or so (m).
const TABLE_ERROR_M: f64 = 2_000.0;
/// First delay before a table that did not come is asked for again, and the longest.
const DELAY: Duration = Duration::from_secs(30);
const DELAY_CEILING: Duration = Duration::from_secs(3_600);
/// Messages of observations that are decoded: MSM4 to MSM7 of each constellation, and the legacy
/// ones with pseudoranges and phases of GPS and GLONASS.
const OBSERVATIONS: [&str; 24] = [
    "1002", "1004", "1010", "1012", "1074", "1075", "1076", "1077", "1084", "1085", "1086", "1087",
    "1094", "1095", "1096", "1097", "1114", "1115", "1116", "1117", "1124", "1125", "1126", "1127",
];

/// A caster whose sourcetable says where bases stand.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NetworkRequest {
    /// The caster.
    pub caster: Caster,
    /// For casters that ask for them.
    pub credentials: Option<Credentials>,
    /// Within half a day of the first message of each stream, for those that are played later than
    /// observed; `None`: the service's clock.
    pub near: Option<GpsTime>,
    /// How often the table is fetched.
    pub table_interval: Duration,
    /// A stream that no rover has needed for so long is disconnected.
    pub idle: Duration,
    /// How often is looked which streams are needed.
    pub demand_interval: Duration,
}

/// How a network is doing.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkHealth {
    /// The caster's address.
    pub caster: String,
    /// What its table is at.
    pub state: SourceState,
    /// Since when (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// Streams in the table that came last.
    pub listed: usize,
    /// Those of them that serve.
    pub usable: usize,
    /// Bases that are connected.
    pub connected: usize,
    /// When the table came last (ms since 1970-01-01 UTC).
    pub succeeded_unix_ms: Option<i64>,
    /// Why it did not come, until it does.
    pub problem: Option<FeedProblem>,
    /// Why the base that is needed last was not made, if it was not.
    pub refusal: Option<FeedProblem>,
    /// When the table is fetched again (ms since 1970-01-01 UTC).
    pub retry_unix_ms: Option<i64>,
}

/// What fills bases from streams.
pub(super) trait Streams: Send + Sync + 'static {
    /// Fills a base from a stream from now on.
    ///
    /// # Errors
    /// A caster or mountpoint that is none.
    fn start(&self, base: &BaseId, feed: &BaseFeed) -> Result<(), FetchError>;

    /// Fills a base no more.
    fn stop(&self, base: &BaseId);
}

/// A stream of the table that serves.
#[derive(Clone, Debug, PartialEq)]
struct Listed {
    name: String,
    label: String,
    place: Ecef,
}

/// A base that is connected.
struct Connected {
    base: BaseId,
    /// When a rover needed it last (ms since 1970-01-01 UTC).
    needed_unix_ms: i64,
}

/// A network that runs.
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
        // Err: it has ended by itself, or it panicked.
        self.stop.send(true).ok();
        self.task.await.ok();
    }
}

/// What a network's task works with.
struct Network<S> {
    request: NetworkRequest,
    connector: Connector,
    bases: BaseBroker,
    filling: S,
    health: Arc<Mutex<NetworkHealth>>,
    stopped: watch::Receiver<bool>,
    /// What of the table serves.
    streams: Arc<Vec<Listed>>,
    /// By mountpoint.
    connected: BTreeMap<String, Connected>,
}

impl<S: Streams> Network<S> {
    /// Runs until it is stopped, or the desk is gone.
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

    /// Fetches the table; returns when to do so again.
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
                let mut health = self.note();
                health.listed = table.mountpoints.len();
                health.usable = self.streams.len();
                (health.succeeded_unix_ms, health.problem) = (Some(unix_ms()), None);
            }
            Err(error) => self.failed(&error),
        }
        self.note().retry_unix_ms = Some(unix_ms() + delay.as_millis() as i64);
        delay
    }

    /// What the table said before still holds.
    fn failed(&self, error: &NtripError) {
        self.enter(SourceState::Waiting);
        let (code, caster) = (error.code(), &self.request.caster);
        // Once for each cause, not for each attempt.
        if self.note().problem.as_ref().is_none_or(|problem| problem.code != code) {
            tracing::warn!(code, %caster, %error, "a caster's sourcetable does not come");
        }
        self.note().problem = Some(FeedProblem::from(error));
    }

    /// Connects what rovers need, and disconnects what none has needed for a while.
    async fn serve(&mut self) {
        let bases = self.bases.clone();
        let oldest_unix_ms = unix_ms() - self.request.idle.as_millis() as i64;
        let (streams, seekers) = (self.streams.clone(), bases.seekers().since(oldest_unix_ms));
        let work = move || needed(&streams, &seekers);
        // Err: it panicked, and nothing is known to be needed now.
        let needed = tokio::task::spawn_blocking(work).await.unwrap_or_default();
        // A base that was deleted is no longer connected.
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
        self.note().connected = self.connected.len();
    }

    async fn connect(&mut self, listed: Listed, needed_unix_ms: i64) {
        let NetworkRequest { caster, credentials, near, .. } = &self.request;
        let Credentials { name, password } = credentials.clone().unwrap_or_default();
        let (caster, mountpoint) = (caster.to_string(), listed.name.clone());
        // The operator's password is in his configuration, and nowhere else.
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
                self.note().refusal = Some(FeedProblem::from(&error));
                return;
            }
        };
        match self.filling.start(&base, &BaseFeed { password, ..kept }) {
            Ok(()) => {
                self.note().refusal = None;
                self.connected.insert(listed.name, Connected { base, needed_unix_ms });
            }
            Err(error) => self.note().refusal = Some(problem_of(&error)),
        }
    }

    fn enter(&self, state: SourceState) {
        let mut health = self.note();
        (health.state, health.since_unix_ms, health.retry_unix_ms) = (state, unix_ms(), None);
    }

    fn note(&self) -> MutexGuard<'_, NetworkHealth> {
        self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn problem_of(error: &FetchError) -> FeedProblem {
    FeedProblem { code: error.code(), message: error.to_string(), remedy: error.remedy() }
}

/// The base that a stream fills: the one that it filled before, or a new one.
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
    let known = bases.feeds().into_iter().find(|(_, known)| is_same(known));
    if let Some((base, _)) = known {
        return Ok(base);
    }
    let new = NewBase { label, site: None, feed: Some(feed.clone()), archive: None };
    let created = bases.create(new).await?;
    Ok(BaseId::parse(&created.name.id).expect("a base's name is an id"))
}

/// The stream, if it serves: RTCM 3 with observations that are decoded, from a place that is told
/// and does not follow who asks.
fn usable(mountpoint: &Mountpoint) -> Option<Listed> {
    let Mountpoint { name, identifier, format, details, position_deg, needs_position, .. } =
        mountpoint;
    let format: String = format.chars().filter(|c| !c.is_whitespace()).collect();
    let is_rtcm = format.to_ascii_uppercase().starts_with("RTCM3");
    // Messages with their intervals, as in 1005(10),1077(1); many tables leave them out.
    let messages = || details.split(|c: char| !c.is_ascii_digit()).filter(|n| n.len() == 4);
    let is_decoded =
        messages().next().is_none() || messages().any(|message| OBSERVATIONS.contains(&message));
    let (latitude_deg, longitude_deg) = position_deg.filter(|place| *place != (0.0, 0.0))?;
    let place = Geodetic::from_degrees(latitude_deg, longitude_deg, 0.0).to_ecef();
    let label = identifier.chars().filter(|c| !c.is_control()).take(100).collect();
    (is_rtcm && is_decoded && !needs_position).then(|| Listed { name: name.clone(), label, place })
}

/// The streams nearest to who seeks one, and when each was needed last.
fn needed(streams: &[Listed], seekers: &[Seeker]) -> BTreeMap<usize, i64> {
    let mut needed: BTreeMap<usize, i64> = BTreeMap::new();
    for Seeker { place, reach_m, noted_unix_ms } in seekers {
        let distances = streams.iter().map(|listed| listed.place.distance_m(*place)).enumerate();
        let nearest = distances.min_by(|(_, a), (_, b)| a.total_cmp(b));
        if let Some((index, _)) = nearest.filter(|(_, m)| *m <= reach_m + TABLE_ERROR_M) {
            let last = needed.entry(index).or_insert(*noted_unix_ms);
            *last = (*last).max(*noted_unix_ms);
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

    fn streams() -> Vec<Listed> {
        Sourcetable::parse(TABLE).mountpoints.iter().filter_map(usable).collect()
    }

    /// Neither RTCM 2 nor raw bytes, ephemerides alone, a place that none is, nor a virtual base.
    #[test]
    fn streams_that_do_not_serve_are_passed_over() {
        let names: Vec<_> = streams().into_iter().map(|listed| listed.name).collect();
        assert_eq!(names, ["WEST", "EAST"]);
    }

    /// Each seeker needs the stream nearest to it, if that is within its reach.
    #[test]
    fn the_nearest_within_reach_is_needed() {
        let at = |longitude_deg: f64, reach_km: f64, noted_unix_ms| Seeker {
            place: Geodetic::from_degrees(53.0, longitude_deg, 50.0).to_ecef(),
            reach_m: reach_km * 1e3,
            noted_unix_ms,
        };
        // A degree of longitude is 67 km there.
        let seekers = [at(-8.9, 50.0, 3), at(-8.8, 50.0, 7), at(-8.1, 5.0, 8), at(-3.0, 50.0, 9)];
        assert_eq!(needed(&streams(), &seekers), BTreeMap::from([(0, 7), (1, 8)]));
        assert_eq!(needed(&streams(), &[at(-8.1, 4.0, 8)]), BTreeMap::new());
        assert_eq!(needed(&[], &seekers), BTreeMap::new());
    }
}
