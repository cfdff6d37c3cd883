//! Reads rollups: of a session, of a fleet hour by hour, and of a fleet session by session; and
//! removes them when they have expired.

use crate::gnss::GpsTime;
use crate::tenant::Tenant;

use super::page::rows_asked;
use super::pool::{reading, writing};
use super::rollup::status_of;
use super::session_filter::condition;
use super::{
    Bounds, Page, Rollup, SessionFilter, SessionKey, Spread, StatusCounts, Store, StoreError,
};

const PAGE_LIMIT: usize = 1_000;
/// Most sessions, and most of their hours, that a page searches for an area: a day of all these
/// sessions. A page ends there, even if it is not full.
const SCANNED: usize = 10_000;
const SCANNED_HOURS: usize = 24 * SCANNED;
/// An upper limit of the sessions created between two statements.
const CREATED: usize = 100;
/// Most rollups of one read: more than the hours of a year, or the minutes of a week.
pub(crate) const ROLLUPS_MAX: i64 = 20_000;
const NS_PER_S: i64 = 1_000_000_000;

const SELECT_ROLLUPS: &str = "SELECT begin_s, first_time_ns, last_time_ns, last_seq, n_none, \
    n_single, n_ekf, n_fgo, n_float, n_fixed, status, latitude_deg, longitude_deg, positions, \
    ages, south_deg, west_deg, north_deg, east_deg, height_min_m, height_max_m, height_sum_m, \
    height_last_m, sigma_min_m, sigma_max_m, sigma_sum_m, sigma_last_m, satellites_min, \
    satellites_max, satellites_sum, satellites_last, age_min_s, age_max_s, age_sum_s, age_last_s \
    FROM rollups WHERE session = $1 AND seconds = $2 AND begin_s >= $3 AND begin_s <= $4 \
    ORDER BY begin_s LIMIT $5";
const ROLLUP_ENDS: &str = "SELECT MIN(begin_s), MAX(begin_s) FROM rollups \
    WHERE session = $1 AND seconds = $2 AND begin_s >= $3 AND begin_s <= $4";
const SELECT_FLEET: &str = "SELECT begin_s, sessions, n_none, n_single, n_ekf, n_fgo, n_float, \
    n_fixed, positions, ages, sigma_sum_m, satellites_sum, age_sum_s FROM fleet_hours \
    WHERE tenant = $1 AND begin_s >= $2 AND begin_s <= $3 ORDER BY begin_s LIMIT $4";
/// Removes some rows of hours whose last epoch arrived before a day.
const REMOVE_EXPIRED: [&str; 2] = [
    "DELETE FROM rollups WHERE (session, seconds, begin_s) IN (SELECT session, seconds, begin_s \
     FROM rollups WHERE seconds = 3600 AND day < $1 LIMIT $2)",
    "DELETE FROM fleet_hours WHERE (tenant, begin_s) IN (SELECT tenant, begin_s \
     FROM fleet_hours WHERE day < $1 LIMIT $2)",
];

/// Selects, for each session of a page, the sums of its hours whose box intersects an area.
macro_rules! summaries {
    ($order:ident, $sort:literal) => {
        concat!(
            "SELECT p.id AS id, p.label AS label, p.mode AS mode, ",
            "p.closed_unix_ms AS closed_unix_ms, MIN(r.first_time_ns) AS first_time_ns, ",
            "MAX(r.last_time_ns) AS last_time_ns, ",
            "CAST(SUM(r.n_none) AS BIGINT) AS n_none, ",
            "CAST(SUM(r.n_single) AS BIGINT) AS n_single, ",
            "CAST(SUM(r.n_ekf) AS BIGINT) AS n_ekf, CAST(SUM(r.n_fgo) AS BIGINT) AS n_fgo, ",
            "CAST(SUM(r.n_float) AS BIGINT) AS n_float, ",
            "CAST(SUM(r.n_fixed) AS BIGINT) AS n_fixed, ",
            "CAST(SUM(r.positions) AS BIGINT) AS positions, ",
            "CAST(SUM(r.ages) AS BIGINT) AS ages, ",
            "MIN(r.south_deg) AS south_deg, MIN(r.west_deg) AS west_deg, ",
            "MAX(r.north_deg) AS north_deg, MAX(r.east_deg) AS east_deg, ",
            "CAST(MAX(r.sigma_max_m) AS DOUBLE PRECISION) AS sigma_max_m, ",
            "SUM(r.sigma_sum_m) AS sigma_sum_m, ",
            "CAST(MIN(r.satellites_min) AS DOUBLE PRECISION) AS satellites_min, ",
            "SUM(r.satellites_sum) AS satellites_sum, ",
            "CAST(MAX(r.age_max_s) AS DOUBLE PRECISION) AS age_max_s, ",
            "SUM(r.age_sum_s) AS age_sum_s ",
            "FROM (SELECT s.key AS key, s.id AS id, s.label AS label, s.mode AS mode, ",
            "h.closed_unix_ms AS closed_unix_ms ",
            "FROM sessions s JOIN session_heads h ON h.session = s.key ",
            condition!($order),
            // With CROSS, SQLite looks up the hours of each session, not the sessions of all hours.
            ") AS p CROSS JOIN rollups r WHERE r.session = p.key ",
            "AND p.key BETWEEN $15 AND $16 AND r.seconds = 3600 ",
            "AND r.begin_s >= $7 AND r.begin_s <= $8 AND ($9 = 0 OR (r.south_deg <= $12 ",
            "AND r.north_deg >= $10 AND ((CAST($11 AS DOUBLE PRECISION) <= $13 ",
            "AND r.west_deg <= $13 AND r.east_deg >= $11) ",
            "OR (CAST($11 AS DOUBLE PRECISION) > $13 ",
            "AND (r.west_deg <= $13 OR r.east_deg >= $11))))) ",
            "GROUP BY p.key, p.id, p.label, p.mode, p.closed_unix_ms ORDER BY p.key ",
            $sort,
            " LIMIT $14"
        )
    };
}
/// Selects keys and ids of a page of sessions.
macro_rules! ids {
    ($order:ident) => {
        concat!(
            "SELECT s.key, s.id FROM sessions s JOIN session_heads h ON h.session = s.key ",
            condition!($order)
        )
    };
}

/// Which sessions a history has, of which hours, and where.
#[derive(Clone, Debug, PartialEq)]
pub struct HistoryFilter {
    /// Which sessions, and in which order.
    pub sessions: SessionFilter,
    /// Only hours that begin in this span of time.
    pub span: (GpsTime, GpsTime),
    /// Only hours whose box of positions meets this area.
    pub area: Option<Bounds>,
}

impl HistoryFilter {
    /// Number of sessions that a page searches: its size without an area. With an area it is more,
    /// and the shorter the span, the more.
    fn sessions_scanned(&self, page_size: usize) -> usize {
        let (from_s, to_s) = seconds(self.span);
        let hours = usize::try_from(to_s.saturating_sub(from_s) / 3_600 + 1).unwrap_or(1);
        match self.area {
            None => page_size,
            Some(_) => (SCANNED_HOURS / hours.max(1)).min(SCANNED).max(page_size),
        }
    }
}

/// The history of a session as one item of a list.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionSummary {
    /// Public id of the session.
    pub id: String,
    /// A name for people; may be empty.
    pub label: String,
    /// Name of the mode.
    pub mode: String,
    /// Whether it is closed.
    pub is_closed: bool,
    /// Earliest and latest time tag.
    pub span: (GpsTime, GpsTime),
    /// Number of epochs with each status.
    pub statuses: StatusCounts,
    /// A box around the positions. Its longitudes are the least and the greatest.
    pub bounds: Option<Bounds>,
    /// Greatest and mean standard deviation along the worst horizontal direction (m).
    pub sigma_m: Option<(f64, f64)>,
    /// Least and mean number of satellites used.
    pub satellites: Option<(f64, f64)>,
    /// Greatest and mean age of the base epoch (s).
    pub age_s: Option<(f64, f64)>,
}

/// An hour of all sessions of a tenant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FleetHour {
    /// When it begins.
    pub begin: GpsTime,
    /// Number of sessions with epochs.
    pub sessions: u64,
    /// Number of epochs with each status.
    pub statuses: StatusCounts,
    /// Epochs with a position.
    pub positions: u64,
    /// Epochs with a base.
    pub ages: u64,
    /// Sum of the standard deviations along the worst horizontal direction (m).
    pub sigma_sum_m: f64,
    /// Sum of the numbers of satellites used.
    pub satellites_sum: f64,
    /// Sum of the ages of base epochs (s).
    pub age_sum_s: f64,
}

#[derive(sqlx::FromRow)]
struct RawRollup {
    begin_s: i64,
    first_time_ns: i64,
    last_time_ns: i64,
    last_seq: i64,
    n_none: i32,
    n_single: i32,
    n_ekf: i32,
    n_fgo: i32,
    n_float: i32,
    n_fixed: i32,
    status: i16,
    latitude_deg: Option<f64>,
    longitude_deg: Option<f64>,
    positions: i32,
    ages: i32,
    south_deg: Option<f64>,
    west_deg: Option<f64>,
    north_deg: Option<f64>,
    east_deg: Option<f64>,
    height_min_m: Option<f32>,
    height_max_m: Option<f32>,
    height_sum_m: f64,
    height_last_m: Option<f32>,
    sigma_min_m: Option<f32>,
    sigma_max_m: Option<f32>,
    sigma_sum_m: f64,
    sigma_last_m: Option<f32>,
    satellites_min: Option<f32>,
    satellites_max: Option<f32>,
    satellites_sum: f64,
    satellites_last: Option<f32>,
    age_min_s: Option<f32>,
    age_max_s: Option<f32>,
    age_sum_s: f64,
    age_last_s: Option<f32>,
}

impl RawRollup {
    fn parse(self) -> Result<Rollup, StoreError> {
        let Self { n_none, n_single, n_ekf, n_fgo, n_float, n_fixed, .. } = self;
        let counts = [n_none, n_single, n_ekf, n_fgo, n_float, n_fixed].map(i64::from);
        let heights = (self.height_min_m, self.height_max_m, self.height_last_m);
        let sigmas = (self.sigma_min_m, self.sigma_max_m, self.sigma_last_m);
        let satellites = (self.satellites_min, self.satellites_max, self.satellites_last);
        let ages = (self.age_min_s, self.age_max_s, self.age_last_s);
        Ok(Rollup {
            begin: begin(self.begin_s),
            span: (GpsTime::from_ns(self.first_time_ns), GpsTime::from_ns(self.last_time_ns)),
            last_seq: self.last_seq as u64,
            statuses: StatusCounts::of(counts),
            status: status_of(i64::from(self.status), "rollup")?,
            position_deg: self.latitude_deg.zip(self.longitude_deg),
            bounds: bounds(self.south_deg, self.west_deg, self.north_deg, self.east_deg),
            height_m: spread(heights, self.height_sum_m, self.positions),
            sigma_m: spread(sigmas, self.sigma_sum_m, self.positions),
            satellites: spread(satellites, self.satellites_sum, self.positions),
            age_s: spread(ages, self.age_sum_s, self.ages),
        })
    }
}

/// The GPS time at which a bucket begins.
fn begin(seconds: i64) -> GpsTime {
    GpsTime::from_ns(seconds.saturating_mul(NS_PER_S))
}

/// The span of time in whole seconds, as buckets have it.
fn seconds((from, to): (GpsTime, GpsTime)) -> (i64, i64) {
    (from.as_ns().div_euclid(NS_PER_S), to.as_ns().div_euclid(NS_PER_S))
}

fn bounds(
    south_deg: Option<f64>,
    west_deg: Option<f64>,
    north_deg: Option<f64>,
    east_deg: Option<f64>,
) -> Option<Bounds> {
    Some(Bounds {
        south_deg: south_deg?,
        west_deg: west_deg?,
        north_deg: north_deg?,
        east_deg: east_deg?,
    })
}

fn spread(
    (min, max, last): (Option<f32>, Option<f32>, Option<f32>),
    sum: f64,
    count: i32,
) -> Option<Spread> {
    let [min, max, last] = [min?, max?, last?].map(f64::from);
    let count = u64::try_from(count).ok().filter(|count| *count != 0)?;
    Some(Spread { min, max, last, sum, count })
}

#[derive(sqlx::FromRow)]
struct RawSummary {
    id: String,
    label: String,
    mode: String,
    closed_unix_ms: Option<i64>,
    first_time_ns: Option<i64>,
    last_time_ns: Option<i64>,
    n_none: Option<i64>,
    n_single: Option<i64>,
    n_ekf: Option<i64>,
    n_fgo: Option<i64>,
    n_float: Option<i64>,
    n_fixed: Option<i64>,
    positions: Option<i64>,
    ages: Option<i64>,
    south_deg: Option<f64>,
    west_deg: Option<f64>,
    north_deg: Option<f64>,
    east_deg: Option<f64>,
    sigma_max_m: Option<f64>,
    sigma_sum_m: Option<f64>,
    satellites_min: Option<f64>,
    satellites_sum: Option<f64>,
    age_max_s: Option<f64>,
    age_sum_s: Option<f64>,
}

impl RawSummary {
    /// The summary; `None` if the session has no such hour.
    fn parse(self) -> Option<SessionSummary> {
        let span = (GpsTime::from_ns(self.first_time_ns?), GpsTime::from_ns(self.last_time_ns?));
        let Self { n_none, n_single, n_ekf, n_fgo, n_float, n_fixed, .. } = self;
        let counts = [n_none, n_single, n_ekf, n_fgo, n_float, n_fixed];
        let mean = |extreme: Option<f64>, sum: Option<f64>, count: Option<i64>| {
            Some((extreme?, sum? / count.filter(|count| 0 < *count)? as f64))
        };
        Some(SessionSummary {
            bounds: bounds(self.south_deg, self.west_deg, self.north_deg, self.east_deg),
            sigma_m: mean(self.sigma_max_m, self.sigma_sum_m, self.positions),
            satellites: mean(self.satellites_min, self.satellites_sum, self.positions),
            age_s: mean(self.age_max_s, self.age_sum_s, self.ages),
            statuses: StatusCounts::of(counts.map(Option::unwrap_or_default)),
            span,
            is_closed: self.closed_unix_ms.is_some(),
            id: self.id,
            label: self.label,
            mode: self.mode,
        })
    }
}

#[derive(sqlx::FromRow)]
struct RawFleetHour {
    begin_s: i64,
    sessions: i64,
    n_none: i64,
    n_single: i64,
    n_ekf: i64,
    n_fgo: i64,
    n_float: i64,
    n_fixed: i64,
    positions: i64,
    ages: i64,
    sigma_sum_m: f64,
    satellites_sum: f64,
    age_sum_s: f64,
}

impl RawFleetHour {
    fn parse(self) -> FleetHour {
        let Self { n_none, n_single, n_ekf, n_fgo, n_float, n_fixed, .. } = self;
        let number = |count: i64| count.max(0) as u64;
        FleetHour {
            begin: begin(self.begin_s),
            sessions: number(self.sessions),
            statuses: StatusCounts::of([n_none, n_single, n_ekf, n_fgo, n_float, n_fixed]),
            positions: number(self.positions),
            ages: number(self.ages),
            sigma_sum_m: self.sigma_sum_m,
            satellites_sum: self.satellites_sum,
            age_sum_s: self.age_sum_s,
        }
    }
}

impl Store {
    /// The rollups of a session whose buckets of this length (s) begin in a span of time, in order
    /// of time; the first [`ROLLUPS_MAX`] of them.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn rollups(
        &self,
        session: SessionKey,
        length_s: i64,
        span: (GpsTime, GpsTime),
    ) -> Result<Vec<Rollup>, StoreError> {
        let (from_s, to_s) = seconds(span);
        let rows: Result<Vec<RawRollup>, _> = reading!(list &self.pool, pool => {
            let select = sqlx::query_as(SELECT_ROLLUPS).bind(session.0).bind(length_s as i32);
            select.bind(from_s).bind(to_s).bind(ROLLUPS_MAX).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading rollups"))?;
        rows.into_iter().map(RawRollup::parse).collect()
    }

    /// Beginnings of the first and the last rollup of the session with this length of bucket.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn rollup_ends(
        &self,
        session: SessionKey,
        length_s: i64,
        (from, to): (Option<GpsTime>, Option<GpsTime>),
    ) -> Result<Option<(GpsTime, GpsTime)>, StoreError> {
        let whole = (GpsTime::from_ns(i64::MIN), GpsTime::from_ns(i64::MAX));
        let (from_s, to_s) = seconds((from.unwrap_or(whole.0), to.unwrap_or(whole.1)));
        let row: Result<(Option<i64>, Option<i64>), _> = reading!(list &self.pool, pool => {
            let select = sqlx::query_as(ROLLUP_ENDS).bind(session.0).bind(length_s as i32);
            select.bind(from_s).bind(to_s).fetch_one(pool).await
        });
        let (first, last) = row.map_err(StoreError::database("reading the span of rollups"))?;
        Ok(first.map(begin).zip(last.map(begin)))
    }

    /// The hours of a tenant's fleet that begin in a span of time; the first [`ROLLUPS_MAX`].
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn fleet_hours(
        &self,
        tenant: &Tenant,
        span: (GpsTime, GpsTime),
    ) -> Result<Vec<FleetHour>, StoreError> {
        let (from_s, to_s) = seconds(span);
        let rows: Result<Vec<RawFleetHour>, _> = reading!(list &self.pool, pool => {
            let select = sqlx::query_as(SELECT_FLEET).bind(tenant.name()).bind(from_s).bind(to_s);
            select.bind(ROLLUPS_MAX).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading the hours of a fleet"))?;
        Ok(rows.into_iter().map(RawFleetHour::parse).collect())
    }

    /// A page of the sessions of a tenant with their hours in a span and an area. It searches a
    /// bounded number of sessions, so it may have fewer items than its size, or none. The list ends
    /// when a page has no token.
    ///
    /// # Errors
    /// The page token or size is invalid, or the database fails.
    pub(crate) async fn session_summaries(
        &self,
        tenant: &Tenant,
        filter: &HistoryFilter,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionSummary>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let sessions = &filter.sessions;
        let beside = self.beside(tenant, sessions, page_token).await?;
        let (from_s, to_s) = seconds(filter.span);
        let area = filter.area.unwrap_or(Bounds {
            south_deg: 0.0,
            west_deg: 0.0,
            north_deg: 0.0,
            east_deg: 0.0,
        });
        let most = filter.sessions_scanned(page_size);
        let scanned = self.listed(tenant, sessions, beside, most + 1).await?;
        let Page { items: scanned, next_page_token: beyond } =
            Page::of(scanned, most, |(_, id)| id.clone());
        let keys = || scanned.iter().map(|(key, _)| *key);
        let Some((first, last)) = keys().min().zip(keys().max()) else {
            return Ok(Page { items: Vec::new(), next_page_token: None });
        };
        let rows: Result<Vec<RawSummary>, _> = reading!(list &self.pool, pool => {
            let sql = match sessions.oldest_first {
                true => summaries!(oldest_first, ""),
                false => summaries!(newest_first, "DESC"),
            };
            let select = sqlx::query_as(sql).bind(tenant.name()).bind(beside);
            // Sessions that were created since the first read have keys outside the range.
            let select = select.bind((scanned.len() + CREATED) as i64);
            let select = select.bind(sessions.closed_column()).bind(&sessions.mode);
            let select = select.bind(&sessions.label).bind(from_s).bind(to_s);
            let select = select.bind(i32::from(filter.area.is_some())).bind(area.south_deg);
            let select = select.bind(area.west_deg).bind(area.north_deg).bind(area.east_deg);
            select.bind(rows_asked).bind(first).bind(last).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("listing the history of sessions"))?;
        let Page { items, next_page_token } = Page::of(rows, page_size, |row| row.id.clone());
        let items = items.into_iter().filter_map(RawSummary::parse).collect();
        Ok(Page { items, next_page_token: next_page_token.or(beyond) })
    }

    /// Keys and ids of up to `rows` sessions of a list after a row key.
    async fn listed(
        &self,
        tenant: &Tenant,
        sessions: &SessionFilter,
        beside: i64,
        rows: usize,
    ) -> Result<Vec<(i64, String)>, StoreError> {
        let ids: Result<Vec<(i64, String)>, _> = reading!(list &self.pool, pool => {
            let sql = if sessions.oldest_first { ids!(oldest_first) } else { ids!(newest_first) };
            let select = sqlx::query_as(sql).bind(tenant.name()).bind(beside);
            let select = select.bind(rows as i64).bind(sessions.closed_column());
            select.bind(&sessions.mode).bind(&sessions.label).fetch_all(pool).await
        });
        ids.map_err(StoreError::database("listing the history of sessions"))
    }

    /// Removes up to `rows` of the hours of sessions and of fleets whose last epoch arrived before
    /// this day. Returns whether there may be more.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn remove_hours_before(
        &self,
        day: i64,
        rows: usize,
    ) -> Result<bool, StoreError> {
        let day = i32::try_from(day).unwrap_or(i32::MAX);
        let mut is_more = false;
        for sql in REMOVE_EXPIRED {
            let removed = writing!(&self.pool, pool => {
                let remove = sqlx::query(sql).bind(day).bind(rows as i64);
                remove.execute(pool).await.map(|done| done.rows_affected())
            });
            let removed = removed.map_err(StoreError::database("removing expired history"))?;
            is_more |= removed == rows as u64;
        }
        Ok(is_more)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_span_or_no_area_looks_through_fewer_sessions() {
        let scanned = |days: i64, area| {
            let span = (begin(0), begin(days * 86_400 - 1));
            HistoryFilter { sessions: SessionFilter::default(), span, area }.sessions_scanned(100)
        };
        let area = Bounds { south_deg: 0.0, west_deg: 0.0, north_deg: 1.0, east_deg: 1.0 };
        assert_eq!([1, 30, 400].map(|days| scanned(days, Some(area))), [10_000, 333, 100]);
        assert_eq!([1, 30, 400].map(|days| scanned(days, None)), [100; 3]);
    }
}
