//! Raw bytes of sessions' receivers: how far they are stored, and what restores their streams.

use bytes::Bytes;

use crate::gnss::GpsTime;

use super::pool::reading;
use super::{SessionKey, Store, StoreError};

/// How far the raw bytes of a session are stored; offsets count from the device's first byte.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawPosition {
    /// First byte of the stream in force.
    pub stream: u64,
    /// End of its header; where it has none, its first byte.
    pub header_end: u64,
    /// The bytes from here on, and those of the header, restore the stream.
    pub tail: u64,
    /// The byte that comes next: all before it are stored.
    pub through: u64,
    /// The newest time known.
    pub time: GpsTime,
    /// When the last piece came (ms since 1970-01-01 UTC).
    pub received_unix_ms: i64,
    /// The last piece.
    pub piece: RawPiecePlace,
}

/// A piece, and the epochs that it completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawPiecePlace {
    /// Its first byte.
    pub start: u64,
    /// Whether it ended its stream.
    pub is_end: bool,
    /// Number of the first epoch that it completed …
    pub first_seq: u64,
    /// … and of the last; below the first where there is none.
    pub last_seq: u64,
}

/// A piece to be stored, and how far that brings the stream.
#[derive(Clone, Debug)]
pub struct RawChange {
    /// The stream after it.
    pub position: RawPosition,
    /// Its bytes that are new; they end at `position.through`.
    pub content: Bytes,
}

impl RawChange {
    /// First byte of the content.
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
    /// How far the raw bytes of a session are stored; `None` before the first.
    ///
    /// # Errors
    /// The database fails.
    pub async fn raw_position(
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
            piece: RawPiecePlace {
                start: row.piece as u64,
                is_end: row.piece_ends != 0,
                first_seq: row.first_seq as u64,
                last_seq: row.last_seq as u64,
            },
        }))
    }

    /// What is kept of a session's bytes from `start` to before `end`, in order, each run with its
    /// first byte.
    ///
    /// # Errors
    /// The database fails.
    pub async fn raw_bytes(
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
            let place = |offset: u64| offset.saturating_sub(at).min(content.len() as u64) as usize;
            (at.max(start), content[place(start)..place(end)].to_vec())
        };
        Ok(rows.into_iter().map(within).collect())
    }
}
