//! The head of a session: one row that each commit compares and sets.
//!
//! A batch is accepted if its session is open, the last number is the one that the batch
//! continues, and no service with a later lease has committed. A node of a cluster must also have
//! claimed the session. All batches of a transaction are compared in one statement (up to 128 of
//! them on SQLite).

use std::collections::BTreeSet;
use std::sync::LazyLock;

use sqlx::{PgConnection, SqliteConnection};

use super::batch::Batch;
use super::rows::ROWS_PER_STATEMENT;

/// Who commits.
#[derive(Clone, Debug, Default)]
pub(super) struct Owner {
    /// Name of the node; empty without a lease.
    pub(super) node: String,
    /// The number of its lease. Each lease has the next one.
    pub(super) fence: i64,
    /// Whether it commits only to sessions that it has claimed: they have its fence.
    pub(super) claims: bool,
}

/// What a batch compares, and what it sets; `None` leaves a value as it is.
struct Head {
    session: i64,
    previous: Option<i64>,
    last_seq: Option<i64>,
    last_gps_time_ns: Option<i64>,
    raw_through: Option<i64>,
    status: Option<i16>,
    position_m: [Option<f64>; 3],
    closed_unix_ms: Option<i64>,
    /// Length of the epochs and solutions that are added (bytes).
    added_bytes: i64,
}

const COLUMNS: usize = 11;

macro_rules! compare_and_set {
    ($owner:literal, $fence:literal, $may_write:literal, $rows:expr) => {
        concat!(
            "UPDATE session_heads SET owner = ",
            $owner,
            ", fence = ",
            $fence,
            ", ",
            "last_seq = COALESCE(b.last_seq, session_heads.last_seq), ",
            "last_gps_time_ns = COALESCE(b.last_gps_time_ns, session_heads.last_gps_time_ns), ",
            "raw_through = COALESCE(b.raw_through, session_heads.raw_through), ",
            "status = COALESCE(b.status, session_heads.status), ",
            "x_m = COALESCE(b.x_m, session_heads.x_m), ",
            "y_m = COALESCE(b.y_m, session_heads.y_m), ",
            "z_m = COALESCE(b.z_m, session_heads.z_m), ",
            "closed_unix_ms = b.closed_unix_ms, ",
            "stored_bytes = session_heads.stored_bytes + b.added_bytes FROM (",
            $rows,
            ") AS b WHERE session_heads.session = b.session ",
            "AND session_heads.last_seq IS NOT DISTINCT FROM b.previous ",
            "AND session_heads.closed_unix_ms IS NULL AND session_heads.fence ",
            $may_write,
            " ",
            $fence,
            " RETURNING session_heads.session"
        )
    };
}
macro_rules! arrays {
    () => {
        "SELECT * FROM UNNEST($3::bigint[], $4::bigint[], $5::bigint[], $6::bigint[], \
         $7::bigint[], $8::smallint[], $9::double precision[], $10::double precision[], \
         $11::double precision[], $12::bigint[], $13::bigint[]) AS u(session, previous, \
         last_seq, last_gps_time_ns, raw_through, status, x_m, y_m, z_m, closed_unix_ms, \
         added_bytes)"
    };
}
const POSTGRES: &str = compare_and_set!("$1", "$2", "<=", arrays!());
/// The same of sessions that the owner has claimed.
const POSTGRES_CLAIMED: &str = compare_and_set!("$1", "$2", "=", arrays!());
const SQLITE: &str = compare_and_set!(
    "?",
    "?",
    "<=",
    "SELECT column1 AS session, column2 AS previous, column3 AS last_seq, \
     column4 AS last_gps_time_ns, column5 AS raw_through, column6 AS status, column7 AS x_m, \
     column8 AS y_m, column9 AS z_m, column10 AS closed_unix_ms, column11 AS added_bytes \
     FROM (VALUES {rows})"
);

static SQLITE_VALUES: LazyLock<[String; ROWS_PER_STATEMENT.len()]> = LazyLock::new(|| {
    let row = format!("({})", ["?"; COLUMNS].join(","));
    ROWS_PER_STATEMENT.map(|rows| SQLITE.replace("{rows}", &vec![row.clone(); rows].join(",")))
});

impl Head {
    fn of(batch: &Batch) -> Self {
        let last = batch.epochs.last();
        let mut solutions = batch.epochs.iter().rev().map(|epoch| &epoch.solution);
        let position = solutions.find(|solution| solution.position_m[0].is_some());
        Self {
            session: batch.session.0,
            previous: batch.previous.map(|seq| seq as i64),
            last_seq: last.map(|epoch| epoch.seq),
            last_gps_time_ns: last.map(|epoch| epoch.gps_time_ns),
            raw_through: batch.raw.as_ref().map(|raw| raw.position.through as i64),
            status: last.map(|epoch| epoch.solution.status),
            position_m: position.map_or([None; 3], |solution| solution.position_m),
            closed_unix_ms: batch.closed_unix_ms,
            added_bytes: batch.added_bytes() as i64,
        }
    }
}

/// Those of the batches that continue their sessions. Their heads are set.
pub(super) async fn accepted_sqlite<'a>(
    connection: &mut SqliteConnection,
    batches: &[&'a Batch],
    owner: &Owner,
) -> Result<Vec<&'a Batch>, sqlx::Error> {
    let mut accepted = Vec::with_capacity(batches.len());
    for round in rounds(batches) {
        let mut rest = &round[..];
        for (index, size) in ROWS_PER_STATEMENT.into_iter().enumerate() {
            while let Some((chunk, after)) = rest.split_at_checked(size) {
                let sql = SQLITE_VALUES[index].as_str();
                let mut update = sqlx::query_scalar(sql).bind(&owner.node).bind(owner.fence);
                for head in chunk.iter().map(|batch| Head::of(batch)) {
                    let [x_m, y_m, z_m] = head.position_m;
                    update = update
                        .bind(head.session)
                        .bind(head.previous)
                        .bind(head.last_seq)
                        .bind(head.last_gps_time_ns)
                        .bind(head.raw_through)
                        .bind(head.status)
                        .bind(x_m)
                        .bind(y_m)
                        .bind(z_m)
                        .bind(head.closed_unix_ms)
                        .bind(head.added_bytes);
                }
                let update = update.bind(owner.fence);
                let set: Vec<i64> = update.fetch_all(&mut *connection).await?;
                accepted.extend(chunk.iter().filter(|batch| set.contains(&batch.session.0)));
                rest = after;
            }
        }
    }
    Ok(accepted)
}

/// The same on Postgres.
pub(super) async fn accepted_postgres<'a>(
    connection: &mut PgConnection,
    batches: &[&'a Batch],
    owner: &Owner,
) -> Result<Vec<&'a Batch>, sqlx::Error> {
    let mut accepted = Vec::with_capacity(batches.len());
    for round in rounds(batches) {
        let heads: Vec<Head> = round.iter().map(|batch| Head::of(batch)).collect();
        let numbers = |of: fn(&Head) -> Option<i64>| heads.iter().map(of).collect::<Vec<_>>();
        let axis = |axis: usize| heads.iter().map(|h| h.position_m[axis]).collect::<Vec<_>>();
        let sql = if owner.claims { POSTGRES_CLAIMED } else { POSTGRES };
        let set: Vec<i64> = sqlx::query_scalar(sql)
            .bind(&owner.node)
            .bind(owner.fence)
            .bind(heads.iter().map(|head| head.session).collect::<Vec<_>>())
            .bind(numbers(|head| head.previous))
            .bind(numbers(|head| head.last_seq))
            .bind(numbers(|head| head.last_gps_time_ns))
            .bind(numbers(|head| head.raw_through))
            .bind(heads.iter().map(|head| head.status).collect::<Vec<_>>())
            .bind(axis(0))
            .bind(axis(1))
            .bind(axis(2))
            .bind(numbers(|head| head.closed_unix_ms))
            .bind(heads.iter().map(|head| head.added_bytes).collect::<Vec<_>>())
            .fetch_all(&mut *connection)
            .await?;
        let set: BTreeSet<i64> = set.into_iter().collect();
        accepted.extend(round.into_iter().filter(|batch| set.contains(&batch.session.0)));
    }
    Ok(accepted)
}

/// The batches in rounds, each with a session once. There is one round, unless several writers
/// share a session.
fn rounds<'a>(batches: &[&'a Batch]) -> Vec<Vec<&'a Batch>> {
    let mut rounds: Vec<(BTreeSet<i64>, Vec<&'a Batch>)> = Vec::new();
    for batch in batches {
        let is_free =
            |(sessions, _): &&mut (BTreeSet<i64>, _)| !sessions.contains(&batch.session.0);
        match rounds.iter_mut().find(is_free) {
            Some((sessions, round)) => {
                sessions.insert(batch.session.0);
                round.push(batch);
            }
            None => rounds.push((BTreeSet::from([batch.session.0]), vec![batch])),
        }
    }
    rounds.into_iter().map(|(_, round)| round).collect()
}
