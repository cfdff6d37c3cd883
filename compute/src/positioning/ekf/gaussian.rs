//! The filter's state as a normal distribution: prediction and update.

use nalgebra::{SMatrix, SVector};

use crate::gnss::Constellation;
use crate::graph::{Link, Row};
use crate::positioning::factors::{CLOCK, ClockWalk, DRIFT, MotionWalk, STATE, State, VELOCITY};
use crate::snapshot::snapshot_fields;

/// First inter-system bias, by index of the constellation.
pub(super) const BIAS: usize = STATE;
/// Position and clock of the epoch before.
const PAST: usize = BIAS + Constellation::COUNT;
/// Numbers in the filter's state.
const SIZE: usize = PAST + 4;

type Matrix = SMatrix<f64, SIZE, SIZE>;
type Vector = SVector<f64, SIZE>;

/// A whitened row on the filter's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Innovation {
    /// J.
    slope: Vector,
    /// r = (model − measured)/σ.
    residual: f64,
    /// R: one, or more where errors are correlated in time.
    variance: f64,
}

impl Innovation {
    /// A row on the epoch's state and on a bias, given by index and Jacobian.
    pub(super) fn row<const N: usize>(row: &Row<N>, bias: Option<(usize, f64)>) -> Self {
        let mut slope = Vector::zeros();
        row.columns.iter().zip(row.jacobian).for_each(|(column, value)| slope[*column] = value);
        if let Some((index, value)) = bias {
            slope[BIAS + index] = value;
        }
        Self { slope, residual: row.residual, variance: 1.0 }
    }

    /// A row between the position and clock of the previous epoch and this epoch's state.
    pub(super) fn link<const N: usize, const M: usize>(link: &Link<N, M>) -> Self {
        let mut slope = Vector::zeros();
        let next = link.next_columns.iter().zip(link.next_jacobian);
        next.for_each(|(column, value)| slope[*column] = value);
        for (column, value) in link.columns.iter().zip(link.jacobian) {
            slope[past_column(*column)] = value;
        }
        Self { slope, residual: link.residual, variance: 1.0 }
    }

    /// The same row with R divided by the independent share of its information.
    pub(super) fn scaled(self, independent_share: f64) -> Self {
        Self { variance: independent_share.recip(), ..self }
    }
}

fn past_column(column: usize) -> usize {
    debug_assert!(column < 3 || column == CLOCK, "only position and clock are remembered");
    PAST + column.min(3)
}

/// Mean and covariance of the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gaussian {
    mean: Vector,
    covariance: Matrix,
}

snapshot_fields!(Gaussian { mean, covariance });

impl Gaussian {
    /// Zeros with zero covariance.
    pub(super) fn zero() -> Self {
        Self { mean: Vector::zeros(), covariance: Matrix::zeros() }
    }

    /// The epoch's state.
    pub(super) fn state(&self) -> State {
        self.mean.fixed_rows::<STATE>(0).into_owned()
    }

    /// Its covariance.
    pub(super) fn state_covariance(&self) -> SMatrix<f64, STATE, STATE> {
        self.covariance.fixed_view::<STATE, STATE>(0, 0).into_owned()
    }

    /// Inter-system biases, by index of the constellation (m).
    pub(super) fn biases_m(&self) -> &[f64] {
        &self.mean.as_slice()[BIAS..PAST]
    }

    /// The state of the epoch before, its velocity and drift zero.
    pub(super) fn past(&self) -> State {
        let mut past = State::zeros();
        past.fixed_rows_mut::<3>(0).copy_from(&self.mean.fixed_rows::<3>(PAST));
        past[CLOCK] = self.mean[PAST + 3];
        past
    }

    /// Multiplies the covariance.
    pub(super) fn scale(&mut self, factor: f64) {
        self.covariance *= factor;
    }

    /// Sets the mean and variance of one variable, uncorrelated with the others.
    pub(super) fn renew(&mut self, column: usize, mean: f64, sigma: f64) {
        self.mean[column] = mean;
        self.covariance.row_mut(column).fill(0.0);
        self.covariance.column_mut(column).fill(0.0);
        self.covariance[(column, column)] = sigma * sigma;
    }

    /// Shifts the mean of one variable by a known amount.
    pub(super) fn shift(&mut self, column: usize, by: f64) {
        self.mean[column] += by;
    }

    /// Adds to the variance of one variable.
    pub(super) fn loosen(&mut self, column: usize, variance: f64) {
        self.covariance[(column, column)] += variance;
    }

    /// Predicts over an interval (s) and keeps the previous position and clock; without walks no
    /// noise is added.
    pub(super) fn predict(&mut self, walks: Option<(&MotionWalk, &ClockWalk)>, interval_s: f64) {
        let mut step = Matrix::identity();
        for axis in 0..3 {
            step[(axis, VELOCITY + axis)] = interval_s;
        }
        step[(CLOCK, DRIFT)] = interval_s;
        for (index, column) in [0, 1, 2, CLOCK].into_iter().enumerate() {
            step[(PAST + index, PAST + index)] = 0.0;
            step[(PAST + index, column)] = 1.0;
        }
        self.mean = step * self.mean;
        self.covariance = step * self.covariance * step.transpose();
        let Some((motion, clock)) = walks else { return };
        for axis in 0..3 {
            let (link, walk) =
                (motion.link_m2(axis, interval_s), motion.velocity_m2_s2(axis, interval_s));
            self.add_noise(axis, VELOCITY + axis, link, walk, interval_s);
        }
        let (link, walk) = (clock.link_m2(interval_s), clock.drift_m2_s2(interval_s));
        self.add_noise(CLOCK, DRIFT, link, walk, interval_s);
        self.make_symmetric();
    }

    /// Adds the noise of a rate with variance `walk`, and of its trapezoidal integral with variance
    /// `link`.
    fn add_noise(&mut self, moved: usize, rate: usize, link: f64, walk: f64, interval_s: f64) {
        let half_s = 0.5 * interval_s;
        self.covariance[(moved, moved)] += half_s * half_s * walk + link;
        self.covariance[(moved, rate)] += half_s * walk;
        self.covariance[(rate, moved)] += half_s * walk;
        self.covariance[(rate, rate)] += walk;
    }

    /// Updates with a row unless r²/S exceeds the limit; returns whether the row was used.
    pub(super) fn update(&mut self, innovation: &Innovation, limit: f64) -> bool {
        let Innovation { slope, residual, variance } = innovation;
        let carried = self.covariance * slope;
        let total = slope.dot(&carried) + variance;
        if limit < residual * residual / total {
            return false;
        }
        let gain = carried / total;
        self.mean -= gain * *residual;
        // (I − K J)·P, then that times (I − K J)ᵀ, plus R·K·Kᵀ.
        // Element by element: outer products as matrices are slow where they are not inlined.
        let left = Matrix::from_fn(|i, j| self.covariance[(i, j)] - gain[i] * carried[j]);
        let left_slope = left * slope;
        self.covariance = Matrix::from_fn(|i, j| {
            left[(i, j)] - left_slope[i] * gain[j] + gain[i] * gain[j] * variance
        });
        self.make_symmetric();
        true
    }

    fn make_symmetric(&mut self) {
        for row in 0..SIZE {
            for column in 0..row {
                let mean = 0.5 * (self.covariance[(row, column)] + self.covariance[(column, row)]);
                self.covariance[(row, column)] = mean;
                self.covariance[(column, row)] = mean;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::{ClockFactor, MotionFactor};

    const MOTION: MotionWalk = MotionWalk { velocity_m_s: [2.0, 2.0, 1.0] };
    const CLOCK_WALK: ClockWalk = ClockWalk { clock_m: 0.3, drift_m_s: 0.5 };

    fn gaussian() -> Gaussian {
        let mut gaussian = Gaussian::zero();
        for column in 0..STATE {
            gaussian.renew(column, 1.0 + column as f64, 2.0 + 0.5 * column as f64);
        }
        gaussian
    }

    fn row(column: usize, residual: f64) -> Innovation {
        Innovation::row(&Row { residual, columns: [column], jacobian: [0.5] }, None)
    }

    /// East 1 ± 2 m, measured as 5 ± 2 m: halfway at 3 ± √2 m.
    #[test]
    fn an_update_worked_by_hand() {
        let mut gaussian = gaussian();
        assert!(!gaussian.update(&row(0, -2.0), 1.99), "the square of 4 m over 8 m² is 2");
        assert!(gaussian.update(&row(0, -2.0), 2.01));
        assert!((gaussian.state()[0] - 3.0).abs() < 1e-12);
        assert!((gaussian.state_covariance()[(0, 0)] - 2.0).abs() < 1e-12);
    }

    /// 20 m off is 10 standard deviations of the measurement and √(100/2) of the innovation.
    #[test]
    fn an_innovation_beyond_the_limit_changes_nothing() {
        let mut tested = gaussian();
        assert!(!tested.update(&row(0, -10.0), 10.8));
        assert_eq!(tested, gaussian());
        assert!(tested.update(&row(0, -10.0).scaled(0.01), 10.8));
    }

    /// The information of a sum is the sum of the information: P⁻¹ + Σ JᵀJ/R.
    #[test]
    fn updates_add_information() {
        let mut gaussian = gaussian();
        gaussian.predict(Some((&MOTION, &CLOCK_WALK)), 2.0);
        let columns = [0, 3, CLOCK];
        let rows = [[0.4, -0.3, 1.0], [-0.7, 0.1, 1.0], [0.2, 0.9, 0.5]].map(|jacobian| {
            Innovation::row(&Row { residual: 0.3, columns, jacobian }, None).scaled(0.5)
        });
        let mut information = gaussian.state_covariance().try_inverse().unwrap();
        for row in &rows {
            let slope = row.slope.fixed_rows::<STATE>(0);
            information += slope * slope.transpose() / row.variance;
            assert!(gaussian.update(row, f64::INFINITY));
        }
        let expected = information.try_inverse().unwrap();
        let difference = (gaussian.state_covariance() - expected).norm();
        assert!(difference < 1e-12 * expected.norm(), "{difference}");
    }

    /// After a prediction from a known state, the graph's motion and clock factors between both
    /// ends have unit variance and no correlation: J Q Jᵀ = I.
    #[test]
    fn the_prediction_is_that_of_the_graphs_factors() {
        let mut gaussian = Gaussian::zero();
        gaussian.predict(Some((&MOTION, &CLOCK_WALK)), 2.0);
        let (at, next) = (State::zeros(), State::zeros());
        let motion = MotionFactor::new(&MOTION, 2.0);
        let clock = ClockFactor::new(&CLOCK_WALK, 2.0, Some(0.0));
        let mut rows = Vec::new();
        let slope = |columns: &[usize], jacobian: &[f64]| {
            let mut slope = State::zeros();
            columns.iter().zip(jacobian).for_each(|(column, value)| slope[*column] = *value);
            slope
        };
        for axis in 0..3 {
            let (level, rate) =
                (motion.position_row(axis, &at, &next), motion.velocity_row(axis, &at, &next));
            rows.push(slope(&level.next_columns, &level.next_jacobian));
            rows.push(slope(&rate.next_columns, &rate.next_jacobian));
        }
        let (level, rate) = (clock.clock_row(&at, &next), clock.drift_row(&at, &next));
        rows.push(slope(&level.next_columns, &level.next_jacobian));
        rows.push(slope(&rate.next_columns, &rate.next_jacobian));
        for (i, a) in rows.iter().enumerate() {
            for (j, b) in rows.iter().enumerate() {
                let product = (a.transpose() * gaussian.state_covariance() * b).x;
                let expected = f64::from(i == j);
                assert!((product - expected).abs() < 1e-9, "{i} {j}: {product}");
            }
        }
    }

    /// A displacement of 7 ± 0.1 m from a position with σ = 2 m: the displacement is then known,
    /// and the position stays uncertain.
    #[test]
    fn a_link_measures_against_the_epoch_before() {
        let mut gaussian = gaussian();
        gaussian.predict(Some((&MOTION, &CLOCK_WALK)), 1.0);
        let moved = gaussian.state()[0] - gaussian.past()[0];
        let link = Link {
            residual: (moved - 7.0) / 0.1,
            columns: [0],
            jacobian: [-10.0],
            next_columns: [0],
            next_jacobian: [10.0],
        };
        assert!(gaussian.update(&Innovation::link(&link), f64::INFINITY));
        assert!((gaussian.state()[0] - gaussian.past()[0] - 7.0).abs() < 0.01);
        assert!(1.9 < gaussian.state_covariance()[(0, 0)].sqrt());
    }
}
