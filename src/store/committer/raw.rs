//! Statements for raw bytes: on Postgres the chunks of many sessions in one statement.

use std::collections::BTreeMap;

use sqlx::PgConnection;

use crate::store::{RawChange, RawPosition};

use super::batch::Batch;

pub(super) const PIECE_COLUMNS: usize = 4;
pub(super) const STREAM_COLUMNS: usize = 11;
/// Interval of stream positions after which bytes that are no longer needed are deleted.
const FORGET_BYTES: u64 = 32 << 10;

pub(super) const INSERT_PIECES: &str = "INSERT INTO raw_pieces (session, start, through, content) ";
pub(super) const INSERT_STREAMS: &str = "INSERT INTO raw_streams \
    (session, stream, header_end, tail, through, gps_time_ns, received_unix_ms, piece, piece_ends, \
     first_seq, last_seq) ";
pub(super) const REPLACE_STREAMS: &str = " ON CONFLICT (session) DO UPDATE SET \
    stream = excluded.stream, header_end = excluded.header_end, tail = excluded.tail, \
    through = excluded.through, gps_time_ns = excluded.gps_time_ns, \
    received_unix_ms = excluded.received_unix_ms, piece = excluded.piece, \
    piece_ends = excluded.piece_ends, first_seq = excluded.first_seq, \
    last_seq = excluded.last_seq";
/// Deletes bytes that neither restore the stream nor belong to the last chunk.
pub(super) const FORGET: &str = "DELETE FROM raw_pieces WHERE session = $1 AND through <= $2 \
    AND (through <= $3 OR $4 <= start)";

/// The raw bytes of a transaction.
struct RawRows<'a> {
    /// Each chunk that has bytes, with its session.
    pieces: Vec<(i64, &'a RawChange)>,
    /// The last chunk of each session.
    streams: Vec<(i64, &'a RawPosition)>,
    /// The entries of `streams` of which bytes are to be deleted.
    forgetting: Vec<(i64, &'a RawPosition)>,
}

impl<'a> RawRows<'a> {
    fn of(batches: &[&'a Batch]) -> Self {
        let changes =
            batches.iter().filter_map(|batch| Some((batch.session.0, batch.raw.as_deref()?)));
        let changes: Vec<(i64, &RawChange)> = changes.collect();
        let has_bytes = |(_, raw): &&(i64, &RawChange)| !raw.content.is_empty();
        let pieces = changes.iter().filter(has_bytes).copied().collect();
        let position = |(session, raw): &(i64, &'a RawChange)| (*session, &raw.position);
        let streams: BTreeMap<i64, &RawPosition> = changes.iter().map(position).collect();
        let forgets = |(_, raw): &&(i64, &RawChange)| is_forgetting(raw);
        let forgetting: BTreeMap<i64, &RawPosition> =
            changes.iter().filter(forgets).map(position).collect();
        let (streams, forgetting) =
            (streams.into_iter().collect(), forgetting.into_iter().collect());
        Self { pieces, streams, forgetting }
    }
}

/// Whether bytes are deleted after this chunk: it passes a multiple of `FORGET_BYTES`, or ends its
/// stream.
pub(super) fn is_forgetting(raw: &RawChange) -> bool {
    let RawPosition { through, last_chunk, .. } = &raw.position;
    last_chunk.is_end || raw.start() / FORGET_BYTES != through / FORGET_BYTES
}

/// The columns of a stream's position that follow the session.
pub(super) fn columns(position: &RawPosition) -> [i64; STREAM_COLUMNS - 1] {
    let RawPosition { stream, header_end, tail, through, time, received_unix_ms, last_chunk } =
        position;
    [
        *stream as i64,
        *header_end as i64,
        *tail as i64,
        *through as i64,
        time.as_ns(),
        *received_unix_ms,
        last_chunk.start as i64,
        i64::from(last_chunk.is_end),
        last_chunk.first_seq as i64,
        last_chunk.last_seq as i64,
    ]
}

/// Writes the raw bytes of batches within a transaction.
pub(super) async fn write_raw_postgres(
    transaction: &mut PgConnection,
    batches: &[&Batch],
) -> Result<(), sqlx::Error> {
    let rows = RawRows::of(batches);
    if rows.streams.is_empty() {
        return Ok(());
    }
    let pieces = &rows.pieces;
    if !pieces.is_empty() {
        let sql = format!(
            "{INSERT_PIECES}SELECT * FROM UNNEST($1::bigint[], $2::bigint[], $3::bigint[], \
             $4::bytea[])"
        );
        sqlx::query(&sql)
            .bind(pieces.iter().map(|(session, _)| *session).collect::<Vec<_>>())
            .bind(pieces.iter().map(|(_, raw)| raw.start() as i64).collect::<Vec<_>>())
            .bind(pieces.iter().map(|(_, raw)| raw.position.through as i64).collect::<Vec<_>>())
            .bind(pieces.iter().map(|(_, raw)| &raw.content[..]).collect::<Vec<_>>())
            .execute(&mut *transaction)
            .await?;
    }
    let arrays: Vec<String> = (1..=STREAM_COLUMNS).map(|n| format!("${n}::bigint[]")).collect();
    let arrays = arrays.join(", ");
    let sql = format!("{INSERT_STREAMS}SELECT * FROM UNNEST({arrays}){REPLACE_STREAMS}");
    let sessions = rows.streams.iter().map(|(session, _)| *session).collect::<Vec<_>>();
    let mut upsert = sqlx::query(&sql).bind(sessions);
    let positions: Vec<_> = rows.streams.iter().map(|(_, position)| columns(position)).collect();
    for column in 0..STREAM_COLUMNS - 1 {
        upsert = upsert.bind(positions.iter().map(|row| row[column]).collect::<Vec<_>>());
    }
    upsert.execute(&mut *transaction).await?;
    for (session, position) in &rows.forgetting {
        sqlx::query(FORGET)
            .bind(session)
            .bind(position.tail.min(position.last_chunk.start) as i64)
            .bind(position.stream as i64)
            .bind(position.header_end as i64)
            .execute(&mut *transaction)
            .await?;
    }
    Ok(())
}
