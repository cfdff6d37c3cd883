//! Many `fgo` sessions on one desk, without a network: the first answers after a crash under load,
//! the time to stop with all states dirty, and the cost of an epoch when not all sessions fit in
//! memory. The database is a SQLite file in a temporary folder, or two databases of its own on the
//! Postgres server that `GRAPHFIX_BENCH_POSTGRES` names. The crash is a copy of the database while
//! it is used.
//!
//! `GRAPHFIX_BENCH_SESSIONS=10000 GRAPHFIX_BENCH_EPOCHS=64 cargo bench --bench recovery`
//!
//! With `GRAPHFIX_BENCH_DAYS` the log on Postgres has the partitions of that many earlier days, as
//! that of a service which has run for its retention. They are empty.
//!
//! While the sessions are filled, a stream brings an ephemeris every `GRAPHFIX_BENCH_STREAM_MS`, so
//! that they were solved with many different sets of navigation data.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use futures::StreamExt;
use futures::stream::FuturesUnordered;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{Ephemeris, Epoch, Navigation};
use graphfix::session::{NewSession, SequencedEpoch, SessionId, SessionLimits, Sessions};
use graphfix::simulation::{Scenario, Simulator};
use graphfix::store::{BaseChoice, Store};
use sqlx::{Connection, PgConnection};
use tempfile::TempDir;

/// The allocator of the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Sessions that push at the same time, while nothing is measured.
const CONCURRENT: usize = 64;
/// Epochs in a push while the sessions are filled.
const FILLING: u64 = 16;
/// Most epochs of a session before the crash, if no other number is given.
const EPOCHS_MAX: u64 = 256;
/// Number of the last epochs, if no other is given. They come one by one as from live devices, so
/// that states of all ages are lost in the crash.
const LIVE: u64 = 8;
/// Time between two ephemerides of the stream, if no other is given (ms).
const STREAM_MS: u64 = 100;
/// Time within which a desk opens new connections after all were broken.
const RECONNECTS_WITHIN: Duration = Duration::from_secs(6);
/// Rounds of one epoch for each session.
const ROUNDS: u64 = 3;
/// Fraction of the sessions that fit in memory: 4096 of 10,000, as by default.
const FITTING: f64 = 0.4096;

struct Drive {
    navigation: Navigation,
    epochs: Vec<Epoch>,
    /// Most epochs of a session before the crash, and how many of them come one by one.
    epochs_max: u64,
    live: u64,
}

/// The number in a variable of the environment.
fn number(name: &str, standard: u64) -> u64 {
    std::env::var(name).map_or(standard, |text| text.parse().expect("it is a number"))
}

/// About sixteen satellites with two signals each, an epoch a second.
fn drive() -> Drive {
    let epochs_max = number("GRAPHFIX_BENCH_EPOCHS", EPOCHS_MAX);
    let duration_s = (epochs_max + 64) as f64;
    let scenario = Scenario { duration_s, elevation_mask_rad: 0.5, ..Scenario::open_sky() };
    let simulator = Simulator::new(Scenario { base: None, ..scenario }, 3);
    let navigation = Navigation::clone(simulator.navigation());
    let live = number("GRAPHFIX_BENCH_LIVE", LIVE);
    Drive { navigation, epochs: simulator.map(|epoch| epoch.rover).collect(), epochs_max, live }
}

/// A desk on a database, with room for this many sessions.
async fn desk(url: &str, drive: &Drive, active_sessions: usize) -> (Store, Sessions, AidingDesk) {
    let store = Store::open(url).await.expect("the database opens");
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await;
    let aiding = aiding.expect("navigation data are read");
    let pushed = aiding.navigation.push(drive.navigation.clone(), "simulation").await;
    pushed.expect("the navigation data are stored");
    let limits = SessionLimits { active_sessions, ..SessionLimits::service() };
    (store.clone(), Sessions::open(store, aiding.clone(), limits), aiding)
}

async fn created(sessions: &Sessions, count: usize) -> Vec<SessionId> {
    let mut ids = Vec::with_capacity(count);
    for _ in 0..count {
        let new = NewSession {
            label: String::new(),
            mode: "fgo".to_owned(),
            profile: "general".to_owned(),
            overrides: BTreeMap::new(),
            base: BaseChoice::None,
            antenna: String::new(),
            retention_days: None,
        };
        ids.push(sessions.create(new).await.expect("the session is created").id);
    }
    ids
}

impl Drive {
    /// Epochs of a session before the crash: from half of the most on, so that states of any age
    /// are restored.
    fn filled(&self, index: usize) -> u64 {
        self.epochs_max - (index as u64 * 37) % (self.epochs_max / 2)
    }
}

/// Pushes an ephemeris at intervals, with times some days later. Never returns.
async fn stream(aiding: &AidingDesk, drive: &Drive) {
    let pause = Duration::from_millis(number("GRAPHFIX_BENCH_STREAM_MS", STREAM_MS));
    let all: Vec<&Ephemeris> = drive.navigation.satellites().flat_map(|(_, list)| list).collect();
    for count in 0.. {
        tokio::time::sleep(pause).await;
        let Ephemeris::Keplerian(mut orbit) = all[count % all.len()].clone() else { continue };
        let later_s = 864_000.0 + 16.0 * count as f64;
        (orbit.toe, orbit.toc) = (orbit.toe + later_s, orbit.toc + later_s);
        let mut brought = Navigation::default();
        brought.insert(Ephemeris::Keplerian(orbit));
        let pushed = aiding.navigation.push(brought, "simulation").await;
        pushed.expect("the ephemeris is stored");
    }
}

/// Pushes epochs of the drive by index; the first has number 1.
async fn push(sessions: &Sessions, drive: &Drive, id: &SessionId, indices: std::ops::Range<u64>) {
    let epoch =
        |index: u64| SequencedEpoch { seq: index + 1, epoch: drive.epochs[index as usize].clone() };
    let submitted = sessions.submit(id, indices.map(epoch).collect()).await;
    let outcomes = submitted.expect("the epochs are committed").outcomes;
    let refusal = outcomes.into_iter().find_map(|outcome| outcome.result.err());
    assert_eq!(refusal, None);
}

/// Runs `run` for each session, this many at the same time.
async fn each<F: Future<Output = ()>>(count: usize, concurrent: usize, run: impl Fn(usize) -> F) {
    futures::stream::iter(0..count).map(run).buffer_unordered(concurrent).collect::<()>().await;
}

/// CPU time of this process.
fn cpu() -> Duration {
    let stat = fs::read_to_string("/proc/self/stat").expect("Linux tells the times of a process");
    let fields = stat.rsplit(')').next().expect("the name ends").split_whitespace();
    let ticks: u64 = fields.skip(11).take(2).map(|ticks| ticks.parse::<u64>().unwrap_or(0)).sum();
    Duration::from_millis(10 * ticks)
}

/// Resident memory of this process (MB).
fn resident_mb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").expect("Linux tells the memory");
    let line = status.lines().find(|line| line.starts_with("VmRSS")).expect("it is resident");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<u64>().ok()).unwrap_or(0) / 1_024
}

/// Where the databases are: the live one, and the one that the crash leaves.
enum Place {
    Folder(TempDir),
    Server(String),
}

const LIVE_DATABASE: &str = "graphfix_bench_live";
const CRASHED_DATABASE: &str = "graphfix_bench_crashed";

impl Place {
    fn of_environment() -> Self {
        match std::env::var("GRAPHFIX_BENCH_POSTGRES") {
            Ok(url) => Self::Server(url),
            Err(_) => Self::Folder(tempfile::tempdir().expect("the folder is writable")),
        }
    }

    fn file(folder: &TempDir, database: &str) -> PathBuf {
        folder.path().join(format!("{database}.db"))
    }

    fn url(&self, database: &str) -> String {
        match self {
            Self::Folder(folder) => format!("sqlite://{}", Self::file(folder, database).display()),
            Self::Server(url) => {
                let (server, _) = url.rsplit_once('/').expect("the URL names a database");
                format!("{server}/{database}")
            }
        }
    }

    /// Makes an empty live database, where databases are made.
    async fn prepare(&self) {
        let drop = |name| format!("DROP DATABASE IF EXISTS {name} WITH (FORCE)");
        let create = format!("CREATE DATABASE {LIVE_DATABASE}");
        self.execute(&[drop(LIVE_DATABASE), drop(CRASHED_DATABASE), create]).await;
    }

    /// Copies the live database as a crash would leave it: on Postgres its connections are broken,
    /// because one that is used cannot be copied.
    async fn crash(&self) {
        if let Self::Folder(folder) = self {
            for suffix in ["", "-wal"] {
                let named = |name| format!("{}{suffix}", Self::file(folder, name).display());
                let copied = fs::copy(named(LIVE_DATABASE), named(CRASHED_DATABASE));
                copied.expect("the files of the database are copied");
            }
        }
        let Self::Server(_) = self else { return };
        let allow =
            |is_allowed| format!("ALTER DATABASE {LIVE_DATABASE} ALLOW_CONNECTIONS {is_allowed}");
        let end = format!(
            "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity \
             WHERE datname = '{LIVE_DATABASE}'"
        );
        let copy = format!("CREATE DATABASE {CRASHED_DATABASE} TEMPLATE {LIVE_DATABASE}");
        self.execute(&[allow(false), end, copy, allow(true)]).await;
        // The desk opens its connections again; this time is not measured.
        tokio::time::sleep(RECONNECTS_WITHIN).await;
    }

    /// Executes statements at the server, if there is one.
    async fn execute(&self, statements: &[String]) {
        let Self::Server(url) = self else { return };
        let mut server = PgConnection::connect(url).await.expect("the server answers");
        for statement in statements {
            let executed = sqlx::query(statement).execute(&mut server);
            executed.await.unwrap_or_else(|error| panic!("{statement}: {error}"));
        }
    }
}

/// Makes the partitions of as many days before today as the environment asks for.
async fn make_days(url: &str) {
    let days = number("GRAPHFIX_BENCH_DAYS", 0);
    if days == 0 || !url.starts_with("postgres") {
        return;
    }
    let mut server = PgConnection::connect(url).await.expect("the server answers");
    for day in 1..=days {
        for (table, unique) in [("epochs", "session, seq"), ("revisions", "session, seq, revision")]
        {
            // Named as those of the service, which finds that they exist.
            let statements = format!(
                "DO $$ DECLARE day DATE := (NOW() AT TIME ZONE 'UTC')::date - {day}; \
                 name TEXT := '{table}_' || TO_CHAR(day, 'YYYYMMDD'); BEGIN \
                 EXECUTE 'CREATE TABLE ' || name || ' (LIKE {table})'; \
                 EXECUTE 'CREATE UNIQUE INDEX ON ' || name || ' ({unique})'; \
                 EXECUTE FORMAT('ALTER TABLE {table} ATTACH PARTITION ' || name \
                 || ' FOR VALUES IN (%L)', day); END $$"
            );
            let made = sqlx::raw_sql(&statements).execute(&mut server).await;
            made.expect("a partition is made");
        }
    }
}

/// All sessions push an epoch at once. Prints when they are answered.
async fn storm(sessions: &Sessions, drive: &Drive, ids: &[SessionId]) {
    let (start, before) = (Instant::now(), cpu());
    let first = |(index, id)| async move {
        let seq = drive.filled(index);
        push(sessions, drive, id, seq..seq + 1).await;
        start.elapsed().as_secs_f64()
    };
    let storm: FuturesUnordered<_> = ids.iter().enumerate().map(first).collect();
    let delays: Vec<f64> = storm.collect().await;
    let at = |fraction: f64| delays[(fraction * (delays.len() - 1) as f64) as usize];
    println!(
        "after the crash: first answers p1 {:.1}, p10 {:.1}, p50 {:.1}, p99 {:.1} s, all {:.1} s; {:.2} ms of CPU a \
         session",
        at(0.01),
        at(0.1),
        at(0.5),
        at(0.99),
        at(1.0),
        1e3 * (cpu() - before).as_secs_f64() / ids.len() as f64,
    );
}

/// Rounds of one epoch for each session, in order. Returns the CPU time of an epoch (µs).
async fn round_robin(sessions: &Sessions, drive: &Drive, ids: &[SessionId], from: u64) -> f64 {
    let (start, before, worst) = (Instant::now(), cpu(), AtomicUsize::new(0));
    for round in from..from + ROUNDS {
        each(ids.len(), CONCURRENT, |index| {
            let (id, worst) = (&ids[index], &worst);
            async move {
                let (seq, start) = (drive.filled(index) + round, Instant::now());
                push(sessions, drive, id, seq..seq + 1).await;
                worst.fetch_max(start.elapsed().as_micros() as usize, Ordering::Relaxed);
            }
        })
        .await;
    }
    let epochs = ROUNDS as f64 * ids.len() as f64;
    let cost_us = 1e6 * (cpu() - before).as_secs_f64() / epochs;
    println!(
        "  {:.0} epochs/s, {cost_us:.0} us of CPU an epoch, longest delay {:.0} ms, {} MB resident",
        epochs / start.elapsed().as_secs_f64(),
        worst.into_inner() as f64 / 1e3,
        resident_mb(),
    );
    cost_us
}

fn main() {
    let count = number("GRAPHFIX_BENCH_SESSIONS", 500) as usize;
    let runtime = tokio::runtime::Runtime::new().expect("a runtime starts");
    runtime.block_on(measure(count));
}

async fn measure(count: usize) {
    let place = Place::of_environment();
    place.prepare().await;
    let drive = Arc::new(drive());
    let observations = drive.epochs[0].observations.len();
    println!("{count} fgo sessions, {observations} observations an epoch");
    let (store, sessions, aiding) = desk(&place.url(LIVE_DATABASE), &drive, count).await;
    make_days(&place.url(LIVE_DATABASE)).await;
    let ids = created(&sessions, count).await;
    let start = Instant::now();
    let filling = each(count, CONCURRENT, |index| {
        let (sessions, drive, id) = (&sessions, &drive, &ids[index]);
        async move {
            let end = drive.filled(index) - drive.live;
            for first in (0..end).step_by(FILLING as usize) {
                push(sessions, drive, id, first..end.min(first + FILLING)).await;
            }
        }
    });
    let filled = async {
        filling.await;
        for left in (1..=drive.live).rev() {
            each(count, CONCURRENT, |index| {
                let (sessions, drive, id) = (&sessions, &drive, &ids[index]);
                let seq = drive.filled(index) - left;
                async move { push(sessions, drive, id, seq..seq + 1).await }
            })
            .await;
        }
    };
    tokio::select! {
        () = filled => {}
        () = stream(&aiding, &drive) => {}
    }
    println!(
        "filled in {:.1} s, with {} pushes of navigation data, {} MB resident",
        start.elapsed().as_secs_f64(),
        aiding.navigation.current().push,
        resident_mb(),
    );
    place.crash().await;

    let start = Instant::now();
    sessions.drain().await;
    println!("stopped with all states dirty in {:.1} s", start.elapsed().as_secs_f64());
    store.close().await;
    drop(sessions);

    let (store, sessions, _) = desk(&place.url(CRASHED_DATABASE), &drive, count).await;
    storm(&sessions, &drive, &ids).await;
    println!("round robin, all fit:");
    let fitting = round_robin(&sessions, &drive, &ids, 1).await;
    sessions.drain().await;
    store.close().await;
    drop(sessions);

    let room = (FITTING * count as f64) as usize;
    let (store, sessions, _) = desk(&place.url(CRASHED_DATABASE), &drive, room).await;
    each(count, CONCURRENT, |index| {
        let (sessions, drive, id) = (&sessions, &drive, &ids[index]);
        let seq = drive.filled(index) + ROUNDS + 1;
        async move { push(sessions, drive, id, seq..seq + 1).await }
    })
    .await;
    println!("round robin, {room} fit:");
    let cost = round_robin(&sessions, &drive, &ids, ROUNDS + 2).await;
    println!("  {:.2} times the cost", cost / fitting);
    sessions.drain().await;
    store.close().await;
    let drop = |name| format!("DROP DATABASE {name} WITH (FORCE)");
    place.execute(&[drop(LIVE_DATABASE), drop(CRASHED_DATABASE)]).await;
}
