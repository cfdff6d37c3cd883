//! Bytes on the disk while devices send an epoch a minute for a month of injected time, with a
//! retention. The size must stay constant. The database is on SQLite in a temporary folder, or the
//! Postgres database that `GRAPHFIX_BENCH_DATABASE` names, for this benchmark alone.
//!
//! `GRAPHFIX_BENCH_DEVICES=100 GRAPHFIX_BENCH_DAYS=30 cargo bench --bench retention`

use std::collections::BTreeMap;
use std::env;
use std::path::Path;

use futures::StreamExt;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::clock::Clock;
use graphfix::gnss::{
    Constellation, Cycles, Epoch, GpsTime, Observation, ObservationCode, SatelliteId,
};
use graphfix::session::{NewSession, SequencedEpoch, SessionId, SessionLimits, Sessions};
use graphfix::store::{BaseChoice, Store};
use sqlx::{Connection, PgConnection};

/// Retention (days). Up to three more days are kept: back to a snapshot of the previous day, and on
/// Postgres to the beginning of a day.
const RETENTION: u32 = 7;
const MARGIN: u64 = 4;
const PER_DAY: u64 = 1_440;
const PUSHES_PER_DAY: u64 = 4;
const MS_PER_DAY: i64 = 86_400_000;
/// 2026-01-01 12:00 UTC.
const START: i64 = 1_767_268_800_000;
/// A day before, in GPS time: week, and seconds of week. The epochs of a day end when they arrive.
const FIRST: (i32, f64) = (2_399, 302_400.0);
const CONCURRENT: usize = 16;
/// Largest ratio of a size to the first full size that counts as constant.
const GROWTH_MAX: f64 = 1.1;

fn number(name: &str, standard: u64) -> u64 {
    env::var(name).map_or(standard, |text| text.parse().expect("a number"))
}

fn main() {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime starts");
    let devices = number("GRAPHFIX_BENCH_DEVICES", 5);
    let days = number("GRAPHFIX_BENCH_DAYS", 16);
    runtime.block_on(measure(devices, days));
}

async fn measure(devices: u64, days: u64) {
    let folder = tempfile::tempdir().expect("the temporary folder is writable");
    let file = folder.path().join("retention.db");
    let url = env::var("GRAPHFIX_BENCH_DATABASE")
        .unwrap_or_else(|_| format!("sqlite://{}", file.display()));
    let store = Store::open(&url).await.expect("the database opens");
    println!("{devices} devices, {PER_DAY} epochs a day, retention {RETENTION} days, {store:?}");
    let (sessions, clock) = desk(&store).await;
    let mut ids = Vec::new();
    for _ in 0..devices {
        ids.push(created(&sessions).await);
    }
    let mut sizes = Vec::new();
    for day in 0..days {
        clock.set(START + day as i64 * MS_PER_DAY);
        let live = |id| live_a_day(&sessions, id, day);
        futures::stream::iter(&ids).map(live).buffer_unordered(CONCURRENT).collect::<()>().await;
        sessions.remove_expired().await.expect("old epochs are removed");
        sizes.push(size(&url, &file).await);
        println!("day {day:>3}: {:>7.1} MB", sizes[day as usize] as f64 / 1e6);
    }
    sessions.drain().await;
    store.close().await;
    let full = (u64::from(RETENTION) + MARGIN) as usize;
    let (first, last) = (sizes.get(full).expect("enough days"), sizes.last().expect("a day"));
    let growth = *last as f64 / *first as f64;
    println!("from day {full} on {growth:.2} times as large");
    assert!(growth < GROWTH_MAX, "it grows");
}

async fn desk(store: &Store) -> (Sessions, Clock) {
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await;
    let aiding = aiding.expect("navigation data are read");
    let (limits, clock) = (SessionLimits::service(), Clock::at(START));
    let limits = SessionLimits { retention_days: RETENTION, ..limits };
    (Sessions::open_at(store.clone(), aiding, limits, clock.clone()), clock)
}

async fn created(sessions: &Sessions) -> SessionId {
    let new = NewSession {
        label: String::new(),
        mode: "spp".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        base: BaseChoice::None,
        antenna: String::new(),
        retention_days: None,
    };
    sessions.create(new).await.expect("the session is created").id
}

async fn live_a_day(sessions: &Sessions, id: &SessionId, day: u64) {
    let seqs: Vec<u64> = (day * PER_DAY + 1..=(day + 1) * PER_DAY).collect();
    for seqs in seqs.chunks((PER_DAY / PUSHES_PER_DAY) as usize) {
        let epochs = seqs.iter().map(|seq| SequencedEpoch { seq: *seq, epoch: epoch(*seq) });
        let submitted = sessions.submit(id, epochs.collect()).await;
        let outcomes = submitted.expect("the epochs are committed").outcomes;
        assert!(outcomes.iter().all(|outcome| outcome.result.is_ok()));
    }
}

/// Ten satellites with two signals each, a minute after the epoch before.
fn epoch(seq: u64) -> Epoch {
    let (week, seconds) = FIRST;
    let mut epoch = Epoch::new(GpsTime::from_week_seconds(week, seconds + 60.0 * seq as f64));
    for number in 1..=10 {
        let satellite = SatelliteId { constellation: Constellation::Gps, number };
        for code in ["1C", "2W"] {
            let code = ObservationCode::parse(code).expect("the code is one");
            let count = f64::from(number) + 60.0 * seq as f64;
            epoch.observations.push(Observation {
                pseudorange_m: Some(((22e6 + 613.2 * count) * 1e3).round() / 1e3),
                carrier_phase: Some(Cycles(((115e6 + 3_213.7 * count) * 1e3).round() / 1e3)),
                doppler_hz: Some(-1_200.5),
                cn0_db_hz: Some(44.25),
                ..Observation::empty(satellite, code)
            });
        }
    }
    epoch
}

/// Bytes of the files of the database.
async fn size(url: &str, file: &Path) -> u64 {
    if url.starts_with("sqlite") {
        let length = |file: String| std::fs::metadata(file).map_or(0, |file| file.len());
        let named = file.display().to_string();
        return length(named.clone()) + length(format!("{named}-wal"));
    }
    let mut connection = PgConnection::connect(url).await.expect("the server answers");
    let size = sqlx::query_scalar("SELECT pg_database_size(current_database())");
    let size: i64 = size.fetch_one(&mut connection).await.expect("the server tells sizes");
    size as u64
}
