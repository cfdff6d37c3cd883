//! Marginal covariances from the factor of a system, without the inverse of all of it.
//!
//! Only those entries of Σ = H⁻¹ are computed at which the Cholesky factor is not zero. With R the
//! next state and the border variables alive, and U = [G; Wᵀ]·L⁻¹ of state k, from the end backward
//!
//! Σ_kR = −Uᵀ·Σ_RR, Σ_kk = (L·Lᵀ)⁻¹ − Σ_kR·U.
//!
//! The first step gives the newest state and the border, all steps give every state, at a cost
//! linear in their number. The covariances are those of the last linearisation: they contain the
//! kernels' weights, and no correlation between rows that the caller does not model. They are
//! computed from the newest state backward; the *state reached* is the one to which they refer at
//! the moment.
//!
//! Source: Takahashi, Fagan & Chin (1973), *Formation of a sparse bus impedance matrix*; Golub &
//! Plemmons (1980), *Large-scale geodetic least-squares adjustment by dissection*, section 5.

use nalgebra::{SMatrix, SVector};

use crate::graph::block::{Factor, subtract_product, symmetric};
use crate::graph::border::Packed;
use crate::graph::elimination::{Elimination, Retired};
use crate::graph::lanes::{Lanes, dot};

/// Variance given to a border variable whose pivot was skipped because no row determines it.
const UNKNOWN: f64 = 1e6;

/// Covariances of one state of a factored system and of the border. Keeps its storage between uses.
#[derive(Clone, Debug)]
pub struct Covariances<const S: usize> {
    /// Covariance of the state reached, both triangles.
    state: SMatrix<f64, S, S>,
    /// Covariance between that state and each border variable alive.
    cross: Vec<SVector<f64, S>>,
    border: Packed,
    /// Border variables alive, in the order of `cross` and `border`.
    variables: Vec<usize>,
    gone: Vec<SVector<f64, S>>,
    scratch: Vec<f64>,
    rows: Vec<Lanes>,
}

impl<const S: usize> Covariances<S> {
    /// Without a result; the first system allocates the storage.
    pub fn new() -> Self {
        Self {
            state: SMatrix::zeros(),
            cross: Vec::new(),
            border: Packed::new(),
            variables: Vec::new(),
            gone: Vec::new(),
            scratch: Vec::new(),
            rows: Vec::new(),
        }
    }

    /// Computes the covariances of the newest state and of the border variables alive there.
    pub fn newest(&mut self, elimination: &Elimination<S>) {
        self.variables.clone_from(&elimination.front.variables);
        elimination.last.invert_into(&mut self.border, &mut self.rows);
        self.state = SMatrix::zeros();
        self.cross.clear();
        self.cross.resize(self.variables.len(), SVector::zeros());
        if let Some(step) = elimination.steps.last() {
            let columns = &elimination.columns[step.columns..step.columns + step.alive];
            self.step_back(&step.factor, &step.coupling, columns);
        }
    }

    /// Writes the covariance of every state, both triangles, to `states`; the state reached is then
    /// the oldest.
    pub fn all_states(
        &mut self,
        elimination: &Elimination<S>,
        states: &mut Vec<SMatrix<f64, S, S>>,
    ) {
        states.clear();
        states.resize(elimination.steps.len(), SMatrix::zeros());
        self.newest(elimination);
        for k in (0..states.len()).rev() {
            states[k] = self.state;
            if 0 < k {
                self.go_back(elimination, k - 1);
            }
        }
    }

    /// Goes from state k + 1, the one reached, to state `k`.
    pub(crate) fn go_back(&mut self, elimination: &Elimination<S>, k: usize) {
        let step = &elimination.steps[k];
        self.truncate(elimination.steps[k + 1].carried);
        let end = step.retired + step.retired_count;
        for retired in elimination.retired[step.retired..end].iter().rev() {
            self.restore(retired, &elimination.retired_rows[retired.row..]);
        }
        let columns = &elimination.columns[step.columns..step.columns + step.alive];
        self.step_back(&step.factor, &step.coupling, columns);
    }

    /// Covariance of the state reached. After [`Covariances::newest`] that is the newest state.
    pub fn state(&self) -> &SMatrix<f64, S, S> {
        &self.state
    }

    /// Border variables alive at the state reached, in the order in which they joined.
    pub fn variables(&self) -> &[usize] {
        &self.variables
    }

    /// Covariance of the border variables at two positions of [`Covariances::variables`].
    pub(crate) fn border_at(&self, a: usize, b: usize) -> f64 {
        self.border.get(a, b)
    }

    /// Covariance between the state reached and the border variable at a position of
    /// [`Covariances::variables`].
    pub(crate) fn cross_at(&self, position: usize) -> &SVector<f64, S> {
        &self.cross[position]
    }

    /// Covariance of two border variables; `None` unless both are alive at the state reached.
    pub fn border(&self, a: usize, b: usize) -> Option<f64> {
        Some(self.border.get(self.position(a)?, self.position(b)?))
    }

    /// Covariance between the state reached and a border variable; `None` unless it is alive there.
    #[cfg(test)]
    pub(crate) fn cross(&self, variable: usize) -> Option<&SVector<f64, S>> {
        self.position(variable).map(|position| &self.cross[position])
    }

    fn position(&self, variable: usize) -> Option<usize> {
        self.variables.iter().position(|&known| known == variable)
    }

    /// Keeps the first `alive` border variables.
    pub(crate) fn truncate(&mut self, alive: usize) {
        self.variables.truncate(alive);
        self.cross.truncate(alive);
        self.border.truncate(alive);
    }

    /// Replaces Σ of (state k + 1, border variables alive) by Σ of (state k, the same variables).
    pub(crate) fn step_back(
        &mut self,
        factor: &Factor<S>,
        coupling: &SMatrix<f64, S, S>,
        columns: &[SVector<f64, S>],
    ) {
        // Uᵀ = L⁻ᵀ·[Gᵀ, W], one column for each variable of R.
        let coupling = coupling.transpose();
        let u_state = SMatrix::<f64, S, S>::from_columns(&std::array::from_fn::<_, S, _>(|c| {
            factor.solve_upper(&coupling.column(c).into_owned())
        }));
        self.gone.clear();
        self.gone.extend(columns.iter().map(|w| factor.solve_upper(w)));
        // Covariance of states k and k + 1, S×S.
        let mut to_next = -(u_state * self.state);
        for (u, cross) in self.gone.iter().zip(&self.cross) {
            to_next -= u * cross.transpose();
        }
        for cross in &mut self.cross {
            let mut own = SVector::zeros();
            subtract_product(&mut own, &u_state, cross);
            *cross = own;
        }
        self.border.subtract_product(&self.gone, &mut self.cross);
        let mut covariance = factor.inverse() - to_next * u_state.transpose();
        for (u, cross) in self.gone.iter().zip(&self.cross) {
            covariance -= cross * u.transpose();
        }
        self.state = symmetric(&covariance);
    }

    /// Adds to Σ a border variable that retired here. The first numbers of `row` are its column of
    /// the factor in the rows of the variables alive.
    pub(crate) fn restore(&mut self, retired: &Retired<S>, row: &[f64]) {
        let alive = self.variables.len();
        let row = &row[..alive];
        self.scratch.clear();
        for i in 0..alive {
            let mut sum = self.cross[i].dot(&retired.next);
            for (j, factor) in row.iter().enumerate() {
                sum += factor * self.border.get(i, j);
            }
            self.scratch.push(-retired.reciprocal * sum);
        }
        let mut cross = self.state * retired.next;
        for (factor, other) in row.iter().zip(&self.cross) {
            cross += other * *factor;
        }
        cross *= -retired.reciprocal;
        let explained = cross.dot(&retired.next) + dot(&self.scratch, row);
        let variance = match 0.0 < retired.reciprocal {
            true => retired.reciprocal * (retired.reciprocal - explained),
            false => UNKNOWN,
        };
        self.scratch.insert(retired.position, variance);
        self.border.insert(retired.position);
        self.variables.insert(retired.position, retired.variable);
        self.cross.insert(retired.position, cross);
        for (other, &value) in self.scratch.iter().enumerate() {
            *self.border.get_mut(retired.position, other) = value;
        }
    }
}

impl<const S: usize> Default for Covariances<S> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::annealing::Widening;
    use crate::graph::optimizer::Problem;
    use crate::graph::oracle::Linear;
    use crate::graph::system::{BorderLife, System};
    use nalgebra::DMatrix;

    fn factored(
        states: usize,
        border: usize,
        life: BorderLife,
    ) -> (Linear<5>, Elimination<5>, DMatrix<f64>) {
        let mut problem = Linear::random(11, states, border);
        let mut system = System::new(life);
        system.reset(states, border);
        problem.linearize(&problem.zero(), Widening::Convex, &mut system);
        let mut elimination = Elimination::new();
        elimination.factor(&system, 0.0).unwrap();
        let (_, dense) = problem.dense();
        (problem, elimination, dense)
    }

    #[test]
    fn every_state_agrees_with_the_dense_inverse() {
        for life in [BorderLife::WholeChain, BorderLife::WhileTouched] {
            for (states, border) in [(1, 0), (8, 0), (9, 4), (15, 30)] {
                let (_, elimination, dense) = factored(states, border, life);
                let (mut covariances, mut all) = (Covariances::new(), Vec::new());
                covariances.all_states(&elimination, &mut all);
                for (k, covariance) in all.iter().enumerate() {
                    let oracle = dense.fixed_view::<5, 5>(5 * k, 5 * k);
                    let error = (covariance - oracle).norm() / oracle.norm();
                    assert!(error < 1e-9, "state {k} of {states}, {border}, {life:?}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn newest_state_and_border_agree_with_the_dense_inverse() {
        let (problem, elimination, dense) = factored(10, 6, BorderLife::WholeChain);
        let mut covariances = Covariances::new();
        covariances.newest(&elimination);
        let start = 5 * problem.states;
        let oracle = dense.fixed_view::<5, 5>(start - 5, start - 5);
        assert!((covariances.state() - oracle).norm() < 1e-9 * oracle.norm());
        for a in 0..6 {
            let oracle = dense.fixed_view::<5, 1>(start - 5, start + a);
            assert!((covariances.cross(a).unwrap() - oracle).norm() < 1e-9);
            for b in 0..6 {
                let difference = covariances.border(a, b).unwrap() - dense[(start + a, start + b)];
                assert!(difference.abs() < 1e-9);
            }
        }
        assert_eq!(covariances.border(0, 6), None);
    }
}
