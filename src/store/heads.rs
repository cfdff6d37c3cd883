//! Heads of sessions: what was committed last, and the span of time of their solutions.

use crate::gnss::{Ecef, GpsTime, Status};
use crate::tenant::Tenant;

use super::codec::status_number;
use super::page::rows_asked;
use super::pool::reading;
use super::session_filter::condition;
use super::{Page, SessionFilter, SessionKey, Store, StoreError};

const PAGE_LIMIT: usize = 10_000;

/// What a session's last commit left.
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
    fn parse(self) -> Result<SessionHead, StoreError> {
        let status = self.status.map(|number| {
            let known = |status: &Status| i64::from(status_number(*status)) == number;
            let status = Status::ALL.into_iter().find(known);
            status.ok_or_else(|| StoreError::CorruptText {
                what: "session head",
                why: format!("{number} is not the number of a status"),
            })
        });
        let position = match (self.x_m, self.y_m, self.z_m) {
            (Some(x_m), Some(y_m), Some(z_m)) => Some(Ecef::new(x_m, y_m, z_m)),
            _ => None,
        };
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

/// The columns of [`RawHead`] of a page.
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

/// The time of an epoch that is not removed, of those between two numbers.
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
    /// A page of the heads of a tenant.
    ///
    /// # Errors
    /// The page token or size is invalid, the database fails, or a row is corrupt.
    pub(crate) async fn heads(
        &self,
        tenant: &Tenant,
        filter: &SessionFilter,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionHead>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let beside = match page_token {
            None => filter.start(),
            Some(id) => {
                let key = self.key_of(tenant, id).await?;
                key.ok_or_else(|| StoreError::PageToken { token: id.to_owned() })?
            }
        };
        let rows: Result<Vec<RawHead>, _> = reading!(list &self.pool, pool => {
            let sql = match filter.oldest_first {
                true => select_heads!(oldest_first),
                false => select_heads!(newest_first),
            };
            let select = sqlx::query_as(sql).bind(tenant.name()).bind(beside).bind(rows_asked);
            let select = select.bind(filter.closed_column()).bind(&filter.mode);
            select.bind(&filter.label).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("listing the heads of sessions"))?;
        Page::of(rows, page_size, |row| row.id.clone()).try_map(RawHead::parse)
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
