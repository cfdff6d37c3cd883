//! When the devices of a load open their streams, and when they send.

use std::sync::OnceLock;
use std::time::Duration;

use tokio::sync::{Barrier, Semaphore};
use tokio::time::Instant;

/// Delay from when the last stream is open to the common beginning.
const LEAD: Duration = Duration::from_secs(1);

/// When devices send.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Schedule {
    /// Interval between the epochs of a device (s).
    pub(super) interval_s: f64,
    /// Number of epochs of a device.
    pub(super) epochs: usize,
}

impl Schedule {
    /// A schedule of `rate_hz` epochs a second for `duration_s` seconds, with one epoch at least.
    pub(super) fn new(rate_hz: f64, duration_s: u32) -> Self {
        let epochs = (rate_hz * f64::from(duration_s)).floor().max(1.0);
        Self { interval_s: 1.0 / rate_hz, epochs: epochs as usize }
    }

    /// Time from the beginning to an epoch. The devices are spread over the interval by the golden
    /// ratio, so that any number of them sends evenly.
    pub(super) fn due(&self, device: usize, epoch: usize) -> Duration {
        let fraction = device as f64 * 0.618_033_988_749_895 % 1.0;
        Duration::from_secs_f64(self.interval_s * (epoch as f64 + fraction))
    }
}

/// The common beginning of all devices, once each has opened its stream.
pub(super) struct Beginning {
    /// Permits to open a stream, which bound how many devices do so at the same time.
    pub(super) opening: Semaphore,
    opened: Barrier,
    at: OnceLock<Instant>,
}

impl Beginning {
    /// For `devices` devices and one more task that waits for them. At most `at_once` devices open
    /// their streams at the same time.
    pub(super) fn new(devices: usize, at_once: usize) -> Self {
        let (opening, opened) = (Semaphore::new(at_once), Barrier::new(devices + 1));
        Self { opening, opened, at: OnceLock::new() }
    }

    /// When all devices begin. This waits until each device has called it.
    pub(super) async fn at(&self) -> Instant {
        self.opened.wait().await;
        *self.at.get_or_init(|| Instant::now() + LEAD)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No device begins before the last one has called `at`, and all begin at the same time.
    #[tokio::test]
    async fn devices_begin_together() {
        let beginning = Beginning::new(2, 1);
        let others = async { tokio::join!(beginning.at(), beginning.at()) };
        let mut others = std::pin::pin!(others);
        assert!(futures::poll!(&mut others).is_pending());
        let (last, (first, second)) = tokio::join!(beginning.at(), others);
        assert_eq!((first, second), (last, last));
    }

    #[test]
    fn devices_are_spread_over_the_interval() {
        let schedule = Schedule::new(0.5, 60);
        assert_eq!((schedule.interval_s, schedule.epochs), (2.0, 30));
        let mut first: Vec<_> = (0..100).map(|device| schedule.due(device, 0)).collect();
        first.sort();
        let gaps = first.windows(2).map(|pair| (pair[1] - pair[0]).as_secs_f64());
        let widest = gaps.fold(0.0, f64::max);
        // The golden ratio leaves gaps of at most 1.7 times the mean (three-distance theorem).
        assert!(widest < 1.7 * 2.0 / 100.0, "{widest} s");
        assert_eq!(schedule.due(0, 29), Duration::from_secs(58));
    }
}
