//! Statements that insert many rows: lists of values for SQLite, arrays for Postgres.

use std::sync::LazyLock;

use sqlx::{PgConnection, SqliteConnection};

use crate::gnss::{GpsTime, LeapSeconds};
use crate::store::SessionKey;

use super::batch::{Batch, EncodedEpoch, EncodedSolution};
use super::origins::OriginKeys;
use super::raw::{write_raw_postgres, write_raw_sqlite};
use super::rows::{ROWS_PER_STATEMENT, with_values};

const EPOCH_COLUMNS: usize = 8;
const SOLUTION_COLUMNS: usize = 10;

const INSERT_EPOCHS: &str = "INSERT INTO epochs \
    (session, seq, gps_time_ns, navigation, base, base_after, base_through, content) ";
const INSERT_SOLUTIONS: &str = "INSERT INTO solutions \
    (session, seq, revision, gps_time_ns, status, x_m, y_m, z_m, origin, content) ";
/// The insert into `epochs` detects a repeated number; a stored revision is not replaced.
const ONCE: &str = " ON CONFLICT (session, seq, revision) DO NOTHING";
/// The newest state wins, in whatever order the writers come.
const UPSERT_SNAPSHOT: &str = "INSERT INTO snapshots (session, seq, configuration_hash, content) \
    VALUES ($1, $2, $3, $4) ON CONFLICT (session) DO UPDATE SET seq = excluded.seq, \
    configuration_hash = excluded.configuration_hash, content = excluded.content \
    WHERE snapshots.seq <= excluded.seq";
/// The first state of a day stays.
const KEEP_SNAPSHOT: &str = "INSERT INTO kept_snapshots \
    (session, day, seq, configuration_hash, content) VALUES ($1, $2, $3, $4, $5) \
    ON CONFLICT (session, day) DO NOTHING";
const INSERT_ARC: &str = "INSERT INTO session_arcs (session, after_seq, created_unix_ms) \
    VALUES ($1, $2, $3) ON CONFLICT (session, after_seq) DO NOTHING";
/// The stream's newest known time may be what made the new arc necessary.
const DATE_RAW: &str =
    "UPDATE raw_streams SET gps_time_ns = $2, received_unix_ms = $3 WHERE session = $1";
const CLOSE: &str =
    "UPDATE sessions SET closed_unix_ms = $2 WHERE key = $1 AND closed_unix_ms IS NULL";
const FORGET_ALL_RAW: &str = "DELETE FROM raw_pieces WHERE session = $1";

static EPOCH_VALUES: LazyLock<[String; ROWS_PER_STATEMENT.len()]> = LazyLock::new(|| {
    ROWS_PER_STATEMENT.map(|rows| with_values(INSERT_EPOCHS, EPOCH_COLUMNS, rows, ""))
});
static SOLUTION_VALUES: LazyLock<[String; ROWS_PER_STATEMENT.len()]> = LazyLock::new(|| {
    ROWS_PER_STATEMENT.map(|rows| with_values(INSERT_SOLUTIONS, SOLUTION_COLUMNS, rows, ONCE))
});

/// GPS time of the system clock's time (ms since 1970-01-01 UTC), in nanoseconds.
fn gps_time_ns(unix_ms: i64) -> i64 {
    GpsTime::from_unix_ms(unix_ms, &LeapSeconds::table()).as_ns()
}

type EpochRow<'a> = (SessionKey, &'a EncodedEpoch);
/// A solution with the key of its origin.
type SolutionRow<'a> = (SessionKey, &'a EncodedSolution, i64);

fn epoch_rows<'a>(batches: &[&'a Batch]) -> Vec<EpochRow<'a>> {
    let rows = |batch: &&'a Batch| {
        let batch: &'a Batch = batch;
        batch.epochs.iter().map(|epoch| (batch.session, epoch))
    };
    batches.iter().flat_map(rows).collect()
}

fn solution_rows<'a>(batches: &[&'a Batch], keys: &OriginKeys) -> Vec<SolutionRow<'a>> {
    let rows = |batch: &&'a Batch| {
        let batch: &'a Batch = batch;
        let first = batch.epochs.iter().map(|epoch| &epoch.solution);
        let solutions = first.chain(&batch.revisions);
        solutions.map(|solution| (batch.session, solution, keys.key(solution)))
    };
    batches.iter().flat_map(rows).collect()
}

/// Writes the parts of a batch that occur once.
macro_rules! write_changes {
    ($transaction:ident, $batches:expr) => {
        for batch in $batches {
            let session = batch.session.0;
            if let Some(snapshot) = &batch.snapshot {
                sqlx::query(UPSERT_SNAPSHOT)
                    .bind(session)
                    .bind(snapshot.seq)
                    .bind(&*snapshot.configuration_hash)
                    .bind(&snapshot.content[..])
                    .execute(&mut *$transaction)
                    .await?;
            }
            if let (Some(snapshot), Some(day)) = (&batch.snapshot, batch.snapshot_day) {
                sqlx::query(KEEP_SNAPSHOT)
                    .bind(session)
                    .bind(day)
                    .bind(snapshot.seq)
                    .bind(&*snapshot.configuration_hash)
                    .bind(&snapshot.content[..])
                    .execute(&mut *$transaction)
                    .await?;
            }
            if let Some(arc) = &batch.arc {
                let insert = sqlx::query(INSERT_ARC).bind(session).bind(arc.after_seq as i64);
                insert.bind(arc.unix_ms).execute(&mut *$transaction).await?;
                let date = sqlx::query(DATE_RAW).bind(session).bind(gps_time_ns(arc.unix_ms));
                date.bind(arc.unix_ms).execute(&mut *$transaction).await?;
            }
            if let Some(unix_ms) = batch.closed_unix_ms {
                let close = sqlx::query(CLOSE).bind(session).bind(unix_ms);
                close.execute(&mut *$transaction).await?;
                sqlx::query(FORGET_ALL_RAW).bind(session).execute(&mut *$transaction).await?;
            }
        }
    };
}
/// Writes batches within a transaction.
pub(super) async fn write_sqlite(
    transaction: &mut SqliteConnection,
    batches: &[&Batch],
    keys: &OriginKeys,
) -> Result<(), sqlx::Error> {
    let mut rest = &epoch_rows(batches)[..];
    for (index, size) in ROWS_PER_STATEMENT.into_iter().enumerate() {
        while let Some((chunk, after)) = rest.split_at_checked(size) {
            insert_epochs(transaction, index, chunk).await?;
            rest = after;
        }
    }
    let mut rest = &solution_rows(batches, keys)[..];
    for (index, size) in ROWS_PER_STATEMENT.into_iter().enumerate() {
        while let Some((chunk, after)) = rest.split_at_checked(size) {
            insert_solutions(transaction, index, chunk).await?;
            rest = after;
        }
    }
    write_raw_sqlite(transaction, batches).await?;
    write_changes!(transaction, batches);
    Ok(())
}

async fn insert_epochs(
    connection: &mut SqliteConnection,
    index: usize,
    rows: &[EpochRow<'_>],
) -> Result<(), sqlx::Error> {
    let mut epochs = sqlx::query(EPOCH_VALUES[index].as_str());
    for (session, row) in rows {
        let [base, base_after, base_through] = row.base_columns();
        epochs = epochs
            .bind(session.0)
            .bind(row.seq)
            .bind(row.gps_time_ns)
            .bind(row.navigation)
            .bind(base)
            .bind(base_after)
            .bind(base_through)
            .bind(&row.content[..]);
    }
    epochs.execute(connection).await.map(drop)
}

async fn insert_solutions(
    connection: &mut SqliteConnection,
    index: usize,
    rows: &[SolutionRow<'_>],
) -> Result<(), sqlx::Error> {
    let mut solutions = sqlx::query(SOLUTION_VALUES[index].as_str());
    for (session, row, origin) in rows {
        let [x_m, y_m, z_m] = row.position_m;
        solutions = solutions
            .bind(session.0)
            .bind(row.seq)
            .bind(row.revision)
            .bind(row.gps_time_ns)
            .bind(row.status)
            .bind(x_m)
            .bind(y_m)
            .bind(z_m)
            .bind(*origin)
            .bind(&row.content[..]);
    }
    solutions.execute(connection).await.map(drop)
}

/// Writes batches within a transaction.
pub(super) async fn write_postgres(
    transaction: &mut PgConnection,
    batches: &[&Batch],
    keys: &OriginKeys,
) -> Result<(), sqlx::Error> {
    insert_arrays(transaction, &epoch_rows(batches), &solution_rows(batches, keys)).await?;
    write_raw_postgres(transaction, batches).await?;
    write_changes!(transaction, batches);
    Ok(())
}

async fn insert_arrays(
    connection: &mut PgConnection,
    epochs: &[EpochRow<'_>],
    solutions: &[SolutionRow<'_>],
) -> Result<(), sqlx::Error> {
    let base = |column: usize| {
        epochs.iter().map(|(_, row)| row.base_columns()[column]).collect::<Vec<_>>()
    };
    sqlx::query(
        "INSERT INTO epochs
             (session, seq, gps_time_ns, navigation, base, base_after, base_through, content)
         SELECT * FROM UNNEST($1::bigint[], $2::bigint[], $3::bigint[], $4::bigint[],
                              $5::bigint[], $6::bigint[], $7::bigint[], $8::bytea[])",
    )
    .bind(epochs.iter().map(|(session, _)| session.0).collect::<Vec<_>>())
    .bind(epochs.iter().map(|(_, row)| row.seq).collect::<Vec<_>>())
    .bind(epochs.iter().map(|(_, row)| row.gps_time_ns).collect::<Vec<_>>())
    .bind(epochs.iter().map(|(_, row)| row.navigation).collect::<Vec<_>>())
    .bind(base(0))
    .bind(base(1))
    .bind(base(2))
    .bind(epochs.iter().map(|(_, row)| &row.content[..]).collect::<Vec<_>>())
    .execute(&mut *connection)
    .await?;
    let axis =
        |axis: usize| solutions.iter().map(|(_, r, _)| r.position_m[axis]).collect::<Vec<_>>();
    sqlx::query(
        "INSERT INTO solutions
             (session, seq, revision, gps_time_ns, status, x_m, y_m, z_m, origin, content)
         SELECT * FROM UNNEST($1::bigint[], $2::bigint[], $3::integer[], $4::bigint[],
                              $5::smallint[], $6::double precision[], $7::double precision[],
                              $8::double precision[], $9::bigint[], $10::bytea[])
         ON CONFLICT (session, seq, revision) DO NOTHING",
    )
    .bind(solutions.iter().map(|(session, ..)| session.0).collect::<Vec<_>>())
    .bind(solutions.iter().map(|(_, row, _)| row.seq).collect::<Vec<_>>())
    .bind(solutions.iter().map(|(_, row, _)| row.revision).collect::<Vec<_>>())
    .bind(solutions.iter().map(|(_, row, _)| row.gps_time_ns).collect::<Vec<_>>())
    .bind(solutions.iter().map(|(_, row, _)| row.status).collect::<Vec<_>>())
    .bind(axis(0))
    .bind(axis(1))
    .bind(axis(2))
    .bind(solutions.iter().map(|(.., origin)| *origin).collect::<Vec<_>>())
    .bind(solutions.iter().map(|(_, row, _)| &row.content[..]).collect::<Vec<_>>())
    .execute(connection)
    .await
    .map(drop)
}
