//! The attempts of a request, with delays between them.

use std::time::Duration;

use tokio::time::sleep;

use crate::feeds::Backoff;

use super::{BucketError, Patience};

/// First delay between two attempts. Each further delay is twice as long, up to the ceiling.
const DELAY: Duration = Duration::from_millis(250);
const DELAY_CEILING: Duration = Duration::from_secs(20);
/// Attempts of a request for which a caller waits: 2 to 4 s of delays.
const ATTEMPTS_OF_CALL: usize = 5;
/// Attempts of a request for a run, whose work would be lost: 1 to 2 minutes of delays.
const ATTEMPTS_OF_RUN: usize = 11;

/// The remaining attempts of a request.
pub(super) struct Attempts {
    left: usize,
    backoff: Backoff,
}

impl Attempts {
    /// As many attempts as this patience allows.
    pub(super) const fn of(patience: Patience) -> Self {
        let left = match patience {
            Patience::Call => ATTEMPTS_OF_CALL,
            Patience::Run => ATTEMPTS_OF_RUN,
        };
        Self { left, backoff: Backoff::new(DELAY, DELAY_CEILING) }
    }

    /// Waits before the next attempt.
    ///
    /// # Errors
    /// Another attempt would also fail, or none is left.
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
