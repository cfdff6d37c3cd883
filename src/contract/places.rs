//! Places of open streams or watches: a number in all, and a number for each key, so that the
//! clients of one key leave places for the others.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The places. Clones share them.
#[derive(Clone, Debug)]
pub(super) struct Places {
    all: Arc<Semaphore>,
    most: usize,
    of_key: usize,
    /// Number of places that each key has, if it has one.
    held: Arc<Mutex<HashMap<Arc<str>, usize>>>,
}

/// One place, until it is dropped.
#[derive(Debug)]
pub(super) struct Place {
    _permit: OwnedSemaphorePermit,
    /// The key that has it; `None` where no key is needed.
    key: Option<Arc<str>>,
    held: Arc<Mutex<HashMap<Arc<str>, usize>>>,
}

/// Why there is no place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Full {
    /// All of this number are taken.
    All(usize),
    /// The key has this number.
    Key(usize),
}

impl Full {
    /// The reason in words, about `what` is open.
    pub(super) fn message(self, what: &str) -> String {
        match self {
            Self::All(most) => format!("{most} {what} are open, as many as allowed"),
            Self::Key(most) => {
                format!("{most} {what} of this key are open, as limits.{what}_per_key allows")
            }
        }
    }
}

impl Places {
    /// This many places, and this many for one key.
    pub(super) fn new(most: usize, of_key: usize) -> Self {
        let most = most.min(Semaphore::MAX_PERMITS);
        Self { all: Arc::new(Semaphore::new(most)), most, of_key, held: Arc::default() }
    }

    /// Takes a place for the holder of a key, or for a caller who needs none.
    pub(super) fn take(&self, key: Option<&str>) -> Result<Place, Full> {
        let mut held = lock(&self.held);
        if key.and_then(|key| held.get(key)).is_some_and(|count| self.of_key <= *count) {
            return Err(Full::Key(self.of_key));
        }
        let permit = self.all.clone().try_acquire_owned().map_err(|_| Full::All(self.most))?;
        let key: Option<Arc<str>> = key.map(Into::into);
        if let Some(key) = &key {
            *held.entry(key.clone()).or_default() += 1;
        }
        Ok(Place { _permit: permit, key, held: self.held.clone() })
    }

    /// Number of places taken.
    pub(super) fn taken(&self) -> usize {
        self.most.saturating_sub(self.all.available_permits())
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let Some(key) = &self.key else { return };
        let mut held = lock(&self.held);
        if let Some(count) = held.get_mut(key) {
            *count -= 1;
            if *count == 0 {
                held.remove(key);
            }
        }
    }
}

fn lock(held: &Mutex<HashMap<Arc<str>, usize>>) -> MutexGuard<'_, HashMap<Arc<str>, usize>> {
    held.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_key_leaves_places_for_others() {
        let places = Places::new(3, 2);
        let of_key = |key| places.take(Some(key));
        let first = of_key("a").unwrap();
        let second = of_key("a").unwrap();
        assert_eq!(of_key("a").unwrap_err(), Full::Key(2));
        let other = of_key("b").unwrap();
        assert_eq!((of_key("b").unwrap_err(), places.taken()), (Full::All(3), 3));
        drop(first);
        drop(of_key("a").unwrap());
        drop((second, other));
        assert_eq!((places.taken(), lock(&places.held).len()), (0, 0));
        let without: Vec<Place> = (0..3).map(|_| places.take(None).unwrap()).collect();
        assert_eq!(places.take(None).unwrap_err(), Full::All(3));
        drop(without);
    }
}
