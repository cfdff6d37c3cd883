//! One lock for each session that is being started, changed or closed.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::OwnedMutexGuard;

use super::SessionId;

type Lock = Arc<tokio::sync::Mutex<()>>;

/// The locks that calls have or wait for. A session waits for its own calls only, however long one
/// of another session takes.
#[derive(Default)]
pub(super) struct SessionLocks(Mutex<HashMap<SessionId, Lock>>);

/// A lock while a call has it or waits for it.
pub(super) struct SessionLock<'a> {
    locks: &'a SessionLocks,
    id: SessionId,
    lock: Lock,
    /// `None` while the call waits.
    guard: Option<OwnedMutexGuard<()>>,
}

impl SessionLocks {
    /// Waits until no other call has the lock of this session.
    pub(super) async fn lock(&self, id: &SessionId) -> SessionLock<'_> {
        let lock = self.locks().entry(id.clone()).or_default().clone();
        let mut own = SessionLock { locks: self, id: id.clone(), lock, guard: None };
        own.guard = Some(own.lock.clone().lock_owned().await);
        own
    }

    fn locks(&self) -> MutexGuard<'_, HashMap<SessionId, Lock>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for SessionLock<'_> {
    fn drop(&mut self) {
        let mut locks = self.locks.locks();
        self.guard = None;
        // Others clone the lock only while `locks` is locked. The map and this call have one each.
        if Arc::strong_count(&self.lock) == 2 {
            locks.remove(&self.id);
        }
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;

    /// With a fixed number of locks, one session would wait for another.
    #[test]
    fn a_session_waits_for_its_own_calls_only() {
        let (locks, id) = (SessionLocks::default(), SessionId::random());
        let first = locks.lock(&id).now_or_never().unwrap();
        let others: Vec<_> = (0..1_000).map(|_| SessionId::random()).collect();
        let others: Vec<_> = others.iter().map(|id| locks.lock(id).now_or_never()).collect();
        assert!(others.iter().all(Option::is_some));
        let mut second = Box::pin(locks.lock(&id));
        assert!(second.as_mut().now_or_never().is_none());
        drop(first);
        let second = second.now_or_never().unwrap();
        assert!(locks.lock(&id).now_or_never().is_none(), "two calls have the lock");
        drop(others);
        drop(second);
        assert!(locks.locks().is_empty(), "locks that nobody needs");
    }

    /// A caller may disconnect while its call waits.
    #[test]
    fn a_call_that_no_longer_waits_leaves_no_lock() {
        let (locks, id) = (SessionLocks::default(), SessionId::random());
        let first = locks.lock(&id).now_or_never().unwrap();
        let mut second = Box::pin(locks.lock(&id));
        assert!(second.as_mut().now_or_never().is_none());
        drop(first);
        drop(second);
        assert!(locks.locks().is_empty());
    }
}
