//! Gauss–Newton with Levenberg's damping, through the stages of an annealing schedule.
//!
//! Each iteration solves (H + λ·diag H)·δ = −g and steps x ← x + δ. The next linearisation gives
//! the cost at the new estimate. If it is higher, the step is undone and λ grows tenfold; if not, λ
//! shrinks tenfold. With λ = 0 this is the Gauss–Newton method.
//!
//! A stage has converged when √(gᵀH⁻¹g/n) is at most the tolerance. That is the length of the step
//! in standard deviations of the estimate, rms over its n states. It has no unit, so one tolerance
//! serves all variables and chains of any length.
//!
//! Source: Dellaert & Kaess (2017), sections 2.5.2 and 2.5.3; Marquardt (1963).

use crate::graph::annealing::{Schedule, Stage, Widening};
use crate::graph::elimination::{Elimination, EliminationError};
use crate::graph::estimate::Estimate;
use crate::graph::system::{BorderLife, System};

/// Least damping after a rejected step: far below the diagonal of H, far above rounding errors.
const DAMPING_START: f64 = 1e-6;
/// Damping above which a stage gives up: steps are then below 10⁻⁶ of −g/diag H.
const DAMPING_LIMIT: f64 = 1e6;
/// Relative rise of the cost that may be rounding errors.
const COST_ROUNDING: f64 = 1e-9;

/// The rows of a least-squares problem.
pub trait Problem<const S: usize> {
    /// Adds every row, linearised at `estimate`, with the kernels at `widening`. The system is
    /// empty.
    fn linearize(&mut self, estimate: &Estimate<S>, widening: Widening, system: &mut System<S>);
}

/// gᵀH⁻¹g of a step that is one standard deviation long.
const FAR: f64 = 1.0;

/// The schedule of a solve, and when it ends.
#[derive(Clone, Debug, PartialEq)]
pub struct OptimizerOptions {
    /// Phases and their iterations.
    pub schedule: Schedule,
    /// √(gᵀH⁻¹g/n) at which a stage has converged, n the number of states (standard deviations).
    pub tolerance: f64,
    /// Damping λ at the start of each stage; zero for Gauss–Newton.
    pub damping: f64,
}

/// How a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The last step was at most the tolerance.
    Converged,
    /// The last stage used all of its iterations.
    IterationsSpent,
    /// The cost rose at every damping; the estimate is the best one found.
    Stalled,
}

/// Result of a solve, besides the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// How the last stage ended.
    pub outcome: Outcome,
    /// Number of linearisations in all stages.
    pub iterations: usize,
    /// Number of steps undone because the cost rose.
    pub rejected: usize,
    /// Cost at the last linearisation.
    pub cost: f64,
    /// gᵀH⁻¹g of the last step, see [`Elimination`].
    pub decrement: f64,
}

/// Storage of a solve, which later solves use again.
///
/// After [`optimize`] it contains the last linearisation and its undamped factor, for covariances.
#[derive(Clone, Debug)]
pub struct Workspace<const S: usize> {
    /// The normal equations last built.
    pub system: System<S>,
    /// Their factor.
    pub elimination: Elimination<S>,
    delta: Estimate<S>,
    previous: Estimate<S>,
}

impl<const S: usize> Workspace<S> {
    /// An empty workspace; the first problem allocates the storage.
    pub fn new(border_life: BorderLife) -> Self {
        Self {
            system: System::new(border_life),
            elimination: Elimination::new(),
            delta: Estimate::new(),
            previous: Estimate::new(),
        }
    }
}

/// Moves `estimate` to a local minimum of the cost.
///
/// # Errors
/// The rows do not determine all variables, or one of them is not finite.
pub fn optimize<const S: usize>(
    problem: &mut impl Problem<S>,
    estimate: &mut Estimate<S>,
    options: &OptimizerOptions,
    workspace: &mut Workspace<S>,
) -> Result<Summary, EliminationError> {
    let mut summary = Summary {
        outcome: Outcome::Converged,
        iterations: 0,
        rejected: 0,
        cost: 0.0,
        decrement: 0.0,
    };
    let (mut damping, mut widening) = (options.damping, Widening::Convex);
    for stage in options.schedule.stages() {
        damping = run_stage(problem, estimate, options, *stage, workspace, &mut summary)?;
        widening = stage.widening;
    }
    if options.damping < damping {
        // Covariances from a damped factor would be too small.
        let Workspace { system, elimination, .. } = workspace;
        system.reset(estimate.states.len(), estimate.border.len());
        problem.linearize(estimate, widening, system);
        elimination.factor(system, options.damping)?;
    }
    Ok(summary)
}

/// Iterates at one widening until it has converged or stalled or no iteration is left; returns the
/// last damping.
fn run_stage<const S: usize>(
    problem: &mut impl Problem<S>,
    estimate: &mut Estimate<S>,
    options: &OptimizerOptions,
    stage: Stage,
    workspace: &mut Workspace<S>,
    summary: &mut Summary,
) -> Result<f64, EliminationError> {
    let Workspace { system, elimination, delta, previous } = workspace;
    let (mut damping, mut before) = (options.damping, f64::INFINITY);
    summary.outcome = Outcome::IterationsSpent;
    for iteration in 0..stage.iterations + stage.further {
        if stage.iterations <= iteration && summary.decrement <= FAR {
            break;
        }
        system.reset(estimate.states.len(), estimate.border.len());
        problem.linearize(estimate, stage.widening, system);
        summary.iterations += 1;
        let (cost, bound) = (system.cost(), before + COST_ROUNDING * (1.0 + before.abs()));
        if before.is_finite() && (bound < cost || cost.is_nan()) {
            estimate.clone_from(previous);
            summary.rejected += 1;
            damping = (10.0 * damping).max(DAMPING_START);
            if DAMPING_LIMIT < damping {
                summary.outcome = Outcome::Stalled;
                return Ok(damping);
            }
            before = f64::INFINITY;
            continue;
        }
        if before.is_finite() {
            damping = if damping <= DAMPING_START { options.damping } else { damping / 10.0 };
        }
        before = cost;
        elimination.factor(system, damping)?;
        elimination.solve(delta);
        previous.clone_from(estimate);
        estimate.step(delta);
        (summary.cost, summary.decrement) = (before, elimination.decrement());
        let undamped = damping <= options.damping.max(DAMPING_START);
        let states = estimate.states.len() as f64;
        if undamped && summary.decrement <= options.tolerance * options.tolerance * states {
            summary.outcome = Outcome::Converged;
            return Ok(damping);
        }
    }
    Ok(damping)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::annealing::AnnealedKernel;
    use crate::graph::covariance::Covariances;
    use crate::graph::kernel::Kernel;
    use crate::graph::oracle::{Linear, assert_jacobian};
    use crate::graph::system::Row;
    use nalgebra::Vector2;

    fn options(schedule: Schedule) -> OptimizerOptions {
        OptimizerOptions { schedule, tolerance: 1e-6, damping: 0.0 }
    }

    /// Rosenbrock's valley as two rows: r₁ = 10·(y − x²), r₂ = 1 − x; minimum at (1, 1).
    struct Valley;

    fn valley(x: &Vector2<f64>) -> [Row<2>; 2] {
        let columns = [0, 1];
        let bend =
            Row { residual: 10.0 * (x.y - x.x * x.x), columns, jacobian: [-20.0 * x.x, 10.0] };
        [bend, Row { residual: 1.0 - x.x, columns, jacobian: [-1.0, 0.0] }]
    }

    impl Problem<2> for Valley {
        fn linearize(&mut self, estimate: &Estimate<2>, _: Widening, system: &mut System<2>) {
            for row in valley(&estimate.states[0]) {
                system.add(0, &row, &Kernel::QUADRATIC);
            }
        }
    }

    #[test]
    fn descends_a_curved_valley_by_damping() {
        let start = Vector2::new(-1.2, 1.0);
        for row in 0..2 {
            let [a, b] = valley(&start)[row].jacobian;
            assert_jacobian(|x| valley(x)[row].residual, &start, &Vector2::new(a, b), 1e-6);
        }
        let mut estimate = Estimate { states: vec![start], border: vec![] };
        let mut workspace = Workspace::new(BorderLife::WholeChain);
        let options = options(Schedule::direct(300));
        let summary = optimize(&mut Valley, &mut estimate, &options, &mut workspace).unwrap();
        assert_eq!(summary.outcome, Outcome::Converged);
        assert!(0 < summary.rejected, "the full step from here climbs the wall: {summary:?}");
        assert!((estimate.states[0] - Vector2::new(1.0, 1.0)).norm() < 1e-6);
    }

    /// r = 10·(x³ − 1). Far from the root a step takes a third of x, and gᵀH⁻¹g = r².
    struct Cube;

    impl Problem<1> for Cube {
        fn linearize(&mut self, estimate: &Estimate<1>, _: Widening, system: &mut System<1>) {
            let x = estimate.states[0].x;
            let residual = 10.0 * (x.powi(3) - 1.0);
            let row = Row { residual, columns: [0], jacobian: [30.0 * x * x] };
            system.add(0, &row, &Kernel::QUADRATIC);
        }
    }

    /// From 10, two iterations reach 10·(2/3)² = 4.45. Further ones reach the root; they are not
    /// made at 1.001, where the first step is 0.03 standard deviations long.
    #[test]
    fn a_far_start_has_further_iterations() {
        let solved = |start, schedule| {
            let mut estimate =
                Estimate { states: vec![nalgebra::Vector1::new(start)], border: vec![] };
            let mut workspace = Workspace::new(BorderLife::WholeChain);
            let options = options(schedule);
            let summary = optimize(&mut Cube, &mut estimate, &options, &mut workspace).unwrap();
            (summary.iterations, estimate.states[0].x)
        };
        let (iterations, x) = solved(10.0, Schedule::direct(2));
        assert!(iterations == 2 && (x - 4.45).abs() < 0.02, "{iterations} {x}");
        let (iterations, x) = solved(10.0, Schedule::direct(2).while_far(12));
        assert!(iterations < 12 && (x - 1.0).abs() < 1e-3, "{iterations} {x}");
        assert_eq!(solved(1.001, Schedule::direct(1).while_far(12)).0, 1);
    }

    /// The factor that a solve leaves in the workspace is undamped, also after a rejected step and
    /// after a damped last iteration.
    #[test]
    fn what_is_left_is_not_damped() {
        for iterations in 2..40 {
            let mut estimate = Estimate { states: vec![Vector2::new(-1.2, 1.0)], border: vec![] };
            let mut workspace = Workspace::new(BorderLife::WholeChain);
            let options = options(Schedule::direct(iterations));
            optimize(&mut Valley, &mut estimate, &options, &mut workspace).unwrap();
            let mut covariances = Covariances::new();
            covariances.newest(&workspace.elimination);
            // The rows' Jacobian at the last linearisation: det H = 100 for every x.
            let information = covariances.state().determinant().recip();
            assert!((information - 100.0).abs() < 1e-3, "{iterations}: {information}");
        }
    }

    #[test]
    fn one_step_solves_a_linear_problem() {
        let mut problem = Linear::<4>::random(7, 5, 3);
        let mut estimate = problem.zero();
        let mut workspace = Workspace::new(BorderLife::WholeChain);
        let options = options(Schedule::direct(5));
        let summary = optimize(&mut problem, &mut estimate, &options, &mut workspace).unwrap();
        assert_eq!((summary.iterations, summary.rejected), (2, 0));
        assert!(problem.distance(&estimate, &problem.dense().0) < 1e-9);
    }

    /// Seventeen readings of one number, five of them gross errors of the same sign.
    struct Readings(AnnealedKernel);

    impl Readings {
        fn all() -> impl Iterator<Item = f64> {
            let good = (0..12).map(|i| 3.0 + 0.1 * f64::from(i % 5 - 2));
            good.chain((0..5).map(|i| 40.0 + 3.0 * f64::from(i)))
        }
    }

    impl Problem<1> for Readings {
        fn linearize(
            &mut self,
            estimate: &Estimate<1>,
            widening: Widening,
            system: &mut System<1>,
        ) {
            for reading in Self::all() {
                let residual = estimate.states[0].x - reading;
                let row = Row { residual, columns: [0], jacobian: [1.0] };
                system.add(0, &row, &self.0.at(widening));
            }
        }
    }

    fn read(kernel: AnnealedKernel, schedule: Schedule, start: f64) -> f64 {
        let mut estimate = Estimate { states: vec![nalgebra::Vector1::new(start)], border: vec![] };
        let mut workspace = Workspace::new(BorderLife::WholeChain);
        optimize(&mut Readings(kernel), &mut estimate, &options(schedule), &mut workspace).unwrap();
        estimate.states[0].x
    }

    #[test]
    fn annealing_finds_the_majority_where_the_kernel_alone_does_not() {
        let kernel =
            AnnealedKernel { convex: Kernel::huber(1.345), target: Kernel::geman_mcclure(2.0) };
        let stuck = read(kernel, Schedule::direct(100), 60.0);
        let annealed = read(kernel, Schedule::graduated(6, 15.0, 1.4, 2, 50), 60.0);
        assert!(30.0 < stuck, "a start in the wrong cluster stays there, got {stuck}");
        // 0.05: the gross readings keep weights of (1 + 37²/4)⁻² ≈ 10⁻⁵ each.
        assert!((annealed - 3.0).abs() < 0.05, "got {annealed}");
    }

    #[test]
    fn same_input_same_bits() {
        let run = || {
            let mut problem = Linear::<8>::random(3, 30, 10);
            let mut estimate = problem.zero();
            let mut workspace = Workspace::new(BorderLife::WhileTouched);
            let options = options(Schedule::direct(5));
            optimize(&mut problem, &mut estimate, &options, &mut workspace).unwrap();
            estimate
        };
        assert_eq!(run(), run());
    }
}
