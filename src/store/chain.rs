//! Chains of epochs, each stored relative to the one before it.

use crate::gnss::Epoch;

use super::codec::{CodecError, decode_epoch, decode_relative_epoch, distances};
use super::pool::reading;
use super::{SessionKey, Store, StoreError};

/// Epochs in a chain. To read its last epoch, all of them are decoded. A later version may raise
/// this number, but must not lower it.
pub(super) const CHAIN: usize = 16;

/// Decodes epochs of a session in order of their numbers. It reads the earlier epochs of a chain
/// from the store where they are needed.
pub(super) struct Chain<'a> {
    store: &'a Store,
    session: SessionKey,
    /// The last decoded epoch with its number.
    last: Option<(u64, Epoch)>,
}

impl<'a> Chain<'a> {
    pub(super) const fn of(store: &'a Store, session: SessionKey) -> Self {
        Self { store, session, last: None }
    }

    /// Decodes the stored epoch `seq`.
    pub(super) async fn decode(&mut self, seq: u64, content: &[u8]) -> Result<Epoch, StoreError> {
        let is_near = self.has_reference_of(seq, content).map_err(corrupt)?;
        if !is_near {
            for (seq, content) in self.before(seq, content).await? {
                self.step(seq as u64, &content).map_err(corrupt)?;
            }
        }
        self.step(seq, content).cloned().map_err(corrupt)
    }

    /// Whether the last decoded epoch suffices to decode this one.
    fn has_reference_of(&self, seq: u64, content: &[u8]) -> Result<bool, CodecError> {
        let Some(distances) = distances(content)? else { return Ok(true) };
        let last = self.last.as_ref().map(|(last, _)| *last);
        Ok(last.is_some() && last == seq.checked_sub(distances.reference))
    }

    /// Decodes an epoch that is whole or relative to the last one.
    fn step(&mut self, seq: u64, content: &[u8]) -> Result<&Epoch, CodecError> {
        let is_after_last = self.has_reference_of(seq, content)?;
        let epoch = match (distances(content)?, &self.last) {
            (None, _) => decode_epoch(content)?,
            (Some(_), Some((_, last))) if is_after_last => decode_relative_epoch(content, last)?,
            (Some(_), _) => return Err(CodecError::ReferenceMissing),
        };
        Ok(&self.last.insert((seq, epoch)).1)
    }

    /// The epochs before `seq` that belong to its chain.
    async fn before(&self, seq: u64, content: &[u8]) -> Result<Vec<(i64, Vec<u8>)>, StoreError> {
        let distances = distances(content).map_err(corrupt)?;
        let distance = distances.map_or(0, |distances| distances.first);
        let first = seq.checked_sub(distance).ok_or(corrupt(CodecError::ReferenceMissing))?;
        let rows: Result<Vec<(i64, Vec<u8>)>, _> = reading!(&self.store.pool, pool => {
            let sql = "SELECT seq, content FROM epochs
                       WHERE session = $1 AND $2 <= seq AND seq < $3 ORDER BY seq LIMIT $4";
            sqlx::query_as(sql)
                .bind(self.session.0)
                .bind(first as i64)
                .bind(seq as i64)
                .bind(CHAIN as i64)
                .fetch_all(pool)
                .await
        });
        rows.map_err(StoreError::database("reading the epochs of a chain"))
    }
}

fn corrupt(error: CodecError) -> StoreError {
    StoreError::corrupt("epoch")(error)
}
