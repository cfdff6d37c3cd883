//! A database that fails while sessions use it: epochs are refused clearly, the service recovers by
//! itself, and nothing acknowledged is lost.

use std::time::{Duration, Instant};

use graphfix::session::{SessionError, SessionId, Sessions};
use graphfix::store::{CommitterState, DatabaseSetting, SettingRisk, Store};
use sqlx::{Connection, PgConnection, SqliteConnection};

use crate::support::database::{Database, on_both_databases, on_postgres, whole_session};
use crate::support::sessions::{created, desk, epoch};
use crate::support::wait::until;

on_both_databases!(
    a_locked_database_is_refused_and_served_again,
    a_store_opened_to_read_changes_nothing,
    the_settings_of_the_database_are_reported,
);

/// The deadline of a commit is 5 s.
const REFUSED_WITHIN: Duration = Duration::from_secs(7);
/// Short compared with the deadline, with room for a busy machine.
const REFUSED_AT_ONCE_WITHIN: Duration = Duration::from_secs(2);

async fn numbers(sessions: &Sessions, id: &SessionId) -> Vec<u64> {
    let page = sessions.solutions(id, &whole_session()).await.unwrap().page;
    page.items.iter().map(|solution| solution.seq).collect()
}

/// Submits an epoch until it is acknowledged.
async fn acknowledged(sessions: &Sessions, id: &SessionId, seq: u64) {
    let submit = async || sessions.submit(id, vec![epoch(seq, seq as f64)]).await;
    let answer = until("acknowledged", submit, Result::is_ok).await.unwrap();
    assert_eq!(answer.durable_through, Some(seq));
    assert!(answer.outcomes[0].result.is_ok());
}

fn assert_failed(error: &SessionError) {
    assert_eq!(error.code().name(), "DATABASE_FAILED", "{error}");
}

/// A lock on the committer's tables by another client.
enum Lock {
    Sqlite(SqliteConnection),
    Postgres(PgConnection),
}

impl Lock {
    async fn take(database: &Database) -> Self {
        if database.url.starts_with("sqlite") {
            let mut connection = SqliteConnection::connect(&database.url).await.unwrap();
            sqlx::query("BEGIN IMMEDIATE").execute(&mut connection).await.unwrap();
            return Self::Sqlite(connection);
        }
        let mut connection = PgConnection::connect(&database.url).await.unwrap();
        sqlx::query("BEGIN").execute(&mut connection).await.unwrap();
        let lock = "LOCK TABLE epochs IN EXCLUSIVE MODE";
        sqlx::query(lock).execute(&mut connection).await.unwrap();
        Self::Postgres(connection)
    }

    async fn release(self) {
        match self {
            Self::Sqlite(mut connection) => {
                sqlx::query("ROLLBACK").execute(&mut connection).await.unwrap();
            }
            Self::Postgres(mut connection) => {
                sqlx::query("ROLLBACK").execute(&mut connection).await.unwrap();
            }
        }
    }
}

/// An epoch is refused within the deadline while the database is locked, and at once when that is
/// known, also one of a session that is not in memory. After the lock the session continues from
/// the state in memory.
async fn a_locked_database_is_refused_and_served_again(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let id = created(&sessions).await;
    let parked = created(&sessions).await;
    acknowledged(&sessions, &id, 1).await;
    let lock = Lock::take(&database).await;
    let began = Instant::now();
    let error = sessions.submit(&id, vec![epoch(2, 2.0)]).await.unwrap_err();
    assert_failed(&error);
    assert!(began.elapsed() < REFUSED_WITHIN, "refused after {:?}", began.elapsed());
    assert_eq!(store.committer_health().failures, 1);
    // On Postgres another connection works: only commits of epochs wait for the lock.
    for id in [&id, &parked].into_iter().filter(|_| matches!(lock, Lock::Sqlite(_))) {
        let began = Instant::now();
        assert_failed(&sessions.submit(id, vec![epoch(2, 2.0)]).await.unwrap_err());
        assert!(began.elapsed() < REFUSED_AT_ONCE_WITHIN, "refused after {:?}", began.elapsed());
    }
    lock.release().await;
    acknowledged(&sessions, &parked, 1).await;
    let released = Instant::now();
    acknowledged(&sessions, &id, 3).await;
    assert!(released.elapsed() < Duration::from_secs(5), "served after {:?}", released.elapsed());
    eprintln!("locked: served {:.1?} after its end", released.elapsed());
    assert_eq!(store.committer_health().state, CommitterState::Working);
    assert_eq!(numbers(&sessions, &id).await, [1, 3]);
    assert_eq!(sessions.counts().restores(), 0, "the state in memory was dropped");
}

/// A store that is opened to read, as by `graphfix replay`, migrates and commits nothing. It
/// refuses another schema.
async fn a_store_opened_to_read_changes_nothing(database: Database) {
    let id = {
        let sessions = desk(&database.store().await).await;
        let id = created(&sessions).await;
        acknowledged(&sessions, &id, 1).await;
        id
    };
    let store = Store::open_read_only(&database.url).await.unwrap();
    let sessions = desk(&store).await;
    assert_eq!(numbers(&sessions, &id).await, [1]);
    let error = sessions.submit(&id, vec![epoch(2, 2.0)]).await.unwrap_err();
    assert_eq!(error.code().name(), "DRAINING", "{error}");
    store.close().await;
    let newest = "(SELECT MAX(version) FROM _sqlx_migrations)";
    database.execute(&format!("DELETE FROM _sqlx_migrations WHERE version = {newest}")).await;
    let error = Store::open_read_only(&database.url).await.unwrap_err();
    assert_eq!(error.code().name(), "DATABASE_SCHEMA_OLDER", "{error}");
}

async fn the_settings_of_the_database_are_reported(database: Database) {
    let store = database.store().await;
    let names: Vec<_> = store.settings().iter().map(|setting| setting.name).collect();
    let expected: &[&str] = match database.url.starts_with("sqlite") {
        true => &["journal_mode", "synchronous"],
        false => &["synchronous_commit", "fsync", "full_page_writes", "autovacuum"],
    };
    assert_eq!(names, expected);
    let synchronous = store.settings().iter().find(|s| s.name.starts_with("synchronous"));
    assert_eq!(synchronous.unwrap().risk, None);
    let vacuum = store.settings().iter().find(|s| s.name == "autovacuum");
    if let Some(DatabaseSetting { value, risk, .. }) = vacuum {
        assert_eq!(*risk, (value == "off").then_some(SettingRisk::Growth));
    }
}

/// The service turns `synchronous_commit` on, even if the role or the server has it off. Without it
/// the service would acknowledge epochs that a power failure loses.
#[tokio::test]
async fn commits_are_durable_whatever_the_server_says() {
    on_postgres(async |database| {
        let url = format!("{}&options[synchronous_commit]=off", database.url);
        let store = Store::open(&url).await.unwrap();
        let setting = &store.settings()[0];
        assert_eq!((setting.name, &*setting.value), ("synchronous_commit", "on"));
    })
    .await;
}

/// The server ends the committer's process repeatedly while a device pushes.
#[tokio::test]
async fn an_ended_connection_loses_nothing() {
    on_postgres(async |database| {
        let name = format!("ended_{}", std::process::id());
        let url = format!("{}&application_name={name}", database.url);
        let sessions = desk(&Store::open(&url).await.unwrap()).await;
        let id = created(&sessions).await;
        acknowledged(&sessions, &id, 1).await;
        let mut server = PgConnection::connect(&database.url).await.unwrap();
        let end = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity
                   WHERE starts_with(application_name, $1 || ' committer')";
        for seq in 2..=20 {
            let ended = sqlx::query(end).bind(&name).execute(&mut server).await.unwrap();
            assert_eq!(ended.rows_affected(), 1);
            acknowledged(&sessions, &id, seq).await;
        }
        assert_eq!(numbers(&sessions, &id).await, (1..=20).collect::<Vec<_>>());
    })
    .await;
}
