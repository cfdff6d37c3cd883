//! The queries of a history over many stored solutions: on SQLite in a temporary folder, or on the
//! Postgres server that `GRAPHFIX_BENCH_DATABASE` names, in a database of its own that is dropped
//! at the end. Times are those of the desk, without messages and JSON.
//!
//! Devices send an epoch a second for some minutes of each of 30 days, and one device for a whole
//! day. Their rows are written by SQL: copies of one simulated epoch with its solution, at other
//! times. The epoch is small, of GPS and one band, so that fifty million fit on a disk. Only the
//! last of the timed queries reads these rows. On Postgres they are in partitions of days, as the
//! service makes them.
//!
//! `GRAPHFIX_BENCH_SESSIONS=10000 GRAPHFIX_BENCH_SOLUTIONS=5000000 cargo bench --bench history`

use std::collections::BTreeMap;
use std::env;
use std::future::Future;
use std::panic::{AssertUnwindSafe, resume_unwind};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use futures::{FutureExt, StreamExt};
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{Constellation, GpsTime, LeapSeconds};
use graphfix::session::{
    HistoryQuery, NewSession, SequencedEpoch, SeriesQuery, SessionId, SessionLimits, Sessions,
};
use graphfix::simulation::{Scenario, Simulator};
use graphfix::store::{BaseChoice, Bounds, Revisions, SessionFilter, Store};
use sqlx::postgres::PgConnectOptions;
use sqlx::{ConnectOptions, Connection, PgConnection, SqliteConnection};

const DAYS: i64 = 30;
const DAY_S: i64 = 86_400;
const HOUR_S: i64 = 3_600;
const REPEATS: usize = 5;
/// Numbers of the epochs that are written by SQL begin after those of the template.
const FIRST: i64 = 1_000;
/// Sessions that are created at the same time.
const CONCURRENT: usize = 16;

/// The most that a query may take (ms).
const HEADS_MS: u128 = 200;
const DAY_MS: u128 = 200;
const FLEET_MS: u128 = 500;
const AREA_MS: u128 = 200;

fn number(name: &str, standard: i64) -> i64 {
    env::var(name).map_or(standard, |text| text.parse().expect("a number"))
}

fn main() {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime starts");
    let slow = runtime.block_on(async {
        let Ok(server) = env::var("GRAPHFIX_BENCH_DATABASE") else {
            let folder = tempfile::tempdir().expect("the temporary folder is writable");
            return measure(format!("sqlite://{}", folder.path().join("history.db").display()))
                .await;
        };
        let options: PgConnectOptions = server.parse().expect("the URL of a server");
        let name = format!("graphfix_history_{}", std::process::id());
        let url = options.clone().database(&name).to_url_lossy().to_string();
        let mut connection = options.connect().await.expect("the server answers");
        execute(&mut connection, &format!("CREATE DATABASE {name}")).await;
        // The database is dropped even after a panic.
        let slow = AssertUnwindSafe(measure(url)).catch_unwind().await;
        execute(&mut connection, &format!("DROP DATABASE {name} WITH (FORCE)")).await;
        slow.unwrap_or_else(|panic| resume_unwind(panic))
    });
    assert!(slow.is_empty(), "too slow: {}", slow.join(", "));
}

async fn execute(connection: &mut PgConnection, sql: &str) {
    sqlx::raw_sql(sql).execute(connection).await.unwrap_or_else(|error| panic!("{sql}: {error}"));
}

/// What is measured.
struct Fleet {
    sessions: Sessions,
    /// The device that works for a whole day, the last one.
    whole_day: SessionId,
    /// The present, at a whole hour of GPS time (s).
    end_s: i64,
}

/// Fills a database and measures. Returns the names of the queries that are too slow.
async fn measure(url: String) -> Vec<&'static str> {
    let devices = number("GRAPHFIX_BENCH_SESSIONS", 1_000);
    let solutions = number("GRAPHFIX_BENCH_SOLUTIONS", 300_000);
    let per_day = (solutions / devices / DAYS).clamp(1, HOUR_S);
    let store = Store::open(&url).await.expect("the database opens");
    println!("{devices} devices, {per_day} epochs on each of {DAYS} days, {store:?}");
    let begun = Instant::now();
    let fleet = created(&store, devices).await;
    let statements = statements(&url, &fleet, devices, per_day);
    let count = if url.starts_with("sqlite") {
        let mut connection = SqliteConnection::connect(&url).await.expect("the file opens");
        for sql in &statements {
            let done = sqlx::raw_sql(sql).execute(&mut connection).await;
            done.unwrap_or_else(|error| panic!("{sql}: {error}"));
        }
        sqlx::query_scalar("SELECT COUNT(*) FROM epochs").fetch_one(&mut connection).await
    } else {
        let mut connection = PgConnection::connect(&url).await.expect("the server answers");
        for sql in &statements {
            execute(&mut connection, sql).await;
        }
        sqlx::query_scalar("SELECT COUNT(*) FROM epochs").fetch_one(&mut connection).await
    };
    let count: i64 = count.expect("the rows are counted");
    println!("{count} solutions, written in {:.0} s", begun.elapsed().as_secs_f64());
    let slow = queries(&fleet, devices as usize).await;
    fleet.sessions.drain().await;
    store.close().await;
    slow
}

/// Sessions, of which the first has stored the template.
async fn created(store: &Store, devices: i64) -> Fleet {
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await;
    let aiding = aiding.expect("navigation data are read");
    let sessions = Sessions::open(store.clone(), aiding.clone(), SessionLimits::service());
    let scenario = Scenario {
        duration_s: 30.0,
        constellations: vec![Constellation::Gps],
        frequencies: 1,
        ..Scenario::open_sky()
    };
    let receiver = Simulator::new(Scenario { base: None, ..scenario }, 1);
    let pushed = aiding.navigation.push((**receiver.navigation()).clone(), "simulation").await;
    pushed.expect("navigation data are stored");
    let create = || async {
        let new = NewSession {
            label: String::new(),
            mode: "fgo".to_owned(),
            profile: "general".to_owned(),
            overrides: BTreeMap::new(),
            base: BaseChoice::None,
            antenna: String::new(),
            retention_days: None,
        };
        sessions.create(new).await.expect("the session is created").id
    };
    let whole_day = create().await;
    let numbered = (1..).zip(receiver);
    let epochs = numbered.map(|(seq, epoch)| SequencedEpoch { seq, epoch: epoch.rover }).collect();
    let submitted = sessions.submit(&whole_day, epochs).await.expect("the epochs are committed");
    assert!(submitted.outcomes.iter().all(|outcome| outcome.result.is_ok()));
    let others = futures::stream::iter(1..devices).map(|_| create());
    others.buffer_unordered(CONCURRENT).collect::<Vec<_>>().await;
    let now_ms =
        SystemTime::now().duration_since(UNIX_EPOCH).expect("it is after 1970").as_millis();
    let now = GpsTime::from_unix_ms(now_ms as i64, &LeapSeconds::table());
    let end_s = now.as_ns() / 1_000_000_000 / HOUR_S * HOUR_S;
    Fleet { sessions, whole_day, end_s }
}

/// The statements that fill the database.
///
/// Device `k` is at 45° + (k mod 100)/100° north and (k div 100)/100° east, on the sphere of the
/// equator's radius. Its distance from the ellipsoid does not matter here.
fn statements(url: &str, fleet: &Fleet, devices: i64, per_day: i64) -> Vec<String> {
    let is_sqlite = url.starts_with("sqlite");
    let begin_s = fleet.end_s - DAYS * DAY_S;
    let mut places = Vec::new();
    for k in 0..devices {
        let (latitude, longitude) = place(k);
        let (north, east) = (latitude.to_radians(), longitude.to_radians());
        let (x, y) = (north.cos() * east.cos(), north.cos() * east.sin());
        let (x, y, z) = (6_378_137.0 * x, 6_378_137.0 * y, 6_378_137.0 * north.sin());
        places.push(format!("({k},{latitude},{longitude},{x},{y},{z})"));
    }
    let real = if is_sqlite { "REAL" } else { "DOUBLE PRECISION" };
    let mut all = vec![format!(
        "CREATE TABLE bench_places (k BIGINT PRIMARY KEY, latitude {real}, longitude {real}, \
         x {real}, y {real}, z {real})"
    )];
    for rows in places.chunks(500) {
        all.push(format!("INSERT INTO bench_places VALUES {}", rows.join(",")));
    }
    all.push(
        "CREATE TABLE bench_devices AS SELECT s.key AS session, p.k AS k, p.latitude AS latitude, \
         p.longitude AS longitude FROM (SELECT key, ROW_NUMBER() OVER (ORDER BY key) - 1 AS k \
         FROM sessions) s JOIN bench_places p ON p.k = s.k"
            .to_owned(),
    );
    all.push("CREATE TABLE bench_numbers (i INTEGER PRIMARY KEY)".to_owned());
    all.push(format!(
        "INSERT INTO bench_numbers WITH RECURSIVE n(i) AS \
         (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i + 1 < {DAY_S}) SELECT i FROM n"
    ));
    all.push("CREATE TABLE bench_template AS SELECT * FROM epochs WHERE seq = 30".to_owned());
    for day in 0..DAYS {
        if !is_sqlite {
            all.extend(partitions(day));
        }
        // Each device has an hour of its own.
        let at = format!("{begin_s} + {day} * {DAY_S} + (d.k % 24) * {HOUR_S} + n.i");
        let seq = format!("{FIRST} + {day} * {per_day} + n.i");
        all.push(epochs(is_sqlite, day, &at, &seq, &format!("d.k > 0 AND n.i < {per_day}")));
    }
    let last_day = fleet.end_s - DAY_S;
    let (at, seq) = (format!("{last_day} + n.i"), format!("{FIRST} + n.i"));
    all.push(epochs(is_sqlite, DAYS - 1, &at, &seq, "d.k = 0"));
    all.extend([60, HOUR_S].map(rollups));
    all.push(FLEET_HOURS.to_owned());
    all.push(HEADS.to_owned());
    all.push(if is_sqlite { "ANALYZE".to_owned() } else { "VACUUM ANALYZE".to_owned() });
    all
}

/// Latitude and longitude of a device (degrees).
fn place(k: i64) -> (f64, f64) {
    (45.0 + (k % 100) as f64 / 100.0, (k / 100) as f64 / 100.0)
}

/// The partitions of a day, as the service makes them. The dates are made up.
fn partitions(day: i64) -> Vec<String> {
    let date = format!("DATE '2026-01-01' + {day}");
    let name = format!("epochs_bench_{day}");
    vec![
        format!("CREATE TABLE {name} (LIKE epochs)"),
        format!("CREATE UNIQUE INDEX ON {name} (session, seq)"),
        format!(
            "DO $$ BEGIN EXECUTE FORMAT('ALTER TABLE epochs ATTACH PARTITION {name} \
             FOR VALUES IN (%L)', {date}); END $$"
        ),
    ]
}

/// Copies the template to the times and numbers of devices `d`, with numbers `n`.
fn epochs(is_sqlite: bool, day: i64, at: &str, seq: &str, condition: &str) -> String {
    let columns = "navigation, origin, status, x_m, y_m, z_m, sigma_east_mm, sigma_north_mm, \
                   sigma_up_mm, ratio, base_age_ms, content, solution";
    let of_template: Vec<String> =
        columns.split(", ").map(|column| format!("t.{}", column.trim())).collect();
    let (name, value) = match is_sqlite {
        true => ("", String::new()),
        false => (", day", format!(", DATE '2026-01-01' + {day}")),
    };
    format!(
        "INSERT INTO epochs (session, seq, gps_time_ns, {columns}{name}) SELECT d.session, {seq}, \
         CAST({at} AS BIGINT) * 1000000000, {}{value} FROM bench_devices d CROSS JOIN bench_numbers n \
         CROSS JOIN bench_template t WHERE {condition}",
        of_template.join(", ")
    )
}

/// The rollups of the epochs, in buckets of this length.
fn rollups(length_s: i64) -> String {
    format!(
        "INSERT INTO rollups SELECT e.session, {length_s}, \
         e.gps_time_ns / 1000000000 / {length_s} * {length_s}, 20000, MIN(e.gps_time_ns), \
         MAX(e.gps_time_ns), MAX(e.seq), 0, 0, 0, COUNT(*), 0, 0, 20, MAX(d.latitude), \
         MAX(d.longitude), COUNT(*), 0, MAX(d.latitude), MAX(d.longitude), MAX(d.latitude), \
         MAX(d.longitude), 100, 110, 105.0 * COUNT(*), 105, 0.5, 2, 1.0 * COUNT(*), 1, 7, 12, \
         9.0 * COUNT(*), 9, NULL, NULL, 0, NULL \
         FROM epochs e JOIN bench_devices d ON d.session = e.session WHERE {FIRST} <= e.seq \
         GROUP BY e.session, e.gps_time_ns / 1000000000 / {length_s} * {length_s}"
    )
}

const FLEET_HOURS: &str = "INSERT INTO fleet_hours SELECT s.tenant, r.begin_s, 20000, COUNT(*), \
    0, 0, 0, SUM(r.n_fgo), 0, 0, SUM(r.positions), 0, SUM(r.sigma_sum_m), SUM(r.satellites_sum), 0 \
    FROM rollups r JOIN sessions s ON s.key = r.session WHERE r.seconds = 3600 \
    AND r.day = 20000 GROUP BY s.tenant, r.begin_s";
const HEADS: &str = "UPDATE session_heads SET last_seq = b.seq, last_gps_time_ns = b.ns, \
    status = 20, x_m = p.x, y_m = p.y, z_m = p.z FROM (SELECT session, MAX(last_seq) AS seq, \
    MAX(last_time_ns) AS ns FROM rollups WHERE seconds = 3600 GROUP BY session) b \
    JOIN bench_devices d ON d.session = b.session JOIN bench_places p ON p.k = d.k \
    WHERE session_heads.session = b.session";

/// Times a query: the first run, and the median of those after it. Returns whether that is within
/// the limit.
async fn timed<F: Future<Output = usize>>(
    name: &'static str,
    limit_ms: u128,
    mut query: impl FnMut() -> F,
) -> Option<&'static str> {
    let mut times = Vec::new();
    let mut items = 0;
    for _ in 0..=REPEATS {
        let begun = Instant::now();
        items = query().await;
        times.push(begun.elapsed());
    }
    let first = times.remove(0);
    times.sort();
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let median = times[REPEATS / 2];
    let limit =
        if limit_ms == u128::MAX { "no limit".to_owned() } else { format!("limit {limit_ms} ms") };
    println!(
        "{name:<44} first {:>7.1} ms, median {:>7.1} ms, {limit}, {items} items",
        ms(first),
        ms(median),
    );
    (limit_ms < median.as_millis()).then_some(name)
}

async fn queries(fleet: &Fleet, devices: usize) -> Vec<&'static str> {
    let Fleet { sessions, whole_day, end_s } = fleet;
    let at = |seconds: i64| Some(GpsTime::from_ns(seconds * 1_000_000_000));
    let (page, all) = (devices.min(10_000), SessionFilter::default());
    let latest = timed("latest position of each session", HEADS_MS, || async {
        sessions.heads(&all, None, page, None).await.expect("heads are read").0.items.len()
    });
    let day = HistoryQuery { from: at(end_s - DAY_S), to: at(end_s - 1), points: 2_000 };
    let thinned = timed("a day of a session in 2000 points", DAY_MS, || async {
        let history = sessions.history(whole_day, &day).await.expect("the history is read");
        assert_eq!(history.statuses.total(), DAY_S as u64);
        history.rollups.len()
    });
    let month = HistoryQuery { from: at(end_s - DAYS * DAY_S), to: at(end_s - 1), points: 1_000 };
    let status = timed("status of the fleet over 30 days", FLEET_MS, || async {
        let history = sessions.fleet_history(&month).await.expect("the history is read");
        assert!(devices as u64 <= history.statuses.total());
        history.hours.len()
    });
    // A tenth of the width of the places and all of their height.
    let east_deg = place(devices as i64 / 10).1;
    let area = Bounds { south_deg: 44.0, west_deg: -0.001, north_deg: 47.0, east_deg };
    let present = timed("sessions in an area now", AREA_MS, || async {
        let page = sessions.heads(&all, Some(&area), 10_000, None).await;
        page.expect("heads are read").0.items.len()
    });
    let past = timed("sessions in an area on a day, all pages", AREA_MS, || async {
        let (mut found, mut token) = (0, None::<String>);
        loop {
            let span = (day.from, day.to);
            let filter = SessionFilter::default();
            let page =
                sessions.session_histories(filter, span, Some(area), 1_000, token.as_deref());
            let page = page.await.expect("the history is read");
            found += page.items.len();
            token = page.next_page_token;
            if token.is_none() {
                return found;
            }
        }
    });
    let mut slow = Vec::new();
    slow.extend(latest.await);
    slow.extend(thinned.await);
    slow.extend(status.await);
    slow.extend(present.await);
    slow.extend(past.await);
    // The same from the solutions, without rollups. This is for comparison and has no limit.
    timed("the same day from its solutions (series)", u128::MAX, || async {
        let query = SeriesQuery {
            from: day.from,
            to: day.to,
            points: 2_000,
            revisions: Revisions::First,
            page_token: None,
        };
        sessions.series(whole_day, &query).await.expect("the series is read").intervals.len()
    })
    .await;
    slow
}
