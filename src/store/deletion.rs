//! Deletes sessions: they are hidden from callers at once, and their rows are removed in steps.

use super::audit::note;
use super::pool::{Pool, reading, writing};
use super::{AuditEntry, SessionKey, Store, StoreError};

/// Something is left of it, also if its epochs have expired.
const DELETE: &str = "UPDATE sessions SET deleted_unix_ms = $2, request_name = NULL, emptied = 0 \
    WHERE key = $1";
/// An index has these sessions, and no others.
const TO_REMOVE: &str = "SELECT key FROM sessions \
    WHERE deleted_unix_ms IS NOT NULL AND emptied = 0 AND key > $1 ORDER BY key LIMIT 1";
/// Number of the epoch up to which a step removes epochs.
const LAST_OF_STEP: &str =
    "SELECT seq FROM epochs WHERE session = $1 ORDER BY seq LIMIT 1 OFFSET $2";
const REMOVE_REVISIONS: &str = "DELETE FROM revisions WHERE session = $1 AND seq <= $2";
const REMOVE_EPOCHS: &str = "DELETE FROM epochs WHERE session = $1 AND seq <= $2";
/// Removes some of the rows that a session may have many of.
const REMOVE_MINUTES: &str = "DELETE FROM rollups WHERE session = $1 AND seconds = 60 \
    AND begin_s IN (SELECT begin_s FROM rollups WHERE session = $1 AND seconds = 60 LIMIT $2)";
const REMOVE_KEPT: &str = "DELETE FROM kept_snapshots WHERE session = $1 \
    AND day IN (SELECT day FROM kept_snapshots WHERE session = $1 LIMIT $2)";
/// Snapshots removed in one step. Each may have hundreds of kilobytes.
pub(super) const SNAPSHOTS_PER_STEP: usize = 50;
/// Removes all other rows, once there are no epochs. Without its head a session is not found.
const REMOVE_REST: [&str; 9] = [
    "DELETE FROM rollups WHERE session = $1",
    "DELETE FROM revisions WHERE session = $1",
    "DELETE FROM snapshots WHERE session = $1",
    "DELETE FROM kept_snapshots WHERE session = $1",
    "DELETE FROM raw_pieces WHERE session = $1",
    "DELETE FROM raw_streams WHERE session = $1",
    "DELETE FROM session_arcs WHERE session = $1",
    "DELETE FROM session_bases WHERE session = $1",
    "DELETE FROM session_heads WHERE session = $1",
];
/// Selects the hours of the fleet to which the session contributes. On Postgres it locks them, in
/// the same order as the committer.
macro_rules! hours_of_fleet {
    ($lock:literal) => {
        concat!(
            "SELECT f.begin_s FROM fleet_hours f ",
            "WHERE f.tenant = (SELECT s.tenant FROM sessions s WHERE s.key = $1) ",
            "AND f.begin_s IN (SELECT r.begin_s FROM rollups r ",
            "WHERE r.session = $1 AND r.seconds = 3600) ORDER BY f.begin_s",
            $lock
        )
    };
}
/// Subtracts the session's hours from those of its fleet.
const LEAVE_FLEET: [&str; 2] = [
    "UPDATE fleet_hours SET sessions = fleet_hours.sessions - 1, \
     n_none = fleet_hours.n_none - r.n_none, n_single = fleet_hours.n_single - r.n_single, \
     n_ekf = fleet_hours.n_ekf - r.n_ekf, n_fgo = fleet_hours.n_fgo - r.n_fgo, \
     n_float = fleet_hours.n_float - r.n_float, n_fixed = fleet_hours.n_fixed - r.n_fixed, \
     positions = fleet_hours.positions - r.positions, ages = fleet_hours.ages - r.ages, \
     sigma_sum_m = fleet_hours.sigma_sum_m - r.sigma_sum_m, \
     satellites_sum = fleet_hours.satellites_sum - r.satellites_sum, \
     age_sum_s = fleet_hours.age_sum_s - r.age_sum_s \
     FROM rollups r JOIN sessions s ON s.key = r.session WHERE r.session = $1 \
     AND r.seconds = 3600 AND fleet_hours.tenant = s.tenant AND fleet_hours.begin_s = r.begin_s",
    "DELETE FROM fleet_hours WHERE sessions <= 0 \
     AND tenant = (SELECT s.tenant FROM sessions s WHERE s.key = $1)",
];
/// Erases the settings of a session, and notes that nothing is left of it. Its row and its id
/// remain.
const FORGET: &str = "UPDATE sessions SET label = '', overrides = '{}', configuration = '{}', \
    emptied = 1 WHERE key = $1";

impl Store {
    /// Deletes a closed session, so that it is not found any more, and writes `entry` to the audit
    /// log. [`Self::remove_deleted`] frees its space.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn delete_session(
        &self,
        session: SessionKey,
        unix_ms: i64,
        entry: Option<&AuditEntry>,
    ) -> Result<(), StoreError> {
        let deleted = writing!(&self.pool, pool => {
            let delete = async {
                let mut transaction = pool.begin().await?;
                let delete = sqlx::query(DELETE).bind(session.0).bind(unix_ms);
                delete.execute(&mut *transaction).await?;
                note!(self, transaction, entry);
                transaction.commit().await
            };
            delete.await
        });
        deleted.map_err(StoreError::database("deleting a session"))
    }

    /// The first deleted session after `after` of which something is left.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn deleted_session(
        &self,
        after: Option<SessionKey>,
    ) -> Result<Option<SessionKey>, StoreError> {
        let after = after.map_or(i64::MIN, |session| session.0);
        let found: Result<Option<i64>, _> = reading!(&self.pool, pool => {
            sqlx::query_scalar(TO_REMOVE).bind(after).fetch_optional(pool).await
        });
        let found = found.map_err(StoreError::database("finding deleted sessions"))?;
        Ok(found.map(SessionKey))
    }

    /// Removes up to `epochs` epochs of a deleted session, or its other rows if it has no epochs.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn remove_deleted(
        &self,
        session: SessionKey,
        epochs: usize,
    ) -> Result<(), StoreError> {
        let key = session.0;
        let lock = match &self.pool {
            Pool::Sqlite { .. } => hours_of_fleet!(""),
            Pool::Postgres { .. } => hours_of_fleet!(" FOR UPDATE"),
        };
        let removed = writing!(&self.pool, pool => {
            let step = async {
                let mut transaction = pool.begin().await?;
                let last = sqlx::query_scalar(LAST_OF_STEP).bind(key).bind(epochs as i64 - 1);
                let last: Option<i64> = last.fetch_optional(&mut *transaction).await?;
                let through = last.unwrap_or(i64::MAX);
                for sql in [REMOVE_REVISIONS, REMOVE_EPOCHS] {
                    let remove = sqlx::query(sql).bind(key).bind(through);
                    remove.execute(&mut *transaction).await?;
                }
                let mut is_more = last.is_some();
                for (sql, rows) in
                    [(REMOVE_MINUTES, epochs), (REMOVE_KEPT, epochs.min(SNAPSHOTS_PER_STEP))]
                {
                    if !is_more {
                        let remove = sqlx::query(sql).bind(key).bind(rows as i64);
                        let removed = remove.execute(&mut *transaction).await?;
                        is_more = removed.rows_affected() == rows as u64;
                    }
                }
                if !is_more {
                    sqlx::query(lock).bind(key).fetch_all(&mut *transaction).await?;
                    let rest = LEAVE_FLEET.into_iter().chain(REMOVE_REST).chain([FORGET]);
                    for sql in rest {
                        sqlx::query(sql).bind(key).execute(&mut *transaction).await?;
                    }
                }
                transaction.commit().await
            };
            step.await
        });
        removed.map_err(StoreError::database("removing deleted sessions"))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use sqlx::{Connection, Row, SqliteConnection};

    use crate::gnss::Epoch;
    use crate::store::EncodedEpoch;
    use crate::store::sample::{answer, session, store};

    use super::*;

    /// The last steps of a deletion remove some of the kept snapshots each.
    #[tokio::test]
    async fn kept_snapshots_are_removed_in_steps() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(&folder).await;
        let answer = answer(1, 0);
        let epoch = Arc::new(Epoch::new(answer.solution.time));
        let key = session(&store, vec![EncodedEpoch::new(epoch, &answer, 0, None, None)]).await;
        let Pool::Sqlite { writer, .. } = &store.pool else { panic!("SQLite") };
        let days = 2 * SNAPSHOTS_PER_STEP as i64 + 20;
        for day in 0..days {
            let keep = "INSERT INTO kept_snapshots (session, day, seq, configuration_hash, content)
                        VALUES ($1, $2, 1, '', x'00')";
            sqlx::query(keep).bind(key.0).bind(day).execute(writer).await.unwrap();
        }
        store.delete_session(key, 0, None).await.unwrap();
        let left = async |table: &str| -> i64 {
            let count = format!("SELECT COUNT(*) FROM {table}");
            sqlx::query_scalar(&count).fetch_one(writer).await.unwrap()
        };
        for (kept, heads) in [(70, 1), (20, 1), (0, 0)] {
            assert_eq!(store.deleted_session(None).await.unwrap(), Some(key));
            assert_eq!(store.deleted_session(Some(key)).await.unwrap(), None);
            store.remove_deleted(key, 500).await.unwrap();
            assert_eq!((left("kept_snapshots").await, left("session_heads").await), (kept, heads));
        }
        assert_eq!(store.deleted_session(None).await.unwrap(), None);
    }

    /// The search reads an index that has the sessions with something to remove, and no others.
    #[tokio::test]
    async fn deleted_sessions_are_found_by_their_index() {
        let mut database = SqliteConnection::connect("sqlite::memory:").await.unwrap();
        sqlx::migrate!("migrations/sqlite").run_direct(&mut database).await.unwrap();
        let explain = format!("EXPLAIN QUERY PLAN {TO_REMOVE}");
        let plan = sqlx::query(&explain).bind(0).fetch_all(&mut database).await.unwrap();
        let steps: Vec<String> = plan.iter().map(|step| step.get("detail")).collect();
        assert!(matches!(&steps[..], [step] if step.contains("sessions_to_remove")), "{steps:?}");
    }
}
