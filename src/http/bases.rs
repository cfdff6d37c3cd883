//! `/v1/bases`.

use axum::extract::Path;
use axum::http::StatusCode;

use crate::contract::{Caller, Refusal, calls, v1};
use crate::refusal::Code;

use super::body::{JsonBody, RawBody, StrictQuery};
use super::conditions::{IdempotencyKey, Location, created, location};
use super::json::Json;
use super::lists::PageQuery;
use super::problem::Refused;

/// Creates a base.
///
/// With the header `Idempotency-Key`, or `requestId` in the body, a repetition of the same request
/// returns the same base, with status 200.
#[utoipa::path(post, operation_id = "basesCreate",
    path = "/v1/bases", tag = "Bases",
    params(("Idempotency-Key" = Option<String>, Header, description = "Names this request")),
    request_body = v1::CreateBaseRequest,
    responses(
        (status = 201, description = "The base", body = v1::Base,
            headers(("Location" = String, description = "Path of the base"))),
        (status = 200, description = "The base, which this request has created before",
            body = v1::Base),
        Refused))]
pub(super) async fn create(
    caller: Caller,
    key: IdempotencyKey,
    JsonBody(mut request): JsonBody<v1::CreateBaseRequest>,
) -> Result<(StatusCode, Location, Json<v1::Base>), Refused> {
    request.request_id = key.or(request.request_id)?;
    let (base, is_new) = calls::bases::create(&caller, request).await?;
    Ok((created(is_new), location("/v1/bases", &base.base), Json(base)))
}

/// Returns a base with its health.
#[utoipa::path(get, operation_id = "basesGet",
    path = "/v1/bases/{base}", tag = "Bases",
    params(("base" = String, Path, description = "Its id")),
    responses((status = 200, description = "The base", body = v1::Base), Refused))]
pub(super) async fn get(
    caller: Caller,
    Path(base): Path<String>,
) -> Result<Json<v1::Base>, Refused> {
    Ok(Json(calls::bases::get(&caller, v1::GetBaseRequest { base }).await?))
}

/// Lists bases with their health, in order of id.
#[utoipa::path(get, operation_id = "basesList",
    path = "/v1/bases", tag = "Bases", params(PageQuery),
    responses((status = 200, description = "A page of bases",
        body = v1::ListBasesResponse), Refused))]
pub(super) async fn list(
    caller: Caller,
    StrictQuery(page): StrictQuery<PageQuery>,
) -> Result<Json<v1::ListBasesResponse>, Refused> {
    let PageQuery { page_size, page_token } = page;
    let request = v1::ListBasesRequest { page_size, page_token };
    Ok(Json(calls::bases::list(&caller, request).await?))
}

/// Deletes a base with its epochs, unless an open session uses it.
#[utoipa::path(delete, operation_id = "basesDelete",
    path = "/v1/bases/{base}", tag = "Bases",
    params(("base" = String, Path, description = "Its id")),
    responses((status = 200, description = "The base is deleted",
        body = v1::DeleteBaseResponse), Refused))]
pub(super) async fn delete(
    caller: Caller,
    Path(base): Path<String>,
) -> Result<Json<v1::DeleteBaseResponse>, Refused> {
    Ok(Json(calls::bases::delete(&caller, v1::DeleteBaseRequest { base }).await?))
}

/// Takes epochs of a base in order of time. Acknowledged epochs are durable.
///
/// If an epoch is refused, the others are still taken. An epoch that is stored already with the
/// same content is acknowledged again. If every epoch is refused, the call is refused with the
/// first one's refusal.
#[utoipa::path(post, operation_id = "basesPushEpochs",
    path = "/v1/bases/{base}/epochs", tag = "Bases",
    params(("base" = String, Path, description = "Its id")),
    request_body = v1::PushBaseEpochsRequest,
    responses((status = 200, description = "The outcome of each epoch",
        body = v1::PushBaseEpochsResponse), Refused))]
pub(super) async fn push_epochs(
    caller: Caller,
    Path(base): Path<String>,
    JsonBody(request): JsonBody<v1::PushBaseEpochsRequest>,
) -> Result<Json<v1::PushBaseEpochsResponse>, Refused> {
    if !request.base.is_empty() && request.base != base {
        let message = format!("the path names {base:?}, the body {:?}", request.base);
        return Err(Refusal::new(Code::InvalidField, message).at("base").into());
    }
    let request = v1::PushBaseEpochsRequest { base, ..request };
    Ok(Json(calls::bases::push_epochs(&caller, request).await?))
}

/// Takes a RINEX observation file of a base. If the base has no position yet, it takes the one of
/// the header.
#[utoipa::path(post, operation_id = "basesUpload",
    path = "/v1/bases/{base}/observations", tag = "Bases",
    params(("base" = String, Path, description = "Its id")),
    request_body(content = String, content_type = "application/octet-stream",
        description = "RINEX 2.10 to 4.0x observations or CRINEX, plain or gzip"),
    responses((status = 200, description = "What the file brought",
        body = v1::UploadBaseResponse), Refused))]
pub(super) async fn upload(
    caller: Caller,
    Path(base): Path<String>,
    RawBody(content): RawBody,
) -> Result<Json<v1::UploadBaseResponse>, Refused> {
    let request = v1::UploadBaseRequest { base, content };
    Ok(Json(calls::bases::upload(&caller, request).await?))
}
