//! The times for which rovers need a base, in quarters of an hour. An archive is asked only for the
//! files of these times.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use crate::gnss::GpsTime;
use crate::gnss::constants::SECONDS_PER_DAY;

/// One quarter of an hour (ns). No archive has shorter files.
const QUARTER_NS: i64 = 900_000_000_000;
/// Lead time (s): the next quarter is requested this long before it starts, because recorded rovers
/// may run faster than real time.
const LEAD_S: f64 = 60.0;
/// Most quarters in one request, and most that are remembered: one week.
const QUARTERS_LIMIT: usize = 7 * 96;
/// A quarter expires when nobody has requested it for this long (ms).
const EXPIRY_MS: i64 = SECONDS_PER_DAY as i64 * 1000;

/// The quarters that rovers have recently requested.
#[derive(Debug, Default)]
pub(super) struct ArchiveRequests {
    /// By number of the quarter: when it was last requested (ms since 1970-01-01 UTC).
    quarters: Mutex<BTreeMap<i64, i64>>,
    has_new: Notify,
}

impl ArchiveRequests {
    /// Requests the quarters in which epochs from `from` until `until` lie.
    pub(super) fn add(&self, from: GpsTime, until: GpsTime, now_unix_ms: i64) {
        let quarter = |time: GpsTime| time.as_ns().div_euclid(QUARTER_NS);
        let requested = (quarter(from)..=quarter(until + LEAD_S)).take(QUARTERS_LIMIT);
        let mut quarters = self.quarters();
        // `filter` runs for each quarter, so known ones are renewed.
        let new =
            requested.filter(|quarter| quarters.insert(*quarter, now_unix_ms).is_none()).count();
        while QUARTERS_LIMIT < quarters.len() {
            quarters.pop_first();
        }
        if 0 < new {
            self.has_new.notify_one();
        }
    }

    /// The start of each requested quarter, in order of time. Expired ones are dropped.
    pub(super) fn starts(&self, now_unix_ms: i64) -> Vec<GpsTime> {
        let mut quarters = self.quarters();
        quarters.retain(|_, requested| now_unix_ms < *requested + EXPIRY_MS);
        quarters.keys().map(|quarter| GpsTime::from_ns(quarter * QUARTER_NS)).collect()
    }

    /// Waits until a quarter is requested that was not requested before.
    pub(super) async fn wait_for_new(&self) {
        self.has_new.notified().await;
    }

    fn quarters(&self) -> MutexGuard<'_, BTreeMap<i64, i64>> {
        self.quarters.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_needed_until_nobody_asks() {
        let requests = ArchiveRequests::default();
        let at = |minutes: f64| GpsTime::from_week_seconds(2300, minutes * 60.0);
        requests.add(at(10.0), at(13.5), 0);
        assert_eq!(requests.starts(1), [at(0.0)]);
        requests.add(at(14.5), at(31.0), 1000);
        assert_eq!(requests.starts(1), [at(0.0), at(15.0), at(30.0)]);
        requests.add(at(31.0), at(31.0), 5000);
        assert_eq!(requests.starts(1000 + EXPIRY_MS), [at(30.0)]);
        // A push with epochs of a whole year does not make the service fetch that year.
        requests.add(at(0.0), at(1e6), 5000);
        assert_eq!(requests.starts(5000).len(), QUARTERS_LIMIT);
    }
}
