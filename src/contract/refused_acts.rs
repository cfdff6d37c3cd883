//! Limits the entries of refused calls in the audit log, so that nobody fills the log by refused
//! calls.
//!
//! An actor can cause [`BURST`] entries at once, and then one in each [`INTERVAL`]. An entry states
//! how many calls before it have no entry.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const BURST: u32 = 20;
const INTERVAL: Duration = Duration::from_secs(60);
/// Most actors that are counted at the same time.
const ACTORS: usize = 4096;

/// The remaining entries of refused calls of each actor.
#[derive(Debug, Default)]
pub(super) struct RefusedActs(Mutex<HashMap<String, Spent>>);

/// The used entries of an actor.
#[derive(Debug)]
struct Spent {
    /// The time until which its entries are used up.
    until: Instant,
    /// Number of calls without an entry since the last entry.
    left_out: u64,
}

impl RefusedActs {
    /// Counts a refused call of an actor. If the call gets an entry, returns the number of calls
    /// before it that got none.
    pub(super) fn count(&self, actor: &str, now: Instant) -> Option<u64> {
        let mut actors = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if ACTORS <= actors.len() && !actors.contains_key(actor) {
            actors.retain(|_, spent| now < spent.until);
            if ACTORS <= actors.len() {
                return None;
            }
        }
        let new = || Spent { until: now, left_out: 0 };
        let spent = actors.entry(actor.to_owned()).or_insert_with(new);
        let next = spent.until.max(now) + INTERVAL;
        if INTERVAL * BURST < next - now {
            spent.left_out += 1;
            return None;
        }
        spent.until = next;
        Some(std::mem::take(&mut spent.left_out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_actor_has_a_burst_of_entries_and_then_one_each_interval() {
        let (refused, start) = (RefusedActs::default(), Instant::now());
        for _ in 0..BURST {
            assert_eq!(refused.count("key_1", start), Some(0));
        }
        for _ in 0..7 {
            assert_eq!(refused.count("key_1", start), None);
        }
        assert_eq!(refused.count("key_2", start), Some(0));
        assert_eq!(refused.count("key_1", start + INTERVAL), Some(7));
        assert_eq!(refused.count("key_1", start + INTERVAL), None);
        assert_eq!(refused.count("key_1", start + 3 * INTERVAL), Some(1));
    }

    #[test]
    fn many_actors_take_bounded_memory() {
        let (refused, now) = (RefusedActs::default(), Instant::now());
        let counted = (0..2 * ACTORS).filter(|n| refused.count(&n.to_string(), now).is_some());
        assert_eq!(counted.count(), ACTORS);
        assert!(refused.count("another", now + INTERVAL).is_some());
        assert_eq!(refused.0.lock().unwrap().len(), 1);
    }
}
