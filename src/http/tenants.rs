//! `/v1/tenants`.

use axum::extract::Path;

use crate::contract::{Caller, Refusal, calls, v1};
use crate::refusal::Code;

use super::body::{JsonBody, StrictQuery};
use super::conditions::{ETag, IfMatch, etag};
use super::json::Json;
use super::lists::PageQuery;
use super::problem::Refused;

/// Returns a tenant with its quotas and what it uses: the caller's, and to the operator any.
#[utoipa::path(get, operation_id = "tenantsGet",
    path = "/v1/tenants/{tenant}", tag = "Tenants",
    params(("tenant" = String, Path, description = "Its name")),
    responses((status = 200, description = "The tenant", body = v1::Tenant, headers(
        ("ETag" = String, description = "Etag of its quotas"))), Refused))]
pub(super) async fn get(
    caller: Caller,
    Path(tenant): Path<String>,
) -> Result<(ETag, Json<v1::Tenant>), Refused> {
    let tenant = calls::tenants::get(&caller, v1::GetTenantRequest { tenant }).await?;
    Ok((etag(&tenant.etag), Json(tenant)))
}

/// Lists tenants in order of their names: the caller's, and to the operator all.
#[utoipa::path(get, operation_id = "tenantsList",
    path = "/v1/tenants", tag = "Tenants", params(PageQuery),
    responses((status = 200, description = "A page of tenants",
        body = v1::ListTenantsResponse), Refused))]
pub(super) async fn list(
    caller: Caller,
    StrictQuery(page): StrictQuery<PageQuery>,
) -> Result<Json<v1::ListTenantsResponse>, Refused> {
    let PageQuery { page_size, page_token } = page;
    let request = v1::ListTenantsRequest { page_size, page_token };
    Ok(Json(calls::tenants::list(&caller, request).await?))
}

/// Sets all quotas of a tenant; those that are absent end. For the operator.
///
/// With the header `If-Match`, or `etag` in the body, the call is refused (`ETAG_MISMATCH`) if
/// somebody has set the quotas since.
#[utoipa::path(put, operation_id = "tenantsSet",
    path = "/v1/tenants/{tenant}", tag = "Tenants",
    params(("tenant" = String, Path, description = "Its name"),
        ("If-Match" = Option<String>, Header, description = "Its etag in quotes, as it was read")),
    request_body = v1::SetTenantRequest,
    responses((status = 200, description = "The tenant", body = v1::Tenant, headers(
        ("ETag" = String, description = "Etag of its quotas"))), Refused))]
pub(super) async fn set(
    caller: Caller,
    Path(tenant): Path<String>,
    if_match: IfMatch,
    JsonBody(mut request): JsonBody<v1::SetTenantRequest>,
) -> Result<(ETag, Json<v1::Tenant>), Refused> {
    if !request.tenant.is_empty() && request.tenant != tenant {
        let message = format!("the path names {tenant:?}, the body {:?}", request.tenant);
        return Err(Refusal::new(Code::InvalidField, message).at("tenant").into());
    }
    request.etag = if_match.or(request.etag)?;
    let request = v1::SetTenantRequest { tenant, ..request };
    let tenant = calls::tenants::set(&caller, request).await?;
    Ok((etag(&tenant.etag), Json(tenant)))
}
