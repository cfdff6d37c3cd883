//! The pools of the two databases. The committer has a connection of its own. Lists for people have
//! connections of their own, so that no device waits for them.
//!
//! A read that nobody waits for any more must also end in the database. A Postgres server ends it
//! by its own limit, and SQLite checks from time to time whether the limit has passed.

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use sqlx::postgres::{PgConnectOptions, PgPoolOptions};
use sqlx::sqlite::{SqliteConnectOptions, SqlitePoolOptions};
use sqlx::{Connection, PgPool, SqliteConnection, SqlitePool};
use tokio::sync::Mutex;

use super::database::{Database, POSTGRES_DURABLE};
use super::deadline::{BULK_DEADLINE, DEADLINE};

const SQLITE_READERS: u32 = 4;
const SQLITE_LISTERS: u32 = 4;
const POSTGRES_CONNECTIONS: u32 = 16;
const POSTGRES_LISTERS: u32 = 4;
/// SQLite instructions between two checks of the time: about 0.1 ms.
const INSTRUCTIONS: i32 = 4_096;
/// Time after a deadline, so that the error of the deadline is reported first.
const GRACE: Duration = Duration::from_millis(100);

/// The pools of one database.
#[derive(Clone)]
pub(super) enum Pool {
    /// SQLite: one connection writes beside the committer, the others read committed data.
    Sqlite {
        /// The connection that writes.
        writer: SqlitePool,
        /// The connections that read.
        readers: SqlitePool,
        /// The connections that read lists.
        listers: SqlitePool,
        /// Locked by the writer, in order of arrival. SQLite's own lock has no order.
        turn: Arc<Mutex<()>>,
    },
    /// Postgres.
    Postgres {
        /// The connections that read and write.
        pool: PgPool,
        /// The connections that read lists.
        listers: PgPool,
    },
}

/// Runs the same body on the reading pool of either database, with the deadline of a statement.
/// With `bulk` it has the deadline for many rows; with `list` it uses the connections for lists.
macro_rules! reading {
    (list $pool:expr, $executor:ident => $body:expr) => {
        match $pool {
            $crate::store::pool::Pool::Sqlite { listers: $executor, .. } => {
                let read = async { $body };
                $crate::store::deadline::within($crate::store::deadline::DEADLINE, read).await
            }
            $crate::store::pool::Pool::Postgres { listers: $executor, .. } => {
                let read = async { $body };
                $crate::store::deadline::within($crate::store::deadline::DEADLINE, read).await
            }
        }
    };
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
            $crate::store::pool::Pool::Postgres { pool: $executor, .. } => {
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
            $crate::store::pool::Pool::Postgres { pool: $executor, .. } => {
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
                // After a failed commit, for instance on a full disk, sqlx believes that the
                // connection is still within a transaction, and can begin no other.
                let writer =
                    SqlitePoolOptions::new().max_connections(1).after_release(|connection, _| {
                        Box::pin(async { Ok(!connection.is_in_transaction()) })
                    });
                Self::Sqlite {
                    writer: writer.acquire_timeout(DEADLINE).connect_lazy_with(options.clone()),
                    readers: sqlite_readers(options, SQLITE_READERS, BULK_DEADLINE),
                    listers: sqlite_readers(options, SQLITE_LISTERS, DEADLINE),
                    turn: Arc::default(),
                }
            }
            Database::Postgres(options) => Self::Postgres {
                pool: postgres(options.clone(), POSTGRES_CONNECTIONS),
                listers: postgres(
                    options.clone().options([("statement_timeout", DEADLINE.as_millis())]),
                    POSTGRES_LISTERS,
                ),
            },
        }
    }

    /// A pool with one connection for reads that must not wait for others, and none for writes.
    pub(super) fn of_one(database: &Database) -> Self {
        match database {
            Database::Sqlite(options) => {
                let none = SqlitePoolOptions::new().connect_lazy_with(options.clone());
                Self::Sqlite {
                    writer: none.clone(),
                    readers: sqlite_readers(options, 1, DEADLINE),
                    listers: none,
                    turn: Arc::default(),
                }
            }
            Database::Postgres(options) => {
                let pool = postgres(options.clone(), 1);
                Self::Postgres { listers: pool.clone(), pool }
            }
        }
    }

    /// The same database, read by the connections for lists.
    pub(super) fn for_lists(&self) -> Self {
        match self {
            Self::Sqlite { writer, listers, turn, .. } => Self::Sqlite {
                writer: writer.clone(),
                readers: listers.clone(),
                listers: listers.clone(),
                turn: turn.clone(),
            },
            Self::Postgres { listers, .. } => {
                Self::Postgres { pool: listers.clone(), listers: listers.clone() }
            }
        }
    }

    /// The connections that read and write, on Postgres.
    pub(super) const fn postgres(&self) -> Option<&PgPool> {
        match self {
            Self::Sqlite { .. } => None,
            Self::Postgres { pool, .. } => Some(pool),
        }
    }

    /// The lock of the writer, which the committer takes, too.
    pub(super) fn turn(&self) -> Arc<Mutex<()>> {
        match self {
            Self::Sqlite { turn, .. } => turn.clone(),
            Self::Postgres { .. } => Arc::default(),
        }
    }

    pub(super) async fn close(&self) {
        match self {
            Self::Sqlite { writer, readers, listers, .. } => {
                readers.close().await;
                listers.close().await;
                writer.close().await;
            }
            Self::Postgres { pool, listers } => {
                listers.close().await;
                pool.close().await;
            }
        }
    }
}

/// Connections that read. Each use of a connection ends within the limit.
fn sqlite_readers(options: &SqliteConnectOptions, count: u32, limit: Duration) -> SqlitePool {
    SqlitePoolOptions::new()
        .max_connections(count)
        .acquire_timeout(DEADLINE)
        .after_connect(move |connection, _| Box::pin(end_after(connection, limit)))
        // `before_acquire` also checks that the connection works.
        .test_before_acquire(false)
        .before_acquire(move |connection, _| {
            Box::pin(async move { end_after(connection, limit).await.map(|()| true) })
        })
        .connect_lazy_with(options.clone())
}

/// Interrupts a statement on the connection once the limit has passed.
async fn end_after(connection: &mut SqliteConnection, limit: Duration) -> Result<(), sqlx::Error> {
    let end = Instant::now() + limit + GRACE;
    let mut connection = connection.lock_handle().await?;
    connection.set_progress_handler(INSTRUCTIONS, move || Instant::now() < end);
    Ok(())
}

fn postgres(options: PgConnectOptions, count: u32) -> PgPool {
    PgPoolOptions::new()
        .max_connections(count)
        .acquire_timeout(DEADLINE)
        .after_connect(|connection, _| {
            Box::pin(async { sqlx::query(POSTGRES_DURABLE).execute(connection).await.map(drop) })
        })
        .connect_lazy_with(options)
}

impl fmt::Debug for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Sqlite { .. } => "Sqlite",
            Self::Postgres { .. } => "Postgres",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// When lists time out on all their connections, these connections serve again at once, and
    /// other reads never wait.
    #[tokio::test]
    async fn a_read_whose_time_is_over_ends_in_the_database() {
        let folder = tempfile::tempdir().unwrap();
        let url = format!("sqlite://{}?mode=rwc", folder.path().join("graphfix.db").display());
        let Database::Sqlite(options) = Database::parse(&url).unwrap() else { panic!("SQLite") };
        let limit = Duration::from_millis(50);
        let listers = sqlite_readers(&options, 1, limit);
        let endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) \
                       SELECT COUNT(*) FROM n";
        for _ in 0..3 {
            let read = sqlx::query_scalar::<_, i64>(endless).fetch_one(&listers);
            let begun = Instant::now();
            assert!(tokio::time::timeout(limit, read).await.is_err());
            let next: i64 = sqlx::query_scalar("SELECT 1").fetch_one(&listers).await.unwrap();
            assert_eq!(next, 1);
            assert!(begun.elapsed() < Duration::from_secs(3), "{:?}", begun.elapsed());
        }
    }
}
