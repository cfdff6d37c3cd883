//! The store and the navigation broker, on both databases.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use graphfix::aiding::{AidingLimits, NavigationBroker};
use graphfix::gnss::{
    Ephemeris, Epoch, GpsTime, GroupDelays, KeplerianEphemeris, KlobucharCoefficients, LeapSeconds,
    Navigation, NavigationMessage, NeQuickCoefficients, Solution, Status,
};
use graphfix::store::{
    Arrival, BaseChoice, Batch, EncodedEpoch, EncodedSnapshot, Page, Revisions, SessionKey,
    SessionSettings, SolutionQuery, Store, StoreError, StoredSolution,
};
use graphfix::tenant::Tenant;

use crate::support::database::{Database, on_both_databases, whole_session};

on_both_databases!(
    solutions_come_in_pages,
    a_span_of_time_includes_its_ends,
    solutions_are_chosen_by_status_and_revision,
    a_batch_is_stored_whole_or_not_at_all,
    one_contradiction_fails_alone,
    large_batches_of_any_size_are_stored,
    states_of_one_transaction_are_stored,
    a_newer_schema_is_refused,
    a_schema_that_cannot_be_migrated_is_refused,
    navigation_survives_a_restart,
    old_ephemerides_make_room,
    an_upload_gets_the_room_that_is_left,
    coverage_is_told,
);

async fn session(store: &Store, id: &str) -> SessionKey {
    let settings = SessionSettings {
        label: String::new(),
        mode: "spp".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        configuration: BTreeMap::new(),
        configuration_hash: "c0ffee".into(),
        base: BaseChoice::None,
        antenna: None,
        retention_days: None,
    };
    store.create_session(&Tenant::operator(), id, &settings, 0).await.unwrap().key
}

fn time(second: u64) -> GpsTime {
    GpsTime::from_week_seconds(2051, second as f64)
}

/// The first epochs of a session. Their numbers are their seconds. They have no observations, and
/// their answers have no position.
fn batch(session: SessionKey, seqs: impl IntoIterator<Item = u64>) -> Batch {
    batch_after(None, session, seqs)
}

/// The same after number `previous`.
fn batch_after(
    previous: Option<u64>,
    session: SessionKey,
    seqs: impl IntoIterator<Item = u64>,
) -> Batch {
    let row = |seq| {
        let solution = StoredSolution {
            seq,
            revision: 0,
            solution: Solution::none(time(seq), vec![]),
            version: "0.1.0".into(),
            configuration_hash: "c0ffee".into(),
        };
        EncodedEpoch::new(Arc::new(Epoch::new(time(seq))), &solution, 0, None, None)
    };
    Batch { epochs: seqs.into_iter().map(row).collect(), ..Batch::new(session, previous) }
}

fn numbers(page: &Page<StoredSolution>) -> Vec<(u64, u32)> {
    page.items.iter().map(|solution| (solution.seq, solution.revision)).collect()
}

async fn stored(store: &Store, session: SessionKey, query: &SolutionQuery) -> Vec<(u64, u32)> {
    let page = store.solutions(session, query).await.unwrap();
    assert_eq!(page.next_page_token, None);
    numbers(&page)
}

async fn solutions_come_in_pages(database: Database) {
    let store = database.store().await;
    let key = session(&store, "one").await;
    let other = session(&store, "other").await;
    store.commit(batch(key, 1..=7)).await.unwrap();
    store.commit(batch(other, 3..=5)).await.unwrap();
    let mut query = SolutionQuery { page_size: 3, ..whole_session() };
    let mut pages = Vec::new();
    loop {
        let page = store.solutions(key, &query).await.unwrap();
        pages.push(page.items.iter().map(|solution| solution.seq).collect::<Vec<_>>());
        query.page_token = page.next_page_token;
        if query.page_token.is_none() {
            break;
        }
    }
    assert_eq!(pages, [vec![1, 2, 3], vec![4, 5, 6], vec![7]]);
    for token in ["", "7", "x.0", "-1.0", "1.0.0"] {
        let query = SolutionQuery { page_token: Some(token.to_owned()), ..query.clone() };
        let error = store.solutions(key, &query).await.unwrap_err();
        assert_eq!(error.code().name(), "PAGE_TOKEN_INVALID", "{token}");
    }
    for page_size in [0, 10_001] {
        let query = SolutionQuery { page_size, ..query.clone() };
        let error = store.solutions(key, &query).await.unwrap_err();
        assert!(matches!(error, StoreError::PageSize { limit: 10_000, .. }), "{error}");
    }
}

async fn a_span_of_time_includes_its_ends(database: Database) {
    let store = database.store().await;
    let key = session(&store, "one").await;
    store.commit(batch(key, [10, 20, 30, 40])).await.unwrap();
    let between = async |from: Option<u64>, to: Option<u64>| {
        let query = SolutionQuery { from: from.map(time), to: to.map(time), ..whole_session() };
        stored(&store, key, &query).await.into_iter().map(|(seq, _)| seq).collect::<Vec<_>>()
    };
    assert_eq!(between(Some(20), Some(30)).await, [20, 30]);
    assert_eq!(between(Some(11), None).await, [20, 30, 40]);
    assert_eq!(between(None, Some(29)).await, [10, 20]);
    assert!(between(Some(41), None).await.is_empty());
    assert!(between(None, Some(9)).await.is_empty());
    assert!(between(Some(21), Some(29)).await.is_empty());
}

async fn solutions_are_chosen_by_status_and_revision(database: Database) {
    let store = database.store().await;
    let key = session(&store, "one").await;
    store.commit(batch(key, 1..=4)).await.unwrap();
    let smoothed = "INSERT INTO revisions (session, seq, revision, gps_time_ns, status, content, \
                    origin) SELECT session, seq, 1, gps_time_ns, status, solution, origin \
                    FROM epochs WHERE seq IN (2, 3)";
    database.execute(smoothed).await;
    for table in ["epochs", "revisions"] {
        database.execute(&format!("UPDATE {table} SET status = 10 WHERE seq = 3")).await;
    }
    let of = async |revisions, status, token: Option<&str>| {
        let page_token = token.map(str::to_owned);
        stored(&store, key, &SolutionQuery { revisions, status, page_token, ..whole_session() })
            .await
    };
    assert_eq!(of(Revisions::First, None, None).await, [(1, 0), (2, 0), (3, 0), (4, 0)]);
    assert_eq!(of(Revisions::Last, None, None).await, [(1, 0), (2, 1), (3, 1), (4, 0)]);
    let all = [(1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (4, 0)];
    assert_eq!(of(Revisions::All, None, None).await, all);
    assert_eq!(of(Revisions::All, None, Some("2.0")).await, all[2..]);
    assert_eq!(of(Revisions::All, Some(Status::Single), None).await, [(3, 0), (3, 1)]);
    assert_eq!(of(Revisions::Last, Some(Status::None), None).await, [(1, 0), (2, 1), (4, 0)]);
}

async fn a_batch_is_stored_whole_or_not_at_all(database: Database) {
    let store = database.store().await;
    let key = session(&store, "one").await;
    store.commit(batch(key, [5])).await.unwrap();
    let error = store.commit(batch(key, 1..=300)).await.unwrap_err();
    assert!(matches!(error, StoreError::AlreadyStored), "{error}");
    assert_eq!(stored(&store, key, &whole_session()).await, [(5, 0)]);
    assert_eq!(store.epochs(key, &[4, 5, 6]).await.unwrap().len(), 1);
}

/// The batches are in one transaction, because they are passed before the committer runs.
async fn one_contradiction_fails_alone(database: Database) {
    let store = database.store().await;
    let (one, other) = (session(&store, "one").await, session(&store, "other").await);
    store.commit(batch(one, 1..=3)).await.unwrap();
    let (before, contradiction, after) = tokio::join!(
        store.commit(batch(other, 1..=3)),
        store.commit(batch(one, 3..=4)),
        store.commit(batch_after(Some(3), other, 4..=5)),
    );
    assert!(before.is_ok() && after.is_ok());
    assert!(matches!(contradiction, Err(StoreError::AlreadyStored)));
    assert_eq!(stored(&store, one, &whole_session()).await, [(1, 0), (2, 0), (3, 0)]);
    assert_eq!(stored(&store, other, &whole_session()).await.len(), 5);
}

async fn large_batches_of_any_size_are_stored(database: Database) {
    let store = database.store().await;
    let key = session(&store, "one").await;
    let mut first = 0;
    for size in [1, 7, 8, 127, 128, 1_024, 3_001] {
        let previous = u64::checked_sub(first, 1);
        store.commit(batch_after(previous, key, first..first + size)).await.unwrap();
        first += size;
    }
    let rows = stored(&store, key, &whole_session()).await;
    assert_eq!(rows, (0..first).map(|seq| (seq, 0)).collect::<Vec<_>>());
    let last = store.last_epochs(key, 1).await.unwrap().pop().unwrap();
    assert_eq!(last.epoch, Epoch::new(time(first - 1)));
}

/// Of the states that a transaction has of a session the newest is stored, and the first of a day is
/// kept. The first batch has a transaction of its own, and those that wait meanwhile share the next.
async fn states_of_one_transaction_are_stored(database: Database) {
    let store = database.store().await;
    let [alone, one, other] = [
        session(&store, "alone").await,
        session(&store, "one").await,
        session(&store, "other").await,
    ];
    let state = |session, seq: u64, day, keeps_snapshot| {
        let content = seq.to_be_bytes().to_vec();
        let snapshot = EncodedSnapshot::new(seq, "c0ffee".into(), content, Some(day));
        let arrival = Some(Arrival::on(day, 7));
        Batch { snapshot: Some(snapshot), arrival, keeps_snapshot, ..Batch::new(session, None) }
    };
    let batches = [
        state(alone, 1, 20_000, false),
        state(one, 5, 20_000, true),
        state(other, 3, 20_000, true),
        state(one, 9, 20_000, true),
        state(one, 7, 20_001, true),
        state(other, 4, 20_000, false),
    ];
    let committed =
        futures::future::join_all(batches.into_iter().map(|batch| store.commit(batch))).await;
    committed.into_iter().for_each(|committed| committed.unwrap());
    for (session, newest) in [(alone, 1_u64), (one, 9), (other, 4)] {
        let stored = store.snapshot(session).await.unwrap().unwrap();
        assert_eq!((stored.seq, stored.content), (newest, newest.to_be_bytes().to_vec()));
    }
    let kept = [(5, 20_000), (3, 20_000), (7, 20_001)];
    assert_eq!(database.count("kept_snapshots").await, kept.len() as i64);
    for (seq, day) in kept {
        let row = format!("kept_snapshots WHERE seq = {seq} AND day = {day}");
        assert_eq!(database.count(&row).await, 1, "{row}");
    }
}

async fn a_newer_schema_is_refused(database: Database) {
    database.store().await.close().await;
    let later = "INSERT INTO _sqlx_migrations SELECT 9000, description, installed_on, success, \
                 checksum, execution_time FROM _sqlx_migrations WHERE version = 1";
    database.execute(later).await;
    let error = Store::open(&database.url).await.unwrap_err();
    let known = newest_migration(&database);
    assert_eq!(
        error.to_string(),
        format!("the database has schema 9000, this Graphfix knows schemas up to {known}")
    );
    assert_eq!(error.code().name(), "DATABASE_SCHEMA_NEWER");
}

/// The number with which the name of the newest migration begins.
fn newest_migration(database: &Database) -> u32 {
    let (store, _) = database.url.split_once(':').unwrap();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("migrations").join(store);
    let names = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
    let number = |name: OsString| name.to_str().unwrap()[..4].parse().unwrap();
    names.map(number).max().unwrap()
}

/// If the list of migrations is lost, the schema is unknown.
async fn a_schema_that_cannot_be_migrated_is_refused(database: Database) {
    database.store().await.close().await;
    database.execute("DELETE FROM _sqlx_migrations").await;
    let error = Store::open(&database.url).await.unwrap_err();
    assert_eq!(error.code().name(), "DATABASE_MIGRATION_FAILED", "{error}");
}

#[tokio::test]
async fn urls_of_other_kinds_are_refused() {
    for url in
        ["mysql://x/y", "graphfix.db", "sqlite://", "sqlite://:memory:", "sqlite://a?mode=memory"]
    {
        let error = Store::open(url).await.unwrap_err();
        assert_eq!(error.code().name(), "DATABASE_URL_INVALID", "{url}: {error}");
    }
    let error = Store::open("sqlite:///no/such/folder/graphfix.db").await.unwrap_err();
    assert_eq!(error.code().name(), "DATABASE_FAILED", "{error}");
}

fn ephemeris(satellite: &str, toe: u64, health: u32) -> Ephemeris {
    Ephemeris::Keplerian(KeplerianEphemeris {
        satellite: satellite.parse().unwrap(),
        message: NavigationMessage::Lnav,
        toc: time(toe),
        toe: time(toe),
        transmission_time: Some(time(toe) - 7_200.0),
        af0_s: 1.1e-4,
        af1: -3.3e-12,
        af2_per_s: 0.0,
        iode: 45,
        iodc: 45,
        sqrt_a: 5_153.7,
        a_dot_m_s: 0.0,
        eccentricity: 0.01,
        m0_rad: 0.1,
        delta_n_rad_s: 4.5e-9,
        delta_n_dot_rad_s2: 0.0,
        omega_rad: -1.7,
        omega0_rad: 2.2,
        omega_dot_rad_s: -8.1e-9,
        i0_rad: 0.96,
        idot_rad_s: 1e-10,
        cuc_rad: 1e-6,
        cus_rad: 2e-6,
        crc_m: 200.0,
        crs_m: -30.0,
        cic_rad: 1e-7,
        cis_rad: -1e-7,
        accuracy_m: Some(2.0),
        health,
        fit_interval_h: Some(4.0),
        group_delays: GroupDelays::Gps {
            tgd_s: -1e-8,
            isc_l1ca_s: None,
            isc_l2c_s: None,
            isc_l5i_s: None,
            isc_l5q_s: None,
            isc_l1cd_s: None,
            isc_l1cp_s: None,
        },
    })
}

fn navigation(ephemerides: impl IntoIterator<Item = Ephemeris>) -> Navigation {
    let mut navigation = Navigation::default();
    for ephemeris in ephemerides {
        navigation.insert(ephemeris);
    }
    navigation
}

async fn navigation_survives_a_restart(database: Database) {
    let store = database.store().await;
    let broker = NavigationBroker::open(store, AidingLimits::service()).await.unwrap();
    let mut pushed = navigation([ephemeris("G05", 0, 0), ephemeris("G07", 0, 0)]);
    let klobuchar = KlobucharCoefficients { alpha: [1e-8, 0.0, -6e-8, 1e-7], beta: [9e4; 4] };
    pushed.klobuchar_gps = Some(klobuchar);
    pushed.klobuchar_beidou = Some(KlobucharCoefficients { alpha: [2e-8; 4], ..klobuchar });
    pushed.klobuchar_qzss = Some(KlobucharCoefficients { alpha: [3e-8; 4], ..klobuchar });
    pushed.nequick = Some(NeQuickCoefficients { ai: [65.0, 0.1, 0.01] });
    pushed.leap_seconds = LeapSeconds::with_broadcast(19);
    let before = broker.current().navigation;
    let first = broker.push(pushed.clone(), "archive").await.unwrap();
    assert_eq!((first.received, first.new, first.dropped, first.in_force), (2, 2, 0, 2));
    assert!(before.is_empty(), "a snapshot does not change under its reader");

    let more = navigation([ephemeris("G05", 0, 0), ephemeris("G05", 7_200, 0)]);
    let second = broker.push(more.clone(), "archive").await.unwrap();
    assert_eq!((second.received, second.new, second.in_force), (2, 1, 3));
    pushed.merge(more);
    assert_eq!(*broker.current().navigation, pushed);
    let replaced = navigation([ephemeris("G07", 0, 1)]);
    assert_eq!(broker.push(replaced.clone(), "archive").await.unwrap().in_force, 3);
    pushed.merge(replaced);

    let restarted = NavigationBroker::open(database.store().await, AidingLimits::service());
    let restarted = restarted.await.unwrap();
    assert_eq!(*restarted.current().navigation, pushed);
    assert_eq!(restarted.status(), broker.status());
}

async fn old_ephemerides_make_room(database: Database) {
    let limits = AidingLimits { ephemerides_per_satellite: 2, ..AidingLimits::service() };
    let broker = NavigationBroker::open(database.store().await, limits.clone()).await.unwrap();
    let push = async |toes: &[u64]| {
        let pushed = navigation(toes.iter().map(|toe| ephemeris("G05", *toe, 0)));
        broker.push(pushed, "archive").await
    };
    push(&[7_200, 14_400]).await.unwrap();
    // A new ephemeris is kept, even if it is older than the stored ones.
    let counts = push(&[0]).await.unwrap();
    assert_eq!((counts.new, counts.dropped, counts.in_force), (1, 1, 2));
    let held = |navigation: &Navigation| -> Vec<GpsTime> {
        navigation.of("G05".parse().unwrap()).iter().map(Ephemeris::toe).collect()
    };
    assert_eq!(held(&broker.current().navigation), [time(0), time(14_400)]);
    let error = push(&[0, 1, 2]).await.unwrap_err();
    assert_eq!(error.code().name(), "TOO_MANY_EPHEMERIDES");
    let restarted = NavigationBroker::open(database.store().await, limits).await.unwrap();
    assert_eq!(held(&restarted.current().navigation), [time(0), time(14_400)]);
}

/// An upload ends nothing that is newer than a day. Of its ephemerides the newest get the room that
/// is left, and the others are counted.
async fn an_upload_gets_the_room_that_is_left(database: Database) {
    let limits = AidingLimits { ephemerides_per_satellite: 2, ..AidingLimits::service() };
    let broker = NavigationBroker::open(database.store().await, limits).await.unwrap();
    let push = async |toes: &[u64]| {
        let pushed = navigation(toes.iter().map(|toe| ephemeris("G05", *toe, 0)));
        broker.push(pushed, "upload").await.unwrap()
    };
    assert_eq!(push(&[0]).await.left_out, 0);
    let counts = push(&[7_200, 14_400]).await;
    assert_eq!((counts.new, counts.left_out, counts.in_force), (1, 1, 2));
    let current = broker.current().navigation;
    let held: Vec<GpsTime> =
        current.of("G05".parse().unwrap()).iter().map(Ephemeris::toe).collect();
    assert_eq!(held, [time(0), time(14_400)]);
}

async fn coverage_is_told(database: Database) {
    let store = database.store().await;
    let broker = NavigationBroker::open(store, AidingLimits::service()).await.unwrap();
    let healthy = [ephemeris("G05", 7_200, 0), ephemeris("G05", 14_400, 0)];
    broker.push(navigation(healthy), "archive").await.unwrap();
    broker.push(navigation([ephemeris("G07", 7_200, 63)]), "upload").await.unwrap();
    let status = broker.status();
    let [five, seven] = &status.satellites[..] else { panic!("{status:?}") };
    assert_eq!((five.ephemerides, &*five.source), (2, "archive"));
    // A fit interval of 4 h extends 2 h to both sides of toe.
    assert_eq!(five.usable, Some((time(0), time(21_600))));
    assert_eq!((seven.usable, &*seven.source), (None, "upload"));
    assert!(!status.klobuchar_gps && status.ephemerides == 3);
}
