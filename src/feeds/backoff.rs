//! Delays between attempts.

use std::time::Duration;

use uuid::Uuid;

/// Delays between attempts. Each is twice the previous one, up to a ceiling. The delay is drawn at
/// random between half of this and all of it, so that clients that lost the same caster do not
/// return at the same moment.
#[derive(Clone, Debug)]
pub(crate) struct Backoff {
    first: Duration,
    ceiling: Duration,
    next: Duration,
}

impl Backoff {
    /// Delays from `first` to `ceiling`.
    pub(crate) const fn new(first: Duration, ceiling: Duration) -> Self {
        Self { first, ceiling, next: first }
    }

    /// The next delay, but at least the delay `asked` for by the host, which may be zero.
    pub(crate) fn next(&mut self, asked: Option<Duration>) -> Duration {
        // The quality of these random bits does not matter.
        let fraction = f64::from(Uuid::new_v4().as_fields().0) / f64::from(u32::MAX);
        let delay = self.next.mul_f64(0.5 + 0.5 * fraction);
        self.next = (self.next * 2).min(self.ceiling);
        asked.map_or(delay, |asked| delay.max(asked + delay.min(asked)))
    }

    /// Starts again with the first delay. Call it after a success that lasted.
    pub(crate) const fn reset(&mut self) {
        self.next = self.first;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_to_a_ceiling_and_differ() {
        let (first, ceiling) = (Duration::from_secs(1), Duration::from_secs(60));
        let mut backoff = Backoff::new(first, ceiling);
        let mut most = first;
        let mut seen = std::collections::BTreeSet::new();
        for _ in 0..40 {
            let delay = backoff.next(None);
            assert!(most / 2 <= delay && delay <= most, "{delay:?} of {most:?}");
            most = (most * 2).min(ceiling);
            seen.insert(delay);
        }
        assert!(30 < seen.len(), "no jitter");
        let asked = Duration::from_secs(7);
        assert!(asked <= backoff.next(Some(asked)));
        // A host that asks for no delay does not switch the delays off.
        let least = backoff.next(Some(Duration::ZERO));
        assert!(ceiling / 2 <= least, "{least:?}");
        backoff.reset();
        assert!(backoff.next(None) <= first);
    }
}
