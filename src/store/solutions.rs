//! Lists solutions: first answers, which are in the rows of their epochs, and revisions.

use std::collections::HashMap;
use std::sync::Arc;

use tokio::task::coop::consume_budget;

use crate::gnss::{GpsTime, Solution, Status};

use super::codec::{SolutionColumns, decode_solution, is_relative, status_number};
use super::deadline::{DEADLINE, within};
use super::page::rows_asked;
use super::pool::{Pool, reading};
use super::times::Numbers;
use super::{Page, SessionKey, Store, StoreError};

const PAGE_LIMIT: usize = 10_000;
/// Most epochs that are searched for a status or in several arcs. A page ends there, even if it is
/// not full.
const SCANNED_EPOCHS: usize = 20_000;
/// Number of the epoch that comes a given number of epochs later.
const NUMBER_AFTER: &str = "SELECT seq FROM epochs \
    WHERE session = $1 AND seq >= $2 AND seq <= $3 AND seq > COALESCE(\
    (SELECT removed_through FROM session_heads h WHERE h.session = $1), -1) \
    ORDER BY seq LIMIT 1 OFFSET $4";

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

/// Which revisions of each epoch's solution are listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Revisions {
    /// The real-time answer.
    First,
    /// The newest revision.
    Last,
    /// All revisions.
    All,
    /// All but the real-time answer.
    Later,
}

/// Which solutions are listed.
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

impl SolutionQuery {
    /// Checks the size of the page.
    ///
    /// # Errors
    /// It is out of range.
    pub(crate) fn check(&self) -> Result<(), StoreError> {
        rows_asked(self.page_size, PAGE_LIMIT).map(drop)
    }
}

#[derive(Clone, sqlx::FromRow)]
pub(super) struct RawSolution {
    pub(super) seq: i64,
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
    /// The solution. A relative one is decoded with `first`, the encoded first answer of its epoch.
    pub(super) fn parse(self, first: Option<&[u8]>) -> Result<StoredSolution, StoreError> {
        let time = GpsTime::from_ns(self.gps_time_ns);
        let columns = SolutionColumns { time, position_m: [self.x_m, self.y_m, self.z_m] };
        let decoded = decode_solution(&self.content, columns, first);
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

/// The columns of [`RawSolution`]: of an epoch's first answer `e`, or of a revision `r`.
macro_rules! columns {
    (first) => {
        "SELECT e.seq AS seq, 0 AS revision, e.gps_time_ns AS gps_time_ns, e.x_m AS x_m, \
         e.y_m AS y_m, e.z_m AS z_m, e.origin AS origin, e.solution AS content FROM epochs e "
    };
    (revision) => {
        "SELECT r.seq AS seq, r.revision AS revision, r.gps_time_ns AS gps_time_ns, \
         r.x_m AS x_m, r.y_m AS y_m, r.z_m AS z_m, r.origin AS origin, r.content AS content \
         FROM revisions r "
    };
}
/// The conditions of a list on the rows of either table, and its order.
macro_rules! conditions {
    ($row:literal, $revision:literal, $condition:literal, $order:literal) => {
        concat!(
            "WHERE ",
            $row,
            ".session = $1 AND ",
            $row,
            ".seq >= $2 AND ",
            $row,
            ".seq <= $3 ",
            "AND (",
            $row,
            ".seq > $4 OR ",
            $revision,
            " > $5) ",
            "AND ($6 = -1 OR ",
            $row,
            ".status = $6) ",
            "AND ",
            $row,
            ".gps_time_ns >= $8 AND ",
            $row,
            ".gps_time_ns <= $9 ",
            "AND ",
            $row,
            ".seq > COALESCE((SELECT removed_through FROM session_heads h ",
            "WHERE h.session = $1), -1) ",
            $condition,
            " ORDER BY ",
            $order,
            " LIMIT $7"
        )
    };
}
/// A page of answers and revisions. Each table returns at most as many rows as the page has, so
/// that neither is read to its end.
macro_rules! list {
    ($condition_of_first:literal, $condition_of_revision:literal) => {
        concat!(
            "SELECT u.seq AS seq, u.revision AS revision, u.gps_time_ns AS gps_time_ns, ",
            "u.x_m AS x_m, u.y_m AS y_m, u.z_m AS z_m, o.version AS version, ",
            "o.configuration_hash AS configuration_hash, u.content AS content FROM (",
            "SELECT * FROM (",
            columns!(first),
            conditions!("e", "0", $condition_of_first, "e.seq"),
            ") AS answers UNION ALL SELECT * FROM (",
            columns!(revision),
            conditions!("r", "r.revision", $condition_of_revision, "r.seq, r.revision"),
            ") AS later) AS u LEFT JOIN solution_origins o ON o.key = u.origin ",
            "ORDER BY u.seq, u.revision LIMIT $7"
        )
    };
}

impl Store {
    /// A page of a session's solutions in order of epoch number and revision. It may have fewer
    /// items than its size, or none, even if there are more. The list ends when a page has no
    /// token.
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
        let Some(numbers) = self.numbers_between(session, query.from, query.to).await? else {
            return Ok(Page { items: Vec::new(), next_page_token: None });
        };
        let numbers = Numbers { first: numbers.first.max(after.0), ..numbers };
        let scanned = self.scanned_through(session, query, numbers).await?;
        let numbers = (numbers.first, scanned.unwrap_or(numbers.last));
        let rows = self.select(session, query, numbers, after, rows_asked).await;
        let rows = rows.map_err(StoreError::database("listing solutions"))?;
        let token = |row: &RawSolution| format!("{}.{}", row.seq, row.revision);
        let Page { mut items, next_page_token } = Page::of(rows, query.page_size, token);
        // A revision that was stored on two days is listed once.
        items.dedup_by_key(|row| (row.seq, row.revision));
        let items = self.decoded_solutions(session, items).await?;
        let beyond = || scanned.map(|seq| format!("{seq}.{}", i32::MAX));
        Ok(Page { items, next_page_token: next_page_token.or_else(beyond) })
    }

    /// Number of the last epoch that a page may reach; `None` if there is no such limit between
    /// these numbers. Without a limit the database could search a whole session for a status, for
    /// the newest revisions, or for a time in a later arc.
    async fn scanned_through(
        &self,
        session: SessionKey,
        query: &SolutionQuery,
        Numbers { first, last, has_others }: Numbers,
    ) -> Result<Option<i64>, StoreError> {
        let epochs = match (query.status, query.revisions) {
            (None, Revisions::Last) if !has_others => query.page_size + 1, // Each has one.
            (None, _) if !has_others => return Ok(None),
            _ => SCANNED_EPOCHS.max(query.page_size + 1),
        };
        let number: Result<Option<i64>, _> = reading!(list &self.pool, pool => {
            let number = sqlx::query_scalar(NUMBER_AFTER).bind(session.0).bind(first).bind(last);
            number.bind(epochs as i64).fetch_optional(pool).await
        });
        number.map_err(StoreError::database("listing solutions"))
    }

    /// All revisions of the solution of an epoch; up to 100.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn solutions_of(
        &self,
        session: SessionKey,
        seq: u64,
    ) -> Result<Vec<StoredSolution>, StoreError> {
        let query = SolutionQuery {
            from: None,
            to: None,
            status: None,
            revisions: Revisions::All,
            page_size: 100,
            page_token: None,
        };
        let (seq, rows) = (seq as i64, query.page_size as i64);
        let rows = self.select(session, &query, (seq, seq), (-1, i32::MAX), rows).await;
        let mut rows = rows.map_err(StoreError::database("reading an epoch's solutions"))?;
        rows.dedup_by_key(|row| row.revision); // It may have been stored on two days.
        self.decoded_solutions(session, rows).await
    }

    /// Number of the last epoch of a session with a later revision than the real-time answer.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn last_revised(
        &self,
        session: SessionKey,
    ) -> Result<Option<u64>, StoreError> {
        let number: Result<Option<i64>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT MAX(seq) FROM revisions WHERE session = $1";
            sqlx::query_scalar(sql).bind(session.0).fetch_one(pool).await
        });
        let number = number.map_err(StoreError::database("reading the last revision"))?;
        Ok(number.map(|seq| seq as u64))
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
        let sql = match query.revisions {
            Revisions::All => list!("", ""),
            Revisions::First => list!("", "AND 1 = 0"),
            Revisions::Later => list!("AND 1 = 0", ""),
            Revisions::Last => list!(
                "AND NOT EXISTS (SELECT 1 FROM revisions n WHERE n.session = e.session \
                 AND n.seq = e.seq AND n.seq >= $2 AND n.seq <= $3)",
                "AND NOT EXISTS (SELECT 1 FROM revisions n WHERE n.session = r.session \
                 AND n.seq = r.seq AND n.revision > r.revision \
                 AND n.seq >= $2 AND n.seq <= $3)"
            ),
        };
        let (from, to) = time_columns(query.from, query.to);
        reading!(list &self.pool, pool => sqlx::query_as(sql)
            .bind(session.0)
            .bind(first)
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

    /// Decodes rows in their order. It reads the first answers that revisions need, unless they are
    /// among the rows. Revisions that have expired since they were read are left out.
    async fn decoded_solutions(
        &self,
        session: SessionKey,
        rows: Vec<RawSolution>,
    ) -> Result<Vec<StoredSolution>, StoreError> {
        let firsts = self.first_answers(session, &rows).await?;
        let (mut solutions, mut last) = (Vec::with_capacity(rows.len()), None);
        for row in rows {
            consume_budget().await; // Many rows don't hold the thread up.
            let first = match &last {
                Some((seq, content)) if *seq == row.seq => Some(content),
                _ => firsts.get(&row.seq),
            };
            let seq = row.seq;
            let content = (row.revision == 0).then(|| row.content.clone());
            match row.parse(first.map(Vec::as_slice)) {
                Err(error) if self.explains_missing(session, seq as u64, &error).await? => {}
                parsed => solutions.push(parsed?),
            }
            last = content.map(|content| (seq, content)).or(last);
        }
        Ok(solutions)
    }

    /// The encoded first answers that revisions among the rows need, and that are not among them.
    async fn first_answers(
        &self,
        session: SessionKey,
        rows: &[RawSolution],
    ) -> Result<HashMap<i64, Vec<u8>>, StoreError> {
        let mut last = None;
        let mut needed = Vec::new();
        for row in rows {
            match row.revision {
                0 => last = Some(row.seq),
                _ if is_relative(&row.content) && last != Some(row.seq) => needed.push(row.seq),
                _ => {}
            }
        }
        if needed.is_empty() {
            return Ok(HashMap::new());
        }
        let found: Result<Vec<(i64, Vec<u8>)>, _> = match &self.pool {
            Pool::Sqlite { listers, .. } => {
                let list = serde_json::to_string(&needed).expect("a list of numbers is JSON");
                let sql = "SELECT seq, solution FROM epochs
                           WHERE session = $1 AND seq IN (SELECT value FROM json_each($2))";
                let rows = sqlx::query_as(sql).bind(session.0).bind(list).fetch_all(listers);
                within(DEADLINE, rows).await
            }
            Pool::Postgres { listers, .. } => {
                let sql = "SELECT seq, solution FROM epochs WHERE session = $1 AND seq = ANY($2)";
                let rows = sqlx::query_as(sql).bind(session.0).bind(needed).fetch_all(listers);
                within(DEADLINE, rows).await
            }
        };
        let found = found.map_err(StoreError::database("reading first answers"))?;
        Ok(found.into_iter().collect())
    }
}

/// A span of time as columns; an open end is the least or greatest value.
pub(super) fn time_columns(from: Option<GpsTime>, to: Option<GpsTime>) -> (i64, i64) {
    (from.map_or(i64::MIN, GpsTime::as_ns), to.map_or(i64::MAX, GpsTime::as_ns))
}

/// Number and revision of the last item of the previous page, written as `seq.revision`.
fn parse_token(token: &str) -> Option<(i64, i32)> {
    let (seq, revision) = token.split_once('.')?;
    let (seq, revision) = (seq.parse().ok()?, revision.parse().ok()?);
    (0 <= seq && 0 <= revision).then_some((seq, revision))
}

#[cfg(test)]
mod tests {
    use crate::gnss::Epoch;
    use crate::store::EncodedEpoch;
    use crate::store::sample::{answer, session, store};

    use super::*;

    /// An epoch without a position.
    fn encoded(seq: u64) -> EncodedEpoch {
        let answer = answer(seq, 0);
        EncodedEpoch::new(Arc::new(Epoch::new(answer.solution.time)), &answer, 0, None, None)
    }

    /// A list for a status that no epoch has reads only some thousand epochs a page.
    #[tokio::test]
    async fn a_page_looks_through_some_epochs_only() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(&folder).await;
        let scanned = SCANNED_EPOCHS as u64;
        let key = session(&store, (1..=scanned + 100).map(encoded).collect()).await;
        let mut query = SolutionQuery {
            from: None,
            to: None,
            status: Some(Status::Fixed),
            revisions: Revisions::Last,
            page_size: 10,
            page_token: None,
        };
        let page = store.solutions(key, &query).await.unwrap();
        let token = format!("{}.{}", scanned + 1, i32::MAX);
        assert_eq!((page.items.len(), &page.next_page_token), (0, &Some(token)));
        query.page_token = page.next_page_token;
        let page = store.solutions(key, &query).await.unwrap();
        assert_eq!((page.items.len(), page.next_page_token), (0, None));

        (query.status, query.page_token) = (None, None);
        for pages in 0..3 {
            let page = store.solutions(key, &query).await.unwrap();
            let numbers: Vec<u64> = page.items.iter().map(|solution| solution.seq).collect();
            assert_eq!(numbers, (10 * pages + 1..=10 * pages + 10).collect::<Vec<_>>());
            query.page_token = page.next_page_token;
        }
    }

    /// A list for a time that two arcs have reads only some thousand epochs between them a page.
    #[tokio::test]
    async fn a_page_looks_through_some_epochs_between_arcs_only() {
        let folder = tempfile::tempdir().unwrap();
        let store = store(&folder).await;
        let scanned = SCANNED_EPOCHS as u64;
        let key = session(&store, (1..=scanned + 100).map(encoded).collect()).await;
        // The last epoch is of another arc, and has the time of the first.
        let Pool::Sqlite { writer, .. } = &store.pool else { panic!("SQLite") };
        let (last, first) = (scanned + 100, answer(1, 0).solution.time);
        let again = sqlx::query("UPDATE epochs SET gps_time_ns = $1 WHERE seq = $2");
        again.bind(first.as_ns()).bind(last as i64).execute(writer).await.unwrap();
        let arc =
            "INSERT INTO session_arcs (session, after_seq, created_unix_ms) VALUES (1, $1, 0)";
        sqlx::query(arc).bind(last as i64 - 1).execute(writer).await.unwrap();
        let mut query = SolutionQuery {
            from: Some(first),
            to: Some(first),
            status: None,
            revisions: Revisions::All,
            page_size: 10,
            page_token: None,
        };
        for (found, token) in [(1, Some(format!("{}.{}", scanned + 1, i32::MAX))), (last, None)] {
            let page = store.solutions(key, &query).await.unwrap();
            let numbers: Vec<u64> = page.items.iter().map(|solution| solution.seq).collect();
            assert_eq!((numbers, &page.next_page_token), (vec![found], &token));
            query.page_token = page.next_page_token;
        }
    }
}
