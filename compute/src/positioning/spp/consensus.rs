//! A position in spite of gross errors of pseudoranges or ephemerides.
//!
//! If one satellite is off by kilometres, least squares diverges or converges to a wrong position
//! far away. Then the positions of minimal subsets compete (Fischler & Bolles 1981, *Random sample
//! consensus*, CACM 24) by the sum of ln(1 + min(|s|, W)²/λ²) over all satellites. s is the
//! residual against the clock on which most satellites agree, and λ = 40 m is the extra path of a
//! reflection in a street. Clocks with known differences count as one. Subsets are drawn until one
//! of them contains only good satellites with a probability of 99.9 %, given the fraction of good
//! satellites that the best subset found.
//!
//! Satellites further than W from their clock at the best position are excluded, and the rest is
//! solved again until the set of excluded satellites is stable. W is 1.5 chips of the C/A code, 440
//! m: a reflection that arrives later does not correlate with the signal (Van Nee 1993,
//! *Spread-spectrum code and carrier synchronization errors caused by multipath and interference*,
//! IEEE Trans. Aerosp. Electron. Syst. 29), so multipath cannot cause a larger error.
//!
//! An excluded satellite may have another ephemeris of nearly the same time. If its pseudorange
//! agrees with that one, the satellite stays.

use crate::gnss::{Constellation, Ecef, Reason};
use crate::models::geometric_range;
use crate::positioning::Measurement;
use crate::positioning::draws::{Draws, subsets_needed};
use crate::positioning::pseudorange_error::WILD_M;

use super::exclusion::REDUNDANCY_MIN;
use super::least_squares::{ClockPrior, Row, Step};
use super::{EpochInputs, STEPS_MAX, SinglePoint};

/// λ (m): the width of a street.
const LATE_M: f64 = 40.0;
/// Maximum number of subsets. If 51 % of the satellites are good, one of the subsets contains only
/// good ones with a probability of 99.9 %.
const SUBSETS_MAX: usize = 100;
/// Steps of a refinement.
const REFINEMENTS: usize = 5;
/// Tolerance of a known clock (standard deviations).
const SLACK_SIGMAS: f64 = 3.0;
/// Step of a subset's position after which it is accepted (m): atmosphere and rows are accurate
/// enough.
const SUBSET_STEP_M: f64 = 10.0;
/// Maximum number of changes of the excluded satellites.
const CHANGES_MAX: usize = 8;

/// Scratch of the search.
#[derive(Debug, Default)]
pub(super) struct Search {
    /// The clocks of the epoch's constellations, if they are known from earlier epochs.
    pub(super) known: Option<[ClockPrior; Constellation::COUNT]>,
    order: Vec<usize>,
    subset: Vec<Row>,
    excesses: Vec<Excess>,
}

/// Residual of a pseudorange against its range.
#[derive(Clone, Copy, Debug)]
struct Excess {
    /// Index of the measurement.
    index: usize,
    /// Index of its clock.
    clock: usize,
    /// Measured minus range and known bias (m).
    excess_m: f64,
    /// Tolerance against its clock, in addition to W (m).
    slack_m: f64,
}

/// A position with the cost of all residuals and the number of satellites within W.
struct Candidate {
    position: Ecef,
    cost: f64,
    agreeing: usize,
}

impl Search {
    /// Index of a constellation's clock in the search: its own, or one common clock if they are
    /// known.
    fn clock(&self, constellation: Constellation) -> usize {
        if self.known.is_some() { 0 } else { constellation.index() }
    }

    /// Collects the residuals of `ranges` (measurement, measured minus range), sorted by clock and
    /// size.
    fn collect(&mut self, ranges: impl Iterator<Item = (usize, Constellation, f64)>) {
        self.excesses.clear();
        for (index, constellation, excess_m) in ranges {
            let prior = self.known.map(|known| known[constellation.index()]);
            self.excesses.push(Excess {
                index,
                clock: self.clock(constellation),
                excess_m: excess_m - prior.map_or(0.0, |prior| prior.bias_m),
                slack_m: prior.map_or(0.0, |prior| SLACK_SIGMAS * prior.variance_m2.sqrt()),
            });
        }
        let order = |a: &Excess, b: &Excess| {
            a.clock
                .cmp(&b.clock)
                .then(a.excess_m.total_cmp(&b.excess_m))
                .then(a.index.cmp(&b.index))
        };
        self.excesses.sort_unstable_by(order);
    }

    /// The residuals of each clock, and the clock: the middle of the largest set within W of one
    /// value.
    fn clocks(&self) -> impl Iterator<Item = (&[Excess], f64)> {
        self.excesses.chunk_by(|a, b| a.clock == b.clock).map(|excesses| {
            let end = |first: usize| {
                let reach_m = excesses[first].excess_m + WILD_M;
                excesses.partition_point(|excess| excess.excess_m <= reach_m)
            };
            // Of several sets of equal size the first: the earliest signals.
            let most = (0..excesses.len()).rev().max_by_key(|first| end(*first) - first);
            let first = most.expect("a chunk has a member");
            (excesses, excesses[(first + end(first) - 1) / 2].excess_m)
        })
    }
}

impl Excess {
    /// Distance from its clock (m).
    fn off_m(&self, clock_m: f64) -> f64 {
        ((self.excess_m - clock_m).abs() - self.slack_m).max(0.0)
    }
}

impl SinglePoint {
    /// Whether the error of some satellite is larger than multipath can cause. If that satellite
    /// alone is wrong, its error is r/(1 − w·aᵀQa).
    pub(super) fn has_wild(&self, step: &Step) -> bool {
        self.rows.iter().filter(|row| row.is_used).any(|row| {
            WILD_M * step.redundancy(row).max(REDUNDANCY_MIN) < step.residual_after_m(row).abs()
        })
    }

    /// The converged position of the satellites that agree; the others are marked wild.
    pub(super) fn consensus(&mut self, inputs: &EpochInputs<'_>) -> Result<(Ecef, Step), Reason> {
        self.wild.fill(false);
        let mut position = self.likeliest(inputs).ok_or(Reason::NotConverged)?;
        let mut before = self.wild.clone();
        for _ in 0..CHANGES_MAX {
            self.measurements
                .place(position, inputs.epoch.time, inputs.navigation, inputs.options())
                .ok_or(Reason::NotConverged)?;
            self.mark_wild(inputs, position);
            let (origin, step) = self.converge(inputs, position)?;
            if self.wild == before {
                return Ok((origin, step));
            }
            before.clone_from(&self.wild);
            position = Ecef(origin.0 + step.position_m);
        }
        Err(Reason::NotConverged)
    }

    /// The position of the subset with the lowest cost, refined.
    fn likeliest(&mut self, inputs: &EpochInputs<'_>) -> Option<Ecef> {
        let mut draws = Draws::new(inputs.epoch.time.as_ns() as u64);
        let mut best: Option<Candidate> = None;
        let (mut drawn, mut needed) = (0, SUBSETS_MAX as f64);
        while drawn < SUBSETS_MAX && (drawn as f64) < needed {
            drawn += 1;
            let Some(position) = self.subset_position(&mut draws) else { continue };
            let candidate = self.candidate(position);
            if best.as_ref().is_none_or(|best| candidate.cost < best.cost) {
                let candidate = self.refined(candidate);
                let sound = candidate.agreeing as f64 / self.measurements.list.len() as f64;
                needed = subsets_needed(sound, self.search.subset.len());
                best = Some(candidate);
            }
        }
        best.map(|best| best.position)
    }

    /// The position of a minimal subset, from pseudoranges without atmosphere.
    fn subset_position(&mut self, draws: &mut Draws) -> Option<Ecef> {
        let count = self.measurements.list.len();
        self.search.order.clear();
        self.search.order.extend(0..count);
        draws.shuffle_front(&mut self.search.order, count);
        let wanted = self.minimal()?;
        let mut position = Ecef::new(0.0, 0.0, 0.0);
        for _ in 0..STEPS_MAX {
            self.search.subset.clear();
            for place in 0..wanted {
                let row = self.search_row(self.search.order[place], position);
                self.search.subset.push(row);
            }
            let step = Step::solve(&self.search.subset)?;
            position.0 += step.position_m;
            if step.position_m.norm() < SUBSET_STEP_M {
                return Some(position);
            }
        }
        None
    }

    /// Improves a candidate by steps with all satellites, weighted as in the cost. A subset's
    /// geometry may be weak and its position uncertain (Chum, Matas & Kittler 2003, *Locally
    /// optimized RANSAC*).
    fn refined(&mut self, begin: Candidate) -> Candidate {
        let mut best = begin;
        let mut position = best.position;
        for _ in 0..REFINEMENTS {
            self.collect_all(position);
            let mut rows = Vec::with_capacity(self.search.excesses.len());
            for (excesses, clock_m) in self.search.clocks() {
                for excess in excesses {
                    let off_m = excess.off_m(clock_m);
                    let weight = (1.0 + (off_m / LATE_M).powi(2)).recip();
                    let is_used = off_m < WILD_M;
                    rows.push(Row { weight, is_used, ..self.search_row(excess.index, position) });
                }
            }
            let Some(step) = Step::solve(&rows) else { return best };
            position.0 += step.position_m;
            let candidate = self.candidate(position);
            if candidate.cost < best.cost {
                best = candidate;
            }
        }
        best
    }

    /// A row of unit weight for the search, with its clock in the search.
    fn search_row(&self, index: usize, position: Ecef) -> Row {
        let mut row = self.raw_row(index, position);
        if let Some(known) = &self.search.known {
            row.residual_m += known[row.constellation.index()].bias_m;
            row.constellation = Constellation::ALL[0];
        }
        row
    }

    /// Number of satellites at the beginning of `order` that determine a position: three more than
    /// they have clocks. Satellites that are alone with their clock are moved behind the others.
    fn minimal(&mut self) -> Option<usize> {
        let mut order = std::mem::take(&mut self.search.order);
        let clock =
            |at: usize| self.search.clock(self.measurements.list[at].satellite.constellation);
        let mut counts = [0_usize; Constellation::COUNT];
        let mut beyond = 0;
        let last = order.iter().position(|at| {
            let count = &mut counts[clock(*at)];
            *count += 1;
            beyond += usize::from(1 < *count);
            beyond == 3
        });
        let wanted = last.map(|last| {
            let mut wanted = last + 1;
            for place in (0..=last).rev() {
                if counts[clock(order[place])] == 1 {
                    wanted -= 1;
                    order.swap(place, wanted);
                }
            }
            wanted
        });
        self.search.order = order;
        wanted
    }

    /// A row of unit weight without atmosphere.
    pub(super) fn raw_row(&self, index: usize, position: Ecef) -> Row {
        let measurement = &self.measurements.list[index];
        let (range_m, gradient) = geometric_range(measurement.state.position, position);
        Row {
            index,
            constellation: measurement.satellite.constellation,
            gradient: gradient.transpose(),
            residual_m: range_m - measurement.pseudorange_m,
            weight: 1.0,
            is_used: true,
        }
    }

    /// A position with its cost over all satellites.
    fn candidate(&mut self, position: Ecef) -> Candidate {
        self.collect_all(position);
        let (mut cost, mut agreeing) = (0.0, 0);
        for (excesses, clock_m) in self.search.clocks() {
            for off_m in excesses.iter().map(|excess| excess.off_m(clock_m)) {
                cost += (off_m.min(WILD_M) / LATE_M).powi(2).ln_1p();
                agreeing += usize::from(off_m < WILD_M);
            }
        }
        Candidate { position, cost, agreeing }
    }

    /// Collects the residuals of all pseudoranges, without atmosphere.
    fn collect_all(&mut self, position: Ecef) {
        let Self { search, measurements, .. } = self;
        search.collect(measurements.list.iter().enumerate().map(|(index, m)| {
            let range_m = geometric_range(m.state.position, position).0;
            (index, m.satellite.constellation, m.pseudorange_m - range_m)
        }));
    }

    /// Marks the corrected measurements that are further than W from their clock.
    fn mark_wild(&mut self, inputs: &EpochInputs<'_>, position: Ecef) {
        let Self { search, measurements, wild, .. } = self;
        let range_m = |m: &Measurement| geometric_range(m.state.position, position).0;
        let placed = measurements.list.iter().enumerate().filter(|(_, m)| m.is_above_mask);
        search.collect(placed.map(|(index, m)| {
            (index, m.satellite.constellation, m.corrected_range_m - range_m(m))
        }));
        for (excesses, clock_m) in search.clocks() {
            for excess in excesses {
                let measurement = &mut measurements.list[excess.index];
                let before_m = measurement.corrected_range_m - range_m(measurement);
                let agrees = |other: &Measurement| {
                    let change_m = other.corrected_range_m - range_m(other) - before_m;
                    Excess { excess_m: excess.excess_m + change_m, ..*excess }.off_m(clock_m)
                        <= WILD_M
                };
                if agrees(measurement) {
                    wild[excess.index] = false;
                    continue;
                }
                let EpochInputs { epoch, navigation, bands, .. } = *inputs;
                let other = measurement.with_other_ephemeris(
                    epoch,
                    navigation,
                    inputs.options(),
                    bands,
                    agrees,
                );
                wild[excess.index] = other.is_none();
                if let Some(other) = other {
                    *measurement = other;
                }
            }
        }
    }
}
