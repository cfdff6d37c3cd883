//! API keys as rows. A row contains the hash of the secret, never the secret.
//!
//! Each change of a key has a number that is higher than all earlier ones. So a service that has
//! the keys in memory reads only the changes. It has a connection for this, which never waits for
//! other reads.

use crate::tenant::Tenant;

use super::audit::note;
use super::page::rows_asked;
use super::pool::{reading, writing};
use super::{AuditEntry, Page, Store, StoreError};

const PAGE_LIMIT: usize = 1_000;
/// Keys read at a time.
const CHANGES: i64 = 1_000;

/// Takes the next number of a change. It is the first statement of a transaction, so other
/// transactions with a change wait until this one ends.
pub(super) const COUNT_UP: &str = "UPDATE api_key_changes SET number = number + 1 RETURNING number";
const INSERT: &str = "INSERT INTO api_keys (id, tenant, rights, label, secret_sha256, \
    created_unix_ms, expires_unix_ms, changed) VALUES ($1, $2, $3, $4, $5, $6, $7, $8)";
const REVOKE: &str = "UPDATE api_keys SET revoked_unix_ms = $1, changed = $2 \
    WHERE id = $3 AND revoked_unix_ms IS NULL";
/// Shortens the life of a key. An earlier expiry is kept.
const EXPIRE: &str = "UPDATE api_keys SET expires_unix_ms = $1, changed = $2 \
    WHERE id = $3 AND (expires_unix_ms IS NULL OR $1 < expires_unix_ms)";
const TENANT: &str = "INSERT INTO tenants (name, created_unix_ms) VALUES ($1, $2) \
    ON CONFLICT (name) DO NOTHING";
const USE: &str = "UPDATE api_keys SET last_used_unix_ms = $1 \
    WHERE id = $2 AND (last_used_unix_ms IS NULL OR last_used_unix_ms < $1)";
const REMOVE: &str = "DELETE FROM api_keys WHERE key IN (SELECT key FROM api_keys \
    WHERE (revoked_unix_ms < $1 OR expires_unix_ms < $1) \
    AND key < (SELECT MAX(key) FROM api_keys) ORDER BY key LIMIT $2)";

/// A new key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewKeyRow {
    /// Public id.
    pub id: String,
    /// Tenant that owns the key.
    pub tenant: Tenant,
    /// Names of its rights, separated by spaces.
    pub rights: String,
    /// A name for people.
    pub label: String,
    /// SHA-256 of its secret.
    pub secret_sha256: [u8; 32],
    /// When it is created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When it expires (ms since 1970-01-01 UTC); `None` for never.
    pub expires_unix_ms: Option<i64>,
}

/// A stored key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyRow {
    /// The values with which it was created. Its expiry may have changed since.
    pub key: NewKeyRow,
    /// When it was revoked (ms since 1970-01-01 UTC).
    pub revoked_unix_ms: Option<i64>,
    /// When it was last used (ms since 1970-01-01 UTC), written once a minute at most.
    pub last_used_unix_ms: Option<i64>,
    /// Number of its last change.
    pub changed: i64,
}

#[derive(sqlx::FromRow)]
struct RawKey {
    key: i64,
    id: String,
    tenant: String,
    rights: String,
    label: String,
    secret_sha256: Vec<u8>,
    created_unix_ms: i64,
    expires_unix_ms: Option<i64>,
    revoked_unix_ms: Option<i64>,
    last_used_unix_ms: Option<i64>,
    changed: i64,
}

impl RawKey {
    fn parse(self) -> Result<KeyRow, StoreError> {
        let secret_sha256 = self.secret_sha256.try_into().map_err(|bytes: Vec<u8>| {
            let why = format!("the hash of key {} has {} bytes", self.key, bytes.len());
            StoreError::CorruptText { what: "key", why }
        })?;
        let key = NewKeyRow {
            id: self.id,
            tenant: Tenant::stored(&self.tenant),
            rights: self.rights,
            label: self.label,
            secret_sha256,
            created_unix_ms: self.created_unix_ms,
            expires_unix_ms: self.expires_unix_ms,
        };
        let Self { revoked_unix_ms, last_used_unix_ms, changed, .. } = self;
        Ok(KeyRow { key, revoked_unix_ms, last_used_unix_ms, changed })
    }
}

macro_rules! select_keys {
    ($condition:literal) => {
        concat!(
            "SELECT key, id, tenant, rights, label, secret_sha256, created_unix_ms, ",
            "expires_unix_ms, revoked_unix_ms, last_used_unix_ms, changed FROM api_keys ",
            $condition
        )
    };
}

/// Inserts a key within a transaction, with the number of the change.
macro_rules! insert {
    ($transaction:expr, $new:expr, $number:expr) => {
        sqlx::query(INSERT)
            .bind(&$new.id)
            .bind($new.tenant.name())
            .bind(&$new.rights)
            .bind(&$new.label)
            .bind(&$new.secret_sha256[..])
            .bind($new.created_unix_ms)
            .bind($new.expires_unix_ms)
            .bind($number)
            .execute(&mut *$transaction)
            .await?
    };
}

impl Store {
    /// Stores a new key, and its tenant if that is new. If the key replaces an earlier one, the
    /// earlier key expires at this time (ms since 1970-01-01 UTC), or at its own expiry if that is
    /// sooner. `entry` is the act's entry for the audit log.
    ///
    /// # Errors
    /// The database fails. An existing id is such a failure.
    pub(crate) async fn create_key(
        &self,
        new: &NewKeyRow,
        replaces: Option<(&str, i64)>,
        entry: &AuditEntry,
    ) -> Result<(), StoreError> {
        let created = writing!(&self.pool, pool => {
            let create = async {
                let mut transaction = pool.begin().await?;
                let number: i64 =
                    sqlx::query_scalar(COUNT_UP).fetch_one(&mut *transaction).await?;
                let tenant = sqlx::query(TENANT).bind(new.tenant.name());
                tenant.bind(new.created_unix_ms).execute(&mut *transaction).await?;
                insert!(transaction, new, number);
                if let Some((earlier, expires_unix_ms)) = replaces {
                    // Each change needs its own number, because readers continue after the last one
                    // they have read.
                    let number: i64 =
                        sqlx::query_scalar(COUNT_UP).fetch_one(&mut *transaction).await?;
                    let expire = sqlx::query(EXPIRE).bind(expires_unix_ms).bind(number);
                    expire.bind(earlier).execute(&mut *transaction).await?;
                }
                note!(self, transaction, entry);
                transaction.commit().await
            };
            create.await
        });
        created.map_err(StoreError::database("storing a key"))
    }

    /// Revokes a key. A revoked key stays unchanged. `entry` is the act's entry for the audit log.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn revoke_key(
        &self,
        id: &str,
        unix_ms: i64,
        entry: &AuditEntry,
    ) -> Result<(), StoreError> {
        let revoked = writing!(&self.pool, pool => {
            let revoke = async {
                let mut transaction = pool.begin().await?;
                let number: i64 =
                    sqlx::query_scalar(COUNT_UP).fetch_one(&mut *transaction).await?;
                let revoke = sqlx::query(REVOKE).bind(unix_ms).bind(number).bind(id);
                if revoke.execute(&mut *transaction).await?.rows_affected() == 1 {
                    note!(self, transaction, entry);
                }
                transaction.commit().await
            };
            revoke.await
        });
        revoked.map_err(StoreError::database("revoking a key"))
    }

    /// Stores when keys were last used: each id with its time (ms since 1970-01-01 UTC).
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn note_key_uses(&self, uses: &[(String, i64)]) -> Result<(), StoreError> {
        let noted = writing!(&self.pool, pool => {
            let note = async {
                let mut transaction = pool.begin().await?;
                for (id, unix_ms) in uses {
                    let note = sqlx::query(USE).bind(unix_ms).bind(id);
                    note.execute(&mut *transaction).await?;
                }
                transaction.commit().await
            };
            note.await
        });
        noted.map_err(StoreError::database("noting the use of keys"))
    }

    /// The key with this id.
    ///
    /// # Errors
    /// The database fails, or the row is corrupt.
    pub(crate) async fn key(&self, id: &str) -> Result<Option<KeyRow>, StoreError> {
        let row: Result<Option<RawKey>, _> = reading!(&self.pool, pool => {
            let sql = select_keys!("WHERE id = $1");
            sqlx::query_as(sql).bind(id).fetch_optional(pool).await
        });
        row.map_err(StoreError::database("reading a key"))?.map(RawKey::parse).transpose()
    }

    /// A page of the keys of a tenant, or of all, the newest first.
    ///
    /// # Errors
    /// The page token or size is invalid, or the database fails.
    pub(crate) async fn keys(
        &self,
        tenant: Option<&Tenant>,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<KeyRow>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let of = tenant.map_or("", Tenant::name);
        let before = match page_token {
            None => i64::MAX,
            Some(id) => {
                let key: Result<Option<i64>, _> = reading!(list &self.pool, pool => {
                    let sql = "SELECT key FROM api_keys WHERE id = $1 AND ($2 = '' OR tenant = $2)";
                    sqlx::query_scalar(sql).bind(id).bind(of).fetch_optional(pool).await
                });
                let key = key.map_err(StoreError::database("listing keys"))?;
                key.ok_or_else(|| StoreError::PageToken { token: id.to_owned() })?
            }
        };
        let rows: Result<Vec<RawKey>, _> = reading!(list &self.pool, pool => {
            let sql = select_keys!(
                "WHERE key < $1 AND ($2 = '' OR tenant = $2) ORDER BY key DESC LIMIT $3"
            );
            let select = sqlx::query_as(sql).bind(before).bind(of);
            select.bind(rows_asked).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("listing keys"))?;
        Page::of(rows, page_size, |row| row.id.clone()).try_map(RawKey::parse)
    }

    /// Number of keys in force at this time (ms since 1970-01-01 UTC).
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn count_keys(&self, unix_ms: i64) -> Result<i64, StoreError> {
        let count: Result<i64, _> = reading!(&self.pool, pool => {
            let sql = "SELECT COUNT(*) FROM api_keys WHERE revoked_unix_ms IS NULL
                       AND (expires_unix_ms IS NULL OR $1 < expires_unix_ms)";
            sqlx::query_scalar(sql).bind(unix_ms).fetch_one(pool).await
        });
        count.map_err(StoreError::database("counting keys"))
    }

    /// Number of keys of a tenant that were created after this time (ms since 1970-01-01 UTC).
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn count_created_keys(
        &self,
        tenant: &Tenant,
        after_unix_ms: i64,
    ) -> Result<i64, StoreError> {
        let count: Result<i64, _> = reading!(&self.pool, pool => {
            let sql = "SELECT COUNT(*) FROM api_keys WHERE tenant = $1 AND $2 < created_unix_ms";
            sqlx::query_scalar(sql).bind(tenant.name()).bind(after_unix_ms).fetch_one(pool).await
        });
        count.map_err(StoreError::database("counting keys"))
    }

    /// Removes up to `keys` of the keys that ended before this time (ms since 1970-01-01 UTC), but
    /// never the newest key, so that calls need a key for ever. Returns whether there may be more.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn remove_keys_ended_before(
        &self,
        unix_ms: i64,
        keys: usize,
    ) -> Result<bool, StoreError> {
        let removed = writing!(&self.pool, pool => {
            let remove = sqlx::query(REMOVE).bind(unix_ms).bind(keys as i64);
            remove.execute(pool).await.map(|done| done.rows_affected())
        });
        let removed = removed.map_err(StoreError::database("removing keys"))?;
        Ok(removed == keys as u64)
    }

    /// Number of the last change of a stored key; 0 without keys.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn last_key_change(&self) -> Result<i64, StoreError> {
        let number: Result<i64, _> = reading!(&self.key_pool, pool => {
            let sql = "SELECT COALESCE(MAX(changed), 0) FROM api_keys";
            sqlx::query_scalar(sql).fetch_one(pool).await
        });
        number.map_err(StoreError::database("reading changed keys"))
    }

    /// Keys that were changed after the change with this number, in the order of their changes,
    /// without those whose last change is a revocation up to number `revoked_after`. If there are
    /// many, the first of them.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn changed_keys(
        &self,
        after: i64,
        revoked_after: i64,
    ) -> Result<Vec<KeyRow>, StoreError> {
        let rows: Result<Vec<RawKey>, _> = reading!(&self.key_pool, pool => {
            let sql = select_keys!(
                "WHERE $1 < changed AND (revoked_unix_ms IS NULL OR $2 < changed) \
                 ORDER BY changed LIMIT $3"
            );
            let select = sqlx::query_as(sql).bind(after).bind(revoked_after);
            select.bind(CHANGES).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading changed keys"))?;
        rows.into_iter().map(RawKey::parse).collect()
    }
}
