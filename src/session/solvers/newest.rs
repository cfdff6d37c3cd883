//! Admission of a bounded number of callers, the newest first. Under overload the newest callers
//! are served at once; in order of arrival, all callers would be served after their timeouts.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

/// A bounded number of slots. All clones share them.
#[derive(Clone, Debug)]
pub(super) struct Newest(Arc<Mutex<Slots>>);

#[derive(Debug)]
struct Slots {
    free: usize,
    waiting: Vec<oneshot::Sender<Admitted>>,
}

/// The right to a slot. Dropping it admits the next caller.
#[derive(Debug)]
pub(in crate::session) struct Admitted(Newest);

impl Newest {
    pub(super) fn new(slots: usize) -> Self {
        Self(Arc::new(Mutex::new(Slots { free: slots, waiting: Vec::new() })))
    }

    /// Waits for a slot.
    pub(super) async fn admitted(&self) -> Admitted {
        let waiting = {
            let mut slots = self.slots();
            if let Some(free) = slots.free.checked_sub(1) {
                slots.free = free;
                return Admitted(self.clone());
            }
            let (sender, waiting) = oneshot::channel();
            slots.waiting.push(sender);
            waiting
        };
        waiting.await.expect("a slot that is waited for is given")
    }

    /// Gives a free slot to the caller that has waited for the shortest time.
    fn admit_next(&self) {
        loop {
            let mut slots = self.slots();
            let Some(newest) = slots.waiting.pop() else {
                slots.free += 1;
                return;
            };
            drop(slots);
            if newest.is_closed() {
                continue; // Who waited has gone.
            }
            // Err: the caller has gone just now. Dropping the slot admits the next.
            drop(newest.send(Admitted(self.clone())));
            return;
        }
    }

    fn slots(&self) -> MutexGuard<'_, Slots> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Admitted {
    fn drop(&mut self) {
        self.0.admit_next();
    }
}

#[cfg(test)]
mod tests {
    use std::pin::pin;
    use std::task::{Context, Poll, Waker};

    use super::*;

    fn now<F: Future>(future: F) -> Option<F::Output> {
        match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(output) => Some(output),
            Poll::Pending => None,
        }
    }

    #[test]
    fn the_newest_comes_first_and_no_place_is_lost() {
        let newest = Newest::new(2);
        let (first, second) = (now(newest.admitted()).unwrap(), now(newest.admitted()).unwrap());
        let mut waiting: Vec<_> = (0..4).map(|_| Box::pin(newest.admitted())).collect();
        assert!(waiting.iter_mut().all(|waiting| now(waiting.as_mut()).is_none()));
        drop(waiting.pop()); // Has gone.
        drop(first);
        let third = now(waiting.pop().unwrap().as_mut()).unwrap();
        assert!(waiting.iter_mut().all(|waiting| now(waiting.as_mut()).is_none()));
        drop(second);
        // Given, but never taken.
        drop(waiting.pop());
        assert!(now(waiting.pop().unwrap().as_mut()).is_some());
        drop(third);
        assert!(now(newest.admitted()).is_some() && now(newest.admitted()).is_some());
    }
}
