//! The slowest rate at which the body of a request may arrive, at both doors.

use std::time::Duration;

use tokio::time::Instant;

use crate::refusal::Code;

use super::Refusal;

/// Slowest rate of a body (bytes/s).
const RATE_MIN: u64 = 16 << 10;

/// Measures the rate of a body: twice the longest silence, and the time of its bytes at the slowest
/// rate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BodyRate {
    begun: Instant,
    silence: Duration,
}

impl BodyRate {
    /// Begins with the body. `silence` is the longest time without a byte.
    pub(crate) fn begin(silence: Duration) -> Self {
        Self { begun: Instant::now(), silence }
    }

    /// Checks the rate when `arrived` bytes have arrived.
    ///
    /// # Errors
    /// [`Code::BodyTooSlow`].
    pub(crate) fn check(&self, arrived: usize) -> Result<(), Refusal> {
        let allowed = self.silence + self.silence + Duration::from_secs(arrived as u64 / RATE_MIN);
        let elapsed = self.begun.elapsed();
        match allowed < elapsed {
            true => Err(Refusal::new(Code::BodyTooSlow, format!("{arrived} bytes in {elapsed:?}"))),
            false => Ok(()),
        }
    }
}
