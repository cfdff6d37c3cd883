//! Number of attempts to fetch a file, and the delays between them.

use std::time::Duration;

use crate::refusal::Code;

use super::{Backoff, WebError};

/// Number of attempts to fetch a file.
const ATTEMPTS: usize = 3;
const DELAY: Duration = Duration::from_secs(2);
const DELAY_CEILING: Duration = Duration::from_secs(60);

/// The remaining attempts for one file.
#[derive(Clone, Debug)]
pub(crate) struct Attempts {
    left: usize,
    backoff: Backoff,
}

impl Attempts {
    /// The attempts before the first one.
    pub(crate) const fn new() -> Self {
        Self { left: ATTEMPTS, backoff: Backoff::new(DELAY, DELAY_CEILING) }
    }

    /// The delay before the next attempt after a failed one. `None` if no attempt follows, because
    /// it would fail, too, or because none is left.
    pub(crate) fn delay_after(&mut self, error: &WebError) -> Option<Duration> {
        self.left = self.left.saturating_sub(1);
        if self.left == 0 || !error.is_passing() {
            return None;
        }
        let asked = error.retry_after().filter(|asked| *asked <= DELAY_CEILING);
        Some(self.backoff.next(asked))
    }
}

impl WebError {
    /// Whether another attempt may succeed.
    fn is_passing(&self) -> bool {
        let passing = [
            Code::HostUnresolved,
            Code::HostUnreachable,
            Code::HostSlow,
            Code::HostRefuses,
            Code::HostProtocol,
            Code::FileCut,
        ];
        passing.contains(&self.code())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_passing_failure_is_tried_three_times() {
        let slow = WebError::Slow { seconds: 15 };
        let mut attempts = Attempts::new();
        let delays = [(); 4].map(|()| attempts.delay_after(&slow));
        let within = |delay: Option<Duration>, first: Duration| {
            delay.is_some_and(|delay| first / 2 <= delay && delay <= first)
        };
        assert!(within(delays[0], DELAY) && within(delays[1], 2 * DELAY), "{delays:?}");
        assert_eq!(delays[2..], [None, None]);
    }

    #[test]
    fn a_lasting_failure_is_not_tried_again() {
        let missing = WebError::NotFound { answer: "404 Not Found".to_owned() };
        for error in [missing, WebError::TooLarge { limit: 1 }] {
            assert_eq!(Attempts::new().delay_after(&error), None, "{error}");
        }
    }

    /// The delay that a host asks for is respected, but only up to a limit.
    #[test]
    fn the_delay_that_a_host_asks_for_is_kept_within_a_limit() {
        let refused = |seconds| {
            let retry_after = Some(Duration::from_secs(seconds));
            let answer = "503 Service Unavailable".to_owned();
            Attempts::new().delay_after(&WebError::Refused { answer, retry_after }).unwrap()
        };
        assert!(Duration::from_secs(60) <= refused(60));
        assert!(refused(61) <= DELAY);
    }
}
