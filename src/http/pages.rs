//! Paths that are not calls: health and schema.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Method, StatusCode, Uri};
use axum::response::Response;

use crate::contract::{Readiness, Refusal, Service};
use crate::refusal::Code;

use super::admission::{answer, is_grpc};
use super::openapi;
use super::problem::Refused;

/// `GET /healthz`: 200 while the process runs.
pub(super) async fn live() -> &'static str {
    "ok\n"
}

/// `GET /readyz`: 200 while epochs can be taken and committed, otherwise 503. The body says why.
pub(super) async fn ready(State(service): State<Service>) -> (StatusCode, Json<Readiness>) {
    let readiness = service.readiness().await;
    let status = match readiness.ready {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    (status, Json(readiness))
}

/// `GET /openapi.json`.
pub(super) async fn schema() -> Json<utoipa::openapi::OpenApi> {
    Json(openapi::document())
}

/// The answer to an unknown path, as the addressed door sends it.
pub(super) async fn no_route(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let message = format!("{method} {} is not a call", uri.path());
    let refusal = Refusal::new(Code::RouteNotFound, message);
    answer(refusal, is_grpc(&headers))
}

/// The answer to a method that the path does not take.
pub(super) async fn no_method(method: Method, uri: Uri) -> Refused {
    let message = format!("{} does not take {method}", uri.path());
    Refusal::new(Code::MethodNotAllowed, message).into()
}
