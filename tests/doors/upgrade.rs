//! Populated databases of earlier schemas are opened, listed, continued and replayed: that of the
//! first with raw streams, feeds and archives (migrations 1 to 8, layouts 1 of epochs and 3 of
//! solutions and snapshots), that of the last with solutions in a table of their own (migration 16),
//! and those before some changes of rows (84, 86).

use std::path::Path;

use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{Reason, SatelliteId, Solution};
use graphfix::session::{Recomputation, SequencedEpoch, SessionId, SessionLimits, Sessions};
use graphfix::store::{SessionFilter, Store, StoredSolution};
use sqlx::migrate::Migrator;
use sqlx::{Connection, PgConnection, SqliteConnection};

use crate::support::database::{Database, on_both_databases, whole_session};
use crate::support::sessions::{created, desk, epoch};
use crate::support::wait::until;

on_both_databases!(
    a_populated_database_of_the_eighth_schema_is_upgraded,
    a_populated_database_of_the_sixteenth_schema_is_upgraded,
    stored_navigation_data_have_their_accounts,
    the_removal_of_deleted_sessions_goes_on,
);

const HASH: &str = "87fd338087fd338087fd338087fd338087fd338087fd338087fd338087fd3380";
const VERSION: &str = "0.0.9";
const EPOCHS: u64 = 5;

/// Applies the migrations up to one.
async fn make_schema(database: &Database, schema: i64) {
    let is_sqlite = database.url.starts_with("sqlite");
    let folder = if is_sqlite { "migrations/sqlite" } else { "migrations/postgres" };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut known = Migrator::new(folder).await.unwrap();
    known.migrations.to_mut().retain(|migration| migration.version <= schema);
    if is_sqlite {
        let url = format!("{}?mode=rwc", database.url);
        let mut connection = SqliteConnection::connect(&url).await.unwrap();
        known.run_direct(&mut connection).await.unwrap();
    } else {
        let mut connection = PgConnection::connect(&database.url).await.unwrap();
        known.run_direct(&mut connection).await.unwrap();
    }
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while 0x80 <= value {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

fn zigzag(value: i64) -> Vec<u8> {
    varint(((value << 1) ^ (value >> 63)) as u64)
}

/// A time of whole seconds.
fn time(ns: i64) -> Vec<u8> {
    assert_eq!(ns % 1_000_000_000, 0);
    [vec![1], zigzag(ns / 1_000_000_000)].concat()
}

/// Number of the constellation, and that of the satellite; GPS only.
fn satellite(satellite: SatelliteId) -> Vec<u8> {
    assert_eq!(satellite.to_string().as_bytes()[0], b'G');
    vec![0, satellite.number]
}

fn text(text: &str) -> Vec<u8> {
    [varint(text.len() as u64), text.as_bytes().to_vec()].concat()
}

/// Layout 1 of an epoch with one pseudorange.
fn former_epoch(SequencedEpoch { epoch, .. }: &SequencedEpoch) -> Vec<u8> {
    let [observation] = &epoch.observations[..] else { panic!("one observation") };
    let millimetres = (observation.pseudorange_m.unwrap() * 1e3).round() as i64;
    let (power_failure, count, flags, tags) = (0, 1, 0, 1);
    [
        vec![1],
        time(epoch.time.as_ns()),
        vec![power_failure, count],
        satellite(observation.satellite),
        vec![b'1', b'C', flags, tags],
        zigzag(millimetres),
    ]
    .concat()
}

/// Layout 3 of a solution without position.
fn former_solution(solution: &Solution) -> Vec<u8> {
    assert!(solution.estimate.is_none() && solution.provenance.ephemerides.is_empty());
    let (status, estimate, ephemerides, base) = (0, 0, 0, 0);
    let reason = |reason: &Reason| match reason {
        Reason::EphemerisMissing { satellites } => {
            let list = satellites.iter().flat_map(|id| satellite(*id)).collect();
            [vec![0], varint(satellites.len() as u64), list].concat()
        }
        Reason::TooFewSatellites { used, needed } => {
            [vec![1], varint(*used as u64), varint(*needed as u64)].concat()
        }
        other => panic!("{other:?} is not expected of an epoch without ephemeris"),
    };
    [
        vec![3],
        time(solution.time.as_ns()),
        vec![status, estimate],
        varint(solution.reasons.len() as u64),
        solution.reasons.iter().flat_map(reason).collect(),
        vec![ephemerides, base],
        text(VERSION),
        text(HASH),
    ]
    .concat()
}

/// The answers of the present version to the epochs, and its options without those that are newer
/// than the schema.
async fn answers() -> (Vec<StoredSolution>, String) {
    let database = Database::sqlite();
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, epochs(1..=EPOCHS)).await.unwrap();
    let options = sessions.get(&id).await.unwrap().configuration.into_iter();
    let former = options.filter(|option| !option.name.starts_with("integrity."));
    let options: serde_json::Map<_, _> =
        former.map(|option| (option.name.to_owned(), option.value.into())).collect();
    let page = sessions.solutions(&id, &whole_session()).await.unwrap().page;
    (page.items, serde_json::Value::Object(options).to_string())
}

fn epochs(seqs: impl Iterator<Item = u64>) -> Vec<SequencedEpoch> {
    seqs.map(|seq| epoch(seq, seq as f64)).collect()
}

/// Stores a session, its epochs and solutions, and a snapshot, as that schema and its layouts did.
async fn populate(database: &Database, id: &str, closed: bool) -> Vec<StoredSolution> {
    let is_sqlite = database.url.starts_with("sqlite");
    let blob = |bytes: &[u8]| {
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        if is_sqlite { format!("x'{hex}'") } else { format!("'\\x{hex}'") }
    };
    let (answers, options) = answers().await;
    let closed = if closed { "1700000009000" } else { "NULL" };
    let mut sql = vec![format!(
        "INSERT INTO sessions (id, label, mode, profile, overrides, configuration, \
         configuration_hash, created_unix_ms, closed_unix_ms) VALUES ('{id}', 'old', 'spp', \
         'general', '{{}}', '{options}', '{HASH}', 1700000000000, {closed})"
    )];
    let key = format!("(SELECT key FROM sessions WHERE id = '{id}')");
    for (answer, epoch) in answers.iter().zip(epochs(1..=EPOCHS)) {
        let (seq, ns) = (epoch.seq, epoch.epoch.time.as_ns());
        let content = blob(&former_epoch(&epoch));
        sql.push(format!(
            "INSERT INTO epochs (session, seq, gps_time_ns, content, navigation) \
             VALUES ({key}, {seq}, {ns}, {content}, 0)"
        ));
        let content = blob(&former_solution(&answer.solution));
        sql.push(format!(
            "INSERT INTO solutions (session, seq, revision, gps_time_ns, status, content) \
             VALUES ({key}, {seq}, 0, {ns}, 0, {content})"
        ));
    }
    let layout_3_of_an_estimator = blob(&[3, 0, 1, 2, 3]);
    sql.push(format!(
        "INSERT INTO snapshots (session, seq, configuration_hash, content) \
         VALUES ({key}, 3, '{HASH}', {layout_3_of_an_estimator})"
    ));
    sql.push(format!(
        "INSERT INTO configurations (hash, mode, profile, configuration) \
         VALUES ('{HASH}', 'spp', 'general', '{options}') ON CONFLICT (hash) DO NOTHING"
    ));
    for sql in sql {
        database.execute(&sql).await;
    }
    answers
}

async fn check(store: &Store, id: &SessionId, least: usize) {
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let again = Recomputation::open(store.clone(), aiding, id, None).await.unwrap();
    assert_eq!(again.began_after(), None, "a replay begins with the session");
    let check = again.check().await.unwrap();
    assert!(check.is_same() && least <= check.compared, "{check:?}");
}

async fn a_populated_database_of_the_eighth_schema_is_upgraded(database: Database) {
    make_schema(&database, 8).await;
    let (open, closed) = (SessionId::random(), SessionId::random());
    let answers = populate(&database, open.as_str(), false).await;
    populate(&database, closed.as_str(), true).await;
    let refused = Store::open_read_only(&database.url).await.unwrap_err();
    assert_eq!(refused.code().name(), "DATABASE_SCHEMA_OLDER");

    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let sessions = Sessions::open(store.clone(), aiding, SessionLimits::service());
    let listed = sessions.list(&SessionFilter::default(), 10, None).await.unwrap().items;
    assert_eq!(listed.iter().map(|info| &info.id).collect::<Vec<_>>(), [&closed, &open]);
    assert_eq!(listed[0].closed_unix_ms, Some(1_700_000_009_000));
    for info in &listed {
        assert_eq!(info.durable_through, Some(EPOCHS));
        assert_eq!((info.retention_days, info.oldest_available), (0, None));
        let page = sessions.solutions(&info.id, &whole_session()).await.unwrap().page;
        assert_eq!(page.items.len() as u64, EPOCHS);
        for (stored, answer) in page.items.iter().zip(&answers) {
            assert_eq!((stored.seq, &stored.solution), (answer.seq, &answer.solution));
            assert_eq!((&*stored.version, &*stored.configuration_hash), (VERSION, HASH));
        }
        check(&store, &info.id, EPOCHS as usize).await;
    }

    let resent = sessions.submit(&open, epochs(2..=3)).await.unwrap().outcomes;
    assert!(resent.iter().all(|outcome| outcome.result.as_ref().unwrap().resent));
    let other = sessions.submit(&open, vec![epoch(3, 3.5)]).await.unwrap().outcomes.remove(0);
    assert_eq!(other.result.unwrap_err().code().name(), "SEQUENCE_CONFLICT");
    // The snapshot of the earlier layout cannot be read: the state is rebuilt from stored epochs.
    let next = sessions.submit(&open, epochs(EPOCHS + 1..=2 * EPOCHS)).await.unwrap();
    assert_eq!(next.durable_through, Some(2 * EPOCHS));
    check(&store, &open, 2 * EPOCHS as usize).await;
    // The history begins with the upgrade: one minute and its hour.
    assert_eq!(database.count("rollups").await, 2);
    let of_hour = format!("rollups WHERE seconds = 3600 AND n_none = {EPOCHS}");
    assert_eq!(database.count(&of_hour).await, 1);
    sessions.drain().await;
    store.close().await;
}

/// The last schema with first answers and revisions in one table.
async fn a_populated_database_of_the_sixteenth_schema_is_upgraded(database: Database) {
    make_schema(&database, 16).await;
    let (open, revised) = (SessionId::random(), SessionId::random());
    let answers = populate(&database, open.as_str(), false).await;
    populate(&database, revised.as_str(), false).await;
    let key = format!("(SELECT key FROM sessions WHERE id = '{}')", revised.as_str());
    let time = answers[1].solution.time.as_ns();
    for sql in [
        "INSERT INTO session_heads (session, owner, fence, last_seq, last_gps_time_ns, status) \
         SELECT session, '', 0, MAX(seq), MAX(gps_time_ns), 0 FROM epochs GROUP BY session"
            .to_owned(),
        format!(
            "INSERT INTO solutions (session, seq, revision, gps_time_ns, status, content) \
             SELECT session, seq, 1, {time}, status, content FROM solutions \
             WHERE seq = 2 AND session = {key}"
        ),
    ] {
        database.execute(&sql).await;
    }
    let store = database.store().await;
    for table in ["epochs", "revisions"] {
        let expected = if table == "epochs" { 2 * EPOCHS as i64 } else { 1 };
        assert_eq!(database.count(table).await, expected, "{table}");
    }
    let sessions = desk(&store).await;
    let listed = sessions.solutions(&revised, &whole_session()).await.unwrap().page.items;
    let keys: Vec<_> = listed.iter().map(|solution| (solution.seq, solution.revision)).collect();
    assert_eq!(keys, [(1, 0), (2, 0), (2, 1), (3, 0), (4, 0), (5, 0)]);
    assert!(listed.iter().all(|solution| &*solution.version == VERSION));
    assert_eq!(listed[2].solution, answers[1].solution);
    let next = sessions.submit(&open, epochs(EPOCHS + 1..=2 * EPOCHS)).await.unwrap();
    assert_eq!(next.durable_through, Some(2 * EPOCHS));
    check(&store, &open, 2 * EPOCHS as usize).await;
    sessions.drain().await;
    store.close().await;
}

/// Migration 85: superseded navigation data are counted by account.
async fn stored_navigation_data_have_their_accounts(database: Database) {
    make_schema(&database, 84).await;
    let sources = ["upload", "device", "device ses_1", "device ses_2", "device tenant a"];
    for (number, source) in sources.into_iter().enumerate() {
        let ephemeris = format!(
            "INSERT INTO ephemerides (satellite, toe_ns, message, toc_ns, issue, since, until, \
             source, stored_unix_ms, content) \
             VALUES ('G01', {number}, 'LNAV', 0, 0, 0, 1, '{source}', 0, '')"
        );
        let record = format!(
            "INSERT INTO navigation_records (kind, since, until, source, stored_unix_ms, content) \
             VALUES ('klobuchar-gps', {number}, 9, '{source}', 0, '')"
        );
        database.execute(&ephemeris).await;
        database.execute(&record).await;
    }
    database.store().await;
    for table in ["ephemerides", "navigation_records"] {
        for (account, rows) in [("", 2), ("device", 2), ("device tenant a", 1)] {
            let of_account = format!("{table} WHERE account = '{account}'");
            assert_eq!(database.count(&of_account).await, rows, "{of_account}");
        }
    }
}

/// Of deleted sessions of schema 86, those with a head are removed and no others: also one of which
/// the retention has removed all epochs.
async fn the_removal_of_deleted_sessions_goes_on(database: Database) {
    make_schema(&database, 86).await;
    for (key, emptied, has_head) in [(1, 0, false), (2, 0, true), (3, 1, true)] {
        let session = format!(
            "INSERT INTO sessions (id, label, mode, profile, overrides, configuration, \
             configuration_hash, created_unix_ms, closed_unix_ms, deleted_unix_ms, emptied) \
             VALUES ('ses_{key}', 'left', 'spp', 'general', '{{}}', '{{}}', '{HASH}', 0, 1, 2, \
             {emptied})"
        );
        database.execute(&session).await;
        if has_head {
            let head = "INSERT INTO session_heads (session, owner, fence)";
            database.execute(&format!("{head} VALUES ({key}, '', 0)")).await;
        }
    }
    let _sessions = desk(&database.store().await).await;
    let left = async || database.count("sessions WHERE emptied = 0").await;
    until("all are removed", left, |left| *left == 0).await;
    assert_eq!(database.count("session_heads").await, 0);
    assert_eq!(database.count("sessions WHERE label = 'left'").await, 1, "the one without a head");
}
