//! Partitions of the log by day of arrival, on Postgres.
//!
//! Epochs and revisions of a day, or of some days, are in partitions of their own, and `day` is the
//! first of these days. So retention drops days at once: no row is deleted singly, and the disk
//! gets its space back. The committer makes the partitions of a day before its first commit. Rows
//! that are kept longer, because their session has a longer retention, are moved to the partition
//! without a day.
//!
//! A read of a session by number looks into every partition and locks it, and a server has room for
//! 6,400 locks by default. So the longer the retention, the more days have one partition.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use sqlx::{Connection, PgConnection, PgPool};
use tokio::time::sleep;

use super::deadline::{BULK_DEADLINE, DEADLINE, within};
use super::pool::Pool;
use super::{Store, StoreError};

/// The partitioned tables, each with the columns that are unique in a partition.
const TABLES: [(&str, &str); 2] =
    [("epochs", "session, seq"), ("revisions", "session, seq, revision")];
/// Days of a table's partitions, since 1970-01-01.
const DAYS: &str = "SELECT TO_DATE(SUBSTRING(relname FROM '_([0-9]{8})$'), 'YYYYMMDD') \
    - DATE '1970-01-01' FROM pg_inherits JOIN pg_class ON pg_class.oid = inhrelid \
    WHERE inhparent = $1::regclass AND relname ~ '_[0-9]{8}$' ORDER BY 1";
/// Makes nodes of a cluster wait for each other when they make the partitions of a day.
const MAKE_IN_TURN: &str =
    "SELECT pg_advisory_xact_lock(hashtextextended('graphfix days ' || current_schema(), 0))";
/// A table can be dropped only while nobody reads it. A drop waits for this time at most, because
/// later readers wait behind it.
const DROP_PATIENCE: &str = "SET LOCAL lock_timeout = '200ms'";
/// SQLSTATE of a lock that was not granted in time.
const LOCK_NOT_AVAILABLE: &str = "55P03";
/// Rows moved in one transaction, so that it takes only some milliseconds.
const ROWS_PER_STEP: i64 = 500;
/// Pause between transactions, so that those of others come in between.
const PAUSE: Duration = Duration::from_millis(20);
const SESSIONS_PER_READ: i64 = 100;

/// About the number of partitions of each table that a retention needs.
const PARTITIONS: u32 = 30;
/// Days in a partition if epochs are kept for ever.
const DAYS_FOR_EVER: u32 = 30;
/// Days that can be stored: from 1970-01-01 to 9999-12-31.
const STORED: std::ops::RangeInclusive<i64> = 0..=2_932_896;

/// Days in a partition, where epochs are kept for `retention_days`; 0 for ever.
const fn days_in_partition(retention_days: u32) -> i64 {
    match retention_days {
        0 => DAYS_FOR_EVER as i64,
        1..PARTITIONS => 1,
        days => (days / PARTITIONS) as i64,
    }
}

/// When epochs arrived (days since 1970-01-01 UTC).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// The day.
    pub day: i64,
    /// First day of the partition in which they are stored on Postgres.
    pub partition: i64,
}

impl Arrival {
    /// An arrival on this day, where epochs are kept for `retention_days`; 0 for ever.
    pub const fn on(day: i64, retention_days: u32) -> Self {
        Self { day, partition: day - day.rem_euclid(days_in_partition(retention_days)) }
    }

    /// The day as it is stored, if it can be.
    pub(super) fn stored_day(self) -> Option<i32> {
        Some(self.day).filter(|day| STORED.contains(day)).map(|day| day as i32)
    }

    /// First day of the partition as it is stored; `None` if the day has no partition.
    pub(super) fn stored_partition(self) -> Option<i32> {
        self.stored_day().map(|_| self.partition as i32)
    }
}

/// The days whose partitions are known to exist.
#[derive(Debug, Default)]
pub(super) struct Days {
    known: Mutex<BTreeSet<i32>>,
}

impl Days {
    /// The given days whose partitions may not exist yet.
    pub(super) fn unknown(&self, days: impl IntoIterator<Item = i32>) -> BTreeSet<i32> {
        let known = self.known();
        days.into_iter().filter(|day| !known.contains(day)).collect()
    }

    /// Remembers days whose partitions have been committed.
    pub(super) fn learn(&self, days: BTreeSet<i32>) {
        self.known().extend(days);
    }

    /// Forgets all known days, after a failure or before a drop.
    pub(super) fn forget(&self) {
        self.known().clear();
    }

    fn known(&self) -> std::sync::MutexGuard<'_, BTreeSet<i32>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Makes the partitions of a day in a transaction. It does not block readers and writers of other
/// days, as `CREATE TABLE … PARTITION OF` would.
pub(super) async fn make_day(connection: &mut PgConnection, day: i32) -> Result<(), sqlx::Error> {
    sqlx::query(MAKE_IN_TURN).execute(&mut *connection).await?;
    let date = date(connection, day).await?;
    for (table, unique) in TABLES {
        let partition = partition(table, &date);
        let exists = sqlx::query_scalar("SELECT to_regclass($1) IS NOT NULL").bind(&partition);
        if exists.fetch_one(&mut *connection).await? {
            continue;
        }
        for sql in [
            format!("CREATE TABLE {partition} (LIKE {table})"),
            format!("CREATE UNIQUE INDEX ON {partition} ({unique})"),
            format!("ALTER TABLE {table} ATTACH PARTITION {partition} FOR VALUES IN ('{date}')"),
        ] {
            sqlx::query(&sql).execute(&mut *connection).await?;
        }
    }
    Ok(())
}

/// The date of a day since 1970-01-01, as `YYYY-MM-DD`.
async fn date(connection: &mut PgConnection, day: i32) -> Result<String, sqlx::Error> {
    let sql = "SELECT TO_CHAR(DATE '1970-01-01' + $1::integer, 'YYYY-MM-DD')";
    sqlx::query_scalar(sql).bind(day).fetch_one(connection).await
}

fn partition(table: &str, date: &str) -> String {
    format!("{table}_{}", date.replace('-', ""))
}

impl Store {
    /// Drops the partitions from which no row is kept any more. From those older than the service's
    /// retention it first moves the kept rows. A `retention_days` of 0 keeps all for ever.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn drop_days(
        &self,
        today: i64,
        retention_days: u32,
    ) -> Result<(), StoreError> {
        let Pool::Postgres { pool, .. } = &self.pool else { return Ok(()) };
        let dropping = async {
            for (table, _) in TABLES {
                let days = sqlx::query_scalar(DAYS).bind(table).fetch_all(pool);
                let days: Vec<i32> = within(BULK_DEADLINE, days).await?;
                for day in days {
                    let last_day = i64::from(day) + days_in_partition(retention_days) - 1;
                    let age = today - last_day;
                    // A session's epochs are kept for up to a day longer than its retention.
                    let is_due = retention_days != 0 && i64::from(retention_days) + 2 < age;
                    if 1 < age {
                        self.drop_day(pool, table, day, is_due).await?;
                    }
                }
            }
            Ok(())
        };
        dropping.await.map_err(StoreError::database("dropping the days of the log"))
    }

    /// Drops a day of a table if none of its rows is kept. If `is_due`, kept rows are moved first.
    async fn drop_day(
        &self,
        pool: &PgPool,
        table: &str,
        day: i32,
        is_due: bool,
    ) -> Result<(), sqlx::Error> {
        let mut connection = pool.acquire().await?;
        let dropping = async {
            let date = within(DEADLINE, date(&mut connection, day)).await?;
            let partition = partition(table, &date);
            if is_due {
                move_kept(&mut connection, table, &partition).await?;
            }
            let is_kept = !kept_sessions(&mut connection, &partition, 1).await?.is_empty();
            if !is_kept && self.drop_partition(&mut connection, &partition).await? {
                tracing::info!(partition, "a day of the log is dropped");
            }
            Ok(())
        };
        let dropped = dropping.await;
        if dropped.is_err() {
            // Perhaps it is within a transaction, and the server does not answer any more. A closed
            // connection releases its locks.
            drop(connection.detach());
        }
        dropped
    }

    /// Drops a partition; `false` if it is in use, or if it has received rows that are kept. After
    /// an error the connection must be dropped.
    async fn drop_partition(
        &self,
        connection: &mut PgConnection,
        partition: &str,
    ) -> Result<bool, sqlx::Error> {
        within(BULK_DEADLINE, self.drop_partition_whole(connection, partition)).await
    }

    async fn drop_partition_whole(
        &self,
        connection: &mut PgConnection,
        partition: &str,
    ) -> Result<bool, sqlx::Error> {
        let mut transaction = connection.begin().await?;
        let dropping = async {
            sqlx::query(DROP_PATIENCE).execute(&mut *transaction).await?;
            // Nobody can write to it from now on, even if the clock was set back.
            let lock = format!("LOCK TABLE {partition} IN EXCLUSIVE MODE");
            sqlx::query(&lock).execute(&mut *transaction).await?;
            if !kept_sessions(&mut transaction, partition, 1).await?.is_empty() {
                return Ok(false);
            }
            self.days.forget(); // The committer makes it again, if it should need it.
            let drop = format!("DROP TABLE {partition}");
            sqlx::query(&drop).execute(&mut *transaction).await.map(|_| true)
        };
        match dropping.await {
            Ok(true) => {
                transaction.commit().await?;
                self.days.forget();
                Ok(true)
            }
            Ok(false) => transaction.rollback().await.map(|()| false),
            Err(error) => {
                let code = error.as_database_error().and_then(|e| e.code().map(|c| c.to_string()));
                transaction.rollback().await?;
                if code.as_deref() == Some(LOCK_NOT_AVAILABLE) { Ok(false) } else { Err(error) }
            }
        }
    }
}

/// Up to `count` sessions that have rows in a partition which are not removed.
async fn kept_sessions(
    connection: &mut PgConnection,
    partition: &str,
    count: i64,
) -> Result<Vec<i64>, sqlx::Error> {
    // The inner LIMIT makes the database search the index for each session.
    let sql = format!(
        "SELECT h.session FROM session_heads h CROSS JOIN LATERAL (SELECT 1 FROM {partition} p \
         WHERE p.session = h.session AND p.seq > COALESCE(h.removed_through, -1) LIMIT 1) kept \
         LIMIT $1"
    );
    let read = sqlx::query_scalar(&sql).bind(count).fetch_all(connection);
    within(BULK_DEADLINE, read).await
}

/// Moves the kept rows of a day to the partition without a day, in steps.
async fn move_kept(
    connection: &mut PgConnection,
    table: &str,
    partition: &str,
) -> Result<(), sqlx::Error> {
    let step = format!(
        "WITH step AS (SELECT p.seq FROM {partition} p JOIN session_heads h USING (session) \
         WHERE p.session = $1 AND p.seq > COALESCE(h.removed_through, -1) ORDER BY p.seq LIMIT $2) \
         UPDATE {table} SET day = NULL WHERE session = $1 AND seq IN (SELECT seq FROM step) \
         AND tableoid = '{partition}'::regclass"
    );
    // A revision that was stored on two days is kept once.
    let repeated = format!(
        "DELETE FROM {partition} p USING revisions_kept k WHERE p.session = $1 \
         AND k.session = $1 AND k.seq = p.seq AND k.revision = p.revision"
    );
    loop {
        let sessions = kept_sessions(connection, partition, SESSIONS_PER_READ).await?;
        if sessions.is_empty() {
            return Ok(());
        }
        for session in sessions {
            if table == "revisions" {
                let remove = sqlx::query(&repeated).bind(session);
                within(BULK_DEADLINE, remove.execute(&mut *connection)).await?;
            }
            loop {
                let step = sqlx::query(&step).bind(session).bind(ROWS_PER_STEP);
                let moved = within(BULK_DEADLINE, step.execute(&mut *connection)).await?;
                if moved.rows_affected() < ROWS_PER_STEP as u64 {
                    break;
                }
                sleep(PAUSE).await;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_day_is_in_a_partition_of_days_for_its_retention() {
        let first = |retention| Arrival::on(20_464, retention).partition;
        assert_eq!([1, 29, 30, 59].map(first), [20_464; 4]);
        // 20,464 = 3 · 6,821 + 1 = 12 · 1,705 + 4 = 30 · 682 + 4.
        assert_eq!([90, 365, 0].map(first), [20_463, 20_460, 20_460]);
    }

    /// Those of the retention, the two days of its margin, the present one, and one that is cut.
    #[test]
    fn no_retention_needs_many_partitions() {
        for retention_days in 1..10_000 {
            let days = days_in_partition(retention_days);
            let partitions = (i64::from(retention_days) + 3) / days + 2;
            assert!(partitions <= 64, "{partitions} for {retention_days} days");
        }
    }

    #[test]
    fn days_that_cannot_be_stored_have_no_partition() {
        for day in [-1, 2_932_897, i64::MAX] {
            assert_eq!(Arrival::on(day, 90).stored_partition(), None, "{day}");
        }
        assert_eq!(Arrival::on(0, 0).stored_partition(), Some(0));
    }
}
