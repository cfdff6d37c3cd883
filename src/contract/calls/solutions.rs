//! Stored solutions.

use std::mem;

use crate::contract::{Caller, Lease, Refusal, convert, v1};
use crate::gnss::{LeapSeconds, Observation};
use crate::refusal::Code;
use crate::session::{
    EpochResiduals, Interval, RESIDUAL_POINTS, Range, ResidualQuery, SERIES_POINTS, SatelliteRole,
    SatelliteView, SeriesQuery, SessionError, SessionId, SolutionPage,
};
use crate::store::{Revisions, SolutionQuery};

use super::paging::Pages;
use super::{is_full, page_size, session_id, typed};

/// Solutions on a page if the request gives no size.
const PAGE: usize = 1000;
/// Solutions that are read in one batch.
const PORTION: usize = 256;
/// Memory of a solution, its message and its JSON (bytes).
pub(super) const SOLUTION_BYTES: usize = 10 << 10;
/// Intervals of a series if the request gives no number.
const POINTS: usize = 1000;
/// Epochs of an answer with residuals if the request gives no number.
const RESIDUALS: usize = 200;
/// Memory of an interval, its message and its JSON (bytes).
const INTERVAL_BYTES: usize = 2048;
/// Memory of the solutions that a series reads at a time (bytes).
const BATCH_BYTES: usize = 4 << 20;

/// A page of a session's stored solutions in order of seq and revision.
///
/// # Errors
/// The session does not exist, or the page token, size, time or status is invalid.
pub async fn list(
    caller: &Caller,
    mut request: v1::ListSolutionsRequest,
) -> Result<v1::ListSolutionsResponse, Refusal> {
    let id = session_id(&request.session)?;
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("Solutions/List", &request, &token)?;
    let is_full = is_full(request.view)?;
    let (from, to) = convert::span(request.from, request.to)?;
    let query = SolutionQuery {
        from,
        to,
        status: convert::status_filter(request.status)?,
        revisions: convert::revisions(request.revisions)?,
        page_size: size,
        page_token: pages.after().map(ToOwned::to_owned),
    };
    let (mut page, next) = read(caller, &id, query).await?;
    if !is_full {
        page.solutions.iter_mut().for_each(shorten);
    }
    page.next_page_token = pages.token(next);
    Ok(page)
}

/// Removes the fields that the view BASIC omits.
fn shorten(solution: &mut v1::Solution) {
    let whole = mem::take(solution);
    let (velocity, clock, dops, provenance, satellites_used) = Default::default();
    *solution = v1::Solution { velocity, clock, dops, provenance, satellites_used, ..whole };
}

/// Reads a page in batches, each after memory is reserved for it. The page ends early if no more
/// memory is free, or if the store has searched many epochs that do not match. Also returns the
/// beginning of the next page.
async fn read(
    caller: &Caller,
    id: &SessionId,
    mut query: SolutionQuery,
) -> Result<(v1::ListSolutionsResponse, Option<String>), Refusal> {
    query.check().map_err(SessionError::from)?;
    let (mut left, lease) = (query.page_size, Lease::current());
    let (mut whole, mut next) = (v1::ListSolutionsResponse::default(), None);
    while 0 < left {
        query.page_size = left.min(PORTION);
        let bytes = query.page_size * SOLUTION_BYTES;
        match lease.as_ref().map_or(Ok(()), |lease| lease.reserve(bytes)) {
            Err(refusal) if whole.solutions.is_empty() => return Err(refusal),
            Err(_) => break,
            Ok(()) => {}
        }
        let SolutionPage { page, oldest_available, output, .. } =
            caller.sessions().solutions(id, &query).await?;
        let presenter = caller.presenter(&output);
        whole.solutions.extend(page.items.iter().map(|row| convert::stored(row, &presenter)));
        whole.oldest_available_seq = oldest_available;
        next = page.next_page_token.clone();
        let is_full = page.items.len() == query.page_size;
        if !is_full || page.next_page_token.is_none() {
            break;
        }
        left -= query.page_size;
        query.page_token = page.next_page_token;
    }
    Ok((whole, next))
}

/// A page of the time series of a session's solutions.
///
/// # Errors
/// The session does not exist, or a time, the number of points or the page token is invalid.
pub async fn series(
    caller: &Caller,
    mut request: v1::SolutionSeriesRequest,
) -> Result<v1::SolutionSeriesResponse, Refusal> {
    let id = session_id(&request.session)?;
    let token = mem::take(&mut request.page_token);
    // The span may be set with the second page, so that a new epoch does not move it.
    let (from, to) = (request.from.take(), request.to.take());
    let pages = Pages::of("Solutions/Series", &request, &token)?;
    let revisions = convert::revisions(request.revisions)?;
    if revisions == Revisions::All {
        let message = "a series has one revision of each epoch, last or first";
        return Err(Refusal::new(Code::InvalidField, message).at("revisions"));
    }
    let (from, to) = convert::span(from, to)?;
    let query = SeriesQuery {
        from,
        to,
        points: page_size(request.points, POINTS),
        revisions,
        page_token: pages.after().map(ToOwned::to_owned),
    };
    let bytes = BATCH_BYTES + query.points.min(SERIES_POINTS) * INTERVAL_BYTES;
    Lease::current().as_ref().map_or(Ok(()), |lease| lease.reserve(bytes))?;
    let series = caller.sessions().series(&id, &query).await?;
    let intervals = series.intervals.iter();
    let solutions = series.intervals.values().map(|interval| u64::from(interval.solutions)).sum();
    let reasons = series.reasons.iter().map(|(reason, solutions)| v1::SeriesReason {
        code: reason.code().to_owned(),
        remedy: reason.remedy().to_owned(),
        solutions: *solutions,
    });
    let statuses = series.statuses.iter().rev().map(|(status, solutions)| v1::SeriesStatus {
        status: convert::status(*status).into(),
        solutions: *solutions,
    });
    Ok(v1::SolutionSeriesResponse {
        statuses: statuses.collect(),
        from: series.span.map(|(from, _)| from.into()),
        to: series.span.map(|(_, to)| to.into()),
        interval_length_s: series.interval_s,
        solutions,
        reasons: reasons.collect(),
        intervals: intervals.map(|(index, interval)| interval_message(*index, interval)).collect(),
        next_page_token: pages.token(series.next_page_token),
    })
}

fn interval_message(index: u32, interval: &Interval) -> v1::SeriesInterval {
    let range = |range: Option<Range>| {
        let Range { min, max, last } = range?;
        let is_finite = [min, max, last].iter().all(|value| value.is_finite());
        is_finite.then_some(v1::Range { min, max, last })
    };
    let (seq, time) = interval.last;
    let (worst, best) = interval.statuses;
    v1::SeriesInterval {
        index,
        solutions: interval.solutions,
        seq,
        time: Some(time.into()),
        time_utc: time.to_rfc3339(&LeapSeconds::table()),
        status: convert::status(interval.status).into(),
        worst_status: convert::status(worst).into(),
        best_status: convert::status(best).into(),
        position: interval.position.map(convert::geodetic),
        satellites: range(interval.satellites),
        height_m: range(interval.height_m),
        horizontal_sigma_m: range(interval.horizontal_sigma_m),
        vertical_sigma_m: range(interval.vertical_sigma_m),
        horizontal_protection_m: range(interval.horizontal_protection_m),
        vertical_protection_m: range(interval.vertical_protection_m),
        age_s: range(interval.age_s),
        ratio: range(interval.ratio),
    }
}

/// The residuals of evenly spaced epochs of a session.
///
/// # Errors
/// The session does not exist, or a time or the number of epochs is invalid.
pub async fn residuals(
    caller: &Caller,
    request: v1::ResidualsRequest,
) -> Result<v1::ResidualsResponse, Refusal> {
    let id = session_id(&request.session)?;
    let (from, to) = convert::span(request.from, request.to)?;
    let query = ResidualQuery { from, to, points: page_size(request.points, RESIDUALS) };
    let bytes = query.points.min(RESIDUAL_POINTS) * INTERVAL_BYTES;
    Lease::current().as_ref().map_or(Ok(()), |lease| lease.reserve(bytes))?;
    let points = caller.sessions().residuals(&id, &query).await?;
    Ok(v1::ResidualsResponse { points: points.iter().map(residuals_message).collect() })
}

fn residuals_message(of: &EpochResiduals) -> v1::EpochResiduals {
    let (satellite, largest_m) = of.largest.unzip();
    v1::EpochResiduals {
        seq: of.seq,
        time: Some(of.time.into()),
        time_utc: of.time.to_rfc3339(&LeapSeconds::table()),
        satellites: of.satellites as u32,
        rms_m: of.rms_m,
        largest_m,
        largest_satellite: satellite.map(|satellite| satellite.to_string()).unwrap_or_default(),
    }
}

/// A stored epoch with its solutions and satellites.
///
/// # Errors
/// The session or the epoch does not exist.
pub async fn explain(
    caller: &Caller,
    request: v1::ExplainEpochRequest,
) -> Result<v1::ExplainEpochResponse, Refusal> {
    let id = session_id(&request.session)?;
    let seq = Some(request.seq).filter(|seq| *seq != 0);
    let explained = caller.sessions().explain(&id, seq).await?;
    let observed: std::collections::BTreeMap<_, _> = explained.epoch.by_satellite().collect();
    let satellite = |view: &SatelliteView| {
        view_message(view, observed.get(&view.satellite).copied().unwrap_or_default())
    };
    let (presenter, solutions) = (caller.presenter(&explained.output), explained.solutions.iter());
    Ok(v1::ExplainEpochResponse {
        solutions: solutions.map(|row| convert::stored(row, &presenter)).collect(),
        satellites: explained.satellites.iter().map(satellite).collect(),
    })
}

fn view_message(view: &SatelliteView, observations: &[Observation]) -> v1::SatelliteView {
    let signal = |observation: &Observation| v1::SignalView {
        code: observation.code.to_string(),
        cn0_db_hz: observation.cn0_db_hz,
        pseudorange: observation.pseudorange_m.is_some(),
        carrier_phase: observation.carrier_phase.is_some(),
        doppler: observation.doppler_hz.is_some(),
    };
    v1::SatelliteView {
        satellite: view.satellite.to_string(),
        role: role_text(view.role).to_owned(),
        azimuth_deg: view.look.map(|look| look.azimuth_rad.to_degrees()),
        elevation_deg: view.look.map(|look| look.elevation_rad.to_degrees()),
        residual_m: view.residual_m,
        sigma_m: view.sigma_m,
        slipped: view.is_slipped,
        half_cycle: view.has_half_cycle,
        signals: observations.iter().map(signal).collect(),
        satellite_role: typed(
            &format!("SATELLITE_ROLE_{}", role_text(view.role)),
            v1::SatelliteRole::from_str_name,
        ),
    }
}

const fn role_text(role: SatelliteRole) -> &'static str {
    match role {
        SatelliteRole::Used => "USED",
        SatelliteRole::Excluded => "EXCLUDED",
        SatelliteRole::NoEphemeris => "NO_EPHEMERIS",
        SatelliteRole::BelowMask => "BELOW_MASK",
        SatelliteRole::SwitchedOff => "SWITCHED_OFF",
        SatelliteRole::Unused => "UNUSED",
    }
}
