//! Heads of sessions: state after the last commit, and the span of time of their solutions.

use crate::gnss::{Ecef, GpsTime, Status};
use crate::tenant::Tenant;

use super::page::rows_asked;
use super::pool::reading;
use super::rollup::status_of;
use super::session_filter::condition;
use super::{Bounds, Page, SessionFilter, SessionKey, Store, StoreError};

const PAGE_LIMIT: usize = 10_000;
/// Most heads that are searched for an area. A page ends there, even if it is not full.
pub(crate) const SCANNED_HEADS: usize = 20_000;

/// A session as its last commit left it.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionHead {
    /// Public id of the session.
    pub id: String,
    /// A name for people; may be empty.
    pub label: String,
    /// Name of the mode.
    pub mode: String,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// Whether it is closed.
    pub is_closed: bool,
    /// Number of the last epoch.
    pub last_seq: Option<u64>,
    /// Time tag of the last epoch.
    pub last_time: Option<GpsTime>,
    /// Status of the last epoch.
    pub status: Option<Status>,
    /// The latest position.
    pub position: Option<Ecef>,
}

#[derive(sqlx::FromRow)]
struct RawHead {
    id: String,
    label: String,
    mode: String,
    created_unix_ms: i64,
    closed_unix_ms: Option<i64>,
    last_seq: Option<i64>,
    last_gps_time_ns: Option<i64>,
    status: Option<i64>,
    x_m: Option<f64>,
    y_m: Option<f64>,
    z_m: Option<f64>,
}

impl RawHead {
    fn position(&self) -> Option<Ecef> {
        Some(Ecef::new(self.x_m?, self.y_m?, self.z_m?))
    }

    /// Whether the latest position lies in an area.
    fn is_within(&self, area: &Bounds) -> bool {
        self.position().map(Ecef::to_geodetic).is_some_and(|position| {
            let (latitude, longitude) = (position.latitude_rad, position.longitude_rad);
            area.contains(latitude.to_degrees(), longitude.to_degrees())
        })
    }

    fn parse(self) -> Result<SessionHead, StoreError> {
        let status = self.status.map(|number| status_of(number, "session head"));
        let position = self.position();
        Ok(SessionHead {
            id: self.id,
            label: self.label,
            mode: self.mode,
            created_unix_ms: self.created_unix_ms,
            is_closed: self.closed_unix_ms.is_some(),
            last_seq: self.last_seq.map(|seq| seq as u64),
            last_time: self.last_gps_time_ns.map(GpsTime::from_ns),
            status: status.transpose()?,
            position,
        })
    }
}

/// Selects the columns of [`RawHead`] of a page.
macro_rules! select_heads {
    ($order:ident) => {
        concat!(
            "SELECT s.id AS id, s.label AS label, s.mode AS mode, ",
            "s.created_unix_ms AS created_unix_ms, h.closed_unix_ms AS closed_unix_ms, ",
            "h.last_seq AS last_seq, h.last_gps_time_ns AS last_gps_time_ns, ",
            "CAST(h.status AS BIGINT) AS status, h.x_m AS x_m, h.y_m AS y_m, h.z_m AS z_m ",
            "FROM sessions s JOIN session_heads h ON h.session = s.key ",
            condition!($order)
        )
    };
}

/// Selects the time of an epoch between two numbers that is not removed.
macro_rules! time_of {
    ($order:literal) => {
        concat!(
            "SELECT gps_time_ns FROM epochs WHERE session = $1 AND $2 <= seq AND seq <= $3 ",
            "AND seq > COALESCE((SELECT removed_through FROM session_heads h ",
            "WHERE h.session = $1), -1) ",
            $order
        )
    };
}

impl Store {
    /// A page of the heads of a tenant, or of those whose latest position is in an area. With an
    /// area a page may have fewer items than its size, or none, even if there are more. The list
    /// ends when a page has no token.
    ///
    /// # Errors
    /// The page token or size is invalid, the database fails, or a row is corrupt.
    pub(crate) async fn heads(
        &self,
        tenant: &Tenant,
        filter: &SessionFilter,
        area: Option<&Bounds>,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionHead>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let beside = self.beside(tenant, filter, page_token).await?;
        let token = |row: &RawHead| row.id.clone();
        let Some(area) = area else {
            let rows = self.head_rows(tenant, filter, beside, rows_asked).await?;
            return Page::of(rows, page_size, token).try_map(RawHead::parse);
        };
        let scanned = self.head_rows(tenant, filter, beside, SCANNED_HEADS as i64 + 1).await?;
        let Page { items: mut rows, next_page_token: beyond } =
            Page::of(scanned, SCANNED_HEADS, token);
        rows.retain(|row| row.is_within(area));
        let Page { items, next_page_token } = Page::of(rows, page_size, token);
        let page = Page { items, next_page_token: next_page_token.or(beyond) };
        page.try_map(RawHead::parse)
    }

    /// Row key of the session after which a page begins.
    pub(super) async fn beside(
        &self,
        tenant: &Tenant,
        filter: &SessionFilter,
        page_token: Option<&str>,
    ) -> Result<i64, StoreError> {
        let Some(id) = page_token else { return Ok(filter.start()) };
        let key = self.key_of(tenant, id).await?;
        key.ok_or_else(|| StoreError::PageToken { token: id.to_owned() })
    }

    async fn head_rows(
        &self,
        tenant: &Tenant,
        filter: &SessionFilter,
        beside: i64,
        rows: i64,
    ) -> Result<Vec<RawHead>, StoreError> {
        let rows: Result<Vec<RawHead>, _> = reading!(list &self.pool, pool => {
            let sql = match filter.oldest_first {
                true => select_heads!(oldest_first),
                false => select_heads!(newest_first),
            };
            let select = sqlx::query_as(sql).bind(tenant.name()).bind(beside).bind(rows);
            let select = select.bind(filter.closed_column()).bind(&filter.mode);
            select.bind(&filter.label).fetch_all(pool).await
        });
        rows.map_err(StoreError::database("listing the heads of sessions"))
    }

    /// First and last time tag of a session's solutions, over all its arcs; `None` without any.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn solution_span(
        &self,
        session: SessionKey,
    ) -> Result<Option<(GpsTime, GpsTime)>, StoreError> {
        let ends = self.arcs(session).await?.into_iter().map(|seq| seq as i64).chain([i64::MAX]);
        let (mut span, mut first) = (None::<(i64, i64)>, 0);
        for last in ends {
            // Within an arc time rises with the number.
            let row: Result<(Option<i64>, Option<i64>), _> = reading!(list &self.pool, pool => {
                let sql = concat!(
                    "SELECT (", time_of!("ORDER BY seq LIMIT 1"), "), ",
                    "(", time_of!("ORDER BY seq DESC LIMIT 1"), ")"
                );
                sqlx::query_as(sql).bind(session.0).bind(first).bind(last).fetch_one(pool).await
            });
            let row = row.map_err(StoreError::database("reading a span of time"))?;
            if let (Some(begin), Some(end)) = row {
                let (earliest, latest) = span.unwrap_or((begin, end));
                span = Some((earliest.min(begin), latest.max(end)));
            }
            first = last.saturating_add(1);
        }
        Ok(span.map(|(begin, end)| (GpsTime::from_ns(begin), GpsTime::from_ns(end))))
    }
}
