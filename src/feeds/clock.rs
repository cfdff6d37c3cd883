//! The system clock, and the signal to stop.

use std::time::{SystemTime, UNIX_EPOCH};

use tokio::sync::watch;

/// Waits until what runs is to be given up.
pub(super) async fn stopped(stop: &mut watch::Receiver<bool>) {
    // Err: the desk is gone.
    stop.wait_for(|stop| *stop).await.ok();
}

/// The time now (ms since 1970-01-01 UTC).
pub(super) fn unix_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).expect("the clock is past 1970");
    i64::try_from(since.as_millis()).expect("the clock is not millions of years ahead")
}
