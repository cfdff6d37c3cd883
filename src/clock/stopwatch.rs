//! Processor time of a thread.

use std::marker::PhantomData;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// Measures the processor time of the thread that started it.
///
/// Time in which other threads have the processor does not count, so a busy machine gives the same
/// result as a quiet one. It cannot be sent to another thread, which has another clock.
pub(crate) struct Stopwatch {
    started: Duration,
    thread: PhantomData<*const ()>,
}

impl Stopwatch {
    pub(crate) fn started() -> Self {
        Self { started: thread_time(), thread: PhantomData }
    }

    pub(crate) fn elapsed(&self) -> Duration {
        thread_time().saturating_sub(self.started)
    }
}

/// The processor time that this thread has used.
fn thread_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::try_from(time).expect("a thread has used no negative time")
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    #[test]
    fn waiting_does_not_count() {
        let (stopwatch, begun) = (Stopwatch::started(), Instant::now());
        std::thread::sleep(Duration::from_millis(50));
        assert!(Duration::from_millis(50) <= begun.elapsed());
        assert!(stopwatch.elapsed() < Duration::from_millis(25), "{:?}", stopwatch.elapsed());
    }

    #[test]
    fn computing_counts() {
        let (begun, stopwatch) = (Instant::now(), Stopwatch::started());
        let mut sum = 0.0_f64;
        while stopwatch.elapsed() < Duration::from_millis(5) {
            sum = std::hint::black_box(sum + 1.0);
        }
        assert!(Duration::from_millis(5) <= begun.elapsed(), "{sum}");
    }
}
