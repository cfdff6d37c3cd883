//! The stop signal of a task.

use tokio::sync::watch;

/// Waits for the signal to stop.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    // Err: the sender is gone, which also means stop.
    stop.wait_for(|stop| *stop).await.ok();
}
