//! Loss of lock from lock time indicators.

use crate::gnss::GpsTime;

/// Range of lock times of an indicator: from `least_ms` to below `below_ms`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LockTime {
    pub(super) least_ms: u64,
    pub(super) below_ms: u64,
}

impl LockTime {
    /// The seven-bit indicator of DF013 and similar fields, in seconds.
    pub(super) const fn of_legacy(indicator: u64) -> Self {
        let least_s = Self::legacy_s(indicator);
        let below_ms =
            if 127 <= indicator { u64::MAX } else { Self::legacy_s(indicator + 1) * 1000 };
        Self { least_ms: least_s * 1000, below_ms }
    }

    const fn legacy_s(indicator: u64) -> u64 {
        match indicator {
            0..=23 => indicator,
            24..=47 => 2 * indicator - 24,
            48..=71 => 4 * indicator - 120,
            72..=95 => 8 * indicator - 408,
            96..=119 => 16 * indicator - 1176,
            120..=126 => 32 * indicator - 3096,
            _ => 937,
        }
    }

    /// The four-bit indicator of DF402: 0, then powers of two from 32 ms.
    pub(super) const fn of_four_bits(indicator: u64) -> Self {
        let least_ms = if indicator == 0 { 0 } else { 16 << indicator };
        let below_ms = if 15 <= indicator { u64::MAX } else { 32 << indicator };
        Self { least_ms, below_ms }
    }

    /// The ten-bit indicator of DF407: 1 ms up to 64 ms, then steps that double every 32 values.
    pub(super) const fn of_ten_bits(indicator: u64) -> Self {
        let below_ms = if 704 <= indicator { u64::MAX } else { Self::ten_bits_ms(indicator + 1) };
        Self { least_ms: Self::ten_bits_ms(indicator), below_ms }
    }

    const fn ten_bits_ms(indicator: u64) -> u64 {
        if indicator < 64 {
            return indicator;
        }
        // 704 is the last value; 705 to 1023 are reserved and treated as 704.
        let indicator = if 704 < indicator { 704 } else { indicator };
        let power = (indicator - 32) / 32;
        (indicator - 32 * power) << power
    }
}

/// A phase of a signal, by the signal's number.
#[derive(Clone, Copy, Debug)]
struct Phase {
    signal: usize,
    time: GpsTime,
    lock: LockTime,
}

/// The last lock time of each signal that was observed: some hundred of 14,000. A service has a
/// table for each receiver.
#[derive(Debug, Default)]
pub(super) struct LockTable {
    /// In order of the signals.
    last: Vec<Phase>,
}

impl LockTable {
    /// Whether lock may have been lost since the last phase of the signal, and stores this phase;
    /// true for its first phase.
    pub(super) fn is_lost(&mut self, signal: usize, time: GpsTime, lock: LockTime) -> bool {
        let now = Phase { signal, time, lock };
        match self.last.binary_search_by_key(&signal, |phase| phase.signal) {
            Err(place) => {
                self.last.insert(place, now);
                true
            }
            Ok(place) => {
                let last = std::mem::replace(&mut self.last[place], now);
                let since_ms = (time - last.time) * 1e3;
                lock.least_ms < last.lock.least_ms || (lock.below_ms as f64) <= since_ms
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indicators_of_the_tables() {
        let legacy = |i| (LockTime::of_legacy(i).least_ms, LockTime::of_legacy(i).below_ms);
        // RTCM 10403.3, table 3.4-2.
        assert_eq!((legacy(0), legacy(23)), ((0, 1000), (23_000, 24_000)));
        assert_eq!((legacy(24), legacy(119)), ((24_000, 26_000), (728_000, 744_000)));
        assert_eq!((legacy(126), legacy(127)), ((936_000, 937_000), (937_000, u64::MAX)));
        // Table 3.5-74.
        let four = |i| (LockTime::of_four_bits(i).least_ms, LockTime::of_four_bits(i).below_ms);
        assert_eq!((four(0), four(1), four(15)), ((0, 32), (32, 64), (524_288, u64::MAX)));
        // Table 3.5-75.
        let ten = |i| (LockTime::of_ten_bits(i).least_ms, LockTime::of_ten_bits(i).below_ms);
        assert_eq!((ten(63), ten(64), ten(95)), ((63, 64), (64, 66), (126, 128)));
        assert_eq!((ten(96), ten(704)), ((128, 132), (67_108_864, u64::MAX)));
    }

    #[test]
    fn lock_is_lost_where_it_cannot_reach_back() {
        let mut table = LockTable::default();
        let at = |seconds: f64| GpsTime::from_week_seconds(2100, seconds);
        let lock = LockTime::of_four_bits;
        assert!(table.is_lost(0, at(0.0), lock(4)), "nothing before it is known");
        assert!(!table.is_lost(0, at(1.0), lock(5)), "512 to 1024 ms reach back 1 s");
        assert!(!table.is_lost(0, at(1.2), lock(5)), "may stand still");
        assert!(table.is_lost(0, at(10.0), lock(5)), "began within the 8.8 s");
        assert!(table.is_lost(0, at(10.1), lock(4)), "fell");
        assert!(table.is_lost(9, at(10.1), lock(4)) && table.is_lost(5, at(10.1), lock(4)));
        assert!(!table.is_lost(9, at(10.2), lock(4)) && !table.is_lost(0, at(10.2), lock(4)));
    }
}
