//! Bytes that the files of a tenant's jobs take.

use crate::store::pool::{Pool, reading};
use crate::store::{Store, StoreError};
use crate::tenant::Tenant;

/// The inputs of jobs and uploads, each content once, and results. `$inputs` are the rows of the
/// inputs in a request, `$hash` and `$bytes` what one of them has.
macro_rules! bytes_of_files {
    ($inputs:literal, $hash:literal, $bytes:literal) => {
        concat!(
            "SELECT CAST(COALESCE(SUM(bytes), 0) AS BIGINT) FROM (SELECT ",
            $hash,
            " AS name, ",
            $bytes,
            " AS bytes FROM jobs, ",
            $inputs,
            " AS input WHERE tenant = $1 ",
            "UNION SELECT COALESCE(hash, id), bytes FROM job_uploads WHERE tenant = $1 ",
            "UNION SELECT result, result_bytes FROM jobs WHERE tenant = $1) AS files"
        )
    };
}

impl Store {
    /// Bytes of the files that the jobs and uploads of a tenant name: inputs, each content once,
    /// uploads with all their bytes from the beginning on, and results.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn tenant_job_bytes(&self, tenant: &Tenant) -> Result<u64, StoreError> {
        let sql = match &self.pool {
            Pool::Sqlite { .. } => bytes_of_files!(
                "json_each(request, '$.inputs')",
                "json_extract(input.value, '$.hash')",
                "json_extract(input.value, '$.bytes')"
            ),
            Pool::Postgres { .. } => bytes_of_files!(
                "jsonb_array_elements(CAST(request AS JSONB) -> 'inputs')",
                "input ->> 'hash'",
                "CAST(input ->> 'bytes' AS BIGINT)"
            ),
        };
        let bytes: Result<i64, _> = reading!(list &self.pool, pool => {
            sqlx::query_scalar(sql).bind(tenant.name()).fetch_one(pool).await
        });
        let bytes = bytes.map_err(StoreError::database("counting the files of jobs"))?;
        Ok(bytes.max(0) as u64)
    }
}
