//! Frees the space of deleted sessions in the background.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::sleep;

use crate::store::Store;

/// Epochs removed in one transaction, so that commits wait for few milliseconds.
const EPOCHS_PER_STEP: usize = 500;
/// Between transactions, for those of others.
const PAUSE: Duration = Duration::from_millis(20);
const RETRY: Duration = Duration::from_secs(10);

/// Removes what deleted sessions have stored, whenever it is woken; first what is left from before.
pub(super) async fn remove_deleted(store: Store, deleted: Arc<Notify>) {
    loop {
        match store.remove_deleted(EPOCHS_PER_STEP).await {
            Ok(true) => sleep(PAUSE).await,
            Ok(false) => deleted.notified().await,
            Err(error) => {
                tracing::warn!(%error, "deleted sessions still take space");
                sleep(RETRY).await;
            }
        }
    }
}
