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
mod exclusion;
mod least_squares;
mod single_points;

use crate::gnss::{Constellation, Ecef, Reason, Solution, Status};
use crate::models::geometric_range;

use super::Measurements;
use super::engine::EpochInputs;
use super::velocity::VelocityEstimator;
use least_squares::{Row, Step};

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

impl Fit {
    /// Whether the residual test was made and passed.
    fn is_valid(&self) -> bool {
        self.test_ratio.is_some_and(|ratio| ratio <= 1.0)
    }
}

impl SinglePoint {
    /// Solves one epoch, from `start` if it is given and else from the Earth's centre.
    pub(super) fn solve(&mut self, inputs: &EpochInputs<'_>, start: Option<Ecef>) -> Solution {
        let epoch = inputs.epoch;
        self.measurements.gather(epoch, inputs.navigation, inputs.options());
        let fit = self.fit(inputs, start);
        let mut reasons = self.aiding_reasons();
        let outcome = fit.and_then(|fit| {
            let estimate = self.estimate(epoch, &fit, inputs.options())?;
            Ok((fit, estimate))
        });
        match outcome {
            Err(reason) => {
                reasons.push(reason);
                Solution::none(epoch.time, reasons)
            }
            Ok((fit, estimate)) => {
                reasons.extend(self.quality_reasons(&fit));
                Solution {
                    time: epoch.time,
                    status: Status::Single,
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
        let start = match start {
            Some(position) => position,
            None => self.coarse_position()?,
        };
        let (origin, step) = self.converge(inputs, start)?;
        Ok(self.validate(inputs, origin, step))
    }

    /// A position good to kilometres from unit weights and no atmosphere.
    fn coarse_position(&mut self) -> Result<Ecef, Reason> {
        let mut position = Ecef::new(0.0, 0.0, 0.0);
        for _ in 0..STEPS_MAX {
            self.rows.clear();
            for (index, measurement) in self.measurements.list.iter().enumerate() {
                let (range_m, gradient) = geometric_range(measurement.state.position, position);
                self.rows.push(Row {
                    index,
                    constellation: measurement.satellite.constellation,
                    gradient: gradient.transpose(),
                    residual_m: range_m - measurement.pseudorange_m,
                    weight: 1.0,
                    is_used: true,
                });
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
            if !measurement.is_above_mask || measurement.is_excluded {
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
}
