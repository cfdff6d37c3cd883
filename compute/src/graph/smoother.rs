//! Marginalised states, smoothed by the rows that came later.
//!
//! Marginalising state k gives the prior on the states and border variables that stay, and the
//! distribution of state k given these:
//!
//! x_k = x̄_k + L⁻ᵀ·(y − Gᵀ·δ_{k+1} − W·δ_β) + L⁻ᵀ·ε, ε standard normal
//!
//! δ is the difference from the linearisation point. The border variables that retired with the
//! state have a distribution of the same form. A `Departure` contains both. A `Smoother` begins at
//! the newest state of a solved window and carries mean and covariance of (one state, the border
//! variables alive there) backward through the departures, at a cost of O(S²·n + S·n²) per state
//! for n border variables. The rows of a marginalised state keep their linearisation and their
//! kernel weights.
//!
//! Source: Rauch, Tung & Striebel (1965), *Maximum likelihood estimates of linear dynamic systems*;
//! here in the square-root information form of Bierman (1977), *Factorization methods for discrete
//! sequential estimation*, chapter X.

use nalgebra::{SMatrix, SVector};

use crate::graph::block::Factor;
use crate::graph::covariance::Covariances;
use crate::graph::elimination::{Elimination, Retired};
use crate::graph::estimate::Estimate;
use crate::graph::lanes::dot;
use crate::snapshot::snapshot_fields;

/// The distribution of a marginalised state given the next state and the border variables.
#[derive(Clone, Debug)]
pub(crate) struct Departure<const S: usize> {
    factor: Factor<S>,
    coupling: SMatrix<f64, S, S>,
    forward: SVector<f64, S>,
    /// W, then the variable of each column, then the value at which each was linearised.
    columns: Vec<SVector<f64, S>>,
    variables: Vec<usize>,
    border_at: Vec<f64>,
    /// Number of the variables that were in the prior before; they come first.
    carried: usize,
    retired: Vec<Retired<S>>,
    retired_rows: Vec<f64>,
    /// Linearisation point of the state, then of the next state.
    at: SVector<f64, S>,
    next_at: SVector<f64, S>,
}

snapshot_fields!(generic [const S: usize] Factor<S> { lower, reciprocal });
snapshot_fields!(
    generic [const S: usize] Retired<S> { variable, position, reciprocal, forward, next, row }
);

impl<const S: usize> Departure<S> {
    /// Takes the departure of the first state from `elimination`, right after
    /// [`Prior::marginalize`] has used it on a system of two states.
    ///
    /// `carried` is the number of border variables in the prior before; `estimate` is the
    /// linearisation point of the system. No row on the second state may touch a border variable.
    ///
    /// [`Prior::marginalize`]: crate::graph::Prior::marginalize
    pub(crate) fn of(elimination: &Elimination<S>, estimate: &Estimate<S>, carried: usize) -> Self {
        let step = elimination.steps.last().expect("a state was marginalised");
        let mut variables = elimination.front.variables.clone();
        for retired in elimination.retired.iter().rev() {
            variables.insert(retired.position, retired.variable);
        }
        debug_assert_eq!(variables.len(), step.alive, "the next state joined no variable");
        Self {
            factor: step.factor,
            coupling: step.coupling,
            forward: step.forward,
            columns: elimination.columns[step.columns..].to_vec(),
            border_at: variables.iter().map(|&variable| estimate.border[variable]).collect(),
            variables,
            carried,
            retired: elimination.retired.clone(),
            retired_rows: elimination.retired_rows.clone(),
            at: estimate.states[0],
            next_at: estimate.states[1],
        }
    }
}

snapshot_fields!(
    generic [const S: usize] Departure<S> {
        factor,
        coupling,
        forward,
        columns,
        variables,
        border_at,
        carried,
        retired,
        retired_rows,
        at,
        next_at,
    }
    checked by is_whole
);

impl<const S: usize> Departure<S> {
    /// Whether no index is beyond the end of its list.
    fn is_whole(&self) -> bool {
        let alive = self.variables.len();
        let mut left = alive.checked_sub(self.retired.len());
        let mut fits = self.columns.len() == alive && self.border_at.len() == alive;
        for retired in self.retired.iter().rev() {
            let Some(others) = left else { return false };
            let end = retired.row.checked_add(others);
            fits &=
                retired.position <= others && end.is_some_and(|end| end <= self.retired_rows.len());
            left = Some(others + 1);
        }
        fits && self.carried <= alive
    }

    /// Number of border variables that did not retire.
    fn left(&self) -> usize {
        self.variables.len() - self.retired.len()
    }
}

/// Mean and covariance of one state and the border variables alive there, reached from the newest
/// state backward.
#[derive(Clone, Debug)]
pub(crate) struct Smoother<const S: usize> {
    state: SVector<f64, S>,
    /// In the order of [`Covariances::variables`].
    border: Vec<f64>,
    covariances: Covariances<S>,
    /// Index of the window's state reached; `None` beyond its oldest state.
    reached: Option<usize>,
    /// δ of the border variables.
    moved: Vec<f64>,
}

impl<const S: usize> Smoother<S> {
    /// Before [`Self::begin`]: no state is reached.
    pub(crate) fn new() -> Self {
        Self {
            state: SVector::zeros(),
            border: Vec::new(),
            covariances: Covariances::new(),
            reached: None,
            moved: Vec::new(),
        }
    }

    /// Begins at the newest state of a solved window.
    pub(crate) fn begin(&mut self, elimination: &Elimination<S>, estimate: &Estimate<S>) {
        self.covariances.newest(elimination);
        self.reached = estimate.states.len().checked_sub(1);
        self.read(estimate);
    }

    /// Takes the means of the state reached and of the border from the window's estimate.
    fn read(&mut self, estimate: &Estimate<S>) {
        self.state = self.reached.map_or_else(SVector::zeros, |reached| estimate.states[reached]);
        self.border.clear();
        let variables = self.covariances.variables();
        self.border.extend(variables.iter().map(|&variable| estimate.border[variable]));
    }

    /// Goes to the state before in the window; returns false at its oldest state.
    pub(crate) fn go_back(&mut self, elimination: &Elimination<S>, estimate: &Estimate<S>) -> bool {
        let Some(before) = self.reached.and_then(|reached| reached.checked_sub(1)) else {
            return false;
        };
        self.covariances.go_back(elimination, before);
        self.reached = Some(before);
        self.read(estimate);
        true
    }

    /// Goes from the window's oldest state, or from a marginalised one, to the marginalised state
    /// before it.
    ///
    /// Returns false and changes nothing if the departure is not that of the state before.
    pub(crate) fn go_back_to(&mut self, departure: &Departure<S>) -> bool {
        let left = departure.left();
        let mut stayed = departure.variables.clone();
        let mut border_at = departure.border_at.clone();
        for retired in &departure.retired {
            stayed.remove(retired.position);
            border_at.remove(retired.position);
        }
        if !self.covariances.variables().starts_with(&stayed) {
            return false;
        }
        self.reached = None;
        self.covariances.truncate(left);
        self.border.truncate(left);
        let next = self.state - departure.next_at;
        self.moved.clear();
        self.moved.extend(self.border.iter().zip(&border_at).map(|(value, at)| value - at));
        for retired in departure.retired.iter().rev() {
            let row = &departure.retired_rows[retired.row..];
            self.covariances.restore(retired, row);
            let known = retired.next.dot(&next) + dot(&row[..self.moved.len()], &self.moved);
            self.moved.insert(retired.position, retired.reciprocal * (retired.forward - known));
        }
        self.covariances.step_back(&departure.factor, &departure.coupling, &departure.columns);
        let mut right = departure.forward - departure.coupling.tr_mul(&next);
        for (column, &moved) in departure.columns.iter().zip(&self.moved) {
            right -= column * moved;
        }
        self.state = departure.at + departure.factor.solve_upper(&right);
        self.border.clear();
        let whole = self.moved.iter().zip(&departure.border_at);
        self.border.extend(whole.map(|(moved, at)| moved + at));
        true
    }

    /// Mean of the state reached.
    pub(crate) fn state(&self) -> &SVector<f64, S> {
        &self.state
    }

    /// Means of the border variables alive there, in the order of [`Covariances::variables`].
    pub(crate) fn border(&self) -> &[f64] {
        &self.border
    }

    /// Covariances of the state reached and of the border variables alive there.
    pub(crate) fn covariances(&self) -> &Covariances<S> {
        &self.covariances
    }
}

impl<const S: usize> Default for Smoother<S> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::oracle::Linear;
    use crate::graph::prior::Prior;
    use crate::graph::system::{BorderLife, System};
    use crate::snapshot::{Snapshot, SnapshotReader, SnapshotWriter};

    const LENGTH: usize = 3;

    /// The last window of a linear problem, factored, and what has left it, oldest first.
    struct Slid {
        elimination: Elimination<5>,
        window: Estimate<5>,
        departures: Vec<Departure<5>>,
    }

    fn slide(problem: &Linear<5>) -> Slid {
        let mut system = System::new(BorderLife::WholeChain);
        let (mut elimination, mut prior) = (Elimination::new(), Prior::none());
        let mut delta = Estimate::new();
        let mut window = Estimate { states: vec![], border: vec![0.0; problem.border] };
        let mut departures = Vec::new();
        for end in 1..=problem.states {
            window.states.push(SVector::repeat(end as f64));
            let begin = end.saturating_sub(LENGTH);
            if LENGTH < window.states.len() {
                let gone = begin - 1;
                system.reset(2, problem.border);
                let carried = prior.variables().count();
                prior.add_to(0, &window, &mut system);
                for row in problem.rows.iter().filter(|row| row.k == gone) {
                    problem.add(row, gone, &window, &mut system);
                }
                let over = |variable| problem.last_state_of(variable) == Some(gone);
                prior.marginalize(&system, &window, over, &mut elimination).unwrap();
                departures.push(Departure::of(&elimination, &window, carried));
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
        Slid { elimination, window, departures }
    }

    /// Every state with the border alive there has the mean and joint covariance of the whole
    /// problem solved at once. This does not depend on what has left the window, nor on its border
    /// variables.
    #[test]
    fn states_gone_are_smoothed_as_by_the_batch() {
        for (states, border) in [(12, 0), (14, 5), (9, 12)] {
            let problem = Linear::<5>::random(states as u64, states, border);
            let (dense, inverse) = problem.dense();
            let mut slid = slide(&problem);
            let mut smoother = Smoother::new();
            smoother.begin(&slid.elimination, &slid.window);
            let mut seen = vec![false; border];
            for k in (0..states).rev() {
                let at = smoother.state() - dense.fixed_rows::<5>(5 * k);
                assert!(at.norm() < 1e-9 * dense.amax(), "state {k} of {states}, {border}");
                let covariances = smoother.covariances();
                let oracle = inverse.fixed_view::<5, 5>(5 * k, 5 * k);
                assert!((covariances.state() - oracle).norm() < 1e-9 * oracle.norm());
                for (position, &variable) in covariances.variables().iter().enumerate() {
                    seen[variable] = true;
                    let own = 5 * states + variable;
                    let value = smoother.border()[position];
                    assert!((value - dense[own]).abs() < 1e-9 * dense.amax(), "{variable}");
                    let oracle = inverse.fixed_view::<5, 1>(5 * k, own);
                    assert!((covariances.cross_at(position) - oracle).norm() < 1e-9, "{variable}");
                    for (b, &other) in covariances.variables().iter().enumerate() {
                        let oracle = inverse[(own, 5 * states + other)];
                        assert!((covariances.border_at(position, b) - oracle).abs() < 1e-9);
                    }
                }
                if 0 < k && !smoother.go_back(&slid.elimination, &slid.window) {
                    let departure = slid.departures.pop().unwrap();
                    assert!(smoother.go_back_to(&departure));
                }
            }
            assert!(slid.departures.is_empty() && seen.iter().all(|seen| *seen));
        }
    }

    /// A stored and restored smoother goes back in the same way; truncated bytes are refused.
    #[test]
    fn a_stored_departure_is_the_same() {
        let problem = Linear::<5>::random(3, 9, 7);
        let slid = slide(&problem);
        let departure = slid.departures.iter().find(|d| !d.retired.is_empty()).unwrap();
        let stored = |departure: &Departure<5>| {
            let mut writer = SnapshotWriter::new(1);
            departure.save(&mut writer);
            let bytes = writer.finish();
            Departure::<5>::load(&mut SnapshotReader::open(&bytes, 1).unwrap())
        };
        let same = stored(departure).unwrap();
        assert_eq!(format!("{same:?}"), format!("{departure:?}"));
        let mut cut = departure.clone();
        cut.retired_rows.pop();
        assert!(stored(&cut).is_err());
    }
}
