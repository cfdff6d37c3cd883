//! Joins reads of about the same time into one statement.
//!
//! After a restart thousands of sessions are read. A statement for several of them costs a server
//! little more than a statement for one: it is planned once, and sent once. A read that comes alone
//! is executed at once. Others wait while two statements are executed, or until a pause after the
//! beginning of the last one is over.

use std::collections::{HashMap, VecDeque};
use std::hash::Hash;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use futures::future::BoxFuture;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore, oneshot};
use tokio::time::{Instant, sleep_until};

use super::StoreError;
use super::deadline::within;

/// Statements of one kind at the same time. While one is executed, the rows of the other are read.
const STATEMENTS: usize = 2;

/// Reads the values of some keys, in their order.
type Read<K, V> = dyn Fn(Vec<K>) -> BoxFuture<'static, Result<Vec<V>, StoreError>> + Send + Sync;

/// How reads of one kind are joined.
pub(super) struct Rules {
    /// What they do, for errors.
    pub(super) operation: &'static str,
    /// Most keys in a statement.
    pub(super) keys_max: usize,
    /// Time from the beginning of a statement to that of the next, unless `keys_max` keys wait.
    pub(super) pause: Duration,
    /// Time that a reader waits for its value.
    pub(super) limit: Duration,
}

/// Reads of one kind.
pub(super) struct Joined<K, V> {
    rules: Rules,
    read: Box<Read<K, V>>,
    queue: Mutex<Queue<K, V>>,
    /// Tells that as many keys wait as a statement may have.
    full: Notify,
    statements: Arc<Semaphore>,
}

/// The keys that wait for a statement.
struct Queue<K, V> {
    waiting: VecDeque<Waiting<K, V>>,
    /// When the last statement began.
    begun: Option<Instant>,
}

/// A key, and the reader that waits for its value.
struct Waiting<K, V> {
    key: K,
    reader: oneshot::Sender<Result<V, StoreError>>,
}

impl<K: Send + 'static, V: Send + 'static> Joined<K, V> {
    /// Reads by `read`, which gets the keys of a statement.
    pub(super) fn new<F>(
        rules: Rules,
        read: impl Fn(Vec<K>) -> F + Send + Sync + 'static,
    ) -> Arc<Self>
    where
        F: Future<Output = Result<Vec<V>, StoreError>> + Send + 'static,
    {
        Arc::new(Self {
            rules,
            read: Box::new(move |keys| Box::pin(read(keys))),
            queue: Mutex::new(Queue { waiting: VecDeque::new(), begun: None }),
            full: Notify::new(),
            statements: Arc::new(Semaphore::new(STATEMENTS)),
        })
    }

    /// The value of a key.
    ///
    /// # Errors
    /// The statement failed, or the value did not come in time.
    pub(super) async fn value(self: &Arc<Self>, key: K) -> Result<V, StoreError> {
        let (reader, value) = oneshot::channel();
        let is_full = {
            let mut queue = self.queue();
            queue.waiting.push_back(Waiting { key, reader });
            self.rules.keys_max <= queue.waiting.len()
        };
        if is_full {
            self.full.notify_one();
        }
        let read = within(self.rules.limit, async { Ok(self.received(value).await) });
        read.await.map_err(StoreError::database(self.rules.operation))?
    }

    /// Waits for a value, and executes statements meanwhile. So each key that waits has a reader
    /// that executes its statement, even if other readers are gone.
    async fn received(
        self: &Arc<Self>,
        mut value: oneshot::Receiver<Result<V, StoreError>>,
    ) -> Result<V, StoreError> {
        let received = loop {
            tokio::select! {
                biased;
                received = &mut value => break received,
                permit = self.turn() => if !self.execute(permit) {
                    break value.await;
                }
            }
        };
        received.unwrap_or_else(|_| {
            Err(StoreError::database(self.rules.operation)(sqlx::Error::WorkerCrashed))
        })
    }

    /// Waits until a statement may begin.
    async fn turn(&self) -> OwnedSemaphorePermit {
        let permit = self.statements.clone().acquire_owned().await;
        let begins = {
            let queue = self.queue();
            let is_full = self.rules.keys_max <= queue.waiting.len();
            queue.begun.filter(|_| !is_full).map(|begun| begun + self.rules.pause)
        };
        if let Some(begins) = begins.filter(|begins| Instant::now() < *begins) {
            tokio::select! {
                () = sleep_until(begins) => {}
                () = self.full.notified() => {}
            }
        }
        permit.expect("the semaphore is never closed")
    }

    /// Begins a statement for the keys that have waited longest. Returns `false` if none waits.
    fn execute(self: &Arc<Self>, permit: OwnedSemaphorePermit) -> bool {
        let (mut keys, mut readers) = (Vec::new(), Vec::new());
        let mut queue = self.queue();
        while let Some(next) = queue.waiting.pop_front_if(|_| keys.len() < self.rules.keys_max) {
            if !next.reader.is_closed() {
                keys.push(next.key);
                readers.push(next.reader);
            }
        }
        if keys.is_empty() {
            return false;
        }
        queue.begun = Some(Instant::now());
        drop(queue);
        let joined = self.clone();
        tokio::spawn(async move {
            let values = (joined.read)(keys).await;
            drop(permit);
            // Err: the reader is gone.
            match values {
                Ok(values) => readers.into_iter().zip(values).for_each(|(reader, value)| {
                    reader.send(Ok(value)).ok();
                }),
                Err(error) => readers.into_iter().for_each(|reader| {
                    reader.send(Err(error.clone())).ok();
                }),
            }
        });
        true
    }

    fn queue(&self) -> MutexGuard<'_, Queue<K, V>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The values that a statement has found, in the order of its keys. Seldom two readers ask for one
/// key, and only then its value is copied.
pub(super) fn in_order<K: Eq + Hash, V: Clone>(
    keys: &[K],
    mut found: HashMap<K, V>,
) -> Vec<Option<V>> {
    let value = |(index, key): (usize, &K)| match keys[index + 1..].contains(key) {
        true => found.get(key).cloned(),
        false => found.remove(key),
    };
    keys.iter().enumerate().map(value).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use futures::future::join_all;

    use super::*;

    const LIMIT: Duration = Duration::from_secs(60);

    const fn rules(limit: Duration) -> Rules {
        let pause = Duration::from_millis(10);
        Rules { operation: "reading squares", keys_max: 4, pause, limit }
    }

    /// Reads squares, once `gate` is open, and counts statements.
    fn squares(
        gate: &Arc<Semaphore>,
        statements: &Arc<AtomicUsize>,
        limit: Duration,
    ) -> Arc<Joined<u64, u64>> {
        let (gate, statements) = (gate.clone(), statements.clone());
        Joined::new(rules(limit), move |keys: Vec<u64>| {
            let (gate, statements) = (gate.clone(), statements.clone());
            async move {
                assert!(keys.len() <= 4);
                statements.fetch_add(1, Ordering::Relaxed);
                drop(gate.acquire().await);
                match keys.contains(&13) {
                    true => Err(StoreError::Closed),
                    false => Ok(keys.into_iter().map(|key| key * key).collect()),
                }
            }
        })
    }

    #[test]
    fn every_reader_of_a_key_gets_its_value() {
        let found = HashMap::from([(1, "one"), (2, "two")]);
        assert_eq!(in_order(&[2, 1, 3, 1], found), [Some("two"), Some("one"), None, Some("one")]);
    }

    /// The first reader has a statement of its own. The eleven that come after it share three: four
    /// keys in each.
    #[tokio::test]
    async fn readers_that_wait_share_statements() {
        let (gate, statements) = (Arc::new(Semaphore::new(0)), Arc::default());
        let joined = squares(&gate, &statements, LIMIT);
        let opened = async {
            tokio::task::yield_now().await;
            gate.add_permits(1);
        };
        let (values, ()) = tokio::join!(join_all((0..12).map(|key| joined.value(key))), opened);
        let values: Vec<u64> = values.into_iter().map(Result::unwrap).collect();
        assert_eq!(values, (0..12).map(|key| key * key).collect::<Vec<_>>());
        assert_eq!(statements.load(Ordering::Relaxed), 4);
    }

    /// A reader that gives up takes no other with it, and its key is not read.
    #[tokio::test]
    async fn a_reader_that_is_gone_strands_nobody() {
        let (gate, statements) = (Arc::new(Semaphore::new(0)), Arc::default());
        let joined = squares(&gate, &statements, LIMIT);
        let first = tokio::spawn({
            let joined = joined.clone();
            async move { joined.value(1).await }
        });
        let begun = Arc::new(Notify::new());
        while statements.load(Ordering::Relaxed) == 0 {
            tokio::task::yield_now().await;
        }
        first.abort();
        assert!(first.await.unwrap_err().is_cancelled());
        let second = tokio::spawn({
            let (joined, begun) = (joined.clone(), begun.clone());
            async move {
                begun.notify_one();
                joined.value(2).await
            }
        });
        begun.notified().await;
        gate.add_permits(1);
        assert_eq!(second.await.unwrap().unwrap(), 4);
    }

    /// A statement that fails is an error for its readers, and the next one works again.
    #[tokio::test]
    async fn an_error_is_that_of_one_statement() {
        let joined = squares(&Arc::new(Semaphore::new(1)), &Arc::default(), LIMIT);
        assert!(matches!(joined.value(13).await, Err(StoreError::Closed)));
        assert_eq!(joined.value(3).await.unwrap(), 9);
    }

    /// A panic ends only the statement in which it happens.
    #[tokio::test]
    async fn a_panic_is_that_of_one_statement() {
        let joined = Joined::new(rules(LIMIT), |keys: Vec<u64>| async move {
            assert!(!keys.contains(&13), "on purpose");
            Ok(keys)
        });
        for _ in 0..2 * STATEMENTS {
            assert_eq!(joined.value(13).await.unwrap_err().code().name(), "DATABASE_FAILED");
        }
        assert_eq!(joined.value(3).await.unwrap(), 3);
    }

    /// Nobody waits for longer than the limit, whatever the database does.
    #[tokio::test]
    async fn a_statement_that_never_ends_is_given_up() {
        let (gate, statements) = (Arc::new(Semaphore::new(0)), Arc::default());
        let joined = squares(&gate, &statements, Duration::from_millis(20));
        let failed = join_all((0..50).map(|key| joined.value(key))).await;
        assert!(failed.into_iter().all(|value| value.is_err()));
    }
}
