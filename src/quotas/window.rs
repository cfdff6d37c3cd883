//! The approximate use within a window of time that ends now, and the use that is owed.
//!
//! What is owed grows with each use, and shrinks at the allowed rate. So who uses more at once than
//! a window allows waits for as long as it takes at that rate (the leaky bucket).
//!
//! Two counts are kept: of the present window and of the previous one. Of the previous count, only
//! the fraction is added that lies within one window length before now. For steady use the sum is
//! the use within the last window length.

use std::time::Duration;

/// Longest delay that is stated (s).
const DELAY_MAX_S: f64 = 600.0;

/// Use within the last window. Times are seconds since any fixed instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    length_s: f64,
    begun_s: f64,
    present: f64,
    before: f64,
    /// The use allowed in each window; `None` is no limit.
    allowed: Option<f64>,
    owed: f64,
    owed_at_s: f64,
}

/// Use beyond what is allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Excess {
    pub(super) beyond: f64,
    /// The time until use is allowed again, if nothing is added.
    pub(super) delay: Duration,
}

impl Window {
    /// Without a limit.
    pub(super) const fn new(length_s: f64) -> Self {
        let (present, before, owed) = (0.0, 0.0, 0.0);
        Self { length_s, begun_s: 0.0, present, before, allowed: None, owed, owed_at_s: 0.0 }
    }

    /// Allows this use in each window. If it is another than before, what is owed begins with the
    /// use of the last window.
    pub(super) fn allow(&mut self, allowed: Option<f64>, now_s: f64) {
        if self.allowed != allowed {
            self.allowed = allowed;
            self.owed = self.used(now_s);
            self.owed_at_s = now_s;
        }
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

    /// Lets what is owed shrink until now.
    fn make_up(&mut self, now_s: f64) {
        let rate = self.allowed.unwrap_or(0.0) / self.length_s;
        self.owed = (self.owed - rate * (now_s - self.owed_at_s)).max(0.0);
        self.owed_at_s = now_s;
    }

    /// Adds use.
    pub(super) fn add(&mut self, amount: f64, now_s: f64) {
        self.turn(now_s);
        self.make_up(now_s);
        self.present += amount;
        self.owed += amount;
    }

    /// The use within the last window length.
    pub(super) fn used(&mut self, now_s: f64) -> f64 {
        self.turn(now_s);
        let elapsed = (now_s - self.begun_s) / self.length_s;
        self.present + self.before * (1.0 - elapsed)
    }

    /// The use that is owed beyond what is allowed; `None` if use is allowed now.
    pub(super) fn excess(&mut self, now_s: f64) -> Option<Excess> {
        let allowed = self.allowed?;
        self.make_up(now_s);
        if self.owed < allowed {
            return None;
        }
        let beyond = self.owed - allowed;
        let delay_s = beyond / (allowed / self.length_s);
        // Where nothing is allowed, 0/0 is not a number.
        let delay_s = if delay_s.is_finite() { delay_s } else { DELAY_MAX_S };
        Some(Excess { beyond, delay: Duration::from_secs_f64(delay_s.clamp(0.001, DELAY_MAX_S)) })
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

    /// After the delay, and not before it, use is allowed again. Time before the first use is not
    /// saved up.
    #[test]
    fn the_delay_is_that_until_use_is_allowed() {
        for (amount, begun_s) in [(30.0, 2.0), (1000.0, 2.0), (30.0, 500.0)] {
            let mut window = Window::new(10.0);
            window.allow(Some(20.0), 0.0);
            assert_eq!(window.excess(1.0), None);
            window.add(amount, begun_s);
            let Excess { beyond, delay } = window.excess(begun_s).unwrap();
            let delay_s = delay.as_secs_f64();
            assert_eq!(beyond, amount - 20.0);
            assert!((delay_s - beyond / 2.0).abs() < 1e-9, "{delay_s}");
            assert!(window.clone().excess(begun_s + delay_s - 0.01).is_some());
            assert_eq!(window.excess(begun_s + delay_s + 0.01), None);
        }
        let mut unused = Window::new(10.0);
        unused.allow(Some(0.0), 0.0);
        assert_eq!(unused.excess(1.0).unwrap().delay, Duration::from_secs(600));
    }

    /// 1 a second is allowed. 100 at a time, whenever they are allowed, are 1 a second in the mean.
    #[test]
    fn large_uses_at_once_are_not_more_than_the_rate() {
        let (mut window, mut used) = (Window::new(10.0), 0.0);
        window.allow(Some(10.0), 0.0);
        for second in 0..10_000 {
            if window.excess(f64::from(second)).is_none() {
                window.add(100.0, f64::from(second));
                used += 100.0;
            }
        }
        assert!((9_900.0..=10_200.0).contains(&used), "{used}");
        // The same limit does not forgive, another one does.
        window.allow(Some(10.0), 10_030.0);
        assert!(window.excess(10_030.0).is_some());
        window.allow(Some(11.0), 10_030.0);
        assert_eq!(window.excess(10_030.0), None);
    }
}
