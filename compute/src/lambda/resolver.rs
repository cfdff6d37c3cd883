//! From a float estimate to accepted integers: all of them, a subset, or none with the reason.

use nalgebra::DMatrix;

use crate::lambda::EXACT_MAX;
use crate::lambda::Fix;
use crate::lambda::LambdaError;
use crate::lambda::reduction::Reduction;
use crate::lambda::search::Search;
use crate::lambda::search::SearchLimits;
use crate::lambda::search::SearchOutcome;
use crate::lambda::success::adop;
use crate::lambda::success::bootstrapped_success_rate;
use crate::lambda::validation::{KnownScale, posterior, ratio};

/// Conditions for accepting integers, and limits of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Smallest bootstrapped success rate of the fixed entries; 0: no condition.
    pub success_rate_min: f64,
    /// Smallest ratio R = ‖â − a₂‖² / ‖â − a₁‖² of the second best to the best; 0: no condition.
    pub ratio_min: f64,
    /// Smallest posterior probability of the best candidate; 0: no condition. If the covariance is
    /// right, no other test accepts more integers at the same rate of wrong ones.
    pub probability_min: f64,
    /// Prior of the covariance's unknown scale, for the posterior probability; `None`: the scale is
    /// exact.
    pub scale: Option<KnownScale>,
    /// Smallest number of entries in a fix.
    pub fixed_min: usize,
    /// Number of candidates in the posterior, at least 2.
    pub candidates: usize,
    /// Largest number of integers tried, in all searches of one call together.
    pub nodes_max: usize,
    /// Largest number of subsets tried in one call, the full set included.
    pub attempts_max: usize,
}

/// What to try when the full set is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Partial<'a> {
    /// Nothing: all or none.
    None,
    /// Leave out entries one by one, in this order, weakest first.
    Ordered(&'a [usize]),
}

/// Why the integers are rejected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rejection {
    /// Fewer entries than `fixed_min`.
    TooFew,
    /// The bootstrapped success rate is below its minimum.
    SuccessRate,
    /// The second best is too close to the best.
    Ratio,
    /// The posterior probability of the best candidate is below its minimum.
    Probability,
    /// The search reached its limit of nodes.
    SearchLimit,
    /// The integers are too large to be exact in an `f64`.
    Magnitude,
}

/// The outcome of the accepted attempt, or of the first one (all entries) if none is accepted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// `None` if the integers are accepted.
    pub rejection: Option<Rejection>,
    /// Number of entries tried together, and fixed if accepted.
    pub size: usize,
    /// Bootstrapped success rate of these entries.
    pub success_rate: f64,
    /// Ambiguity dilution of precision of these entries, in the unit of the entries.
    pub adop: f64,
    /// Ratio of second-best to best squared norm, if searched.
    pub ratio: Option<f64>,
    /// Posterior probability that the best integers are right, if their ratio is sufficient.
    pub probability: Option<f64>,
    /// Best squared norm ‖â − ǎ‖²_Q, if searched.
    pub squared_norm: Option<f64>,
    /// Number of integers tried, in all searches of the call.
    pub nodes: usize,
    /// Number of subsets tried in the call.
    pub attempts: usize,
}

/// Resolves integers. Its buffers are reused, so that only the first calls allocate.
#[derive(Clone, Debug)]
pub struct Resolver {
    reduction: Reduction,
    search: Search,
    fix: Fix,
    members: Vec<usize>,
    base: Vec<f64>,
    restored: Vec<f64>,
    weights: Vec<f64>,
    nodes: usize,
    attempts: usize,
}

impl Resolver {
    /// A resolver with room for `size` entries; it grows for more.
    pub fn with_capacity(size: usize) -> Self {
        Self {
            reduction: Reduction::with_capacity(size),
            search: Search::with_capacity(size),
            fix: Fix::with_capacity(size),
            members: Vec::with_capacity(size),
            base: Vec::with_capacity(size),
            restored: Vec::with_capacity(size),
            weights: Vec::with_capacity(size),
            nodes: 0,
            attempts: 0,
        }
    }

    /// Resolves `float` (n) with `covariance` (n×n); [`Self::fix`] then holds the accepted
    /// integers.
    ///
    /// # Errors
    /// Sizes that disagree, floats beyond ±2⁵², a covariance that is not positive definite.
    /// Rejected integers are no error: see [`Outcome::rejection`].
    pub fn resolve(
        &mut self,
        float: &[f64],
        covariance: &DMatrix<f64>,
        partial: Partial<'_>,
        options: &Options,
    ) -> Result<Outcome, LambdaError> {
        check(float, covariance, partial)?;
        (self.nodes, self.attempts) = (0, 0);
        self.load(float, covariance)?;
        let whole = self.attempt(float.len(), options);
        let outcome = match partial {
            _ if whole.rejection.is_none() => whole,
            Partial::None => whole,
            Partial::Ordered(order) => self.drop_in_order(order, options)?.unwrap_or(whole),
        };
        if outcome.rejection.is_some() {
            self.fix.clear(float.len());
        }
        Ok(Outcome { nodes: self.nodes, attempts: self.attempts, ..outcome })
    }

    /// The integers accepted by the last call; empty if they were rejected.
    pub fn fix(&self) -> &Fix {
        &self.fix
    }

    /// Decorrelates the covariance and the floats.
    ///
    /// The nearest integers are subtracted first: the remainders are small and keep their digits.
    fn load(&mut self, float: &[f64], covariance: &DMatrix<f64>) -> Result<(), LambdaError> {
        self.members.clear();
        self.members.extend(0..float.len());
        self.base.clear();
        self.base.extend(float.iter().map(|float| float.round()));
        let fractions = float.iter().zip(&self.base).map(|(float, whole)| float - whole);
        self.reduction.reduce(fractions, covariance.iter().copied())
    }

    /// Leaves out a member.
    fn leave_out(&mut self, member: usize) -> Result<(), LambdaError> {
        self.members.retain(|&other| other != member);
        self.weights.clear();
        self.weights.resize(self.base.len(), 0.0);
        self.weights[member] = 1.0;
        self.reduction.leave_out(&mut self.weights)
    }

    /// Tests the present members and stores their integers if accepted.
    fn attempt(&mut self, size: usize, options: &Options) -> Outcome {
        self.attempts += 1;
        let variances = self.reduction.variances();
        let mut outcome = Outcome {
            rejection: None,
            size: variances.len(),
            success_rate: bootstrapped_success_rate(variances),
            adop: adop(variances),
            ratio: None,
            probability: None,
            squared_norm: None,
            nodes: 0,
            attempts: 0,
        };
        outcome.rejection = if outcome.size < options.fixed_min {
            Some(Rejection::TooFew)
        } else if outcome.success_rate < options.success_rate_min {
            Some(Rejection::SuccessRate)
        } else {
            self.search(options, &mut outcome)
        };
        if outcome.rejection.is_none() {
            self.fix.clear(size);
            self.restored.clear();
            self.restored.extend_from_slice(self.search.candidate(0));
            let (members, best) = (&self.members, &mut self.restored);
            if !self.fix.hold(&self.reduction, members, &self.base, best) {
                outcome.rejection = Some(Rejection::Magnitude);
            }
        }
        outcome
    }

    /// Searches with half of the remaining nodes, so that a smaller subset still has some.
    fn search(&mut self, options: &Options, outcome: &mut Outcome) -> Option<Rejection> {
        let nodes = (options.nodes_max - self.nodes).div_ceil(2);
        let limits = SearchLimits { candidates: options.candidates.max(2), nodes };
        let searched = self.search.run(&self.reduction, limits);
        self.nodes += searched.nodes();
        if let SearchOutcome::LimitReached { .. } = searched {
            return Some(Rejection::SearchLimit);
        }
        let norms = self.search.norms();
        outcome.ratio = ratio(norms);
        outcome.squared_norm = norms.first().copied();
        if outcome.ratio.is_none_or(|ratio| ratio < options.ratio_min) {
            return Some(Rejection::Ratio);
        }
        let variances = self.reduction.variances();
        outcome.probability = Some(posterior(norms, variances, options.scale));
        let is_likely = outcome.probability.is_some_and(|p| options.probability_min <= p);
        (!is_likely).then_some(Rejection::Probability)
    }

    /// Whether another subset may be tried.
    fn has_budget(&self, options: &Options) -> bool {
        self.attempts < options.attempts_max && self.nodes < options.nodes_max
    }

    fn drop_in_order(
        &mut self,
        order: &[usize],
        options: &Options,
    ) -> Result<Option<Outcome>, LambdaError> {
        for &weakest in order {
            if self.members.len() <= options.fixed_min.max(1) || !self.has_budget(options) {
                break;
            }
            self.leave_out(weakest)?;
            let outcome = self.attempt(self.base.len(), options);
            if outcome.rejection.is_none() {
                return Ok(Some(outcome));
            }
        }
        Ok(None)
    }
}

fn check(
    float: &[f64],
    covariance: &DMatrix<f64>,
    partial: Partial<'_>,
) -> Result<(), LambdaError> {
    let size = float.len();
    for actual in [covariance.nrows(), covariance.ncols()] {
        if actual != size {
            return Err(LambdaError::Dimension { what: "covariance", actual, expected: size });
        }
    }
    let outside = |value: &f64| value.is_nan() || EXACT_MAX <= value.abs();
    if let Some(index) = float.iter().position(outside) {
        return Err(LambdaError::Float { index, value: float[index] });
    }
    if let Partial::Ordered(order) = partial {
        for (at, &index) in order.iter().enumerate() {
            if size <= index || order[..at].contains(&index) {
                return Err(LambdaError::Index { index, size });
            }
        }
    }
    Ok(())
}
