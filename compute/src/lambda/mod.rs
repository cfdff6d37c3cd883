//! Integer least squares: from a real-valued estimate with its covariance to integers.
//!
//! ǎ = argmin over z ∈ ℤⁿ of ‖â − z‖²_Q = (â − z)ᵀ Q⁻¹ (â − z)
//!
//! `reduction` decorrelates Q by a unimodular Z, `search` enumerates the ellipsoid for the best
//! integers, `success` and `validation` give their reliability, `resolver` combines these and fixes
//! a subset when the full set is too weak. `separation` tests known integers without some of the
//! entries. The physical meaning of the integers, and their effect on real-valued parameters, is
//! the caller's concern.
//!
//! Sources: Teunissen (1995), *The least-squares ambiguity decorrelation adjustment*;
//! de Jonge & Tiberius (1996), *The LAMBDA method for integer ambiguity estimation: implementation
//! aspects*, LGR-Series 12; Chang, Yang & Zhou (2005), *MLAMBDA: a modified LAMBDA method for
//! integer least-squares estimation*, J. Geodesy 79.
//!
//! # Example
//!
//! Three strongly correlated entries whose best integers rounding does not find:
//!
//! ```
//! use graphfix_compute::lambda::*;
//! use nalgebra::DMatrix;
//!
//! let float = [5.450, 3.100, 2.970];
//! let covariance = [6.290, 5.978, 0.544, 5.978, 6.292, 2.340, 0.544, 2.340, 6.288];
//! let covariance = DMatrix::from_row_slice(3, 3, &covariance);
//! let options = Options {
//!     success_rate_min: 0.0,
//!     ratio_min: 1.2,
//!     probability_min: 0.0,
//!     scale: None,
//!     fixed_min: 3,
//!     candidates: 2,
//!     nodes_max: 1_000,
//!     attempts_max: 1,
//! };
//! let mut resolver = Resolver::with_capacity(3);
//! let outcome = resolver.resolve(&float, &covariance, Partial::None, &options)?;
//! assert_eq!(outcome.rejection, None);
//! assert_eq!(resolver.fix().entries(), [Some(5), Some(3), Some(4)]);
//! # Ok::<(), LambdaError>(())
//! ```

mod fix;
mod reduction;
mod resolver;
mod search;
mod separation;
mod success;
mod validation;

pub use fix::Fix;
pub use resolver::{Options, Outcome, Partial, Rejection, Resolver};
pub(crate) use separation::{Separated, Separation};
pub use validation::KnownScale;

/// Why integers cannot be searched for. Real data causes all but the dimension errors.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LambdaError {
    /// The estimate has no entries.
    #[error("the float estimate is empty")]
    Empty,
    /// The sizes of two arguments disagree.
    #[error("{what} has size {actual}, expected {expected}")]
    Dimension {
        /// Name of the argument.
        what: &'static str,
        /// Size of that argument.
        actual: usize,
        /// The size that the other arguments need.
        expected: usize,
    },
    /// An index of a subset is outside the estimate, or occurs twice.
    #[error("index {index} is outside 0..{size} or occurs twice")]
    Index {
        /// The index that is invalid.
        index: usize,
        /// Number of entries of the estimate.
        size: usize,
    },
    /// A float estimate is not finite, or too large for exact rounding.
    #[error("float estimate {index} is {value}, not within ±2⁵²")]
    Float {
        /// Index of the entry.
        index: usize,
        /// Value of the entry (cycles, or the caller's unit).
        value: f64,
    },
    /// The covariance is not positive definite (to working precision) or not finite.
    #[error("covariance is not positive definite: conditional variance {pivot} of entry {index}")]
    NotPositiveDefinite {
        /// Index of the entry whose conditional variance fails.
        index: usize,
        /// Conditional variance of that entry.
        pivot: f64,
    },
    /// A decorrelated entry exceeds the integers that an `f64` represents exactly.
    #[error("covariance is too badly conditioned: a decorrelated entry exceeds 2⁵²")]
    Overflow,
}

/// Largest magnitude below which every integer and half-integer is exact in an `f64`.
const EXACT_MAX: f64 = 4_503_599_627_370_496.0;

/// The nearest integer. Of two equally near it is the even one, or beyond 2⁵⁰ the one away from
/// zero.
///
/// The sum with 1.5·2⁵² has no digits after the point. So this costs two additions, while
/// `f64::round` is a call on processors without an instruction for it.
#[inline]
fn nearest(value: f64) -> f64 {
    const SHIFT: f64 = 1.5 * EXACT_MAX;
    match value.abs() < 0.25 * EXACT_MAX {
        true => (value + SHIFT) - SHIFT,
        false => value.round(),
    }
}

#[cfg(test)]
mod tests;
