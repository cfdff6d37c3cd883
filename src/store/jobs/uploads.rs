//! Files that arrive in several requests, before a job names them.

use crate::store::pool::{reading, writing};
use crate::store::{Store, StoreError};
use crate::tenant::Tenant;

/// A file that arrives in several requests.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub struct JobUploadRow {
    /// Public id.
    pub id: String,
    /// Name of the file on the user's side.
    pub name: String,
    /// Size of the whole file (bytes).
    pub bytes: i64,
    /// Hash of its bytes, once all have arrived.
    pub hash: Option<String>,
    /// When it is removed (ms since 1970-01-01 UTC).
    pub expires_unix_ms: i64,
}

const SELECT: &str = "SELECT id, name, bytes, hash, expires_unix_ms FROM job_uploads \
    WHERE id = $1 AND tenant = $2";

impl Store {
    /// Stores a new upload; false if the tenant already has `limit` of them.
    ///
    /// # Errors
    /// The database fails.
    pub async fn create_upload(
        &self,
        tenant: &Tenant,
        new: &JobUploadRow,
        limit: usize,
    ) -> Result<bool, StoreError> {
        let created: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "INSERT INTO job_uploads (id, tenant, name, bytes, expires_unix_ms)
                       SELECT $1, $2, $3, $4, $5
                       WHERE (SELECT COUNT(*) FROM job_uploads WHERE tenant = $2) < $6";
            sqlx::query(sql)
                .bind(&new.id)
                .bind(tenant.name())
                .bind(&new.name)
                .bind(new.bytes)
                .bind(new.expires_unix_ms)
                .bind(i64::try_from(limit).unwrap_or(i64::MAX))
                .execute(pool)
                .await
                .map(|done| done.rows_affected())
        });
        created.map(|rows| rows == 1).map_err(StoreError::database("beginning an upload"))
    }

    /// The upload of a tenant with this id.
    ///
    /// # Errors
    /// The database fails.
    pub async fn upload(
        &self,
        tenant: &Tenant,
        id: &str,
    ) -> Result<Option<JobUploadRow>, StoreError> {
        let row = reading!(&self.pool, pool => {
            sqlx::query_as(SELECT).bind(id).bind(tenant.name()).fetch_optional(pool).await
        });
        row.map_err(StoreError::database("reading an upload"))
    }

    /// Stores the hash of a complete upload.
    ///
    /// # Errors
    /// The database fails.
    pub async fn complete_upload(&self, id: &str, hash: &str) -> Result<(), StoreError> {
        let set = writing!(&self.pool, pool => {
            let sql = "UPDATE job_uploads SET hash = $2 WHERE id = $1";
            sqlx::query(sql).bind(id).bind(hash).execute(pool).await.map(drop)
        });
        set.map_err(StoreError::database("completing an upload"))
    }

    /// Deletes an upload of a tenant; false if the tenant has no such upload.
    ///
    /// # Errors
    /// The database fails.
    pub async fn delete_upload(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        let deleted: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "DELETE FROM job_uploads WHERE id = $1 AND tenant = $2";
            let done = sqlx::query(sql).bind(id).bind(tenant.name()).execute(pool).await;
            done.map(|done| done.rows_affected())
        });
        deleted.map(|rows| rows == 1).map_err(StoreError::database("deleting an upload"))
    }

    /// Deletes the uploads that have expired.
    ///
    /// # Errors
    /// The database fails.
    pub async fn delete_expired_uploads(&self, now_unix_ms: i64) -> Result<u64, StoreError> {
        let deleted: Result<u64, _> = writing!(&self.pool, pool => {
            let sql = "DELETE FROM job_uploads WHERE expires_unix_ms <= $1";
            let done = sqlx::query(sql).bind(now_unix_ms).execute(pool).await;
            done.map(|done| done.rows_affected())
        });
        deleted.map_err(StoreError::database("deleting expired uploads"))
    }

    /// Id and hash of every upload.
    ///
    /// # Errors
    /// The database fails.
    pub async fn upload_files(&self) -> Result<Vec<(String, Option<String>)>, StoreError> {
        let rows: Result<Vec<(String, Option<String>)>, _> = reading!(bulk &self.pool, pool => {
            sqlx::query_as("SELECT id, hash FROM job_uploads").fetch_all(pool).await
        });
        rows.map_err(StoreError::database("reading the files of uploads"))
    }
}
