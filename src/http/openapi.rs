//! The REST door as OpenAPI 3.1.

use utoipa::OpenApi;

use super::{bases, navigation, positioning, raw, sessions, solutions, watch};

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
        (name = "Bases", description = "Base stations, which sessions relative to one name"),
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
        navigation::push,
        navigation::status,
        bases::create,
        bases::list,
        bases::get,
        bases::delete,
        bases::push_epochs,
        bases::upload,
    )
)]
struct Rest;

/// The document at `/openapi.json`.
pub fn document() -> utoipa::openapi::OpenApi {
    Rest::openapi()
}
