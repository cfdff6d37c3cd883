//! Sessions as rows.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::page::rows_asked;
use super::pool::{reading, writing};
use super::{BaseKey, BaseName, Page, Store, StoreError};

const PAGE_LIMIT: usize = 1_000;

/// The store's short name of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionKey(pub(super) i64);

/// What of a session its users set, and what follows from it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionSettings {
    /// A name for people.
    pub label: String,
    /// Estimator.
    pub mode: String,
    /// Profile.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// Every option with its value in force.
    pub configuration: BTreeMap<String, String>,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
    /// The base of modes relative to one.
    pub base: Option<BaseName>,
}

/// A configuration that solved epochs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredConfiguration {
    /// Estimator.
    pub mode: String,
    /// Profile.
    pub profile: String,
    /// Every option with its value in force.
    pub configuration: BTreeMap<String, String>,
}

/// A stored session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionRow {
    /// The store's short name of it.
    pub key: SessionKey,
    /// Its id.
    pub id: String,
    /// Its settings.
    pub settings: SessionSettings,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When it was closed (ms since 1970-01-01 UTC).
    pub closed_unix_ms: Option<i64>,
    /// Its last epoch.
    pub last_seq: Option<u64>,
    /// How many raw bytes of its receiver are stored.
    pub raw_through: Option<u64>,
}

#[derive(sqlx::FromRow)]
struct RawSession {
    key: i64,
    id: String,
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
    base: Option<i64>,
    base_id: Option<String>,
}

impl RawSession {
    fn parse(self) -> Result<SessionRow, StoreError> {
        let base = self.base.zip(self.base_id);
        Ok(SessionRow {
            key: SessionKey(self.key),
            id: self.id,
            settings: SessionSettings {
                label: self.label,
                mode: self.mode,
                profile: self.profile,
                overrides: options_from(&self.overrides)?,
                configuration: options_from(&self.configuration)?,
                configuration_hash: self.configuration_hash.into(),
                base: base.map(|(key, id)| BaseName { key: BaseKey(key), id: id.into() }),
            },
            created_unix_ms: self.created_unix_ms,
            closed_unix_ms: self.closed_unix_ms,
            last_seq: self.last_seq.map(|seq| seq as u64),
            raw_through: self.raw_through.map(|through| through as u64),
        })
    }
}

fn options_text(options: &BTreeMap<String, String>) -> String {
    serde_json::to_string(options).expect("a map of texts is JSON")
}

fn options_from(text: &str) -> Result<BTreeMap<String, String>, StoreError> {
    serde_json::from_str(text)
        .map_err(|error| StoreError::CorruptText { what: "configuration", why: error.to_string() })
}

/// Columns of [`RawSession`], up to the condition.
macro_rules! select_sessions {
    ($condition:literal) => {
        concat!(
            "SELECT key, id, label, mode, profile, overrides, configuration, configuration_hash, ",
            "created_unix_ms, closed_unix_ms, ",
            "(SELECT MAX(seq) FROM epochs WHERE epochs.session = sessions.key) AS last_seq, ",
            "(SELECT through FROM raw_streams WHERE raw_streams.session = sessions.key) ",
            "AS raw_through, ",
            "base, (SELECT id FROM bases WHERE bases.key = sessions.base) AS base_id ",
            "FROM sessions ",
            $condition
        )
    };
}

impl Store {
    /// Stores a new session.
    ///
    /// # Errors
    /// The database fails; an id that exists is such a failure.
    pub async fn create_session(
        &self,
        id: &str,
        settings: &SessionSettings,
        created_unix_ms: i64,
    ) -> Result<SessionRow, StoreError> {
        self.store_configuration(settings).await?;
        let inserted = writing!(&self.pool, pool => sqlx::query_as(
            "INSERT INTO sessions (id, label, mode, profile, overrides, configuration,
                                   configuration_hash, created_unix_ms, base)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9) RETURNING key",
        )
        .bind(id)
        .bind(&settings.label)
        .bind(&settings.mode)
        .bind(&settings.profile)
        .bind(options_text(&settings.overrides))
        .bind(options_text(&settings.configuration))
        .bind(&*settings.configuration_hash)
        .bind(created_unix_ms)
        .bind(settings.base.as_ref().map(|base| base.key.0))
        .fetch_one(pool)
        .await);
        let (key,): (i64,) = inserted.map_err(StoreError::database("storing a session"))?;
        Ok(SessionRow {
            key: SessionKey(key),
            id: id.to_owned(),
            settings: settings.clone(),
            created_unix_ms,
            closed_unix_ms: None,
            last_seq: None,
            raw_through: None,
        })
    }

    /// The session of an id.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub async fn session(&self, id: &str) -> Result<Option<SessionRow>, StoreError> {
        let row: Result<Option<RawSession>, _> = reading!(&self.pool, pool => {
            sqlx::query_as(select_sessions!("WHERE id = $1")).bind(id).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a session"))?;
        row.map(RawSession::parse).transpose()
    }

    /// Sessions, the newest first.
    ///
    /// # Errors
    /// A page token or size that is refused, or the database fails.
    pub async fn sessions(
        &self,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionRow>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let before = match page_token {
            None => i64::MAX,
            Some(id) => {
                let row = self.session(id).await?;
                row.ok_or_else(|| StoreError::PageToken { token: id.to_owned() })?.key.0
            }
        };
        let rows: Result<Vec<RawSession>, _> = reading!(&self.pool, pool => {
            sqlx::query_as(select_sessions!("WHERE key < $1 ORDER BY key DESC LIMIT $2"))
                .bind(before)
                .bind(rows_asked)
                .fetch_all(pool)
                .await
        });
        let rows = rows.map_err(StoreError::database("listing sessions"))?;
        Page::of(rows, page_size, |row| row.id.clone()).try_map(RawSession::parse)
    }

    /// Replaces a session's settings.
    ///
    /// # Errors
    /// The database fails.
    pub async fn update_session(
        &self,
        key: SessionKey,
        settings: &SessionSettings,
    ) -> Result<(), StoreError> {
        self.store_configuration(settings).await?;
        let updated = writing!(&self.pool, pool => sqlx::query(
            "UPDATE sessions SET label = $2, mode = $3, profile = $4, overrides = $5,
                                 configuration = $6, configuration_hash = $7, base = $8
             WHERE key = $1",
        )
        .bind(key.0)
        .bind(&settings.label)
        .bind(&settings.mode)
        .bind(&settings.profile)
        .bind(options_text(&settings.overrides))
        .bind(options_text(&settings.configuration))
        .bind(&*settings.configuration_hash)
        .bind(settings.base.as_ref().map(|base| base.key.0))
        .execute(pool)
        .await
        .map(drop));
        updated.map_err(StoreError::database("updating a session"))
    }

    /// Keeps a configuration under its hash, for replay. Equal hashes mean equal configurations.
    async fn store_configuration(&self, settings: &SessionSettings) -> Result<(), StoreError> {
        let stored = writing!(&self.pool, pool => sqlx::query(
            "INSERT INTO configurations (hash, mode, profile, configuration)
             VALUES ($1, $2, $3, $4) ON CONFLICT (hash) DO NOTHING",
        )
        .bind(&*settings.configuration_hash)
        .bind(&settings.mode)
        .bind(&settings.profile)
        .bind(options_text(&settings.configuration))
        .execute(pool)
        .await
        .map(drop));
        stored.map_err(StoreError::database("storing a configuration"))
    }

    /// The configuration of a hash.
    ///
    /// # Errors
    /// There is none, or the database fails.
    pub async fn configuration(&self, hash: &str) -> Result<StoredConfiguration, StoreError> {
        let row: Result<Option<(String, String, String)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT mode, profile, configuration FROM configurations WHERE hash = $1";
            sqlx::query_as(sql).bind(hash).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a configuration"))?;
        let (mode, profile, configuration) = row.ok_or_else(|| StoreError::CorruptText {
            what: "configuration",
            why: format!("none has the hash {hash:?}"),
        })?;
        Ok(StoredConfiguration { mode, profile, configuration: options_from(&configuration)? })
    }
}
