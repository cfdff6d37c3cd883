//! The head of a session: one row that each commit compares and sets.
//!
//! A batch is accepted if its session is open, the batch continues the last number, and no service
//! with a later lease has committed. A node of a cluster must also have claimed the session. On
//! Postgres one statement compares all batches of a transaction; on SQLite each batch has its own.

use std::collections::BTreeSet;

use sqlx::PgConnection;

use super::batch::Batch;

/// The service that commits.
#[derive(Clone, Debug, Default)]
pub(super) struct Owner {
    /// Name of the node; empty without a lease.
    pub(super) node: String,
    /// The fence, which is the number of its lease. Each lease has the next number.
    pub(super) fence: i64,
    /// Whether it is a node of a cluster. Such a node commits only to sessions with its own fence,
    /// which it sets when it claims them.
    pub(super) claims: bool,
}

/// The values that a batch compares and sets; `None` leaves a value as it is.
pub(super) struct Head {
    pub(super) session: i64,
    pub(super) previous: Option<i64>,
    pub(super) last_seq: Option<i64>,
    pub(super) last_gps_time_ns: Option<i64>,
    pub(super) raw_through: Option<i64>,
    pub(super) status: Option<i16>,
    pub(super) position_m: [Option<f64>; 3],
    pub(super) closed_unix_ms: Option<i64>,
    /// Length of the epochs and solutions that are added (bytes).
    pub(super) added_bytes: i64,
}

macro_rules! compare_and_set {
    ($may_write:literal) => {
        concat!(
            "UPDATE session_heads SET owner = $1, fence = $2, \
             last_seq = COALESCE(b.last_seq, session_heads.last_seq), \
             last_gps_time_ns = COALESCE(b.last_gps_time_ns, session_heads.last_gps_time_ns), \
             raw_through = COALESCE(b.raw_through, session_heads.raw_through), \
             status = COALESCE(b.status, session_heads.status), \
             x_m = COALESCE(b.x_m, session_heads.x_m), \
             y_m = COALESCE(b.y_m, session_heads.y_m), \
             z_m = COALESCE(b.z_m, session_heads.z_m), \
             closed_unix_ms = b.closed_unix_ms, \
             stored_bytes = session_heads.stored_bytes + b.added_bytes \
             FROM (SELECT * FROM UNNEST($3::bigint[], $4::bigint[], $5::bigint[], $6::bigint[], \
             $7::bigint[], $8::smallint[], $9::double precision[], $10::double precision[], \
             $11::double precision[], $12::bigint[], $13::bigint[]) AS u(session, previous, \
             last_seq, last_gps_time_ns, raw_through, status, x_m, y_m, z_m, closed_unix_ms, \
             added_bytes)) AS b WHERE session_heads.session = b.session \
             AND session_heads.last_seq IS NOT DISTINCT FROM b.previous \
             AND session_heads.closed_unix_ms IS NULL AND session_heads.fence ",
            $may_write,
            " $2 RETURNING session_heads.session"
        )
    };
}
const POSTGRES: &str = compare_and_set!("<=");
/// The statement of a node of a cluster, for sessions that it has claimed.
const POSTGRES_CLAIMED: &str = compare_and_set!("=");
/// The statement for one session on SQLite.
pub(super) const SQLITE: &str = "UPDATE session_heads SET owner = ?1, fence = ?2, \
    last_seq = COALESCE(?3, last_seq), last_gps_time_ns = COALESCE(?4, last_gps_time_ns), \
    raw_through = COALESCE(?5, raw_through), status = COALESCE(?6, status), \
    x_m = COALESCE(?7, x_m), y_m = COALESCE(?8, y_m), z_m = COALESCE(?9, z_m), \
    closed_unix_ms = ?10, stored_bytes = stored_bytes + ?11 \
    WHERE session = ?12 AND last_seq IS ?13 AND closed_unix_ms IS NULL AND fence <= ?2";

impl Head {
    pub(super) fn of(batch: &Batch) -> Self {
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

/// Sets the heads of the batches that continue their sessions, and returns these batches.
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

/// The batches in rounds, in which each session occurs at most once. There is one round, unless
/// several writers share a session.
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
