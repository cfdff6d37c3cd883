//! Broadcast navigation data, kept over restarts.

use crate::gnss::{
    Ephemeris, GpsTime, KlobucharCoefficients, LeapSeconds, Navigation, NavigationMessage,
};

use super::codec::{
    NavigationRecord, decode_ephemeris, decode_record, encode_ephemeris, encode_record,
};
use super::pool::{reading, writing};
use super::{Store, StoreError};

/// An ephemeris with where it came from.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredEphemeris {
    /// The ephemeris.
    pub ephemeris: Ephemeris,
    /// Who brought it.
    pub source: String,
    /// When it was stored (ms since 1970-01-01 UTC).
    pub stored_unix_ms: i64,
}

/// Everything broadcast that is stored.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredNavigation {
    /// Ephemerides.
    pub ephemerides: Vec<StoredEphemeris>,
    /// Ionosphere coefficients and leap seconds; no ephemerides.
    pub coefficients: Navigation,
}

impl Store {
    /// Stores ephemerides, and the coefficients and leap seconds that `coefficients` has, and
    /// forgets `dropped`; all of it or nothing.
    ///
    /// # Errors
    /// The database fails; nothing may then be taken for stored.
    pub async fn store_navigation(
        &self,
        ephemerides: &[&Ephemeris],
        coefficients: &Navigation,
        dropped: &[&Ephemeris],
        source: &str,
        stored_unix_ms: i64,
    ) -> Result<(), StoreError> {
        let failed = "storing navigation data";
        writing!(&self.pool, pool => {
            let mut transaction = pool.begin().await.map_err(StoreError::database(failed))?;
            for ephemeris in ephemerides {
                let [toe_ns, toc_ns, issue] = numbers(ephemeris);
                sqlx::query(
                    "INSERT INTO ephemerides (satellite, toe_ns, message, toc_ns, issue, source,
                                              stored_unix_ms, content)
                     VALUES ($1, $2, $3, $4, $5, $6, $7, $8)
                     ON CONFLICT (satellite, toe_ns, message, toc_ns, issue) DO UPDATE SET
                         source = $6, stored_unix_ms = $7, content = $8",
                )
                .bind(ephemeris.satellite().to_string())
                .bind(toe_ns)
                .bind(message_name(ephemeris))
                .bind(toc_ns)
                .bind(issue)
                .bind(source)
                .bind(stored_unix_ms)
                .bind(encode_ephemeris(ephemeris))
                .execute(&mut *transaction)
                .await
                .map_err(StoreError::database(failed))?;
            }
            for (kind, record) in records(coefficients) {
                sqlx::query(
                    "INSERT INTO navigation_records (kind, source, stored_unix_ms, content)
                     VALUES ($1, $2, $3, $4)
                     ON CONFLICT (kind) DO UPDATE SET
                         source = $2, stored_unix_ms = $3, content = $4",
                )
                .bind(kind)
                .bind(source)
                .bind(stored_unix_ms)
                .bind(encode_record(&record))
                .execute(&mut *transaction)
                .await
                .map_err(StoreError::database(failed))?;
            }
            for ephemeris in dropped {
                let [toe_ns, toc_ns, issue] = numbers(ephemeris);
                sqlx::query(
                    "DELETE FROM ephemerides WHERE satellite = $1 AND toe_ns = $2 AND message = $3
                     AND toc_ns = $4 AND issue = $5",
                )
                .bind(ephemeris.satellite().to_string())
                .bind(toe_ns)
                .bind(message_name(ephemeris))
                .bind(toc_ns)
                .bind(issue)
                .execute(&mut *transaction)
                .await
                .map_err(StoreError::database(failed))?;
            }
            transaction.commit().await.map_err(StoreError::database(failed))
        })
    }

    /// Everything broadcast that is stored.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub async fn navigation(&self) -> Result<StoredNavigation, StoreError> {
        let failed = "reading navigation data";
        let ephemerides: Result<Vec<(String, i64, Vec<u8>)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT source, stored_unix_ms, content FROM ephemerides";
            sqlx::query_as(sql).fetch_all(pool).await
        });
        let records: Result<Vec<(String, Vec<u8>)>, _> = reading!(&self.pool, pool => {
            sqlx::query_as("SELECT kind, content FROM navigation_records").fetch_all(pool).await
        });
        let parse = |(source, stored_unix_ms, content): (String, i64, Vec<u8>)| {
            let ephemeris = decode_ephemeris(&content).map_err(StoreError::corrupt("ephemeris"))?;
            Ok(StoredEphemeris { ephemeris, source, stored_unix_ms })
        };
        let ephemerides = ephemerides.map_err(StoreError::database(failed))?;
        let ephemerides = ephemerides.into_iter().map(parse).collect::<Result<_, StoreError>>()?;
        let mut coefficients = Navigation::default();
        for (kind, content) in records.map_err(StoreError::database(failed))? {
            let record =
                decode_record(&content).map_err(StoreError::corrupt("navigation record"))?;
            take_over(&mut coefficients, &kind, record);
        }
        Ok(StoredNavigation { ephemerides, coefficients })
    }
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

/// The records that `navigation` has, by kind.
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
        // A kind that a later Graphfix of the same schema added: not an error, and not ours.
        _ => {}
    }
}
