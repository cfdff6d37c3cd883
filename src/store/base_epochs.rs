//! Reads the stored epochs of bases: all of one base, or those that other nodes have added.

use super::deadline::{BULK_DEADLINE, within};
use super::pool::{Pool, reading};
use super::{BaseKey, Store, StoreError, StoredBaseEpoch};

const LATER: &str = "SELECT e.base, e.number, e.gps_time_ns, e.stored_unix_ms, e.content \
    FROM UNNEST($1::bigint[], $2::bigint[]) AS k(base, newest) \
    JOIN base_epochs e ON e.base = k.base AND k.newest < e.number ORDER BY e.base, e.number";

/// Number, GPS time (ns), time of storage (ms) and content of a base epoch.
type BaseEpochRow = (i64, i64, i64, Vec<u8>);

/// A [`BaseEpochRow`] with the key of its base in front.
type LaterRow = (i64, i64, i64, i64, Vec<u8>);

/// An epoch of a base, and when it was stored (ms since 1970-01-01 UTC).
pub(crate) type LaterEpoch = (BaseKey, StoredBaseEpoch, i64);

impl Store {
    /// The stored epochs of a base in order, and when the last of them was stored (ms since
    /// 1970-01-01 UTC).
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn base_epochs(
        &self,
        base: BaseKey,
    ) -> Result<(Vec<StoredBaseEpoch>, Option<i64>), StoreError> {
        let rows: Result<Vec<BaseEpochRow>, _> = reading!(bulk &self.pool, pool => {
            let sql = "SELECT number, gps_time_ns, stored_unix_ms, content FROM base_epochs
                       WHERE base = $1 ORDER BY number";
            sqlx::query_as(sql).bind(base.0).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading a base's epochs"))?;
        let stored_unix_ms = rows.last().map(|(_, _, stored_unix_ms, _)| *stored_unix_ms);
        let read =
            |(number, ns, _, content): BaseEpochRow| StoredBaseEpoch::of_row(number, ns, content);
        Ok((rows.into_iter().map(read).collect::<Result<_, _>>()?, stored_unix_ms))
    }

    /// The epochs of bases after the given numbers, in order of base and number. Empty on SQLite,
    /// where no other node writes.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn base_epochs_after(
        &self,
        known: &[(BaseKey, u64)],
    ) -> Result<Vec<LaterEpoch>, StoreError> {
        let Pool::Postgres { pool, .. } = &self.pool else { return Ok(Vec::new()) };
        let (bases, newest): (Vec<i64>, Vec<i64>) =
            known.iter().map(|(base, newest)| (base.0, *newest as i64)).unzip();
        let select = sqlx::query_as(LATER).bind(bases).bind(newest).fetch_all(pool);
        let rows: Result<Vec<LaterRow>, _> = within(BULK_DEADLINE, select).await;
        let rows = rows.map_err(StoreError::database("reading epochs of bases"))?;
        let read = |(base, number, ns, unix_ms, content)| {
            Ok((BaseKey(base), StoredBaseEpoch::of_row(number, ns, content)?, unix_ms))
        };
        rows.into_iter().map(read).collect()
    }
}
