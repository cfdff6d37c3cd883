//! The solver pool: where estimation runs, so that the threads that serve the network never do.

use std::num::NonZeroUsize;
use std::sync::Arc;

use tokio::sync::Semaphore;
use tokio::task::{JoinError, spawn_blocking};

use super::SessionError;

/// A bounded number of threads that estimate. Who asks first is served first.
#[derive(Clone)]
pub(super) struct Solvers {
    permits: Arc<Semaphore>,
}

impl Solvers {
    pub(super) fn new(threads: NonZeroUsize) -> Self {
        Self { permits: Arc::new(Semaphore::new(threads.get())) }
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
        running.await.map_err(|error| SessionError::EstimatorFailed { message: said(error) })
    }
}

fn said(error: JoinError) -> String {
    let Ok(panic) = error.try_into_panic() else { return "it was cancelled".to_owned() };
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("it panicked").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_panic_is_an_error_and_frees_its_thread() {
        let solvers = Solvers::new(NonZeroUsize::MIN);
        let failed = solvers.run(|| panic!("singular at {}", 3)).await.unwrap_err();
        assert_eq!(failed.code(), "ESTIMATOR_FAILED");
        assert!(failed.to_string().ends_with("singular at 3"), "{failed}");
        assert_eq!(solvers.run(|| 7).await.unwrap(), 7);
    }
}
