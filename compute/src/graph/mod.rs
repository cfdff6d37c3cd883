//! Least squares on factor graphs. The caller gives the variables their meaning.
//!
//! Minimises Σᵢ ρᵢ(rᵢ(x)) over a *chain* of states x₀ … xₙ₋₁ of one fixed size and a *border* of
//! scalar variables that may live across many of them. A row (whitened residual rᵢ with its
//! Jacobian) touches one state, or two neighbours, and any border variables; ρᵢ is a robust
//! [`Kernel`].
//!
//! | module | contains |
//! |---|---|
//! | [`kernel`] | robust kernels: loss ρ(s) and weight w(s) = ρ′(s)/s |
//! | [`annealing`] | graduated non-convexity: which kernel width in which iteration |
//! | [`estimate`] | values of all states and border variables |
//! | [`system`] | normal equations H·δ = −g, accumulated row by row |
//! | [`sums`] | rows on the same coordinates, summed before they enter the normal equations |
//! | [`sharing`] | rows with one unknown offset in common, which is eliminated at once |
//! | [`elimination`] | block Cholesky along the chain, border by Schur complement, δ |
//! | [`covariance`] | marginal covariances of any state and of the border |
//! | [`prior`] | old states marginalised into a dense prior |
//! | [`smoother`] | marginalised states, smoothed by the rows that came later |
//! | [`optimizer`] | Gauss–Newton with Levenberg's damping |
//!
//! One elimination serves the sliding window and the batch. Its cost is linear in the number of
//! states. The caller linearises each row and chooses its kernel.
//!
//! Words used in all of these modules:
//!
//! - A row *touches* a variable if its Jacobian with respect to the variable is not zero.
//! - A border variable is *alive* from the first state whose rows touch it. It *retires*, that is,
//!   it is eliminated, after the last such state or at the end of the chain ([`BorderLife`]).
//! - The *front* is the part of H that elimination works on: the next state and the border
//!   variables alive.
//!
//! # Example
//!
//! Two states of (position, velocity), one step of constant velocity apart. Both positions are
//! measured, with one unknown offset: border variable 0, which a prior keeps near zero.
//!
//! ```
//! use graphfix_compute::graph::*;
//!
//! struct Walk;
//!
//! impl Problem<2> for Walk {
//!     fn linearize(&mut self, x: &Estimate<2>, _: Widening, system: &mut System<2>) {
//!         let huber = Kernel::huber(1.345);
//!         for (k, reading) in [1.0, 3.0].into_iter().enumerate() {
//!             let residual = x.states[k][0] + x.border[0] - reading;
//!             let row = Row { residual, columns: [0], jacobian: [1.0] };
//!             system.add_with_border(k, &row, &[(0, 1.0)], &huber);
//!         }
//!         let link = Link {
//!             residual: x.states[1][0] - x.states[0][0] - x.states[0][1],
//!             columns: [0, 1],
//!             jacobian: [-1.0, -1.0],
//!             next_columns: [0],
//!             next_jacobian: [1.0],
//!         };
//!         system.add_link(0, &link, &Kernel::QUADRATIC);
//!         let residual = x.states[1][1] - x.states[0][1];
//!         let (columns, next_columns) = ([1], [1]);
//!         let (jacobian, next_jacobian) = ([-1.0], [1.0]);
//!         let steady = Link { residual, columns, jacobian, next_columns, next_jacobian };
//!         system.add_link(0, &steady, &Kernel::QUADRATIC);
//!         let offset = Row { residual: x.border[0] / 0.1, columns: [], jacobian: [] };
//!         system.add_with_border(0, &offset, &[(0, 10.0)], &Kernel::QUADRATIC);
//!     }
//! }
//!
//! let mut x = Estimate { states: vec![[0.0, 0.0].into(); 2], border: vec![0.0] };
//! let mut workspace = Workspace::new(BorderLife::WholeChain);
//! let schedule = Schedule::direct(20);
//! let options = OptimizerOptions { schedule, tolerance: 1e-6, damping: 0.0 };
//! let summary = optimize(&mut Walk, &mut x, &options, &mut workspace)?;
//! assert_eq!(summary.outcome, Outcome::Converged);
//! assert!((x.states[1][1] - 2.0).abs() < 1e-9);
//!
//! let mut covariances = Covariances::new();
//! covariances.newest(&workspace.elimination);
//! assert!(covariances.border(0, 0) < Some(0.0101));
//! # Ok::<(), EliminationError>(())
//! ```
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
pub mod sharing;
pub mod smoother;
pub mod sums;
pub mod system;

mod block;
mod border;
mod lanes;
mod median;

#[cfg(test)]
pub(crate) mod oracle;

pub use annealing::{AnnealedKernel, Schedule, Stage, Widening};
pub use covariance::Covariances;
pub use elimination::{Elimination, EliminationError, Variable};
pub use estimate::Estimate;
pub(crate) use kernel::HUBER_WIDTH;
pub use kernel::{Kernel, Law};
pub(crate) use median::median;
pub use optimizer::{OptimizerOptions, Outcome, Problem, Summary, Workspace, optimize};
pub use prior::Prior;
pub(crate) use sharing::{SharingRow, shared_offset};
pub(crate) use smoother::{Departure, Smoother};
pub(crate) use sums::{LinkSum, RowSum};
pub use system::{BorderLife, Link, Row, System};
