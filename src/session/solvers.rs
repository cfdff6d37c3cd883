//! The solver pool: estimation runs here, never on the threads that serve the network.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::Semaphore;
use tokio::task::{JoinError, spawn_blocking};

use crate::positioning::Scratch;

use super::SessionError;
use super::panics::message;
use super::state::State;

/// Most spare states that are kept.
const SPARE_STATES: usize = 64;

/// A bounded number of threads for estimation. Requests are served in order.
#[derive(Clone)]
pub(super) struct Solvers {
    permits: Arc<Semaphore>,
    memory: MemoryPool,
}

/// Memory that all sessions share, so that a session at rest needs its state only.
#[derive(Clone, Default)]
pub(super) struct MemoryPool {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Default)]
struct Shared {
    states: Vec<State>,
    /// One for each estimation that has run at the same time.
    scratches: Vec<Box<Scratch>>,
}

impl Solvers {
    pub(super) fn new(threads: NonZeroUsize) -> Self {
        Self { permits: Arc::new(Semaphore::new(threads.get())), memory: MemoryPool::default() }
    }

    pub(super) fn memory(&self) -> &MemoryPool {
        &self.memory
    }

    /// Runs `work` on a thread of the pool.
    ///
    /// # Errors
    /// It panicked.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, SessionError> {
        let permit = self.permits.clone().acquire_owned().await;
        let permit = permit.expect("the semaphore is never closed");
        let running = spawn_blocking(move || {
            let _permit = permit;
            work()
        });
        running.await.map_err(|error| SessionError::EstimatorFailed { message: message_of(error) })
    }

    /// Runs `work` on a thread of the pool, with an estimator's scratch.
    ///
    /// # Errors
    /// It panicked.
    pub(super) async fn estimate<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Scratch) -> T + Send + 'static,
    ) -> Result<T, SessionError> {
        let memory = self.memory.clone();
        let with_scratch = move || {
            let scratch = memory.shared().scratches.pop();
            let mut scratch = scratch.unwrap_or_default();
            let done = work(&mut scratch);
            memory.shared().scratches.push(scratch);
            done
        };
        self.run(with_scratch).await
    }
}

impl MemoryPool {
    /// A copy of `state`, in storage that an earlier one left.
    pub(super) fn copy_of(&self, state: &State) -> State {
        let spare = self.shared().states.pop();
        match spare {
            None => state.clone(),
            Some(mut spare) => {
                spare.clone_from(state);
                spare
            }
        }
    }

    /// Keeps the storage of a state that is no longer needed.
    pub(super) fn recycle(&self, state: State) {
        let mut shared = self.shared();
        if shared.states.len() < SPARE_STATES {
            shared.states.push(state);
        }
    }

    fn shared(&self) -> std::sync::MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn message_of(error: JoinError) -> String {
    error.try_into_panic().map_or_else(|_| "it was cancelled".to_owned(), |p| message(&*p))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    #[tokio::test]
    async fn a_panic_is_an_error_and_frees_its_thread() {
        let solvers = Solvers::new(NonZeroUsize::MIN);
        let failed = solvers.run(|| panic!("singular at {}", 3)).await.unwrap_err();
        assert_eq!(failed.code(), Code::EstimatorFailed);
        assert!(failed.to_string().ends_with("singular at 3"), "{failed}");
        assert_eq!(solvers.run(|| 7).await.unwrap(), 7);
    }
}
