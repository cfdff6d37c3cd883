//! Broadcast navigation data.

use crate::gnss::{
    Ephemeris, GpsTime, KlobucharCoefficients, LeapSeconds, Navigation, NavigationMessage,
};

use super::codec::{
    NavigationRecord, decode_ephemeris, decode_record, encode_ephemeris, encode_record,
};
use super::navigation_accounts::{OWNER_PREFIX, account_of, forget_superseded};
use super::notices::{Change as Changed, notify};
use super::pool::{reading, writing};
use super::{Store, StoreError};

/// An ephemeris with its source.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredEphemeris {
    /// The ephemeris.
    pub ephemeris: Ephemeris,
    /// Source, such as `upload` or a caster's address.
    pub source: String,
    /// When it was stored (ms since 1970-01-01 UTC).
    pub stored_unix_ms: i64,
}

/// Coefficients or leap seconds with their source.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredCoefficients {
    /// Ionosphere coefficients of one kind, or leap seconds; nothing else.
    pub coefficients: Navigation,
    /// Source, such as `upload` or a caster's address.
    pub source: String,
}

/// All navigation data in force.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredNavigation {
    /// Number of the last push.
    pub push: u64,
    /// Ephemerides in force.
    pub ephemerides: Vec<StoredEphemeris>,
    /// Ionosphere coefficients and leap seconds, by kind.
    pub coefficients: Vec<StoredCoefficients>,
}

/// Ephemerides and coefficients.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NavigationRows {
    /// Ephemerides.
    pub ephemerides: Vec<StoredEphemeris>,
    /// Ionosphere coefficients and leap seconds, by kind.
    pub coefficients: Vec<StoredCoefficients>,
}

/// Difference between the navigation data in force after push `from` and after push `to`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NavigationDifference {
    /// In force after push `from`, but not after push `to`.
    pub ended: NavigationRows,
    /// In force after push `to`, but not after push `from`.
    pub begun: NavigationRows,
    /// Accounts of which some of the difference is no longer stored.
    pub incomplete: Vec<String>,
}

/// The changes of one push. Data have an owner: the source itself if its name begins with
/// `device `, otherwise the service, whose name is empty.
#[derive(Clone, Debug)]
pub struct NavigationChange<'a> {
    /// Number of the push that this one continues.
    pub after: u64,
    /// New ephemerides. They replace those of the same owner, satellite, time and issue.
    pub new: &'a [Ephemeris],
    /// Ephemerides that are no longer in force, with their owners.
    pub ended: &'a [(&'a str, &'a Ephemeris)],
    /// New coefficients and leap seconds. They replace those of the same owner and kind.
    pub coefficients: &'a Navigation,
    /// Coefficients and leap seconds that are no longer in force, with their owners.
    pub ended_coefficients: &'a [(&'a str, &'a Navigation)],
    /// Source of the push.
    pub source: &'a str,
    /// Time of the push (ms since 1970-01-01 UTC).
    pub stored_unix_ms: i64,
    /// Accounts whose superseded data are counted, and removed beyond the limit.
    pub counted_accounts: &'a [&'a str],
    /// Number of superseded ephemerides of one account that stay stored for replay.
    pub superseded_limit: usize,
}

const NEXT_PUSH: &str =
    "UPDATE navigation_pushes SET newest = newest + 1 WHERE newest = $1 RETURNING newest";
const END_EPHEMERIS: &str = "UPDATE ephemerides SET until = $1
    WHERE satellite = $2 AND toe_ns = $3 AND message = $4 AND toc_ns = $5 AND issue = $6
    AND (source = $7 OR ($7 = '' AND source NOT LIKE 'device %')) AND until IS NULL";
const INSERT_EPHEMERIS: &str = "INSERT INTO ephemerides
    (since, satellite, toe_ns, message, toc_ns, issue, source, stored_unix_ms, content, account)
    VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10)";
const END_RECORD: &str = "UPDATE navigation_records SET until = $1 WHERE kind = $2
    AND (source = $3 OR ($3 = '' AND source NOT LIKE 'device %')) AND until IS NULL";
const INSERT_RECORD: &str = "INSERT INTO navigation_records
    (since, kind, source, stored_unix_ms, content, account) VALUES ($1, $2, $3, $4, $5, $6)";

const READING: &str = "reading navigation data";

macro_rules! ephemeris_rows {
    () => {
        "SELECT since, until, source, stored_unix_ms, content FROM ephemerides "
    };
}
macro_rules! record_rows {
    () => {
        "SELECT since, until, source, kind, content FROM navigation_records "
    };
}

/// Binds the key of an ephemeris after the number of the push.
macro_rules! named {
    ($query:expr, $push:expr, $ephemeris:expr) => {{
        let [toe_ns, toc_ns, issue] = numbers($ephemeris);
        $query
            .bind($push)
            .bind($ephemeris.satellite().to_string())
            .bind(toe_ns)
            .bind(message_name($ephemeris))
            .bind(toc_ns)
            .bind(issue)
    }};
}

impl Store {
    /// Stores all navigation data of a push, or none. Returns the number of the push, which is the
    /// next one. Returns `None` and stores nothing if another push came after the one that this
    /// push continues.
    ///
    /// # Errors
    /// The database fails. Nothing may then be considered stored.
    pub(crate) async fn push_navigation(
        &self,
        change: &NavigationChange<'_>,
    ) -> Result<Option<u64>, StoreError> {
        let (owner, account) = (owner_of(change.source), account_of(change.source));
        let pushed = writing!(&self.pool, pool => {
            let pushed = async {
                let mut transaction = pool.begin().await?;
                let next = sqlx::query_scalar(NEXT_PUSH).bind(change.after as i64);
                let next: Option<i64> = next.fetch_optional(&mut *transaction).await?;
                let Some(push) = next else { return Ok(None) };
                let replaced = change.new.iter().map(|ephemeris| (owner, ephemeris));
                for (owner, ephemeris) in replaced.chain(change.ended.iter().copied()) {
                    let end = named!(sqlx::query(END_EPHEMERIS), push, ephemeris);
                    end.bind(owner).execute(&mut *transaction).await?;
                }
                for ephemeris in change.new {
                    named!(sqlx::query(INSERT_EPHEMERIS), push, ephemeris)
                        .bind(change.source)
                        .bind(change.stored_unix_ms)
                        .bind(encode_ephemeris(ephemeris))
                        .bind(account)
                        .execute(&mut *transaction)
                        .await?;
                }
                for (owner, coefficients) in change.ended_coefficients {
                    for (kind, _) in records(coefficients) {
                        let end = sqlx::query(END_RECORD).bind(push).bind(kind);
                        end.bind(*owner).execute(&mut *transaction).await?;
                    }
                }
                for (kind, record) in records(change.coefficients) {
                    let end = sqlx::query(END_RECORD).bind(push).bind(kind);
                    end.bind(owner).execute(&mut *transaction).await?;
                    sqlx::query(INSERT_RECORD)
                        .bind(push)
                        .bind(kind)
                        .bind(change.source)
                        .bind(change.stored_unix_ms)
                        .bind(encode_record(&record))
                        .bind(account)
                        .execute(&mut *transaction)
                        .await?;
                }
                for account in change.counted_accounts {
                    forget_superseded!(transaction, *account, change.superseded_limit);
                }
                notify!(self, transaction, Changed::Navigation);
                transaction.commit().await?;
                Ok::<Option<u64>, sqlx::Error>(Some(push as u64))
            };
            pushed.await
        });
        pushed.map_err(StoreError::database("storing navigation data"))
    }

    /// All navigation data in force.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn navigation(&self) -> Result<StoredNavigation, StoreError> {
        let push = self.newest_navigation_push().await?;
        self.navigation_in_force(push).await
    }

    /// All navigation data that were in force after push number `push`, and the accounts of which
    /// some are no longer stored. `account` is not among them.
    ///
    /// # Errors
    /// Some of the data that serve sessions of `account` are no longer stored, the database fails,
    /// or a row is corrupt.
    pub(crate) async fn navigation_after(
        &self,
        push: u64,
        account: &str,
    ) -> Result<(StoredNavigation, Vec<String>), StoreError> {
        let stored = self.navigation_in_force(push).await?;
        // Read last, so that the check also covers data that were removed during the reads.
        let completeness = self.navigation_completeness().await?;
        let complete_since = completeness.since(account);
        if push < complete_since {
            return Err(StoreError::NavigationForgotten { push, complete_since });
        }
        Ok((stored, completeness.incomplete_at(push)))
    }

    /// Number of the last push.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn newest_navigation_push(&self) -> Result<u64, StoreError> {
        Ok(self.navigation_completeness().await?.newest)
    }

    async fn navigation_in_force(&self, push: u64) -> Result<StoredNavigation, StoreError> {
        let at = push as i64;
        let ephemerides: Result<Vec<EphemerisRow>, _> = reading!(bulk &self.pool, pool => {
            let sql = concat!(
                ephemeris_rows!(), "WHERE since <= $1 AND (until IS NULL OR $1 < until)"
            );
            sqlx::query_as(sql).bind(at).fetch_all(pool).await
        });
        let records: Result<Vec<RecordRow>, _> = reading!(&self.pool, pool => {
            let sql = concat!(
                record_rows!(), "WHERE since <= $1 AND (until IS NULL OR $1 < until)"
            );
            sqlx::query_as(sql).bind(at).fetch_all(pool).await
        });
        let ephemerides = ephemerides.map_err(StoreError::database(READING))?;
        let records = records.map_err(StoreError::database(READING))?;
        let ephemerides = ephemerides.into_iter().map(EphemerisRow::parse);
        let coefficients = records.into_iter().map(RecordRow::parse);
        Ok(StoredNavigation {
            push,
            ephemerides: ephemerides.collect::<Result<_, _>>()?,
            coefficients: coefficients.collect::<Result<_, _>>()?,
        })
    }

    /// How the navigation data in force after push `to` differ from those after push `from`, which
    /// may be the later one. `None` if some of the difference for sessions of `account` is no
    /// longer stored.
    ///
    /// # Errors
    /// The data that served sessions of `account` after push `to` are no longer stored, the
    /// database fails, or a row is corrupt.
    pub(crate) async fn navigation_difference(
        &self,
        from: u64,
        to: u64,
        account: &str,
    ) -> Result<Option<NavigationDifference>, StoreError> {
        let (first, last) = (from.min(to) as i64, from.max(to) as i64);
        let ephemerides: Result<Vec<EphemerisRow>, _> = reading!(bulk &self.pool, pool => {
            let sql = concat!(
                ephemeris_rows!(),
                "WHERE ($1 < since AND since <= $2) OR ($1 < until AND until <= $2)"
            );
            sqlx::query_as(sql).bind(first).bind(last).fetch_all(pool).await
        });
        let records: Result<Vec<RecordRow>, _> = reading!(&self.pool, pool => {
            let sql = concat!(
                record_rows!(),
                "WHERE ($1 < since AND since <= $2) OR ($1 < until AND until <= $2)"
            );
            sqlx::query_as(sql).bind(first).bind(last).fetch_all(pool).await
        });
        let ephemerides = ephemerides.map_err(StoreError::database(READING))?;
        let records = records.map_err(StoreError::database(READING))?;
        // Read last, so that the check also covers data that were removed during the reads.
        let completeness = self.navigation_completeness().await?;
        let complete_since = completeness.since(account);
        if to < complete_since {
            return Err(StoreError::NavigationForgotten { push: to, complete_since });
        }
        if from < complete_since {
            return Ok(None);
        }
        let (mut ended, mut begun) = (NavigationRows::default(), NavigationRows::default());
        for row in ephemerides {
            match row.span.change(from, to) {
                Some(Change::Ended) => ended.ephemerides.push(row.parse()?),
                Some(Change::Begun) => begun.ephemerides.push(row.parse()?),
                None => {}
            }
        }
        for row in records {
            match row.span.change(from, to) {
                Some(Change::Ended) => ended.coefficients.push(row.parse()?),
                Some(Change::Begun) => begun.coefficients.push(row.parse()?),
                None => {}
            }
        }
        let incomplete = completeness.incomplete_at(from.min(to));
        Ok(Some(NavigationDifference { ended, begun, incomplete }))
    }
}

/// The push from which a row is in force, and the push from which it no longer is.
#[derive(sqlx::FromRow)]
struct Span {
    since: i64,
    until: Option<i64>,
}

/// How a row changes between two pushes.
enum Change {
    Ended,
    Begun,
}

impl Span {
    fn change(&self, from: u64, to: u64) -> Option<Change> {
        let is_in_force = |push: u64| {
            self.since <= push as i64 && self.until.is_none_or(|end| (push as i64) < end)
        };
        match (is_in_force(from), is_in_force(to)) {
            (true, false) => Some(Change::Ended),
            (false, true) => Some(Change::Begun),
            _ => None,
        }
    }
}

#[derive(sqlx::FromRow)]
struct EphemerisRow {
    #[sqlx(flatten)]
    span: Span,
    source: String,
    stored_unix_ms: i64,
    content: Vec<u8>,
}

impl EphemerisRow {
    fn parse(self) -> Result<StoredEphemeris, StoreError> {
        let Self { source, stored_unix_ms, content, .. } = self;
        let ephemeris = decode_ephemeris(&content).map_err(StoreError::corrupt("ephemeris"))?;
        Ok(StoredEphemeris { ephemeris, source, stored_unix_ms })
    }
}

#[derive(sqlx::FromRow)]
struct RecordRow {
    #[sqlx(flatten)]
    span: Span,
    source: String,
    kind: String,
    content: Vec<u8>,
}

impl RecordRow {
    fn parse(self) -> Result<StoredCoefficients, StoreError> {
        let record = decode_record(&self.content);
        let record = record.map_err(StoreError::corrupt("navigation record"))?;
        let mut coefficients = Navigation::default();
        take_over(&mut coefficients, &self.kind, record);
        Ok(StoredCoefficients { coefficients, source: self.source })
    }
}

/// The owner of the data of a source: the source itself, or the service.
pub(crate) fn owner_of(source: &str) -> &str {
    if source.starts_with(OWNER_PREFIX) { source } else { "" }
}

fn numbers(ephemeris: &Ephemeris) -> [i64; 3] {
    [ephemeris.toe().as_ns(), ephemeris.toc().as_ns(), ephemeris.issue().into()]
}

fn message_name(ephemeris: &Ephemeris) -> &'static str {
    let Ephemeris::Keplerian(keplerian) = ephemeris else { return "FDMA" };
    match keplerian.message {
        NavigationMessage::Lnav => "LNAV",
        NavigationMessage::Cnav => "CNAV",
        NavigationMessage::Cnav2 => "CNV2",
        NavigationMessage::Inav => "INAV",
        NavigationMessage::Fnav => "FNAV",
        NavigationMessage::D1 => "D1",
        NavigationMessage::D2 => "D2",
        NavigationMessage::Cnv1 => "B-CNAV1",
        NavigationMessage::Cnv2 => "B-CNAV2",
        NavigationMessage::Cnv3 => "B-CNAV3",
        NavigationMessage::Fdma => "FDMA",
    }
}

const GPS: &str = "klobuchar-gps";
const BEIDOU: &str = "klobuchar-beidou";
const QZSS: &str = "klobuchar-qzss";
const NEQUICK: &str = "nequick";
const LEAP_SECONDS: &str = "leap-seconds";

/// The records of `navigation`, by kind.
fn records(navigation: &Navigation) -> Vec<(&'static str, NavigationRecord)> {
    let klobuchar = |c: KlobucharCoefficients| NavigationRecord::Klobuchar(c);
    let leap = navigation.leap_seconds;
    let broadcast = leap != LeapSeconds::table();
    let after_the_table = GpsTime::from_week_seconds(14_999, 0.0);
    let records = [
        (GPS, navigation.klobuchar_gps.map(klobuchar)),
        (BEIDOU, navigation.klobuchar_beidou.map(klobuchar)),
        (QZSS, navigation.klobuchar_qzss.map(klobuchar)),
        (NEQUICK, navigation.nequick.map(NavigationRecord::NeQuick)),
        (LEAP_SECONDS, broadcast.then(|| NavigationRecord::LeapSeconds(leap.at(after_the_table)))),
    ];
    records.into_iter().filter_map(|(kind, record)| Some((kind, record?))).collect()
}

fn take_over(navigation: &mut Navigation, kind: &str, record: NavigationRecord) {
    match (kind, record) {
        (GPS, NavigationRecord::Klobuchar(c)) => navigation.klobuchar_gps = Some(c),
        (BEIDOU, NavigationRecord::Klobuchar(c)) => navigation.klobuchar_beidou = Some(c),
        (QZSS, NavigationRecord::Klobuchar(c)) => navigation.klobuchar_qzss = Some(c),
        (NEQUICK, NavigationRecord::NeQuick(c)) => navigation.nequick = Some(c),
        (LEAP_SECONDS, NavigationRecord::LeapSeconds(seconds)) => {
            navigation.leap_seconds = LeapSeconds::with_broadcast(seconds);
        }
        // A later Graphfix with the same schema has added this kind. It is ignored.
        _ => {}
    }
}
