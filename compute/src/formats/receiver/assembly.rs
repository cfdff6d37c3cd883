//! Assembles messages into epochs.

use crate::formats::binary::Refusal;
use crate::gnss::{Epoch, GpsTime, Observation};

/// Time tags this close belong to one epoch (s); no receiver measures at 200 Hz.
const SAME_EPOCH_S: f64 = 0.004;
/// Largest number of observations in an epoch; MSM of five systems has 320.
const OBSERVATIONS_LIMIT: usize = 1024;

/// Quality of a source of observations, in ascending order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Rank {
    /// The older messages of RTCM 3.
    Legacy,
    /// Multiple signal messages (MSM) of RTCM 3.
    Msm,
    /// RXM-RAWX, one message for the whole epoch.
    Rawx,
}

/// Observations of one epoch, possibly incomplete.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) rank: Rank,
    pub(super) station: u16,
    pub(super) time: GpsTime,
    pub(super) more: bool,
    pub(super) observations: Vec<Observation>,
}

/// Collects the messages of an epoch.
///
/// An epoch ends where a message states that no more follow. The assembly waits for the next epoch
/// instead if messages of a better source have been seen, since they may follow, or if messages
/// came after the end of their epoch, since the stream's statement is then unreliable.
#[derive(Debug, Default)]
pub(super) struct Assembly {
    pending: Option<Part>,
    best: Option<Rank>,
    /// Time and source of the last epoch passed on.
    last: Option<(GpsTime, Rank)>,
    ends_are_wrong: bool,
    /// Whether UBX has been seen, so that RXM-RAWX may follow.
    expects_rawx: bool,
}

/// The effect of a message: completed epochs, and the reason if it was left out.
#[derive(Debug, Default)]
pub(super) struct Assembled {
    pub(super) epochs: [Option<Epoch>; 2],
    pub(super) refusal: Option<Refusal>,
    pub(super) duplicates: usize,
}

impl Assembly {
    /// Notes that the stream holds UBX.
    pub(super) const fn expect_rawx(&mut self) {
        self.expects_rawx = true;
    }

    pub(super) fn add(&mut self, part: Part) -> Assembled {
        let mut assembled = Assembled::default();
        let has_rawx = self.best == Some(Rank::Rawx);
        if has_rawx && part.rank != Rank::Rawx {
            assembled.refusal = Some(Refusal::Superseded);
            return assembled;
        }
        if part.rank == Rank::Rawx && !has_rawx && self.pending.take().is_some() {
            assembled.refusal = Some(Refusal::Superseded);
        }
        self.best = self.best.max(Some(part.rank));
        if let Some((time, rank)) = self.last
            && is_same(time, part.time)
        {
            self.ends_are_wrong |= rank == part.rank;
            let is_worse = part.rank < rank;
            assembled.refusal = Some(if is_worse { Refusal::Superseded } else { Refusal::Late });
            return assembled;
        }
        let belongs = self
            .pending
            .as_ref()
            .is_some_and(|p| is_same(p.time, part.time) && p.station == part.station);
        if !belongs {
            assembled.epochs[0] = self.flush(&mut assembled.duplicates);
        }
        let is_end = !part.more;
        if let Some(refusal) = self.merge(part) {
            assembled.refusal = Some(refusal);
        }
        if is_end && !self.waits() {
            assembled.epochs[1] = self.flush(&mut assembled.duplicates);
        }
        assembled
    }

    /// The pending epoch, when a message without observations states that it is complete.
    pub(super) fn end(&mut self) -> Option<Epoch> {
        if self.waits() { None } else { self.finish() }
    }

    /// The pending epoch, at the end of the stream.
    pub(super) fn finish(&mut self) -> Option<Epoch> {
        self.flush(&mut 0)
    }

    fn waits(&self) -> bool {
        let rank = self.pending.as_ref().map(|pending| pending.rank);
        match rank {
            Some(Rank::Rawx) => false,
            rank => self.ends_are_wrong || rank < self.best || self.expects_rawx,
        }
    }

    fn merge(&mut self, part: Part) -> Option<Refusal> {
        match &mut self.pending {
            Some(pending) if part.rank < pending.rank => Some(Refusal::Superseded),
            Some(pending) if part.rank == pending.rank => {
                let space = OBSERVATIONS_LIMIT.saturating_sub(pending.observations.len());
                let fits = part.observations.len() <= space;
                pending.observations.extend(part.observations.into_iter().take(space));
                (!fits).then_some(Refusal::DuplicateSignal)
            }
            pending => pending.replace(part).map(|_| Refusal::Superseded),
        }
    }

    /// The pending epoch, sorted by satellite, each signal once.
    fn flush(&mut self, duplicates: &mut usize) -> Option<Epoch> {
        let Part { rank, time, mut observations, .. } = self.pending.take()?;
        self.last = Some((time, rank));
        observations.sort_by_key(|o| (o.satellite, o.code));
        let before = observations.len();
        observations.dedup_by_key(|o| (o.satellite, o.code));
        *duplicates += before - observations.len();
        Some(Epoch { observations, ..Epoch::new(time) })
    }
}

fn is_same(a: GpsTime, b: GpsTime) -> bool {
    (a - b).abs() < SAME_EPOCH_S
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{ObservationCode, SatelliteId};

    fn part(rank: Rank, second: f64, more: bool, satellite: &str) -> Part {
        let satellite: SatelliteId = satellite.parse().unwrap();
        let code = ObservationCode::parse("1C").unwrap();
        Part {
            rank,
            station: 7,
            time: GpsTime::from_week_seconds(2100, second),
            more,
            observations: vec![Observation::empty(satellite, code)],
        }
    }

    fn epochs(parts: Vec<Part>) -> Vec<String> {
        let mut assembly = Assembly::default();
        let mut found = Vec::new();
        let mut name = |epoch: Epoch| {
            let names: Vec<_> =
                epoch.observations.iter().map(|o| o.satellite.to_string()).collect();
            found.push(format!("{} {}", epoch.time.seconds_of_week(), names.join(" ")));
        };
        for part in parts {
            assembly.add(part).epochs.into_iter().flatten().for_each(&mut name);
        }
        assembly.finish().into_iter().for_each(&mut name);
        found
    }

    #[test]
    fn messages_of_an_epoch_are_one() {
        let parts = vec![
            part(Rank::Msm, 1.0, true, "G05"),
            part(Rank::Msm, 1.0, false, "E01"),
            part(Rank::Msm, 2.0, true, "G05"),
            part(Rank::Msm, 3.0, true, "G06"),
        ];
        assert_eq!(epochs(parts), ["1 G05 E01", "2 G05", "3 G06"]);
    }

    #[test]
    fn better_messages_win() {
        let parts = vec![
            part(Rank::Msm, 1.0, false, "G01"),
            part(Rank::Legacy, 1.0, false, "G02"),
            part(Rank::Legacy, 2.0, false, "G03"),
            part(Rank::Msm, 2.0, false, "G04"),
            part(Rank::Legacy, 3.0, false, "G05"),
            part(Rank::Legacy, 4.0, false, "G06"),
        ];
        assert_eq!(epochs(parts), ["1 G01", "2 G04", "3 G05", "4 G06"]);
    }

    #[test]
    fn beside_rawx_nothing_else_counts() {
        let parts = vec![
            part(Rank::Rawx, 1.0, false, "G01"),
            part(Rank::Msm, 1.2, false, "G02"),
            part(Rank::Rawx, 2.0, false, "G03"),
        ];
        assert_eq!(epochs(parts), ["1 G01", "2 G03"]);
    }

    #[test]
    fn a_base_whose_rawx_follow_gives_those() {
        let mut assembly = Assembly::default();
        assembly.expect_rawx();
        assert!(assembly.add(part(Rank::Msm, 1.0, false, "G02")).epochs[1].is_none());
        let rawx = assembly.add(part(Rank::Rawx, 1.0, false, "G01"));
        assert_eq!(rawx.refusal, Some(Refusal::Superseded));
        let first = rawx.epochs[1].as_ref().unwrap();
        assert_eq!(first.observations[0].satellite.to_string(), "G01");
    }

    #[test]
    fn ends_that_are_wrong_are_not_relied_on() {
        let parts = vec![
            part(Rank::Msm, 1.0, false, "G01"),
            part(Rank::Msm, 1.0, false, "E01"),
            part(Rank::Msm, 2.0, false, "G01"),
            part(Rank::Msm, 2.0, false, "E01"),
        ];
        assert_eq!(epochs(parts), ["1 G01", "2 G01 E01"]);
    }
}
