//! Requests that create something and carry a name chosen by the client. A repeated request with
//! the same name creates nothing.

use crate::tenant::Tenant;

use super::pool::reading;
use super::{Store, StoreError};

/// The client's name of a request, and the hash of its content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedRequest {
    /// The name. It is unique for a tenant and the kind of object.
    pub name: String,
    /// Hash of the content.
    pub hash: String,
}

/// The object that a named request has created.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct Created {
    /// Public id.
    pub(crate) id: String,
    /// Hash of the request's content.
    #[sqlx(rename = "request_hash")]
    pub(crate) hash: String,
}

impl Store {
    /// The session that a tenant's request with this name has created, unless it is deleted.
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
