//! Frees the space of deleted sessions and bases, of epochs older than their retention, and of old
//! entries of the audit log and the keys that ended before them, in the background.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::{sleep, timeout};

use crate::clock::{Clock, MS_PER_DAY, day_of};
use crate::store::{Expired, SessionKey, Store, StoreError};

use super::SessionLimits;

/// Epochs removed in one transaction, so that commits wait for few milliseconds.
const EPOCHS_PER_STEP: usize = 500;
/// Entries of the audit log, keys, or rows of the history, removed in one transaction.
const ENTRIES_PER_STEP: usize = 500;
/// Pause between transactions, so that those of others come in between.
const PAUSE: Duration = Duration::from_millis(20);
const RETRY: Duration = Duration::from_secs(10);
/// Longest time of a count of the time at the begin and the end of the service.
const COUNT_PATIENCE: Duration = Duration::from_secs(1);
/// Interval of the removal of epochs that are older than their retention, which is in days.
const EXPIRY_INTERVAL: Duration = Duration::from_secs(3_600);
/// Interval of checks whether this node leads its cluster.
const LEAD_INTERVAL: Duration = Duration::from_secs(5);
/// If the clock is ahead of the counted time by more than this, it was set, or the service did not
/// run (ms).
const STEP_MS: i64 = MS_PER_DAY;

/// Interval at which deleted sessions are looked for, whose node may have ended before it has
/// removed their rows.
const LOOK_INTERVAL: Duration = Duration::from_secs(60);

/// Removes the rows of deleted sessions, and the epochs of deleted bases, at the start, once a
/// minute, and whenever it is woken.
pub(super) async fn remove_deleted(store: Store, deleted: Arc<Notify>) {
    let mut failed = None;
    loop {
        match remove_some(&store, &mut failed).await {
            Ok(true) => sleep(PAUSE).await,
            Ok(false) => drop(timeout(LOOK_INTERVAL, deleted.notified()).await),
            Err(error) => {
                tracing::warn!(%error, "deleted sessions and bases still take space");
                sleep(RETRY).await;
            }
        }
    }
}

/// Removes some rows of a deleted session, or epochs of a deleted base. Returns whether there were
/// any. After a failure the sessions behind the one that `failed` come first.
async fn remove_some(store: &Store, failed: &mut Option<SessionKey>) -> Result<bool, StoreError> {
    if let Some(session) = store.deleted_session(*failed).await? {
        let removed = store.remove_deleted(session, EPOCHS_PER_STEP).await;
        removed.inspect_err(|_| *failed = Some(session))?;
        return Ok(true);
    }
    *failed = None;
    store.remove_epochs_of_deleted_bases(EPOCHS_PER_STEP).await
}

/// Removes epochs that are older than their retention, and old entries of the audit log.
pub(super) struct Expiry {
    store: Store,
    clock: Clock,
    /// Retention of sessions without one of their own (days).
    retention_days: u32,
    /// Retention of the audit log (days).
    audit_days: u32,
    /// Retention of the hours of the history (days).
    history_days: u32,
    /// The clock's [`Clock::elapsed_ms`] when ages were last counted. Locked during a removal.
    counted_ms: tokio::sync::Mutex<i64>,
    /// Time by which the clock was then ahead of the counted time (ms).
    ahead_ms: AtomicI64,
}

impl Expiry {
    pub(super) fn new(store: Store, clock: Clock, limits: &SessionLimits) -> Self {
        let counted_ms = tokio::sync::Mutex::new(clock.elapsed_ms());
        let SessionLimits { retention_days, audit_days, history_days, .. } = *limits;
        let ahead_ms = AtomicI64::new(0);
        Self { store, clock, retention_days, audit_days, history_days, counted_ms, ahead_ms }
    }

    /// Removes them once an hour. In a cluster only the leader does.
    pub(super) async fn remove_hourly(self: Arc<Self>) {
        loop {
            if !self.store.is_leader() {
                // The leader counts this time, by which this node stores what arrives.
                *self.counted_ms.lock().await = self.clock.elapsed_ms();
                self.store.read_expiry_clock().await.ok(); // Err: it is read again soon.
                sleep(LEAD_INTERVAL).await;
                continue;
            }
            match self.remove().await {
                Ok(()) => sleep(EXPIRY_INTERVAL).await,
                Err(error) => {
                    tracing::warn!(%error, "expired epochs still take space");
                    sleep(RETRY).await;
                }
            }
        }
    }

    /// Counts the time until now, at the begin and at the end of the service. If that takes long,
    /// or fails, what is stored expires a little later.
    pub(super) async fn count(&self) {
        let counting = async {
            let mut counted_ms = self.counted_ms.lock().await;
            self.today(&mut counted_ms).await
        };
        if self.store.is_leader() {
            drop(timeout(COUNT_PATIENCE, counting).await);
        }
    }

    /// Removes them, in steps. After a failure it goes on with what does not depend on it.
    ///
    /// # Errors
    /// The first failure.
    pub(super) async fn remove(&self) -> Result<(), StoreError> {
        let mut counted_ms = self.counted_ms.lock().await;
        let today = self.today(&mut counted_ms).await?;
        let epochs = self.remove_epochs(today).await;
        let audit = self.remove_audit(today).await;
        let history = self.remove_history(today).await;
        let pages = self.release_pages().await;
        epochs.and(audit).and(history).and(pages)
    }

    /// Removes the epochs that are older than their retention on this day.
    async fn remove_epochs(&self, today: i64) -> Result<(), StoreError> {
        let (store, retention_days) = (&self.store, self.retention_days);
        // Marked first, so that whole days of the log can be dropped if none of their rows is kept.
        let marked = store.mark_expired(today, retention_days).await;
        let dropped = store.drop_days(today, retention_days).await;
        let mut removed = Ok(());
        while removed.is_ok() {
            let sessions = store.expired(today, retention_days).await?;
            if sessions.is_empty() {
                break;
            }
            for expired in sessions {
                removed = removed.and(self.remove_expired(&expired).await);
            }
        }
        marked.and(dropped).and(removed)
    }

    /// Removes the epochs of a session that are older than their retention.
    async fn remove_expired(&self, expired: &Expired) -> Result<(), StoreError> {
        while self.store.remove_expired(expired, EPOCHS_PER_STEP).await? {
            sleep(PAUSE).await;
        }
        Ok(())
    }

    /// Gives free pages back to the disk.
    async fn release_pages(&self) -> Result<(), StoreError> {
        while self.store.release_pages().await? {
            sleep(PAUSE).await;
        }
        Ok(())
    }

    /// Removes the entries of the audit log that are older than its retention on this day, and the
    /// keys that ended before. No entry then names these.
    async fn remove_audit(&self, today: i64) -> Result<(), StoreError> {
        if self.audit_days == 0 {
            return Ok(());
        }
        let oldest_ms = MS_PER_DAY * (today - i64::from(self.audit_days));
        while self.store.remove_audit_before(oldest_ms, ENTRIES_PER_STEP).await? {
            sleep(PAUSE).await;
        }
        while self.store.remove_keys_ended_before(oldest_ms, ENTRIES_PER_STEP).await? {
            sleep(PAUSE).await;
        }
        Ok(())
    }

    /// Removes the hours of the history that are older than its retention on this day.
    async fn remove_history(&self, today: i64) -> Result<(), StoreError> {
        if self.history_days == 0 {
            return Ok(());
        }
        let oldest = today - i64::from(self.history_days);
        while self.store.remove_hours_before(oldest, ENTRIES_PER_STEP).await? {
            sleep(PAUSE).await;
        }
        Ok(())
    }

    /// Time by which the clock is ahead of the time by which ages are counted, if it must have been
    /// set. Epochs are kept longer by this time.
    pub(super) fn clock_ahead(&self) -> Option<Duration> {
        let ahead_ms = self.ahead_ms.load(Ordering::Relaxed);
        (STEP_MS < ahead_ms).then(|| Duration::from_millis(ahead_ms as u64))
    }

    /// The day by which ages are counted.
    async fn today(&self, counted_ms: &mut i64) -> Result<i64, StoreError> {
        let (now, elapsed_ms) = (self.clock.unix_ms(), self.clock.elapsed_ms());
        let counted = self.store.advance_expiry_clock(now, elapsed_ms - *counted_ms).await?;
        *counted_ms = elapsed_ms;
        self.ahead_ms.store(now - counted, Ordering::Relaxed);
        if let Some(ahead) = self.clock_ahead() {
            let days = ahead.as_secs_f64() / 86_400.0;
            tracing::warn!(
                days,
                "the clock is ahead of what is stored; epochs are kept for longer"
            );
        }
        Ok(day_of(counted))
    }
}
