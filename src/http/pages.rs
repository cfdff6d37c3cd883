//! Paths that are not calls: health and schema.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use crate::contract::{Refusal, Service};
use crate::refusal::Code;

use super::openapi;
use super::problem::{Refused, whole_seconds};

/// `GET /healthz`: 200 while the process runs.
pub(super) async fn live() -> &'static str {
    "ok\n"
}

/// `GET /readyz`: 200 while epochs can be taken and committed, otherwise 503 with `Retry-After`.
/// The body gives the reason.
pub(super) async fn ready(State(service): State<Service>) -> Response {
    let readiness = service.readiness().await;
    let Some(delay_ms) = readiness.retry_after_ms else { return Json(readiness).into_response() };
    let retry_after = [(header::RETRY_AFTER, HeaderValue::from(whole_seconds(delay_ms)))];
    (StatusCode::SERVICE_UNAVAILABLE, retry_after, Json(readiness)).into_response()
}

/// `GET /metrics`: the meters of the service, in the text format of OpenMetrics 1.0, which
/// Prometheus reads.
pub(super) async fn metrics(
    State(service): State<Service>,
) -> ([(HeaderName, &'static str); 1], String) {
    let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], service.metrics().await)
}

/// `GET /openapi.json`.
pub(super) async fn schema() -> Json<utoipa::openapi::OpenApi> {
    Json(openapi::document())
}

/// The answer to a path with the form of a call or a page that does not exist.
pub(super) async fn no_route(uri: Uri) -> Refused {
    Refusal::new(Code::RouteNotFound, format!("there is no {}", uri.path())).into()
}
