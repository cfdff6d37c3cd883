//! Single-point positioning: one epoch's pseudoranges, weighted least squares, fault exclusion.
//!
//! Unknowns are the position and one clock per constellation. From the Earth's centre, or from the
//! previous position, Gauss–Newton steps alternate with placing the measurements anew until a step
//! is shorter than 0.1 m: then the range's curvature (step²/ρ < 1 nm) and the atmosphere's slope
//! (below 0.1 mm) are exhausted, so that the answer no longer depends on the start.
//!
//! The residual test compares the sum of squared whitened residuals with its chi-square limit, and
//! `exclusion` then leaves out what contradicts the rest. An epoch that still fails is answered
//! with its covariance multiplied by that sum per degree of freedom, and the reason.

mod answer;
mod consensus;
mod exclusion;
mod least_squares;
mod protection;
mod single_points;
mod system_biases;

use crate::gnss::{
    Constellation, Ecef, LocalFrame, Protection, Reason, Solution, SolutionEstimate, Status,
};
use crate::models::geometric_range;

use super::Measurements;
use super::answer::LOST_M;
use super::engine::EpochInputs;
use super::velocity::VelocityEstimator;
use consensus::Search;
use least_squares::{Row, Step, Tie};
use protection::Influence;
use system_biases::SystemBiases;

pub(super) use single_points::SinglePoints;

/// A step shorter than this needs no further one (m).
const LAST_STEP_M: f64 = 0.1;
/// A coarse step shorter than this gives way to full models (m).
const COARSE_STEP_M: f64 = 10_000.0;
/// Steps at most, coarse or fine; from the Earth's centre some five and three are taken.
const STEPS_MAX: usize = 15;

/// Solves epochs by themselves; holds memory that is used again, and no state.
#[derive(Debug, Default)]
pub(super) struct SinglePoint {
    measurements: Measurements,
    rows: Vec<Row>,
    velocity: VelocityEstimator,
    /// By measurement: whether no reflection explains its residual.
    wild: Vec<bool>,
    /// What the clocks of the epoch's constellations are tied by, if they are.
    ties: Option<[Tie; Constellation::COUNT]>,
    search: Search,
    influences: Vec<Influence>,
}

/// A position found, with the rows that determined it.
struct Fit {
    /// Where the rows were linearised.
    origin: Ecef,
    step: Step,
    /// Measurements less unknowns.
    degrees: usize,
    /// Sum of squared whitened residuals over its limit; `None` without redundancy.
    test_ratio: Option<f64>,
    /// What the stated covariance is multiplied by.
    variance_factor: f64,
}

/// An answer, or why there is none.
type Answer = Result<Answered, Reason>;

/// A fit with what is made of it.
struct Answered {
    fit: Fit,
    estimate: SolutionEstimate,
    protection: Option<Protection>,
}

/// Satellites that give a position, however uncertain.
const SUFFICIENT: usize = 5;

/// Whether an answer of four satellites is none: its standard deviation is above a kilometre.
fn is_lost(Answered { estimate, .. }: &Answered) -> bool {
    estimate.satellites_used.len() < SUFFICIENT && LOST_M * LOST_M < estimate.covariance.trace()
}

impl Fit {
    /// The position.
    fn position(&self) -> Ecef {
        Ecef(self.origin.0 + self.step.position_m)
    }

    /// Whether the residual test was made and passed.
    fn is_valid(&self) -> bool {
        self.test_ratio.is_some_and(|ratio| ratio <= 1.0)
    }
}

impl SinglePoint {
    /// Solves one epoch, from `start` if it is given and else from the Earth's centre.
    pub(super) fn solve(&mut self, inputs: &EpochInputs<'_>, start: Option<Ecef>) -> Solution {
        self.gather(inputs);
        let answer = self.answer(inputs, start);
        self.solution(inputs, answer)
    }

    /// As [`Self::solve`], but where the satellites do not determine every clock by themselves the
    /// clocks are tied by `biases`; learns these where they do.
    fn solve_with(
        &mut self,
        inputs: &EpochInputs<'_>,
        start: Option<Ecef>,
        biases: &mut SystemBiases,
    ) -> Solution {
        let (time, options) = (inputs.epoch.time, inputs.options());
        self.gather(inputs);
        let ties = biases.ties(time, &options.graph);
        self.search.known = biases.is_known().then_some(ties);
        let mut answer = self.answer(inputs, start);
        let fit = answer.as_ref().ok().map(|answered| &answered.fit);
        if let Some(fit) = fit.filter(|fit| fit.is_valid()) {
            biases.learn(time, &fit.step.clocks(&self.rows), &options.graph);
        }
        let is_redundant = fit.is_some_and(|fit| fit.test_ratio.is_some());
        if options.fault_exclusion && !is_redundant {
            (self.ties, self.search.known) = (Some(ties), Some(ties));
            let tied = self.answer(inputs, start);
            // Without redundancy a free clock hides what the ties show.
            if !tied.as_ref().is_ok_and(is_lost)
                && matches!(tied, Ok(_) | Err(Reason::NotConverged))
            {
                answer = tied;
            }
        }
        self.solution(inputs, answer)
    }

    fn gather(&mut self, inputs: &EpochInputs<'_>) {
        self.measurements.gather(inputs.epoch, inputs.navigation, inputs.options());
        self.wild.clear();
        self.wild.resize(self.measurements.list.len(), false);
        (self.ties, self.search.known) = (None, None);
    }

    fn answer(&mut self, inputs: &EpochInputs<'_>, start: Option<Ecef>) -> Answer {
        let fit = self.fit(inputs, start)?;
        let frame = LocalFrame::at(fit.position());
        let estimate = self.estimate(inputs.epoch, &frame, &fit, inputs.options())?;
        let protection = self.protection(&frame, &fit, inputs.options().integrity.risk);
        Ok(Answered { fit, estimate, protection })
    }

    fn solution(&self, inputs: &EpochInputs<'_>, answer: Answer) -> Solution {
        let epoch = inputs.epoch;
        let mut reasons = self.aiding_reasons();
        match answer {
            Err(reason) => {
                reasons.push(reason);
                Solution::none(epoch.time, reasons)
            }
            Ok(Answered { fit, estimate, protection }) => {
                reasons.extend(self.quality_reasons(&fit));
                Solution {
                    time: epoch.time,
                    status: Status::Single,
                    protection,
                    estimate: Some(estimate),
                    reasons,
                    provenance: self.provenance(),
                }
            }
        }
    }

    /// Measurements of the epoch solved last, none excluded; placed where its position is, if it
    /// has one.
    pub(super) fn measurements(&mut self) -> &mut Measurements {
        self.measurements.list.iter_mut().for_each(|measurement| measurement.is_excluded = false);
        &mut self.measurements
    }

    fn fit(&mut self, inputs: &EpochInputs<'_>, start: Option<Ecef>) -> Result<Fit, Reason> {
        self.wild.fill(false);
        let found = match start {
            Some(position) => Ok(position),
            None => self.coarse_position(),
        };
        let found = found.and_then(|start| self.converge(inputs, start));
        if !inputs.options().fault_exclusion {
            return found.map(|(origin, step)| self.judge(inputs, origin, step));
        }
        let all = found.map(|(origin, step)| self.judge(inputs, origin, step));
        let judged = match all {
            Err(reason) if reason.is_geometry() => return Err(reason),
            Ok(fit) if fit.is_valid() || !self.has_wild(&fit.step) => fit,
            _ => {
                let (origin, step) = self.consensus(inputs)?;
                self.judge(inputs, origin, step)
            }
        };
        Ok(self.validated(inputs, judged))
    }

    /// A position good to kilometres from unit weights and no atmosphere.
    fn coarse_position(&mut self) -> Result<Ecef, Reason> {
        let mut position = Ecef::new(0.0, 0.0, 0.0);
        for _ in 0..STEPS_MAX {
            self.rows.clear();
            for index in 0..self.measurements.list.len() {
                let row = self.raw_row(index, position);
                self.rows.push(row);
            }
            let step = self.determined_step()?;
            position.0 += step.position_m;
            if step.position_m.norm() < COARSE_STEP_M {
                return Ok(position);
            }
        }
        Err(Reason::NotConverged)
    }

    /// Steps with full models until one is short; gives where the last step began, and that step.
    fn converge(&mut self, inputs: &EpochInputs<'_>, start: Ecef) -> Result<(Ecef, Step), Reason> {
        let mut position = start;
        for _ in 0..STEPS_MAX {
            self.measurements
                .place(position, inputs.epoch.time, inputs.navigation, inputs.options())
                .ok_or(Reason::NotConverged)?;
            self.linearize(position);
            let step = self.determined_step()?;
            if step.position_m.norm() < LAST_STEP_M {
                return Ok((position, step));
            }
            position.0 += step.position_m;
        }
        Err(Reason::NotConverged)
    }

    /// Rows of the placed measurements above the mask.
    fn linearize(&mut self, position: Ecef) {
        self.rows.clear();
        for (index, measurement) in self.measurements.list.iter().enumerate() {
            if !measurement.is_above_mask || measurement.is_excluded || self.wild[index] {
                continue;
            }
            let (range_m, gradient) = geometric_range(measurement.state.position, position);
            self.rows.push(Row {
                index,
                constellation: measurement.satellite.constellation,
                gradient: gradient.transpose(),
                residual_m: range_m - measurement.corrected_range_m,
                weight: measurement.variance_m2.recip(),
                is_used: true,
            });
        }
    }

    /// The step of the rows, or why there is none.
    fn determined_step(&mut self) -> Result<Step, Reason> {
        let mut counts = [0_usize; Constellation::COUNT];
        self.rows.iter().for_each(|row| counts[row.constellation.index()] += 1);
        if let Some(ties) = &self.ties {
            // As below, but where the clock is known.
            let determines = |c: Constellation| 1 < counts[c.index()] || ties[c.index()].is_known;
            self.rows.iter_mut().for_each(|row| row.is_used = determines(row.constellation));
            let used = self.rows.iter().filter(|row| row.is_used).count();
            if used < 4 {
                return Err(Reason::TooFewSatellites { used, needed: 4 });
            }
            let step = self.step_of(&self.rows);
            return step.ok_or(Reason::GeometryTooWeak { gdop: f64::INFINITY });
        }
        let needed = 3 + counts.iter().filter(|count| 0 < **count).count();
        let too_few = Reason::TooFewSatellites { used: self.rows.len(), needed: needed.max(4) };
        // A constellation's only satellite determines its clock and nothing else.
        self.rows.iter_mut().for_each(|row| row.is_used = 1 < counts[row.constellation.index()]);
        let used = counts.iter().filter(|count| 1 < **count).sum::<usize>();
        let unknowns = 3 + counts.iter().filter(|count| 1 < **count).count();
        if used < unknowns.max(4) {
            return Err(too_few);
        }
        Step::solve(&self.rows).ok_or(Reason::GeometryTooWeak { gdop: f64::INFINITY })
    }

    /// The step of rows, with clocks free or tied.
    fn step_of(&self, rows: &[Row]) -> Option<Step> {
        match &self.ties {
            Some(ties) => Step::solve_tied(rows, ties),
            None => Step::solve(rows),
        }
    }
}
