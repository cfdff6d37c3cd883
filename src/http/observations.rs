//! `/v1/sessions/{session}/observations.rnx`.

use axum::extract::Path;
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, calls, v1};

use super::body::StrictQuery;
use super::download::download;
use super::problem::Refused;
use super::solutions::time;

/// The epochs of a file.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ObservationsQuery {
    /// First time: GPS week and seconds of week, such as `2051:46701.5`.
    from: Option<String>,
    /// Last time, in the same form.
    to: Option<String>,
}

/// Returns the stored epochs of a session as a RINEX 3.05 file of observations.
///
/// The answer is read from the store while it is sent, so its length is not known before. If the
/// store fails in between, the connection breaks off, and the file is not complete.
#[utoipa::path(get, operation_id = "sessionsObservations",
    path = "/v1/sessions/{session}/observations.rnx", tag = "Sessions",
    params(("session" = String, Path, description = "Its id"), ObservationsQuery),
    responses((status = 200, description = "The file", body = String, content_type = "text/plain"),
        Refused))]
pub(super) async fn observations(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<ObservationsQuery>,
) -> Result<Response, Refused> {
    let name = format!("{session}.rnx");
    let from = query.from.map(|text| time("from", &text)).transpose()?;
    let to = query.to.map(|text| time("to", &text)).transpose()?;
    let request = v1::SessionObservationsRequest { session, from, to };
    let content = calls::observations::observations(&caller, request).await?;
    Ok(download(&name, "text/plain; charset=utf-8", content))
}
