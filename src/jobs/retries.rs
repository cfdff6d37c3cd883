//! Further runs of jobs that a failing database has ended. The jobs are not at fault, so they wait
//! until the database works again.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::feeds::Backoff;

/// First and longest delay before another attempt.
const DELAY: Duration = Duration::from_secs(1);
const DELAY_CEILING: Duration = Duration::from_secs(10);
/// Most attempts that the database may end within [`WINDOW`]. A job can be claimed again only once
/// the database takes writes, so a database that is down uses up one of them.
const ATTEMPTS: u32 = 20;
const WINDOW: Duration = Duration::from_secs(3600);

/// The attempts of this process that the database has ended, by the id of their job.
#[derive(Default)]
pub(super) struct Retries(Mutex<HashMap<String, Failing>>);

struct Failing {
    since: Instant,
    attempts: u32,
    delays: Backoff,
}

impl Retries {
    /// The delay before another attempt at a job, after one that the database has ended; `None` if
    /// no other follows.
    pub(super) fn delay(&self, job: &str) -> Option<Duration> {
        self.delay_at(job, Instant::now())
    }

    fn delay_at(&self, job: &str, now: Instant) -> Option<Duration> {
        let mut failing = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        failing.retain(|_, failing| now - failing.since < WINDOW);
        let failing = failing.entry(job.to_owned()).or_insert_with(|| Failing {
            since: now,
            attempts: 0,
            delays: Backoff::new(DELAY, DELAY_CEILING),
        });
        failing.attempts += 1;
        (failing.attempts < ATTEMPTS).then(|| failing.delays.next(None))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attempts_within_an_hour_are_bounded() {
        let (retries, now) = (Retries::default(), Instant::now());
        for attempt in 1..ATTEMPTS {
            let delay = retries.delay_at("a", now).unwrap();
            assert!(DELAY / 2 <= delay && delay <= DELAY_CEILING, "{attempt}: {delay:?}");
        }
        assert_eq!(retries.delay_at("a", now), None);
        assert!(retries.delay_at("b", now).is_some(), "another job");
        assert!(retries.delay_at("a", now + WINDOW).is_some_and(|delay| delay <= DELAY));
    }
}
