//! Paths that are not calls: health, schema and home page.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::response::{Html, IntoResponse, Response};

use crate::contract::{Readiness, Refusal, Service};
use crate::grpc;
use crate::refusal::Code;

use super::openapi;
use super::problem::Refused;

/// `GET /`: the home page, with links.
pub(super) async fn home() -> Html<&'static str> {
    Html(include_str!("home.html"))
}

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

/// The answer to an unknown path, in the form of the door that was meant.
pub(super) async fn no_route(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let message = format!("{method} {} is not a call", uri.path());
    let refusal = Refusal::new(Code::RouteNotFound, message);
    let kind = headers.get(header::CONTENT_TYPE).map(|kind| kind.as_bytes());
    if kind.is_some_and(|kind| kind.starts_with(b"application/grpc")) {
        return grpc::to_status(&refusal).into_http::<axum::body::Body>();
    }
    Refused(refusal).into_response()
}

/// The answer to a method that the path does not take.
pub(super) async fn no_method(method: Method, uri: Uri) -> Refused {
    let message = format!("{} does not take {method}", uri.path());
    Refusal::new(Code::MethodNotAllowed, message).into()
}
