//! The newest snapshot of each session's state, and the epochs after it, from which a session is
//! restored.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use sqlx::PgPool;

use super::deadline::{DEADLINE, within};
use super::epochs::{RawEpoch, SELECT_AFTER, select_epochs};
use super::joined::{Joined, Rules, in_order};
use super::pool::reading;
use super::{SessionKey, Store, StoreError, StoredEpoch};

const READING: &str = "reading a session's state";
/// Sessions in a statement. Each has a snapshot and epochs of up to some hundred kilobytes.
const SESSIONS: usize = 16;
/// Time between statements. A state is read faster than a session is restored from it, so without a
/// pause most statements would be for one session. It is as long as a few restores take.
const PAUSE: Duration = Duration::from_millis(10);

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

/// The stored rows from which a session is restored.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StoredState {
    /// The newest snapshot.
    pub(crate) snapshot: Option<StoredSnapshot>,
    /// All epochs after the snapshot are in partitions that begin on this day (since 1970-01-01
    /// UTC) or later, if known.
    pub(crate) since_day: Option<i64>,
    /// Whether the session may have begun a new arc.
    pub(crate) has_arcs: bool,
    /// The first epochs after the snapshot, up to [`Self::EPOCHS`]; none without one.
    pub(crate) epochs: Vec<StoredEpoch>,
}

impl StoredState {
    /// Most epochs that are read with a state.
    pub(crate) const EPOCHS: usize = 256;
}

/// Selects the columns of [`RawState`].
macro_rules! select_states {
    ($condition:literal) => {
        concat!(
            "SELECT session, seq, configuration_hash, content, since_day, ",
            "EXISTS (SELECT 1 FROM session_arcs a WHERE a.session = s.session) AS has_arcs ",
            "FROM snapshots s WHERE session ",
            $condition
        )
    };
}
/// The first epochs of sessions after a number, of the partitions that begin on a day or later.
/// Rows without a day are older ones that are kept for longer.
///
/// The condition on the first day of all, `$5`, lets the server leave partitions out before it
/// locks them.
const SELECT_OF_ALL: &str = concat!(
    "SELECT w.session AS session, x.* FROM UNNEST($1::bigint[], $2::bigint[], $3::integer[]) ",
    "AS w (session, seq, day) CROSS JOIN LATERAL (",
    select_epochs!(
        of "w.session",
        "AND e.seq > w.seq \
         AND (e.day >= DATE '1970-01-01' + w.day OR e.day IS NULL) \
         AND (e.day >= DATE '1970-01-01' + $5::integer OR e.day IS NULL) \
         ORDER BY e.seq LIMIT $4"
    ),
    ") AS x"
);

#[derive(Clone, sqlx::FromRow)]
pub(super) struct RawState {
    session: i64,
    seq: i64,
    configuration_hash: String,
    content: Vec<u8>,
    since_day: Option<i32>,
    has_arcs: bool,
}

/// An epoch of one of several sessions.
#[derive(sqlx::FromRow)]
struct EpochOf {
    session: i64,
    #[sqlx(flatten)]
    epoch: RawEpoch,
}

/// A session's snapshot with the epochs after it; `None` without a snapshot.
type Read = Option<(RawState, Vec<RawEpoch>)>;

/// Reads the states of several sessions at once.
pub(super) type JoinedStates = Joined<SessionKey, Read>;

impl JoinedStates {
    /// Reads from a Postgres server.
    pub(super) fn of(pool: &PgPool) -> Arc<Self> {
        let pool = pool.clone();
        let limit = DEADLINE;
        let rules = Rules { operation: READING, keys_max: SESSIONS, pause: PAUSE, limit };
        Joined::new(rules, move |sessions| {
            let pool = pool.clone();
            async move {
                let read = within(DEADLINE, read_states(&pool, &sessions)).await;
                read.map_err(StoreError::database(READING))
            }
        })
    }
}

/// Reads the states of these sessions, on one connection.
async fn read_states(pool: &PgPool, sessions: &[SessionKey]) -> Result<Vec<Read>, sqlx::Error> {
    let keys: Vec<i64> = sessions.iter().map(|session| session.0).collect();
    let mut connection = pool.acquire().await?;
    let select = sqlx::query_as(select_states!("= ANY($1)")).bind(&keys);
    let states: Vec<RawState> = select.fetch_all(&mut *connection).await?;
    // Of the state of an earlier version no day is known: its epochs may be in all partitions.
    let days: Vec<i32> = states.iter().map(|state| state.since_day.unwrap_or(0)).collect();
    let rows: Vec<EpochOf> = sqlx::query_as(SELECT_OF_ALL)
        .bind(states.iter().map(|state| state.session).collect::<Vec<_>>())
        .bind(states.iter().map(|state| state.seq).collect::<Vec<_>>())
        .bind(&days)
        .bind(StoredState::EPOCHS as i64)
        .bind(days.iter().min().copied().unwrap_or(0))
        .fetch_all(&mut *connection)
        .await?;
    let mut read: HashMap<i64, (RawState, Vec<RawEpoch>)> =
        states.into_iter().map(|state| (state.session, (state, Vec::new()))).collect();
    for EpochOf { session, epoch } in rows {
        if let Some((_, epochs)) = read.get_mut(&session) {
            epochs.push(epoch);
        }
    }
    Ok(in_order(&keys, read))
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

    /// The rows from which a session is restored: its newest snapshot, and the first epochs after
    /// it. On Postgres the rows of several sessions are read at once.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn stored_state(
        &self,
        session: SessionKey,
    ) -> Result<StoredState, StoreError> {
        let read = match &self.states {
            Some(states) => states.value(session).await?,
            None => self.read_state(session).await?,
        };
        let Some((state, rows)) = read else {
            let (snapshot, since_day, epochs) = (None, None, Vec::new());
            return Ok(StoredState { snapshot, since_day, has_arcs: true, epochs });
        };
        let RawState { seq, configuration_hash, content, since_day, has_arcs, .. } = state;
        let (seq, configuration_hash) = (seq as u64, configuration_hash.into());
        let snapshot = Some(StoredSnapshot { seq, configuration_hash, content });
        let (since_day, epochs) = (since_day.map(i64::from), self.decoded(session, rows).await?);
        Ok(StoredState { snapshot, since_day, has_arcs, epochs })
    }

    /// Reads the state of one session, on one connection.
    async fn read_state(&self, session: SessionKey) -> Result<Read, StoreError> {
        let read = reading!(&self.pool, pool => {
            let reading = async {
                let mut connection = pool.acquire().await?;
                let select = sqlx::query_as(select_states!("= $1")).bind(session.0);
                let state: Option<RawState> = select.fetch_optional(&mut *connection).await?;
                let Some(state) = state else { return Ok(None) };
                let select = sqlx::query_as(SELECT_AFTER).bind(session.0).bind(state.seq);
                let select = select.bind(StoredState::EPOCHS as i64);
                let rows: Vec<RawEpoch> = select.fetch_all(&mut *connection).await?;
                Ok::<_, sqlx::Error>(Some((state, rows)))
            };
            reading.await
        });
        read.map_err(StoreError::database(READING))
    }
}
