//! Integer least squares: a real-valued estimate with its covariance in, integers out.
//!
//! ǎ = argmin over z ∈ ℤⁿ of ‖â − z‖²_Q = (â − z)ᵀ Q⁻¹ (â − z)
//!
//! `reduction` makes Q nearly diagonal by a unimodular Z, `search` walks the ellipsoid for the best
//! integers, `success` and `validation` say how far to trust them, `resolver` joins these and
//! settles for a part when the whole is too weak. What the integers mean, and what they say of
//! real-valued parameters, is the caller's business.
//!
//! Sources: Teunissen (1995), *The least-squares ambiguity decorrelation adjustment*;
//! de Jonge & Tiberius (1996), *The LAMBDA method for integer ambiguity estimation: implementation
//! aspects*, LGR-Series 12; Chang, Yang & Zhou (2005), *MLAMBDA: a modified LAMBDA method for
//! integer least-squares estimation*, J. Geodesy 79.

mod fix;
mod reduction;
mod resolver;
mod search;
mod success;
mod thresholds;
mod validation;

pub use fix::Fix;
pub use reduction::Reduction;
pub use resolver::{Options, Outcome, Partial, Rejection, Resolver};
pub use search::{Search, SearchLimits, SearchOutcome};
pub use success::{adop, bootstrapped_failure_rate, bootstrapped_success_rate};
pub use thresholds::FailureRate;
pub use validation::{
    KnownScale, RatioTest, odds_at_scale, posterior_probability, scaled_posterior_probability,
};

/// Why integers cannot even be looked for. All but the dimensions come from real data.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LambdaError {
    /// Nothing to resolve.
    #[error("the float estimate is empty")]
    Empty,
    /// Sizes that must agree do not.
    #[error("{what} has size {actual}, expected {expected}")]
    Dimension {
        /// Which argument.
        what: &'static str,
        /// The size it has.
        actual: usize,
        /// The size it needs.
        expected: usize,
    },
    /// An index of a subset lies outside the estimate, or stands twice.
    #[error("index {index} is outside 0..{size} or stands twice")]
    Index {
        /// The index.
        index: usize,
        /// Size of the estimate.
        size: usize,
    },
    /// A float estimate is not finite or too large to be rounded exactly.
    #[error("float estimate {index} is {value}, not within ±2⁵²")]
    Float {
        /// Position in the estimate.
        index: usize,
        /// The value.
        value: f64,
    },
    /// The covariance is not positive definite (to working precision) or not finite.
    #[error("covariance is not positive definite: conditional variance {pivot} of entry {index}")]
    NotPositiveDefinite {
        /// Entry whose conditional variance fails.
        index: usize,
        /// That conditional variance.
        pivot: f64,
    },
    /// The decorrelating integers outgrew what an `f64` holds exactly.
    #[error("covariance is too badly conditioned: a transformation entry exceeds 2⁵²")]
    Overflow,
}

/// Largest magnitude below which every integer and half-integer is exact in an `f64`.
const EXACT_MAX: f64 = 4_503_599_627_370_496.0;

#[cfg(test)]
mod tests;
