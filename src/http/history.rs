//! `/v1/history`.

use axum::extract::Path;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, calls, v1};

use super::body::StrictQuery;
use super::json::Json;
use super::lists::{area, order};
use super::problem::Refused;
use super::solutions::time;

/// The history to compute.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HistoryQuery {
    /// First time: GPS week and seconds of week, such as `2051:46701.5`; a day before the last if
    /// absent.
    from: Option<String>,
    /// Last time, in the same form; if absent the present, of one session that of its last hour.
    to: Option<String>,
    /// Most intervals, 1 to 4000; 1000 if absent.
    points: u32,
}

/// Counts the solutions of all sessions by status, hour by hour, over up to 400 days.
#[utoipa::path(get, operation_id = "historyFleet",
    path = "/v1/history/fleet", tag = "History", params(HistoryQuery),
    responses((status = 200, description = "The history of the fleet",
        body = v1::FleetHistoryResponse), Refused))]
pub(super) async fn fleet(
    caller: Caller,
    StrictQuery(query): StrictQuery<HistoryQuery>,
) -> Result<Json<v1::FleetHistoryResponse>, Refused> {
    let request = v1::FleetHistoryRequest {
        from: query.from.map(|text| time("from", &text)).transpose()?,
        to: query.to.map(|text| time("to", &text)).transpose()?,
        points: query.points,
    };
    Ok(Json(calls::history::fleet(&caller, request).await?))
}

/// Which sessions to list, with which of their hours.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SessionHistoriesQuery {
    /// At most this many sessions on the page, 1 to 1000; 100 if absent. A page may have fewer, or
    /// none, although there are more: it ends when it has looked through as many sessions, or, for
    /// an area, up to 10 000 of a day and fewer of a longer span.
    #[param(minimum = 0, maximum = 1000)]
    page_size: u32,
    /// `nextPageToken` of the previous answer. The other parameters but `pageSize` must be those of
    /// its request.
    page_token: String,
    /// First time: GPS week and seconds of week, such as `2051:46701.5`; a day before the last if
    /// absent. Hours that begin in the span count.
    from: Option<String>,
    /// Last time, in the same form; the present if absent. Give it, so that all pages have the same
    /// span.
    to: Option<String>,
    /// Only hours whose box of positions meets this area: `SOUTH,WEST,NORTH,EAST` in degrees. West
    /// may be east of east: the area then crosses 180°.
    area: Option<String>,
    /// Only closed sessions, or only open ones; all if absent.
    closed: Option<bool>,
    /// Only those of this mode.
    mode: String,
    /// Only those with exactly this label.
    label: String,
    /// `NEWEST_FIRST` (if absent) or `OLDEST_FIRST`.
    order: Option<String>,
}

/// Lists the sessions that have solutions in a span of time, each with sums of its hours; with an
/// area those that have been there.
#[utoipa::path(get, operation_id = "historySessions",
    path = "/v1/history/sessions", tag = "History", params(SessionHistoriesQuery),
    responses((status = 200, description = "A page of sessions",
        body = v1::ListSessionHistoriesResponse), Refused))]
pub(super) async fn sessions(
    caller: Caller,
    StrictQuery(query): StrictQuery<SessionHistoriesQuery>,
) -> Result<Json<v1::ListSessionHistoriesResponse>, Refused> {
    let request = v1::ListSessionHistoriesRequest {
        page_size: query.page_size,
        page_token: query.page_token,
        from: query.from.map(|text| time("from", &text)).transpose()?,
        to: query.to.map(|text| time("to", &text)).transpose()?,
        area: query.area.map(|text| area(&text)).transpose()?,
        closed: query.closed,
        mode: query.mode,
        label: query.label,
        order: order(query.order)?,
    };
    Ok(Json(calls::history::sessions(&caller, request).await?))
}

/// Thins the solutions of a session to intervals of whole minutes, or of whole hours where the span
/// is longer than a week or the minutes are removed with their epochs already.
#[utoipa::path(get, operation_id = "historySession",
    path = "/v1/history/sessions/{session}", tag = "History",
    params(("session" = String, Path, description = "Its id"), HistoryQuery),
    responses((status = 200, description = "The history of the session",
        body = v1::SessionHistoryResponse), Refused))]
pub(super) async fn session(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<HistoryQuery>,
) -> Result<Json<v1::SessionHistoryResponse>, Refused> {
    let request = v1::SessionHistoryRequest {
        session,
        from: query.from.map(|text| time("from", &text)).transpose()?,
        to: query.to.map(|text| time("to", &text)).transpose()?,
        points: query.points,
    };
    Ok(Json(calls::history::session(&caller, request).await?))
}
