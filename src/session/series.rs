//! Time series of a session's solutions: the smallest, largest and last values in intervals of
//! equal length.

use std::collections::BTreeMap;

use crate::gnss::{Ecef, GpsTime, Reason, Solution, SolutionEstimate, Status};
use crate::store::{Revisions, SolutionQuery, StoredSolution};

use super::desk::Sessions;
use super::{SessionError, SessionId};

/// Most intervals of a series.
pub const SERIES_POINTS: usize = 4_000;
/// Most solutions from which one page of a series is made.
const PAGE_SOLUTIONS: usize = 100_000;
/// Solutions that are read at a time.
const BATCH: usize = 1_000;
/// Shortest interval (ns).
const SHORTEST_NS: i64 = 1_000_000;

/// The series to compute.
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesQuery {
    /// First time tag; `None` for that of the first solution. The series does not begin before the
    /// first stored solution.
    pub from: Option<GpsTime>,
    /// Last time tag; `None` for that of the last solution. The series does not end after it.
    pub to: Option<GpsTime>,
    /// Number of intervals, 1 to [`SERIES_POINTS`].
    pub points: usize,
    /// The revision of each epoch: the first or the last.
    pub revisions: Revisions,
    /// Token of the page; `None` for the first page.
    pub page_token: Option<String>,
}

/// Values of a session over time.
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionSeries {
    /// Start of the first interval and end of the last; `None` without solutions.
    pub span: Option<(GpsTime, GpsTime)>,
    /// Length of an interval (s).
    pub interval_s: f64,
    /// The intervals with solutions, by index.
    pub intervals: BTreeMap<u32, Interval>,
    /// Number of solutions with each status.
    pub statuses: BTreeMap<Status, u64>,
    /// The reasons: an example of each, and the number of solutions that have it.
    pub reasons: Vec<(Reason, u64)>,
    /// Token of the next page; `None` on the last page.
    pub next_page_token: Option<String>,
}

/// The solutions of one interval.
#[derive(Clone, Debug, PartialEq)]
pub struct Interval {
    /// Number of solutions.
    pub solutions: u32,
    /// Number and time tag of the last solution.
    pub last: (u64, GpsTime),
    /// Status of the last solution.
    pub status: Status,
    /// The worst and the best status.
    pub statuses: (Status, Status),
    /// The last position.
    pub position: Option<Ecef>,
    /// Number of satellites used.
    pub satellites: Option<Range>,
    /// Height above the ellipsoid (m).
    pub height_m: Option<Range>,
    /// Standard deviation along the worst horizontal direction (m).
    pub horizontal_sigma_m: Option<Range>,
    /// Standard deviation of the height (m).
    pub vertical_sigma_m: Option<Range>,
    /// Horizontal protection level (m).
    pub horizontal_protection_m: Option<Range>,
    /// Vertical protection level (m).
    pub vertical_protection_m: Option<Range>,
    /// Age of the base epoch (s).
    pub age_s: Option<Range>,
    /// Ratio of second-best to best integers.
    pub ratio: Option<Range>,
}

/// The values of a quantity in an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// The smallest value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// The last value.
    pub last: f64,
}

/// Extends the range of a quantity by its next value. Values that are not finite are ignored.
fn extend(range: &mut Option<Range>, value: Option<f64>) {
    let Some(value) = value.filter(|value| value.is_finite()) else { return };
    let before = range.unwrap_or(Range { min: value, max: value, last: value });
    *range = Some(Range { min: before.min.min(value), max: before.max.max(value), last: value });
}

impl Interval {
    fn new(stored: &StoredSolution) -> Self {
        let Solution { time, status, .. } = stored.solution;
        Self {
            solutions: 0,
            last: (stored.seq, time),
            status,
            statuses: (status, status),
            position: None,
            satellites: None,
            height_m: None,
            horizontal_sigma_m: None,
            vertical_sigma_m: None,
            horizontal_protection_m: None,
            vertical_protection_m: None,
            age_s: None,
            ratio: None,
        }
    }

    fn take(&mut self, stored: &StoredSolution) {
        let solution = &stored.solution;
        self.solutions += 1;
        self.last = (stored.seq, solution.time);
        self.status = solution.status;
        let (worst, best) = self.statuses;
        self.statuses = (worst.min(solution.status), best.max(solution.status));
        let protection = solution.protection;
        extend(&mut self.horizontal_protection_m, protection.map(|levels| levels.horizontal_m));
        extend(&mut self.vertical_protection_m, protection.map(|levels| levels.vertical_m));
        if let Some(estimate) = &solution.estimate {
            self.take_estimate(estimate);
        }
    }

    fn take_estimate(&mut self, estimate: &SolutionEstimate) {
        self.position = Some(estimate.position);
        let (horizontal_m, vertical_m) = estimate.sigmas_m();
        extend(&mut self.satellites, Some(estimate.satellites_used.len() as f64));
        extend(&mut self.height_m, Some(estimate.position.to_geodetic().height_m));
        extend(&mut self.horizontal_sigma_m, Some(horizontal_m));
        extend(&mut self.vertical_sigma_m, Some(vertical_m));
        extend(&mut self.age_s, estimate.relative.as_ref().map(|relative| relative.age_s));
        extend(&mut self.ratio, estimate.relative.as_ref().and_then(|relative| relative.ratio));
    }
}

impl SolutionSeries {
    /// A series without solutions over `span`.
    fn over(span: Option<(GpsTime, GpsTime)>, points: usize) -> Self {
        let length_ns = span.map_or(0, |(from, to)| to.as_ns().saturating_sub(from.as_ns()));
        let interval_ns = (length_ns / points as i64 + 1).max(SHORTEST_NS);
        Self {
            span,
            interval_s: interval_ns as f64 * 1e-9,
            intervals: BTreeMap::new(),
            statuses: BTreeMap::new(),
            reasons: Vec::new(),
            next_page_token: None,
        }
    }

    fn take(&mut self, stored: &StoredSolution) {
        let Some((from, _)) = self.span else { return };
        // An interval is a whole number of nanoseconds, so equal requests have equal intervals.
        let interval_ns = (self.interval_s * 1e9).round() as i64;
        let elapsed_ns = stored.solution.time.as_ns().saturating_sub(from.as_ns()).max(0);
        let index = u32::try_from(elapsed_ns / interval_ns).unwrap_or(u32::MAX);
        let interval = self.intervals.entry(index).or_insert_with(|| Interval::new(stored));
        interval.take(stored);
        *self.statuses.entry(stored.solution.status).or_default() += 1;
        for reason in &stored.solution.reasons {
            match self.reasons.iter_mut().find(|(known, _)| known.code() == reason.code()) {
                Some((_, count)) => *count += 1,
                None => self.reasons.push((reason.clone(), 1)),
            }
        }
    }
}

impl Sessions {
    /// A page of the time series of a session, open or closed.
    ///
    /// One page is made of 100 000 solutions at most, which are read in batches.
    ///
    /// # Errors
    /// No session has this id, the number of points or the page token is invalid, or the store
    /// fails.
    pub async fn series(
        &self,
        id: &SessionId,
        query: &SeriesQuery,
    ) -> Result<SolutionSeries, SessionError> {
        if !(1..=SERIES_POINTS).contains(&query.points) {
            let (points, limit) = (query.points, SERIES_POINTS);
            return Err(SessionError::TooManyPoints { points, limit });
        }
        let key = self.row(id).await?.key;
        let stored = self.store().solution_span(key).await?;
        let span = stored.and_then(|(first, last)| {
            let from = query.from.map_or(first, |from| from.max(first));
            let to = query.to.map_or(last, |to| to.min(last));
            (from <= to).then_some((from, to))
        });
        let mut series = SolutionSeries::over(span, query.points);
        let Some((from, to)) = span else { return Ok(series) };
        let mut batch = SolutionQuery {
            from: Some(from),
            to: Some(to),
            status: None,
            revisions: query.revisions,
            page_size: BATCH,
            page_token: query.page_token.clone(),
        };
        for _ in 0..PAGE_SOLUTIONS / BATCH {
            let page = self.store().solutions(key, &batch).await?;
            page.items.iter().for_each(|stored| series.take(stored));
            batch.page_token = page.next_page_token;
            if batch.page_token.is_none() {
                break;
            }
        }
        series.reasons.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        series.next_page_token = batch.page_token;
        Ok(series)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_has_smallest_largest_and_last() {
        let mut range = None;
        for value in [Some(3.0), None, Some(f64::NAN), Some(5.0), Some(1.0), Some(2.0)] {
            extend(&mut range, value);
        }
        assert_eq!(range, Some(Range { min: 1.0, max: 5.0, last: 2.0 }));
    }

    fn stored(seq: u64, seconds: f64, status: Status) -> StoredSolution {
        let time = GpsTime::from_week_seconds(2400, seconds);
        let solution = Solution { status, ..Solution::none(time, vec![Reason::NoRedundancy]) };
        let (version, configuration_hash) = ("0".into(), "0".into());
        StoredSolution { seq, revision: 0, solution, version, configuration_hash }
    }

    /// Ten seconds in five intervals: 2.000000001 s each, so that the last time is in the last.
    #[test]
    fn solutions_fall_into_their_intervals() {
        let at = |seconds| GpsTime::from_week_seconds(2400, seconds);
        let mut series = SolutionSeries::over(Some((at(0.0), at(10.0))), 5);
        for second in 0..=10_u64 {
            let status = if second == 3 { Status::None } else { Status::Single };
            series.take(&stored(second + 1, second as f64, status));
        }
        let counts: Vec<(u32, u32)> =
            series.intervals.iter().map(|(index, interval)| (*index, interval.solutions)).collect();
        assert_eq!(counts, [(0, 3), (1, 2), (2, 2), (3, 2), (4, 2)]);
        let second = &series.intervals[&1];
        assert_eq!(second.statuses, (Status::None, Status::Single));
        assert_eq!((second.status, second.last), (Status::Single, (5, at(4.0))));
        assert_eq!(Vec::from_iter(series.statuses), [(Status::None, 1), (Status::Single, 10)]);
        assert_eq!(series.reasons, [(Reason::NoRedundancy, 11)]);
    }
}
