//! Block Cholesky along the chain, oldest state first; border variables alive stay in the front.
//!
//! Eliminating state k from H·δ = −g, with β the border variables alive at k:
//!
//! L·Lᵀ = Hₖₖ, G = Hₖ₊₁,ₖ·L⁻ᵀ, W = L⁻¹·Hₖᵦ, y = −L⁻¹·gₖ; then
//! Hₖ₊₁,ₖ₊₁ −= G·Gᵀ, Hₖ₊₁,ᵦ −= G·W, Hᵦᵦ −= Wᵀ·W, and −gₖ₊₁ −= G·y, −gᵦ −= Wᵀ·y.
//!
//! A border variable joins the front at the first state that touches it. With
//! [`BorderLife::WhileTouched`] it is eliminated after the last one. So the cost per state depends
//! on the variables alive there and not on the number of all variables. The variables left after
//! the last state are solved densely.

mod columns;
mod error;
mod front;

use nalgebra::{SMatrix, SVector};

use crate::graph::block::{BadPivot, PIVOT_FLOOR, Rank};
use crate::graph::border::Packed;
use crate::graph::estimate::Estimate;
use crate::graph::lanes::dot;
use crate::graph::system::{BorderLife, System};

pub(crate) use columns::Retired;
pub use error::{EliminationError, Variable};

use columns::Step;
use front::Front;

/// The factor of a system. It gives the step δ, and [`Covariances`](crate::graph::Covariances)
/// computes covariances from it. Keeps its storage between uses.
#[derive(Clone, Debug)]
pub struct Elimination<const S: usize> {
    pub(crate) steps: Vec<Step<S>>,
    pub(crate) columns: Vec<SVector<f64, S>>,
    pub(crate) retired: Vec<Retired<S>>,
    pub(crate) retired_rows: Vec<f64>,
    pub(crate) front: Front<S>,
    /// Factor of the border variables left after the last state.
    pub(crate) last: Packed,
    last_forward: Vec<f64>,
    floor: Vec<f64>,
    /// Number of border variables alive that joined at earlier states than the front's.
    carried: usize,
    /// Steps of the border variables alive, during back substitution.
    alive: Vec<f64>,
}

impl<const S: usize> Elimination<S> {
    /// Without a factor; the first system allocates the storage.
    pub const fn new() -> Self {
        Self {
            steps: Vec::new(),
            columns: Vec::new(),
            retired: Vec::new(),
            retired_rows: Vec::new(),
            front: Front::new(),
            last: Packed::new(),
            last_forward: Vec::new(),
            floor: Vec::new(),
            carried: 0,
            alive: Vec::new(),
        }
    }

    /// Factors a system with every diagonal entry multiplied by 1 + `damping`.
    ///
    /// Border variables that no row touches are left out: their step is zero and they have no
    /// covariance.
    ///
    /// # Errors
    /// The rows do not determine all variables, or one of them is not finite.
    pub fn factor(&mut self, system: &System<S>, damping: f64) -> Result<(), EliminationError> {
        let early = system.border_life == BorderLife::WhileTouched;
        self.begin(system, system.states, damping);
        for k in 0..system.states {
            self.eliminate(system, k, Rank::Full)?;
            if k + 1 < system.states {
                self.move_to(system, k + 1, damping);
                let over = |last: Option<usize>| last.is_none_or(|last| last <= k);
                self.retire(Rank::Full, |variable| early && over(system.lives[variable].last))?;
                self.steps[k].retired_count = self.retired.len() - self.steps[k].retired;
                self.join(system, k + 1, damping);
            }
        }
        self.factor_border()
    }

    /// Eliminates all states but the last, then the border variables for which `retired` holds.
    /// The front is then the Schur complement on the rest. Pivots without information are skipped.
    pub(crate) fn reduce(
        &mut self,
        system: &System<S>,
        retired: impl Fn(usize) -> bool,
    ) -> Result<(), EliminationError> {
        self.begin(system, system.states - 1, 0.0);
        for k in 0..system.states - 1 {
            self.eliminate(system, k, Rank::Deficient)?;
            self.move_to(system, k + 1, 0.0);
            self.join(system, k + 1, 0.0);
        }
        self.retire(Rank::Deficient, retired)
    }

    fn begin(&mut self, system: &System<S>, steps: usize, damping: f64) {
        self.steps.resize_with(steps, Step::new);
        self.columns.clear();
        self.retired.clear();
        self.retired_rows.clear();
        self.carried = 0;
        if 0 < system.states {
            self.front.load(system, damping);
        }
    }

    /// Eliminates state `k`, the front's state.
    fn eliminate(
        &mut self,
        system: &System<S>,
        k: usize,
        rank: Rank,
    ) -> Result<(), EliminationError> {
        let (front, step) = (&mut self.front, &mut self.steps[k]);
        step.factor.lower = front.block;
        step.factor.factor(&(front.diagonal * PIVOT_FLOOR), rank).map_err(|bad| {
            let variable = Variable::State { index: k, coordinate: bad.index };
            EliminationError::new(variable, bad.pivot, front.diagonal[bad.index])
        })?;
        step.forward = step.factor.solve_lower(&front.right);
        if k + 1 < system.states {
            step.coupling = system.coupling[k];
            step.factor.solve_right(&mut step.coupling);
        } else {
            step.coupling = SMatrix::zeros();
        }
        step.columns = self.columns.len();
        self.columns.extend(front.columns.iter().map(|column| step.factor.solve_lower(column)));
        front.reduce_border(&self.columns[step.columns..], &step.forward);
        (step.alive, step.carried) = (front.variables.len(), self.carried);
        (step.retired, step.retired_count) = (self.retired.len(), 0);
        Ok(())
    }

    fn move_to(&mut self, system: &System<S>, k: usize, damping: f64) {
        let step = &self.steps[k - 1];
        self.front.move_to(system, k, damping, step, &self.columns[step.columns..]);
    }

    fn join(&mut self, system: &System<S>, k: usize, damping: f64) {
        self.carried = self.front.variables.len();
        self.front.join(system, k, damping);
    }

    /// Eliminates the border variables in the front for which `over` holds, last position first.
    fn retire(&mut self, rank: Rank, over: impl Fn(usize) -> bool) -> Result<(), EliminationError> {
        for position in (0..self.front.variables.len()).rev() {
            if over(self.front.variables[position]) {
                self.retire_one(rank, position)?;
            }
        }
        Ok(())
    }

    fn retire_one(&mut self, rank: Rank, position: usize) -> Result<(), EliminationError> {
        let front = &mut self.front;
        let (variable, pivot) = (front.variables[position], front.matrix.get(position, position));
        let diagonal = front.border_diagonal[position];
        let positive = PIVOT_FLOOR * diagonal < pivot && pivot.is_finite();
        if !positive && (rank == Rank::Full || pivot.is_nan()) {
            return Err(EliminationError::new(Variable::Border(variable), pivot, diagonal));
        }
        let reciprocal = if positive { 1.0 / pivot.sqrt() } else { 0.0 };
        let (next, forward) =
            (front.columns[position] * reciprocal, front.border_right[position] * reciprocal);
        let row = self.retired_rows.len();
        let others = (0..front.variables.len()).filter(|&other| other != position);
        self.retired_rows
            .extend(others.map(|other| front.matrix.get(position, other) * reciprocal));
        front.remove(position);
        front.subtract_outer(&next, &self.retired_rows[row..], forward);
        self.retired.push(Retired { variable, position, reciprocal, forward, next, row });
        Ok(())
    }

    fn factor_border(&mut self) -> Result<(), EliminationError> {
        let front = &self.front;
        self.floor.clear();
        self.floor.extend(front.border_diagonal.iter().map(|diagonal| PIVOT_FLOOR * diagonal));
        self.last.clone_from(&front.matrix);
        self.last.factor(&self.floor, Rank::Full).map_err(|BadPivot { index, pivot }| {
            let variable = Variable::Border(front.variables[index]);
            EliminationError::new(variable, pivot, front.border_diagonal[index])
        })?;
        self.last_forward.clone_from(&front.border_right);
        self.last.solve_lower(&mut self.last_forward);
        Ok(())
    }

    /// gᵀ·H⁻¹·g: the squared length of the step in standard deviations. It is twice the decrease of
    /// the cost in the linearised problem.
    pub(crate) fn decrement(&self) -> f64 {
        let states: f64 = self.steps.iter().map(|step| step.forward.norm_squared()).sum();
        let retired: f64 = self.retired.iter().map(|gone| gone.forward * gone.forward).sum();
        states + retired + dot(&self.last_forward, &self.last_forward)
    }

    /// Writes the step δ = −H⁻¹·g to `delta`.
    pub fn solve(&mut self, delta: &mut Estimate<S>) {
        delta.states.clear();
        delta.states.resize(self.steps.len(), SVector::zeros());
        delta.border.clear();
        delta.border.resize(self.front.positions.len(), 0.0);
        self.alive.clone_from(&self.last_forward);
        self.last.solve_upper(&mut self.alive);
        for (&variable, &value) in self.front.variables.iter().zip(&self.alive) {
            delta.border[variable] = value;
        }
        let mut next = SVector::zeros();
        for (k, step) in self.steps.iter().enumerate().rev() {
            let retired = &self.retired[step.retired..step.retired + step.retired_count];
            for gone in retired.iter().rev() {
                let row = &self.retired_rows[gone.row..gone.row + self.alive.len()];
                let value = gone.forward - gone.next.dot(&next) - dot(row, &self.alive);
                self.alive.insert(gone.position, value * gone.reciprocal);
                delta.border[gone.variable] = value * gone.reciprocal;
            }
            let mut right = step.forward - step.coupling.tr_mul(&next);
            let columns = &self.columns[step.columns..step.columns + step.alive];
            for (w, &value) in columns.iter().zip(&self.alive) {
                right -= w * value;
            }
            next = step.factor.solve_upper(&right);
            delta.states[k] = next;
            self.alive.truncate(step.carried);
        }
    }

    /// Number of values that fit into the storage without a new allocation.
    #[cfg(test)]
    pub(crate) fn capacity(&self) -> usize {
        let blocks = self.steps.capacity() * (2 * S * S + 2 * S);
        let columns = (self.columns.capacity() + self.front.columns.capacity()) * S;
        let retired = self.retired.capacity() * (S + 2) + self.retired_rows.capacity();
        let border = self.front.matrix.capacity() + self.last.capacity();
        let lists = self.front.border_right.capacity() + self.front.positions.capacity();
        let border = border + self.front.tiles.capacity();
        let scratch = self.floor.capacity() + self.alive.capacity() + self.last_forward.capacity();
        blocks + columns + retired + border + lists + scratch
    }
}

impl<const S: usize> Default for Elimination<S> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::annealing::Widening;
    use crate::graph::kernel::Kernel;
    use crate::graph::optimizer::Problem;
    use crate::graph::oracle::Linear;
    use crate::graph::system::Row;

    fn solve<const S: usize>(problem: &mut Linear<S>, life: BorderLife) -> Estimate<S> {
        let mut system = System::new(life);
        let mut elimination = Elimination::new();
        let mut delta = problem.zero();
        system.reset(problem.states, problem.border);
        problem.linearize(&delta, Widening::Convex, &mut system);
        elimination.factor(&system, 0.0).unwrap();
        elimination.solve(&mut delta);
        delta
    }

    #[test]
    fn window_and_batch_agree_with_a_dense_solve() {
        for (states, border) in [(1, 0), (1, 3), (2, 1), (9, 0), (12, 20), (25, 7)] {
            let mut problem = Linear::<5>::random(states as u64, states, border);
            let (dense, _) = problem.dense();
            for life in [BorderLife::WholeChain, BorderLife::WhileTouched] {
                let solved = solve(&mut problem, life);
                let distance = problem.distance(&solved, &dense);
                assert!(distance < 1e-9, "{states} states, {border}, {life:?}: {distance:e}");
            }
        }
    }

    #[test]
    fn batch_lets_border_variables_go() {
        let problem = Linear::<5>::random(1, 60, 60);
        let mut system = System::new(BorderLife::WhileTouched);
        system.reset(60, 60);
        problem.clone().linearize(&problem.zero(), Widening::Convex, &mut system);
        let mut elimination = Elimination::new();
        elimination.factor(&system, 0.0).unwrap();
        let most = elimination.steps.iter().map(|step| step.alive).max();
        assert!(most <= Some(5), "lives of three states, yet {most:?} alive at once");
    }

    #[test]
    fn names_the_state_left_free() {
        let mut system = System::<3>::new(BorderLife::WholeChain);
        system.reset(4, 0);
        for k in 0..4 {
            for column in (0..3).filter(|&column| (k, column) != (2, 1)) {
                let row = Row { residual: 1.0, columns: [column], jacobian: [2.0] };
                system.add(k, &row, &Kernel::QUADRATIC);
            }
        }
        let error = Elimination::new().factor(&system, 0.0).unwrap_err();
        let variable = Variable::State { index: 2, coordinate: 1 };
        assert_eq!(error, EliminationError::Singular { variable, pivot: 0.0, diagonal: 0.0 });
    }

    /// The rows determine only the sum of two border variables: the one eliminated last is named.
    #[test]
    fn names_the_border_variable_left_free() {
        for life in [BorderLife::WholeChain, BorderLife::WhileTouched] {
            let mut system = System::<1>::new(life);
            system.reset(2, 3);
            for k in 0..2 {
                let row = Row { residual: 1.0, columns: [0], jacobian: [1.0] };
                system.add(k, &row, &Kernel::QUADRATIC);
            }
            let row = Row { residual: 1.0, columns: [0], jacobian: [1.0] };
            system.add_with_border(0, &row, &[(0, 0.7), (2, 0.7)], &Kernel::QUADRATIC);
            let error = Elimination::new().factor(&system, 0.0).unwrap_err();
            let named = match error {
                EliminationError::Singular { variable: Variable::Border(named), .. } => named,
                other => panic!("{other}"),
            };
            assert!(named == 0 || named == 2, "variable 1 is not touched at all");
        }
    }

    #[test]
    fn a_row_that_is_not_a_number_is_refused() {
        let mut system = System::<1>::new(BorderLife::WholeChain);
        system.reset(1, 0);
        let row = Row { residual: 1.0, columns: [0], jacobian: [f64::NAN] };
        system.add(0, &row, &Kernel::QUADRATIC);
        let error = Elimination::new().factor(&system, 0.0).unwrap_err();
        assert!(matches!(error, EliminationError::NotFinite { .. }), "{error}");
    }

    #[test]
    fn an_untouched_border_variable_does_not_move() {
        let mut problem = Linear::<4>::random(5, 6, 2);
        problem.border = 4;
        let solved = solve(&mut problem, BorderLife::WholeChain);
        assert_eq!(solved.border[2..], [0.0, 0.0]);
        assert!(solved.border[..2].iter().all(|&value| value != 0.0));
    }

    /// After the first solve, others of the same shape allocate nothing: no capacity changes.
    #[test]
    fn a_warm_solve_allocates_nothing() {
        for life in [BorderLife::WholeChain, BorderLife::WhileTouched] {
            let mut problem = Linear::<5>::random(9, 20, 12);
            let mut system = System::new(life);
            let mut elimination = Elimination::new();
            let mut delta = problem.zero();
            let mut capacities = Vec::new();
            for _ in 0..4 {
                system.reset(20, 12);
                problem.linearize(&problem.zero(), Widening::Convex, &mut system);
                elimination.factor(&system, 0.0).unwrap();
                elimination.solve(&mut delta);
                capacities.push((system.capacity(), elimination.capacity()));
            }
            assert!(0 < capacities[0].0 && 0 < capacities[0].1);
            assert!(capacities.iter().all(|&warm| warm == capacities[0]), "{capacities:?}");
        }
    }

    #[test]
    fn damping_shortens_the_step() {
        let mut problem = Linear::<4>::random(5, 6, 2);
        let mut system = System::new(BorderLife::WholeChain);
        system.reset(6, 2);
        let mut delta = problem.zero();
        problem.linearize(&delta, Widening::Convex, &mut system);
        let mut elimination = Elimination::new();
        let lengths = [0.0, 0.1, 10.0].map(|damping| {
            elimination.factor(&system, damping).unwrap();
            elimination.solve(&mut delta);
            delta.states.iter().map(|state| state.norm_squared()).sum::<f64>()
        });
        assert!(lengths[1] < lengths[0] && lengths[2] < lengths[1], "{lengths:?}");
    }
}
