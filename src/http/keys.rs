//! `/v1/keys`.

use axum::extract::Path;
use axum::http::StatusCode;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, calls, v1};

use super::body::{JsonBody, StrictQuery};
use super::conditions::{Location, location};
use super::json::Json;
use super::problem::Refused;
use super::sign_in::{NO_STORE, NoStore};

/// The page of the list of keys.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct KeysQuery {
    /// At most this many items on the page, 1 to 1000; 100 if absent. A page may have fewer
    /// although more exist, because memory is scarce.
    page_size: u32,
    /// `nextPageToken` of the previous answer.
    page_token: String,
    /// Name of the tenant; the caller's if absent. Only the operator names another.
    tenant: String,
}

/// Creates a key of the caller's tenant; the operator also of another one.
///
/// The answer has the secret, which nobody can read again. Once a key exists, every call needs one.
#[utoipa::path(post, operation_id = "keysCreate",
    path = "/v1/keys", tag = "Keys",
    request_body = v1::CreateKeyRequest,
    responses((status = 201, description = "The key with its secret", body = v1::CreateKeyResponse,
        headers(("Location" = String, description = "Path of the key"))), Refused))]
pub(super) async fn create(
    caller: Caller,
    JsonBody(request): JsonBody<v1::CreateKeyRequest>,
) -> Result<(StatusCode, Location, NoStore, Json<v1::CreateKeyResponse>), Refused> {
    let created = calls::keys::create(&caller, request).await?;
    let id = created.key.as_ref().map_or("", |key| &key.key);
    Ok((StatusCode::CREATED, location("/v1/keys", id), [NO_STORE], Json(created)))
}

/// Lists the keys of the caller's tenant, the newest first, also those that are revoked or have
/// expired; the operator also those of another tenant.
#[utoipa::path(get, operation_id = "keysList",
    path = "/v1/keys", tag = "Keys", params(KeysQuery),
    responses((status = 200, description = "A page of keys",
        body = v1::ListKeysResponse), Refused))]
pub(super) async fn list(
    caller: Caller,
    StrictQuery(query): StrictQuery<KeysQuery>,
) -> Result<Json<v1::ListKeysResponse>, Refused> {
    let KeysQuery { page_size, page_token, tenant } = query;
    let request = v1::ListKeysRequest { page_size, page_token, tenant };
    Ok(Json(calls::keys::list(&caller, request).await?))
}

/// Returns a key, also one that is revoked or has expired; the operator finds keys of every tenant.
#[utoipa::path(get, operation_id = "keysGet",
    path = "/v1/keys/{key}", tag = "Keys",
    params(("key" = String, Path, description = "Its id")),
    responses((status = 200, description = "The key, without its secret", body = v1::Key),
        Refused))]
pub(super) async fn get(caller: Caller, Path(key): Path<String>) -> Result<Json<v1::Key>, Refused> {
    Ok(Json(calls::keys::get(&caller, v1::GetKeyRequest { key }).await?))
}

/// Revokes a key. Calls with it are refused, and its open watches end within a second.
#[utoipa::path(delete, operation_id = "keysRevoke",
    path = "/v1/keys/{key}", tag = "Keys",
    params(("key" = String, Path, description = "Its id")),
    responses((status = 200, description = "The key", body = v1::Key), Refused))]
pub(super) async fn revoke(
    caller: Caller,
    Path(key): Path<String>,
) -> Result<Json<v1::Key>, Refused> {
    Ok(Json(calls::keys::revoke(&caller, v1::RevokeKeyRequest { key }).await?))
}
