//! Losses of lock of the receivers, reported or possible.

use crate::gnss::{Epoch, GpsTime, ObservationCode, SatelliteId};
use crate::snapshot::{snapshot_fields, state_fields};

/// A carrier that a receiver tracks.
pub(crate) type Tracked = (SatelliteId, ObservationCode);

/// Carriers on which either receiver may have slipped since the last epoch.
#[derive(Debug)]
pub(crate) struct Losses {
    /// All carriers: a receiver lost power, the base moved, or each epoch is solved alone.
    pub(crate) all: bool,
    pub(crate) rover: Vec<Tracked>,
    pub(crate) base: Vec<Tracked>,
    /// Probability that both receivers have kept lock in the time in which their epochs are
    /// missing.
    pub(crate) survival: f64,
    /// Time since the rover's last epoch in which its epochs are missing (s).
    pub(crate) unobserved_s: f64,
}

impl Default for Losses {
    /// No losses.
    fn default() -> Self {
        let (rover, base) = (Vec::new(), Vec::new());
        Self { all: false, rover, base, survival: 1.0, unobserved_s: 0.0 }
    }
}

impl Losses {
    /// Whether the carrier with these codes at rover and base is among them.
    pub(crate) fn has(&self, satellite: SatelliteId, codes: [ObservationCode; 2]) -> bool {
        self.all
            || self.rover.contains(&(satellite, codes[0]))
            || self.base.contains(&(satellite, codes[1]))
    }
}

/// A receiver's epoch is missing if the interval is at least this many usual ones.
const MISSING_INTERVALS: f64 = 1.5;
/// A carrier with a smaller probability of being unslipped has more likely slipped.
pub(crate) const MORE_LIKELY: f64 = 0.5;
/// Time constant of the evidence on the rate of losses (s), as that of the receiver's surroundings
/// in [`crate::positioning::receiver`].
const RATE_LASTS_S: f64 = 300.0;
/// The usual interval follows a longer one by at most this factor an epoch.
const USUAL_GROWTH: f64 = 2.0;

/// A carrier that a receiver has tracked.
#[derive(Clone, Copy, Debug)]
struct Lock {
    carrier: Tracked,
    /// Time of its first phase since it was lost, later by the time not observed since then.
    since: GpsTime,
    /// Time of its last phase.
    last: GpsTime,
    /// Time since its last phase in which epochs of the receiver are missing (s).
    unobserved_s: f64,
}

impl Lock {
    /// Probability that the carrier has not slipped since its last phase.
    fn survival(&self, rate: &LossRate) -> f64 {
        rate.survival(self.last - self.since, self.unobserved_s)
    }
}

/// How often a receiver loses lock.
#[derive(Clone, Copy, Debug, Default)]
struct LossRate {
    /// Losses of lock that it has reported, of carriers with a phase within `gap_s` before.
    losses: f64,
    /// Time for which it was seen to track carriers, summed over the carriers (s).
    tracked_s: f64,
}

impl LossRate {
    /// Lets the evidence fade over an interval.
    fn fade(&mut self, interval_s: f64) {
        let kept = (-interval_s / RATE_LASTS_S).exp();
        self.losses *= kept;
        self.tracked_s *= kept;
    }

    /// Mean time between losses (s), of which one more is counted than was reported: zero before
    /// any evidence.
    fn mean_interval_s(&self) -> f64 {
        self.tracked_s / (self.losses + 1.0)
    }

    /// Probability that a carrier has not slipped in `unobserved_s`, after it was tracked without a
    /// loss for `tracked_s`.
    ///
    /// P = (m + t)/(m + t + u) with the mean interval m, the tracked time t and the unobserved time
    /// u. Carriers have different rates η of losses, constant in time. Their prior is exponential
    /// with the mean 1/m, so that η has the density (m + t)·e^(−η(m + t)) after the time t, and P
    /// is the mean of e^(−ηu).
    ///
    /// Source: the conjugate prior of a Poisson rate, Gelman et al. (2013), *Bayesian data
    /// analysis*, 3rd ed.
    fn survival(&self, tracked_s: f64, unobserved_s: f64) -> f64 {
        let known_s = self.mean_interval_s() + tracked_s;
        match 0.0 < unobserved_s {
            true => known_s / (known_s + unobserved_s),
            false => 1.0,
        }
    }
}

/// What an epoch of a receiver shows about the time since its last one.
pub(crate) struct Watched {
    /// Probability that the receiver as a whole has kept lock: that of the carrier which it has
    /// tracked longest.
    pub(crate) survival: f64,
    /// Time in which epochs are missing (s).
    pub(crate) unobserved_s: f64,
}

/// Whether one receiver reports losses of lock, and for how long it has tracked its carriers.
///
/// An indicator that is not set means "OK or not known" (RINEX 2 and 3, loss of lock indicator). So
/// until a receiver has reported a loss, a carrier without a phase in the last epoch may have
/// slipped. A flag refers to the time since the last *recorded* epoch. If epochs are missing, their
/// flags are missing, too. A carrier counts as lost if it has more likely slipped than not in the
/// missing time.
#[derive(Debug, Default)]
pub(crate) struct LockWatch {
    /// Whether the receiver has ever reported a loss.
    reports: bool,
    /// Time of the last epoch.
    last: Option<GpsTime>,
    /// Usual interval between epochs (s); zero before the second epoch.
    usual_s: f64,
    rate: LossRate,
    /// In order of the carriers.
    locks: Vec<Lock>,
}

snapshot_fields!(Lock { carrier, since, last, unobserved_s });
snapshot_fields!(LossRate { losses, tracked_s });
state_fields!(LockWatch { reports, last, usual_s, rate, locks });

impl LockWatch {
    /// Takes in an epoch; appends the carriers that may have slipped since their last phase.
    /// Carriers without a phase for `gap_s` of observed time are forgotten.
    pub(crate) fn take(&mut self, epoch: &Epoch, gap_s: f64, lost: &mut Vec<Tracked>) -> Watched {
        let unobserved_s = self.follow(epoch.time, gap_s);
        self.reports |= epoch.observations.iter().any(|observation| observation.loss_of_lock);
        let before = self.last.replace(epoch.time);
        let rate = if self.reports { self.rate } else { LossRate::default() };
        let survival = self.whole_survival(&rate, unobserved_s);
        for observation in &epoch.observations {
            let carrier = (observation.satellite, observation.code);
            let index = self.locks.binary_search_by_key(&carrier, |lock| lock.carrier);
            if observation.loss_of_lock {
                lost.push(carrier);
            }
            if observation.carrier_phase.is_none() {
                if let (true, Ok(index)) = (observation.loss_of_lock, index) {
                    self.locks.remove(index);
                    self.rate.losses += 1.0;
                }
                continue;
            }
            let (since, last) = (epoch.time, epoch.time);
            let new = Lock { carrier, since, last, unobserved_s: 0.0 };
            match index {
                Err(index) => {
                    self.locks.insert(index, new);
                    if !self.reports {
                        lost.push(carrier);
                    }
                }
                Ok(index) => {
                    let lock = &mut self.locks[index];
                    let is_doubtful = !self.reports && Some(lock.last) != before;
                    if observation.loss_of_lock {
                        *lock = new;
                        self.rate.losses += 1.0;
                    } else if is_doubtful || lock.survival(&rate) < MORE_LIKELY {
                        *lock = new;
                        lost.push(carrier);
                    } else {
                        self.rate.tracked_s += epoch.time - lock.last - lock.unobserved_s;
                        *lock = Lock { since: lock.since + lock.unobserved_s, ..new };
                    }
                }
            }
        }
        Watched { survival, unobserved_s }
    }

    /// Probability that the receiver as a whole has kept lock in the `unobserved_s` before this
    /// epoch, if it had until then: that of the carrier which it has tracked longest.
    fn whole_survival(&self, rate: &LossRate, unobserved_s: f64) -> f64 {
        let known_s = |lock: &Lock| lock.last - lock.since + lock.unobserved_s - unobserved_s;
        let of = |lock: &Lock| rate.survival(known_s(lock), unobserved_s);
        match 0.0 < unobserved_s {
            true => self.locks.iter().map(of).fold(0.0, f64::max),
            false => 1.0,
        }
    }

    /// Adds the interval up to an epoch; returns the part of it that was not observed (s).
    fn follow(&mut self, time: GpsTime, gap_s: f64) -> f64 {
        let interval_s = self.last.map_or(0.0, |last| time - last);
        self.rate.fade(interval_s);
        let is_missing = 0.0 < self.usual_s && MISSING_INTERVALS * self.usual_s <= interval_s;
        let unobserved_s = if is_missing { interval_s - self.usual_s } else { 0.0 };
        self.usual_s = match 0.0 < self.usual_s {
            true => interval_s.min(USUAL_GROWTH * self.usual_s),
            false => interval_s,
        };
        self.locks.iter_mut().for_each(|lock| lock.unobserved_s += unobserved_s);
        self.locks.retain(|lock| time - lock.last - lock.unobserved_s <= gap_s);
        unobserved_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Constellation, Cycles, GpsTime, Observation};

    /// A satellite with a phase, with its flag.
    fn observed(number: u8, loss_of_lock: bool) -> Observation {
        let satellite = SatelliteId::new(Constellation::Gps, number).unwrap();
        let code = ObservationCode::parse("1C").unwrap();
        let carrier_phase = Some(Cycles(1e8));
        Observation { carrier_phase, loss_of_lock, ..Observation::empty(satellite, code) }
    }

    /// The numbers of the satellites that may have slipped at each epoch.
    fn lost(epochs: &[&[Observation]]) -> Vec<Vec<u8>> {
        let mut watch = LockWatch::default();
        let slipped = |(second, observations): (usize, &&[Observation])| {
            let mut epoch = Epoch::new(GpsTime::EPOCH + second as f64);
            epoch.observations = observations.to_vec();
            let mut lost = Vec::new();
            watch.take(&epoch, 35.0, &mut lost);
            lost.iter().map(|(satellite, _)| satellite.number).collect()
        };
        epochs.iter().enumerate().map(slipped).collect()
    }

    #[test]
    fn without_any_flag_a_carrier_that_was_missing_may_have_slipped() {
        let [one, two] = [1, 2].map(|number| observed(number, false));
        let no_phase = Observation { carrier_phase: None, ..two };
        let epochs: [&[_]; 6] =
            [&[one, two], &[one], &[one, two], &[one, no_phase], &[one, two], &[one, two]];
        assert_eq!(lost(&epochs), [vec![1, 2], vec![], vec![2], vec![], vec![2], vec![]]);
    }

    #[test]
    fn a_receiver_that_has_flagged_a_loss_is_believed() {
        let [one, two, flagged] = [observed(1, false), observed(2, false), observed(2, true)];
        let epochs: [&[_]; 4] = [&[one, flagged], &[one], &[one, two], &[one, flagged]];
        assert_eq!(lost(&epochs), [vec![2], vec![], vec![], vec![2]]);
    }

    /// 300 carrier-seconds with two reported losses: one in 100 s, and a third one is assumed. A
    /// carrier tracked for 50 s survives 50 s with 150/200, and one just begun with 100/150. Before
    /// any evidence the tracked time alone counts.
    #[test]
    fn the_chance_of_a_slip_grows_with_the_time_not_observed() {
        let rate = LossRate { losses: 2.0, tracked_s: 300.0 };
        assert_eq!(rate.survival(50.0, 50.0), 0.75);
        assert!((rate.survival(0.0, 50.0) - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!(rate.survival(0.0, 0.0), 1.0);
        assert_eq!(LossRate::default().survival(10.0, 30.0), 0.25);
    }

    /// Satellite 1 from the first second on, satellite 2 from the eighth, each second until the
    /// tenth; then `missing` seconds without epochs, and both again. The flag of `flagged` at the
    /// first second makes the receiver one that reports.
    fn after_a_pause(missing: usize, flagged: bool) -> (Vec<u8>, Watched) {
        let mut watch = LockWatch::default();
        let (mut lost, mut watched) = (Vec::new(), None);
        for second in (0..=10).chain([11 + missing]) {
            let mut epoch = Epoch::new(GpsTime::EPOCH + second as f64);
            epoch.observations.push(observed(1, flagged && second == 0));
            epoch.observations.extend((8 <= second).then(|| observed(2, false)));
            lost.clear();
            watched = Some(watch.take(&epoch, 35.0, &mut lost));
        }
        (lost.iter().map(|(satellite, _)| satellite.number).collect(), watched.unwrap())
    }

    /// Without a pause no carrier is lost. Of a receiver that has not reported a loss, carriers
    /// tracked for 10 and 2 s survive pauses of up to 10 and 2 s. One that has reported a loss, at
    /// its first epoch, has tracked carriers for 12 s without another one: they survive 12 s more.
    #[test]
    fn a_carrier_is_lost_in_a_pause_longer_than_it_was_tracked() {
        let none: &[u8] = &[];
        for (missing, flagged, expected) in [
            (0, false, none),
            (2, false, none),
            (3, false, &[2]),
            (10, false, &[2]),
            (11, false, &[1, 2]),
            (13, true, none),
            (16, true, &[2]),
        ] {
            assert_eq!(after_a_pause(missing, flagged).0, expected, "{missing} {flagged}");
        }
        let watched = after_a_pause(0, false).1;
        assert_eq!((watched.survival, watched.unobserved_s), (1.0, 0.0));
        let watched = after_a_pause(5, false).1;
        assert_eq!((watched.survival, watched.unobserved_s), (10.0 / 15.0, 5.0));
    }

    /// Satellite 1 for 10 s, and then epochs at 16, 17 and 20 s, of which the first two have no
    /// phase. Each pause counts once: 10/(10 + 5) and 15/(15 + 2) are together 10/(10 + 7).
    #[test]
    fn an_epoch_without_phases_does_not_end_the_lock_of_a_receiver() {
        let mut watch = LockWatch::default();
        let mut lost = Vec::new();
        let mut survival = |second: u32| {
            let mut epoch = Epoch::new(GpsTime::EPOCH + f64::from(second));
            epoch.observations.extend((!(16..20).contains(&second)).then(|| observed(1, false)));
            lost.clear();
            watch.take(&epoch, 35.0, &mut lost).survival
        };
        assert!((0..=10).all(|second| survival(second) == 1.0));
        let [first, between, second] = [16, 17, 20].map(survival);
        assert_eq!(between, 1.0);
        assert!((first - 10.0 / 15.0).abs() < 1e-12);
        assert!((first * second - 10.0 / 17.0).abs() < 1e-12);
    }

    /// Epochs of 10 s and a pause of 4 s that the carrier survives are 11 s of tracking, of which
    /// less than a twentieth fades. A loss that is flagged without a phase counts. The flag of a
    /// carrier that was not tracked does not.
    #[test]
    fn evidence_on_the_rate_is_what_was_seen() {
        let mut watch = LockWatch::default();
        let mut take = |second: f64, observation: Observation| {
            let mut epoch = Epoch::new(GpsTime::EPOCH + second);
            epoch.observations.push(observation);
            watch.take(&epoch, 35.0, &mut Vec::new());
            (watch.rate, watch.locks.clone())
        };
        (0..=10).for_each(|second| drop(take(f64::from(second), observed(1, second == 0))));
        let (rate, locks) = take(15.0, observed(1, false));
        assert!((rate.tracked_s - 11.0).abs() < 0.5 && rate.losses == 0.0, "{rate:?}");
        assert_eq!(locks[0].last - locks[0].since, 11.0);
        let (rate, locks) = take(16.0, Observation { carrier_phase: None, ..observed(1, true) });
        assert!(rate.losses == 1.0 && locks.is_empty());
        let (rate, _) = take(17.0, observed(1, true));
        assert!((rate.losses - 1.0).abs() < 0.01, "{rate:?}");
    }

    /// Epochs each 30 s have no pause, nor does one that is late by a third. A pause that a single
    /// epoch interrupts is two pauses.
    #[test]
    fn the_usual_interval_is_no_pause() {
        let unobserved_s = |times: &[f64]| -> Vec<f64> {
            let mut watch = LockWatch::default();
            let epoch = |time: &f64| Epoch::new(GpsTime::EPOCH + *time);
            let take = |time| watch.take(&epoch(time), 35.0, &mut Vec::new()).unobserved_s;
            times.iter().map(take).collect()
        };
        assert_eq!(unobserved_s(&[0.0, 30.0, 60.0, 100.0]), [0.0; 4]);
        assert_eq!(unobserved_s(&[0.0, 1.0, 21.0, 41.0]), [0.0, 0.0, 19.0, 18.0]);
    }
}
