//! Whitened residuals of epochs that were solved.

use nalgebra::{Matrix3, Vector3};

use crate::graph::{Kernel, SharingRow, shared_offset};
use crate::positioning::setup::OFFSET_KERNEL;

use super::epoch::{Group, RowScratch, RtkEpoch, State};
use super::noise::Residuals;

/// Whitened residuals of the rows of a group, with the offset that fits best.
pub(crate) fn whitened<'a>(
    rows: &'a [SharingRow<3>],
    kernel: &Kernel,
    numbers: &mut Vec<f64>,
) -> impl Iterator<Item = f64> + use<'a> {
    let offset_m = shared_offset(rows, kernel, numbers);
    rows.iter().map(move |row| row.row.residual + row.by_offset * offset_m)
}

/// Writes the magnitudes of the pseudorange residuals at a state to the scratch; returns the number
/// of groups.
pub(crate) fn pseudorange_residuals(
    epoch: &RtkEpoch,
    state: &State,
    scratch: &mut RowScratch,
) -> usize {
    let groups = epoch.groups.iter().filter(|group| !group.is_carrier);
    gather(epoch, state, groups, &[], |_| (), scratch)
}

/// The same for carrier phases with the ambiguities of `border`. `fix` may first change or drop the
/// rows of a group.
pub(crate) fn carrier_residuals(
    epoch: &RtkEpoch,
    state: &State,
    border: &[f64],
    fix: impl Fn(&mut Vec<SharingRow<3>>),
    scratch: &mut RowScratch,
) -> usize {
    let groups = epoch.groups.iter().filter(|group| group.is_carrier);
    gather(epoch, state, groups, border, fix, scratch)
}

fn gather<'a>(
    epoch: &RtkEpoch,
    state: &State,
    groups: impl Iterator<Item = &'a Group>,
    border: &[f64],
    fix: impl Fn(&mut Vec<SharingRow<3>>),
    scratch: &mut RowScratch,
) -> usize {
    scratch.residuals.clear();
    epoch.see(state, scratch);
    let mut count = 0;
    for group in groups {
        epoch.linearize_group(group, border, scratch);
        let RowScratch { rows, numbers, residuals, .. } = &mut *scratch;
        fix(rows);
        if 2 <= rows.len() {
            residuals.extend(whitened(rows, &OFFSET_KERNEL, numbers).map(f64::abs));
            count += 1;
        }
    }
    count
}

/// Pseudorange residuals of a solved window, with their degrees of freedom.
///
/// The pseudoranges have determined one offset for each group, and a part of one position. Phases
/// tie the epochs together, so the newest position, with `covariance`, represents all of them.
pub(crate) fn window_residuals(
    epochs: &[RtkEpoch],
    states: &[State],
    covariance: &Matrix3<f64>,
    scratch: &mut RowScratch,
) -> Residuals {
    let (mut square, mut freedom) = (0.0, 0.0);
    for (epoch, state) in epochs.iter().zip(states) {
        freedom -= leverage(epoch, state, covariance, scratch, |fraction| fraction);
        epoch.see(state, scratch);
        for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
            epoch.linearize_group(group, &[], scratch);
            let RowScratch { rows, numbers, .. } = &mut *scratch;
            let left = 1.0 - (rows.len() as f64).recip();
            for (row, residual) in rows.iter().zip(whitened(rows, &OFFSET_KERNEL, numbers)) {
                square += row.independent_share * residual * residual;
                freedom += row.independent_share * left;
            }
        }
    }
    Residuals { square, freedom: f64::max(freedom, 0.0) }
}

/// Sum over an epoch's pseudoranges of aᵀCa/σ², each times the function `of` of its independent
/// share. Offsets are eliminated.
pub(crate) fn leverage(
    epoch: &RtkEpoch,
    state: &State,
    covariance: &Matrix3<f64>,
    scratch: &mut RowScratch,
    of: impl Fn(f64) -> f64,
) -> f64 {
    epoch.see(state, scratch);
    let mut sum = 0.0;
    for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
        epoch.linearize_group(group, &[], scratch);
        let rows = &scratch.rows;
        let total: f64 = rows.iter().map(|row| row.by_offset.powi(2)).sum();
        let weighted = |row: &SharingRow<3>| Vector3::from(row.row.jacobian) * row.by_offset;
        let mean = rows.iter().map(weighted).sum::<Vector3<f64>>() / total;
        for row in rows.iter().filter(|_| 1 < rows.len()) {
            let slope = Vector3::from(row.row.jacobian) - mean * row.by_offset;
            sum += of(row.independent_share) * slope.dot(&(covariance * slope));
        }
    }
    sum
}
