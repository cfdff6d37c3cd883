//! The history of sessions from rollups: a session over time, a fleet over time, and a fleet
//! session by session.

use std::collections::BTreeMap;

use crate::clock::gps_time;
use crate::gnss::GpsTime;
use crate::store::{
    Bounds, FleetHour, HOUR_S, HistoryFilter, MINUTE_S, Page, Rollup, SessionFilter,
    SessionSummary, StatusCounts,
};

use super::desk::Sessions;
use super::series::SERIES_POINTS;
use super::{SessionError, SessionId};

/// Span of a history if the query gives no beginning (s).
const STANDARD_S: i64 = 86_400;
/// Longest span that is read from rollups of minutes (s).
const MINUTES_S: i64 = 7 * 86_400;
/// Longest span of a history (days).
const SPAN_DAYS: i64 = 400;
const NS_PER_S: i64 = 1_000_000_000;

/// The history to compute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistoryQuery {
    /// First time; `None` for one day before `to`.
    pub from: Option<GpsTime>,
    /// Last time; `None` for the present, or for the last epoch in the history of one session.
    pub to: Option<GpsTime>,
    /// Most intervals, 1 to [`SERIES_POINTS`].
    pub points: usize,
}

/// Intervals of equal length, each of whole buckets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intervals {
    /// Start of the first interval and end of the last.
    pub span: (GpsTime, GpsTime),
    /// Length of an interval (s).
    pub length_s: i64,
}

impl Intervals {
    /// At most `points` intervals of whole buckets that cover a span.
    fn over((from, to): (GpsTime, GpsTime), points: usize, bucket_s: i64) -> Self {
        let (first, last) = (seconds(from).div_euclid(bucket_s), seconds(to).div_euclid(bucket_s));
        let buckets = (last - first + 1) as u64;
        let per_interval = buckets.div_ceil(points as u64);
        let length_s = per_interval as i64 * bucket_s;
        let begin_s = first * bucket_s;
        let end_s = begin_s + buckets.div_ceil(per_interval) as i64 * length_s;
        Self { span: (at(begin_s), at(end_s)), length_s }
    }

    /// The interval of a bucket, by its begin.
    fn index(&self, begin: GpsTime) -> u32 {
        let elapsed_s = seconds(begin) - seconds(self.span.0);
        u32::try_from(elapsed_s.div_euclid(self.length_s)).unwrap_or_default()
    }
}

/// The history of one session.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionHistory {
    /// The intervals; `None` without rollups.
    pub intervals: Option<Intervals>,
    /// Length of the buckets that intervals are made of (s).
    pub rollup_s: i64,
    /// The intervals with epochs, by index.
    pub rollups: BTreeMap<u32, Rollup>,
    /// Number of epochs with each status.
    pub statuses: StatusCounts,
}

/// The history of the sessions of a tenant.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetHistory {
    /// The intervals of whole hours.
    pub intervals: Intervals,
    /// The intervals with epochs, by index. The sessions of an interval are the most in one hour.
    pub hours: BTreeMap<u32, FleetHour>,
    /// Number of epochs with each status.
    pub statuses: StatusCounts,
    /// The clock of the service (ms since 1970-01-01 UTC).
    pub now_ms: i64,
}

fn seconds(time: GpsTime) -> i64 {
    time.as_ns().div_euclid(NS_PER_S)
}

fn at(seconds: i64) -> GpsTime {
    GpsTime::from_ns(seconds.saturating_mul(NS_PER_S))
}

fn before(time: GpsTime, length_s: i64) -> GpsTime {
    GpsTime::from_ns(time.as_ns().saturating_sub(length_s * NS_PER_S))
}

/// The span from one time to another; `None` if it is empty.
///
/// # Errors
/// It is longer than a history may be.
fn checked_span(from: GpsTime, to: GpsTime) -> Result<Option<(GpsTime, GpsTime)>, SessionError> {
    let length_ns = to.as_ns().saturating_sub(from.as_ns());
    if SPAN_DAYS * 86_400 * NS_PER_S < length_ns {
        return Err(SessionError::SpanTooLong { limit_days: SPAN_DAYS });
    }
    Ok((0 <= length_ns).then_some((from, to)))
}

fn check_points(points: usize) -> Result<(), SessionError> {
    let limit = SERIES_POINTS;
    let is_allowed = (1..=limit).contains(&points);
    if is_allowed { Ok(()) } else { Err(SessionError::TooManyPoints { points, limit }) }
}

fn add(sum: &mut FleetHour, hour: &FleetHour) {
    sum.sessions = sum.sessions.max(hour.sessions);
    sum.statuses.add(&hour.statuses);
    sum.positions += hour.positions;
    sum.ages += hour.ages;
    sum.sigma_sum_m += hour.sigma_sum_m;
    sum.satellites_sum += hour.satellites_sum;
    sum.age_sum_s += hour.age_sum_s;
}

impl Sessions {
    /// The history of a session, open or closed. Up to a week it is read from rollups of minutes.
    /// Longer spans, and spans whose minutes are already removed, are read from rollups of hours.
    ///
    /// # Errors
    /// No session has this id, the number of points or the span is out of range, or the store
    /// fails.
    pub async fn history(
        &self,
        id: &SessionId,
        query: &HistoryQuery,
    ) -> Result<SessionHistory, SessionError> {
        check_points(query.points)?;
        let (key, store) = (self.row(id).await?.key, self.store());
        let none = SessionHistory {
            intervals: None,
            rollup_s: HOUR_S,
            rollups: BTreeMap::new(),
            statuses: StatusCounts::default(),
        };
        let whole = store.rollup_ends(key, HOUR_S, (None, query.to)).await?;
        let Some((_, last)) = whole else { return Ok(none) };
        let to = query.to.unwrap_or(at(seconds(last) + HOUR_S - 1));
        let from = query.from.unwrap_or_else(|| before(to, STANDARD_S));
        let Some(span) = checked_span(from, to)? else { return Ok(none) };
        // The first minutes may belong to an hour that begins before the span.
        let hour = (at(seconds(from).div_euclid(HOUR_S) * HOUR_S), to);
        let rollup_s = match seconds(to) - seconds(from) <= MINUTES_S {
            true => {
                let bounds = (Some(hour.0), Some(hour.1));
                let hours = store.rollup_ends(key, HOUR_S, bounds).await?;
                let minutes = store.rollup_ends(key, MINUTE_S, bounds).await?;
                let first_hour = |(first, _): (GpsTime, GpsTime)| seconds(first).div_euclid(HOUR_S);
                let is_whole = hours.map(first_hour) == minutes.map(first_hour);
                if is_whole { MINUTE_S } else { HOUR_S }
            }
            false => HOUR_S,
        };
        let intervals = Intervals::over(span, query.points, rollup_s);
        let (begin, end) = intervals.span;
        let end = GpsTime::from_ns(end.as_ns() - 1);
        let mut history = SessionHistory { intervals: Some(intervals), rollup_s, ..none };
        for rollup in store.rollups(key, rollup_s, (begin, end)).await? {
            history.statuses.add(&rollup.statuses);
            let sum = history.rollups.entry(intervals.index(rollup.begin));
            sum.and_modify(|sum| sum.add(&rollup)).or_insert(rollup);
        }
        Ok(history)
    }

    /// The history of all sessions of the tenant, from rollups of hours.
    ///
    /// # Errors
    /// The number of points or the span is out of range, or the store fails.
    pub async fn fleet_history(&self, query: &HistoryQuery) -> Result<FleetHistory, SessionError> {
        check_points(query.points)?;
        let now_ms = self.unix_ms();
        let to = query.to.unwrap_or_else(|| gps_time(now_ms));
        let from = query.from.unwrap_or_else(|| before(to, STANDARD_S));
        let span = checked_span(from, to)?;
        let intervals = Intervals::over(span.unwrap_or((to, to)), query.points, HOUR_S);
        let (hours, statuses) = (BTreeMap::new(), StatusCounts::default());
        let mut history = FleetHistory { intervals, hours, statuses, now_ms };
        if span.is_none() {
            return Ok(history);
        }
        let (begin, end) = intervals.span;
        let end = GpsTime::from_ns(end.as_ns() - 1);
        for hour in self.store().fleet_hours(self.tenant(), (begin, end)).await? {
            history.statuses.add(&hour.statuses);
            let sum = history.hours.entry(intervals.index(hour.begin));
            sum.and_modify(|sum| add(sum, &hour)).or_insert(hour);
        }
        Ok(history)
    }

    /// A page of up to 1000 sessions that have hours in an area and in a span of time. Without a
    /// span, it is the last day.
    ///
    /// # Errors
    /// The span is out of range, the page token or size is invalid, or the store fails.
    pub async fn session_histories(
        &self,
        sessions: SessionFilter,
        (from, to): (Option<GpsTime>, Option<GpsTime>),
        area: Option<Bounds>,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionSummary>, SessionError> {
        let to = to.unwrap_or_else(|| gps_time(self.unix_ms()));
        let from = from.unwrap_or_else(|| before(to, STANDARD_S));
        let Some((from, to)) = checked_span(from, to)? else {
            return Ok(Page { items: Vec::new(), next_page_token: None });
        };
        let from = at(seconds(from).div_euclid(HOUR_S) * HOUR_S);
        let filter = HistoryFilter { sessions, span: (from, to), area };
        let store = self.store();
        Ok(store.session_summaries(self.tenant(), &filter, page_size, page_token).await?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intervals(from_s: i64, to_s: i64, points: usize, bucket_s: i64) -> (i64, i64, i64) {
        let Intervals { span, length_s } =
            Intervals::over((at(from_s), at(to_s)), points, bucket_s);
        (seconds(span.0), seconds(span.1), length_s)
    }

    /// A day in minutes, in at most 2000 intervals and in at most 100.
    #[test]
    fn intervals_are_whole_buckets_and_not_more_than_asked_for() {
        assert_eq!(intervals(0, 86_399, 2_000, 60), (0, 86_400, 60));
        assert_eq!(intervals(59, 61, 2, 60), (0, 120, 60));
        assert_eq!(intervals(59, 61, 1, 60), (0, 120, 120));
        for points in [1, 2, 3, 7, 100, 1_440, 4_000] {
            for (from_s, to_s) in [(0, 86_399), (-30, 604_801), (1_234_567_890, 1_234_567_890)] {
                let (begin_s, end_s, length_s) = intervals(from_s, to_s, points, 60);
                assert_eq!((length_s % 60, begin_s % 60, (end_s - begin_s) % length_s), (0, 0, 0));
                assert!((end_s - begin_s) / length_s <= points as i64, "{points}");
                assert!(begin_s <= from_s && to_s < end_s);
            }
        }
    }
}
