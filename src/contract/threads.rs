//! Keeps long computations off the threads that serve the network.

use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::task::{block_in_place, spawn_blocking};

use crate::refusal::Code;

use super::{Lease, Refusal};

/// Messages up to this size are decoded on the thread that received them (bytes).
const SHORT_BYTES: usize = 64 << 10;

/// Runs `work` on a blocking thread. The work keeps the lease of the request until it is done, even
/// if the caller has disconnected.
///
/// # Errors
/// It panicked.
pub(crate) async fn in_background<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Refusal> {
    let lease = Lease::current();
    let done = spawn_blocking(move || {
        let _lease = lease;
        work()
    });
    let done = done.await;
    done.map_err(|panic| Refusal::new(Code::Internal, panic.to_string()))
}

/// Runs `work`, which processes `bytes` bytes. If they are many, the runtime first moves the other
/// tasks of this thread to another thread.
pub(crate) fn off_the_network<T>(bytes: usize, work: impl FnOnce() -> T) -> T {
    let is_movable =
        || Handle::try_current().is_ok_and(|at| at.runtime_flavor() == RuntimeFlavor::MultiThread);
    if SHORT_BYTES < bytes && is_movable() { block_in_place(work) } else { work() }
}
