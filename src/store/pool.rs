//! The pools of the two databases.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::postgres::{PgConnectOptions, PgPoolOptions};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{PgPool, SqlitePool};

use super::StoreError;

static SQLITE_MIGRATIONS: Migrator = sqlx::migrate!("migrations/sqlite");
static POSTGRES_MIGRATIONS: Migrator = sqlx::migrate!("migrations/postgres");

const SQLITE_READERS: u32 = 4;
const POSTGRES_CONNECTIONS: u32 = 16;
/// Longest time that a connection waits for another process's lock on the file.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Size of the write-ahead log (pages of 4 KiB) at which it is moved into the database.
const CHECKPOINT_PAGES: &str = "4000";

/// The pools of one of the databases.
#[derive(Clone)]
pub(super) enum Pool {
    /// SQLite: one connection writes, the others read committed data.
    Sqlite {
        /// The connection that writes.
        writer: SqlitePool,
        /// The connections that read.
        readers: SqlitePool,
    },
    /// Postgres.
    Postgres(PgPool),
}

/// Runs the same body on the reading pool of either database.
macro_rules! reading {
    ($pool:expr, $executor:ident => $body:expr) => {
        match $pool {
            $crate::store::pool::Pool::Sqlite { readers: $executor, .. } => $body,
            $crate::store::pool::Pool::Postgres($executor) => $body,
        }
    };
}
/// Runs the same body on the writing pool of either database.
macro_rules! writing {
    ($pool:expr, $executor:ident => $body:expr) => {
        match $pool {
            $crate::store::pool::Pool::Sqlite { writer: $executor, .. } => $body,
            $crate::store::pool::Pool::Postgres($executor) => $body,
        }
    };
}
pub(super) use {reading, writing};

impl Pool {
    pub(super) async fn open(url: &str) -> Result<Self, StoreError> {
        match url.split_once("://") {
            Some(("sqlite", file)) => Self::open_sqlite(url, file).await,
            Some(("postgres" | "postgresql", _)) => Self::open_postgres(url).await,
            Some((scheme, _)) => {
                Err(StoreError::Url { why: format!("{scheme:?} is not a supported database") })
            }
            None => Err(StoreError::Url { why: "it has no \"://\"".to_owned() }),
        }
    }

    async fn open_sqlite(url: &str, file: &str) -> Result<Self, StoreError> {
        if file.is_empty() || file.starts_with(":memory:") || file.contains("mode=memory") {
            let why = "it names no file, and Graphfix keeps nothing in memory alone".to_owned();
            return Err(StoreError::Url { why });
        }
        let options = SqliteConnectOptions::from_str(url)
            .map_err(|error| StoreError::Url { why: error.to_string() })?
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Full)
            .busy_timeout(BUSY_TIMEOUT)
            .foreign_keys(true)
            .pragma("wal_autocheckpoint", CHECKPOINT_PAGES);
        let opening = StoreError::database("opening the SQLite database");
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .connect_with(options.clone())
            .await
            .map_err(opening)?;
        let migrated = SQLITE_MIGRATIONS.run(&writer).await;
        migrated.map_err(|error| migration_error(error, &SQLITE_MIGRATIONS))?;
        let readers =
            SqlitePoolOptions::new().max_connections(SQLITE_READERS).connect_lazy_with(options);
        Ok(Self::Sqlite { writer, readers })
    }

    async fn open_postgres(url: &str) -> Result<Self, StoreError> {
        let options = PgConnectOptions::from_str(url)
            .map_err(|error| StoreError::Url { why: error.to_string() })?;
        let pool = PgPoolOptions::new()
            .max_connections(POSTGRES_CONNECTIONS)
            .connect_with(options)
            .await
            .map_err(StoreError::database("connecting to Postgres"))?;
        let migrated = POSTGRES_MIGRATIONS.run(&pool).await;
        migrated.map_err(|error| migration_error(error, &POSTGRES_MIGRATIONS))?;
        Ok(Self::Postgres(pool))
    }

    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite { writer, readers } => {
                readers.close().await;
                writer.close().await;
            }
            Self::Postgres(pool) => pool.close().await,
        }
    }
}

impl fmt::Debug for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sqlite { .. } => "Sqlite",
            Self::Postgres(_) => "Postgres",
        })
    }
}

fn migration_error(error: MigrateError, known: &Migrator) -> StoreError {
    let newest = known.iter().map(|migration| migration.version).max().unwrap_or(0);
    match error {
        MigrateError::VersionMissing(found) if newest < found => {
            StoreError::NewerSchema { found, known: newest }
        }
        error => StoreError::Migration { source: Arc::new(error) },
    }
}
