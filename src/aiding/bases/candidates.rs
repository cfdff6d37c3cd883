//! Chooses the base of a rover among several.
//!
//! The nearest usable base is chosen. The choice changes when the present base is no longer usable,
//! or when another base is nearer by a fraction of the present distance and by a minimum length,
//! and has been received without a gap for long enough. These margins prevent frequent changes:
//! after each change all ambiguities start again.

use std::sync::Arc;

use crate::config::RtkOptions;
use crate::gnss::{Ecef, GpsTime};
use crate::positioning::{BasePositionVerdict, TAG_SLACK_S};
use crate::store::BaseKey;

use super::BaseView;
use super::base::Base;

/// The bases from which a session chooses the nearest. All clones share them.
#[derive(Clone)]
pub(crate) struct Candidates {
    bases: Vec<Arc<Base>>,
}

/// A base as seen from a rover.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CandidateState {
    distance_m: f64,
    /// It is within the longest baseline, has a recent epoch, and its position is not refused.
    is_usable: bool,
    /// Its epochs have arrived without a gap for long enough, so a rover may change to it.
    is_steady: bool,
}

impl Candidates {
    pub(super) const fn new(bases: Vec<Arc<Base>>) -> Self {
        Self { bases }
    }

    /// The base for the rover epoch at `time`, with the base epochs that this epoch may need.
    /// `position` is the rover's approximate position; `present` is the base of the rover's last
    /// epoch.
    ///
    /// If no base is usable, the present one stays; without a present one the nearest is chosen.
    /// The solution then reports the reason. `None` if no base has a known position, or if the
    /// rover's position is unknown and there is no present base.
    pub(crate) fn choose(
        &self,
        present: Option<BaseKey>,
        position: Option<Ecef>,
        time: GpsTime,
        options: &RtkOptions,
    ) -> Option<BaseView> {
        let is_present = |base: &Arc<Base>| Some(base.name().key) == present;
        let chosen = match position {
            None => self.bases.iter().find(|base| is_present(base))?,
            Some(position) => {
                let located: Vec<_> = self
                    .bases
                    .iter()
                    .filter_map(|base| Some((base, state_of(base, position, time, options)?)))
                    .collect();
                let states: Vec<CandidateState> = located.iter().map(|(_, state)| *state).collect();
                let present = located.iter().position(|(base, _)| is_present(base));
                located[choice(&states, present, options)?].0
            }
        };
        Some(chosen.view(time, time, options.base_span_s()))
    }
}

/// The state of a base as seen from a rover; `None` if the base has no position yet.
fn state_of(
    base: &Base,
    position: Ecef,
    time: GpsTime,
    options: &RtkOptions,
) -> Option<CandidateState> {
    let stored = base.stored();
    let distance_m = position.distance_m(stored.site()?.antenna_reference_point());
    let is_refused = stored.checks.present.verdict() == BasePositionVerdict::Refused;
    let may_be_used = distance_m <= options.baseline_max_m && !is_refused;
    let gap_s = options.base_age_max_s + TAG_SLACK_S;
    let received_s = || stored.uninterrupted_s(time, gap_s, options.handover_gap_free_s);
    let received_s = may_be_used.then(received_s).flatten();
    let is_steady = received_s.is_some_and(|received_s| options.handover_gap_free_s <= received_s);
    let is_usable = received_s.is_some();
    Some(CandidateState { distance_m, is_usable, is_steady })
}

/// Index of the base to use. Among equally distant bases it is the first.
fn choice(
    states: &[CandidateState],
    present: Option<usize>,
    options: &RtkOptions,
) -> Option<usize> {
    let nearest = |may_be: &dyn Fn(&CandidateState) -> bool| {
        let eligible = states.iter().enumerate().filter(|(_, state)| may_be(state));
        let least = eligible.min_by(|(_, a), (_, b)| a.distance_m.total_cmp(&b.distance_m));
        least.map(|(index, _)| index)
    };
    let here = present.map(|present| states[present]).filter(|here| here.is_usable);
    let Some(here) = here else {
        return nearest(&|other| other.is_usable).or(present).or_else(|| nearest(&|_| true));
    };
    let is_better = |other: &CandidateState| {
        other.is_usable
            && other.is_steady
            && other.distance_m < here.distance_m * (1.0 - options.handover_distance_share)
            && options.handover_distance_m <= here.distance_m - other.distance_m
    };
    nearest(&is_better).or(present)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};

    fn options() -> RtkOptions {
        PositioningOptions::new(Mode::RtkFgo, Profile::General).rtk
    }

    fn at(distance_km: f64) -> CandidateState {
        CandidateState { distance_m: distance_km * 1e3, is_usable: true, is_steady: true }
    }

    /// Index of the chosen base at each position along a line between two bases 20 km apart.
    fn walk(positions_km: impl Iterator<Item = f64>) -> Vec<usize> {
        let mut present = None;
        let mut chosen = Vec::new();
        for position_km in positions_km {
            present =
                choice(&[at(position_km), at((20.0 - position_km).abs())], present, &options());
            chosen.extend(present);
        }
        chosen
    }

    fn changes(chosen: &[usize]) -> usize {
        chosen.windows(2).filter(|pair| pair[0] != pair[1]).count()
    }

    /// From one base to the other in steps of 10 m: the base changes once, where the other one is
    /// nearer by a fifth (8.89 km against 11.11 km), and once on the way back, at the mirrored
    /// position.
    #[test]
    fn a_walk_between_two_bases_changes_once() {
        let steps = || (0..=2_000).map(|step| f64::from(step) / 100.0);
        let there = walk(steps());
        assert_eq!(changes(&there), 1);
        assert_eq!(there.iter().position(|chosen| *chosen == 1), Some(1_112));
        let there_and_back = walk(steps().chain(steps().rev()));
        assert_eq!((there_and_back.len(), changes(&there_and_back)), (4_002, 2));
        assert_eq!((there_and_back[0], there_and_back[4_001]), (0, 0));
    }

    /// A rover that moves by 1 km around the middle keeps its base, whichever base it began with.
    #[test]
    fn a_rover_in_the_middle_keeps_its_base() {
        for start_km in [9.9, 10.1] {
            let lingering = (0..1_000).map(|step| 10.0 + f64::from(step).sin());
            let chosen = walk(std::iter::once(start_km).chain(lingering));
            assert_eq!(changes(&chosen), 0, "from {start_km}");
            assert_eq!(chosen[0], usize::from(10.0 < start_km));
        }
    }

    #[test]
    fn a_near_base_is_not_left_for_one_a_little_nearer() {
        // Half the distance but only 500 m less; much nearer, but not steady yet.
        assert_eq!(choice(&[at(1.0), at(0.5)], Some(0), &options()), Some(0));
        let fresh = CandidateState { is_steady: false, ..at(1.0) };
        assert_eq!(choice(&[at(30.0), fresh], Some(0), &options()), Some(0));
        assert_eq!(choice(&[at(30.0), fresh], None, &options()), Some(1));
        // The nearest of several better bases.
        assert_eq!(choice(&[at(30.0), at(5.0), at(3.0)], Some(0), &options()), Some(2));
    }

    #[test]
    fn of_equally_distant_bases_the_first_is_taken_and_kept() {
        assert_eq!(choice(&[at(5.0), at(5.0)], None, &options()), Some(0));
        assert_eq!(choice(&[at(5.0), at(5.0)], Some(1), &options()), Some(1));
        let eager =
            RtkOptions { handover_distance_share: 0.0, handover_distance_m: 0.0, ..options() };
        assert_eq!(choice(&[at(5.0), at(5.0)], Some(1), &eager), Some(1));
    }

    /// The rover changes from an unusable base to a usable one. If no base is usable, it stays.
    #[test]
    fn a_base_that_fails_is_left() {
        let failed = |distance_km| CandidateState { is_usable: false, ..at(distance_km) };
        assert_eq!(choice(&[failed(1.0), at(40.0)], Some(0), &options()), Some(1));
        let fresh = CandidateState { is_steady: false, ..at(40.0) };
        assert_eq!(choice(&[failed(1.0), fresh], Some(0), &options()), Some(1));
        assert_eq!(choice(&[failed(9.0), failed(1.0)], Some(0), &options()), Some(0));
        assert_eq!(choice(&[failed(9.0), failed(1.0)], None, &options()), Some(1));
        assert_eq!(choice(&[], None, &options()), None);
    }
}
