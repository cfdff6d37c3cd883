//! The REST door, and the port that both doors share. The router is in this file.

mod admission;
mod answer;
mod audit;
mod bases;
mod body;
mod caller;
mod conditions;
mod connection;
mod connection_slots;
mod cross_origin;
mod dashboard;
mod download;
mod error_page;
mod forwarding;
mod handshake;
mod head;
mod head_events;
mod history;
mod job_events;
mod job_report;
mod jobs;
mod json;
mod json_extent;
mod keys;
mod lists;
mod metered;
mod multipart;
mod navigation;
mod objects;
mod observations;
mod openapi;
mod pages;
mod positioning;
mod problem;
mod raw;
mod server;
mod sessions;
mod sign_in;
mod solutions;
mod tenants;
mod traced;
mod track;
mod unread;
mod uploads;
mod watch;

use axum::routing::{get, post};
use axum::{Extension, Router, middleware};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::decompression::RequestDecompressionLayer;
use utoipa_swagger_ui::{Config, SwaggerUi};

use crate::contract::Service;
use crate::grpc;

use body::BodyLimit;
use forwarding::Peers;

pub use openapi::document;
pub use problem::{Problem, http_status};
pub use server::serve;

/// Largest body of a call without epochs and files (bytes).
const CONTROL_BYTES: usize = 256 << 10;

/// Both doors on one router: REST, pages and gRPC. A request that is not in the table of calls
/// ([`crate::contract::access`]) is refused before it reaches a route.
pub fn router(service: &Service) -> Router {
    let limit = service.limits().body_bytes;
    let admission = (service.clone(), Peers::new(service.nodes()));
    let rest = controls()
        .layer(Extension(BodyLimit(limit.min(CONTROL_BYTES))))
        .merge(contents().layer(Extension(BodyLimit(limit))))
        .with_state(service.clone())
        .merge(dashboard::routes(service.tiles().as_ref()))
        .merge(SwaggerUi::new("/docs").config(Config::from("/openapi.json")))
        .layer(RequestDecompressionLayer::new())
        .layer(CatchPanicLayer::custom(server::panicked));
    let router = Router::new()
        .merge(rest)
        .merge(grpc::routes(service))
        .fallback(pages::no_route)
        .layer(middleware::from_fn_with_state(admission, admission::admit));
    let origins = service.web_origins();
    match origins.is_empty() {
        true => router,
        false => router.layer(middleware::from_fn_with_state(origins.clone(), cross_origin::share)),
    }
}

/// Calls with short bodies, and the pages.
fn controls() -> Router<Service> {
    Router::new()
        .route("/v1/sessions", get(sessions::list).post(sessions::create))
        .route("/v1/sessions:heads", get(sessions::heads))
        .route("/v1/sessions:watch", get(head_events::events))
        .route(
            "/v1/sessions/{session}",
            // POST is `{session}:solve` or `{session}:reset`.
            get(sessions::get)
                .patch(sessions::update)
                .delete(sessions::close)
                .post(positioning::act),
        )
        .route("/v1/sessions/{session}/solutions", get(solutions::list))
        .route("/v1/sessions/{session}/solutions:series", get(solutions::series))
        .route("/v1/sessions/{session}/solutions:residuals", get(solutions::residuals))
        .route("/v1/sessions/{session}/solutions:watch", get(watch::watch))
        .route("/v1/sessions/{session}/epochs/{seq}", get(solutions::explain))
        .route("/v1/sessions/{session}/observations.rnx", get(observations::observations))
        .merge(track::routes())
        .route("/v1/history/fleet", get(history::fleet))
        .route("/v1/history/sessions", get(history::sessions))
        .route("/v1/history/sessions/{session}", get(history::session))
        .route("/v1/bases", get(bases::list).post(bases::create))
        .route("/v1/bases/{base}", get(bases::get).delete(bases::delete))
        .route(jobs::PATH, get(jobs::list).post(jobs::create))
        .route("/v1/jobs/{job}", get(jobs::get).delete(jobs::end))
        .route("/v1/jobs/{job}/events", get(job_events::events))
        .route("/v1/jobs/{job}/result", get(jobs::result))
        .route("/v1/jobs/{job}/report", get(job_report::report))
        .route("/v1/jobs/{job}/deliveries", get(jobs::deliveries))
        .merge(uploads())
        .route("/v1/keys", get(keys::list).post(keys::create))
        .route("/v1/keys/{key}", get(keys::get).delete(keys::revoke))
        .route("/v1/tenants", get(tenants::list))
        .route("/v1/tenants/{tenant}", get(tenants::get).put(tenants::set))
        .route("/v1/audit", get(audit::list))
        .route("/v1/sign-in", get(sign_in::get).post(sign_in::create).delete(sign_in::delete))
        .route("/healthz", get(pages::live))
        .route("/readyz", get(pages::ready))
        .route("/metrics", get(pages::metrics))
        .route("/openapi.json", get(pages::schema))
        .route("/docs/errors", get(error_page::errors))
}

/// Uploads of files of jobs in several requests.
fn uploads() -> Router<Service> {
    let one = get(uploads::get).patch(uploads::append).delete(uploads::remove);
    Router::new()
        .route(uploads::PATH, post(uploads::create).options(uploads::options))
        .route("/v1/uploads/{upload}", one)
        .layer(middleware::from_fn(uploads::versioned))
}

/// Calls with epochs, bytes or files.
fn contents() -> Router<Service> {
    Router::new()
        .route("/v1/sessions/{session}/epochs", post(positioning::push_epochs))
        .route("/v1/sessions/{session}/raw", post(raw::push))
        .route("/v1/solve", post(positioning::solve_once))
        .route("/v1/navigation", get(navigation::status).post(navigation::push))
        .route("/v1/bases/{base}/epochs", post(bases::push_epochs))
        .route("/v1/bases/{base}/observations", post(bases::upload))
}
