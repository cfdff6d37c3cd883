//! Broadcast navigation data.

use crate::gnss::{
    Ephemeris, GpsTime, KlobucharCoefficients, LeapSeconds, Navigation, NavigationMessage,
};

use super::codec::{
    NavigationRecord, decode_ephemeris, decode_record, encode_ephemeris, encode_record,
};
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

/// The beginning of the sources that own their data: these serve nobody else.
pub(crate) const OWNER_PREFIX: &str = "device ";

/// The changes of one push. Data belong to an owner: a source that begins with `device `, or
/// for all other sources the service, whose name is empty.
#[derive(Clone, Debug)]
pub struct NavigationChange<'a> {
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
    /// Most superseded ephemerides that are stored for replay.
    pub superseded_limit: usize,
}

const NEXT_PUSH: &str = "UPDATE navigation_pushes SET newest = newest + 1 RETURNING newest";
const END_EPHEMERIS: &str = "UPDATE ephemerides SET until = $1
    WHERE satellite = $2 AND toe_ns = $3 AND message = $4 AND toc_ns = $5 AND issue = $6
    AND (source = $7 OR ($7 = '' AND source NOT LIKE 'device %')) AND until IS NULL";
const INSERT_EPHEMERIS: &str = "INSERT INTO ephemerides
    (since, satellite, toe_ns, message, toc_ns, issue, source, stored_unix_ms, content)
    VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)";
const END_RECORD: &str = "UPDATE navigation_records SET until = $1 WHERE kind = $2
    AND (source = $3 OR ($3 = '' AND source NOT LIKE 'device %')) AND until IS NULL";
const INSERT_RECORD: &str = "INSERT INTO navigation_records
    (since, kind, source, stored_unix_ms, content) VALUES ($1, $2, $3, $4, $5)";
/// Selects the push that ended the newest ephemeris beyond the limit.
const SURPLUS: &str = "SELECT until FROM ephemerides WHERE until IS NOT NULL
    ORDER BY until DESC LIMIT 1 OFFSET $1";
/// Deletes the ephemerides that ended up to this push.
const FORGET: [&str; 3] = [
    "DELETE FROM ephemerides WHERE until <= $1",
    "DELETE FROM navigation_records WHERE until <= $1",
    "UPDATE navigation_pushes SET complete_since = $1",
];

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
    /// Stores all navigation data of a push, or none. Returns the number of the push; each push has
    /// the next number.
    ///
    /// # Errors
    /// The database fails. Nothing may then be considered stored.
    pub(crate) async fn push_navigation(
        &self,
        change: &NavigationChange<'_>,
    ) -> Result<u64, StoreError> {
        let owner = owner_of(change.source);
        let pushed = writing!(&self.pool, pool => {
            let pushed = async {
                let mut transaction = pool.begin().await?;
                let (push,): (i64,) =
                    sqlx::query_as(NEXT_PUSH).fetch_one(&mut *transaction).await?;
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
                        .execute(&mut *transaction)
                        .await?;
                }
                let surplus = sqlx::query_as(SURPLUS).bind(change.superseded_limit as i64);
                let surplus: Option<(i64,)> = surplus.fetch_optional(&mut *transaction).await?;
                if let Some((end,)) = surplus {
                    for forget in FORGET {
                        sqlx::query(forget).bind(end).execute(&mut *transaction).await?;
                    }
                }
                transaction.commit().await?;
                Ok::<u64, sqlx::Error>(push as u64)
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
        let (push, _) = self.navigation_pushes().await?;
        self.navigation_in_force(push).await
    }

    /// All navigation data that were in force after push number `push`.
    ///
    /// # Errors
    /// Some of them are no longer stored, the database fails, or a row is corrupt.
    pub(crate) async fn navigation_after(&self, push: u64) -> Result<StoredNavigation, StoreError> {
        let (_, complete_since) = self.navigation_pushes().await?;
        if push < complete_since {
            return Err(StoreError::NavigationForgotten { push, complete_since });
        }
        self.navigation_in_force(push).await
    }

    /// Numbers of the last push and of the first push whose navigation data are complete.
    async fn navigation_pushes(&self) -> Result<(u64, u64), StoreError> {
        let row: Result<(i64, i64), _> = reading!(&self.pool, pool => {
            let sql = "SELECT newest, complete_since FROM navigation_pushes";
            sqlx::query_as(sql).fetch_one(pool).await
        });
        let (newest, complete) = row.map_err(StoreError::database("reading navigation data"))?;
        Ok((newest as u64, complete as u64))
    }

    async fn navigation_in_force(&self, push: u64) -> Result<StoredNavigation, StoreError> {
        let failed = "reading navigation data";
        let at = push as i64;
        type EphemerisRow = (String, i64, Vec<u8>);
        let ephemerides: Result<Vec<EphemerisRow>, _> = reading!(bulk &self.pool, pool => {
            let sql = "SELECT source, stored_unix_ms, content FROM ephemerides
                       WHERE since <= $1 AND (until IS NULL OR $1 < until)";
            sqlx::query_as(sql).bind(at).fetch_all(pool).await
        });
        let records: Result<Vec<(String, String, Vec<u8>)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT source, kind, content FROM navigation_records
                       WHERE since <= $1 AND (until IS NULL OR $1 < until)";
            sqlx::query_as(sql).bind(at).fetch_all(pool).await
        });
        let parse = |(source, stored_unix_ms, content): (String, i64, Vec<u8>)| {
            let ephemeris = decode_ephemeris(&content).map_err(StoreError::corrupt("ephemeris"))?;
            Ok(StoredEphemeris { ephemeris, source, stored_unix_ms })
        };
        let ephemerides = ephemerides.map_err(StoreError::database(failed))?;
        let ephemerides = ephemerides.into_iter().map(parse).collect::<Result<_, StoreError>>()?;
        let parse = |(source, kind, content): (String, String, Vec<u8>)| {
            let record =
                decode_record(&content).map_err(StoreError::corrupt("navigation record"))?;
            let mut coefficients = Navigation::default();
            take_over(&mut coefficients, &kind, record);
            Ok(StoredCoefficients { coefficients, source })
        };
        let records = records.map_err(StoreError::database(failed))?;
        let coefficients = records.into_iter().map(parse).collect::<Result<_, StoreError>>()?;
        Ok(StoredNavigation { push, ephemerides, coefficients })
    }
}

/// The owner of what a source brings: the source itself, or the service.
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
        // A kind that a later Graphfix with the same schema added. It is ignored.
        _ => {}
    }
}
