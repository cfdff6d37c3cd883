//! `/v1/sessions/{session}/solutions`.

use axum::Json;
use axum::extract::{Path, State};
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Refusal, Service, calls, intake, v1};

use super::body::StrictQuery;
use super::problem::{Problem, Refused};

/// The solutions to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SolutionsQuery {
    /// First time: GPS week and seconds of week, such as `2051:46701.5`.
    from: Option<String>,
    /// Last time, in the same form.
    to: Option<String>,
    /// Only this status, such as `SINGLE`.
    status: Option<String>,
    /// The revisions of each epoch: `last` (if absent), `first` or `all`.
    revisions: Option<String>,
    /// Most solutions on the page, 1 to 10000; 1000 if absent.
    page_size: u32,
    /// `nextPageToken` of the previous answer.
    page_token: String,
}

/// Lists stored solutions of a session in order of seq and revision.
#[utoipa::path(get, operation_id = "solutionsList",
    path = "/v1/sessions/{session}/solutions", tag = "Solutions",
    params(("session" = String, Path, description = "Its id"), SolutionsQuery),
    responses((status = 200, body = v1::ListSolutionsResponse), (status = "4XX", body = Problem),
        (status = "5XX", body = Problem)))]
pub(super) async fn list(
    State(service): State<Service>,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<SolutionsQuery>,
) -> Result<Json<v1::ListSolutionsResponse>, Refused> {
    let request = v1::ListSolutionsRequest {
        session,
        from: query.from.map(|text| time("from", &text)).transpose()?,
        to: query.to.map(|text| time("to", &text)).transpose()?,
        status: query.status.map_or(Ok(0), |name| status(&name))?,
        revisions: query.revisions.map_or(Ok(0), |name| revisions(&name))?,
        page_size: query.page_size,
        page_token: query.page_token,
    };
    Ok(Json(calls::solutions::list(&service, request).await?))
}

fn time(field: &str, text: &str) -> Result<v1::GpsTime, Refusal> {
    intake::time_text(text).map(Into::into).map_err(|refusal| refusal.at(field))
}

fn status(name: &str) -> Result<i32, Refusal> {
    v1::Status::from_str_name(&format!("STATUS_{name}"))
        .map(i32::from)
        .ok_or_else(|| intake::unknown_status(name))
}

fn revisions(name: &str) -> Result<i32, Refusal> {
    v1::Revisions::from_str_name(&format!("REVISIONS_{}", name.to_uppercase()))
        .filter(|_| name.chars().all(|c| c.is_ascii_lowercase()))
        .filter(|revisions| *revisions != v1::Revisions::Unspecified)
        .map(i32::from)
        .ok_or_else(|| intake::unknown_revisions(name))
}
