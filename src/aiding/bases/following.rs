//! Reads from the store what another node of the cluster has stored of bases. One node writes the
//! bases, and the others follow.

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
    /// Reads new bases, sites and epochs from the store, and drops bases that are deleted. Of each
    /// base it reads the epochs after the last known number.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub(crate) async fn follow(&self) -> Result<(), AidingError> {
        let _turn = self.creating.lock().await;
        if self.store.is_leader() {
            return Ok(()); // It has stored all of it.
        }
        // If a base is new here, its epochs are read in the next round.
        while self.follow_once().await? {}
        Ok(())
    }

    /// Reads new epochs and sites of the known bases, and then the bases that are not known,
    /// without their epochs. Returns whether there were any of the latter.
    async fn follow_once(&self) -> Result<bool, AidingError> {
        let known: Vec<(BaseKey, u64)> = {
            let bases = self.read();
            let newest = |base: &Arc<Base>| (base.name().key, base.stored().next_number() - 1);
            bases.values().map(newest).collect()
        };
        let mut later: BTreeMap<BaseKey, Later> = BTreeMap::new();
        for (base, epoch, unix_ms) in self.store.base_epochs_after(&known).await? {
            let (epochs, stored_unix_ms) = later.entry(base).or_default();
            epochs.push(epoch);
            *stored_unix_ms = unix_ms;
        }
        // After the epochs: a site is stored with its first epoch or before it. So an epoch is
        // never seen without its site.
        let mut rows: BTreeMap<BaseId, BaseRow> = BTreeMap::new();
        for row in self.store.bases().await? {
            rows.insert(stored_id(&row)?, row);
        }
        self.write().retain(|id, _| rows.contains_key(id));
        let mut has_new = false;
        for (id, row) in rows {
            let known = self.read().get(&id).cloned();
            match known {
                Some(base) => {
                    let new = later.remove(&row.key);
                    self.take_over(&base, row, new);
                }
                None => {
                    has_new = true;
                    self.write().insert(id, Arc::new(stored_base(row, Vec::new(), None)));
                }
            }
        }
        Ok(has_new)
    }

    /// Adds sites and epochs of a base. Epochs beyond the limits are dropped; the node that stored
    /// them has dropped the same ones.
    fn take_over(&self, base: &Base, row: BaseRow, new: Option<Later>) {
        let mut stored = base.stored();
        if *stored.sites != row.sites {
            stored.replace_sites(row.sites);
        }
        let Some((epochs, unix_ms)) = new else { return };
        let limits = (self.limits.epochs_per_base, self.limits.bytes_per_base);
        // A gap before the first new epoch means that the epochs between are already dropped.
        let first = epochs.first().map_or(1, |first| first.number);
        let kept = stored.first_kept(&epochs, limits.0, limits.1).unwrap_or(first);
        let follows = stored.next_number() == first;
        stored.add(epochs, if follows { kept } else { first }, unix_ms);
    }
}
