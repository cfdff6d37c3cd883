//! Takes over what another node of the cluster has stored of bases: one node writes them, and the
//! others follow.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::aiding::AidingError;
use crate::store::{BaseKey, BaseRow, StoredBaseEpoch};

use super::BaseId;
use super::base::Base;
use super::broker::{BaseBroker, stored_base, stored_id};

/// New epochs of a base in order, and when the last of them was stored (ms since 1970-01-01 UTC).
type Later = (Vec<StoredBaseEpoch>, i64);

impl BaseBroker {
    /// Takes over new bases, sites and epochs, and drops bases that are deleted. Epochs are read
    /// after those that are known, by their numbers.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub(crate) async fn follow(&self) -> Result<(), AidingError> {
        let _turn = self.creating.lock().await;
        if self.store.leads() {
            return Ok(()); // It has stored all of it.
        }
        let mut rows: BTreeMap<BaseId, BaseRow> = BTreeMap::new();
        for row in self.store.bases().await? {
            rows.insert(stored_id(&row)?, row);
        }
        self.write().retain(|id, _| rows.contains_key(id));
        let newest = |id: &BaseId, row: &BaseRow| {
            let known = self.read().get(id).cloned();
            (row.key, known.map_or(0, |base| base.stored().next_number() - 1))
        };
        let known: Vec<(BaseKey, u64)> = rows.iter().map(|(id, row)| newest(id, row)).collect();
        let mut later: BTreeMap<BaseKey, Later> = BTreeMap::new();
        for (base, epoch, unix_ms) in self.store.base_epochs_after(&known).await? {
            let (epochs, stored_unix_ms) = later.entry(base).or_default();
            epochs.push(epoch);
            *stored_unix_ms = unix_ms;
        }
        for (id, row) in rows {
            let new = later.remove(&row.key);
            let known = self.read().get(&id).cloned();
            match known {
                Some(base) => self.take_over(&base, row, new),
                None => {
                    let unix_ms = new.as_ref().map(|(_, unix_ms)| *unix_ms);
                    let epochs = new.map(|(epochs, _)| epochs).unwrap_or_default();
                    self.write().insert(id, Arc::new(stored_base(row, epochs, unix_ms)));
                }
            }
        }
        Ok(())
    }

    /// Takes over sites and epochs of a base. What they leave no room for was dropped by the node
    /// that stored them, by the same limits.
    fn take_over(&self, base: &Base, row: BaseRow, new: Option<Later>) {
        let mut stored = base.stored();
        if *stored.sites != row.sites {
            stored.replace_sites(row.sites);
        }
        let Some((epochs, unix_ms)) = new else { return };
        let limits = (self.limits.epochs_per_base, self.limits.bytes_per_base);
        // Gaps are what is dropped already.
        let first = epochs.first().map_or(1, |first| first.number);
        let kept = stored.first_kept(&epochs, limits.0, limits.1).unwrap_or(first);
        let follows = stored.next_number() == first;
        stored.add(epochs, if follows { kept } else { first }, unix_ms);
    }
}
