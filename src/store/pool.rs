//! The pools of the two databases. The committer has a connection of its own.

use std::fmt;
use std::sync::Arc;

use sqlx::postgres::PgPoolOptions;
use sqlx::sqlite::SqlitePoolOptions;
use sqlx::{Connection, PgPool, SqlitePool};
use tokio::sync::Mutex;

use super::database::{Database, POSTGRES_DURABLE};
use super::deadline::DEADLINE;

const SQLITE_READERS: u32 = 4;
const POSTGRES_CONNECTIONS: u32 = 16;

/// The pools of one of the databases.
#[derive(Clone)]
pub(super) enum Pool {
    /// SQLite: one connection writes beside the committer, the others read committed data.
    Sqlite {
        /// The connection that writes.
        writer: SqlitePool,
        /// The connections that read.
        readers: SqlitePool,
        /// Locked by who writes, in order of arrival. SQLite's own lock would be a matter of luck.
        turn: Arc<Mutex<()>>,
    },
    /// Postgres.
    Postgres(PgPool),
}

/// Runs the same body on the reading pool of either database, with the deadline of a statement or,
/// with `bulk`, of many rows.
macro_rules! reading {
    (bulk $pool:expr, $executor:ident => $body:expr) => {
        $crate::store::pool::reading!(
            $crate::store::deadline::BULK_DEADLINE, $pool, $executor => $body
        )
    };
    ($pool:expr, $executor:ident => $body:expr) => {
        $crate::store::pool::reading!($crate::store::deadline::DEADLINE, $pool, $executor => $body)
    };
    ($deadline:expr, $pool:expr, $executor:ident => $body:expr) => {
        match $pool {
            $crate::store::pool::Pool::Sqlite { readers: $executor, .. } => {
                $crate::store::deadline::within($deadline, async { $body }).await
            }
            $crate::store::pool::Pool::Postgres($executor) => {
                $crate::store::deadline::within($deadline, async { $body }).await
            }
        }
    };
}
/// Runs the same body on the writing pool of either database, with the deadline of a transaction of
/// many statements.
macro_rules! writing {
    ($pool:expr, $executor:ident => $body:expr) => {
        match $pool {
            $crate::store::pool::Pool::Sqlite { writer: $executor, turn, .. } => {
                let write = async {
                    let _turn = turn.lock().await;
                    $body
                };
                $crate::store::deadline::within($crate::store::deadline::BULK_DEADLINE, write).await
            }
            $crate::store::pool::Pool::Postgres($executor) => {
                let write = async { $body };
                $crate::store::deadline::within($crate::store::deadline::BULK_DEADLINE, write).await
            }
        }
    };
}
pub(super) use {reading, writing};

impl Pool {
    /// The pools of a database. They connect when they are first used.
    pub(super) fn new(database: &Database) -> Self {
        match database {
            Database::Sqlite(options) => {
                // After a commit that fails, as on a full disk, sqlx takes the connection for one
                // within a transaction, and can begin no other.
                let writer =
                    SqlitePoolOptions::new().max_connections(1).after_release(|connection, _| {
                        Box::pin(async { Ok(!connection.is_in_transaction()) })
                    });
                let readers = SqlitePoolOptions::new().max_connections(SQLITE_READERS);
                Self::Sqlite {
                    writer: writer.acquire_timeout(DEADLINE).connect_lazy_with(options.clone()),
                    readers: readers.acquire_timeout(DEADLINE).connect_lazy_with(options.clone()),
                    turn: Arc::default(),
                }
            }
            Database::Postgres(options) => {
                let pool = PgPoolOptions::new()
                    .max_connections(POSTGRES_CONNECTIONS)
                    .acquire_timeout(DEADLINE)
                    .after_connect(|connection, _| {
                        Box::pin(async {
                            sqlx::query(POSTGRES_DURABLE).execute(connection).await.map(drop)
                        })
                    });
                Self::Postgres(pool.connect_lazy_with(options.clone()))
            }
        }
    }

    /// The turn of who writes, which the committer takes too.
    pub(super) fn turn(&self) -> Arc<Mutex<()>> {
        match self {
            Self::Sqlite { turn, .. } => turn.clone(),
            Self::Postgres(_) => Arc::default(),
        }
    }

    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite { writer, readers, .. } => {
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
