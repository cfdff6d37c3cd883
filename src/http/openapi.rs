//! The REST door as OpenAPI 3.1.

use utoipa::OpenApi;

use super::{
    bases, job_events, jobs, keys, navigation, positioning, raw, sessions, sign_in, solutions,
    tenants, track, watch,
};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Graphfix",
        description = "GNSS positioning: raw observations in, stored positions out. Every call has \
                       its twin in the gRPC package graphfix.v1, on the same port. Times are \
                       GPS week and nanoseconds of week; refusals are RFC 9457 problem documents \
                       with a stable code.",
        license(name = "MIT OR Apache-2.0"),
    ),
    tags(
        (name = "Sessions", description = "A rover's sessions"),
        (name = "Positioning", description = "Epochs in, solutions out"),
        (name = "Solutions", description = "What was stored"),
        (name = "Navigation", description = "Broadcast ephemerides, which every session uses"),
        (name = "Jobs", description = "Files in, a file of positions and a report out"),
        (name = "Bases", description = "Base stations, which sessions relative to one name"),
        (name = "Keys", description = "API keys: who may call what"),
        (name = "Tenants", description = "What each tenant may use, and what it uses"),
        (name = "Sign-in", description = "A cookie for a browser in place of a key"),
    ),
    paths(
        sessions::create,
        sessions::list,
        sessions::heads,
        sessions::get,
        sessions::update,
        sessions::reset,
        sessions::close,
        positioning::push_epochs,
        raw::push,
        positioning::solve,
        positioning::solve_once,
        solutions::list,
        solutions::series,
        watch::watch,
        solutions::explain,
        track::track,
        navigation::push,
        navigation::status,
        bases::create,
        bases::list,
        bases::get,
        bases::delete,
        bases::push_epochs,
        bases::upload,
        jobs::create,
        jobs::list,
        jobs::get,
        job_events::events,
        jobs::cancel,
        jobs::result,
        jobs::report,
        keys::create,
        keys::list,
        keys::revoke,
        tenants::get,
        tenants::list,
        tenants::set,
        sign_in::get,
        sign_in::create,
        sign_in::delete,
    )
)]
struct Rest;

/// The document at `/openapi.json`.
pub fn document() -> utoipa::openapi::OpenApi {
    Rest::openapi()
}
