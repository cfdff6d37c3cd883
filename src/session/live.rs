//! Newly committed solutions for the watches of sessions: one bounded ring for all watches.
//!
//! Only solutions of watched sessions enter the ring. A watch that falls behind the ring, or whose
//! session may have committed something that the ring does not have, reads the store.

use std::collections::{HashMap, VecDeque};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::store::{SessionKey, StoredSolution};

/// The ring, which all sessions and watches share.
pub(super) struct Live {
    capacity: usize,
    /// Number of watches. While it is zero, a commit only reads this number.
    watches: AtomicUsize,
    ring: Mutex<Ring>,
}

#[derive(Default)]
struct Ring {
    entries: VecDeque<(SessionKey, Entry)>,
    /// Number of entries that have left the ring.
    left: u64,
    watched: HashMap<SessionKey, Watched>,
}

/// A session with watches.
struct Watched {
    watches: usize,
    changed: Arc<Notify>,
}

#[derive(Clone)]
enum Entry {
    Solution(Arc<StoredSolution>),
    /// A commit may have happened whose solutions are not in the ring.
    Unknown,
    Closed,
}

/// What a watch receives.
#[derive(Clone, Debug)]
pub enum WatchEvent {
    /// Solutions in the order of their commits, and whether the session is then closed.
    Solutions {
        /// The solutions.
        solutions: Vec<Arc<StoredSolution>>,
        /// Whether the session is closed after them.
        is_closed: bool,
    },
    /// A commit may have happened whose solutions are not in the ring. The watch reads the store.
    Unknown,
}

/// A watch on one session's commits.
pub struct Watch {
    live: Arc<Live>,
    session: SessionKey,
    changed: Arc<Notify>,
    /// Number of the next entry to read.
    next: u64,
}

impl Live {
    /// A ring of `capacity` solutions.
    pub(super) fn new(capacity: usize) -> Self {
        Self { capacity, watches: AtomicUsize::new(0), ring: Mutex::default() }
    }

    fn ring(&self) -> MutexGuard<'_, Ring> {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A watch on the commits of a session from now on.
    pub(super) fn watch(self: &Arc<Self>, session: SessionKey) -> Watch {
        self.watches.fetch_add(1, Ordering::AcqRel);
        let mut ring = self.ring();
        let next = ring.end();
        let changed = Arc::default();
        let watched = ring.watched.entry(session).or_insert(Watched { watches: 0, changed });
        watched.watches += 1;
        Watch { live: self.clone(), session, changed: watched.changed.clone(), next }
    }

    /// Whether there is any watch, of any session.
    pub(super) fn has_watches(&self) -> bool {
        self.watches.load(Ordering::Acquire) != 0
    }

    /// Publishes the solutions that a session has committed.
    pub(super) fn publish<'a>(
        &self,
        session: SessionKey,
        solutions: impl IntoIterator<Item = &'a StoredSolution>,
    ) {
        let entry = |solution: &StoredSolution| Entry::Solution(Arc::new(solution.clone()));
        self.add(session, solutions.into_iter().map(entry));
    }

    /// Publishes that a session may have committed solutions that are not in the ring.
    pub(super) fn publish_unknown(&self, session: SessionKey) {
        self.add(session, [Entry::Unknown]);
    }

    /// Does [`Self::publish_unknown`] for all watched sessions for which `is_here` is false.
    pub(super) fn publish_elsewhere(&self, is_here: impl Fn(SessionKey) -> bool) {
        let watched: Vec<SessionKey> = self.ring().watched.keys().copied().collect();
        watched.into_iter().filter(|key| !is_here(*key)).for_each(|key| self.publish_unknown(key));
    }

    /// Publishes that a session is closed.
    pub(super) fn publish_closed(&self, session: SessionKey) {
        self.add(session, [Entry::Closed]);
    }

    fn add(&self, session: SessionKey, entries: impl IntoIterator<Item = Entry>) {
        if !self.has_watches() {
            return;
        }
        let mut ring = self.ring();
        let Some(watched) = ring.watched.get(&session) else { return };
        let changed = watched.changed.clone();
        ring.entries.extend(entries.into_iter().map(|entry| (session, entry)));
        let surplus = ring.entries.len().saturating_sub(self.capacity);
        ring.entries.drain(..surplus);
        ring.left += surplus as u64;
        drop(ring);
        changed.notify_waiters();
    }
}

impl Ring {
    /// Number of the next entry.
    fn end(&self) -> u64 {
        self.left + self.entries.len() as u64
    }
}

impl Watch {
    /// Waits for something new.
    pub(crate) async fn next(&mut self) -> WatchEvent {
        let changed = self.changed.clone();
        loop {
            let notified = changed.notified();
            if let Some(news) = self.arrived() {
                return news;
            }
            notified.await;
        }
    }

    /// The entries that have arrived since the last call.
    fn arrived(&mut self) -> Option<WatchEvent> {
        let ring = self.live.ring();
        let next = std::mem::replace(&mut self.next, ring.end());
        let Some(skipped) = next.checked_sub(ring.left) else { return Some(WatchEvent::Unknown) };
        let (mut solutions, mut is_closed) = (Vec::new(), false);
        for (session, entry) in ring.entries.range(skipped as usize..) {
            match entry {
                _ if *session != self.session => {}
                Entry::Solution(solution) => solutions.push(solution.clone()),
                Entry::Unknown => return Some(WatchEvent::Unknown),
                Entry::Closed => is_closed = true,
            }
        }
        let is_new = !solutions.is_empty() || is_closed;
        is_new.then_some(WatchEvent::Solutions { solutions, is_closed })
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        let mut ring = self.live.ring();
        if let Some(watched) = ring.watched.get_mut(&self.session) {
            watched.watches -= 1;
            if watched.watches == 0 {
                ring.watched.remove(&self.session);
            }
        }
        if self.live.watches.fetch_sub(1, Ordering::AcqRel) == 1 {
            ring.left = ring.end();
            ring.entries = VecDeque::new();
        }
    }
}
