//! What is known of keys and sign-ins, and how it follows the store: changes are read at an
//! interval, after an own change, and when a request brings what another node may have made just
//! now.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until};

use crate::store::{Store, StoreError};

use super::register::Register;
use super::sign_ins::SignIns;

/// Between the beginnings of two reads that requests ask for: those that come meanwhile share one.
const PAUSE: Duration = Duration::from_millis(25);

/// Keys and sign-ins of the store.
pub(super) struct Known {
    store: Store,
    pub(super) register: Register,
    pub(super) sign_ins: SignIns,
    /// Number of reads that have begun.
    begun: AtomicU64,
    /// Locked while the store is read, so that changes arrive in order.
    reading: Mutex<LastRead>,
}

/// The last read.
struct LastRead {
    begun_at: Instant,
    /// Number of the last one that has not failed.
    succeeded: u64,
}

impl Known {
    /// Nothing yet.
    pub(super) fn new(store: Store) -> Self {
        let reading = LastRead { begun_at: Instant::now(), succeeded: 0 };
        Self {
            store,
            register: Register::new(),
            sign_ins: SignIns::default(),
            begun: AtomicU64::new(0),
            reading: Mutex::new(reading),
        }
    }

    /// Reads what was changed since the last time.
    ///
    /// # Errors
    /// The store fails.
    pub(super) async fn refresh(&self) -> Result<(), StoreError> {
        let mut last = self.reading.lock().await;
        self.read(&mut last).await
    }

    /// The same for a request: what was committed when it came is known when this returns. Requests
    /// that come at the same time share a read, so that they cost the database little.
    ///
    /// # Errors
    /// The store fails.
    pub(super) async fn catch_up(&self) -> Result<(), StoreError> {
        let come = self.begun.load(Ordering::Acquire);
        let mut last = self.reading.lock().await;
        if come < last.succeeded {
            return Ok(()); // Read for another request, which came later.
        }
        sleep_until(last.begun_at + PAUSE).await;
        self.read(&mut last).await
    }

    async fn read(&self, last: &mut LastRead) -> Result<(), StoreError> {
        last.begun_at = Instant::now();
        let number = self.begun.fetch_add(1, Ordering::AcqRel) + 1;
        loop {
            // Before the keys, so that the keys of these sign-ins are among those that are read.
            let sign_ins = self.store.changed_sign_ins(self.sign_ins.changed()).await?;
            self.read_keys().await?;
            if sign_ins.is_empty() {
                break;
            }
            self.sign_ins.take(sign_ins, &self.register);
        }
        last.succeeded = number;
        Ok(())
    }

    async fn read_keys(&self) -> Result<(), StoreError> {
        loop {
            let keys = self.store.changed_keys(self.register.changed()).await?;
            if keys.is_empty() {
                return Ok(());
            }
            self.register.take(keys);
        }
    }
}
