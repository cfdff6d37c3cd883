//! Reads epochs with their first answers.

use tokio::task::coop::consume_budget;

use crate::gnss::Epoch;

use super::chain::Chain;
use super::codec::{CodecError, encode_epoch};
use super::deadline::{DEADLINE, within};
use super::pool::{Pool, reading};
use super::solutions::RawSolution;
use super::{BaseKey, BaseUse, SessionKey, Store, StoreError, StoredSolution};

/// A stored epoch with its real-time answer.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredEpoch {
    /// The epoch.
    pub epoch: Epoch,
    /// The real-time answer.
    pub solution: StoredSolution,
    /// Number of the last push of navigation data before it was solved.
    pub navigation: u64,
    /// The base epochs with which it was solved.
    pub base: Option<BaseUse>,
}

impl StoredEpoch {
    /// Whether `epoch` equals the stored one, bit by bit.
    pub(crate) fn is(&self, epoch: &Epoch) -> bool {
        encode_epoch(&self.epoch) == encode_epoch(epoch)
    }
}

#[derive(Clone, sqlx::FromRow)]
pub(super) struct RawEpoch {
    epoch: Vec<u8>,
    navigation: i64,
    base: Option<i64>,
    base_after: Option<i64>,
    base_through: Option<i64>,
    #[sqlx(flatten)]
    solution: RawSolution,
}

impl RawEpoch {
    /// The row, with its epoch decoded.
    fn parse(self, epoch: Epoch) -> Result<StoredEpoch, StoreError> {
        let base = self.base.map(|key| BaseUse {
            base: BaseKey(key),
            after: self.base_after.unwrap_or(0) as u64,
            through: self.base_through.unwrap_or(0) as u64,
        });
        if let Some(BaseUse { after, through, .. }) = base.filter(|used| used.through < used.after)
        {
            let why = format!("it has used the base epochs after {after} through {through}");
            return Err(StoreError::CorruptText { what: "epoch", why });
        }
        let navigation = self.navigation as u64;
        Ok(StoredEpoch { epoch, solution: self.solution.parse(None)?, navigation, base })
    }
}

/// Selects the columns of [`RawEpoch`] of the session `$1`, or of another one; other conditions
/// follow.
macro_rules! select_epochs {
    ($conditions:literal) => {
        $crate::store::epochs::select_epochs!(of "$1", $conditions)
    };
    (of $session:literal, $conditions:literal) => {
        concat!(
            "SELECT e.content AS epoch, e.navigation AS navigation, e.base AS base, ",
            "e.base_after AS base_after, e.base_through AS base_through, e.seq AS seq, ",
            "0 AS revision, e.gps_time_ns AS gps_time_ns, e.x_m AS x_m, e.y_m AS y_m, ",
            "e.z_m AS z_m, o.version AS version, o.configuration_hash AS configuration_hash, ",
            "e.solution AS content FROM epochs e JOIN session_heads h ON h.session = e.session ",
            "LEFT JOIN solution_origins o ON o.key = e.origin WHERE e.session = ",
            $session,
            " AND e.seq > COALESCE(h.removed_through, -1) ",
            $conditions
        )
    };
}
pub(super) use select_epochs;

/// The first `$3` epochs of a session after number `$2`.
pub(super) const SELECT_AFTER: &str = select_epochs!("AND e.seq > $2 ORDER BY e.seq LIMIT $3");

impl Store {
    /// The last `count` epochs of a session with their real-time answers, the newest first.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn last_epochs(
        &self,
        session: SessionKey,
        count: usize,
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        let rows: Result<Vec<RawEpoch>, _> = reading!(&self.pool, pool => sqlx::query_as(
            select_epochs!("ORDER BY e.seq DESC LIMIT $2"),
        )
        .bind(session.0)
        .bind(count as i64)
        .fetch_all(pool)
        .await);
        let rows = rows.map_err(StoreError::database("reading a session's last epochs"))?;
        let mut epochs = self.decoded(session, rows).await?;
        epochs.reverse();
        Ok(epochs)
    }

    /// The first `count` epochs of a session after number `after`, or from its first epoch, in
    /// order and with their real-time answers.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn epochs_after(
        &self,
        session: SessionKey,
        after: Option<u64>,
        count: usize,
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        let after = after.map_or(-1, |seq| i64::try_from(seq).unwrap_or(i64::MAX));
        let rows: Result<Vec<RawEpoch>, _> = reading!(&self.pool, pool => {
            let select = sqlx::query_as(SELECT_AFTER).bind(session.0).bind(after);
            select.bind(count as i64).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading a session's epochs"))?;
        self.decoded(session, rows).await
    }

    /// Like [`Self::epochs_after`], by the connections for lists.
    ///
    /// # Errors
    /// As for [`Self::epochs_after`].
    pub(crate) async fn listed_epochs_after(
        &self,
        session: SessionKey,
        after: Option<u64>,
        count: usize,
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        let lists = Self { pool: self.pool.for_lists(), ..self.clone() };
        lists.epochs_after(session, after, count).await
    }

    /// Number of the epoch that is followed by the last `count` epochs of the session, if there are
    /// that many.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn number_before_last(
        &self,
        session: SessionKey,
        count: usize,
    ) -> Result<Option<u64>, StoreError> {
        let row: Result<Option<(i64,)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT seq FROM epochs WHERE session = $1
                       ORDER BY seq DESC LIMIT 1 OFFSET $2";
            sqlx::query_as(sql).bind(session.0).bind(count as i64).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a session's epochs"))?;
        Ok(row.map(|(seq,)| seq as u64))
    }

    /// The stored ones of the epochs `seqs`, with their real-time answers.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn epochs(
        &self,
        session: SessionKey,
        seqs: &[u64],
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        let seqs: Vec<i64> = seqs.iter().filter_map(|seq| i64::try_from(*seq).ok()).collect();
        let rows = self.rows_of(session, seqs).await?;
        self.decoded(session, rows).await
    }

    async fn rows_of(
        &self,
        session: SessionKey,
        seqs: Vec<i64>,
    ) -> Result<Vec<RawEpoch>, StoreError> {
        let rows: Result<Vec<RawEpoch>, _> = match &self.pool {
            Pool::Sqlite { readers, .. } => {
                let list = serde_json::to_string(&seqs).expect("a list of numbers is JSON");
                let rows = sqlx::query_as(select_epochs!(
                    "AND e.seq IN (SELECT value FROM json_each($2))"
                ))
                .bind(session.0)
                .bind(list)
                .fetch_all(readers);
                within(DEADLINE, rows).await
            }
            Pool::Postgres { pool, .. } => {
                let sql = select_epochs!("AND e.seq = ANY($2)");
                let rows = sqlx::query_as(sql).bind(session.0).bind(seqs).fetch_all(pool);
                within(DEADLINE, rows).await
            }
        };
        rows.map_err(StoreError::database("reading epochs"))
    }

    /// Decodes rows in order of their numbers. A row is left out if it has expired since it was
    /// read, and other epochs of its chain have been removed.
    pub(super) async fn decoded(
        &self,
        session: SessionKey,
        mut rows: Vec<RawEpoch>,
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        rows.sort_unstable_by_key(|row| row.solution.seq);
        let mut chain = Chain::of(self, session);
        let mut epochs = Vec::with_capacity(rows.len());
        for row in rows {
            consume_budget().await; // Many rows don't hold the thread up.
            let seq = row.solution.seq as u64;
            match chain.decode(seq, &row.epoch).await {
                Err(error) if self.explains_missing(session, seq, &error).await? => {}
                decoded => epochs.push(row.parse(decoded?)?),
            }
        }
        Ok(epochs)
    }

    /// Whether the error means that a row needs another one, and both have been removed since the
    /// row was read.
    pub(super) async fn explains_missing(
        &self,
        session: SessionKey,
        seq: u64,
        error: &StoreError,
    ) -> Result<bool, StoreError> {
        let is_missing =
            matches!(error, StoreError::Corrupt { source: CodecError::ReferenceMissing, .. });
        if !is_missing {
            return Ok(false);
        }
        let removed: Result<bool, _> = reading!(&self.pool, pool => {
            let sql = "SELECT s.deleted_unix_ms IS NOT NULL
                           OR COALESCE(h.removed_through, -1) >= $2
                       FROM sessions s LEFT JOIN session_heads h ON h.session = s.key
                       WHERE s.key = $1";
            sqlx::query_scalar(sql).bind(session.0).bind(seq as i64).fetch_one(pool).await
        });
        removed.map_err(StoreError::database("reading what is removed of a session"))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use crate::store::sample::{answer, session, store};
    use crate::store::{EncodedEpoch, Expired, Revisions, SolutionQuery};

    use super::*;

    /// A session with three chains of epochs, the first two of 16.
    async fn chains(store: &Store) -> SessionKey {
        let mut epochs: Vec<EncodedEpoch> = Vec::new();
        for seq in 1..=40 {
            let answer = answer(seq, 0);
            let epoch = Arc::new(Epoch::new(answer.solution.time));
            let last = epochs.last().map(EncodedEpoch::reference);
            epochs.push(EncodedEpoch::new(epoch, &answer, 0, None, last));
        }
        session(store, epochs).await
    }

    /// Rows that expire between the read of the rows and that of their chains are not found. A gap
    /// in a chain for another reason means that its rows are corrupt.
    #[tokio::test]
    async fn epochs_that_expire_while_they_are_read_are_not_found() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(&folder).await;
        let key = chains(&store).await;
        let read = store.rows_of(key, vec![5, 10, 20]).await.unwrap();
        let expired = Expired { session: key, through: 16, is_whole: false };
        assert!(!store.remove_expired(&expired, 500).await.unwrap());
        let found = store.decoded(key, read).await.unwrap();
        assert_eq!(found.iter().map(|epoch| epoch.solution.seq).collect::<Vec<_>>(), [20]);

        let read = store.rows_of(key, vec![20]).await.unwrap();
        let Pool::Sqlite { writer, .. } = &store.pool else { panic!("SQLite") };
        sqlx::query("DELETE FROM epochs WHERE seq = 18").execute(writer).await.unwrap();
        let corrupt = store.decoded(key, read).await.unwrap_err();
        assert_eq!(corrupt.code().name(), "STORED_DATA_CORRUPT");
    }

    /// A row whose range of base epochs ends before it begins is corrupt.
    #[tokio::test]
    async fn an_epoch_with_a_reversed_range_of_base_epochs_is_corrupt() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(&folder).await;
        let key = chains(&store).await;
        let Pool::Sqlite { writer, .. } = &store.pool else { panic!("SQLite") };
        let damage = "UPDATE epochs SET base = 1, base_after = 7, base_through = 5 WHERE seq = 20";
        sqlx::query(damage).execute(writer).await.unwrap();
        let rows = store.rows_of(key, vec![20]).await.unwrap();
        let corrupt = store.decoded(key, rows).await.unwrap_err();
        assert_eq!(corrupt.code().name(), "STORED_DATA_CORRUPT");
        assert!(corrupt.to_string().contains("after 7 through 5"), "{corrupt}");
    }

    /// A revision whose first answer is missing is corrupt, unless both have expired.
    #[tokio::test]
    async fn a_revision_without_its_first_answer_is_corrupt_unless_it_expired() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(&folder).await;
        let key = chains(&store).await;
        let Pool::Sqlite { writer, .. } = &store.pool else { panic!("SQLite") };
        // Layout 7: relative to a first answer.
        let revision = "INSERT INTO revisions (session, seq, revision, gps_time_ns, status, content) \
                        VALUES (1, 8, 1, 0, 0, x'07')";
        sqlx::query(revision).execute(writer).await.unwrap();
        sqlx::query("DELETE FROM epochs WHERE seq = 8").execute(writer).await.unwrap();
        let query = SolutionQuery {
            from: None,
            to: None,
            status: None,
            revisions: Revisions::All,
            page_size: 100,
            page_token: None,
        };
        let corrupt = store.solutions(key, &query).await.unwrap_err();
        assert_eq!(corrupt.code().name(), "STORED_DATA_CORRUPT");
        assert!(!store.explains_missing(key, 8, &corrupt).await.unwrap());
        store
            .remove_expired(&Expired { session: key, through: 16, is_whole: false }, 500)
            .await
            .unwrap();
        assert!(store.explains_missing(key, 8, &corrupt).await.unwrap());
        assert!(!store.explains_missing(key, 17, &corrupt).await.unwrap());
        let listed = store.solutions(key, &query).await.unwrap().items;
        assert_eq!(listed.first().map(|solution| solution.seq), Some(17));
    }
}
