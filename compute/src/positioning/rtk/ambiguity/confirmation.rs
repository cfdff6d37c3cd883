//! Confirms a fix by leaving out each satellite in turn: solution separation, applied to integers.
//!
//! Multipath on one satellite biases the float ambiguities, and the posterior probability of a
//! search does not model this. So an epoch has n + 1 models: either no satellite has faulty
//! carriers, or one of the n satellites has. In a model with a faulty satellite, the fractional
//! parts of its ambiguities are uniform, and the other ambiguities have the integers of a search
//! without it. Each model counts with its prior probability and with the evidence of the float
//! ambiguities for it. Averaged over the models, the held integers have the probability
//!
//! P = ((1 − ε) + ε/n·Σ Eᵢ·pᵢ)/((1 − ε) + ε/n·Σ Eᵢ),
//!
//! ε is the prior probability that one satellite is faulty. Eᵢ is the density of the float
//! ambiguities without satellite i, divided by the density of all. pᵢ is the probability that the
//! search without satellite i gives to the held integers. The model without a fault counts the held
//! integers as certain here: the probability of the search with all satellites is a factor of its
//! own.
//!
//! The evidence is only as good as the covariance of the float ambiguities. If multipath makes that
//! covariance too small, wrong integers may fit all float ambiguities, and every Eᵢ is small. So P
//! is also computed with Eᵢ = 1, that is with the prior weights, and the smaller P counts.
//!
//! Source: the idea is that of solution separation, Brown & McBurney (1988), *Self-contained GPS
//! integrity check using maximum solution separation*, Navigation 35(1), 41–53. Model averaging:
//! Hoeting, Madigan, Raftery & Volinsky (1999), *Bayesian model averaging: a tutorial*, Statistical
//! Science 14(4), 382–417.

use crate::gnss::SatelliteId;
use crate::snapshot::{snapshot_fields, state_fields};

use super::hold::NEARLY_CERTAIN;
use super::joint::{FAULTY, scale_odds};

/// Prior odds of confirmed integers in a search: many epochs have found them.
const CONFIRMED_ODDS: f64 = NEARLY_CERTAIN / (1.0 - NEARLY_CERTAIN);
/// Confirmed integers are refuted below this probability: they are more likely wrong than right.
const REFUTED: f64 = 0.5;

/// Outcome of a search without one satellite.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SearchWithout {
    /// Probability of the held integers.
    pub(crate) probability: f64,
    /// Density of the float ambiguities without the satellite, divided by the density of all.
    pub(crate) evidence: f64,
}

impl SearchWithout {
    /// Too few ambiguities are left for a search without the satellite: there is no evidence for
    /// the held integers, and none for another model.
    const IMPOSSIBLE: Self = Self { probability: 0.0, evidence: 1.0 };
}

/// A satellite with the outcome of the last search that left it out.
#[derive(Clone, Copy, Debug)]
struct Separation {
    satellite: SatelliteId,
    /// `None` before the first search.
    outcome: Option<SearchWithout>,
}

/// The searches without one satellite each for the held integers.
#[derive(Debug, Default)]
pub(crate) struct Confirmation {
    /// Satellites with held integers; those tested longest ago first.
    separations: Vec<Separation>,
    is_confirmed: bool,
}

snapshot_fields!(SearchWithout { probability, evidence });
snapshot_fields!(Separation { satellite, outcome });
state_fields!(Confirmation { separations, is_confirmed });

impl Confirmation {
    /// Forgets all searches: nothing is confirmed.
    pub(crate) fn clear(&mut self) {
        self.separations.clear();
        self.is_confirmed = false;
    }

    /// Whether the integers are confirmed.
    pub(crate) fn is_confirmed(&self) -> bool {
        self.is_confirmed
    }

    /// Probability P of the held integers, averaged over the models; one before any search.
    pub(crate) fn probability(&self) -> f64 {
        let odds = if self.is_confirmed { CONFIRMED_ODDS } else { 1.0 };
        let by_evidence = self.averaged(|one| (one.evidence, scale_odds(odds, one.probability)));
        by_evidence.min(self.averaged(|one| (1.0, one.probability)))
    }

    /// P by the evidence and the probability that `of` returns for each search.
    fn averaged(&self, of: impl Fn(SearchWithout) -> (f64, f64)) -> f64 {
        let searches = self.separations.iter().filter_map(|separation| separation.outcome).map(of);
        let (mut right, mut all, mut count) = (0.0, 0.0, 0.0);
        for (evidence, probability) in searches {
            right += evidence * probability;
            all += evidence;
            count += 1.0;
        }
        let prior = FAULTY / f64::max(count, 1.0);
        (1.0 - FAULTY + prior * right) / (1.0 - FAULTY + prior * all)
    }

    /// Tests the integers of `satellites`. Each test is a search without one satellite.
    ///
    /// Integers that are not confirmed are tested without each satellite, all in one epoch. They
    /// are confirmed if P is at least `probability_min`. Confirmed integers are tested without one
    /// satellite per epoch, in turn, and stay confirmed until they are refuted.
    pub(crate) fn update(
        &mut self,
        satellites: &[SatelliteId],
        probability_min: f64,
        mut test: impl FnMut(SatelliteId) -> Option<SearchWithout>,
    ) {
        self.follow(satellites);
        let tests = if self.is_confirmed { 1 } else { self.separations.len() };
        for separation in self.separations.iter_mut().take(tests) {
            separation.outcome =
                Some(test(separation.satellite).unwrap_or(SearchWithout::IMPOSSIBLE));
        }
        if self.is_confirmed && !self.separations.is_empty() {
            self.separations.rotate_left(1);
        }
        let least = if self.is_confirmed { REFUTED } else { probability_min };
        self.is_confirmed =
            least <= self.probability() && (self.is_confirmed || !self.separations.is_empty());
    }

    /// Takes over the satellites of an epoch; new ones are tested first.
    fn follow(&mut self, satellites: &[SatelliteId]) {
        let separations = &mut self.separations;
        separations.retain(|separation| satellites.contains(&separation.satellite));
        for &satellite in satellites {
            if separations.iter().all(|separation| separation.satellite != satellite) {
                separations.insert(0, Separation { satellite, outcome: None });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Constellation;

    /// A threshold as of the options.
    const LEAST: f64 = 0.95;

    const AGREES: Option<SearchWithout> = Some(SearchWithout { probability: 0.99, evidence: 0.1 });
    const CONTRADICTS: Option<SearchWithout> =
        Some(SearchWithout { probability: 0.0, evidence: 1000.0 });

    fn satellites(count: u8) -> Vec<SatelliteId> {
        (1..=count).map(|k| SatelliteId::new(Constellation::Gps, k).unwrap()).collect()
    }

    /// Of eight searches six agree (p = 0.99, E = 0.1), one prefers other integers (p = 0.1, E = 2)
    /// and one was not possible (p = 0, E = 1). By evidence P = (0.9 + (0.6·0.99 + 0.2)/80)/(0.9 +
    /// 3.6/80), by the prior weights 0.9 + (6·0.99 + 0.1)/80, which is less.
    #[test]
    fn a_probability_worked_by_hand() {
        let mut confirmation = Confirmation::default();
        assert_eq!(confirmation.probability(), 1.0);
        let test = |satellite: SatelliteId| match satellite.number {
            1 => Some(SearchWithout { probability: 0.1, evidence: 2.0 }),
            2 => None,
            _ => AGREES,
        };
        confirmation.update(&satellites(8), LEAST, test);
        let by_evidence = confirmation.averaged(|one| (one.evidence, one.probability));
        assert!((by_evidence - (0.9 + 0.794 / 80.0) / (0.9 + 3.6 / 80.0)).abs() < 1e-12);
        assert!((confirmation.probability() - (0.9 + 6.04 / 80.0)).abs() < 1e-12);
        assert!(confirmation.is_confirmed());
    }

    /// Integers that fit all float ambiguities are not confirmed if few searches without a
    /// satellite find them again, however small the evidence of these searches is. Five of eight
    /// searches are enough, three are not.
    #[test]
    fn integers_must_be_found_again() {
        for (again, is_confirmed) in [(5, true), (3, false)] {
            let mut confirmation = Confirmation::default();
            let test = |satellite: SatelliteId| match satellite.number <= again {
                true => AGREES,
                false => Some(SearchWithout { probability: 0.0, evidence: 1e-6 }),
            };
            confirmation.update(&satellites(8), LEAST, test);
            assert_eq!(confirmation.is_confirmed(), is_confirmed, "{again}");
        }
    }

    /// If a search without one satellite finds other integers, they refute the held ones only if
    /// the float ambiguities without it are much denser than all: the satellite is then likely
    /// faulty. Otherwise the other integers count with the prior probability of that fault.
    #[test]
    fn a_contradiction_counts_as_much_as_its_evidence() {
        for (evidence, is_right) in [(0.01, true), (1.0, true), (5.0, false), (1000.0, false)] {
            let mut confirmation = Confirmation::default();
            let test = |satellite: SatelliteId| match satellite.number {
                5 => Some(SearchWithout { probability: 0.0, evidence }),
                _ => AGREES,
            };
            confirmation.update(&satellites(8), LEAST, test);
            assert_eq!(confirmation.is_confirmed(), is_right, "{evidence}");
        }
        let mut nothing = Confirmation::default();
        nothing.update(&[], LEAST, |_| AGREES);
        assert!(!nothing.is_confirmed());
    }

    /// Confirmed integers are tested without one satellite per epoch, in turn. They are dropped at
    /// once if a test shows that its satellite is faulty and other integers are right.
    #[test]
    fn confirmed_integers_are_tested_in_turn() {
        let mut confirmation = Confirmation::default();
        confirmation.update(&satellites(8), LEAST, |_| AGREES);
        let mut tested = Vec::new();
        while confirmation.is_confirmed() {
            assert!(tested.len() < 8, "a turn has eight epochs: {tested:?}");
            confirmation.update(&satellites(8), LEAST, |satellite| {
                tested.push(satellite.number);
                if satellite.number == 5 { CONTRADICTS } else { AGREES }
            });
        }
        tested.sort_unstable();
        tested.dedup();
        assert!(tested.contains(&5) && tested.len() < 9, "{tested:?}");
    }

    /// Confirmed integers have odds of 9999 before a search: 0.01 becomes 0.99.
    #[test]
    fn earlier_epochs_speak_for_confirmed_integers() {
        let doubts = |_| Some(SearchWithout { probability: 0.01, evidence: 1000.0 });
        let mut confirmation = Confirmation::default();
        confirmation.update(&satellites(8), LEAST, |_| AGREES);
        confirmation.update(&satellites(8), LEAST, doubts);
        assert!(confirmation.is_confirmed() && 0.98 < confirmation.probability());
        assert!(confirmation.averaged(|one| (one.evidence, one.probability)) < 0.1);
        let mut unconfirmed = Confirmation::default();
        unconfirmed.update(&satellites(8), LEAST, doubts);
        assert!(!unconfirmed.is_confirmed() && unconfirmed.probability() < 0.05);
    }
}
