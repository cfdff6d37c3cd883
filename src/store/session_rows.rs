//! Reads sessions as rows.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use sqlx::PgPool;

use crate::tenant::Tenant;

use super::deadline::{DEADLINE, within};
use super::joined::{Joined, Rules, in_order};
use super::page::rows_asked;
use super::pool::{Pool, reading};
use super::session_filter::condition;
use super::sessions::{NEAREST_OF, options_from};
use super::{
    AntennaName, BaseChoice, BaseKey, BaseName, Page, SessionFilter, SessionKey, SessionRow,
    SessionSettings, Store, StoreError,
};

const PAGE_LIMIT: usize = 1_000;
const READING: &str = "reading a session";
const READING_BASES: &str = "reading a session's bases";
/// Sessions in a statement.
const ROWS: usize = 64;

#[derive(Clone, sqlx::FromRow)]
pub(super) struct RawSession {
    key: i64,
    id: String,
    tenant: String,
    label: String,
    mode: String,
    profile: String,
    overrides: String,
    configuration: String,
    configuration_hash: String,
    created_unix_ms: i64,
    closed_unix_ms: Option<i64>,
    last_seq: Option<i64>,
    raw_through: Option<i64>,
    removed_through: Option<i64>,
    retention_days: Option<i64>,
    base: Option<i64>,
    base_id: Option<String>,
    base_choice: i32,
    antenna: Option<String>,
    calibration: Option<String>,
}

/// A candidate base of a session: key of the session, key and id of the base.
type CandidateRow = (i64, i64, String);

/// The candidate bases of sessions by their keys, in the order that each session has.
type Candidates = HashMap<i64, Vec<BaseName>>;

impl RawSession {
    /// Decodes the row. It takes its bases from `candidates` if it uses the nearest of several.
    fn parse(self, candidates: &mut Candidates) -> Result<SessionRow, StoreError> {
        let base = match self.base_choice {
            0 => self.base.zip(self.base_id).map(|(key, id)| base_name(key, id)).into(),
            NEAREST_OF => BaseChoice::NearestOf(candidates.remove(&self.key).unwrap_or_default()),
            2 => BaseChoice::Nearest,
            other => {
                let why = format!("{other} is not a choice of bases");
                return Err(StoreError::CorruptText { what: "session", why });
            }
        };
        let antenna = self.antenna.zip(self.calibration);
        let antenna = antenna
            .map(|(name, calibration)| AntennaName { name, calibration: calibration.into() });
        Ok(SessionRow {
            key: SessionKey(self.key),
            id: self.id,
            tenant: Tenant::stored(&self.tenant),
            settings: SessionSettings {
                label: self.label,
                mode: self.mode,
                profile: self.profile,
                overrides: options_from(&self.overrides)?,
                configuration: options_from(&self.configuration)?,
                configuration_hash: self.configuration_hash.into(),
                base,
                antenna,
                retention_days: self.retention_days.map(|days| days as u32),
            },
            created_unix_ms: self.created_unix_ms,
            closed_unix_ms: self.closed_unix_ms,
            last_seq: self.last_seq.map(|seq| seq as u64),
            raw_through: self.raw_through.map(|through| through as u64),
            removed_through: self.removed_through.map(|seq| seq as u64),
        })
    }
}

/// Selects the columns of [`RawSession`]; a condition follows.
macro_rules! select_sessions {
    ($($condition:tt)+) => {
        concat!(
            "SELECT s.key AS key, id, tenant, label, mode, profile, overrides, configuration, ",
            "configuration_hash, created_unix_ms, h.closed_unix_ms AS closed_unix_ms, ",
            "last_seq, raw_through, removed_through, retention_days, ",
            "base, (SELECT id FROM bases WHERE bases.key = s.base) AS base_id, ",
            "base_choice, antenna, calibration ",
            "FROM sessions s JOIN session_heads h ON h.session = s.key ",
            $($condition)+
        )
    };
}

/// Selects the [`CandidateRow`]s of the sessions of some keys.
macro_rules! candidates {
    ($keys:literal) => {
        concat!(
            "SELECT session, bases.key, bases.id FROM session_bases ",
            "JOIN bases ON bases.key = session_bases.base WHERE session IN (SELECT ",
            $keys,
            ") ORDER BY session, place"
        )
    };
}

/// Reads the rows of several sessions at once, by their ids.
pub(super) type JoinedRows = Joined<String, Option<RawSession>>;

impl JoinedRows {
    /// Reads from a Postgres server.
    pub(super) fn of(pool: &PgPool) -> Arc<Self> {
        let pool = pool.clone();
        // A client that reads one session after another waits for no other read.
        let pause = Duration::ZERO;
        let rules = Rules { operation: READING, keys_max: ROWS, pause, limit: DEADLINE };
        Joined::new(rules, move |ids| {
            let pool = pool.clone();
            async move {
                let read = within(DEADLINE, read_rows(&pool, &ids)).await;
                read.map_err(StoreError::database(READING))
            }
        })
    }
}

async fn read_rows(pool: &PgPool, ids: &[String]) -> Result<Vec<Option<RawSession>>, sqlx::Error> {
    let sql = select_sessions!("WHERE id = ANY($1) AND s.deleted_unix_ms IS NULL");
    let rows: Vec<RawSession> = sqlx::query_as(sql).bind(ids).fetch_all(pool).await?;
    Ok(in_order(ids, rows.into_iter().map(|row| (row.id.clone(), row)).collect()))
}

fn base_name(key: i64, id: String) -> BaseName {
    BaseName { key: BaseKey(key), id: id.into() }
}

impl Store {
    /// The session of a tenant with this id.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub async fn session(
        &self,
        tenant: &Tenant,
        id: &str,
    ) -> Result<Option<SessionRow>, StoreError> {
        self.session_of(tenant.name(), id).await
    }

    /// The session with this id, of any tenant: for the session's own task, and for commands with
    /// direct access to the database.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub async fn session_of_any(&self, id: &str) -> Result<Option<SessionRow>, StoreError> {
        self.session_of("", id).await
    }

    /// The session of a tenant; of any tenant if the name is empty. On Postgres several sessions
    /// are read at once.
    async fn session_of(&self, tenant: &str, id: &str) -> Result<Option<SessionRow>, StoreError> {
        let row = match &self.rows {
            Some(rows) => rows.value(id.to_owned()).await?,
            None => self.read_row(id).await?,
        };
        let Some(row) = row.filter(|row| tenant.is_empty() || row.tenant == tenant) else {
            return Ok(None);
        };
        let mut candidates = self.candidates(std::slice::from_ref(&row), false).await?;
        row.parse(&mut candidates).map(Some)
    }

    async fn read_row(&self, id: &str) -> Result<Option<RawSession>, StoreError> {
        let row = reading!(&self.pool, pool => {
            let sql = select_sessions!("WHERE id = $1 AND s.deleted_unix_ms IS NULL");
            sqlx::query_as(sql).bind(id).fetch_optional(pool).await
        });
        row.map_err(StoreError::database(READING))
    }

    /// The key of a tenant's session, even if it is deleted.
    pub(super) async fn key_of(
        &self,
        tenant: &Tenant,
        id: &str,
    ) -> Result<Option<i64>, StoreError> {
        let key: Result<Option<i64>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT key FROM sessions WHERE id = $1 AND tenant = $2";
            sqlx::query_scalar(sql).bind(id).bind(tenant.name()).fetch_optional(pool).await
        });
        key.map_err(StoreError::database("reading a session"))
    }

    /// The candidate bases of those of the sessions that use the nearest of several.
    async fn candidates(
        &self,
        sessions: &[RawSession],
        of_list: bool,
    ) -> Result<Candidates, StoreError> {
        let keys = sessions.iter().filter(|row| row.base_choice == NEAREST_OF).map(|row| row.key);
        let keys: Vec<i64> = keys.collect();
        let mut candidates = Candidates::new();
        if keys.is_empty() {
            return Ok(candidates);
        }
        let keys = serde_json::to_string(&keys).expect("numbers are JSON");
        let sql = match &self.pool {
            Pool::Sqlite { .. } => candidates!("value FROM json_each($1)"),
            Pool::Postgres { .. } => {
                candidates!("CAST(value AS BIGINT) FROM json_array_elements_text($1::text::json)")
            }
        };
        let rows: Result<Vec<CandidateRow>, _> = match of_list {
            true => reading!(list &self.pool, pool => {
                sqlx::query_as(sql).bind(&keys).fetch_all(pool).await
            }),
            false => reading!(&self.pool, pool => {
                sqlx::query_as(sql).bind(&keys).fetch_all(pool).await
            }),
        };
        for (session, key, id) in rows.map_err(StoreError::database(READING_BASES))? {
            candidates.entry(session).or_default().push(base_name(key, id));
        }
        Ok(candidates)
    }

    /// A page of the sessions of a tenant.
    ///
    /// # Errors
    /// The page token or size is invalid, or the database fails.
    pub(crate) async fn sessions(
        &self,
        tenant: &Tenant,
        filter: &SessionFilter,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionRow>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let beside = match page_token {
            None => filter.start(),
            Some(id) => {
                let key = self.key_of(tenant, id).await?;
                key.ok_or_else(|| StoreError::PageToken { token: id.to_owned() })?
            }
        };
        let rows: Result<Vec<RawSession>, _> = reading!(list &self.pool, pool => {
            let sql = match filter.oldest_first {
                true => select_sessions!(condition!(oldest_first)),
                false => select_sessions!(condition!(newest_first)),
            };
            let select = sqlx::query_as(sql).bind(tenant.name()).bind(beside).bind(rows_asked);
            let select = select.bind(filter.closed_column()).bind(&filter.mode);
            select.bind(&filter.label).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("listing sessions"))?;
        let mut candidates = self.candidates(&rows, true).await?;
        Page::of(rows, page_size, |row| row.id.clone()).try_map(|row| row.parse(&mut candidates))
    }
}
