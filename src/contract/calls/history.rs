//! The history of sessions, from rollups.

use std::mem;

use crate::contract::{Caller, Lease, Refusal, convert, v1};
use crate::session::{HistoryQuery, SERIES_POINTS};
use crate::store::{Bounds, FleetHour, Rollup, SessionSummary, Spread, StatusCounts};

use super::paging::Pages;
use super::sessions::filter;
use super::{bounds, page_size, session_id, utc};

/// Intervals of a history if the request gives no number.
const POINTS: usize = 1000;
/// Memory of an interval, its message and its JSON (bytes).
const INTERVAL_BYTES: usize = 2048;
/// Memory of the rollups that are read at a time (bytes).
const READ_BYTES: usize = 8 << 20;
/// Sessions on a page if the request gives no size.
const PAGE: usize = 100;
/// Most sessions on a page.
const PAGE_MAX: usize = 1000;
/// Memory of a summary, its message and its JSON (bytes).
const SUMMARY_BYTES: usize = 2048;

/// The history of all sessions of the caller's tenant.
///
/// # Errors
/// A time, the span or the number of points is invalid, or the store fails.
pub async fn fleet(
    caller: &Caller,
    request: v1::FleetHistoryRequest,
) -> Result<v1::FleetHistoryResponse, Refusal> {
    let query = query(request.from, request.to, request.points)?;
    let history = caller.sessions().fleet_history(&query).await?;
    let (from, to) = history.intervals.span;
    Ok(v1::FleetHistoryResponse {
        from: Some(from.into()),
        to: Some(to.into()),
        interval_length_s: history.intervals.length_s as f64,
        statuses: statuses(&history.statuses),
        intervals: history.hours.iter().map(|(index, hour)| fleet_interval(*index, hour)).collect(),
        now_utc: utc(history.now_ms),
    })
}

/// A page of sessions with sums of their hours.
///
/// # Errors
/// The page token, the page size or the filter is invalid, or the store fails.
pub async fn sessions(
    caller: &Caller,
    mut request: v1::ListSessionHistoriesRequest,
) -> Result<v1::ListSessionHistoriesResponse, Refusal> {
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("History/Sessions", &request, &token)?;
    let v1::ListSessionHistoriesRequest { from, to, closed, mode, label, order, area, .. } =
        request;
    let filter = filter(closed, mode, label, order)?;
    let span = convert::span(from, to)?;
    let area = bounds(area)?;
    let bytes = size.min(PAGE_MAX) * SUMMARY_BYTES;
    Lease::current().as_ref().map_or(Ok(()), |lease| lease.reserve(bytes))?;
    let desk = caller.sessions();
    let page = desk.session_histories(filter, span, area, size, pages.after()).await?;
    Ok(v1::ListSessionHistoriesResponse {
        sessions: page.items.into_iter().map(summary).collect(),
        next_page_token: pages.token(page.next_page_token),
    })
}

/// The history of a session.
///
/// # Errors
/// The session does not exist, a time, the span or the number of points is invalid, or the store
/// fails.
pub async fn session(
    caller: &Caller,
    request: v1::SessionHistoryRequest,
) -> Result<v1::SessionHistoryResponse, Refusal> {
    let id = session_id(&request.session)?;
    let query = query(request.from, request.to, request.points)?;
    let history = caller.sessions().history(&id, &query).await?;
    let span = history.intervals.map(|intervals| intervals.span);
    let rollups = history.rollups.iter();
    Ok(v1::SessionHistoryResponse {
        from: span.map(|(from, _)| from.into()),
        to: span.map(|(_, to)| to.into()),
        interval_length_s: history.intervals.map_or(0.0, |intervals| intervals.length_s as f64),
        rollup_length_s: history.rollup_s as u32,
        solutions: history.statuses.total(),
        statuses: statuses(&history.statuses),
        intervals: rollups.map(|(index, rollup)| interval(*index, rollup)).collect(),
    })
}

/// Reads a query, after memory is reserved for its answer.
fn query(
    from: Option<v1::GpsTime>,
    to: Option<v1::GpsTime>,
    points: u32,
) -> Result<HistoryQuery, Refusal> {
    let points = page_size(points, POINTS);
    let (from, to) = convert::span(from, to)?;
    let bytes = READ_BYTES + points.min(SERIES_POINTS) * INTERVAL_BYTES;
    Lease::current().as_ref().map_or(Ok(()), |lease| lease.reserve(bytes))?;
    Ok(HistoryQuery { from, to, points })
}

/// The statuses that occur, the best first.
fn statuses(counts: &StatusCounts) -> Vec<v1::SeriesStatus> {
    let mut statuses: Vec<_> = counts
        .iter()
        .filter(|(_, solutions)| *solutions != 0)
        .map(|(status, solutions)| v1::SeriesStatus {
            status: convert::status(status).into(),
            solutions,
        })
        .collect();
    statuses.reverse();
    statuses
}

fn fleet_interval(index: u32, hour: &FleetHour) -> v1::FleetInterval {
    let mean = |sum: f64, count: u64| (count != 0).then(|| sum / count as f64);
    v1::FleetInterval {
        index,
        sessions: hour.sessions,
        statuses: statuses(&hour.statuses),
        horizontal_sigma_mean_m: mean(hour.sigma_sum_m, hour.positions),
        satellites_mean: mean(hour.satellites_sum, hour.positions),
        age_mean_s: mean(hour.age_sum_s, hour.ages),
    }
}

fn area_message(bounds: Bounds) -> v1::Area {
    let Bounds { south_deg, west_deg, north_deg, east_deg } = bounds;
    v1::Area { south_deg, west_deg, north_deg, east_deg }
}

fn summary(summary: SessionSummary) -> v1::SessionSummary {
    v1::SessionSummary {
        session: summary.id,
        label: summary.label,
        mode: summary.mode,
        closed: summary.is_closed,
        first_time: Some(summary.span.0.into()),
        last_time: Some(summary.span.1.into()),
        solutions: summary.statuses.total(),
        statuses: statuses(&summary.statuses),
        area: summary.bounds.map(area_message),
        horizontal_sigma_max_m: summary.sigma_m.map(|(max, _)| max),
        horizontal_sigma_mean_m: summary.sigma_m.map(|(_, mean)| mean),
        satellites_min: summary.satellites.map(|(min, _)| min),
        satellites_mean: summary.satellites.map(|(_, mean)| mean),
        age_max_s: summary.age_s.map(|(max, _)| max),
        age_mean_s: summary.age_s.map(|(_, mean)| mean),
    }
}

fn interval(index: u32, rollup: &Rollup) -> v1::HistoryInterval {
    let range = |spread: Option<Spread>| {
        let spread = spread?;
        let Spread { min, max, last, .. } = spread;
        Some(v1::HistoryRange { min, max, mean: spread.mean(), last })
    };
    let (worst, best) = rollup.statuses.ends().unwrap_or((rollup.status, rollup.status));
    let height_m = rollup.height_m.map(|height| height.last);
    let position = rollup.position_deg.zip(height_m).map(|(deg, height_m)| {
        let (latitude_deg, longitude_deg) = deg;
        v1::Geodetic { latitude_deg, longitude_deg, height_m }
    });
    v1::HistoryInterval {
        index,
        solutions: rollup.statuses.total(),
        statuses: statuses(&rollup.statuses),
        first_time: Some(rollup.span.0.into()),
        last_time: Some(rollup.span.1.into()),
        seq: rollup.last_seq,
        status: convert::status(rollup.status).into(),
        worst_status: convert::status(worst).into(),
        best_status: convert::status(best).into(),
        position,
        area: rollup.bounds.map(area_message),
        height_m: range(rollup.height_m),
        horizontal_sigma_m: range(rollup.sigma_m),
        satellites: range(rollup.satellites),
        age_s: range(rollup.age_s),
    }
}
