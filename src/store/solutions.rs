//! Reads epochs and solutions.

use std::sync::Arc;

use crate::gnss::{Epoch, GpsTime, Solution, Status};

use super::chain::Chain;
use super::codec::{SolutionColumns, decode_solution, encode_epoch, status_number};
use super::deadline::{DEADLINE, within};
use super::page::rows_asked;
use super::pool::{Pool, reading};
use super::{BaseKey, BaseUse, Page, SessionKey, Store, StoreError};

const PAGE_LIMIT: usize = 10_000;

/// A stored solution.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredSolution {
    /// Number of the epoch.
    pub seq: u64,
    /// 0 for the real-time answer, 1 for the smoothed one.
    pub revision: u32,
    /// The solution.
    pub solution: Solution,
    /// Version of the program that computed it.
    pub version: Arc<str>,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
}

/// The revisions of each epoch's solution to list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Revisions {
    /// The real-time answer.
    First,
    /// The newest revision.
    Last,
    /// All revisions.
    All,
}

/// The solutions to list.
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionQuery {
    /// First time tag.
    pub from: Option<GpsTime>,
    /// Last time tag.
    pub to: Option<GpsTime>,
    /// Only solutions with this status.
    pub status: Option<Status>,
    /// The revisions of each epoch.
    pub revisions: Revisions,
    /// Solutions per page, 1 to 10 000.
    pub page_size: usize,
    /// Token of the page; `None` for the first page.
    pub page_token: Option<String>,
}

/// A stored epoch with its real-time answer.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredEpoch {
    /// The epoch.
    pub epoch: Epoch,
    /// The real-time answer.
    pub solution: StoredSolution,
    /// Number of the last push of navigation data before it was solved.
    pub navigation: u64,
    /// The base epochs it was solved with.
    pub base: Option<BaseUse>,
}

impl StoredEpoch {
    /// Whether `epoch` is the stored one, bit by bit.
    pub(crate) fn is(&self, epoch: &Epoch) -> bool {
        encode_epoch(&self.epoch) == encode_epoch(epoch)
    }
}

#[derive(sqlx::FromRow)]
struct RawSolution {
    seq: i64,
    revision: i32,
    gps_time_ns: i64,
    x_m: Option<f64>,
    y_m: Option<f64>,
    z_m: Option<f64>,
    version: Option<String>,
    configuration_hash: Option<String>,
    content: Vec<u8>,
}

impl RawSolution {
    fn parse(self) -> Result<StoredSolution, StoreError> {
        let time = GpsTime::from_ns(self.gps_time_ns);
        let columns = SolutionColumns { time, position_m: [self.x_m, self.y_m, self.z_m] };
        let decoded = decode_solution(&self.content, columns);
        let decoded = decoded.map_err(StoreError::corrupt("solution"))?;
        let origin = decoded.origin.or(self.version.zip(self.configuration_hash));
        let (version, configuration_hash) = origin.ok_or_else(|| StoreError::CorruptText {
            what: "solution",
            why: "it names no version and configuration".to_owned(),
        })?;
        Ok(StoredSolution {
            seq: self.seq as u64,
            revision: self.revision as u32,
            solution: decoded.solution,
            version: version.into(),
            configuration_hash: configuration_hash.into(),
        })
    }
}

#[derive(sqlx::FromRow)]
struct RawEpoch {
    epoch: Vec<u8>,
    navigation: i64,
    base: Option<i64>,
    base_after: Option<i64>,
    base_through: Option<i64>,
    #[sqlx(flatten)]
    solution: RawSolution,
}

impl RawEpoch {
    /// The row, with its epoch decoded.
    fn parse(self, epoch: Epoch) -> Result<StoredEpoch, StoreError> {
        let base = self.base.map(|key| BaseUse {
            base: BaseKey(key),
            after: self.base_after.unwrap_or(0) as u64,
            through: self.base_through.unwrap_or(0) as u64,
        });
        let navigation = self.navigation as u64;
        Ok(StoredEpoch { epoch, solution: self.solution.parse()?, navigation, base })
    }
}

/// The columns of [`RawSolution`] from the solutions `s`.
macro_rules! solution_columns {
    () => {
        "s.seq AS seq, s.revision AS revision, s.gps_time_ns AS gps_time_ns, s.x_m AS x_m, \
         s.y_m AS y_m, s.z_m AS z_m, o.version AS version, \
         o.configuration_hash AS configuration_hash, s.content AS content"
    };
}
/// The rows of [`RawEpoch`] of the session `$1`, up to the other conditions.
macro_rules! select_epochs {
    ($conditions:literal) => {
        concat!(
            "SELECT e.content AS epoch, e.navigation AS navigation, e.base AS base, ",
            "e.base_after AS base_after, e.base_through AS base_through, ",
            solution_columns!(),
            " FROM epochs e JOIN session_heads h ON h.session = e.session ",
            "JOIN solutions s ON s.session = e.session AND s.seq = e.seq AND s.revision = 0 ",
            "LEFT JOIN solution_origins o ON o.key = s.origin WHERE e.session = $1 ",
            "AND e.seq > COALESCE(h.removed_through, -1) ",
            $conditions
        )
    };
}

impl Store {
    /// The last `count` epochs of a session with their real-time answers, the newest first.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn last_epochs(
        &self,
        session: SessionKey,
        count: usize,
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        let rows: Result<Vec<RawEpoch>, _> = reading!(&self.pool, pool => sqlx::query_as(
            select_epochs!("ORDER BY e.seq DESC LIMIT $2"),
        )
        .bind(session.0)
        .bind(count as i64)
        .fetch_all(pool)
        .await);
        let rows = rows.map_err(StoreError::database("reading a session's last epochs"))?;
        let mut epochs = self.decoded(session, rows).await?;
        epochs.reverse();
        Ok(epochs)
    }

    /// The first `count` epochs of a session after number `after`, or from its first epoch, in
    /// order and with their real-time answers.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn epochs_after(
        &self,
        session: SessionKey,
        after: Option<u64>,
        count: usize,
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        let after = after.map_or(-1, |seq| i64::try_from(seq).unwrap_or(i64::MAX));
        let rows: Result<Vec<RawEpoch>, _> = reading!(&self.pool, pool => sqlx::query_as(
            select_epochs!("AND e.seq > $2 ORDER BY e.seq LIMIT $3"),
        )
        .bind(session.0)
        .bind(after)
        .bind(count as i64)
        .fetch_all(pool)
        .await);
        let rows = rows.map_err(StoreError::database("reading a session's epochs"))?;
        self.decoded(session, rows).await
    }

    /// Number of the epoch that `count` epochs of the session follow, if there are that many.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn number_before_last(
        &self,
        session: SessionKey,
        count: usize,
    ) -> Result<Option<u64>, StoreError> {
        let row: Result<Option<(i64,)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT seq FROM epochs WHERE session = $1
                       ORDER BY seq DESC LIMIT 1 OFFSET $2";
            sqlx::query_as(sql).bind(session.0).bind(count as i64).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a session's epochs"))?;
        Ok(row.map(|(seq,)| seq as u64))
    }

    /// Those of the epochs `seqs` that are stored, with their real-time answers.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn epochs(
        &self,
        session: SessionKey,
        seqs: &[u64],
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        let seqs: Vec<i64> = seqs.iter().filter_map(|seq| i64::try_from(*seq).ok()).collect();
        let rows: Result<Vec<RawEpoch>, _> = match &self.pool {
            Pool::Sqlite { readers, .. } => {
                let list = serde_json::to_string(&seqs).expect("a list of numbers is JSON");
                let rows = sqlx::query_as(select_epochs!(
                    "AND e.seq IN (SELECT value FROM json_each($2))"
                ))
                .bind(session.0)
                .bind(list)
                .fetch_all(readers);
                within(DEADLINE, rows).await
            }
            Pool::Postgres(pool) => {
                let sql = select_epochs!("AND e.seq = ANY($2)");
                let rows = sqlx::query_as(sql).bind(session.0).bind(seqs).fetch_all(pool);
                within(DEADLINE, rows).await
            }
        };
        let rows = rows.map_err(StoreError::database("reading epochs"))?;
        self.decoded(session, rows).await
    }

    /// Decodes rows in order of their numbers.
    async fn decoded(
        &self,
        session: SessionKey,
        mut rows: Vec<RawEpoch>,
    ) -> Result<Vec<StoredEpoch>, StoreError> {
        rows.sort_unstable_by_key(|row| row.solution.seq);
        let mut chain = Chain::of(self, session);
        let mut epochs = Vec::with_capacity(rows.len());
        for row in rows {
            let epoch = chain.decode(row.solution.seq as u64, &row.epoch).await?;
            epochs.push(row.parse(epoch)?);
        }
        Ok(epochs)
    }

    /// A page of a session's solutions in order of epoch number and revision.
    ///
    /// # Errors
    /// The page token or size is invalid, the database fails, or a row is corrupt.
    pub async fn solutions(
        &self,
        session: SessionKey,
        query: &SolutionQuery,
    ) -> Result<Page<StoredSolution>, StoreError> {
        let rows_asked = rows_asked(query.page_size, PAGE_LIMIT)?;
        let after = match &query.page_token {
            None => (-1, i32::MAX),
            Some(token) => {
                parse_token(token).ok_or_else(|| StoreError::PageToken { token: token.clone() })?
            }
        };
        let Some((first, last)) = self.numbers_between(session, query.from, query.to).await? else {
            return Ok(Page { items: Vec::new(), next_page_token: None });
        };
        let rows = self.select(session, query, (first, last), after, rows_asked).await;
        let rows = rows.map_err(StoreError::database("listing solutions"))?;
        Page::of(rows, query.page_size, |row| format!("{}.{}", row.seq, row.revision))
            .try_map(RawSolution::parse)
    }

    async fn select(
        &self,
        session: SessionKey,
        query: &SolutionQuery,
        (first, last): (i64, i64),
        (after_seq, after_revision): (i64, i32),
        rows: i64,
    ) -> Result<Vec<RawSolution>, sqlx::Error> {
        const ANY_STATUS: i16 = -1;
        let status = query.status.map_or(ANY_STATUS, status_number);
        macro_rules! list {
            ($condition:literal) => {
                concat!(
                    "SELECT ",
                    solution_columns!(),
                    " FROM solutions s LEFT JOIN solution_origins o ON o.key = s.origin ",
                    "WHERE session = $1 AND seq >= $2 AND seq <= $3 ",
                    "AND (seq > $4 OR revision > $5) AND ($6 = -1 OR status = $6) ",
                    "AND gps_time_ns >= $8 AND gps_time_ns <= $9 ",
                    "AND seq > COALESCE((SELECT removed_through FROM session_heads h ",
                    "WHERE h.session = $1), -1) ",
                    $condition,
                    " ORDER BY seq, revision LIMIT $7"
                )
            };
        }
        let sql = match query.revisions {
            Revisions::All => list!(""),
            Revisions::First => list!("AND revision = 0"),
            Revisions::Last => list!(
                "AND NOT EXISTS (SELECT 1 FROM solutions n WHERE n.session = s.session \
                 AND n.seq = s.seq AND n.revision > s.revision)"
            ),
        };
        let (from, to) = time_columns(query.from, query.to);
        reading!(&self.pool, pool => sqlx::query_as(sql)
            .bind(session.0)
            .bind(first.max(after_seq))
            .bind(last)
            .bind(after_seq)
            .bind(after_revision)
            .bind(status)
            .bind(rows)
            .bind(from)
            .bind(to)
            .fetch_all(pool)
            .await)
    }

    /// The first and last epoch number of a span of time. Within an arc of a session time rises
    /// with the number, so a query by number reads only the rows of the page. With several arcs
    /// the rows of the whole span are read.
    async fn numbers_between(
        &self,
        session: SessionKey,
        from: Option<GpsTime>,
        to: Option<GpsTime>,
    ) -> Result<Option<(i64, i64)>, StoreError> {
        let mut span = (0, i64::MAX);
        if (from.is_some() || to.is_some()) && !self.arcs(session).await?.is_empty() {
            let (from, to) = time_columns(from, to);
            let row: Result<(Option<i64>, Option<i64>), _> = reading!(&self.pool, pool => {
                let sql = "SELECT MIN(seq), MAX(seq) FROM solutions
                           WHERE session = $1 AND gps_time_ns >= $2 AND gps_time_ns <= $3";
                sqlx::query_as(sql).bind(session.0).bind(from).bind(to).fetch_one(pool).await
            });
            let (first, last) = row.map_err(StoreError::database("finding a time"))?;
            return Ok(first.zip(last));
        }
        if let Some(from) = from {
            let sql = "SELECT seq FROM solutions WHERE session = $1 AND gps_time_ns >= $2 \
                       ORDER BY gps_time_ns LIMIT 1";
            match number(&self.pool, sql, session, from).await? {
                Some(first) => span.0 = first,
                None => return Ok(None),
            }
        }
        if let Some(to) = to {
            let sql = "SELECT seq FROM solutions WHERE session = $1 AND gps_time_ns <= $2 \
                       ORDER BY gps_time_ns DESC LIMIT 1";
            match number(&self.pool, sql, session, to).await? {
                Some(last) => span.1 = last,
                None => return Ok(None),
            }
        }
        Ok(Some(span))
    }
}

/// A span of time as columns; an open end has no limit.
fn time_columns(from: Option<GpsTime>, to: Option<GpsTime>) -> (i64, i64) {
    (from.map_or(i64::MIN, GpsTime::as_ns), to.map_or(i64::MAX, GpsTime::as_ns))
}

async fn number(
    pool: &Pool,
    sql: &'static str,
    session: SessionKey,
    time: GpsTime,
) -> Result<Option<i64>, StoreError> {
    let row: Result<Option<(i64,)>, _> = reading!(pool, pool => {
        sqlx::query_as(sql).bind(session.0).bind(time.as_ns()).fetch_optional(pool).await
    });
    Ok(row.map_err(StoreError::database("finding a time"))?.map(|(seq,)| seq))
}

/// Number and revision of the last item of the previous page, written as `seq.revision`.
fn parse_token(token: &str) -> Option<(i64, i32)> {
    let (seq, revision) = token.split_once('.')?;
    let (seq, revision) = (seq.parse().ok()?, revision.parse().ok()?);
    (0 <= seq && 0 <= revision).then_some((seq, revision))
}
