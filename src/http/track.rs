//! `/v1/sessions/{session}/track.{format}`.

use axum::Router;
use axum::extract::Path;
use axum::response::Response;
use axum::routing::get;

use crate::contract::{Caller, Service, calls};

use super::body::StrictQuery;
use super::problem::Refused;
use super::solutions::{TrackQuery, file};

/// A route for each format.
pub(super) fn routes() -> Router<Service> {
    calls::track::formats().fold(Router::new(), |router, format| {
        let serve = move |caller, session, query| track(caller, session, query, format);
        router.route(&format!("/v1/sessions/{{session}}/track.{format}"), get(serve))
    })
}

/// Returns the stored solutions of a session as a file that other programs open.
///
/// The answer is read from the store while it is sent, so its length is not known before. If the
/// store fails in between, the connection breaks off, and the file is not complete.
#[utoipa::path(get, operation_id = "solutionsTrack",
    path = "/v1/sessions/{session}/track.{format}", tag = "Solutions",
    params(("session" = String, Path, description = "Its id"),
        ("format" = String, Path,
            description = "pos, csv, geojson, kml, gpx, nmea or parquet"), TrackQuery),
    responses((status = 200, description = "The file",
        content((String = "text/plain"), (String = "text/csv"),
            (String = "application/geo+json"), (String = "application/vnd.google-earth.kml+xml"),
            (String = "application/gpx+xml"), (String = "application/vnd.apache.parquet"))),
        Refused))]
pub(super) async fn track(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<TrackQuery>,
    format: &'static str,
) -> Result<Response, Refused> {
    file(&caller, session, format, query).await
}
