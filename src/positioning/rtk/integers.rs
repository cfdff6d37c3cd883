//! From float ambiguities to integers, and back to the position.

use nalgebra::{DMatrix, Matrix3, Vector3};

use crate::config::RtkOptions;
use crate::gnss::{Constellation, Reason};
use crate::graph::{Covariances, Estimate};
use crate::lambda::{
    Conditioning, FailureRate, Options, Partial, RatioTest, RealParameters, Rejection, Resolver,
};

use super::arcs::Arc;
use super::epoch::STATE;

/// Ambiguities that storage is made for at first.
const CAPACITY: usize = 64;
/// Candidates that the posterior probability is made of.
const CANDIDATES: usize = 4;
/// Integers tried in all searches of one epoch together.
const NODES_MAX: usize = 20_000;
/// Subsets tried in one epoch.
const ATTEMPTS_MAX: usize = 12;

/// A position with integers held.
#[derive(Clone, Copy, Debug)]
pub(super) struct FixedPosition {
    /// Local (m).
    pub(super) position: Vector3<f64>,
    /// (m²).
    pub(super) covariance: Matrix3<f64>,
    /// Double differences held.
    pub(super) held: usize,
    /// Estimated probability that they are right.
    pub(super) probability: f64,
}

/// What looking for integers came to.
#[derive(Clone, Debug)]
pub(super) struct Resolution {
    /// Double differences there were.
    pub(super) ambiguities: usize,
    pub(super) ratio: Option<f64>,
    pub(super) success_rate: Option<f64>,
    pub(super) outcome: Result<FixedPosition, Reason>,
}

/// A double difference against the reference of its group, as places in the list of arcs.
#[derive(Clone, Copy, Debug)]
struct DoubleDifference {
    arc: usize,
    reference: usize,
}

/// Resolves integers; its memory is used again.
#[derive(Clone, Debug)]
pub(super) struct Integers {
    resolver: Resolver,
    conditioning: Conditioning,
    pairs: Vec<DoubleDifference>,
    /// Place of each arc among the covariances.
    places: Vec<Option<usize>>,
    float: Vec<f64>,
    order: Vec<usize>,
}

impl Integers {
    pub(super) fn new() -> Self {
        Self {
            resolver: Resolver::with_capacity(CAPACITY),
            conditioning: Conditioning::with_capacity(CAPACITY, 3),
            pairs: Vec::new(),
            places: Vec::new(),
            float: Vec::new(),
            order: Vec::new(),
        }
    }

    /// Looks for the integers of the arcs that are `present`.
    pub(super) fn resolve(
        &mut self,
        arcs: &[Arc],
        is_present: impl Fn(&Arc) -> bool,
        estimate: &Estimate<STATE>,
        covariances: &Covariances<STATE>,
        options: &RtkOptions,
    ) -> Resolution {
        let is_eligible = |arc: &Arc| {
            is_present(arc)
                && !arc.half_cycle
                && arc.satellite.constellation != Constellation::Glonass
                && options.elevation_mask_rad <= arc.elevation_rad
        };
        self.difference(arcs, is_eligible, covariances);
        let n = self.pairs.len();
        let mut resolution = Resolution {
            ambiguities: n,
            ratio: None,
            success_rate: None,
            outcome: Err(Reason::FixRejected),
        };
        if n < options.fixed_min {
            let (used, needed) = (n, options.fixed_min);
            resolution.outcome = Err(Reason::TooFewCommonSatellites { used, needed });
            return resolution;
        }
        let value = |arc: usize| estimate.border[arcs[arc].variable];
        self.float.clear();
        self.float.extend(self.pairs.iter().map(|p| value(p.arc) - value(p.reference)));
        let covariance = self.covariance(covariances);
        self.order.clear();
        self.order.extend(0..n);
        let elevation = |place: &usize| arcs[self.pairs[*place].arc].elevation_rad;
        self.order.sort_by(|a, b| elevation(a).total_cmp(&elevation(b)));
        let failure = FailureRate::PerMille;
        let lambda = Options {
            success_rate_min: options.success_rate_min,
            ratio_test: RatioTest::FixedFailureRateAtLeast(failure, options.ratio_min),
            fixed_min: options.fixed_min,
            candidates: CANDIDATES,
            nodes_max: NODES_MAX,
            attempts_max: ATTEMPTS_MAX,
        };
        let order = Partial::Ordered(&self.order);
        let Ok(outcome) = self.resolver.resolve(&self.float, &covariance, order, &lambda) else {
            return resolution;
        };
        resolution.ratio = outcome.ratio;
        resolution.success_rate = Some(outcome.success_rate);
        resolution.outcome = match outcome.rejection {
            Some(Rejection::Ratio) => Err(Reason::RatioBelowThreshold {
                ratio: outcome.ratio.unwrap_or(1.0),
                threshold: outcome.ratio_threshold,
            }),
            Some(Rejection::SuccessRate | Rejection::SearchLimit) => {
                Err(Reason::SuccessRateTooLow { success_rate: outcome.success_rate })
            }
            Some(Rejection::TooFew | Rejection::Magnitude) => Err(Reason::FixRejected),
            None => {
                let probability = outcome.probability.unwrap_or(0.0);
                self.condition(estimate, covariances, &covariance, probability)
            }
        };
        resolution
    }

    /// Double differences of the eligible arcs, each against the highest of its group.
    fn difference(
        &mut self,
        arcs: &[Arc],
        is_eligible: impl Fn(&Arc) -> bool,
        covariances: &Covariances<STATE>,
    ) {
        let variables = covariances.variables();
        self.places.clear();
        self.places.extend(arcs.iter().map(|arc| {
            let place = variables.iter().position(|variable| *variable == arc.variable);
            place.filter(|_| is_eligible(arc))
        }));
        self.pairs.clear();
        for (arc, own) in arcs.iter().enumerate() {
            if self.places[arc].is_none() {
                continue;
            }
            let mut reference = arc;
            for (other, candidate) in arcs.iter().enumerate() {
                let is_higher = arcs[reference].elevation_rad < candidate.elevation_rad;
                if is_higher && self.places[other].is_some() && candidate.group() == own.group() {
                    reference = other;
                }
            }
            if reference != arc {
                self.pairs.push(DoubleDifference { arc, reference });
            }
        }
    }

    fn place(&self, arc: usize) -> usize {
        self.places[arc].expect("arcs of double differences are eligible")
    }

    fn covariance(&self, covariances: &Covariances<STATE>) -> DMatrix<f64> {
        let n = self.pairs.len();
        let places: Vec<_> =
            self.pairs.iter().map(|p| (self.place(p.arc), self.place(p.reference))).collect();
        let mut matrix = DMatrix::zeros(n, n);
        for (j, &(b, s)) in places.iter().enumerate() {
            for (i, &(a, r)) in places[..=j].iter().enumerate() {
                let own = covariances.border_at(a, b) - covariances.border_at(a, s);
                let references = covariances.border_at(r, b) - covariances.border_at(r, s);
                matrix[(i, j)] = own - references;
                matrix[(j, i)] = own - references;
            }
        }
        matrix
    }

    /// The position conditioned on the integers held.
    fn condition(
        &mut self,
        estimate: &Estimate<STATE>,
        covariances: &Covariances<STATE>,
        covariance: &DMatrix<f64>,
        probability: f64,
    ) -> Result<FixedPosition, Reason> {
        let newest = estimate.states.last().expect("a window that was solved has a state");
        let mut cross = DMatrix::zeros(3, self.pairs.len());
        for (j, pair) in self.pairs.iter().enumerate() {
            let own = covariances.cross_at(self.place(pair.arc));
            let reference = covariances.cross_at(self.place(pair.reference));
            for axis in 0..3 {
                cross[(axis, j)] = own[axis] - reference[axis];
            }
        }
        let place = covariances.state().fixed_view::<3, 3>(0, 0);
        let mut real = RealParameters {
            estimate: nalgebra::DVector::from_fn(3, |axis, _| newest[axis]),
            covariance: DMatrix::from_fn(3, 3, |i, j| place[(i, j)]),
            cross,
        };
        let fix = self.resolver.fix();
        let conditioned = self.conditioning.apply(fix, &self.float, covariance, &mut real);
        conditioned.map_err(|_| Reason::FixRejected)?;
        Ok(FixedPosition {
            position: Vector3::new(real.estimate[0], real.estimate[1], real.estimate[2]),
            covariance: Matrix3::from_fn(|i, j| real.covariance[(i, j)]),
            held: fix.len(),
            probability,
        })
    }
}
