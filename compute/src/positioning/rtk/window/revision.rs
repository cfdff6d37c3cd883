//! The revision of an epoch with everything that is known now.

use nalgebra::{Matrix3, Vector3};

use crate::config::RtkOptions;
use crate::gnss::{LocalFrame, Reason, Solution, Status, Velocity};
use crate::graph::Smoother;
use crate::lambda::Resolver;
use crate::positioning::factors::VELOCITY;
use crate::positioning::rtk::ambiguity::{
    EarlierAmbiguity, FixedPosition, FloatSolution, HoldPeriod, IntegerHistory,
    condition_on_known_integers,
};
use crate::positioning::rtk::answer::{is_by_companion, keeps_from_fixing, moved};
use crate::positioning::rtk::observed::{ArcReference, HeldInteger, STATE};

use super::record::EpochRecord;

/// What is known of an epoch now.
pub(crate) struct Revision<'a> {
    frame: &'a LocalFrame,
    float: FloatSolution,
    /// Local (m/s), with covariance.
    velocity: Velocity,
    options: &'a RtkOptions,
    /// Factor on the variance of a position without integers.
    float_factor: f64,
}

impl<'a> Revision<'a> {
    /// From the state that the smoother has reached.
    pub(crate) fn at(
        smoother: &Smoother<STATE>,
        frame: &'a LocalFrame,
        options: &'a RtkOptions,
        float_factor: f64,
    ) -> Self {
        let (state, covariances) = (smoother.state(), smoother.covariances());
        let velocity_covariance =
            covariances.state().fixed_view::<3, 3>(VELOCITY, VELOCITY).into_owned();
        Self {
            frame,
            float: FloatSolution::of_graph(state, smoother.border().to_vec(), covariances),
            velocity: Velocity {
                velocity_m_s: state.fixed_rows::<3>(VELOCITY).into_owned(),
                covariance: velocity_covariance,
                clock_drift_m_s: 0.0,
            },
            options,
            float_factor,
        }
    }

    /// Revises an epoch.
    ///
    /// An epoch that was not fixed itself needs integers for at least half of its ambiguities: a
    /// few integers of another time fit by chance too often. A fixed epoch that accepts no integers
    /// now keeps its answer, since the float one is worse, unless the integers found since
    /// contradict its own.
    pub(crate) fn of(
        &self,
        record: &EpochRecord,
        integers: &IntegerHistory,
        resolver: &mut Resolver,
    ) -> EpochRecord {
        let was_fixed = record.solution.status == Status::Fixed;
        let mut is_contradicted = false;
        for period in integers.not_refuted(record.arcs.iter().map(|arc| arc.serial)) {
            let is_own = period.number == record.period && was_fixed;
            if !period.was_confirmed && !is_own {
                continue;
            }
            let held = |arc: &ArcReference| integers.find(arc.serial, period.number);
            let ambiguity = |arc| EarlierAmbiguity { arc, held: held(arc) };
            let ambiguities: Vec<_> = record.arcs.iter().map(ambiguity).collect();
            let (float, options) = (&self.float, self.options);
            let is_enough =
                |fixed: &FixedPosition| was_fixed || ambiguities.len() <= 2 * fixed.held;
            let fixed = condition_on_known_integers(
                float,
                &ambiguities,
                period.probability,
                resolver,
                options,
            );
            if let Some(fixed) = fixed.filter(is_enough) {
                let solution = self.fixed(record, &fixed, period);
                return EpochRecord { solution, period: period.number, ..record.clone() };
            }
            is_contradicted |= contradicts(integers, record, period.number);
        }
        match was_fixed && !is_contradicted {
            true => record.clone(),
            false => EpochRecord { solution: self.float(record), ..record.clone() },
        }
    }

    fn fixed(&self, record: &EpochRecord, fixed: &FixedPosition, period: &HoldPeriod) -> Solution {
        let mut solution = self.moved(record, &fixed.position, &fixed.covariance);
        solution.status = Status::Fixed;
        solution.reasons.retain(|reason| !keeps_from_fixing(reason));
        let estimate = solution.estimate.as_mut();
        if let Some(relative) = estimate.and_then(|estimate| estimate.relative.as_mut()) {
            relative.fixed_ambiguities = fixed.held;
            relative.ambiguities = relative.ambiguities.max(fixed.held);
            (relative.ratio, relative.success_rate) = (period.ratio, period.success_rate);
            relative.fix_probability = Some(fixed.probability * period.reliability);
        }
        solution
    }

    /// The answer without integers. An answer of the companion stays, as it is mostly ten times as
    /// accurate.
    fn float(&self, record: &EpochRecord) -> Solution {
        if is_by_companion(&record.solution) {
            return record.solution.clone();
        }
        let covariance = self.float.covariance.fixed_view::<3, 3>(0, 0) * self.float_factor;
        let mut solution = self.moved(record, &self.float.position, &covariance);
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

    /// The answer at another local position. The receiver clock is unchanged.
    fn moved(
        &self,
        record: &EpochRecord,
        position: &Vector3<f64>,
        covariance: &Matrix3<f64>,
    ) -> Solution {
        let place = (position, covariance);
        let mut solution = moved(&record.solution, self.frame, place, self.options);
        let rotation = &self.frame.rotation;
        if let Some(estimate) = &mut solution.estimate {
            estimate.velocity = Some(Velocity {
                velocity_m_s: rotation.transpose() * self.velocity.velocity_m_s,
                covariance: rotation.transpose() * self.velocity.covariance * rotation,
                ..self.velocity
            });
        }
        solution
    }
}

/// Whether a period's integers contradict those of the epoch's own period.
fn contradicts(integers: &IntegerHistory, record: &EpochRecord, period: u32) -> bool {
    let both = |arc: &ArcReference| {
        Some((integers.find(arc.serial, record.period)?, integers.find(arc.serial, period)?))
    };
    let both: Vec<(HeldInteger, HeldInteger)> = record.arcs.iter().filter_map(both).collect();
    both.iter().enumerate().any(|(i, a)| {
        both[..i].iter().any(|b| {
            let differences = a.0.minus(b.0).zip(a.1.minus(b.1));
            differences.is_some_and(|(own, other)| own != other)
        })
    })
}
