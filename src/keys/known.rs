//! The known keys and sign-ins, and how they follow the store. Changes are read at an interval,
//! after a change by this service, and when a request has a key that another node may have made
//! just now.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::Mutex;
use tokio::time::{Instant, sleep_until};

use crate::clock::unix_ms;
use crate::store::{Store, StoreError};

use super::register::{ENDED, Register};
use super::sign_ins::SignIns;

/// Shortest time between two reads for requests. Requests in between share one read.
const PAUSE: Duration = Duration::from_millis(25);

/// Keys and sign-ins of the store.
pub(super) struct Known {
    store: Store,
    pub(super) register: Register,
    pub(super) sign_ins: SignIns,
    /// Number of reads that have begun.
    begun: AtomicU64,
    /// Locked during a read of the store, so that changes are taken in order.
    reading: Mutex<LastRead>,
}

/// The last read.
struct LastRead {
    begun_at: Instant,
    /// Number of the last read that has succeeded.
    succeeded: u64,
}

impl Known {
    /// No keys and sign-ins yet.
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

    /// Reads the changes since the last read.
    ///
    /// # Errors
    /// The store fails.
    pub(super) async fn refresh(&self) -> Result<(), StoreError> {
        let mut last = self.reading.lock().await;
        self.read(&mut last).await
    }

    /// Like [`Self::refresh`], for a request. When it returns, everything is known that was
    /// committed before the call. Requests at the same time share a read, so they cost the database
    /// little.
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
            // Read before the keys, so that the keys of these sign-ins are among the keys read.
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
        self.register.read_forgotten(unix_ms());
        // Only the last revocations of a service that has just started are read. Later ones all
        // are, because they end keys in force.
        let revoked_after = match self.register.changed() {
            0 => self.store.last_key_change().await? - ENDED as i64,
            _ => 0,
        };
        loop {
            let keys = self.store.changed_keys(self.register.changed(), revoked_after).await?;
            if keys.is_empty() {
                return Ok(());
            }
            self.register.take(keys);
            self.register.forget_ended(unix_ms());
        }
    }
}
