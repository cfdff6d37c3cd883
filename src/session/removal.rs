//! Frees the space of deleted sessions and of epochs older than their retention, in the background.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::sleep;

use crate::clock::Clock;
use crate::store::{Store, StoreError};

/// Epochs removed in one transaction, so that commits wait for few milliseconds.
const EPOCHS_PER_STEP: usize = 500;
/// Between transactions, for those of others.
const PAUSE: Duration = Duration::from_millis(20);
const RETRY: Duration = Duration::from_secs(10);
/// Between checks for epochs that are older than their retention, which is counted in days.
const EXPIRY_INTERVAL: Duration = Duration::from_secs(3_600);

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

/// Removes the epochs that are older than their retention, once an hour.
pub(super) async fn remove_expired_hourly(store: Store, clock: Clock, retention_days: u32) {
    loop {
        match remove_expired(&store, &clock, retention_days).await {
            Ok(()) => sleep(EXPIRY_INTERVAL).await,
            Err(error) => {
                tracing::warn!(%error, "expired epochs still take space");
                sleep(RETRY).await;
            }
        }
    }
}

/// Removes the epochs that are older than their retention, in steps. Sessions without a retention
/// of their own have `retention_days`.
pub(super) async fn remove_expired(
    store: &Store,
    clock: &Clock,
    retention_days: u32,
) -> Result<(), StoreError> {
    // Marked first, so that whole days of the log are dropped where nothing of them is kept.
    store.mark_expired(clock.day(), retention_days).await?;
    store.drop_days(clock.day(), retention_days).await?;
    loop {
        let sessions = store.expired(clock.day(), retention_days).await?;
        if sessions.is_empty() {
            break;
        }
        for expired in sessions {
            while store.remove_expired(&expired, EPOCHS_PER_STEP).await? {
                sleep(PAUSE).await;
            }
        }
    }
    while store.release_pages().await? {
        sleep(PAUSE).await;
    }
    Ok(())
}
