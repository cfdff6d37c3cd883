//! `/v1/audit`.

use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, calls, v1};

use super::body::StrictQuery;
use super::json::Json;
use super::lists::order;
use super::problem::Refused;

/// Which entries to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct AuditQuery {
    /// At most this many items on the page, 1 to 1000; 100 if absent. A page may have fewer
    /// although more exist, because memory is scarce.
    #[param(minimum = 0, maximum = 1000)]
    page_size: u32,
    /// `nextPageToken` of the previous answer. The other parameters but `pageSize` must be those of
    /// its request.
    page_token: String,
    /// Name of a tenant. If absent the caller's, and for the operator all. Only the operator names
    /// another.
    tenant: String,
    /// Only entries of this actor.
    actor: String,
    /// Only entries of this call, such as `Keys.Create`.
    call: String,
    /// Only entries about the thing with this id.
    object: String,
    /// Only entries of refused calls, or only those of acts that were done; both if absent.
    refused: Option<bool>,
    /// Only entries from this time on, RFC 3339 in UTC.
    from_utc: String,
    /// Only entries before this time, RFC 3339 in UTC.
    to_utc: String,
    /// `NEWEST_FIRST` (if absent) or `OLDEST_FIRST`.
    order: Option<String>,
}

/// Lists the entries of the audit log, the newest first unless asked otherwise: those of the
/// caller's tenant; to the operator those of all.
#[utoipa::path(get, operation_id = "auditList",
    path = "/v1/audit", tag = "Audit", params(AuditQuery),
    responses((status = 200, description = "A page of entries",
        body = v1::ListAuditResponse), Refused))]
pub(super) async fn list(
    caller: Caller,
    StrictQuery(query): StrictQuery<AuditQuery>,
) -> Result<Json<v1::ListAuditResponse>, Refused> {
    let request = v1::ListAuditRequest {
        page_size: query.page_size,
        page_token: query.page_token,
        tenant: query.tenant,
        actor: query.actor,
        call: query.call,
        object: query.object,
        refused: query.refused,
        from_utc: query.from_utc,
        to_utc: query.to_utc,
        order: order(query.order)?,
    };
    Ok(Json(calls::audit::list(&caller, request).await?))
}
