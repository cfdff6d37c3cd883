//! Work on a blocking thread.

use tokio::task::spawn_blocking;

use crate::jobs::Failure;
use crate::refusal::Code;

/// Runs work that reads files on a blocking thread.
pub(super) async fn in_background<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> Result<T, Failure> {
    let done = spawn_blocking(work).await;
    done.unwrap_or_else(|panic| {
        let message = format!("reading or writing a file failed: {panic}");
        Err(Failure::new(Code::Internal, message, None))
    })
}
