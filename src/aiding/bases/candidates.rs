//! Which of several bases a rover is positioned against, and when another takes its place.
//!
//! The nearest that can be used is taken. Another takes its place where it is nearer by a share of
//! the present one's distance and by a length, and steady; or where the present one can be used no
//! more: every change costs the ambiguities, which begin anew.

use std::sync::Arc;

use crate::config::RtkOptions;
use crate::gnss::{Ecef, GpsTime};
use crate::store::BaseKey;

use super::BaseView;
use super::broker::Base;
use super::check::REFUSED_M;

/// Ages within this of the limit are within the limit (s), as estimators have it.
const TAG_SLACK_S: f64 = 1e-3;

/// The bases of which a session takes the nearest. Clones share them.
#[derive(Clone)]
pub struct Candidates {
    bases: Vec<Arc<Base>>,
}

/// How a base stands to a rover.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Standing {
    distance_m: f64,
    /// It is near enough, was heard of late, and stands where it is said to.
    is_usable: bool,
    /// It was heard for long without a gap.
    is_steady: bool,
}

impl Candidates {
    pub(super) const fn new(bases: Vec<Arc<Base>>) -> Self {
        Self { bases }
    }

    /// The base for an epoch at `time` of a rover about at `place`, with what of it that epoch may
    /// need; `present` is the base of the epoch before. `None` where no place of any is known, or
    /// the rover's is not and there was no base before.
    ///
    /// Where none can be used the present one stays, or else it is the nearest: the estimator says
    /// what is wrong with it.
    pub fn choose(
        &self,
        present: Option<BaseKey>,
        place: Option<Ecef>,
        time: GpsTime,
        options: &RtkOptions,
    ) -> Option<BaseView> {
        let is_present = |base: &Arc<Base>| Some(base.name.key) == present;
        let chosen = match place {
            None => self.bases.iter().find(|base| is_present(base))?,
            Some(place) => {
                let placed: Vec<_> = self
                    .bases
                    .iter()
                    .filter_map(|base| Some((base, standing(base, place, time, options)?)))
                    .collect();
                let standings: Vec<Standing> =
                    placed.iter().map(|(_, standing)| *standing).collect();
                let present = placed.iter().position(|(base, _)| is_present(base));
                placed[choice(&standings, present, options)?].0
            }
        };
        Some(chosen.view(time, time, options.base_span_s()))
    }
}

/// `None` where nobody knows where the base stands.
fn standing(base: &Base, place: Ecef, time: GpsTime, options: &RtkOptions) -> Option<Standing> {
    let held = base.held();
    let distance_m = place.distance_m(held.site()?.antenna_reference_point());
    let is_refused = held.check.distance_m().is_some_and(|off_m| REFUSED_M < off_m);
    let may_be_used = distance_m <= options.baseline_max_m && !is_refused;
    let gap_s = options.base_age_max_s + TAG_SLACK_S;
    let heard_s = || held.heard_s(time, gap_s, options.steady_s);
    let heard_s = may_be_used.then(heard_s).flatten();
    let is_steady = heard_s.is_some_and(|heard_s| options.steady_s <= heard_s);
    let is_usable = heard_s.is_some();
    Some(Standing { distance_m, is_usable, is_steady })
}

/// The place in the list of the base to use; of equally distant ones the first.
fn choice(standings: &[Standing], present: Option<usize>, options: &RtkOptions) -> Option<usize> {
    let nearest = |may_be: &dyn Fn(&Standing) -> bool| {
        let those = standings.iter().enumerate().filter(|(_, standing)| may_be(standing));
        let least = those.min_by(|(_, a), (_, b)| a.distance_m.total_cmp(&b.distance_m));
        least.map(|(index, _)| index)
    };
    let here = present.map(|present| standings[present]).filter(|here| here.is_usable);
    let Some(here) = here else {
        return nearest(&|other| other.is_usable).or(present).or_else(|| nearest(&|_| true));
    };
    let is_better = |other: &Standing| {
        other.is_usable
            && other.is_steady
            && other.distance_m < here.distance_m * (1.0 - options.nearer_share)
            && options.nearer_m <= here.distance_m - other.distance_m
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

    fn at(distance_km: f64) -> Standing {
        Standing { distance_m: distance_km * 1e3, is_usable: true, is_steady: true }
    }

    /// Who was chosen at each place of a walk, on a line between two bases 20 km apart.
    fn walk(places_km: impl Iterator<Item = f64>) -> Vec<usize> {
        let mut present = None;
        let mut chosen = Vec::new();
        for place_km in places_km {
            present = choice(&[at(place_km), at((20.0 - place_km).abs())], present, &options());
            chosen.extend(present);
        }
        chosen
    }

    fn changes(chosen: &[usize]) -> usize {
        chosen.windows(2).filter(|pair| pair[0] != pair[1]).count()
    }

    /// From one base to the other in steps of 10 m: one change, where the other is nearer by a
    /// fifth, 8.89 km to 11.11 km; and one on the way back, as far from the middle again.
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

    /// To and fro about the middle by 1 km: nothing changes, wherever it began.
    #[test]
    fn who_lingers_in_the_middle_keeps_his_base() {
        for start_km in [9.9, 10.1] {
            let lingering = (0..1_000).map(|step| 10.0 + f64::from(step).sin());
            let chosen = walk(std::iter::once(start_km).chain(lingering));
            assert_eq!(changes(&chosen), 0, "from {start_km}");
            assert_eq!(chosen[0], usize::from(10.0 < start_km));
        }
    }

    #[test]
    fn a_base_close_by_is_left_for_none_a_little_closer() {
        // Nearer by half, but by 500 m only; and by far, but not steady yet.
        assert_eq!(choice(&[at(1.0), at(0.5)], Some(0), &options()), Some(0));
        let fresh = Standing { is_steady: false, ..at(1.0) };
        assert_eq!(choice(&[at(30.0), fresh], Some(0), &options()), Some(0));
        assert_eq!(choice(&[at(30.0), fresh], None, &options()), Some(1));
        // Of those that are better the nearest.
        assert_eq!(choice(&[at(30.0), at(5.0), at(3.0)], Some(0), &options()), Some(2));
    }

    #[test]
    fn of_equally_distant_bases_the_first_is_taken_and_kept() {
        assert_eq!(choice(&[at(5.0), at(5.0)], None, &options()), Some(0));
        assert_eq!(choice(&[at(5.0), at(5.0)], Some(1), &options()), Some(1));
        let eager = RtkOptions { nearer_share: 0.0, nearer_m: 0.0, ..options() };
        assert_eq!(choice(&[at(5.0), at(5.0)], Some(1), &eager), Some(1));
    }

    /// A base that cannot be used is left for any that can; where none can it stays.
    #[test]
    fn a_base_that_fails_is_left() {
        let failed = |distance_km| Standing { is_usable: false, ..at(distance_km) };
        assert_eq!(choice(&[failed(1.0), at(40.0)], Some(0), &options()), Some(1));
        let fresh = Standing { is_steady: false, ..at(40.0) };
        assert_eq!(choice(&[failed(1.0), fresh], Some(0), &options()), Some(1));
        assert_eq!(choice(&[failed(9.0), failed(1.0)], Some(0), &options()), Some(0));
        assert_eq!(choice(&[failed(9.0), failed(1.0)], None, &options()), Some(1));
        assert_eq!(choice(&[], None, &options()), None);
    }
}
