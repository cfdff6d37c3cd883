//! Waiting for a condition, with a deadline.

use std::fmt::Debug;
use std::time::{Duration, Instant};

/// More than the time that any condition of these tests needs on a busy machine.
const DEADLINE: Duration = Duration::from_secs(60);

const PAUSE: Duration = Duration::from_millis(10);

/// Repeats a call until `is_so` is true for its answer, and returns this answer.
///
/// Panics with `what` and the last answer when the deadline passes.
pub(crate) async fn until<T: Debug>(
    what: &str,
    mut ask: impl AsyncFnMut() -> T,
    is_so: impl Fn(&T) -> bool,
) -> T {
    let start = Instant::now();
    loop {
        let answer = ask().await;
        if is_so(&answer) {
            return answer;
        }
        assert!(start.elapsed() < DEADLINE, "not {what}: {answer:?}");
        tokio::time::sleep(PAUSE).await;
    }
}

/// Repeats a call for this time. Panics with `what` if `is_so` is once false for its answer.
pub(crate) async fn stays<T: Debug>(
    what: &str,
    duration: Duration,
    mut ask: impl AsyncFnMut() -> T,
    is_so: impl Fn(&T) -> bool,
) {
    let start = Instant::now();
    while start.elapsed() < duration {
        let answer = ask().await;
        assert!(is_so(&answer), "no longer {what}: {answer:?}");
        tokio::time::sleep(PAUSE).await;
    }
}

/// Runs `task`, and `interruption` at an arbitrary time.
pub(crate) async fn interrupted<T>(
    task: impl Future<Output = T>,
    after: Duration,
    interruption: impl FnOnce(),
) -> T {
    let interrupt = async {
        tokio::time::sleep(after).await;
        interruption();
    };
    tokio::join!(task, interrupt).0
}
