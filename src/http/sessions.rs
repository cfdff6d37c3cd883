//! `/v1/sessions`.

use axum::extract::Path;
use axum::http::StatusCode;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, Refusal, calls, v1};
use crate::refusal::Code;

use super::body::{JsonBody, OptionalJsonBody, StrictQuery};
use super::conditions::{ETag, IdempotencyKey, IfMatch, Location, created, etag, location};
use super::json::Json;
use super::lists::{area, order, view};
use super::problem::Refused;

/// The session in the path. A session in the body must be the same.
pub(super) fn named(path: String, body: &str) -> Result<String, Refusal> {
    if body.is_empty() || body == path {
        return Ok(path);
    }
    let message = format!("the path names {path:?}, the body {body:?}");
    Err(Refusal::new(Code::InvalidField, message).at("session"))
}

/// Opens a session. Returns it with the configuration in force.
///
/// With the header `Idempotency-Key`, or `requestId` in the body, a repetition of the same request
/// returns the same session, with status 200.
#[utoipa::path(post, operation_id = "sessionsCreate",
    path = "/v1/sessions", tag = "Sessions",
    params(("Idempotency-Key" = Option<String>, Header, description = "Names this request")),
    request_body = v1::CreateSessionRequest,
    responses(
        (status = 201, description = "The session", body = v1::Session, headers(
            ("Location" = String, description = "Path of the session"),
            ("ETag" = String, description = "Etag of its settings"))),
        (status = 200, description = "The session, which this request has opened before",
            body = v1::Session),
        Refused))]
pub(super) async fn create(
    caller: Caller,
    key: IdempotencyKey,
    JsonBody(mut request): JsonBody<v1::CreateSessionRequest>,
) -> Result<(StatusCode, Location, ETag, Json<v1::Session>), Refused> {
    request.request_id = key.or(request.request_id)?;
    let (session, is_new) = calls::sessions::create(&caller, request).await?;
    let place = location("/v1/sessions", &session.session);
    Ok((created(is_new), place, etag(&session.etag), Json(session)))
}

/// Returns a session with the configuration in force.
#[utoipa::path(get, operation_id = "sessionsGet",
    path = "/v1/sessions/{session}", tag = "Sessions",
    params(("session" = String, Path, description = "Its id")),
    responses((status = 200, description = "The session", body = v1::Session, headers(
        ("ETag" = String, description = "Etag of its settings"))), Refused))]
pub(super) async fn get(
    caller: Caller,
    Path(session): Path<String>,
) -> Result<(ETag, Json<v1::Session>), Refused> {
    let request = v1::GetSessionRequest { session };
    let session = calls::sessions::get(&caller, request).await?;
    Ok((etag(&session.etag), Json(session)))
}

/// Which sessions to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SessionsQuery {
    /// At most this many items on the page, 1 to 1000; 100 if absent. A page of the view `FULL`
    /// has at most 128 sessions. A page may have fewer although more exist, because memory is
    /// scarce.
    #[param(minimum = 0, maximum = 1000)]
    page_size: u32,
    /// `nextPageToken` of the previous answer. The other parameters but `pageSize` must be those of
    /// its request.
    page_token: String,
    /// `FULL` (if absent), or `BASIC`: without `configuration`.
    view: Option<String>,
    /// Only closed sessions, or only open ones; all if absent.
    closed: Option<bool>,
    /// Only those of this mode.
    mode: String,
    /// Only those with exactly this label.
    label: String,
    /// `NEWEST_FIRST` (if absent) or `OLDEST_FIRST`.
    order: Option<String>,
}

/// Lists sessions, the newest first unless asked otherwise.
#[utoipa::path(get, operation_id = "sessionsList",
    path = "/v1/sessions", tag = "Sessions", params(SessionsQuery),
    responses((status = 200, description = "A page of sessions",
        body = v1::ListSessionsResponse), Refused))]
pub(super) async fn list(
    caller: Caller,
    StrictQuery(query): StrictQuery<SessionsQuery>,
) -> Result<Json<v1::ListSessionsResponse>, Refused> {
    let request = v1::ListSessionsRequest {
        page_size: query.page_size,
        page_token: query.page_token,
        view: view(query.view)?,
        closed: query.closed,
        mode: query.mode,
        label: query.label,
        order: order(query.order)?,
    };
    Ok(Json(calls::sessions::list(&caller, request).await?))
}

/// Which heads to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HeadsQuery {
    /// At most this many heads on the page, 1 to 10000; 1000 if absent.
    #[param(minimum = 0, maximum = 10_000)]
    page_size: u32,
    /// `nextPageToken` of the previous answer. The other parameters but `pageSize` must be those of
    /// its request.
    page_token: String,
    /// Only those of closed sessions, or only of open ones; all if absent.
    closed: Option<bool>,
    /// Only those of this mode.
    mode: String,
    /// Only those with exactly this label.
    label: String,
    /// `NEWEST_FIRST` (if absent) or `OLDEST_FIRST`.
    order: Option<String>,
    /// Only those with their latest position in this area: `SOUTH,WEST,NORTH,EAST` in degrees. West
    /// may be east of east: the area then crosses 180°.
    area: Option<String>,
}

/// Lists the latest status and position of sessions, the newest session first. Without the
/// configurations, so that a fleet fits into few pages.
#[utoipa::path(get, operation_id = "sessionsHeads",
    path = "/v1/sessions:heads", tag = "Sessions", params(HeadsQuery),
    responses((status = 200, description = "A page of heads",
        body = v1::ListHeadsResponse), Refused))]
pub(super) async fn heads(
    caller: Caller,
    StrictQuery(query): StrictQuery<HeadsQuery>,
) -> Result<Json<v1::ListHeadsResponse>, Refused> {
    let request = v1::ListHeadsRequest {
        page_size: query.page_size,
        page_token: query.page_token,
        closed: query.closed,
        mode: query.mode,
        label: query.label,
        order: order(query.order)?,
        area: query.area.map(|text| area(&text)).transpose()?,
    };
    Ok(Json(calls::sessions::heads(&caller, request).await?))
}

/// Changes the given fields and no others. The epochs that follow are positioned with the new
/// configuration.
///
/// With the header `If-Match`, or `etag` in the body, the change is refused (`ETAG_MISMATCH`) if
/// somebody has changed the session since.
#[utoipa::path(patch, operation_id = "sessionsUpdate",
    path = "/v1/sessions/{session}", tag = "Sessions",
    params(("session" = String, Path, description = "Its id"),
        ("If-Match" = Option<String>, Header, description = "Its etag in quotes, as it was read")),
    request_body = v1::UpdateSessionRequest,
    responses((status = 200, description = "The session with its changes", body = v1::Session,
        headers(("ETag" = String, description = "Etag of its settings"))), Refused))]
pub(super) async fn update(
    caller: Caller,
    Path(session): Path<String>,
    if_match: IfMatch,
    JsonBody(mut request): JsonBody<v1::UpdateSessionRequest>,
) -> Result<(ETag, Json<v1::Session>), Refused> {
    request.session = named(session, &request.session)?;
    request.etag = if_match.or(request.etag)?;
    let session = calls::sessions::update(&caller, request).await?;
    Ok((etag(&session.etag), Json(session)))
}

/// Begins a new arc of a session: its next epoch may be earlier than the last one, unless its time
/// is implausible, and its estimator starts again. Numbers go on rising.
#[utoipa::path(post, operation_id = "sessionsReset",
    path = "/v1/sessions/{session}:reset", tag = "Sessions",
    params(("session" = String, Path, description = "Its id")),
    // Named by a reference: a body given by its type would be required, or could be `null`.
    request_body(content = ref("#/components/schemas/ResetSessionRequest"),
        content_type = "application/json", description = "May be empty"),
    responses((status = 200, description = "The session", body = v1::Session), Refused))]
pub(super) async fn reset(
    caller: Caller,
    session: String,
    OptionalJsonBody(request): OptionalJsonBody<v1::ResetSessionRequest>,
) -> Result<Json<v1::Session>, Refused> {
    let request = v1::ResetSessionRequest { session: named(session, &request.session)? };
    Ok(Json(calls::sessions::reset(&caller, request).await?))
}

/// Whether to delete what a session has stored.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CloseQuery {
    /// Also deletes the session with its epochs and solutions. It is then not found any more.
    pub(super) purge: bool,
}

/// Closes a session. It takes no more epochs, and its solutions stay readable, unless it is purged.
#[utoipa::path(delete, operation_id = "sessionsClose",
    path = "/v1/sessions/{session}", tag = "Sessions",
    params(("session" = String, Path, description = "Its id"), CloseQuery),
    responses((status = 200, description = "The session as it is now, or was",
        body = v1::Session), Refused))]
pub(super) async fn close(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<CloseQuery>,
) -> Result<Json<v1::Session>, Refused> {
    if query.purge {
        let request = v1::DeleteSessionRequest { session };
        return Ok(Json(calls::sessions::delete(&caller, request).await?));
    }
    let request = v1::CloseSessionRequest { session };
    Ok(Json(calls::sessions::close(&caller, request).await?))
}
