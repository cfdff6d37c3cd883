//! The statements of a transaction on SQLite. Those that every batch needs are prepared once.

use std::sync::Arc;

use rusqlite::{
    CachedStatement, Connection, ErrorCode, OptionalExtension, Statement, Transaction,
    TransactionBehavior, ffi,
};

use crate::store::audit;
use crate::store::committer::batch::{Batch, EncodedEpoch, EncodedSnapshot, EncodedSolution};
use crate::store::committer::heads::{Head, Owner, SQLITE as COMPARE_AND_SET};
use crate::store::committer::lease_row::{NEXT_FENCE, OWNER, PROBE};
use crate::store::committer::origins::{self, OriginKeys, Origins};
use crate::store::committer::raw::{self, columns, is_forgetting};
use crate::store::committer::statements::{
    CLOSE, DATE_RAW, EPOCH_COLUMNS, FORGET_ALL_RAW, INSERT_ARC, INSERT_EPOCHS, INSERT_REVISIONS,
    KEEP_SNAPSHOT, ONCE, REVISION_COLUMNS, UPSERT_SNAPSHOT, gps_time_ns,
};
use crate::store::{ArcStart, AuditEntry, RawChange, RawPosition};

use super::binding::{Binding, by_number, with_values};
use super::rollups::Rollups;

/// A connection with its prepared statements and its caches.
pub(super) struct Writer<'c> {
    connection: &'c Connection,
    head: Statement<'c>,
    epoch: Statement<'c>,
    revision: Statement<'c>,
    piece: Statement<'c>,
    stream: Statement<'c>,
    forget: Statement<'c>,
    rollups: Rollups<'c>,
    origins: Origins,
}

impl<'c> Writer<'c> {
    /// Prepares the statements.
    pub(super) fn new(connection: &'c Connection) -> rusqlite::Result<Self> {
        let prepare = |insert: &str, columns: usize, conflict: &str| {
            connection.prepare(&with_values(insert, columns, conflict))
        };
        Ok(Self {
            connection,
            head: connection.prepare(COMPARE_AND_SET)?,
            epoch: prepare(INSERT_EPOCHS, EPOCH_COLUMNS, "")?,
            revision: prepare(INSERT_REVISIONS, REVISION_COLUMNS, ONCE)?,
            piece: prepare(raw::INSERT_PIECES, raw::PIECE_COLUMNS, "")?,
            stream: prepare(raw::INSERT_STREAMS, raw::STREAM_COLUMNS, raw::REPLACE_STREAMS)?,
            forget: connection.prepare(&by_number(raw::FORGET))?,
            rollups: Rollups::new(connection)?,
            origins: Origins::default(),
        })
    }

    /// Writes batches in one transaction, and returns the indices of those that it left out. It
    /// calls `may_commit` last, and commits only if that returns `true`.
    pub(super) fn write(
        &mut self,
        batches: &[Arc<Batch>],
        owner: &Owner,
        may_commit: impl FnOnce() -> bool,
    ) -> rusqlite::Result<Vec<usize>> {
        let transaction = immediate(self.connection)?;
        let (mut accepted, mut left_out) = (Vec::with_capacity(batches.len()), Vec::new());
        for (index, batch) in batches.iter().enumerate() {
            match self.sets_head(batch, owner)? {
                true => accepted.push(&**batch),
                false => left_out.push(index),
            }
        }
        let keys = self.origin_keys(&accepted)?;
        for batch in &accepted {
            for epoch in &batch.epochs {
                self.insert_epoch(batch.session.0, epoch, &keys)?;
            }
        }
        for batch in &accepted {
            for revision in &batch.revisions {
                self.insert_revision(batch.session.0, revision, &keys)?;
            }
        }
        for (session, raw) in accepted.iter().filter_map(|b| Some((b.session.0, b.raw.as_ref()?))) {
            self.write_raw(session, raw)?;
        }
        self.rollups.write(self.connection, &accepted)?;
        for batch in &accepted {
            self.write_changes(batch)?;
        }
        if !may_commit() {
            return Err(abandoned());
        }
        transaction.commit()?;
        self.origins.learn(keys);
        Ok(left_out)
    }

    /// Takes and releases the write lock; with `writes` it also changes a row and commits.
    pub(super) fn probe(&mut self, writes: bool) -> rusqlite::Result<()> {
        let transaction = immediate(self.connection)?;
        if writes {
            transaction.execute(PROBE, ())?;
        }
        transaction.commit()
    }

    /// The node that has the lease or had it last, and the number of its lease.
    pub(super) fn owner(&self) -> rusqlite::Result<(String, i64)> {
        self.connection.query_row(OWNER, (), |row| Ok((row.get(0)?, row.get(1)?)))
    }

    /// Gives the lease its next number, for this node.
    pub(super) fn next_fence(&self, node: &str) -> rusqlite::Result<i64> {
        self.connection.query_row(NEXT_FENCE, [node], |row| row.get(0))
    }

    /// The mode of the journal, and how much is written to the disk before a commit returns.
    pub(super) fn settings(&self) -> rusqlite::Result<(String, i64)> {
        let read = self.connection;
        let mode = read.pragma_query_value(None, "journal_mode", |row| row.get(0))?;
        Ok((mode, read.pragma_query_value(None, "synchronous", |row| row.get(0))?))
    }

    /// Sets the head of a session if the batch continues it. Returns whether it does.
    fn sets_head(&mut self, batch: &Batch, owner: &Owner) -> rusqlite::Result<bool> {
        let head = Head::of(batch);
        let set = Binding::of(&mut self.head)
            .bind(&owner.node)?
            .bind(owner.fence)?
            .bind(head.last_seq)?
            .bind(head.last_gps_time_ns)?
            .bind(head.raw_through)?
            .bind(head.status)?
            .bind_all(head.position_m)?
            .bind(head.closed_unix_ms)?
            .bind(head.added_bytes)?
            .bind(head.session)?
            .bind(head.previous)?
            .execute()?;
        Ok(set == 1)
    }

    /// The keys of all origins of these batches. Stores new ones.
    fn origin_keys(&self, batches: &[&Batch]) -> rusqlite::Result<OriginKeys> {
        let (mut keys, unknown) = self.origins.of(batches);
        for origin in unknown {
            let named = (&*origin.0, &*origin.1);
            let key = |sql: &str| self.connection.query_row(sql, named, |row| row.get(0));
            let found: Option<i32> = key(origins::FIND).optional()?;
            let key = found.map_or_else(|| key(origins::INSERT), Ok)?;
            keys.insert(origin, key);
        }
        Ok(keys)
    }

    fn insert_epoch(
        &mut self,
        session: i64,
        epoch: &EncodedEpoch,
        keys: &OriginKeys,
    ) -> rusqlite::Result<()> {
        let insert = Binding::of(&mut self.epoch)
            .bind(session)?
            .bind(epoch.seq)?
            .bind(epoch.gps_time_ns)?
            .bind(epoch.navigation)?
            .bind_all(epoch.base_columns())?
            .bind(&epoch.content[..])?
            .bind(&epoch.solution.content[..])?;
        answered(insert, &epoch.solution, keys)?.execute().map(drop)
    }

    fn insert_revision(
        &mut self,
        session: i64,
        solution: &EncodedSolution,
        keys: &OriginKeys,
    ) -> rusqlite::Result<()> {
        let insert = Binding::of(&mut self.revision)
            .bind(session)?
            .bind(solution.seq)?
            .bind(solution.revision)?
            .bind(solution.gps_time_ns)?
            .bind(&solution.content[..])?;
        answered(insert, solution, keys)?.execute().map(drop)
    }

    /// Writes a chunk of raw bytes and the position of its stream.
    fn write_raw(&mut self, session: i64, raw: &RawChange) -> rusqlite::Result<()> {
        let position = &raw.position;
        if !raw.content.is_empty() {
            Binding::of(&mut self.piece)
                .bind(session)?
                .bind(raw.start() as i64)?
                .bind(position.through as i64)?
                .bind(&raw.content[..])?
                .execute()?;
        }
        Binding::of(&mut self.stream).bind(session)?.bind_all(columns(position))?.execute()?;
        if is_forgetting(raw) {
            self.forget_raw(session, position)?;
        }
        Ok(())
    }

    /// Deletes what a stream no longer needs.
    fn forget_raw(&mut self, session: i64, position: &RawPosition) -> rusqlite::Result<()> {
        let unneeded = position.tail.min(position.last_chunk.start);
        Binding::of(&mut self.forget)
            .bind(session)?
            .bind_all([unneeded, position.stream, position.header_end].map(|offset| offset as i64))?
            .execute()
            .map(drop)
    }

    /// A statement that few batches need, prepared at its first use.
    fn prepared(&self, sql: &str) -> rusqlite::Result<CachedStatement<'c>> {
        self.connection.prepare_cached(&by_number(sql))
    }

    /// Writes the parts of a batch that few batches have.
    fn write_changes(&self, batch: &Batch) -> rusqlite::Result<()> {
        let session = batch.session.0;
        if let Some(snapshot) = &batch.snapshot {
            let kept_on = batch.arrival.filter(|_| batch.keeps_snapshot).map(|arrival| arrival.day);
            self.write_snapshot(session, snapshot, kept_on)?;
        }
        if let Some(arc) = &batch.arc {
            self.begin_arc(session, arc)?;
        }
        if let Some(unix_ms) = batch.closed_unix_ms {
            self.prepared(CLOSE)?.execute((session, unix_ms))?;
            self.prepared(FORGET_ALL_RAW)?.execute([session])?;
        }
        batch.entry.as_deref().map_or(Ok(()), |entry| self.note(entry))
    }

    fn write_snapshot(
        &self,
        session: i64,
        snapshot: &EncodedSnapshot,
        kept_on: Option<i64>,
    ) -> rusqlite::Result<()> {
        let EncodedSnapshot { seq, configuration_hash: hash, content, .. } = snapshot;
        let row = (session, seq, &**hash, content, snapshot.stored_day());
        self.prepared(UPSERT_SNAPSHOT)?.execute(row)?;
        if let Some(day) = kept_on {
            let row = (session, day, seq, &**hash, content);
            self.prepared(KEEP_SNAPSHOT)?.execute(row)?;
        }
        Ok(())
    }

    fn begin_arc(&self, session: i64, arc: &ArcStart) -> rusqlite::Result<()> {
        let row = (session, arc.after_seq as i64, arc.unix_ms);
        self.prepared(INSERT_ARC)?.execute(row)?;
        let date = (session, gps_time_ns(arc.unix_ms), arc.unix_ms);
        self.prepared(DATE_RAW)?.execute(date).map(drop)
    }

    /// Writes an entry of the audit log.
    fn note(&self, entry: &AuditEntry) -> rusqlite::Result<()> {
        Binding::of(&mut *self.prepared(audit::INSERT)?)
            .bind(&entry.id)?
            .bind(entry.unix_ms)?
            .bind(entry.tenant.name())?
            .bind(&entry.author.actor)?
            .bind(entry.author.tenant.name())?
            .bind(&entry.call)?
            .bind(&entry.object)?
            .bind(&entry.outcome)?
            .bind(&entry.author.request)?
            .bind(&entry.author.node)?
            .bind(&entry.change)?
            .execute()
            .map(drop)
    }
}

/// A transaction with the write lock. It is rolled back unless it is committed.
fn immediate(connection: &Connection) -> rusqlite::Result<Transaction<'_>> {
    Transaction::new_unchecked(connection, TransactionBehavior::Immediate)
}

/// Binds the columns of an answer, which are the last ones.
fn answered<'s, 'c>(
    insert: Binding<'s, 'c>,
    solution: &EncodedSolution,
    keys: &OriginKeys,
) -> rusqlite::Result<Binding<'s, 'c>> {
    insert
        .bind(keys.key(solution))?
        .bind(solution.status)?
        .bind_all(solution.position_m)?
        .bind_all(solution.summary.sigma_mm)?
        .bind(solution.summary.ratio)?
        .bind(solution.summary.base_age_ms)
}

/// The failure of a transaction whose caller no longer waits.
fn abandoned() -> rusqlite::Error {
    let failure = ffi::Error { code: ErrorCode::OperationInterrupted, extended_code: 0 };
    rusqlite::Error::SqliteFailure(failure, Some("the deadline has passed".to_owned()))
}
