//! The statements that insert many rows at once: lists of values on SQLite, arrays on Postgres.

use std::sync::LazyLock;

use sqlx::{PgPool, SqliteConnection, SqlitePool};

use super::{EncodedEpoch, SessionKey};

/// Rows per statement: few texts, each prepared once, and no more than 32 766 parameters.
const ROWS_PER_STATEMENT: [usize; 4] = [128, 32, 8, 1];
const EPOCH_COLUMNS: usize = 4;
const SOLUTION_COLUMNS: usize = 9;

const INSERT_EPOCHS: &str = "INSERT INTO epochs (session, seq, gps_time_ns, content) ";
const INSERT_SOLUTIONS: &str = "INSERT INTO solutions \
    (session, seq, revision, gps_time_ns, status, x_m, y_m, z_m, content) ";

static EPOCH_VALUES: LazyLock<[String; 4]> = LazyLock::new(|| {
    ROWS_PER_STATEMENT.map(|rows| with_values(INSERT_EPOCHS, EPOCH_COLUMNS, rows))
});
static SOLUTION_VALUES: LazyLock<[String; 4]> = LazyLock::new(|| {
    ROWS_PER_STATEMENT.map(|rows| with_values(INSERT_SOLUTIONS, SOLUTION_COLUMNS, rows))
});

fn with_values(insert: &str, columns: usize, rows: usize) -> String {
    let row = format!("({})", vec!["?"; columns].join(","));
    format!("{insert} VALUES {}", vec![row; rows].join(","))
}

type Row<'a> = (SessionKey, &'a EncodedEpoch);

/// Inserts all rows in one transaction.
pub(super) async fn write_sqlite(pool: &SqlitePool, rows: &[Row<'_>]) -> Result<(), sqlx::Error> {
    let mut transaction = pool.begin_with("BEGIN IMMEDIATE").await?;
    let mut rest = rows;
    for (place, size) in ROWS_PER_STATEMENT.into_iter().enumerate() {
        while let Some((chunk, after)) = rest.split_at_checked(size) {
            insert_values(&mut transaction, place, chunk).await?;
            rest = after;
        }
    }
    transaction.commit().await
}

async fn insert_values(
    connection: &mut SqliteConnection,
    place: usize,
    rows: &[Row<'_>],
) -> Result<(), sqlx::Error> {
    let mut epochs = sqlx::query(EPOCH_VALUES[place].as_str());
    let mut solutions = sqlx::query(SOLUTION_VALUES[place].as_str());
    for (session, row) in rows {
        let [x_m, y_m, z_m] = row.position_m;
        epochs = epochs.bind(session.0).bind(row.seq).bind(row.gps_time_ns).bind(&row.content[..]);
        solutions = solutions
            .bind(session.0)
            .bind(row.seq)
            .bind(0_i32)
            .bind(row.gps_time_ns)
            .bind(row.status)
            .bind(x_m)
            .bind(y_m)
            .bind(z_m)
            .bind(&row.solution[..]);
    }
    epochs.execute(&mut *connection).await?;
    solutions.execute(connection).await?;
    Ok(())
}

/// Inserts all rows in one transaction.
pub(super) async fn write_postgres(pool: &PgPool, rows: &[Row<'_>]) -> Result<(), sqlx::Error> {
    let sessions: Vec<i64> = rows.iter().map(|(session, _)| session.0).collect();
    let seqs: Vec<i64> = rows.iter().map(|(_, row)| row.seq).collect();
    let times: Vec<i64> = rows.iter().map(|(_, row)| row.gps_time_ns).collect();
    let axis = |axis: usize| rows.iter().map(|(_, row)| row.position_m[axis]).collect::<Vec<_>>();
    let mut transaction = pool.begin().await?;
    sqlx::query(
        "INSERT INTO epochs (session, seq, gps_time_ns, content)
         SELECT * FROM UNNEST($1::bigint[], $2::bigint[], $3::bigint[], $4::bytea[])",
    )
    .bind(&sessions)
    .bind(&seqs)
    .bind(&times)
    .bind(rows.iter().map(|(_, row)| &row.content[..]).collect::<Vec<_>>())
    .execute(&mut *transaction)
    .await?;
    sqlx::query(
        "INSERT INTO solutions (session, seq, revision, gps_time_ns, status, x_m, y_m, z_m, content)
         SELECT session, seq, 0, gps_time_ns, status, x_m, y_m, z_m, content
         FROM UNNEST($1::bigint[], $2::bigint[], $3::bigint[], $4::smallint[],
                     $5::double precision[], $6::double precision[], $7::double precision[],
                     $8::bytea[])
              AS rows (session, seq, gps_time_ns, status, x_m, y_m, z_m, content)",
    )
    .bind(&sessions)
    .bind(&seqs)
    .bind(&times)
    .bind(rows.iter().map(|(_, row)| row.status).collect::<Vec<_>>())
    .bind(axis(0))
    .bind(axis(1))
    .bind(axis(2))
    .bind(rows.iter().map(|(_, row)| &row.solution[..]).collect::<Vec<_>>())
    .execute(&mut *transaction)
    .await?;
    transaction.commit().await
}
