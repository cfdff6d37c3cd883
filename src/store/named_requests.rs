//! Requests that create something and have a name of the client's, so that a repetition creates
//! nothing.

use crate::tenant::Tenant;

use super::pool::reading;
use super::{Store, StoreError};

/// The client's name of a request, and what it asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedRequest {
    /// The name, of which a tenant has one of each kind.
    pub name: String,
    /// Hash of the content.
    pub hash: String,
}

/// What a named request has created.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct Created {
    /// Public id.
    pub(crate) id: String,
    /// Hash of the request's content.
    #[sqlx(rename = "request_hash")]
    pub(crate) hash: String,
}

impl Store {
    /// The session that a tenant's request of this name has created, unless it is deleted.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn session_created_by(
        &self,
        tenant: &Tenant,
        request: &str,
    ) -> Result<Option<Created>, StoreError> {
        let created: Result<Option<Created>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT id, request_hash FROM sessions
                       WHERE tenant = $1 AND request_name = $2";
            sqlx::query_as(sql).bind(tenant.name()).bind(request).fetch_optional(pool).await
        });
        created.map_err(StoreError::database("reading a named request"))
    }
}
