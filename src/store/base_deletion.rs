//! Deletes bases: no session finds them any more, and their rows are removed in steps.

use super::audit::note;
use super::notices::{Change, notify};
use super::pool::{Pool, reading, writing};
use super::{AuditEntry, BaseKey, Store, StoreError};

/// Waits until no transaction stores a session that names the base, on Postgres. Only a later
/// statement sees this session.
const LOCK: &str = "SELECT key FROM bases WHERE key = $1 FOR UPDATE";
/// Does nothing if an open session uses the base.
const DELETE: &str = "UPDATE bases SET deleted_unix_ms = $2, archive = NULL, request_name = NULL
    WHERE key = $1 AND NOT EXISTS (SELECT 1 FROM sessions
    WHERE sessions.base = bases.key AND closed_unix_ms IS NULL)
    AND NOT EXISTS (SELECT 1 FROM session_bases JOIN sessions ON sessions.key = session
    WHERE session_bases.base = bases.key AND closed_unix_ms IS NULL)";
const DELETE_FEED: &str = "DELETE FROM base_feeds WHERE base = $1";

const DELETED: &str = "SELECT key FROM bases WHERE deleted_unix_ms IS NOT NULL \
    AND (EXISTS (SELECT 1 FROM base_epochs WHERE base = key) \
    OR EXISTS (SELECT 1 FROM base_sites WHERE base = key)) LIMIT 1";
/// Their numbers are consecutive.
const REMOVE_OLDEST: &str = "DELETE FROM base_epochs WHERE base = $1 \
    AND number < (SELECT MIN(number) FROM base_epochs WHERE base = $1) + $2";
const REMOVE_SITES: &str = "DELETE FROM base_sites WHERE base = $1";

impl Store {
    /// Deletes a base, unless an open session uses it. Returns whether it did.
    /// [`Self::remove_epochs_of_deleted_bases`] frees its space.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn delete_base(
        &self,
        base: BaseKey,
        unix_ms: i64,
        entry: Option<&AuditEntry>,
    ) -> Result<bool, StoreError> {
        let deleted = writing!(&self.pool, pool => {
            let deleted = async {
                let mut transaction = pool.begin().await?;
                if let Pool::Postgres { .. } = &self.pool {
                    sqlx::query(LOCK).bind(base.0).execute(&mut *transaction).await?;
                }
                let delete = sqlx::query(DELETE).bind(base.0).bind(unix_ms);
                let rows = delete.execute(&mut *transaction).await?.rows_affected();
                if rows == 1 {
                    sqlx::query(DELETE_FEED).bind(base.0).execute(&mut *transaction).await?;
                    note!(self, transaction, entry);
                    notify!(self, transaction, Change::Bases);
                }
                transaction.commit().await?;
                Ok::<bool, sqlx::Error>(rows == 1)
            };
            deleted.await
        });
        deleted.map_err(StoreError::database("deleting a base"))
    }

    /// Removes at most `epochs` epochs of one deleted base, or its sites if it has no epochs.
    /// Returns whether a deleted base had any.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn remove_epochs_of_deleted_bases(
        &self,
        epochs: usize,
    ) -> Result<bool, StoreError> {
        let failed = StoreError::database("removing epochs of deleted bases");
        let found: Result<Option<i64>, _> = reading!(&self.pool, pool => {
            sqlx::query_scalar(DELETED).fetch_optional(pool).await
        });
        let base = match found {
            Ok(Some(base)) => base,
            Ok(None) => return Ok(false),
            Err(error) => return Err(failed(error)),
        };
        let removed = writing!(&self.pool, pool => {
            let step = async {
                let remove = sqlx::query(REMOVE_OLDEST).bind(base).bind(epochs as i64);
                if remove.execute(pool).await?.rows_affected() == 0 {
                    sqlx::query(REMOVE_SITES).bind(base).execute(pool).await?;
                }
                Ok(())
            };
            step.await
        });
        removed.map(|()| true).map_err(failed)
    }
}
