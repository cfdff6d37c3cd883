//! Sessions as rows.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::tenant::Tenant;

use super::audit::note;
use super::pool::{Pool, reading, writing};
use super::{AntennaName, AuditEntry, BaseChoice, NamedRequest, Store, StoreError};

/// Column value of a session that uses the nearest of several bases.
pub(super) const NEAREST_OF: i32 = 1;

/// Primary key of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionKey(pub(super) i64);

/// The settings of a session, and the configuration that results from them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionSettings {
    /// A name for people.
    pub label: String,
    /// Name of the mode.
    pub mode: String,
    /// Name of the profile.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// All options with their values in force.
    pub configuration: BTreeMap<String, String>,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
    /// The bases of a mode relative to one.
    pub base: BaseChoice,
    /// The rover's antenna, if the session corrects for antennas.
    pub antenna: Option<AntennaName>,
    /// Time for which epochs are kept (days); 0 for ever, `None` for the service's setting.
    pub retention_days: Option<u32>,
}

/// A configuration that has solved epochs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredConfiguration {
    /// Name of the mode.
    pub mode: String,
    /// Name of the profile.
    pub profile: String,
    /// All options with their values in force.
    pub configuration: BTreeMap<String, String>,
    /// Hash of the calibration of the rover's antenna, if the session corrects for antennas.
    pub calibration: Option<Arc<str>>,
}

/// A stored session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionRow {
    /// Primary key of the session.
    pub key: SessionKey,
    /// Public id of the session.
    pub id: String,
    /// Tenant that owns the session.
    pub tenant: Tenant,
    /// Settings of the session.
    pub settings: SessionSettings,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When it was closed (ms since 1970-01-01 UTC); `None` while it is open.
    pub closed_unix_ms: Option<i64>,
    /// Number of its last epoch.
    pub last_seq: Option<u64>,
    /// Number of stored raw bytes.
    pub raw_through: Option<u64>,
    /// Number of the last epoch that is removed because it is older than the retention.
    pub removed_through: Option<u64>,
}

/// Mode, profile and options of a configuration, and the hash of the rover antenna's calibration.
type ConfigurationRow = (String, String, String, Option<String>);

fn options_text(options: &BTreeMap<String, String>) -> String {
    serde_json::to_string(options).expect("a map of texts is JSON")
}

pub(super) fn options_from(text: &str) -> Result<BTreeMap<String, String>, StoreError> {
    serde_json::from_str(text)
        .map_err(|error| StoreError::CorruptText { what: "configuration", why: error.to_string() })
}

fn base_column(base: &BaseChoice) -> Option<i64> {
    match base {
        BaseChoice::One(base) => Some(base.key.0),
        BaseChoice::None | BaseChoice::NearestOf(_) | BaseChoice::Nearest => None,
    }
}

const fn choice_column(base: &BaseChoice) -> i32 {
    match base {
        BaseChoice::None | BaseChoice::One(_) => 0,
        BaseChoice::NearestOf(_) => NEAREST_OF,
        BaseChoice::Nearest => 2,
    }
}

/// Stores a candidate base of a session.
macro_rules! insert_candidates {
    ($transaction:ident, $session:expr, $base:expr) => {
        if let BaseChoice::NearestOf(bases) = $base {
            for (index, base) in bases.iter().enumerate() {
                let sql = "INSERT INTO session_bases (session, place, base) VALUES ($1, $2, $3)";
                let insert = sqlx::query(sql).bind($session).bind(index as i32).bind(base.key.0);
                insert.execute(&mut *$transaction).await?;
            }
        }
    };
}

/// The id of a named base that is deleted, if there is one. On Postgres the others cannot be
/// deleted until the transaction ends; on SQLite no other transaction of the pool runs.
macro_rules! deleted_base {
    ($store:expr, $transaction:ident, $base:expr) => {{
        let sql = match &$store.pool {
            Pool::Sqlite { .. } => present!(""),
            Pool::Postgres { .. } => present!(" FOR SHARE"),
        };
        let mut deleted = None;
        for base in $base.named() {
            let select = sqlx::query_scalar(sql).bind(base.key.0);
            let present: Option<i64> = select.fetch_optional(&mut *$transaction).await?;
            if present.is_none() {
                deleted = Some(base.id.clone());
                break;
            }
        }
        deleted
    }};
}
/// Selects a base that is not deleted.
macro_rules! present {
    ($lock:literal) => {
        concat!("SELECT key FROM bases WHERE key = $1 AND deleted_unix_ms IS NULL", $lock)
    };
}

impl Store {
    /// Stores a new session of a tenant.
    ///
    /// # Errors
    /// A base is deleted, or the database fails. An existing id is such a failure.
    pub async fn create_session(
        &self,
        tenant: &Tenant,
        id: &str,
        settings: &SessionSettings,
        created_unix_ms: i64,
    ) -> Result<SessionRow, StoreError> {
        let created = self.create_session_once(tenant, id, settings, created_unix_ms, None);
        Ok(created.await?.expect("only a named request can meet another of its name"))
    }

    /// Stores a new session of a named request; `None` if one with this name has created a session.
    ///
    /// # Errors
    /// As for [`Self::create_session`].
    pub(crate) async fn create_session_once(
        &self,
        tenant: &Tenant,
        id: &str,
        settings: &SessionSettings,
        created_unix_ms: i64,
        request: Option<&NamedRequest>,
    ) -> Result<Option<SessionRow>, StoreError> {
        let key = writing!(&self.pool, pool => {
            let inserted = async {
                let mut transaction = pool.begin().await?;
                let insert = sqlx::query_as(
                    "INSERT INTO sessions (id, label, mode, profile, overrides, configuration,
                                           configuration_hash, created_unix_ms, base, base_choice,
                                           antenna, calibration, retention_days, tenant,
                                           request_name, request_hash)
                     VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14,
                             $15, $16)
                     ON CONFLICT (tenant, request_name) DO NOTHING RETURNING key",
                )
                .bind(id)
                .bind(&settings.label)
                .bind(&settings.mode)
                .bind(&settings.profile)
                .bind(options_text(&settings.overrides))
                .bind(options_text(&settings.configuration))
                .bind(&*settings.configuration_hash)
                .bind(created_unix_ms)
                .bind(base_column(&settings.base))
                .bind(choice_column(&settings.base))
                .bind(settings.antenna.as_ref().map(|antenna| &*antenna.name))
                .bind(settings.antenna.as_ref().map(|antenna| &*antenna.calibration))
                .bind(settings.retention_days.map(i64::from))
                .bind(tenant.name())
                .bind(request.map(|request| &*request.name))
                .bind(request.map(|request| &*request.hash));
                let key: Option<(i64,)> = insert.fetch_optional(&mut *transaction).await?;
                let Some((key,)) = key else { return Ok(Ok(None)) };
                if let Some(id) = deleted_base!(self, transaction, &settings.base) {
                    return Ok(Err(StoreError::BaseDeleted { id }));
                }
                insert_candidates!(transaction, key, &settings.base);
                let head = "INSERT INTO session_heads (session, owner, fence) VALUES ($1, '', 0)";
                sqlx::query(head).bind(key).execute(&mut *transaction).await?;
                transaction.commit().await?;
                Ok::<Result<Option<i64>, StoreError>, sqlx::Error>(Ok(Some(key)))
            };
            inserted.await
        });
        let key = key.map_err(StoreError::database("storing a session"))??;
        Ok(key.map(|key| SessionRow {
            key: SessionKey(key),
            id: id.to_owned(),
            tenant: tenant.clone(),
            settings: settings.clone(),
            created_unix_ms,
            closed_unix_ms: None,
            last_seq: None,
            raw_through: None,
            removed_through: None,
        }))
    }

    /// Replaces a session's settings, and writes the entry of the audit log.
    ///
    /// # Errors
    /// A base is deleted, or the database fails.
    pub(crate) async fn update_session(
        &self,
        key: SessionKey,
        settings: &SessionSettings,
        entry: Option<&AuditEntry>,
    ) -> Result<(), StoreError> {
        let updated = writing!(&self.pool, pool => {
            let updated = async {
                let mut transaction = pool.begin().await?;
                let update = sqlx::query(
                    "UPDATE sessions SET label = $2, mode = $3, profile = $4, overrides = $5,
                            configuration = $6, configuration_hash = $7, base = $8,
                            base_choice = $9, antenna = $10, calibration = $11,
                            retention_days = $12
                     WHERE key = $1",
                )
                .bind(key.0)
                .bind(&settings.label)
                .bind(&settings.mode)
                .bind(&settings.profile)
                .bind(options_text(&settings.overrides))
                .bind(options_text(&settings.configuration))
                .bind(&*settings.configuration_hash)
                .bind(base_column(&settings.base))
                .bind(choice_column(&settings.base))
                .bind(settings.antenna.as_ref().map(|antenna| &*antenna.name))
                .bind(settings.antenna.as_ref().map(|antenna| &*antenna.calibration))
                .bind(settings.retention_days.map(i64::from));
                update.execute(&mut *transaction).await?;
                let clear = sqlx::query("DELETE FROM session_bases WHERE session = $1").bind(key.0);
                clear.execute(&mut *transaction).await?;
                if let Some(id) = deleted_base!(self, transaction, &settings.base) {
                    return Ok(Err(StoreError::BaseDeleted { id }));
                }
                insert_candidates!(transaction, key.0, &settings.base);
                note!(self, transaction, entry);
                transaction.commit().await.map(Ok)
            };
            updated.await
        });
        updated.map_err(StoreError::database("updating a session"))?
    }

    /// Numbers of the epochs after which the session began a new arc, in order.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn arcs(&self, session: SessionKey) -> Result<Vec<u64>, StoreError> {
        let rows: Result<Vec<i64>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT after_seq FROM session_arcs WHERE session = $1 ORDER BY after_seq";
            sqlx::query_scalar(sql).bind(session.0).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading a session's arcs"))?;
        Ok(rows.into_iter().map(|seq| seq as u64).collect())
    }

    /// Stores the configuration of a session under its hash, for replay. It must be stored before
    /// the first epoch that is positioned with it. Equal hashes mean equal configurations.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn keep_configuration(
        &self,
        settings: &SessionSettings,
    ) -> Result<(), StoreError> {
        let stored = writing!(&self.pool, pool => sqlx::query(
            "INSERT INTO configurations (hash, mode, profile, configuration, calibration)
             VALUES ($1, $2, $3, $4, $5) ON CONFLICT (hash) DO NOTHING",
        )
        .bind(&*settings.configuration_hash)
        .bind(&settings.mode)
        .bind(&settings.profile)
        .bind(options_text(&settings.configuration))
        .bind(settings.antenna.as_ref().map(|antenna| &*antenna.calibration))
        .execute(pool)
        .await
        .map(drop));
        stored.map_err(StoreError::database("storing a configuration"))
    }

    /// The configuration with this hash.
    ///
    /// # Errors
    /// No configuration has this hash, or the database fails.
    pub(crate) async fn configuration(
        &self,
        hash: &str,
    ) -> Result<StoredConfiguration, StoreError> {
        let row: Result<Option<ConfigurationRow>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT mode, profile, configuration, calibration
                       FROM configurations WHERE hash = $1";
            sqlx::query_as(sql).bind(hash).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a configuration"))?;
        let (mode, profile, configuration, calibration) =
            row.ok_or_else(|| StoreError::CorruptText {
                what: "configuration",
                why: format!("none has the hash {hash:?}"),
            })?;
        Ok(StoredConfiguration {
            mode,
            profile,
            configuration: options_from(&configuration)?,
            calibration: calibration.map(Into::into),
        })
    }
}
