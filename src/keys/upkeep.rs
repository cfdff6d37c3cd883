//! The task of a service for its keys: it reads changed keys, ends keys that expire, and stores
//! when keys were used.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, sleep, timeout};

use crate::clock::Clock;
use crate::store::{Store, StoreError};

use super::known::Known;

/// Interval at which changed keys are read, and expired ones ended.
pub(super) const REFRESH_INTERVAL: Duration = Duration::from_millis(400);
/// Interval at which uses are stored.
const NOTE_INTERVAL: Duration = Duration::from_secs(60);
/// Time for storing uses at the end. Uses that are not stored by then are lost.
const LAST_NOTE: Duration = Duration::from_secs(2);
/// Uses that are stored in one transaction, so that commits wait only some milliseconds.
const NOTES: usize = 500;

/// The task that keeps the keys of a service up to date.
pub(super) struct Upkeep {
    pub(super) store: Store,
    pub(super) clock: Clock,
    pub(super) stopped: watch::Receiver<bool>,
}

impl Upkeep {
    /// Runs until it is stopped, or the desk is dropped.
    pub(super) async fn run(mut self, known: Arc<Known>) {
        let mut stopped = self.stopped.clone();
        tokio::select! {
            _ = stopped.wait_for(|stopped| *stopped) => {}
            () = self.keep(&known) => {}
        }
        if *self.stopped.borrow_and_update() {
            let noted = timeout(LAST_NOTE, self.note(&known)).await;
            if !noted.is_ok_and(|noted| noted.is_ok()) {
                tracing::warn!("the last uses of keys are not stored");
            }
        }
    }

    async fn keep(&self, known: &Known) {
        let (mut noted, mut is_current) = (Instant::now(), true);
        loop {
            sleep(REFRESH_INTERVAL).await;
            known.register.forget_ended(self.clock.unix_ms());
            let was_current = is_current;
            is_current = match known.refresh().await {
                Ok(()) => true,
                Err(error) if was_current => {
                    tracing::warn!(%error, "changes of keys are not read; those known stay");
                    false
                }
                Err(_) => false,
            };
            if is_current && NOTE_INTERVAL <= noted.elapsed() {
                noted = Instant::now();
                if let Err(error) = self.note(known).await {
                    tracing::warn!(%error, "the uses of keys are not stored");
                }
            }
        }
    }

    /// Stores the uses since the last time.
    async fn note(&self, known: &Known) -> Result<(), StoreError> {
        for uses in known.register.uses().chunks(NOTES) {
            self.store.note_key_uses(uses).await?;
            known.register.note(uses);
        }
        Ok(())
    }
}
