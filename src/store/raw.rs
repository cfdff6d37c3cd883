//! Raw bytes of receivers: the position up to which they are stored, and the bytes that restore
//! their streams.

use bytes::Bytes;

use crate::gnss::GpsTime;

use super::pool::reading;
use super::{SessionKey, Store, StoreError};

/// Position up to which a session's raw bytes are stored. Offsets count from the device's first
/// byte.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawPosition {
    /// Offset of the present stream's first byte.
    pub stream: u64,
    /// Offset of the end of its header; equal to `stream` if it has none.
    pub header_end: u64,
    /// The bytes from this offset on, together with the header, restore the stream.
    pub tail: u64,
    /// Offset of the next byte. All bytes before it are stored.
    pub through: u64,
    /// The newest known time.
    pub time: GpsTime,
    /// When the last chunk arrived (ms since 1970-01-01 UTC).
    pub received_unix_ms: i64,
    /// The last chunk.
    pub last_chunk: RawChunkSpan,
}

/// Extent of a chunk, and the epochs that it completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawChunkSpan {
    /// Offset of its first byte.
    pub start: u64,
    /// Whether it ended its stream.
    pub is_end: bool,
    /// Number of the first epoch that it completed.
    pub first_seq: u64,
    /// Number of the last epoch that it completed; below `first_seq` if it completed none.
    pub last_seq: u64,
}

/// A chunk to be stored, and the stream's position after it.
#[derive(Clone, Debug)]
pub struct RawChange {
    /// The stream's position after the chunk.
    pub position: RawPosition,
    /// The new bytes of the chunk. They end at `position.through`.
    pub content: Bytes,
}

impl RawChange {
    /// Offset of the first byte of the content.
    pub(super) fn start(&self) -> u64 {
        self.position.through - self.content.len() as u64
    }
}

#[derive(sqlx::FromRow)]
struct RawRow {
    stream: i64,
    header_end: i64,
    tail: i64,
    through: i64,
    gps_time_ns: i64,
    received_unix_ms: i64,
    piece: i64,
    piece_ends: i64,
    first_seq: i64,
    last_seq: i64,
}

impl Store {
    /// Position up to which a session's raw bytes are stored; `None` before the first byte.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn raw_position(
        &self,
        session: SessionKey,
    ) -> Result<Option<RawPosition>, StoreError> {
        let row: Result<Option<RawRow>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT * FROM raw_streams WHERE session = $1";
            sqlx::query_as(sql).bind(session.0).fetch_optional(pool).await
        });
        let row = row.map_err(StoreError::database("reading a session's stream"))?;
        Ok(row.map(|row| RawPosition {
            stream: row.stream as u64,
            header_end: row.header_end as u64,
            tail: row.tail as u64,
            through: row.through as u64,
            time: GpsTime::from_ns(row.gps_time_ns),
            received_unix_ms: row.received_unix_ms,
            last_chunk: RawChunkSpan {
                start: row.piece as u64,
                is_end: row.piece_ends != 0,
                first_seq: row.first_seq as u64,
                last_seq: row.last_seq as u64,
            },
        }))
    }

    /// A session's stored bytes from offset `start` to before `end`, in order, each part with its
    /// offset.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn raw_bytes(
        &self,
        session: SessionKey,
        start: u64,
        end: u64,
    ) -> Result<Vec<(u64, Vec<u8>)>, StoreError> {
        let rows: Result<Vec<(i64, Vec<u8>)>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT start, content FROM raw_pieces
                       WHERE session = $1 AND $2 < through AND start < $3 ORDER BY start";
            sqlx::query_as(sql)
                .bind(session.0)
                .bind(start as i64)
                .bind(end as i64)
                .fetch_all(pool)
                .await
        });
        let rows = rows.map_err(StoreError::database("reading a session's raw bytes"))?;
        let within = |(at, content): (i64, Vec<u8>)| {
            let at = at as u64;
            let within = |offset: u64| offset.saturating_sub(at).min(content.len() as u64) as usize;
            (at.max(start), content[within(start)..within(end)].to_vec())
        };
        Ok(rows.into_iter().map(within).collect())
    }
}
