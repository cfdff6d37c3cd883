//! The tries of a request, with delays between them.

use std::time::Duration;

use tokio::time::sleep;

use crate::feeds::Backoff;

use super::{BucketError, Patience};

/// First delay between two tries. Each further one is twice as long, up to the ceiling.
const DELAY: Duration = Duration::from_millis(250);
const DELAY_CEILING: Duration = Duration::from_secs(20);
/// Tries of a request for which somebody waits: 2 to 4 s of delays.
const TRIES_OF_CALL: usize = 5;
/// Tries of a request for a run, whose work would be lost: 1 to 2 minutes of delays.
const TRIES_OF_RUN: usize = 11;

/// The tries of a request.
pub(super) struct Tries {
    left: usize,
    backoff: Backoff,
}

impl Tries {
    /// As many as somebody has patience for.
    pub(super) const fn of(patience: Patience) -> Self {
        let left = match patience {
            Patience::Call => TRIES_OF_CALL,
            Patience::Run => TRIES_OF_RUN,
        };
        Self { left, backoff: Backoff::new(DELAY, DELAY_CEILING) }
    }

    /// Waits before the next try.
    ///
    /// # Errors
    /// Another try would fail, too, or there are no more.
    pub(super) async fn again(&mut self, error: BucketError) -> Result<(), BucketError> {
        self.left -= 1;
        if self.left == 0 || !matches!(error, BucketError::Away { .. }) {
            return Err(error);
        }
        tracing::debug!(%error, "a request to the bucket is sent again");
        sleep(self.backoff.next(None)).await;
        Ok(())
    }
}
