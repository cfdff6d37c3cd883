//! The answer of an epoch made anew from what is known by now.

use nalgebra::{Matrix3, Vector3};

use crate::config::RtkOptions;
use crate::gnss::{Enu, LocalFrame, Reason, Solution, Status, Velocity};
use crate::graph::Smoother;
use crate::lambda::Resolver;
use crate::positioning::factors::VELOCITY;

use super::answer::gradient_covariance;
use super::answered::{Answered, Named};
use super::arcs::Label;
use super::epoch::STATE;
use super::float::FloatSolution;
use super::held::{Ambiguity, hold};
use super::labels::{Era, Labels};
use super::placed::FixedPosition;

/// What is known of an epoch by now.
pub(super) struct Revision<'a> {
    frame: &'a LocalFrame,
    float: FloatSolution,
    /// East, north and up (m/s), with covariance.
    velocity: Velocity,
    options: &'a RtkOptions,
}

impl<'a> Revision<'a> {
    /// Of the state that a smoother has reached.
    pub(super) fn at(
        smoother: &Smoother<STATE>,
        frame: &'a LocalFrame,
        options: &'a RtkOptions,
    ) -> Self {
        let (state, covariances) = (smoother.state(), smoother.covariances());
        let pace = covariances.state().fixed_view::<3, 3>(VELOCITY, VELOCITY).into_owned();
        Self {
            frame,
            float: FloatSolution::of_graph(state, smoother.border().to_vec(), covariances),
            velocity: Velocity {
                velocity_m_s: state.fixed_rows::<3>(VELOCITY).into_owned(),
                covariance: pace,
                clock_drift_m_s: 0.0,
            },
            options,
        }
    }

    /// The epoch with all that is known by now.
    ///
    /// One that found none itself must hold the integers of half of its ambiguities or more: those
    /// of a few that were found at another time fit by chance too often. One that held integers and
    /// cannot hold any now stays as it was, unless those found since are others: float, by what
    /// came after it, a slip perhaps, it would be worse.
    pub(super) fn of(
        &self,
        answered: &Answered,
        labels: &Labels,
        resolver: &mut Resolver,
    ) -> Answered {
        let was_fixed = answered.solution.status == Status::Fixed;
        let mut is_contradicted = false;
        for era in labels.standing(answered.named.iter().map(|named| named.serial)) {
            let is_own = era.number == answered.era && was_fixed;
            if !era.was_kept && !is_own {
                continue;
            }
            let ambiguity =
                |named| Ambiguity { named, label: labels.find(named.serial, era.number) };
            let ambiguities: Vec<_> = answered.named.iter().map(ambiguity).collect();
            let (float, options) = (&self.float, self.options);
            let is_enough =
                |fixed: &FixedPosition| was_fixed || ambiguities.len() <= 2 * fixed.held;
            let held = hold(float, &ambiguities, era.probability, resolver, options);
            if let Some(fixed) = held.filter(is_enough) {
                let solution = self.fixed(answered, &fixed, era);
                return Answered { solution, era: era.number, ..answered.clone() };
            }
            is_contradicted |= contradicts(labels, answered, era.number);
        }
        match was_fixed && !is_contradicted {
            true => answered.clone(),
            false => Answered { solution: self.float(answered), ..answered.clone() },
        }
    }

    fn fixed(&self, answered: &Answered, fixed: &FixedPosition, era: &Era) -> Solution {
        let mut solution = self.moved(answered, &fixed.position, &fixed.covariance);
        solution.status = Status::Fixed;
        solution.reasons.retain(|reason| !keeps_from_fixing(reason));
        let estimate = solution.estimate.as_mut();
        if let Some(relative) = estimate.and_then(|estimate| estimate.relative.as_mut()) {
            relative.fixed_ambiguities = fixed.held;
            relative.ambiguities = relative.ambiguities.max(fixed.held);
            (relative.ratio, relative.success_rate) = (era.ratio, era.success_rate);
            relative.fix_probability = Some(fixed.probability);
        }
        solution
    }

    fn float(&self, answered: &Answered) -> Solution {
        let covariance = self.float.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let mut solution = self.moved(answered, &self.float.position, &covariance);
        if solution.status == Status::Fixed {
            solution.reasons.push(Reason::FixRejected);
        }
        solution.status = Status::Float;
        let estimate = solution.estimate.as_mut();
        if let Some(relative) = estimate.and_then(|estimate| estimate.relative.as_mut()) {
            (relative.fixed_ambiguities, relative.fix_probability) = (0, None);
        }
        solution
    }

    /// The answer with another local position; what the receiver's clock was is not asked again.
    fn moved(
        &self,
        answered: &Answered,
        position: &Vector3<f64>,
        covariance: &Matrix3<f64>,
    ) -> Solution {
        let mut solution = answered.solution.clone();
        let rotation = &self.frame.rotation;
        let to_ecef = |c: &Matrix3<f64>| rotation.transpose() * c * rotation;
        if let Some(estimate) = &mut solution.estimate {
            let place = self.frame.to_ecef(Enu(*position));
            let mut covariance = *covariance;
            if let Some(relative) = &mut estimate.relative {
                relative.baseline_m += place.0 - estimate.position.0;
                covariance += gradient_covariance(self.options, relative.baseline_m.norm());
            }
            estimate.position = place;
            estimate.covariance = to_ecef(&covariance);
            estimate.velocity = Some(Velocity {
                velocity_m_s: rotation.transpose() * self.velocity.velocity_m_s,
                covariance: to_ecef(&self.velocity.covariance),
                ..self.velocity
            });
        }
        solution
    }
}

/// Whether an era has other integers for an epoch than the epoch's own.
fn contradicts(labels: &Labels, answered: &Answered, era: u32) -> bool {
    let both = |named: &Named| {
        Some((labels.find(named.serial, answered.era)?, labels.find(named.serial, era)?))
    };
    let both: Vec<(Label, Label)> = answered.named.iter().filter_map(both).collect();
    both.iter().enumerate().any(|(i, a)| {
        both[..i].iter().any(|b| {
            let differences = a.0.less(b.0).zip(a.1.less(b.1));
            differences.is_some_and(|(own, other)| own != other)
        })
    })
}

/// Whether a reason says why no integers are held.
fn keeps_from_fixing(reason: &Reason) -> bool {
    matches!(
        reason,
        Reason::RatioBelowThreshold { .. }
            | Reason::SuccessRateTooLow { .. }
            | Reason::FixRejected
            | Reason::FixImprecise { .. }
            | Reason::TooFewCommonSatellites { .. }
    )
}
