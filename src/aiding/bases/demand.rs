//! Which parts of time rovers need of a base, for archives that hold it in files.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::gnss::GpsTime;

/// Length of a part (ns): no archive has shorter files.
const PART_NS: i64 = 900_000_000_000;
/// A part is asked for so long before it is needed (s): rovers may be played quickly.
const AHEAD_S: f64 = 60.0;
/// Parts of one asking, and parts that are kept in mind: a week.
const PARTS_LIMIT: usize = 7 * 96;
/// A part that nobody has asked for so long is needed no more (ms).
const FORGOTTEN_MS: i64 = 86_400_000;

/// The parts that were asked for of late.
#[derive(Debug, Default)]
pub(super) struct Demand {
    /// By number of the part: when it was last asked for (ms since 1970-01-01 UTC).
    parts: Mutex<BTreeMap<i64, i64>>,
    news: Notify,
}

impl Demand {
    /// Notes that epochs from `from` until `until` are to be positioned.
    pub(super) fn note(&self, from: GpsTime, until: GpsTime, now_unix_ms: i64) {
        let part = |time: GpsTime| time.as_ns().div_euclid(PART_NS);
        let asked = (part(from)..=part(until + AHEAD_S)).take(PARTS_LIMIT);
        let mut parts = self.parts();
        // All are noted, though the others be known.
        let new = asked.filter(|part| parts.insert(*part, now_unix_ms).is_none()).count();
        while PARTS_LIMIT < parts.len() {
            parts.pop_first();
        }
        if 0 < new {
            self.news.notify_one();
        }
    }

    /// When the parts begin that are needed, in order.
    pub(super) fn needed(&self, now_unix_ms: i64) -> Vec<GpsTime> {
        let mut parts = self.parts();
        parts.retain(|_, asked| now_unix_ms < *asked + FORGOTTEN_MS);
        parts.keys().map(|part| GpsTime::from_ns(part * PART_NS)).collect()
    }

    /// Waits until a part is asked for that was not.
    pub(super) async fn news(&self) {
        self.news.notified().await;
    }

    fn parts(&self) -> MutexGuard<'_, BTreeMap<i64, i64>> {
        self.parts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_needed_until_nobody_asks() {
        let demand = Demand::default();
        let at = |minutes: f64| GpsTime::from_week_seconds(2300, minutes * 60.0);
        demand.note(at(10.0), at(13.5), 0);
        assert_eq!(demand.needed(1), [at(0.0)]);
        demand.note(at(14.5), at(31.0), 1000);
        assert_eq!(demand.needed(1), [at(0.0), at(15.0), at(30.0)]);
        demand.note(at(31.0), at(31.0), 5000);
        assert_eq!(demand.needed(1000 + FORGOTTEN_MS), [at(30.0)]);
        // Epochs of a year in one push do not make the service fetch it.
        demand.note(at(0.0), at(1e6), 5000);
        assert_eq!(demand.needed(5000).len(), PARTS_LIMIT);
    }
}
