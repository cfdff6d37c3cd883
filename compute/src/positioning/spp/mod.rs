//! Single-point positioning: one epoch's pseudoranges, weighted least squares, fault exclusion.
//!
//! Unknowns are the position and one clock per constellation. The iteration starts at the Earth's
//! centre or at the previous position. Gauss–Newton steps alternate with correcting the
//! measurements for the new position, until a step is shorter than 0.1 m. The range's curvature
//! (step²/ρ < 1 nm) and the slope of the atmosphere (below 0.1 mm) are then negligible, so that the
//! answer does not depend on the start.
//!
//! The residual test compares the sum of squared whitened residuals with its chi-square limit, and
//! `exclusion` then excludes outliers. An epoch that still fails is answered with the reason. The
//! covariance is multiplied by that sum per degree of freedom, if that is above one.

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
use super::answer::SIGMA_MAX_M;
use super::engine::EpochInputs;
use super::velocity::VelocityEstimator;
use consensus::Search;
use least_squares::{ClockPrior, Row, Step};
use protection::Influence;
use system_biases::SystemBiases;

pub(super) use single_points::SinglePoints;

/// The iteration ends after a step shorter than this (m).
const LAST_STEP_M: f64 = 0.1;
/// After a coarse step shorter than this, full models are used (m).
const COARSE_STEP_M: f64 = 10_000.0;
/// Maximum number of steps, coarse or fine; from the Earth's centre about five and three are taken.
const STEPS_MAX: usize = 15;

/// Solves epochs independently. Contains scratch only, no state.
#[derive(Debug, Default)]
pub(super) struct SinglePoint {
    measurements: Measurements,
    rows: Vec<Row>,
    velocity: VelocityEstimator,
    /// By measurement: whether its residual is too large for multipath.
    wild: Vec<bool>,
    /// Ties between the clocks of the epoch's constellations, if there are any.
    priors: Option<[ClockPrior; Constellation::COUNT]>,
    search: Search,
    influences: Vec<Influence>,
}

/// A position with the rows that determined it.
struct Fit {
    /// Linearisation point of the rows.
    origin: Ecef,
    step: Step,
    /// Number of measurements minus number of unknowns.
    degrees: usize,
    /// Sum of squared whitened residuals over its limit; `None` without redundancy.
    test_ratio: Option<f64>,
    /// Factor on the a-priori covariance.
    variance_factor: f64,
}

/// A position, or the reason why the epoch has none.
type Answer = Result<Answered, Reason>;

/// A fit with its estimate and protection levels.
struct Answered {
    fit: Fit,
    estimate: SolutionEstimate,
    protection: Option<Protection>,
}

/// From this number of satellites on, a position is always given, however uncertain.
const SUFFICIENT: usize = 5;

/// Whether a position from fewer than [`SUFFICIENT`] satellites is useless: its standard deviation
/// is above a kilometre.
fn is_too_uncertain(Answered { estimate, .. }: &Answered) -> bool {
    estimate.satellites_used.len() < SUFFICIENT
        && SIGMA_MAX_M * SIGMA_MAX_M < estimate.covariance.trace()
}

impl Fit {
    /// The position.
    fn position(&self) -> Ecef {
        Ecef(self.origin.0 + self.step.position_m)
    }

    /// Whether there was a residual test and it passed.
    fn is_valid(&self) -> bool {
        self.test_ratio.is_some_and(|ratio| ratio <= 1.0)
    }
}

impl SinglePoint {
    /// Solves one epoch, from `start` if there is one, otherwise from the Earth's centre.
    pub(super) fn solve(&mut self, inputs: &EpochInputs<'_>, start: Option<Ecef>) -> Solution {
        self.gather(inputs);
        let answer = self.answer(inputs, start);
        self.solution(inputs, answer)
    }

    /// Like [`Self::solve`]. If the satellites do not determine every clock, the clocks are tied by
    /// `biases`; if they do, `biases` is updated.
    fn solve_with(
        &mut self,
        inputs: &EpochInputs<'_>,
        start: Option<Ecef>,
        biases: &mut SystemBiases,
    ) -> Solution {
        let (time, options) = (inputs.epoch.time, inputs.options());
        self.gather(inputs);
        let priors = biases.priors(time, &options.graph);
        self.search.known = biases.is_known().then_some(priors);
        let mut answer = self.answer(inputs, start);
        let fit = answer.as_ref().ok().map(|answered| &answered.fit);
        if let Some(fit) = fit.filter(|fit| fit.is_valid()) {
            biases.learn(time, &fit.step.clocks(&self.rows), &options.graph);
        }
        let is_redundant = fit.is_some_and(|fit| fit.test_ratio.is_some());
        if options.fault_exclusion && !is_redundant {
            (self.priors, self.search.known) = (Some(priors), Some(priors));
            let tied = self.answer(inputs, start);
            // Without redundancy a free clock absorbs an error that tied clocks show.
            if !tied.as_ref().is_ok_and(is_too_uncertain)
                && matches!(tied, Ok(_) | Err(Reason::NotConverged))
            {
                answer = tied;
            }
        }
        self.solution(inputs, answer)
    }

    fn gather(&mut self, inputs: &EpochInputs<'_>) {
        let EpochInputs { epoch, navigation, bands, .. } = *inputs;
        self.measurements.gather(epoch, navigation, inputs.options(), bands);
        self.wild.clear();
        self.wild.resize(self.measurements.list.len(), false);
        (self.priors, self.search.known) = (None, None);
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

    /// Measurements of the last epoch, none of them excluded; corrected for its position, if it has
    /// one.
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

    /// A position accurate to kilometres, from unit weights and without atmosphere.
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

    /// Steps with full models until one is short. Returns the start of the last step, and that
    /// step.
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

    /// Rows of the corrected measurements above the mask.
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

    /// The step of the rows, or the reason why there is no position.
    fn determined_step(&mut self) -> Result<Step, Reason> {
        let mut counts = [0_usize; Constellation::COUNT];
        self.rows.iter().for_each(|row| counts[row.constellation.index()] += 1);
        if let Some(priors) = &self.priors {
            // As below; a clock that is known from earlier epochs needs one satellite only.
            let determines = |c: Constellation| 1 < counts[c.index()] || priors[c.index()].is_known;
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
        // The only satellite of a constellation determines its clock and nothing else.
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
        match &self.priors {
            Some(priors) => Step::solve_with_priors(rows, priors),
            None => Step::solve(rows),
        }
    }
}
