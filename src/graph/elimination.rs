//! Block Cholesky along the chain, oldest state first, the border carried along in a front.
//!
//! Eliminating state k from H·δ = −g, with R the next state and the border variables then alive:
//!
//! L·Lᵀ = Hₖₖ, G = Hₖ₊₁,ₖ·L⁻ᵀ, W = L⁻¹·Hₖᵦ, y = −L⁻¹·gₖ; then
//! Hₖ₊₁,ₖ₊₁ −= G·Gᵀ, Hₖ₊₁,ᵦ −= G·W, Hᵦᵦ −= Wᵀ·W, and the right side alike.
//!
//! A border variable joins the front at the first state that touches it. With
//! [`BorderLife::WhileTouched`] it is eliminated after the last one, so the cost per state depends
//! on the variables alive there, never on all there are; what is left after the last state is
//! solved densely.
//!
//! Measured against a general sparse Cholesky (faer 0.24, symbolic part reused), which gives no
//! covariances: 30 states of 8, 12 µs here and 53 there; 1000 states with 24 border variables alive
//! at a time, 6 ms and 25; only 80 alive in 30 states turned it round, 420 µs and 240. Four rows of
//! the border at once (`lanes`) have since made that 0.72 of what it was
//! (`cargo bench --bench graph`).

use nalgebra::{SMatrix, SVector};

use crate::graph::block::{BadPivot, Factor, PIVOT_FLOOR, Rank, subtract_product, subtract_square};
use crate::graph::border::Packed;
use crate::graph::estimate::Estimate;
use crate::graph::lanes::{Tiles, dot};
use crate::graph::system::{BorderLife, System};

/// A scalar unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variable {
    /// A coordinate of a state.
    State {
        /// The state's place in the chain.
        index: usize,
        /// The coordinate.
        coordinate: usize,
    },
    /// A border variable.
    Border(usize),
}

/// Why a system has no unique solution.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EliminationError {
    /// Rows leave a direction free; the variable is the first in elimination order to show it.
    #[error("{variable:?} is undetermined: pivot {pivot:e} of a diagonal of {diagonal:e}")]
    Singular {
        /// The variable at whose pivot it showed.
        variable: Variable,
        /// What elimination left of its diagonal.
        pivot: f64,
        /// Its diagonal before.
        diagonal: f64,
    },
    /// A row brought a value that is not finite.
    #[error("{variable:?} has pivot {pivot}: a row is not finite")]
    NotFinite {
        /// The variable at whose pivot it showed.
        variable: Variable,
        /// The pivot.
        pivot: f64,
    },
}

impl EliminationError {
    fn new(variable: Variable, pivot: f64, diagonal: f64) -> Self {
        if pivot.is_finite() {
            Self::Singular { variable, pivot, diagonal }
        } else {
            Self::NotFinite { variable, pivot }
        }
    }
}

/// What eliminating one state left behind.
#[derive(Clone, Debug)]
pub(crate) struct Step<const S: usize> {
    pub(crate) factor: Factor<S>,
    /// G, S×S: how the next state depends on this one.
    pub(crate) coupling: SMatrix<f64, S, S>,
    /// y, the forward solution.
    pub(crate) forward: SVector<f64, S>,
    /// Where W's columns begin in `Elimination::columns`.
    pub(crate) columns: usize,
    /// Border variables alive while it was eliminated: as many columns.
    pub(crate) alive: usize,
    /// The first of these came from the step before.
    pub(crate) carried: usize,
    /// Where the variables retired after it begin in `Elimination::retired`, and how many they are.
    pub(crate) retired: usize,
    pub(crate) retired_count: usize,
}

impl<const S: usize> Step<S> {
    fn new() -> Self {
        Self {
            factor: Factor { lower: SMatrix::zeros(), reciprocal: SVector::zeros() },
            coupling: SMatrix::zeros(),
            forward: SVector::zeros(),
            columns: 0,
            alive: 0,
            carried: 0,
            retired: 0,
            retired_count: 0,
        }
    }
}

/// A border variable eliminated before the end of the chain.
#[derive(Clone, Debug)]
pub(crate) struct Retired<const S: usize> {
    pub(crate) variable: usize,
    /// Its place among the variables alive.
    pub(crate) place: usize,
    /// 1/√pivot, zero where the pivot was skipped.
    pub(crate) reciprocal: f64,
    pub(crate) forward: f64,
    /// Column of the factor: on the next state, and from `row` on the others alive.
    pub(crate) next: SVector<f64, S>,
    pub(crate) row: usize,
}

/// What is not yet eliminated but already changed: the next state and the border alive.
#[derive(Clone, Debug)]
pub(crate) struct Front<const S: usize> {
    pub(crate) block: SMatrix<f64, S, S>,
    pub(crate) right: SVector<f64, S>,
    /// Diagonal of the block before elimination touched it.
    pub(crate) diagonal: SVector<f64, S>,
    pub(crate) variables: Vec<usize>,
    pub(crate) columns: Vec<SVector<f64, S>>,
    pub(crate) matrix: Packed,
    pub(crate) border_right: Vec<f64>,
    pub(crate) border_diagonal: Vec<f64>,
    /// Place of each border variable, if alive.
    pub(crate) places: Vec<Option<usize>>,
    tiles: Tiles<S>,
}

impl<const S: usize> Front<S> {
    const fn new() -> Self {
        Self {
            block: SMatrix::from_array_storage(nalgebra::ArrayStorage([[0.0; S]; S])),
            right: SVector::from_array_storage(nalgebra::ArrayStorage([[0.0; S]; 1])),
            diagonal: SVector::from_array_storage(nalgebra::ArrayStorage([[0.0; S]; 1])),
            variables: Vec::new(),
            columns: Vec::new(),
            matrix: Packed::new(),
            border_right: Vec::new(),
            border_diagonal: Vec::new(),
            places: Vec::new(),
            tiles: Tiles::new(),
        }
    }

    fn clear(&mut self, border: usize) {
        self.variables.clear();
        self.columns.clear();
        self.matrix.clear();
        self.border_right.clear();
        self.border_diagonal.clear();
        self.places.clear();
        self.places.resize(border, None);
    }

    /// Takes in the first state of the system.
    fn load(&mut self, system: &System<S>, damping: f64) {
        self.clear(system.lives.len());
        self.set_block(system, 0, damping);
        self.join(system, 0, damping);
    }

    /// Block and right side of state `k` as the rows made them.
    fn set_block(&mut self, system: &System<S>, k: usize, damping: f64) {
        self.block = system.diagonal[k];
        self.right = -system.gradient[k];
        for j in 0..S {
            self.block[(j, j)] *= 1.0 + damping;
            self.diagonal[j] = self.block[(j, j)];
        }
    }

    /// Moves on to state `k`, less what eliminating the state before took from it.
    fn move_to(
        &mut self,
        system: &System<S>,
        k: usize,
        damping: f64,
        step: &Step<S>,
        columns: &[SVector<f64, S>],
    ) {
        self.set_block(system, k, damping);
        subtract_square(&mut self.block, &step.coupling);
        subtract_product(&mut self.right, &step.coupling, &step.forward);
        for (column, w) in self.columns.iter_mut().zip(columns) {
            *column = SVector::zeros();
            subtract_product(column, &step.coupling, w);
        }
    }

    /// Takes the eliminated state's part from the border: Hᵦᵦ −= Wᵀ·W.
    fn reduce_border(&mut self, columns: &[SVector<f64, S>], forward: &SVector<f64, S>) {
        for (right, w) in self.border_right.iter_mut().zip(columns) {
            *right -= dot(w.as_slice(), forward.as_slice());
        }
        self.tiles.load(columns);
        self.matrix.subtract_gram(&self.tiles);
    }

    /// Adds the border part of state `k`; variables met for the first time join.
    fn join(&mut self, system: &System<S>, k: usize, damping: f64) {
        let touched = &system.touched[k];
        for (index, &variable) in touched.variables.iter().enumerate() {
            let place = self.place(variable);
            self.columns[place] += touched.columns[index];
            self.border_right[place] -= touched.gradient[index];
            let own = touched.matrix.get(index, index);
            self.border_diagonal[place] += own + damping * own;
            *self.matrix.get_mut(place, place) += damping * own;
        }
        let place = |index: usize| self.places[touched.variables[index]].expect("placed above");
        match touched.coupled {
            true => self.matrix.add(&touched.matrix, place),
            false => self.matrix.add_diagonal(&touched.matrix, place),
        }
    }

    #[inline]
    fn place(&mut self, variable: usize) -> usize {
        if let Some(place) = self.places[variable] {
            return place;
        }
        let place = self.variables.len();
        self.places[variable] = Some(place);
        self.variables.push(variable);
        self.columns.push(SVector::zeros());
        self.matrix.push();
        self.border_right.push(0.0);
        self.border_diagonal.push(0.0);
        place
    }

    /// Takes a retired variable's part: `next` on the state, `row` on the border left.
    fn subtract_outer(&mut self, next: &SVector<f64, S>, row: &[f64], forward: f64) {
        for c in 0..S {
            for r in c..S {
                self.block[(r, c)] -= next[r] * next[c];
            }
        }
        self.right -= next * forward;
        for (i, &factor) in row.iter().enumerate() {
            self.columns[i] -= next * factor;
            self.border_right[i] -= factor * forward;
        }
        self.matrix.subtract_square(row);
    }

    fn remove(&mut self, place: usize) {
        self.places[self.variables[place]] = None;
        for &variable in &self.variables[place + 1..] {
            self.places[variable] = self.places[variable].map(|old| old - 1);
        }
        self.variables.remove(place);
        self.columns.remove(place);
        self.matrix.remove(place);
        self.border_right.remove(place);
        self.border_diagonal.remove(place);
    }
}

/// A factored system: gives the step δ, and through [`Covariances`](crate::graph::Covariances) the
/// uncertainty. Keeps its storage from one use to the next.
#[derive(Clone, Debug)]
pub struct Elimination<const S: usize> {
    pub(crate) steps: Vec<Step<S>>,
    pub(crate) columns: Vec<SVector<f64, S>>,
    pub(crate) retired: Vec<Retired<S>>,
    pub(crate) retired_rows: Vec<f64>,
    pub(crate) front: Front<S>,
    /// Factor of what is left of the border after the last state.
    pub(crate) last: Packed,
    last_forward: Vec<f64>,
    floor: Vec<f64>,
    /// Border variables in the front before the state it holds brought its own.
    carried: usize,
    /// Values of the border variables alive, during back substitution.
    alive: Vec<f64>,
}

impl<const S: usize> Elimination<S> {
    /// Nothing factored.
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

    /// Factors a system, each diagonal entry first multiplied by 1 + `damping`.
    ///
    /// Border variables no row touched are left out: their step is zero and they have no variance.
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

    /// Eliminates all states but the last, and then the border variables named by `retired`: the
    /// front is what they say about the rest. Directions without information are skipped.
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

    /// Eliminates state `k`, whose block the front holds.
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

    /// Eliminates the border variables that `over` names from the front, last place first.
    fn retire(&mut self, rank: Rank, over: impl Fn(usize) -> bool) -> Result<(), EliminationError> {
        for place in (0..self.front.variables.len()).rev() {
            if over(self.front.variables[place]) {
                self.retire_one(rank, place)?;
            }
        }
        Ok(())
    }

    fn retire_one(&mut self, rank: Rank, place: usize) -> Result<(), EliminationError> {
        let front = &mut self.front;
        let (variable, pivot) = (front.variables[place], front.matrix.get(place, place));
        let diagonal = front.border_diagonal[place];
        let positive = PIVOT_FLOOR * diagonal < pivot && pivot.is_finite();
        if !positive && (rank == Rank::Full || pivot.is_nan()) {
            return Err(EliminationError::new(Variable::Border(variable), pivot, diagonal));
        }
        let reciprocal = if positive { 1.0 / pivot.sqrt() } else { 0.0 };
        let (next, forward) =
            (front.columns[place] * reciprocal, front.border_right[place] * reciprocal);
        let row = self.retired_rows.len();
        let others = (0..front.variables.len()).filter(|&other| other != place);
        self.retired_rows.extend(others.map(|other| front.matrix.get(place, other) * reciprocal));
        front.remove(place);
        front.subtract_outer(&next, &self.retired_rows[row..], forward);
        self.retired.push(Retired { variable, place, reciprocal, forward, next, row });
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

    /// gᵀ·H⁻¹·g: the squared length of the step in standard deviations, and twice the decrease of
    /// the cost it promises.
    pub fn decrement(&self) -> f64 {
        let states: f64 = self.steps.iter().map(|step| step.forward.norm_squared()).sum();
        let retired: f64 = self.retired.iter().map(|gone| gone.forward * gone.forward).sum();
        states + retired + dot(&self.last_forward, &self.last_forward)
    }

    /// The step δ = −H⁻¹·g, into `delta`.
    pub fn solve(&mut self, delta: &mut Estimate<S>) {
        delta.states.clear();
        delta.states.resize(self.steps.len(), SVector::zeros());
        delta.border.clear();
        delta.border.resize(self.front.places.len(), 0.0);
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
                self.alive.insert(gone.place, value * gone.reciprocal);
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

    /// Numbers all storage can hold without growing: constant once warm.
    pub fn capacity(&self) -> usize {
        let blocks = self.steps.capacity() * (2 * S * S + 2 * S);
        let columns = (self.columns.capacity() + self.front.columns.capacity()) * S;
        let retired = self.retired.capacity() * (S + 2) + self.retired_rows.capacity();
        let border = self.front.matrix.capacity() + self.last.capacity();
        let lists = self.front.border_right.capacity() + self.front.places.capacity();
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
    use crate::graph::annealing::Phase;
    use crate::graph::kernel::Kernel;
    use crate::graph::optimizer::Problem;
    use crate::graph::oracle::Linear;
    use crate::graph::system::Row;

    fn solve<const S: usize>(problem: &mut Linear<S>, life: BorderLife) -> Estimate<S> {
        let mut system = System::new(life);
        let mut elimination = Elimination::new();
        let mut delta = problem.zero();
        system.reset(problem.states, problem.border);
        problem.linearize(&delta, Phase::Convex, &mut system);
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
        problem.clone().linearize(&problem.zero(), Phase::Convex, &mut system);
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

    /// Two border variables seen only as their sum: the second to be eliminated is free.
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

    /// Once warm, the same shape allocates nothing: no capacity moves, in either life.
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
                problem.linearize(&problem.zero(), Phase::Convex, &mut system);
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
        problem.linearize(&delta, Phase::Convex, &mut system);
        let mut elimination = Elimination::new();
        let lengths = [0.0, 0.1, 10.0].map(|damping| {
            elimination.factor(&system, damping).unwrap();
            elimination.solve(&mut delta);
            delta.states.iter().map(|state| state.norm_squared()).sum::<f64>()
        });
        assert!(lengths[1] < lengths[0] && lengths[2] < lengths[1], "{lengths:?}");
    }
}
