//! The signal to stop.

use tokio::sync::watch;

/// Waits until what runs is to be given up.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    // Err: the desk is gone.
    stop.wait_for(|stop| *stop).await.ok();
}
