//! Reads from the store what other nodes have stored. Notices of the database trigger the reads;
//! they also happen at an interval, because a notice can be lost.

use std::time::Duration;

use tokio::time::{Instant, sleep, sleep_until, timeout};

use crate::aiding::{AidingDesk, AidingError};
use crate::store::{Change, Notices, Store, StoreError};

/// Time without a notice after which the store is read.
const POLL: Duration = Duration::from_secs(2);
/// Shortest time between two reads, so that several notices cause one read.
const GATHER: Duration = Duration::from_millis(50);
const RETRY: Duration = Duration::from_secs(1);

/// Follows the changes of other nodes for ever.
pub(super) async fn follow(store: Store, aiding: AidingDesk) {
    loop {
        match listened(&store, &aiding).await {
            Ok(()) => return, // There is no cluster.
            Err(error) => {
                tracing::warn!(%error, "what other nodes store is taken over later");
                sleep(RETRY).await;
            }
        }
    }
}

async fn listened(store: &Store, aiding: &AidingDesk) -> Result<(), AidingError> {
    let Some(mut notices) = store.notices().await? else { return Ok(()) };
    let mut changed = [true, true];
    loop {
        let next = Instant::now() + GATHER;
        if changed[0] {
            aiding.navigation.refresh().await?;
        }
        if changed[1] {
            aiding.bases.follow().await?;
        }
        changed = gathered(&mut notices, next).await?;
    }
}

/// Whether navigation data and bases may have changed. Returns at the next notice or after `POLL`,
/// but not before `next`.
async fn gathered(notices: &mut Notices, next: Instant) -> Result<[bool; 2], StoreError> {
    let mut changed = [false, false];
    let mut note = |change: Option<Change>| match change {
        Some(Change::Navigation) => changed[0] = true,
        Some(Change::Bases) => changed[1] = true,
        None => changed = [true, true],
    };
    // Err: no notice came.
    match timeout(POLL, notices.next()).await {
        Ok(notice) => note(notice?),
        Err(_) => note(None),
    }
    sleep_until(next).await;
    while let Ok(notice) = timeout(Duration::ZERO, notices.next()).await {
        note(notice?);
    }
    Ok(changed)
}
