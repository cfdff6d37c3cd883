//! Statements that insert: on Postgres many rows as arrays, on SQLite row by row (`sqlite`).

use std::collections::BTreeMap;

use sqlx::PgConnection;

use crate::gnss::{GpsTime, LeapSeconds};
use crate::store::audit::note;

use super::batch::{Batch, EncodedEpoch, EncodedSnapshot, EncodedSolution};
use super::origins::OriginKeys;
use super::raw::write_raw_postgres;
use super::rollups::write_rollups_postgres;

/// Columns of an answer. They are the last ones in both tables.
const ANSWER_COLUMNS: usize = 10;
pub(super) const EPOCH_COLUMNS: usize = 9 + ANSWER_COLUMNS;
pub(super) const REVISION_COLUMNS: usize = 5 + ANSWER_COLUMNS;

macro_rules! answer_columns {
    () => {
        "origin, status, x_m, y_m, z_m, sigma_east_mm, sigma_north_mm, sigma_up_mm, ratio, \
         base_age_ms"
    };
}
pub(super) const INSERT_EPOCHS: &str = concat!(
    "INSERT INTO epochs (session, seq, gps_time_ns, navigation, base, base_after, base_through, \
     content, solution, ",
    answer_columns!(),
    ") "
);
pub(super) const INSERT_REVISIONS: &str = concat!(
    "INSERT INTO revisions (session, seq, revision, gps_time_ns, content, ",
    answer_columns!(),
    ") "
);
/// The insert into `epochs` detects a repeated number; a stored revision is not replaced.
pub(super) const ONCE: &str = " ON CONFLICT (session, seq, revision) DO NOTHING";
const POSTGRES_EPOCHS: &str = concat!(
    "INSERT INTO epochs (session, day, seq, gps_time_ns, navigation, base, base_after, \
     base_through, content, solution, ",
    answer_columns!(),
    ") SELECT u.session, DATE '1970-01-01' + u.day, u.seq, u.gps_time_ns, u.navigation, u.base, \
     u.base_after, u.base_through, u.content, u.solution, ",
    answer_columns!(),
    " FROM UNNEST($1::bigint[], $2::integer[], $3::bigint[], $4::bigint[], $5::bigint[], \
     $6::bigint[], $7::bigint[], $8::bigint[], $9::bytea[], $10::bytea[], $11::integer[], \
     $12::smallint[], $13::double precision[], $14::double precision[], \
     $15::double precision[], $16::integer[], $17::integer[], $18::integer[], $19::real[], \
     $20::integer[]) AS u (session, day, seq, gps_time_ns, navigation, base, base_after, \
     base_through, content, solution, ",
    answer_columns!(),
    ")"
);
/// A stored revision is not replaced. It may be stored again on another day; readers list only one
/// of the two.
const POSTGRES_REVISIONS: &str = concat!(
    "INSERT INTO revisions (session, day, seq, revision, gps_time_ns, content, ",
    answer_columns!(),
    ") SELECT u.session, DATE '1970-01-01' + u.day, u.seq, u.revision, u.gps_time_ns, u.content, ",
    answer_columns!(),
    " FROM UNNEST($1::bigint[], $2::integer[], $3::bigint[], $4::smallint[], $5::bigint[], \
     $6::bytea[], $7::integer[], $8::smallint[], $9::double precision[], \
     $10::double precision[], $11::double precision[], $12::integer[], $13::integer[], \
     $14::integer[], $15::real[], $16::integer[]) AS u (session, day, seq, revision, \
     gps_time_ns, content, ",
    answer_columns!(),
    ") ON CONFLICT DO NOTHING"
);
/// Inserts states of sessions. The newest state is kept, in whatever order the writers commit.
macro_rules! upsert_snapshots {
    ($values:literal) => {
        concat!(
            "INSERT INTO snapshots (session, seq, configuration_hash, content, since_day) ",
            $values,
            " ON CONFLICT (session) DO UPDATE SET seq = excluded.seq, ",
            "configuration_hash = excluded.configuration_hash, content = excluded.content, ",
            "since_day = excluded.since_day WHERE snapshots.seq <= excluded.seq"
        )
    };
}
/// Inserts states that are kept for replay. The first state of a day stays.
macro_rules! keep_snapshots {
    ($values:literal) => {
        concat!(
            "INSERT INTO kept_snapshots (session, day, seq, configuration_hash, content) ",
            $values,
            " ON CONFLICT (session, day) DO NOTHING"
        )
    };
}
pub(super) const UPSERT_SNAPSHOT: &str = upsert_snapshots!("VALUES ($1, $2, $3, $4, $5)");
pub(super) const KEEP_SNAPSHOT: &str = keep_snapshots!("VALUES ($1, $2, $3, $4, $5)");
const POSTGRES_SNAPSHOTS: &str = upsert_snapshots!(
    "SELECT * FROM UNNEST($1::bigint[], $2::bigint[], $3::text[], $4::bytea[], $5::integer[])"
);
const POSTGRES_KEPT: &str = keep_snapshots!(
    "SELECT * FROM UNNEST($1::bigint[], $2::bigint[], $3::bigint[], $4::text[], $5::bytea[])"
);
pub(super) const INSERT_ARC: &str = "INSERT INTO session_arcs \
    (session, after_seq, created_unix_ms) VALUES ($1, $2, $3) \
    ON CONFLICT (session, after_seq) DO NOTHING";
/// Sets the newest known time of the stream, since a wrong one may be why the new arc was
/// requested.
pub(super) const DATE_RAW: &str =
    "UPDATE raw_streams SET gps_time_ns = $2, received_unix_ms = $3 WHERE session = $1";
pub(super) const CLOSE: &str =
    "UPDATE sessions SET closed_unix_ms = $2 WHERE key = $1 AND closed_unix_ms IS NULL";
pub(super) const FORGET_ALL_RAW: &str = "DELETE FROM raw_pieces WHERE session = $1";

/// GPS time of the system clock's time (ms since 1970-01-01 UTC), in nanoseconds.
pub(super) fn gps_time_ns(unix_ms: i64) -> i64 {
    GpsTime::from_unix_ms(unix_ms, &LeapSeconds::table()).as_ns()
}

/// An epoch with the key of its answer's origin.
struct EpochRow<'a> {
    session: i64,
    day: Option<i32>,
    epoch: &'a EncodedEpoch,
    origin: i32,
}

/// A revision with the key of its origin.
struct RevisionRow<'a> {
    session: i64,
    day: Option<i32>,
    solution: &'a EncodedSolution,
    origin: i32,
}

fn epoch_rows<'a>(batches: &[&'a Batch], keys: &OriginKeys) -> Vec<EpochRow<'a>> {
    let rows = |batch: &&'a Batch| {
        let batch: &'a Batch = batch;
        let (session, day) = (batch.session.0, batch.partition());
        batch.epochs.iter().map(move |epoch| {
            let origin = keys.key(&epoch.solution);
            EpochRow { session, day, epoch, origin }
        })
    };
    batches.iter().flat_map(rows).collect()
}

fn revision_rows<'a>(batches: &[&'a Batch], keys: &OriginKeys) -> Vec<RevisionRow<'a>> {
    let rows = |batch: &&'a Batch| {
        let batch: &'a Batch = batch;
        let (session, day) = (batch.session.0, batch.partition());
        batch.revisions.iter().map(move |solution| {
            let origin = keys.key(solution);
            RevisionRow { session, day, solution, origin }
        })
    };
    batches.iter().flat_map(rows).collect()
}

/// Binds the columns of many answers as arrays. Each answer comes with the key of its origin.
macro_rules! bind_answers {
    ($insert:expr, $answers:expr) => {{
        let answers = &$answers;
        let axis =
            |axis: usize| answers.iter().map(|(s, _)| s.position_m[axis]).collect::<Vec<_>>();
        let sigma =
            |axis: usize| answers.iter().map(|(s, _)| s.summary.sigma_mm[axis]).collect::<Vec<_>>();
        $insert
            .bind(answers.iter().map(|(_, origin)| *origin).collect::<Vec<_>>())
            .bind(answers.iter().map(|(s, _)| s.status).collect::<Vec<_>>())
            .bind(axis(0))
            .bind(axis(1))
            .bind(axis(2))
            .bind(sigma(0))
            .bind(sigma(1))
            .bind(sigma(2))
            .bind(answers.iter().map(|(s, _)| s.summary.ratio).collect::<Vec<_>>())
            .bind(answers.iter().map(|(s, _)| s.summary.base_age_ms).collect::<Vec<_>>())
    }};
}

/// Writes batches within a transaction. The partitions of their days must exist.
pub(super) async fn write_postgres(
    transaction: &mut PgConnection,
    batches: &[&Batch],
    keys: &OriginKeys,
) -> Result<(), sqlx::Error> {
    let epochs = epoch_rows(batches, keys);
    if !epochs.is_empty() {
        insert_epoch_arrays(transaction, &epochs).await?;
    }
    let revisions = revision_rows(batches, keys);
    if !revisions.is_empty() {
        insert_revision_arrays(transaction, &revisions).await?;
    }
    write_raw_postgres(transaction, batches).await?;
    write_rollups_postgres(transaction, batches).await?;
    write_snapshots(transaction, batches).await?;
    write_changes(transaction, batches).await
}

async fn insert_epoch_arrays(
    connection: &mut PgConnection,
    rows: &[EpochRow<'_>],
) -> Result<(), sqlx::Error> {
    let base =
        |column: usize| rows.iter().map(|row| row.epoch.base_columns()[column]).collect::<Vec<_>>();
    let insert = sqlx::query(POSTGRES_EPOCHS)
        .bind(rows.iter().map(|row| row.session).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.day).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.epoch.seq).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.epoch.gps_time_ns).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.epoch.navigation).collect::<Vec<_>>())
        .bind(base(0))
        .bind(base(1))
        .bind(base(2))
        .bind(rows.iter().map(|row| &row.epoch.content[..]).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| &row.epoch.solution.content[..]).collect::<Vec<_>>());
    let answers: Vec<_> = rows.iter().map(|row| (&row.epoch.solution, row.origin)).collect();
    bind_answers!(insert, answers).execute(connection).await.map(drop)
}

async fn insert_revision_arrays(
    connection: &mut PgConnection,
    rows: &[RevisionRow<'_>],
) -> Result<(), sqlx::Error> {
    let insert = sqlx::query(POSTGRES_REVISIONS)
        .bind(rows.iter().map(|row| row.session).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.day).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.solution.seq).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.solution.revision).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| row.solution.gps_time_ns).collect::<Vec<_>>())
        .bind(rows.iter().map(|row| &row.solution.content[..]).collect::<Vec<_>>());
    let answers: Vec<_> = rows.iter().map(|row| (row.solution, row.origin)).collect();
    bind_answers!(insert, answers).execute(connection).await.map(drop)
}

/// Writes the states of sessions. Sessions that began together store their states within seconds
/// of each other, many in a transaction.
async fn write_snapshots(
    transaction: &mut PgConnection,
    batches: &[&Batch],
) -> Result<(), sqlx::Error> {
    let mut newest: BTreeMap<i64, &EncodedSnapshot> = BTreeMap::new();
    let mut kept = Vec::new();
    for batch in batches {
        let Some(snapshot) = &batch.snapshot else { continue };
        // A statement must not update a row twice.
        let stored = newest.entry(batch.session.0).or_insert(snapshot);
        if stored.seq <= snapshot.seq {
            *stored = snapshot;
        }
        if let Some(arrival) = batch.arrival.filter(|_| batch.keeps_snapshot) {
            kept.push((batch.session.0, arrival.day, snapshot));
        }
    }
    if !newest.is_empty() {
        sqlx::query(POSTGRES_SNAPSHOTS)
            .bind(newest.keys().copied().collect::<Vec<_>>())
            .bind(newest.values().map(|snapshot| snapshot.seq).collect::<Vec<_>>())
            .bind(newest.values().map(|s| &*s.configuration_hash).collect::<Vec<_>>())
            .bind(newest.values().map(|s| &s.content[..]).collect::<Vec<_>>())
            .bind(newest.values().map(|snapshot| snapshot.stored_day()).collect::<Vec<_>>())
            .execute(&mut *transaction)
            .await?;
    }
    if !kept.is_empty() {
        sqlx::query(POSTGRES_KEPT)
            .bind(kept.iter().map(|(session, ..)| *session).collect::<Vec<_>>())
            .bind(kept.iter().map(|(_, day, _)| *day).collect::<Vec<_>>())
            .bind(kept.iter().map(|(.., snapshot)| snapshot.seq).collect::<Vec<_>>())
            .bind(kept.iter().map(|(.., s)| &*s.configuration_hash).collect::<Vec<_>>())
            .bind(kept.iter().map(|(.., s)| &s.content[..]).collect::<Vec<_>>())
            .execute(transaction)
            .await?;
    }
    Ok(())
}

/// Writes the parts of batches that most batches do not have.
async fn write_changes(
    transaction: &mut PgConnection,
    batches: &[&Batch],
) -> Result<(), sqlx::Error> {
    for batch in batches {
        let session = batch.session.0;
        if let Some(arc) = &batch.arc {
            let insert = sqlx::query(INSERT_ARC).bind(session).bind(arc.after_seq as i64);
            insert.bind(arc.unix_ms).execute(&mut *transaction).await?;
            let date = sqlx::query(DATE_RAW).bind(session).bind(gps_time_ns(arc.unix_ms));
            date.bind(arc.unix_ms).execute(&mut *transaction).await?;
        }
        if let Some(unix_ms) = batch.closed_unix_ms {
            let close = sqlx::query(CLOSE).bind(session).bind(unix_ms);
            close.execute(&mut *transaction).await?;
            sqlx::query(FORGET_ALL_RAW).bind(session).execute(&mut *transaction).await?;
        }
        note!(timed transaction, batch.entry.as_deref());
    }
    Ok(())
}
