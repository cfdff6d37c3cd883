//! Tenants as rows: their quotas, and the amount that they have stored.
//!
//! Each change of a quota has a number, as with keys. So a service that has the quotas in memory
//! reads only the changes.

use crate::tenant::{Quotas, Tenant};

use super::audit::note;
use super::pool::{reading, writing};
use super::{Act, Author, Store, StoreError};

/// Takes the next number of a change. It is the first statement of a transaction, so other
/// transactions with a change wait until this one ends.
const COUNT_UP: &str = "UPDATE tenant_changes SET number = number + 1 RETURNING number";
/// A tenant exists since its first key, or since its quotas were first set.
const SET: &str = "INSERT INTO tenants (name, created_unix_ms, sessions, epochs_per_s, \
    cpu_s_per_minute, stored_bytes, job_bytes, changed) \
    VALUES ($1, $2, $3, $4, $5, $6, $7, $8) \
    ON CONFLICT (name) DO UPDATE SET sessions = excluded.sessions, \
    epochs_per_s = excluded.epochs_per_s, cpu_s_per_minute = excluded.cpu_s_per_minute, \
    stored_bytes = excluded.stored_bytes, job_bytes = excluded.job_bytes, \
    changed = excluded.changed";

/// A stored tenant.
#[derive(Clone, Debug, PartialEq)]
pub struct TenantRow {
    /// The tenant.
    pub tenant: Tenant,
    /// When its first key was made, or its quotas were set (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// What it may use.
    pub quotas: Quotas,
    /// Number of the last change of its quotas; 0 if they were never set.
    pub changed: i64,
}

/// The amount that a tenant has stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TenantUse {
    /// Number of sessions, open and closed.
    pub sessions: u64,
    /// Bytes of their epochs and solutions, approximately.
    pub stored_bytes: u64,
}

#[derive(sqlx::FromRow)]
struct RawTenant {
    name: String,
    created_unix_ms: i64,
    sessions: Option<i64>,
    epochs_per_s: Option<f64>,
    cpu_s_per_minute: Option<f64>,
    stored_bytes: Option<i64>,
    job_bytes: Option<i64>,
    changed: i64,
}

impl RawTenant {
    fn parse(self) -> TenantRow {
        let Self { epochs_per_s, cpu_s_per_minute, created_unix_ms, changed, .. } = self;
        let sessions = self.sessions.map(|sessions| sessions as u64);
        let stored_bytes = self.stored_bytes.map(|bytes| bytes as u64);
        let job_bytes = self.job_bytes.map(|bytes| bytes as u64);
        let quotas = Quotas { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes };
        TenantRow { tenant: Tenant::stored(&self.name), created_unix_ms, quotas, changed }
    }
}

macro_rules! select_tenants {
    ($condition:literal) => {
        concat!(
            "SELECT name, created_unix_ms, sessions, epochs_per_s, cpu_s_per_minute, ",
            "stored_bytes, job_bytes, changed FROM tenants ",
            $condition
        )
    };
}

impl Store {
    /// Sets the quotas of a tenant, as an act of `author`. The tenant exists from then on. With
    /// `expected`, returns `false` if the tenant's quotas have another etag.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn set_quotas(
        &self,
        tenant: &Tenant,
        quotas: &Quotas,
        unix_ms: i64,
        expected: Option<&str>,
        author: &Author,
    ) -> Result<bool, StoreError> {
        let set = writing!(&self.pool, pool => {
            let set = async {
                let mut transaction = pool.begin().await?;
                let number: i64 =
                    sqlx::query_scalar(COUNT_UP).fetch_one(&mut *transaction).await?;
                let present = sqlx::query_as(select_tenants!("WHERE name = $1"));
                let present: Option<RawTenant> =
                    present.bind(tenant.name()).fetch_optional(&mut *transaction).await?;
                let present = present.map(RawTenant::parse);
                let etag = present.as_ref().map(|row| row.quotas.etag());
                if expected.is_some() && etag.as_deref() != expected {
                    return Ok(false);
                }
                if present.as_ref().is_some_and(|row| row.quotas == *quotas) {
                    return Ok(true); // No act for the audit log.
                }
                let set = sqlx::query(SET)
                    .bind(tenant.name())
                    .bind(unix_ms)
                    .bind(quotas.sessions.map(|sessions| sessions as i64))
                    .bind(quotas.epochs_per_s)
                    .bind(quotas.cpu_s_per_minute)
                    .bind(quotas.stored_bytes.map(|bytes| bytes as i64))
                    .bind(quotas.job_bytes.map(|bytes| bytes as i64))
                    .bind(number);
                set.execute(&mut *transaction).await?;
                let before = present.map(|row| row.quotas).unwrap_or_default();
                let (object, change) = (tenant.name(), quotas.changes_since(&before));
                let act = Act { call: "Tenants.Set", tenant, object, change };
                note!(self, transaction, &author.does(act, unix_ms));
                transaction.commit().await?;
                Ok::<bool, sqlx::Error>(true)
            };
            set.await
        });
        set.map_err(StoreError::database("setting the quotas of a tenant"))
    }

    /// The tenant of this name.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn tenant(&self, tenant: &Tenant) -> Result<Option<TenantRow>, StoreError> {
        let row: Result<Option<RawTenant>, _> = reading!(&self.pool, pool => {
            let sql = select_tenants!("WHERE name = $1");
            sqlx::query_as(sql).bind(tenant.name()).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a tenant"))?;
        Ok(row.map(RawTenant::parse))
    }

    /// Up to `count` tenants in order of their names, after this name.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn tenants(
        &self,
        after: &str,
        count: i64,
    ) -> Result<Vec<TenantRow>, StoreError> {
        let rows: Result<Vec<RawTenant>, _> = reading!(list &self.pool, pool => {
            let sql = select_tenants!("WHERE $1 < name ORDER BY name LIMIT $2");
            sqlx::query_as(sql).bind(after).bind(count).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("listing tenants"))?;
        Ok(rows.into_iter().map(RawTenant::parse).collect())
    }

    /// Tenants whose quotas were set after the change with this number, in the order of the
    /// changes.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn changed_tenants(&self, after: i64) -> Result<Vec<TenantRow>, StoreError> {
        let rows: Result<Vec<RawTenant>, _> = reading!(&self.key_pool, pool => {
            let sql = select_tenants!("WHERE $1 < changed ORDER BY changed");
            sqlx::query_as(sql).bind(after).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading changed tenants"))?;
        Ok(rows.into_iter().map(RawTenant::parse).collect())
    }

    /// The amount that a tenant has stored.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn tenant_use(&self, tenant: &Tenant) -> Result<TenantUse, StoreError> {
        let row: Result<(i64, i64), _> = reading!(list &self.pool, pool => {
            let sql = "SELECT COUNT(*), CAST(COALESCE(SUM(h.stored_bytes), 0) AS BIGINT)
                       FROM sessions s JOIN session_heads h ON h.session = s.key
                       WHERE s.tenant = $1 AND s.deleted_unix_ms IS NULL";
            sqlx::query_as(sql).bind(tenant.name()).fetch_one(pool).await
        });
        let (sessions, bytes) = row.map_err(StoreError::database("counting what is stored"))?;
        let (sessions, stored_bytes) = (sessions as u64, bytes.max(0) as u64);
        Ok(TenantUse { sessions, stored_bytes })
    }
}
