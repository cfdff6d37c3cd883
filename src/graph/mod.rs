//! Least squares on factor graphs; knows nothing of what its variables mean.
//!
//! Minimises Σᵢ ρᵢ(rᵢ(x)) over a *chain* of states x₀ … xₙ₋₁ of one fixed size and a *border* of
//! scalar variables that may live across many of them. A row (whitened residual rᵢ with its
//! Jacobian) touches one state, or two neighbours, and any border variables; ρᵢ is a robust
//! [`Kernel`].
//!
//! | module | holds |
//! |---|---|
//! | [`kernel`] | robust kernels: loss ρ(s) and weight w(s) = ρ′(s)/s |
//! | [`annealing`] | graduated non-convexity: which kernel width in which iteration |
//! | [`estimate`] | values of all states and border variables |
//! | [`system`] | normal equations H·δ = −g, accumulated row by row |
//! | [`elimination`] | block Cholesky along the chain, border by Schur complement, δ |
//! | [`covariance`] | marginal covariances of any state and of the border |
//! | [`prior`] | old states marginalised into a dense prior |
//! | [`optimizer`] | Gauss–Newton with Levenberg's damping |
//!
//! One elimination serves the sliding window and the batch: its cost is linear in the number of
//! states, and a border variable leaves it after the last state that touches it ([`BorderLife`]).
//! What a variable means, how a row is linearised and which kernel it deserves is the caller's.
//!
//! Sources: Dellaert & Kaess (2017), *Factor Graphs for Robot Perception*, FnT Robotics 6; Golub &
//! Van Loan (2013), *Matrix Computations*, 4th ed., sections 4.2 and 4.5.

pub mod annealing;
pub mod covariance;
pub mod elimination;
pub mod estimate;
pub mod kernel;
pub mod optimizer;
pub mod prior;
pub mod system;

mod block;
mod border;

#[cfg(test)]
pub(crate) mod oracle;

pub use annealing::{AnnealedKernel, Phase, Schedule, Stage};
pub use covariance::Covariances;
pub use elimination::{Elimination, EliminationError, Variable};
pub use estimate::Estimate;
pub use kernel::{Kernel, Law};
pub use optimizer::{OptimizerOptions, Outcome, Problem, Summary, Workspace, optimize};
pub use prior::Prior;
pub use system::{BorderLife, Link, Row, System};
