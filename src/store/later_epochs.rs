//! Base epochs that another node of the cluster has stored.

use super::bases::stored_epoch;
use super::deadline::{BULK_DEADLINE, within};
use super::pool::Pool;
use super::{BaseKey, Store, StoreError, StoredBaseEpoch};

const LATER: &str = "SELECT e.base, e.number, e.gps_time_ns, e.stored_unix_ms, e.content \
    FROM UNNEST($1::bigint[], $2::bigint[]) AS k(base, newest) \
    JOIN base_epochs e ON e.base = k.base AND k.newest < e.number ORDER BY e.base, e.number";

/// An epoch of a base, and when it was stored (ms since 1970-01-01 UTC).
pub(crate) type LaterEpoch = (BaseKey, StoredBaseEpoch, i64);

impl Store {
    /// The epochs of bases after those of these numbers, in order of base and number; none without
    /// a server.
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
        let rows: Result<Vec<(i64, i64, i64, i64, Vec<u8>)>, _> =
            within(BULK_DEADLINE, select).await;
        let rows = rows.map_err(StoreError::database("reading epochs of bases"))?;
        let read = |(base, number, ns, unix_ms, content)| {
            Ok((BaseKey(base), stored_epoch(number, ns, content)?, unix_ms))
        };
        rows.into_iter().map(read).collect()
    }
}
