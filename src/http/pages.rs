//! Paths that are not calls: health and schema.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, StatusCode, Uri, header};

use crate::contract::{Readiness, Refusal, Service};
use crate::refusal::Code;

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

/// `GET /metrics`: what the service has done and uses, in the text format of OpenMetrics 1.0, which
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

/// The answer to a path that looks like that of a call or a page, but does not exist.
pub(super) async fn no_route(uri: Uri) -> Refused {
    Refusal::new(Code::RouteNotFound, format!("there is no {}", uri.path())).into()
}
