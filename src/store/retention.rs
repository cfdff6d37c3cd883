//! Removes epochs that are older than their session's retention, in steps.
//!
//! A session with a retention keeps the first snapshot of each day after the day on which it began.
//! Its epochs are removed up to the newest of these snapshots that is older than the retention, so
//! that the remaining epochs can be replayed. The first step hides all epochs that are to be
//! removed from readers.

use super::deletion::SNAPSHOTS_PER_STEP;
use super::pool::{Pool, reading, writing};
use super::{SessionKey, Store, StoreError, StoredSnapshot};

/// Selects sessions that have kept snapshots older than their retention, with the newest of these
/// and their count. `$1` is the day, `$2` the retention of sessions without one of their own.
macro_rules! expired {
    ($condition:literal) => {
        concat!(
            "SELECT x.session AS session, x.through AS through, CAST(0 AS BIGINT) FROM (",
            "SELECT k.session AS session, MAX(k.seq) AS through, ",
            "COUNT(DISTINCT k.seq) AS snapshots ",
            "FROM kept_snapshots k JOIN sessions s ON s.key = k.session ",
            "WHERE s.deleted_unix_ms IS NULL ",
            "AND COALESCE(s.retention_days, CAST($2 AS BIGINT)) > 0 AND k.day < ",
            "CAST($1 AS BIGINT) - COALESCE(s.retention_days, CAST($2 AS BIGINT)) ",
            "GROUP BY k.session) AS x JOIN session_heads h ON h.session = x.session WHERE ",
            $condition,
            " LIMIT $3"
        )
    };
}
/// Whether a session was closed longer ago than the retention of the service, and is not known to
/// be emptied. An index has these sessions by time.
macro_rules! closed_by_default {
    () => {
        "s.retention_days IS NULL AND s.emptied = 0 AND s.closed_unix_ms IS NOT NULL \
         AND CAST($2 AS BIGINT) > 0 AND s.deleted_unix_ms IS NULL \
         AND s.closed_unix_ms < 86400000 * (CAST($1 AS BIGINT) - CAST($2 AS BIGINT))"
    };
}
/// The same for sessions with a retention of their own.
macro_rules! closed_by_own {
    () => {
        "s.retention_days > 0 AND s.emptied = 0 AND s.closed_unix_ms IS NOT NULL \
         AND CAST($2 AS BIGINT) >= 0 AND s.deleted_unix_ms IS NULL \
         AND (s.closed_unix_ms + 86400000 * CAST(s.retention_days AS BIGINT)) \
         < 86400000 * CAST($1 AS BIGINT)"
    };
}
/// Selects such sessions, with their last number.
macro_rules! expired_closed {
    ($closed:expr, $condition:literal) => {
        concat!(
            "SELECT s.key AS session, COALESCE(h.last_seq, 0) AS through, CAST(1 AS BIGINT) ",
            "FROM sessions s JOIN session_heads h ON h.session = s.key WHERE ",
            $closed,
            $condition,
            " LIMIT $3"
        )
    };
}
/// Those whose heads are not marked yet.
const TO_MARK: [&str; 3] = [
    expired!("x.through > COALESCE(h.removed_through, -1)"),
    expired_closed!(closed_by_default!(), " AND h.last_seq > COALESCE(h.removed_through, -1)"),
    expired_closed!(closed_by_own!(), " AND h.last_seq > COALESCE(h.removed_through, -1)"),
];
/// Those with rows to remove, and closed sessions until they are noted as emptied. Epochs may have
/// gone with their partition, and minutes not.
const TO_REMOVE: [&str; 3] = [
    expired!(
        "(x.snapshots > 1 OR EXISTS \
         (SELECT 1 FROM epochs e WHERE e.session = x.session AND e.seq <= x.through) \
         OR (SELECT m.last_seq FROM rollups m WHERE m.session = x.session AND m.seconds = 60 \
         ORDER BY m.begin_s LIMIT 1) <= x.through)"
    ),
    expired_closed!(closed_by_default!(), ""),
    expired_closed!(closed_by_own!(), ""),
];
/// Marks epochs as removed. `stored_bytes` shrinks in proportion to the numbers of the epochs,
/// which need not begin at 1.
const MARK: &str = "UPDATE session_heads SET removed_through = $2, stored_bytes = \
    CASE WHEN last_seq > $2 THEN CAST(stored_bytes * (1.0 * (last_seq - $2) \
    / (last_seq - COALESCE(removed_through, \
    (SELECT MIN(seq) - 1 FROM epochs WHERE epochs.session = session_heads.session), 0))) \
    AS BIGINT) ELSE 0 END \
    WHERE session = $1 AND (removed_through IS NULL OR removed_through < $2)";
/// Number of the last epoch that a step removes.
const LAST_OF_STEP: &str = "SELECT seq FROM epochs WHERE session = $1 AND seq <= $2 \
    ORDER BY seq LIMIT 1 OFFSET $3";
const REMOVE: [&str; 2] = [
    "DELETE FROM revisions WHERE session = $1 AND seq <= $2",
    "DELETE FROM epochs WHERE session = $1 AND seq <= $2",
];
/// Removes some minutes without any remaining epoch. Hours are kept.
///
/// The outer condition repeats `last_seq`: a commit may have added later epochs to a minute since
/// it was selected, and Postgres then compares the new row with the outer condition only.
const REMOVE_MINUTES: &str = "DELETE FROM rollups WHERE session = $1 AND seconds = 60 \
    AND last_seq <= $2 AND begin_s IN (SELECT begin_s FROM rollups \
    WHERE session = $1 AND seconds = 60 AND last_seq <= $2 LIMIT $3)";
/// Removes some snapshots. The one from which the remaining epochs are replayed is kept, if there
/// are any.
const REMOVE_SNAPSHOTS: &str = "DELETE FROM kept_snapshots WHERE session = $1 \
    AND day IN (SELECT day FROM kept_snapshots WHERE session = $1 AND (seq < $2 \
    OR EXISTS (SELECT 1 FROM session_heads h WHERE h.session = $1 \
    AND h.closed_unix_ms IS NOT NULL AND h.last_seq <= $2)) LIMIT $3)";
/// Removes the state of a closed session, which needs it no more.
const REMOVE_STATE: &str = "DELETE FROM snapshots WHERE session = $1 AND EXISTS \
    (SELECT 1 FROM session_heads h WHERE h.session = $1 AND h.closed_unix_ms IS NOT NULL)";
/// Notes that nothing of a closed session is left, unless it was deleted meanwhile: its head is
/// then still to be removed.
const NOTE_EMPTIED: &str =
    "UPDATE sessions SET emptied = 1 WHERE key = $1 AND deleted_unix_ms IS NULL";

/// Sessions per query.
const SESSIONS: i64 = 100;
/// While more than a quarter of the pages of a file is free, each step gives this many back to the
/// disk (2 MiB). The other free pages are used again.
const PAGES_PER_STEP: &str = "PRAGMA incremental_vacuum(512)";
const FREE_FRACTION: i64 = 4;

/// A session with epochs that are older than its retention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expired {
    /// Primary key of the session.
    pub session: SessionKey,
    /// Number of the last epoch to remove.
    pub through: u64,
    /// Whether all that is stored of it expires, because it is closed.
    pub is_whole: bool,
}

impl Store {
    /// Some of the sessions that have epochs older than their retention on this day since
    /// 1970-01-01. Sessions without a retention of their own have `days`; 0 keeps everything.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn expired(&self, today: i64, days: u32) -> Result<Vec<Expired>, StoreError> {
        self.found_expired(&TO_REMOVE, today, days).await
    }

    /// Marks the epochs that are older than their retention as removed: no reader finds them.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn mark_expired(&self, today: i64, days: u32) -> Result<(), StoreError> {
        loop {
            let found = self.found_expired(&TO_MARK, today, days).await?;
            if found.is_empty() {
                return Ok(());
            }
            let mut all = Ok(());
            // One at a time: a transaction that locks several heads could deadlock with a commit.
            for Expired { session, through, .. } in found {
                let marked = writing!(&self.pool, pool => {
                    let mark = sqlx::query(MARK).bind(session.0).bind(through as i64);
                    mark.execute(pool).await.map(drop)
                });
                all = all.and(marked); // A failure must not keep the epochs of other sessions.
            }
            all.map_err(StoreError::database("marking expired epochs"))?;
        }
    }

    async fn found_expired(
        &self,
        queries: &[&'static str],
        today: i64,
        days: u32,
    ) -> Result<Vec<Expired>, StoreError> {
        let mut found = Vec::new();
        for sql in queries {
            let rows: Result<Vec<(i64, i64, i64)>, _> = reading!(bulk &self.pool, pool => {
                sqlx::query_as(sql)
                    .bind(today)
                    .bind(i64::from(days))
                    .bind(SESSIONS)
                    .fetch_all(pool)
                    .await
            });
            let rows = rows.map_err(StoreError::database("finding expired epochs"))?;
            let expired = |(session, through, is_whole): (i64, i64, i64)| Expired {
                session: SessionKey(session),
                through: through as u64,
                is_whole: is_whole != 0,
            };
            found.extend(rows.into_iter().map(expired));
        }
        Ok(found)
    }

    /// Removes up to `epochs` of the expired epochs of a session. Returns whether some remain. If
    /// none does, a closed session is noted as emptied: `expired` does not find it again.
    ///
    /// # Errors
    /// The database fails.
    pub async fn remove_expired(
        &self,
        expired: &Expired,
        epochs: usize,
    ) -> Result<bool, StoreError> {
        let (key, through) = (expired.session.0, expired.through as i64);
        let remaining = writing!(&self.pool, pool => {
            let step = async {
                let mut transaction = pool.begin().await?;
                sqlx::query(MARK).bind(key).bind(through).execute(&mut *transaction).await?;
                let last = sqlx::query_scalar(LAST_OF_STEP).bind(key).bind(through);
                let last: Option<i64> =
                    last.bind(epochs as i64 - 1).fetch_optional(&mut *transaction).await?;
                for sql in REMOVE {
                    let remove = sqlx::query(sql).bind(key).bind(last.unwrap_or(through));
                    remove.execute(&mut *transaction).await?;
                }
                let mut is_more = last.is_some();
                if !is_more {
                    let remove = sqlx::query(REMOVE_MINUTES).bind(key).bind(through);
                    let removed = remove.bind(epochs as i64).execute(&mut *transaction).await?;
                    is_more = removed.rows_affected() == epochs as u64;
                }
                if !is_more {
                    let rows = epochs.min(SNAPSHOTS_PER_STEP);
                    let remove = sqlx::query(REMOVE_SNAPSHOTS).bind(key).bind(through);
                    let removed = remove.bind(rows as i64).execute(&mut *transaction).await?;
                    is_more = removed.rows_affected() == rows as u64;
                }
                if !is_more {
                    sqlx::query(REMOVE_STATE).bind(key).execute(&mut *transaction).await?;
                    if expired.is_whole {
                        sqlx::query(NOTE_EMPTIED).bind(key).execute(&mut *transaction).await?;
                    }
                }
                transaction.commit().await?;
                Ok(is_more)
            };
            step.await
        });
        remaining.map_err(StoreError::database("removing expired epochs"))
    }

    /// Gives some free pages of a file back to the disk, if many are free. Returns whether there
    /// may be more. A Postgres server does this itself.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn release_pages(&self) -> Result<bool, StoreError> {
        let Pool::Sqlite { .. } = &self.pool else { return Ok(false) };
        let failed = StoreError::database("giving pages back to the disk");
        let counts: Result<(i64, i64), _> = reading!(&self.pool, pool => {
            let sql = "SELECT (SELECT freelist_count FROM pragma_freelist_count()),
                              (SELECT page_count FROM pragma_page_count())";
            sqlx::query_as(sql).fetch_one(pool).await
        });
        let (free, pages) = counts.map_err(StoreError::database("counting free pages"))?;
        if FREE_FRACTION * free <= pages {
            return Ok(false);
        }
        let released = writing!(&self.pool, pool => {
            sqlx::query(PAGES_PER_STEP).fetch_all(pool).await.map(drop)
        });
        released.map_err(failed)?;
        let left: Result<i64, _> = reading!(&self.pool, pool => {
            let sql = "SELECT freelist_count FROM pragma_freelist_count()";
            sqlx::query_scalar(sql).fetch_one(pool).await
        });
        // A file of an earlier version cannot give pages back.
        Ok(left.map_err(StoreError::database("counting free pages"))? < free)
    }

    /// Number of the last epoch of a session that is removed.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn removed_through(
        &self,
        session: SessionKey,
    ) -> Result<Option<u64>, StoreError> {
        let seq: Result<Option<i64>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT removed_through FROM session_heads WHERE session = $1";
            sqlx::query_scalar(sql).bind(session.0).fetch_one(pool).await
        });
        let seq = seq.map_err(StoreError::database("reading what is removed of a session"))?;
        Ok(seq.map(|seq| seq as u64))
    }

    /// The snapshots that a session keeps for replay, the oldest first.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn kept_snapshots(
        &self,
        session: SessionKey,
    ) -> Result<Vec<StoredSnapshot>, StoreError> {
        let rows: Result<Vec<(i64, String, Vec<u8>)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT seq, configuration_hash, content FROM kept_snapshots
                       WHERE session = $1 ORDER BY seq";
            sqlx::query_as(sql).bind(session.0).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading kept snapshots"))?;
        let snapshot = |(seq, hash, content): (i64, String, Vec<u8>)| StoredSnapshot {
            seq: seq as u64,
            configuration_hash: hash.into(),
            content,
        };
        Ok(rows.into_iter().map(snapshot).collect())
    }
}

#[cfg(test)]
mod tests {
    use sqlx::{Connection, Row, SqliteConnection};

    use super::*;

    /// The search for closed sessions reads an index that has those with something to remove by
    /// time, and no other session.
    #[tokio::test]
    async fn closed_sessions_are_found_by_the_time_at_which_they_are_due() {
        let mut database = SqliteConnection::connect("sqlite::memory:").await.unwrap();
        sqlx::migrate!("migrations/sqlite").run_direct(&mut database).await.unwrap();
        let closed = |queries: &[&'static str]| {
            let both = queries[queries.len() - 2..].iter().copied();
            both.zip(["sessions_to_empty", "sessions_to_empty_by_own_retention"])
                .collect::<Vec<_>>()
        };
        let all = [closed(&TO_MARK), closed(&TO_REMOVE)].concat();
        for (sql, index) in all {
            let explain = format!("EXPLAIN QUERY PLAN {sql}");
            let plan = sqlx::query(&explain).bind(20_000).bind(90).bind(SESSIONS);
            let plan = plan.fetch_all(&mut database).await.unwrap();
            let steps: Vec<String> = plan.iter().map(|step| step.get("detail")).collect();
            let range = format!("SEARCH s USING INDEX {index} (");
            assert!(steps.iter().any(|step| step.starts_with(&range)), "{steps:?} of {sql}");
            assert!(!steps.iter().any(|step| step.starts_with("SCAN")), "{steps:?} of {sql}");
        }
    }
}
