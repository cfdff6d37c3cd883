//! `/v1/sessions/{session}/solutions`.

use axum::extract::Path;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, Refusal, calls, intake, v1};
use crate::refusal::Code;

use super::body::StrictQuery;
use super::download::download;
use super::json::Json;
use super::lists::view;
use super::problem::Refused;

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
    /// At most this many solutions on the page, 1 to 10000; 1000 if absent.
    #[param(minimum = 0, maximum = 10_000)]
    page_size: u32,
    /// `nextPageToken` of the previous answer. The other parameters but `pageSize` must be those of
    /// its request.
    page_token: String,
    /// `FULL` (if absent), or `BASIC`: without `velocity`, `clock`, `dops`, `satellitesUsed` and
    /// `provenance`, two thirds of the bytes.
    view: Option<String>,
    /// `json` (if absent) for a page, or `pos`, `csv`, `geojson`, `kml`, `gpx`, `nmea` or `parquet`
    /// for a file of all, without `pageSize`, `pageToken` and `view`; or `rinex` for the
    /// observations of all epochs from `from` to `to`, without `status` and `revisions`.
    format: Option<String>,
}

/// Lists stored solutions of a session in order of seq and revision, or returns all as a file.
#[utoipa::path(get, operation_id = "solutionsList",
    path = "/v1/sessions/{session}/solutions", tag = "Solutions",
    params(("session" = String, Path, description = "Its id"), SolutionsQuery),
    responses((status = 200, description = "A page of solutions, or a file",
        content((v1::ListSolutionsResponse = "application/json"), (String = "text/plain"),
            (String = "text/csv"), (String = "application/geo+json"),
            (String = "application/vnd.google-earth.kml+xml"), (String = "application/gpx+xml"),
            (String = "application/vnd.apache.parquet"))), Refused))]
pub(super) async fn list(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<SolutionsQuery>,
) -> Result<Response, Refused> {
    if let Some(format) = query.format.as_deref().filter(|format| *format != "json") {
        let chosen = query.chosen_for_a_file()?;
        return file(&caller, session, format, chosen).await;
    }
    let request = v1::ListSolutionsRequest {
        session,
        from: query.from.map(|text| time("from", &text)).transpose()?,
        to: query.to.map(|text| time("to", &text)).transpose()?,
        status: query.status.map_or(Ok(0), |name| status(&name))?,
        revisions: query.revisions.map_or(Ok(0), |name| revisions(&name))?,
        page_size: query.page_size,
        page_token: query.page_token,
        view: view(query.view)?,
    };
    Ok(Json(calls::solutions::list(&caller, request).await?).into_response())
}

impl SolutionsQuery {
    /// The solutions of a file, which has no pages and no view.
    ///
    /// # Errors
    /// The query names a page or a view.
    fn chosen_for_a_file(&self) -> Result<TrackQuery, Refusal> {
        let given = [
            ("pageSize", self.page_size != 0),
            ("pageToken", !self.page_token.is_empty()),
            ("view", self.view.is_some()),
        ];
        if let Some((field, _)) = given.into_iter().find(|(_, is_given)| *is_given) {
            let message = "a file has all solutions that are chosen, with all that its format has";
            return Err(Refusal::new(Code::InvalidField, message).at(field));
        }
        Ok(TrackQuery {
            from: self.from.clone(),
            to: self.to.clone(),
            status: self.status.clone(),
            revisions: self.revisions.clone(),
        })
    }
}

/// The solutions of a track.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TrackQuery {
    /// First time: GPS week and seconds of week, such as `2051:46701.5`.
    from: Option<String>,
    /// Last time, in the same form.
    to: Option<String>,
    /// Only this status, such as `FIXED`.
    status: Option<String>,
    /// The revisions of each epoch: `last` (if absent), `first`, or in CSV and GeoJSON `all`.
    revisions: Option<String>,
}

impl TrackQuery {
    /// The request of a track.
    ///
    /// # Errors
    /// A time, the status or the choice of revisions is invalid.
    pub(super) fn request(
        self,
        session: String,
        format: &str,
    ) -> Result<v1::TrackRequest, Refusal> {
        Ok(v1::TrackRequest {
            session,
            format: format.to_owned(),
            from: self.from.map(|text| time("from", &text)).transpose()?,
            to: self.to.map(|text| time("to", &text)).transpose()?,
            status: self.status.map_or(Ok(0), |name| status(&name))?,
            revisions: self.revisions.map_or(Ok(0), |name| revisions(&name))?,
        })
    }
}

/// Stored solutions of a session as a file of this format.
pub(super) async fn file(
    caller: &Caller,
    session: String,
    format: &str,
    query: TrackQuery,
) -> Result<Response, Refused> {
    let (ending, kind) = calls::track::kind(format)?;
    let name = format!("{session}.{ending}");
    let request = query.request(session, format)?;
    Ok(download(&name, kind, calls::track::track(caller, request).await?))
}

/// The time series to compute.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SeriesParameters {
    /// First time: GPS week and seconds of week, such as `2051:46701.5`; that of the first solution
    /// if absent.
    from: Option<String>,
    /// Last time, in the same form; that of the last solution if absent.
    to: Option<String>,
    /// Number of intervals, 1 to 4000; 1000 if absent.
    points: u32,
    /// The revision of each epoch: `last` (if absent) or `first`.
    revisions: Option<String>,
    /// `nextPageToken` of the previous answer. The other parameters must be those of its request,
    /// or `from` and `to` those of its answer.
    page_token: String,
}

/// Thins stored solutions to a time series: smallest, largest and last values in intervals of equal
/// length. For plots of a day or a month.
#[utoipa::path(get, operation_id = "solutionsSeries",
    path = "/v1/sessions/{session}/solutions:series", tag = "Solutions",
    params(("session" = String, Path, description = "Its id"), SeriesParameters),
    responses((status = 200, description = "The time series",
        body = v1::SolutionSeriesResponse), Refused))]
pub(super) async fn series(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<SeriesParameters>,
) -> Result<Json<v1::SolutionSeriesResponse>, Refused> {
    let request = v1::SolutionSeriesRequest {
        session,
        from: query.from.map(|text| time("from", &text)).transpose()?,
        to: query.to.map(|text| time("to", &text)).transpose()?,
        points: query.points,
        revisions: query.revisions.map_or(Ok(0), |name| revisions(&name))?,
        page_token: query.page_token,
    };
    Ok(Json(calls::solutions::series(&caller, request).await?))
}

/// Which epochs to look at.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ResidualsParameters {
    /// First time: GPS week and seconds of week, such as `2051:46701.5`; that of the first epoch if
    /// absent.
    from: Option<String>,
    /// Last time, in the same form; that of the last epoch if absent.
    to: Option<String>,
    /// Number of epochs at most, 1 to 500; 200 if absent. Their numbers are evenly spaced.
    points: u32,
}

/// Returns how well the pseudoranges of evenly spaced epochs agree with their positions. For plots.
#[utoipa::path(get, operation_id = "solutionsResiduals",
    path = "/v1/sessions/{session}/solutions:residuals", tag = "Solutions",
    params(("session" = String, Path, description = "Its id"), ResidualsParameters),
    responses((status = 200, description = "The residuals of these epochs",
        body = v1::ResidualsResponse), Refused))]
pub(super) async fn residuals(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<ResidualsParameters>,
) -> Result<Json<v1::ResidualsResponse>, Refused> {
    let request = v1::ResidualsRequest {
        session,
        from: query.from.map(|text| time("from", &text)).transpose()?,
        to: query.to.map(|text| time("to", &text)).transpose()?,
        points: query.points,
    };
    Ok(Json(calls::solutions::residuals(&caller, request).await?))
}

/// Returns one stored epoch with its solutions, and for each satellite where it stood, how well its
/// pseudorange agrees with the position, and why it was not used.
#[utoipa::path(get, operation_id = "solutionsExplain",
    path = "/v1/sessions/{session}/epochs/{seq}", tag = "Solutions",
    params(("session" = String, Path, description = "Its id"),
        ("seq" = String, Path, description = "Number of the epoch, or `last`")),
    responses((status = 200, description = "The epoch", body = v1::ExplainEpochResponse), Refused))]
pub(super) async fn explain(
    caller: Caller,
    Path((session, seq)): Path<(String, String)>,
) -> Result<Json<v1::ExplainEpochResponse>, Refused> {
    let request = v1::ExplainEpochRequest { session, seq: epoch_number(&seq)? };
    Ok(Json(calls::solutions::explain(&caller, request).await?))
}

/// The number of an epoch in a path; zero for the last one.
fn epoch_number(text: &str) -> Result<u64, Refusal> {
    let number = if text == "last" { Some(0) } else { text.parse().ok().filter(|seq| *seq != 0) };
    number.ok_or_else(|| {
        let message = "an epoch is named by its number from 1, or by last";
        Refusal::new(Code::InvalidField, message).at("seq")
    })
}

pub(super) fn time(field: &str, text: &str) -> Result<v1::GpsTime, Refusal> {
    intake::time_text(text).map(Into::into).map_err(|refusal| refusal.at(field))
}

fn status(name: &str) -> Result<i32, Refusal> {
    v1::Status::from_str_name(&format!("STATUS_{name}"))
        .map(i32::from)
        .ok_or_else(|| intake::unknown_status(name))
}

pub(super) fn revisions(name: &str) -> Result<i32, Refusal> {
    v1::Revisions::from_str_name(&format!("REVISIONS_{}", name.to_uppercase()))
        .filter(|_| name.chars().all(|c| c.is_ascii_lowercase()))
        .filter(|revisions| *revisions != v1::Revisions::Unspecified)
        .map(i32::from)
        .ok_or_else(|| intake::unknown_revisions(name))
}
