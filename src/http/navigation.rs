//! `/v1/navigation`.

use crate::contract::{Caller, calls, v1};

use super::body::RawBody;
use super::json::Json;
use super::problem::Refused;

/// Takes a RINEX navigation file, plain or gzip. Its content is durable before the answer.
#[utoipa::path(post, operation_id = "navigationPush",
    path = "/v1/navigation", tag = "Navigation",
    request_body(content = String, content_type = "application/octet-stream",
        description = "RINEX 2.10 to 4.0x navigation, plain or gzip"),
    responses((status = 200, description = "What the file brought",
        body = v1::PushNavigationResponse),
        Refused))]
pub(super) async fn push(
    caller: Caller,
    RawBody(content): RawBody,
) -> Result<Json<v1::PushNavigationResponse>, Refused> {
    let request = v1::PushNavigationRequest { content };
    Ok(Json(calls::navigation::push(&caller, request).await?))
}

/// Lists the satellites with usable ephemerides, and the time that these cover.
#[utoipa::path(get, operation_id = "navigationStatus",
    path = "/v1/navigation", tag = "Navigation",
    responses((status = 200, description = "What is covered", body = v1::NavigationStatusResponse),
        Refused))]
pub(super) async fn status(caller: Caller) -> Result<Json<v1::NavigationStatusResponse>, Refused> {
    Ok(Json(calls::navigation::status(&caller)))
}
