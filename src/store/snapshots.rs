//! The newest snapshot of each session's state.

use std::sync::Arc;

use super::pool::reading;
use super::{SessionKey, Store, StoreError};

/// The newest snapshot of a session's state.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredSnapshot {
    /// Number of the epoch after which it was taken.
    pub seq: u64,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
    /// The state, as the session encodes it.
    pub content: Vec<u8>,
}

impl Store {
    /// The newest snapshot of a session, if any is stored.
    ///
    /// # Errors
    /// The database fails.
    pub async fn snapshot(
        &self,
        session: SessionKey,
    ) -> Result<Option<StoredSnapshot>, StoreError> {
        let row: Result<Option<(i64, String, Vec<u8>)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT seq, configuration_hash, content FROM snapshots WHERE session = $1";
            sqlx::query_as(sql).bind(session.0).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a session's state"))?;
        Ok(row.map(|(seq, hash, content)| StoredSnapshot {
            seq: seq as u64,
            configuration_hash: hash.into(),
            content,
        }))
    }
}
