//! Integers by when they were found, for epochs that are answered again.

use crate::gnss::GpsTime;
use crate::snapshot::{snapshot_fields, state_fields};

use super::arcs::{Arc, Label};
use super::integers::Trust;

/// The integer of an arc.
#[derive(Clone, Copy, Debug)]
struct Known {
    /// Of the arc.
    serial: u64,
    label: Label,
    era: u32,
    /// Newest epoch of the arc with that label.
    last: GpsTime,
}

/// Integers between two times that all were dropped.
#[derive(Clone, Copy, Debug)]
pub(super) struct Era {
    pub(super) number: u32,
    /// Enough epochs in a row have found them.
    pub(super) was_kept: bool,
    /// They were found to be wrong.
    is_refuted: bool,
    pub(super) probability: f64,
    pub(super) ratio: Option<f64>,
    pub(super) success_rate: Option<f64>,
}

/// Integers of arcs that live or lived when epochs not yet answered for good were.
#[derive(Debug, Default)]
pub(super) struct Labels {
    /// By arc, then by origin.
    known: Vec<Known>,
    /// By number.
    eras: Vec<Era>,
}

snapshot_fields!(Known { serial, label, era, last });
snapshot_fields!(Era { number, was_kept, is_refuted, probability, ratio, success_rate });
state_fields!(Labels { known, eras });

impl Labels {
    /// Takes what is known after an epoch.
    pub(super) fn learn(&mut self, arcs: &[Arc], trust: &Trust) {
        if let Some(refuted) = trust.refuted
            && let Ok(place) = self.eras.binary_search_by_key(&refuted, |era| era.number)
        {
            self.eras[place].is_refuted = true;
        }
        let mut labelled = arcs.iter().filter_map(|arc| Some((arc, arc.label?))).peekable();
        if labelled.peek().is_none() {
            return;
        }
        let era = Era {
            number: trust.era,
            was_kept: trust.was_kept,
            is_refuted: false,
            probability: trust.probability,
            ratio: trust.ratio,
            success_rate: trust.success_rate,
        };
        match self.eras.last_mut().filter(|last| last.number == era.number) {
            Some(last) => *last = era,
            None => self.eras.push(era),
        }
        for (arc, label) in labelled {
            let (serial, last) = (arc.serial, arc.last);
            let key = (serial, label.origin);
            match self.known.binary_search_by_key(&key, |known| (known.serial, known.label.origin))
            {
                Ok(place) => self.known[place].last = last,
                Err(place) => {
                    self.known.insert(place, Known { serial, label, era: trust.era, last });
                }
            }
        }
    }

    /// Forgets the integers of arcs that nothing after `time` has seen.
    pub(super) fn forget_before(&mut self, time: GpsTime) {
        self.known.retain(|known| time <= known.last);
        let Self { known, eras } = self;
        let newest = eras.last().map(|era| era.number);
        eras.retain(|era| {
            Some(era.number) == newest || known.iter().any(|known| known.era == era.number)
        });
    }

    fn of(&self, serial: u64) -> &[Known] {
        let begin = self.known.partition_point(|known| known.serial < serial);
        let end = begin + self.known[begin..].partition_point(|known| known.serial == serial);
        &self.known[begin..end]
    }

    /// The eras that have integers of some arcs, which nothing has refuted: those with the most
    /// first, of equals the newest.
    pub(super) fn standing(&self, serials: impl Iterator<Item = u64>) -> Vec<&Era> {
        let mut numbers: Vec<u32> =
            serials.flat_map(|serial| self.of(serial)).map(|known| known.era).collect();
        numbers.sort_unstable();
        let mut counts: Vec<(usize, u32)> =
            numbers.chunk_by(|a, b| a == b).map(|same| (same.len(), same[0])).collect();
        counts.sort_unstable_by(|a, b| b.cmp(a));
        let era = |(_, number): &(usize, u32)| {
            let place = self.eras.binary_search_by_key(number, |era| era.number).ok()?;
            Some(&self.eras[place]).filter(|era| !era.is_refuted)
        };
        counts.iter().filter_map(era).collect()
    }

    /// The label of an arc in an era; of two the newer.
    pub(super) fn find(&self, serial: u64, era: u32) -> Option<Label> {
        let found = self.of(serial).iter().rev().find(|known| known.era == era);
        found.map(|known| known.label)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Band, Constellation, ObservationCode, SatelliteId};

    fn arc(serial: u64, label: Option<(u32, i64)>, last_s: f64) -> Arc {
        let code = ObservationCode::parse("1C").unwrap();
        Arc {
            satellite: SatelliteId::new(Constellation::Gps, 7).unwrap(),
            band: Band::L1,
            codes: [code; 2],
            variable: serial as usize,
            serial,
            frequency_hz: 1.57542e9,
            last: GpsTime::EPOCH + last_s,
            epochs: 1,
            half_cycle: false,
            elevation_rad: 1.0,
            label: label.map(|(origin, integer)| Label { origin, integer }),
        }
    }

    fn numbers(labels: &Labels, serials: &[u64]) -> Vec<u32> {
        labels.standing(serials.iter().copied()).iter().map(|era| era.number).collect()
    }

    /// Era 0 labels arcs 1 to 3, era 1 arcs 2 and 3, era 2 arc 3 alone.
    #[test]
    fn the_fullest_era_comes_first_until_it_is_refuted() {
        let mut labels = Labels::default();
        let mut trust = Trust { was_kept: true, ..Trust::default() };
        labels.learn(&[1, 2, 3].map(|serial| arc(serial, Some((1, 10)), 0.0)), &trust);
        trust.era = 1;
        labels.learn(&[2, 3].map(|serial| arc(serial, Some((2, 20)), 1.0)), &trust);
        trust.era = 2;
        labels.learn(&[arc(2, None, 2.0), arc(3, Some((3, 30)), 2.0)], &trust);
        assert_eq!(numbers(&labels, &[1, 2, 3]), [0, 1, 2]);
        assert_eq!(numbers(&labels, &[3]), [2, 1, 0]);
        assert_eq!(labels.find(3, 1), Some(Label { origin: 2, integer: 20 }));
        assert_eq!(labels.find(2, 2), None);
        trust.refuted = Some(0);
        labels.learn(&[], &trust);
        assert_eq!(numbers(&labels, &[1, 2, 3]), [1, 2]);
        // Arc 2 had its label of era 1 until 1 s.
        labels.forget_before(GpsTime::EPOCH + 1.5);
        assert_eq!(numbers(&labels, &[1, 2, 3]), [2]);
        assert_eq!(labels.find(2, 1), None);
    }
}
