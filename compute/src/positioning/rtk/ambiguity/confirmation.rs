//! Confirms a fix by leaving out each satellite in turn: solution separation, applied to integers.
//!
//! Multipath on one satellite biases the float ambiguities, and the posterior probability does not
//! model it. A search without that satellite finds other integers, or none. So integers are
//! confirmed if the search finds them again without most of the satellites, left out one at a time,
//! and never finds other likely ones.
//!
//! The searches also say how far a fix depends on single satellites. With the probability ε that
//! one carrier is faulty, the mean of their probabilities counts as much as ε, the search with all
//! satellites as much as 1 − ε: Bayesian model averaging over who is faulty.
//!
//! Source: the idea is that of solution separation, Brown & McBurney (1988), *Self-contained GPS
//! integrity check using maximum solution separation*, Navigation 35(1), 41–53. Model averaging:
//! Hoeting, Madigan, Raftery & Volinsky (1999), *Bayesian model averaging: a tutorial*, Statistical
//! Science 14(4), 382–417.

use crate::gnss::SatelliteId;
use crate::snapshot::{snapshot_fields, snapshot_variants, state_fields};

use super::joint::FAULTY;

/// Fraction of the satellites for which a search without that satellite must find the integers
/// again.
const CONFIRMING_SHARE: f64 = 0.5;

/// Least number of those satellites, so that each search has more satellites than the position and
/// the clock have unknowns.
const CONFIRMING_LEAST: usize = 5;

/// What the search finds without one satellite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// The same integers.
    Agrees,
    /// None that are likely.
    Silent,
    /// Other integers, which are likely.
    Contradicts,
}

/// Outcome of a search without one satellite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Separated {
    pub(crate) verdict: Verdict,
    /// Probability that the held integers are right.
    pub(crate) probability: f64,
}

/// A satellite with the outcome of the last search that left it out.
#[derive(Clone, Copy, Debug)]
struct Separation {
    satellite: SatelliteId,
    verdict: Verdict,
    /// `None` before the first search; 0 where none is possible without the satellite.
    probability: Option<f64>,
}

/// Verdicts of the searches without one satellite on the held integers.
#[derive(Debug, Default)]
pub(crate) struct Confirmation {
    /// Satellites with held integers; those tested longest ago first.
    separations: Vec<Separation>,
    is_confirmed: bool,
}

snapshot_variants!(Verdict { 0 => Agrees {}, 1 => Silent {}, 2 => Contradicts {} });
snapshot_fields!(Separation { satellite, verdict, probability });
state_fields!(Confirmation { separations, is_confirmed });

impl Confirmation {
    /// Forgets all verdicts: nothing is confirmed.
    pub(crate) fn clear(&mut self) {
        self.separations.clear();
        self.is_confirmed = false;
    }

    /// Whether the integers are confirmed.
    pub(crate) fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }

    /// Factor on the probability of the integers, because one satellite may be faulty:
    /// 1 − ε·(1 − p̄), with the mean p̄ of the searches without one satellite.
    pub(crate) fn reliability(&self) -> f64 {
        let searches = self.separations.iter().filter_map(|separation| separation.probability);
        let (sum, count) = searches.fold((0.0, 0.0), |(sum, count), p| (sum + p, count + 1.0));
        if count == 0.0 { 1.0 } else { 1.0 - FAULTY * (1.0 - sum / count) }
    }

    /// Tests the integers of `satellites`, each test being a search without one of them. Returns
    /// the verdict on the integers as a whole.
    ///
    /// Integers that are not confirmed are tested without every satellite, first without those that
    /// failed last, until the outcome is certain. Confirmed ones are tested without one satellite
    /// an epoch, in turn, and stay confirmed until a test contradicts them.
    pub(crate) fn update(
        &mut self,
        satellites: &[SatelliteId],
        mut test: impl FnMut(SatelliteId) -> Option<Separated>,
    ) -> Verdict {
        self.follow(satellites);
        let Self { separations, is_confirmed } = self;
        let tests = if *is_confirmed { 1 } else { separations.len() };
        let most = (CONFIRMING_SHARE * separations.len() as f64).ceil() as usize;
        let needed = most.max(CONFIRMING_LEAST);
        let (mut agreeing, mut left) = (0, separations.len());
        for _ in 0..tests.min(separations.len()) {
            let separated = test(separations[0].satellite);
            let verdict = separated.map_or(Verdict::Silent, |separated| separated.verdict);
            let first = &mut separations[0];
            first.verdict = verdict;
            first.probability = Some(separated.map_or(0.0, |separated| separated.probability));
            if verdict == Verdict::Contradicts {
                *is_confirmed = false;
                return verdict;
            }
            separations.rotate_left(1);
            agreeing += usize::from(verdict == Verdict::Agrees);
            left -= 1;
            if !*is_confirmed && agreeing + left < needed {
                return Verdict::Silent;
            }
        }
        *is_confirmed |= !separations.is_empty();
        if *is_confirmed { Verdict::Agrees } else { Verdict::Silent }
    }

    /// Takes over the satellites of an epoch; before integers are confirmed, those without which
    /// they were not found come first.
    fn follow(&mut self, satellites: &[SatelliteId]) {
        let Self { separations, is_confirmed } = self;
        separations.retain(|separation| satellites.contains(&separation.satellite));
        for &satellite in satellites {
            if separations.iter().all(|separation| separation.satellite != satellite) {
                let (verdict, probability) = (Verdict::Silent, None);
                separations.insert(0, Separation { satellite, verdict, probability });
            }
        }
        if !*is_confirmed {
            separations.sort_by_key(|separation| separation.verdict == Verdict::Agrees);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Constellation;

    fn with(verdict: Verdict) -> Option<Separated> {
        let probability = if verdict == Verdict::Agrees { 0.99 } else { 0.1 };
        Some(Separated { verdict, probability })
    }

    fn satellites(count: u8) -> Vec<SatelliteId> {
        (1..=count).map(|k| SatelliteId::new(Constellation::Gps, k).unwrap()).collect()
    }

    /// Six of twelve satellites are enough and five are not; of six, five are needed.
    #[test]
    fn most_satellites_must_confirm() {
        for (count, needed, agreeing) in [(12, 6, 5), (12, 6, 6), (6, 5, 4), (6, 5, 5), (4, 5, 4)] {
            let mut confirmation = Confirmation::default();
            let test = |satellite: SatelliteId| match satellite.number <= agreeing {
                true => with(Verdict::Agrees),
                false => with(Verdict::Silent),
            };
            let verdict = confirmation.update(&satellites(count), test);
            assert_eq!(confirmation.is_confirmed(), needed <= agreeing, "{agreeing} of {count}");
            assert_eq!(verdict == Verdict::Agrees, needed <= agreeing);
        }
        let mut nothing = Confirmation::default();
        assert_eq!(nothing.update(&[], |_| with(Verdict::Agrees)), Verdict::Silent);
    }

    /// One contradiction among many agreements refuses integers, at once or later; confirmed
    /// integers are tested without each satellite in turn.
    #[test]
    fn one_contradiction_refuses() {
        let mut confirmation = Confirmation::default();
        let against = |number: u8| {
            move |satellite: SatelliteId| match satellite.number == number {
                true => with(Verdict::Contradicts),
                false => with(Verdict::Agrees),
            }
        };
        assert_eq!(confirmation.update(&satellites(8), against(5)), Verdict::Contradicts);
        assert!(!confirmation.is_confirmed());
        assert_eq!(confirmation.update(&satellites(8), against(9)), Verdict::Agrees);
        let mut epochs = 0;
        while confirmation.update(&satellites(8), against(5)) == Verdict::Agrees {
            epochs += 1;
            assert!(epochs < 8, "a turn has eight epochs");
        }
        assert!(!confirmation.is_confirmed());
    }

    /// The satellite that failed last is tested first: one test is enough to refuse again.
    #[test]
    fn a_failed_satellite_is_tested_first() {
        let mut confirmation = Confirmation::default();
        let mut tested = Vec::new();
        for _ in 0..2 {
            tested.clear();
            confirmation.update(&satellites(8), |satellite| {
                tested.push(satellite.number);
                with(if satellite.number == 4 { Verdict::Contradicts } else { Verdict::Agrees })
            });
        }
        assert_eq!(tested, [4]);
    }

    /// Eight searches, six with 0.99, one with 0.1 and one that was not possible: their mean is 6.04/8,
    /// and the factor 1 − 0.1·1.96/8.
    #[test]
    fn reliability_worked_by_hand() {
        let mut confirmation = Confirmation::default();
        assert_eq!(confirmation.reliability(), 1.0);
        let test = |satellite: SatelliteId| match satellite.number {
            1 => with(Verdict::Silent),
            2 => None,
            _ => with(Verdict::Agrees),
        };
        assert_eq!(confirmation.update(&satellites(8), test), Verdict::Agrees);
        assert!((confirmation.reliability() - (1.0 - 0.1 * 1.96 / 8.0)).abs() < 1e-12);
    }
}
