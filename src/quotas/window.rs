//! The approximate use within a window of time that ends now.
//!
//! Two counts are kept: of the present window and of the previous one. Of the previous count, only
//! the fraction is added that lies within one window length before now. For steady use the sum is
//! the use within the last window length.

use std::time::Duration;

/// Use within the last window. Times are seconds since any fixed instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    length_s: f64,
    begun_s: f64,
    present: f64,
    before: f64,
}

impl Window {
    pub(super) const fn new(length_s: f64) -> Self {
        Self { length_s, begun_s: 0.0, present: 0.0, before: 0.0 }
    }

    /// Begins the next window if the present one is over.
    fn turn(&mut self, now_s: f64) {
        let windows = ((now_s - self.begun_s) / self.length_s).floor();
        if windows < 1.0 {
            return;
        }
        self.before = if windows < 2.0 { self.present } else { 0.0 };
        self.present = 0.0;
        self.begun_s += windows * self.length_s;
    }

    /// Adds use.
    pub(super) fn add(&mut self, amount: f64, now_s: f64) {
        self.turn(now_s);
        self.present += amount;
    }

    /// The use within the last window length.
    pub(super) fn used(&mut self, now_s: f64) -> f64 {
        self.turn(now_s);
        let elapsed = (now_s - self.begun_s) / self.length_s;
        self.present + self.before * (1.0 - elapsed)
    }

    /// The time until the use is below `allowed`, if nothing is added; zero if it is so now.
    pub(super) fn delay(&mut self, allowed: f64, now_s: f64) -> Duration {
        if self.used(now_s) < allowed {
            return Duration::ZERO;
        }
        let elapsed_s = now_s - self.begun_s;
        let delay_s = match self.present {
            // Nothing is allowed.
            0.0 => 2.0 * self.length_s,
            present if present < allowed => {
                self.length_s * (1.0 - (allowed - present) / self.before) - elapsed_s
            }
            present => self.length_s * (2.0 - allowed / present) - elapsed_s,
        };
        Duration::from_secs_f64(delay_s.clamp(0.001, 2.0 * self.length_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steady_use_is_measured() {
        let mut window = Window::new(10.0);
        for tenth in 0..1000 {
            let now_s = f64::from(tenth) / 10.0;
            window.add(0.5, now_s);
            if 20.0 < now_s {
                let used = window.used(now_s);
                assert!((49.0..=51.0).contains(&used), "{used} at {now_s}");
            }
        }
        assert!(window.used(110.0) < 51.0);
        assert_eq!(window.used(125.0), 0.0);
    }

    /// After the delay, and not before it, the use is below the allowed one.
    #[test]
    fn the_delay_is_that_until_use_is_allowed() {
        for (amount, now_s) in [(30.0, 3.0), (1000.0, 3.0), (30.0, 12.0)] {
            let mut window = Window::new(10.0);
            window.add(amount, 2.0);
            window.add(5.0, now_s);
            let delay_s = window.delay(20.0, now_s).as_secs_f64();
            assert!(0.0 < delay_s && delay_s < 20.0, "{delay_s}");
            assert!(window.clone().used(now_s + delay_s - 0.01) >= 20.0, "{amount} {now_s}");
            assert!(window.used(now_s + delay_s + 0.01) < 20.0, "{amount} {now_s}");
            assert_eq!(window.delay(1e9, now_s + 1.0), Duration::ZERO);
        }
        let mut unused = Window::new(10.0);
        assert_eq!(unused.delay(0.0, 1.0), Duration::from_secs(20));
        unused.add(1.0, 1.0);
        assert!(Duration::from_secs(15) < unused.delay(0.0, 12.0));
    }
}
