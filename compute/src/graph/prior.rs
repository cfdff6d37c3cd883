//! Old states marginalised into a dense prior on what they touched.
//!
//! With e = x − x̄ on (one state, border variables alive), the prior is ½·eᵀΛe + γᵀe. Λ and γ are
//! the Schur complement of all older rows, linearised once at x̄. Those rows are not kept, so they
//! cannot be linearised again: later estimates change e but not Λ.
//!
//! Source: Dellaert & Kaess (2017), section 5.3; Sibley, Matthies & Sukhatme (2010), *Sliding
//! window filter with application to planetary landing*.

use nalgebra::{SMatrix, SVector};

use crate::graph::block::symmetric;
use crate::graph::border::Packed;
use crate::graph::elimination::{Elimination, EliminationError};
use crate::graph::estimate::Estimate;
use crate::graph::system::System;
use crate::snapshot::{snapshot_fields, state_fields};

/// The part of one border variable in the prior.
#[derive(Clone, Copy, Debug)]
struct Bordering<const S: usize> {
    variable: usize,
    linearized_at: f64,
    gradient: f64,
    /// Λ between the state and the variable.
    column: SVector<f64, S>,
}

/// Quadratic prior on the oldest state of a window and the border variables alive.
#[derive(Debug)]
pub struct Prior<const S: usize> {
    linearized_at: SVector<f64, S>,
    gradient: SVector<f64, S>,
    /// Λ of the state, both triangles.
    information: SMatrix<f64, S, S>,
    border: Vec<Bordering<S>>,
    matrix: Packed,
}

impl<const S: usize> Prior<S> {
    /// A prior without information.
    pub(crate) fn none() -> Self {
        Self::on_state(SVector::zeros(), SMatrix::zeros())
    }

    /// A prior on the state alone, with its mean and its information (inverse covariance).
    pub fn on_state(mean: SVector<f64, S>, information: SMatrix<f64, S, S>) -> Self {
        Self {
            linearized_at: mean,
            gradient: SVector::zeros(),
            information,
            border: Vec::new(),
            matrix: Packed::new(),
        }
    }

    /// Information Λ of the state given the border variables, both triangles.
    #[cfg(test)]
    pub(crate) fn information(&self) -> &SMatrix<f64, S, S> {
        &self.information
    }

    fn is_whole(&self) -> bool {
        self.matrix.size() == self.border.len()
    }

    /// Border variables in the prior.
    pub(crate) fn variables(&self) -> impl Iterator<Item = usize> + '_ {
        self.border.iter().map(|bordering| bordering.variable)
    }

    /// Adds process noise of this variance to every border variable, uncorrelated; no mean changes.
    ///
    /// With e the unit vector of one variable and q the variance, Σ + q·e·eᵀ has the information
    /// Λ − Λe·eᵀΛ·q/(1 + q·eᵀΛe) (Woodbury 1950). `scratch` is overwritten.
    pub(crate) fn loosen_border(&mut self, variance: f64, scratch: &mut Vec<f64>) {
        for i in 0..self.border.len() {
            let factor = variance / (1.0 + variance * self.matrix.get(i, i));
            let (column, pull) = (self.border[i].column, self.border[i].gradient);
            self.information -= column * column.transpose() * factor;
            self.gradient -= column * (pull * factor);
            scratch.clear();
            scratch.extend((0..self.border.len()).map(|j| self.matrix.get(i, j)));
            for (j, other) in self.border.iter_mut().enumerate() {
                let slope = scratch[j] * factor;
                other.column -= column * slope;
                other.gradient -= pull * slope;
                for (l, &across) in scratch[..=j].iter().enumerate() {
                    *self.matrix.get_mut(j, l) -= slope * across;
                }
            }
        }
    }

    /// Adds the prior, linearised at `estimate`, to a system in which its state has index `k`.
    pub fn add_to(&self, k: usize, estimate: &Estimate<S>, system: &mut System<S>) {
        let e = estimate.states[k] - self.linearized_at;
        let mut scratch = std::mem::take(&mut system.scratch);
        scratch.clear();
        scratch.extend(self.border.iter().map(|b| estimate.border[b.variable] - b.linearized_at));
        scratch.extend(self.border.iter().map(|bordering| bordering.column.dot(&e)));
        let (moved, pulls) = scratch.split_at_mut(self.border.len());
        self.matrix.multiply_add(moved, pulls);
        let mut pull = self.information * e;
        for (bordering, &moved) in self.border.iter().zip(moved.iter()) {
            pull += bordering.column * moved;
        }
        let mut cost = e.dot(&(pull * 0.5 + self.gradient));
        system.add_information(k, &self.information, &(pull + self.gradient));
        for ((bordering, &moved), &pull) in self.border.iter().zip(moved.iter()).zip(pulls.iter()) {
            let position = system.touch(k, bordering.variable);
            cost += moved * (0.5 * pull + bordering.gradient);
            let touched = &mut system.touched[k];
            touched.columns[position] += bordering.column;
            touched.gradient[position] += pull + bordering.gradient;
        }
        let System { touched, lives, .. } = system;
        touched[k].coupled |= 1 < self.border.len();
        touched[k].matrix.add(&self.matrix, |i| lives[self.border[i].variable].position());
        system.scratch = scratch;
        system.add_cost(cost);
    }

    /// Replaces the prior by the Schur complement of `system` on its last state and the border.
    ///
    /// The system has n states, of which all but the last are marginalised. Its rows must be the
    /// old prior and all rows that touch the states to be marginalised, and no others, linearised
    /// at `estimate`. Border variables for which `retired` holds are marginalised too; a later row
    /// may use their indices for new variables.
    ///
    /// With a system of one state only border variables are marginalised. Directions that no row
    /// determines are skipped.
    ///
    /// # Errors
    /// A row has a value that is not finite.
    pub fn marginalize(
        &mut self,
        system: &System<S>,
        estimate: &Estimate<S>,
        retired: impl Fn(usize) -> bool,
        elimination: &mut Elimination<S>,
    ) -> Result<(), EliminationError> {
        elimination.reduce(system, retired)?;
        let front = &elimination.front;
        self.linearized_at = estimate.states[system.states() - 1];
        self.information = symmetric(&front.block);
        self.gradient = -front.right;
        self.matrix.clone_from(&front.matrix);
        self.border.clear();
        for (position, &variable) in front.variables.iter().enumerate() {
            self.border.push(Bordering {
                variable,
                linearized_at: estimate.border[variable],
                gradient: -front.border_right[position],
                column: front.columns[position],
            });
        }
        Ok(())
    }
}

snapshot_fields!(
    generic [const S: usize] Bordering<S> { variable, linearized_at, gradient, column }
);

state_fields!(
    generic [const S: usize] Prior<S> { linearized_at, gradient, information, border, matrix }
    checked by is_whole
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::covariance::Covariances;
    use crate::graph::oracle::Linear;
    use crate::graph::system::BorderLife;

    const LENGTH: usize = 4;

    /// Slides a window of `LENGTH` states over a linear problem; returns the last window's estimate
    /// and the border variables retired on the way.
    fn slide(problem: &Linear<5>, covariances: &mut Covariances<5>) -> (Estimate<5>, Vec<usize>) {
        let mut system = System::new(BorderLife::WholeChain);
        let mut elimination = Elimination::new();
        let (mut prior, mut delta) = (Prior::none(), Estimate::new());
        let mut window = Estimate { states: vec![], border: vec![0.0; problem.border] };
        let mut gone = Vec::new();
        for end in 1..=problem.states {
            window.states.push(SVector::repeat(end as f64));
            let begin = end.saturating_sub(LENGTH);
            if LENGTH < window.states.len() {
                let forgotten = begin - 1;
                system.reset(2, problem.border);
                prior.add_to(0, &window, &mut system);
                for row in problem.rows.iter().filter(|row| row.k == forgotten) {
                    problem.add(row, forgotten, &window, &mut system);
                }
                let over = |variable| problem.last_state_of(variable) == Some(forgotten);
                prior.marginalize(&system, &window, over, &mut elimination).unwrap();
                gone.extend((0..problem.border).filter(|&variable| over(variable)));
                window.states.remove(0);
            }
            system.reset(window.states.len(), problem.border);
            prior.add_to(0, &window, &mut system);
            let inside = |k: usize, linked: bool| begin <= k && k + usize::from(linked) < end;
            for row in problem.rows.iter().filter(|row| inside(row.k, row.is_link())) {
                problem.add(row, begin, &window, &mut system);
            }
            elimination.factor(&system, 0.0).unwrap();
            elimination.solve(&mut delta);
            window.step(&delta);
        }
        covariances.newest(&elimination);
        (window, gone)
    }

    /// Compares with the dense inverse: the variance is added on the border, and the mean stays.
    #[test]
    fn a_loosened_border_is_process_noise() {
        let problem = Linear::<5>::random(7, 2, 3);
        let estimate = Estimate { states: vec![SVector::zeros(); 2], border: vec![0.0; 3] };
        let mut system = System::new(BorderLife::WholeChain);
        system.reset(2, 3);
        for row in &problem.rows {
            problem.add(row, 0, &estimate, &mut system);
        }
        let mut prior = Prior::none();
        prior.marginalize(&system, &estimate, |_| false, &mut Elimination::new()).unwrap();
        let dense = |prior: &Prior<5>| {
            let mut matrix = nalgebra::DMatrix::<f64>::zeros(8, 8);
            let mut gradient = nalgebra::DVector::<f64>::zeros(8);
            matrix.view_mut((0, 0), (5, 5)).copy_from(&prior.information);
            gradient.rows_mut(0, 5).copy_from(&prior.gradient);
            for (i, b) in prior.border.iter().enumerate() {
                matrix.view_mut((0, 5 + i), (5, 1)).copy_from(&b.column);
                matrix.view_mut((5 + i, 0), (1, 5)).copy_from(&b.column.transpose());
                gradient[5 + i] = b.gradient;
                for j in 0..3 {
                    matrix[(5 + i, 5 + j)] = prior.matrix.get(i, j);
                }
            }
            let inverse = matrix.try_inverse().unwrap();
            let mean = -&inverse * gradient;
            (inverse, mean)
        };
        let (mut expected, mean) = dense(&prior);
        prior.loosen_border(0.7, &mut Vec::new());
        let (covariance, moved) = dense(&prior);
        (5..8).for_each(|i| expected[(i, i)] += 0.7);
        assert!((covariance - &expected).amax() < 1e-9 * expected.amax());
        assert!((moved - &mean).amax() < 1e-9 * mean.amax());
    }

    #[test]
    fn a_marginalised_window_is_the_batch_on_linear_problems() {
        for border in [0, 3, 12] {
            let problem = Linear::<5>::random(23, 17, border);
            let (dense, inverse) = problem.dense();
            let mut covariances = Covariances::new();
            let (window, gone) = slide(&problem, &mut covariances);
            let first = 17 - LENGTH;
            for (k, state) in window.states.iter().enumerate() {
                let oracle = dense.fixed_rows::<5>(5 * (first + k));
                assert!((state - oracle).norm() < 1e-9 * dense.amax(), "state {k}, {border}");
            }
            for b in (0..border).filter(|b| !gone.contains(b)) {
                assert!((window.border[b] - dense[85 + b]).abs() < 1e-9 * dense.amax());
            }
            assert_eq!(gone.is_empty(), border == 0);
            let oracle = inverse.fixed_view::<5, 5>(80, 80);
            assert!((covariances.state() - oracle).norm() < 1e-9 * oracle.norm());
        }
    }

    /// Retiring one of two border variables keeps the other's joint information with the state.
    #[test]
    fn a_border_variable_is_retired_without_a_state() {
        let problem = Linear::<5>::random(4, 1, 2);
        let (_, inverse) = problem.dense();
        let mut system = System::new(BorderLife::WholeChain);
        let (mut elimination, mut prior) = (Elimination::new(), Prior::none());
        system.reset(1, 2);
        let zero = problem.zero();
        problem.rows.iter().for_each(|row| problem.add(row, 0, &zero, &mut system));
        prior.marginalize(&system, &zero, |variable| variable == 0, &mut elimination).unwrap();
        assert_eq!(prior.variables().collect::<Vec<_>>(), [1]);
        system.reset(1, 2);
        prior.add_to(0, &zero, &mut system);
        elimination.factor(&system, 0.0).unwrap();
        let mut covariances = Covariances::new();
        covariances.newest(&elimination);
        let oracle = inverse.fixed_view::<5, 5>(0, 0);
        assert!((covariances.state() - oracle).norm() < 1e-9 * oracle.norm());
        assert!((covariances.border(1, 1).unwrap() - inverse[(6, 6)]).abs() < 1e-9);
        assert_eq!(covariances.border(0, 0), None);
    }

    /// Rows touch one of two coordinates only, at the state and in its link to the next: the prior
    /// must have no information on the other.
    #[test]
    fn directions_without_information_are_left_out() {
        use crate::graph::kernel::Kernel;
        use crate::graph::system::{Link, Row};
        let mut system = System::<2>::new(BorderLife::WholeChain);
        system.reset(2, 0);
        let row = Row { residual: 1.0, columns: [0], jacobian: [2.0] };
        system.add(0, &row, &Kernel::QUADRATIC);
        let (residual, columns, next_columns) = (0.0, [0], [0]);
        let link = Link { residual, columns, jacobian: [1.0], next_columns, next_jacobian: [-1.0] };
        system.add_link(0, &link, &Kernel::QUADRATIC);
        let estimate = Estimate { states: vec![SVector::zeros(); 2], border: vec![] };
        let mut prior = Prior::none();
        prior.marginalize(&system, &estimate, |_| false, &mut Elimination::new()).unwrap();
        // 4 and 1 in series: 1/(1/4 + 1/1) = 0.8.
        let expected = SMatrix::<f64, 2, 2>::new(0.8, 0.0, 0.0, 0.0);
        assert!((prior.information() - expected).norm() < 1e-15);
    }
}
