//! Epochs are pushed, solutions are returned.

use axum::extract::{FromRequest, Path, Request};
use axum::response::{IntoResponse, Response};

use crate::contract::{Caller, Refusal, calls, v1};
use crate::refusal::Code;

use super::body::{JsonBody, OptionalJsonBody};
use super::json::Json;
use super::problem::Refused;
use super::sessions::{self, named};

/// Positions the epochs of a push in their order. Acknowledged epochs are durable.
///
/// If one epoch is malformed, the whole push is refused and nothing is positioned. If the session
/// refuses an epoch (a conflict, or out of order), it still positions the others, and the answer
/// has the refusal in place of that solution. If it refuses every epoch, the call is refused with
/// the first one's refusal.
#[utoipa::path(post, operation_id = "positioningPushEpochs",
    path = "/v1/sessions/{session}/epochs", tag = "Positioning",
    params(("session" = String, Path, description = "Its id")),
    request_body = v1::PushEpochsRequest,
    responses((status = 200, description = "The outcome of each epoch",
        body = v1::PushEpochsResponse), Refused))]
pub(super) async fn push_epochs(
    caller: Caller,
    Path(session): Path<String>,
    JsonBody(request): JsonBody<v1::PushEpochsRequest>,
) -> Result<Json<v1::PushEpochsResponse>, Refused> {
    let session = named(session, &request.session)?;
    let request = v1::PushEpochsRequest { session, ..request };
    Ok(Json(calls::positioning::push_epochs(&caller, request).await?))
}

/// `POST /v1/sessions/{session}:solve` or `:reset`.
pub(super) async fn act(caller: Caller, Path(target): Path<String>, request: Request) -> Response {
    let named = target.rsplit_once(':').map(|(session, call)| (session.to_owned(), call));
    match named {
        Some((session, "solve")) => match JsonBody::from_request(request, &()).await {
            Ok(body) => solve(caller, session, body).await.into_response(),
            Err(refused) => refused.into_response(),
        },
        Some((session, "reset")) => match OptionalJsonBody::from_request(request, &()).await {
            Ok(body) => sessions::reset(caller, session, body).await.into_response(),
            Err(refused) => refused.into_response(),
        },
        _ => {
            let message = format!("POST /v1/sessions/{target} is not a call");
            Refused(Refusal::new(Code::RouteNotFound, message)).into_response()
        }
    }
}

/// Solves the session's present window with any mode and options. Nothing is stored.
#[utoipa::path(post, operation_id = "positioningSolve",
    path = "/v1/sessions/{session}:solve", tag = "Positioning",
    params(("session" = String, Path, description = "Its id")),
    request_body = v1::SolveRequest,
    responses((status = 200, description = "The solution", body = v1::SolveResponse), Refused))]
async fn solve(
    caller: Caller,
    session: String,
    JsonBody(request): JsonBody<v1::SolveRequest>,
) -> Result<Json<v1::SolveResponse>, Refused> {
    let session = named(session, &request.session)?;
    let request = v1::SolveRequest { session, ..request };
    Ok(Json(calls::positioning::solve(&caller, request).await?))
}

/// Positions one or a few epochs without a session. Nothing is stored.
#[utoipa::path(post, operation_id = "positioningSolveOnce",
    path = "/v1/solve", tag = "Positioning",
    request_body = v1::SolveOnceRequest,
    responses((status = 200, description = "The solution of each epoch",
        body = v1::SolveOnceResponse), Refused))]
pub(super) async fn solve_once(
    caller: Caller,
    JsonBody(request): JsonBody<v1::SolveOnceRequest>,
) -> Result<Json<v1::SolveOnceResponse>, Refused> {
    Ok(Json(calls::positioning::solve_once(&caller, request).await?))
}
