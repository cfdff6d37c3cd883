//! Integers by the period in which they were held, for the revision of earlier epochs.

use crate::gnss::GpsTime;
use crate::positioning::rtk::observed::{CarrierArc, HeldInteger};
use crate::snapshot::{snapshot_fields, state_fields};

use super::hold::HoldState;

/// The integer of an arc in one period.
#[derive(Clone, Copy, Debug)]
struct KnownInteger {
    /// Serial number of the arc.
    serial: u64,
    held: HeldInteger,
    period: u32,
    /// Newest epoch of the arc with that integer.
    last: GpsTime,
}

/// The time between two drops of all integers, with what is known of its integers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HoldPeriod {
    pub(crate) number: u32,
    /// Whether the integers were confirmed in this period.
    pub(crate) was_confirmed: bool,
    /// Whether the integers were found to be wrong.
    is_refuted: bool,
    pub(crate) probability: f64,
    /// [`HoldState::reliability`].
    pub(crate) reliability: f64,
    pub(crate) ratio: Option<f64>,
    pub(crate) success_rate: Option<f64>,
}

/// Integers of all arcs that unrevised epochs refer to.
#[derive(Debug, Default)]
pub(crate) struct IntegerHistory {
    /// By arc, then by datum.
    known: Vec<KnownInteger>,
    /// By number.
    periods: Vec<HoldPeriod>,
}

snapshot_fields!(KnownInteger { serial, held, period, last });
snapshot_fields!(HoldPeriod {
    number,
    was_confirmed,
    is_refuted,
    probability,
    reliability,
    ratio,
    success_rate,
});
state_fields!(IntegerHistory { known, periods });

impl IntegerHistory {
    /// Records the integers held after an epoch.
    pub(crate) fn learn(&mut self, arcs: &[CarrierArc], hold: &HoldState) {
        if let Some(refuted) = hold.refuted
            && let Ok(index) = self.periods.binary_search_by_key(&refuted, |period| period.number)
        {
            self.periods[index].is_refuted = true;
        }
        let mut holding = arcs.iter().filter_map(|arc| Some((arc, arc.held?))).peekable();
        if holding.peek().is_none() {
            return;
        }
        let period = HoldPeriod {
            number: hold.period,
            was_confirmed: hold.was_confirmed,
            is_refuted: false,
            probability: hold.probability,
            reliability: hold.reliability,
            ratio: hold.ratio,
            success_rate: hold.success_rate,
        };
        match self.periods.last_mut().filter(|last| last.number == period.number) {
            Some(last) => *last = period,
            None => self.periods.push(period),
        }
        for (arc, held) in holding {
            let (serial, last) = (arc.serial, arc.last);
            let key = (serial, held.datum);
            match self.known.binary_search_by_key(&key, |known| (known.serial, known.held.datum)) {
                Ok(index) => (self.known[index].held, self.known[index].last) = (held, last),
                Err(index) => {
                    self.known
                        .insert(index, KnownInteger { serial, held, period: hold.period, last });
                }
            }
        }
    }

    /// Forgets the integers of arcs without a phase since `time`.
    pub(crate) fn forget_before(&mut self, time: GpsTime) {
        self.known.retain(|known| time <= known.last);
        let Self { known, periods } = self;
        let newest = periods.last().map(|period| period.number);
        periods.retain(|period| {
            Some(period.number) == newest || known.iter().any(|known| known.period == period.number)
        });
    }

    fn of(&self, serial: u64) -> &[KnownInteger] {
        let begin = self.known.partition_point(|known| known.serial < serial);
        let end = begin + self.known[begin..].partition_point(|known| known.serial == serial);
        &self.known[begin..end]
    }

    /// The periods that are not refuted and have integers of some of the arcs: the most integers
    /// first, and of equal numbers the newest first.
    pub(crate) fn not_refuted(&self, serials: impl Iterator<Item = u64>) -> Vec<&HoldPeriod> {
        let mut numbers: Vec<u32> =
            serials.flat_map(|serial| self.of(serial)).map(|known| known.period).collect();
        numbers.sort_unstable();
        let mut counts: Vec<(usize, u32)> =
            numbers.chunk_by(|a, b| a == b).map(|same| (same.len(), same[0])).collect();
        counts.sort_unstable_by(|a, b| b.cmp(a));
        let period = |(_, number): &(usize, u32)| {
            let index = self.periods.binary_search_by_key(number, |period| period.number).ok()?;
            Some(&self.periods[index]).filter(|period| !period.is_refuted)
        };
        counts.iter().filter_map(period).collect()
    }

    /// The integer of an arc in a period; if there are two, the newer one.
    pub(crate) fn find(&self, serial: u64, period: u32) -> Option<HeldInteger> {
        let found = self.of(serial).iter().rev().find(|known| known.period == period);
        found.map(|known| known.held)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Band, Constellation, ObservationCode, SatelliteId};

    fn arc(serial: u64, held: Option<(u32, i64)>, last_s: f64) -> CarrierArc {
        let code = ObservationCode::parse("1C").unwrap();
        CarrierArc {
            satellite: SatelliteId::new(Constellation::Gps, 7).unwrap(),
            band: Band::L1,
            codes: [code; 2],
            variable: serial as usize,
            serial,
            frequency_hz: 1.57542e9,
            last: GpsTime::EPOCH + last_s,
            unobserved_s: 0.0,
            epochs: 1,
            half_cycle: false,
            elevation_rad: 1.0,
            code_minus_phase_m: None,
            held: held.map(|(datum, cycles)| HeldInteger { datum, cycles }),
            found: 1,
            is_proven: true,
        }
    }

    fn numbers(history: &IntegerHistory, serials: &[u64]) -> Vec<u32> {
        history.not_refuted(serials.iter().copied()).iter().map(|period| period.number).collect()
    }

    /// Period 0 holds integers of arcs 1 to 3, period 1 of arcs 2 and 3, period 2 of arc 3 alone.
    #[test]
    fn the_fullest_period_comes_first_until_it_is_refuted() {
        let mut history = IntegerHistory::default();
        let mut hold = HoldState { was_confirmed: true, ..HoldState::default() };
        history.learn(&[1, 2, 3].map(|serial| arc(serial, Some((1, 10)), 0.0)), &hold);
        hold.period = 1;
        history.learn(&[2, 3].map(|serial| arc(serial, Some((2, 20)), 1.0)), &hold);
        hold.period = 2;
        history.learn(&[arc(2, None, 2.0), arc(3, Some((3, 30)), 2.0)], &hold);
        assert_eq!(numbers(&history, &[1, 2, 3]), [0, 1, 2]);
        assert_eq!(numbers(&history, &[3]), [2, 1, 0]);
        assert_eq!(history.find(3, 1), Some(HeldInteger { datum: 2, cycles: 20 }));
        assert_eq!(history.find(2, 2), None);
        hold.refuted = Some(0);
        history.learn(&[], &hold);
        assert_eq!(numbers(&history, &[1, 2, 3]), [1, 2]);
        // Arc 2 held its integer of period 1 until 1 s.
        history.forget_before(GpsTime::EPOCH + 1.5);
        assert_eq!(numbers(&history, &[1, 2, 3]), [2]);
        assert_eq!(history.find(2, 1), None);
    }
}
