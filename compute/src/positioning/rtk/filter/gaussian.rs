//! The filter's state as a normal distribution: prediction and update.

use nalgebra::{DMatrix, SMatrix};

use crate::graph::{SharingRow, shared_offset};
use crate::positioning::factors::{MotionWalk, VELOCITY};
use crate::positioning::rtk::ambiguity::FloatSolution;
use crate::positioning::rtk::observed::{AmbiguityStart, CarrierArc, STATE, State};
use crate::positioning::setup::OFFSET_KERNEL;
use crate::snapshot::state_fields;

/// Column of the offset that the rows of one group share.
const OFFSET: usize = STATE;
/// Column of the first ambiguity.
const AMBIGUITY: usize = OFFSET + 1;
/// Prior standard deviation of a group's offset about the value that its rows give (m): much wider
/// than the σ of any row, so that the offset is free.
const OFFSET_M: f64 = 1e3;

/// Mean and covariance of [p; v; o; N…]: position, velocity, the offset of the group that entered
/// last and the ambiguities by their border variables.
#[derive(Debug)]
pub(crate) struct Gaussian {
    mean: Vec<f64>,
    /// Column-major; zero where a variable has not begun.
    covariance: Vec<f64>,
}

state_fields!(Gaussian { mean, covariance });

/// Scratch for updates.
#[derive(Debug, Default)]
pub(crate) struct Gains {
    numbers: Vec<f64>,
    /// Index of each row, and whether it fails the innovation test before any row has entered.
    order: Vec<(bool, usize)>,
    /// Mean that the rows were linearised at.
    at: Vec<f64>,
    /// P Jᵀ, K, and P Jᵀ after the update.
    carried: Vec<f64>,
    gain: Vec<f64>,
    left: Vec<f64>,
}

/// Columns and partial derivatives of one row: position, offset, ambiguity.
#[derive(Clone, Copy)]
struct Slope {
    columns: [usize; 5],
    values: [f64; 5],
}

impl Slope {
    fn of(row: &SharingRow<3>) -> Self {
        let ([x, y, z], [first, second, third]) = (row.row.jacobian, row.row.columns);
        let (variable, by_ambiguity) = row.border.unwrap_or((0, 0.0));
        let ambiguity = if row.border.is_some() { AMBIGUITY + variable } else { OFFSET };
        Self {
            columns: [first, second, third, OFFSET, ambiguity],
            values: [x, y, z, row.by_offset, by_ambiguity],
        }
    }

    fn times(&self, list: &[f64]) -> f64 {
        self.columns.iter().zip(self.values).map(|(column, value)| value * list[*column]).sum()
    }
}

impl Gaussian {
    /// State of zeros with zero covariance and no ambiguities.
    pub(crate) fn zero() -> Self {
        Self { mean: vec![0.0; AMBIGUITY], covariance: vec![0.0; AMBIGUITY * AMBIGUITY] }
    }

    /// Number of ambiguities; `None` where mean and covariance differ in size.
    pub(crate) fn ambiguities(&self) -> Option<usize> {
        let size = self.mean.len();
        let is_whole = size.checked_mul(size) == Some(self.covariance.len());
        size.checked_sub(AMBIGUITY).filter(|_| is_whole)
    }

    /// Position and velocity.
    pub(crate) fn state(&self) -> State {
        State::from_column_slice(&self.mean[..STATE])
    }

    /// Ambiguities by border variable (cycles).
    pub(crate) fn border(&self) -> &[f64] {
        &self.mean[AMBIGUITY..]
    }

    /// Covariance of position and velocity.
    pub(crate) fn state_covariance(&self) -> SMatrix<f64, STATE, STATE> {
        SMatrix::from_fn(|row, column| self.at(row, column))
    }

    fn at(&self, row: usize, column: usize) -> f64 {
        self.covariance[column * self.mean.len() + row]
    }

    fn at_mut(&mut self, row: usize, column: usize) -> &mut f64 {
        let size = self.mean.len();
        &mut self.covariance[column * size + row]
    }

    /// Position and the ambiguities of some arcs.
    pub(crate) fn float<'a>(&self, arcs: impl Iterator<Item = &'a CarrierArc>) -> FloatSolution {
        let variables: Vec<usize> = arcs.map(|arc| arc.variable).collect();
        let named = variables.iter().map(|variable| AMBIGUITY + variable);
        let columns: Vec<usize> = (0..3).chain(named).collect();
        let n = columns.len();
        FloatSolution {
            position: self.state().fixed_rows::<3>(0).into_owned(),
            ambiguities: variables.iter().map(|&variable| self.border()[variable]).collect(),
            variables,
            covariance: DMatrix::from_fn(n, n, |i, j| self.at(columns[i], columns[j])),
        }
    }

    /// Sets the mean and variance of one variable, uncorrelated with the others.
    pub(crate) fn renew(&mut self, column: usize, mean: f64, sigma: f64) {
        for other in 0..self.mean.len() {
            *self.at_mut(other, column) = 0.0;
            *self.at_mut(column, other) = 0.0;
        }
        self.mean[column] = mean;
        *self.at_mut(column, column) = sigma * sigma;
    }

    /// Begins an ambiguity.
    pub(crate) fn begin(&mut self, start: &AmbiguityStart) {
        let column = AMBIGUITY + start.variable;
        let (size, wanted) = (self.mean.len(), column + 1);
        if size < wanted {
            self.mean.resize(wanted, 0.0);
            let old = std::mem::take(&mut self.covariance);
            for column in old.chunks(size) {
                self.covariance.extend_from_slice(column);
                self.covariance.resize(self.covariance.len() + wanted - size, 0.0);
            }
            self.covariance.resize(wanted * wanted, 0.0);
        }
        self.renew(column, start.mean, start.inverse_sigma.recip());
    }

    /// Predicts over an interval (s).
    pub(crate) fn predict(&mut self, walk: &MotionWalk, interval_s: f64) {
        let half_s = 0.5 * interval_s;
        for axis in 0..3 {
            let rate = VELOCITY + axis;
            self.mean[axis] += interval_s * self.mean[rate];
            for other in 0..self.mean.len() {
                *self.at_mut(axis, other) += interval_s * self.at(rate, other);
            }
            for other in 0..self.mean.len() {
                *self.at_mut(other, axis) += interval_s * self.at(other, rate);
            }
            let (link, change) =
                (walk.link_m2(axis, interval_s), walk.velocity_m2_s2(axis, interval_s));
            *self.at_mut(axis, axis) += half_s * half_s * change + link;
            *self.at_mut(axis, rate) += half_s * change;
            *self.at_mut(rate, axis) += half_s * change;
            *self.at_mut(rate, rate) += change;
        }
    }

    /// Updates with the rows of one group, linearised at the mean; rows that fail the innovation
    /// test are left out. Returns how many entered.
    ///
    /// The group's offset starts at the value that the rows themselves give. Rows enter in the
    /// order of their standard deviations; rows that fail the test against that offset enter last.
    /// So the least suspect rows have determined offset and position when the others are tested.
    pub(crate) fn enter(&mut self, rows: &[SharingRow<3>], limit: f64, gains: &mut Gains) -> usize {
        let offset_m = shared_offset(rows, &OFFSET_KERNEL, &mut gains.numbers);
        self.renew(OFFSET, offset_m, 0.0);
        let mut order = std::mem::take(&mut gains.order);
        order.clear();
        order.extend((0..rows.len()).map(|i| {
            let residual = rows[i].row.residual + rows[i].by_offset * offset_m;
            (limit * self.innovation_variance(&rows[i]) < residual * residual, i)
        }));
        let sigma = |i: usize| rows[i].by_offset.recip();
        order.sort_by(|&(a_fails, a), &(b_fails, b)| {
            a_fails.cmp(&b_fails).then(sigma(a).total_cmp(&sigma(b)))
        });
        self.renew(OFFSET, offset_m, OFFSET_M);
        gains.at.clone_from(&self.mean);
        // The rows were linearised at offset zero.
        gains.at[OFFSET] = 0.0;
        let mut entered = 0;
        for &(_, i) in &order {
            let slope = Slope::of(&rows[i]);
            let residual = rows[i].row.residual + slope.times(&self.mean) - slope.times(&gains.at);
            entered += usize::from(self.update(&slope, residual, &rows[i], limit, gains));
        }
        gains.order = order;
        entered
    }

    /// S = J P Jᵀ + R of one row.
    fn innovation_variance(&self, row: &SharingRow<3>) -> f64 {
        let Slope { columns, values } = Slope::of(row);
        let mut sum = row.independent_share.recip();
        for (a, &value) in columns.iter().zip(&values) {
            for (b, &other) in columns.iter().zip(&values) {
                sum += value * other * self.at(*a, *b);
            }
        }
        sum
    }

    /// Updates with one row of residual r and variance R: S = J P Jᵀ + R, K = P Jᵀ/S, x ← x − K·r
    /// and P ← (I − K J)·P·(I − K J)ᵀ + R·K·Kᵀ. Returns false where r²/S exceeds the limit.
    fn update(
        &mut self,
        slope: &Slope,
        residual: f64,
        row: &SharingRow<3>,
        limit: f64,
        gains: &mut Gains,
    ) -> bool {
        let n = self.mean.len();
        let Gains { carried, gain, left, .. } = gains;
        carried.clear();
        carried.resize(n, 0.0);
        for (&column, value) in slope.columns.iter().zip(slope.values) {
            let column = &self.covariance[column * n..(column + 1) * n];
            carried.iter_mut().zip(column).for_each(|(sum, entry)| *sum += value * entry);
        }
        let variance = row.independent_share.recip();
        let (known, total) = (slope.times(carried), slope.times(carried) + variance);
        if limit < residual * residual / total {
            return false;
        }
        gain.clear();
        gain.extend(carried.iter().map(|carried| carried / total));
        // (I − K J)·P is P − K·cᵀ with c = P Jᵀ, which times Jᵀ leaves c − K·(J c).
        left.clear();
        left.extend(carried.iter().zip(&*gain).map(|(carried, gain)| carried - gain * known));
        for column in 0..n {
            let (k, c) = (gain[column], carried[column]);
            for row in 0..=column {
                let change = gain[row] * (variance * k - c) - left[row] * k;
                self.covariance[column * n + row] += change;
                self.covariance[row * n + column] = self.covariance[column * n + row];
            }
        }
        self.mean.iter_mut().zip(&*gain).for_each(|(mean, gain)| *mean -= gain * residual);
        true
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DVector, SVector};

    use super::*;
    use crate::graph::Row;

    const WALK: MotionWalk = MotionWalk { velocity_m_s: [2.0, 2.0, 1.0] };
    const START: [f64; 2] = [30.0, 5.0];

    fn gaussian(ambiguities: usize) -> Gaussian {
        let mut gaussian = Gaussian::zero();
        for column in 0..STATE {
            gaussian.renew(column, 0.1 * column as f64, START[column / 3]);
        }
        for variable in 0..ambiguities {
            gaussian.begin(&AmbiguityStart { variable, mean: 0.0, inverse_sigma: 0.01 });
        }
        gaussian
    }

    /// A row at the mean [0; 0.1; 0.2], N = 0 that measures `m` along a unit vector by two angles.
    fn row(m: f64, angles: [f64; 2], sigma_m: f64, ambiguity: Option<usize>) -> SharingRow<3> {
        let ((se, ce), (sa, ca)) = (angles[0].sin_cos(), angles[1].sin_cos());
        let w = sigma_m.recip();
        let jacobian = [ce * sa * w, ce * ca * w, se * w];
        let at = jacobian[1] * 0.1 + jacobian[2] * 0.2;
        SharingRow {
            row: Row { residual: at - m * w, columns: [0, 1, 2], jacobian },
            by_offset: w,
            border: ambiguity.map(|variable| (variable, 0.19 * w)),
            independent_share: 0.5,
        }
    }

    fn sky(sigma_m: f64, m: f64, first: Option<usize>) -> Vec<SharingRow<3>> {
        let at = |k: usize| [0.3 + 0.17 * k as f64, 1.1 * k as f64];
        let own = |k: usize| m + (3.7 * k as f64).sin();
        (0..7).map(|k| row(own(k), at(k), sigma_m, first.map(|first| first + k))).collect()
    }

    /// A filter is least squares: two groups with a free offset each, solved at once by normal
    /// equations over state, ambiguities and both offsets.
    #[test]
    fn rows_of_groups_are_least_squares_with_free_offsets() {
        let (ambiguities, groups) = (7, [sky(0.5, 40.0, None), sky(0.004, -70.0, Some(0))]);
        let mut gaussian = gaussian(ambiguities);
        let size = STATE + ambiguities + groups.len();
        let mut information = DMatrix::zeros(size, size);
        let mut right = DVector::zeros(size);
        for column in 0..STATE {
            information[(column, column)] = START[column / 3].powi(-2);
            right[column] = information[(column, column)] * 0.1 * column as f64;
        }
        (STATE..STATE + ambiguities).for_each(|column| information[(column, column)] = 1e-4);
        let mut gains = Gains::default();
        for (number, group) in groups.iter().enumerate() {
            let mut slopes = Vec::new();
            for row in group {
                let mut slope = DVector::zeros(size);
                slope.rows_mut(0, 3).copy_from(&SVector::from(row.row.jacobian));
                if let Some((variable, derivative)) = row.border {
                    slope[STATE + variable] = derivative;
                }
                slope[STATE + ambiguities + number] = row.by_offset;
                let at = row.row.jacobian[1] * 0.1 + row.row.jacobian[2] * 0.2;
                right -= &slope * ((row.row.residual - at) * row.independent_share);
                information += &slope * slope.transpose() * row.independent_share;
                slopes.push(slope);
            }
            // The rows are linear: their residuals are moved to the current mean.
            let known = DVector::from_iterator(
                size,
                gaussian.state().iter().chain(gaussian.border()).copied().chain([0.0; 2]),
            );
            let mut moved = group.clone();
            for (row, slope) in moved.iter_mut().zip(&slopes) {
                let at = row.row.jacobian[1] * 0.1 + row.row.jacobian[2] * 0.2;
                row.row.residual += slope.dot(&known) - at;
            }
            assert_eq!(gaussian.enter(&moved, f64::INFINITY, &mut gains), 7);
        }
        let covariance = information.try_inverse().unwrap();
        let expected = &covariance * right;
        let arcs = (0..ambiguities).map(|variable| STATE + variable);
        for (column, known) in (0..STATE).chain(arcs).zip(known_of(&gaussian)) {
            let sigma = covariance[(column, column)].sqrt();
            let residual = (known - expected[column]) / sigma;
            // The only difference is the prior of the offsets, 1 km.
            assert!(residual.abs() < 1e-4, "column {column}: {residual} σ");
        }
        for row in 0..STATE {
            for column in 0..STATE {
                let sigmas = (covariance[(row, row)] * covariance[(column, column)]).sqrt();
                let residual = (gaussian.at(row, column) - covariance[(row, column)]) / sigmas;
                assert!(residual.abs() < 1e-4, "{row} {column}: {residual}");
            }
        }
    }

    fn known_of(gaussian: &Gaussian) -> Vec<f64> {
        gaussian.state().iter().chain(gaussian.border()).copied().collect()
    }

    /// A phase that is off by one cycle is rejected at every index in its group, and changes
    /// nothing.
    #[test]
    fn a_slip_is_left_out() {
        let mut gains = Gains::default();
        let at = |k: usize| [0.3 + 0.17 * k as f64, 1.1 * k as f64];
        let slope = |k: usize| Slope::of(&row(0.0, at(k), 1.0, None)).values;
        let truth = [0.02, -0.01, 0.03];
        let range_m = |k: usize| (0..3).map(|axis| slope(k)[axis] * truth[axis]).sum::<f64>();
        let phases = |known: &Gaussian| -> Vec<_> {
            let moved: Vec<f64> = (0..3).map(|axis| known.mean[axis] - 0.1 * axis as f64).collect();
            let way_m = |k: usize| (0..3).map(|axis| slope(k)[axis] * moved[axis]).sum::<f64>();
            (0..7).map(|k| row(range_m(k) - 70.0 - way_m(k), at(k), 0.004, None)).collect()
        };
        let mut settled = gaussian(0);
        assert_eq!(settled.enter(&phases(&gaussian(0)), 10.83, &mut gains), 7);
        for slipped in 0..7 {
            let mut group = phases(&settled);
            group[slipped].row.residual += 0.19 / 0.004;
            let mut gaussian = settled.clone();
            assert_eq!(gaussian.enter(&group, 10.83, &mut gains), 6, "row {slipped}");
            for (axis, truth_m) in truth.iter().enumerate() {
                assert!((gaussian.mean[axis] - truth_m).abs() < 1e-4, "row {slipped}");
            }
        }
    }

    /// From a known state: σ² of the position is q²Δt³/3 + (0.02 m)²·Δt, of the velocity q²Δt, and
    /// their covariance is q²Δt²/2. A correlated ambiguity keeps its correlation.
    #[test]
    fn a_prediction_worked_by_hand() {
        let mut gaussian = gaussian(1);
        for column in 0..STATE {
            gaussian.renew(column, 1.0, 0.0);
        }
        gaussian.predict(&WALK, 3.0);
        assert_eq!(gaussian.state(), State::from([4.0, 4.0, 4.0, 1.0, 1.0, 1.0]));
        let covariance = gaussian.state_covariance();
        assert!((covariance[(0, 0)] - (4.0 * 27.0 / 3.0 + 4e-4 * 3.0)).abs() < 1e-12);
        assert!((covariance[(2, 5)] - 4.5).abs() < 1e-12);
        assert!((covariance[(5, 2)] - 4.5).abs() < 1e-12);
        assert!((covariance[(4, 4)] - 12.0).abs() < 1e-12);
        *gaussian.at_mut(AMBIGUITY, VELOCITY) = 0.25;
        *gaussian.at_mut(VELOCITY, AMBIGUITY) = 0.25;
        gaussian.predict(&WALK, 2.0);
        assert_eq!((gaussian.at(AMBIGUITY, 0), gaussian.at(0, AMBIGUITY)), (0.5, 0.5));
    }
}
