//! The database that a URL names, and how connections to it are configured.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::postgres::PgConnectOptions;
use sqlx::sqlite::{SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{ConnectOptions, PgConnection, SqliteConnection};

use super::StoreError;
use super::deadline::{BULK_DEADLINE, DEADLINE, within};

static SQLITE_MIGRATIONS: Migrator = sqlx::migrate!("migrations/sqlite");
static POSTGRES_MIGRATIONS: Migrator = sqlx::migrate!("migrations/postgres");

/// Longest time that a connection waits for another process's lock on the file. It is below the
/// deadline of a commit, so that SQLite reports the cause.
pub(super) const BUSY_TIMEOUT: Duration = Duration::from_secs(4);
/// Size of the write-ahead log (pages of 4 KiB) at which its pages are moved into the database.
pub(super) const CHECKPOINT_PAGES: &str = "4000";

/// Settings of each connection to Postgres. The server notices a client that has vanished within
/// some 11 s, and ends its transaction. The client has deadlines of its own.
const POSTGRES_SETTINGS: [(&str, &str); 4] = [
    ("tcp_keepalives_idle", "5"),
    ("tcp_keepalives_interval", "2"),
    ("tcp_keepalives_count", "3"),
    ("idle_in_transaction_session_timeout", "30s"),
];
/// Makes commits durable if the server's default does not. A stronger setting is kept.
pub(super) const POSTGRES_DURABLE: &str = "SELECT set_config('synchronous_commit', 'on', false) \
    WHERE current_setting('synchronous_commit') = 'off'";

/// Parameters of a Postgres URL, without those named `options[…]`. Another name would be ignored,
/// and a mistyped `sslmode` would leave out the check of the server's certificate.
const POSTGRES_PARAMETERS: [&str; 18] = [
    "sslmode",
    "ssl-mode",
    "sslrootcert",
    "ssl-root-cert",
    "ssl-ca",
    "sslcert",
    "ssl-cert",
    "sslkey",
    "ssl-key",
    "statement-cache-capacity",
    "host",
    "hostaddr",
    "port",
    "dbname",
    "user",
    "password",
    "application_name",
    "options",
];

/// Checks the names of the parameters of a Postgres URL, which begins after `://`.
fn check_parameters(address: &str) -> Result<(), String> {
    let Some((_, query)) = address.split_once('?') else { return Ok(()) };
    let mut names = query.split(['&', '#']).map(|part| part.split('=').next().unwrap_or(part));
    let is_known = |name: &str| {
        let is_option = name.starts_with("options[") || name.starts_with("options%5B");
        name.is_empty() || is_option || POSTGRES_PARAMETERS.contains(&name)
    };
    match names.find(|name| !is_known(name)) {
        Some(name) => Err(format!("it has no parameter {name:?}")),
        None => Ok(()),
    }
}

/// The database of a URL.
#[derive(Clone)]
pub(super) enum Database {
    /// A file.
    Sqlite(SqliteConnectOptions),
    /// A server.
    Postgres(PgConnectOptions),
}

impl Database {
    /// Parses `sqlite://FILE` or `postgres://…`.
    pub(super) fn parse(url: &str) -> Result<Self, StoreError> {
        let invalid = |why: String| StoreError::Url { why };
        match url.split_once("://") {
            Some(("sqlite", file)) => {
                if file.is_empty() || file.starts_with(":memory:") || file.contains("mode=memory") {
                    let why = "it names no file, and Graphfix keeps nothing in memory alone";
                    return Err(invalid(why.to_owned()));
                }
                let names_vfs = |query: &str| query.split('&').any(|part| part.starts_with("vfs="));
                if file.split_once('?').is_some_and(|(_, query)| names_vfs(query)) {
                    // The committer opens the file by itself, and both must lock it in the same
                    // way.
                    let why = "it names a vfs, and Graphfix uses that of the system";
                    return Err(invalid(why.to_owned()));
                }
                let options = SqliteConnectOptions::from_str(url)
                    .map_err(|error| invalid(error.to_string()))?
                    .journal_mode(SqliteJournalMode::Wal)
                    .synchronous(SqliteSynchronous::Full)
                    .busy_timeout(BUSY_TIMEOUT)
                    .foreign_keys(true)
                    // Journals of single statements stay in memory.
                    .pragma("temp_store", "MEMORY")
                    // Applies to new files only.
                    .auto_vacuum(SqliteAutoVacuum::Incremental)
                    .pragma("wal_autocheckpoint", CHECKPOINT_PAGES);
                Ok(Self::Sqlite(options))
            }
            Some(("postgres" | "postgresql", address)) => {
                check_parameters(address).map_err(invalid)?;
                let options = PgConnectOptions::from_str(url)
                    .map_err(|error| invalid(error.to_string()))?
                    .options(POSTGRES_SETTINGS)
                    .options([("statement_timeout", BULK_DEADLINE.as_millis())]);
                Ok(Self::Postgres(options))
            }
            Some((scheme, _)) => Err(invalid(format!("{scheme:?} is not a supported database"))),
            None => Err(invalid("it has no \"://\"".to_owned())),
        }
    }

    /// Brings the schema up to date. A file is created if absent.
    pub(super) async fn migrate(&self) -> Result<(), StoreError> {
        match self {
            Self::Sqlite(options) => {
                let connecting = options.clone().create_if_missing(true).connect().await;
                let opening = StoreError::database("opening the SQLite database");
                let mut connection: SqliteConnection = connecting.map_err(opening)?;
                let migrated = SQLITE_MIGRATIONS.run_direct(&mut connection).await;
                migrated.map_err(|error| migration_error(error, &SQLITE_MIGRATIONS))
            }
            Self::Postgres(options) => {
                // A migration may take longer than a statement of the service.
                let connecting =
                    options.clone().options([("statement_timeout", 0)]).connect().await;
                let opening = StoreError::database("connecting to Postgres");
                let mut connection: PgConnection = connecting.map_err(opening)?;
                let migrated = POSTGRES_MIGRATIONS.run_direct(&mut connection).await;
                migrated.map_err(|error| migration_error(error, &POSTGRES_MIGRATIONS))
            }
        }
    }

    /// Checks that the schema has the version that this program knows. Changes no row.
    pub(super) async fn check_schema(&self) -> Result<(), StoreError> {
        let failed = StoreError::database("reading the version of the schema");
        let newest = "SELECT MAX(version) FROM _sqlx_migrations WHERE success";
        let (found, migrator) = match self {
            Self::Sqlite(options) => {
                let read = async {
                    let mut connection: SqliteConnection = options.clone().connect().await?;
                    sqlx::query_scalar(newest).fetch_one(&mut connection).await
                };
                (within(DEADLINE, read).await, &SQLITE_MIGRATIONS)
            }
            Self::Postgres(options) => {
                let read = async {
                    let mut connection: PgConnection = options.clone().connect().await?;
                    sqlx::query_scalar(newest).fetch_one(&mut connection).await
                };
                (within(DEADLINE, read).await, &POSTGRES_MIGRATIONS)
            }
        };
        let (found, known) = (found.map_err(failed)?, newest_known(migrator));
        match found {
            found if known < found => Err(StoreError::NewerSchema { found, known }),
            found if found < known => Err(StoreError::OlderSchema { found, known }),
            _ => Ok(()),
        }
    }

    /// The same database for reading only.
    pub(super) fn read_only(self) -> Self {
        match self {
            Self::Sqlite(options) => Self::Sqlite(options.pragma("query_only", "ON")),
            Self::Postgres(options) => {
                Self::Postgres(options.options([("default_transaction_read_only", "on")]))
            }
        }
    }

    /// The file; `None` for a server.
    pub(super) fn file(&self) -> Option<PathBuf> {
        match self {
            Self::Sqlite(options) => Some(options.get_filename().to_owned()),
            Self::Postgres(_) => None,
        }
    }

    /// The folder of the file; `None` for a server.
    pub(super) fn folder(&self) -> Option<PathBuf> {
        match self {
            Self::Sqlite(options) => {
                let folder = options.get_filename().parent().unwrap_or("".as_ref());
                let is_here = folder.as_os_str().is_empty();
                Some(if is_here { PathBuf::from(".") } else { folder.to_owned() })
            }
            Self::Postgres(_) => None,
        }
    }
}

fn migration_error(error: MigrateError, known: &Migrator) -> StoreError {
    let known = newest_known(known);
    match error {
        MigrateError::VersionMissing(found) if known < found => {
            StoreError::NewerSchema { found, known }
        }
        error => StoreError::Migration { source: Arc::new(error) },
    }
}

fn newest_known(migrator: &Migrator) -> i64 {
    migrator.iter().map(|migration| migration.version).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_names_a_file_on_the_disk_or_a_server() {
        for url in ["sqlite://graphfix.db", "sqlite://a/vfs=b.db?mode=rwc&cache=private"] {
            assert!(matches!(Database::parse(url), Ok(Database::Sqlite(_))), "{url}");
        }
        for parameters in ["", "?sslmode=verify-full&sslrootcert=/ca.pem", "?options[jit]=off"] {
            let url = format!("postgres://user:a%3Fb@host/db{parameters}");
            assert!(matches!(Database::parse(&url), Ok(Database::Postgres(_))), "{url}");
        }
        for (url, why) in [
            ("sqlite://", "no file"),
            ("sqlite://graphfix.db?mode=memory", "no file"),
            ("sqlite://graphfix.db?mode=rw&vfs=unix-none", "vfs"),
            ("mysql://host/db", "not a supported database"),
            ("graphfix.db", "no \"://\""),
            ("postgres://host/db?user=a&sslmod=verify-full", "no parameter \"sslmod\""),
            ("postgres://host/db?sslmode=verify", "unknown value \"verify\""),
        ] {
            let refused = Database::parse(url).err().expect(url).to_string();
            assert!(refused.contains(why), "{url}: {refused}");
        }
    }
}
