//! Counts the bytes of the files of a tenant's jobs.

use crate::store::pool::{Pool, reading};
use crate::store::{Store, StoreError};
use crate::tenant::Tenant;

/// Sums the inputs of jobs and uploads, each content once, and the results. `$inputs` selects the
/// rows of a request's inputs; `$hash` and `$bytes` are columns of such a row.
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
    /// and results. An upload counts with its full size from its beginning.
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
                // JSONB has no NUL. Requests that were stored without a check of their names may
                // have the escape of one after an even number of backslashes.
                r"jsonb_array_elements(CAST(CASE WHEN 0 < strpos(request, '\u0000')
                    THEN regexp_replace(request, '(?<!\\)((\\\\)*)\\u0000', '\1', 'g')
                    ELSE request END AS JSONB) -> 'inputs')",
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
