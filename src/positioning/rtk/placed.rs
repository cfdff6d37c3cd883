//! Where an epoch is once its integers are known, and where its phases then place it.

use nalgebra::{Matrix3, Vector3};

use crate::graph::{Kernel, SharingRow, shared_offset};
use crate::positioning::setup::{CARRIER_KERNEL, OFFSET_KERNEL};

use super::arcs::Arcs;
use super::epoch::{Ambiguity, RtkEpoch, Scratch, State};
use super::joint::Joint;

/// Deviation of the position that is set out from (m): says next to nothing.
const START_M: f64 = 10.0;
/// Factors on the kernel's width, one iteration after another: what is astray is seen from where
/// the others agree.
const WIDENINGS: [f64; 7] = [4.0, 2.0, 1.4, 1.0, 1.0, 1.0, 1.0];
/// Iterations with the kernel of offsets before.
const CONVEX_ITERATIONS: usize = 3;
/// Share of a satellite's information below which nothing checks it.
const CHECKED_LEAST: f64 = 1e-9;
/// Information on the cycles that all phases of a group have in common (1/cycles²): 1000 cycles.
const COMMON_INFORMATION: f64 = 1e-6;
/// A position is within centimetres whose horizontal standard deviation is at most this in every
/// direction (m): 95 % of its errors are within 12 cm.
pub(super) const FIXED_SIGMA_M: f64 = 0.05;

/// A position with integers held.
#[derive(Clone, Copy, Debug)]
pub(super) struct FixedPosition {
    /// Local (m).
    pub(super) position: Vector3<f64>,
    /// (m²).
    pub(super) covariance: Matrix3<f64>,
    /// Double differences held.
    pub(super) held: usize,
    /// Estimated probability that they are right.
    pub(super) probability: f64,
}

impl FixedPosition {
    /// Greatest horizontal standard deviation (m).
    pub(super) fn horizontal_sigma_m(&self) -> f64 {
        let horizontal = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        horizontal.symmetric_eigenvalues().max().sqrt()
    }
}

/// A position by phases with integers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    /// Local (m).
    pub(super) position: Vector3<f64>,
    /// (m²).
    pub(super) covariance: Matrix3<f64>,
    /// Greatest horizontal error by one satellite astray, over the norm of the whitened
    /// residuals that it leaves (m); infinite where no other checks a satellite.
    hidden_m: f64,
}

impl Placed {
    /// How far one satellite astray may have moved the position (m), by the sum of the squares of
    /// so many whitened residuals.
    ///
    /// An error b of satellite s, common to its signals, moves the position by b·C·Σ wa and leaves
    /// residuals of the norm b·√(Σ w − (Σ wa)ᵀ·C·(Σ wa)), sums over the rows of s: one is known by
    /// the other. What is beyond one for each residual is put down to the worst satellite.
    ///
    /// Source: the characteristic slope of receiver autonomous integrity monitoring; Zhao, Song &
    /// Wang (2024), *An improved RAIM availability assessment method based on the characteristic
    /// slope*, Sensors 24, 3283.
    pub(super) fn hidden_shift_m(&self, squares: f64, residuals: usize) -> f64 {
        let beyond = squares - residuals as f64;
        if beyond <= 0.0 { 0.0 } else { self.hidden_m * beyond.sqrt() }
    }
}

/// A phase with its integer: satellite, row.
struct Phase {
    sight: usize,
    row: SharingRow<3>,
}

/// The position that the phases of an epoch agree on, from `start` on; `None` where they do not
/// determine one.
///
/// A graph gives a phase a share of its weight, since errors last, and what goes before has told
/// the ambiguity the rest. With integers there is no ambiguity to be told: each phase counts in
/// full here, by [`CARRIER_KERNEL`], which leaves out what is astray. Each group has its offset
/// and, where wavelengths differ, cycles common to all.
pub(super) fn place(
    epoch: &RtkEpoch,
    start: &Vector3<f64>,
    border: &[f64],
    arcs: &Arcs,
    scratch: &mut Scratch,
) -> Option<Placed> {
    let groups = phases(epoch, start, border, arcs, scratch);
    let convex = std::iter::repeat_n(OFFSET_KERNEL, CONVEX_ITERATIONS);
    let kernels = convex.chain(WIDENINGS.map(|factor| CARRIER_KERNEL.widened(factor)));
    let (mut moved, mut covariance) = (Vector3::zeros(), Matrix3::zeros());
    for kernel in kernels {
        let (pull, information) = normal_equations(&groups, &moved, &kernel, scratch);
        covariance = information.try_inverse()?;
        moved += covariance * pull;
    }
    let hidden_m = hidden_slope_m(&groups, epoch.sights.len());
    Some(Placed { position: start + moved, covariance, hidden_m })
}

/// The phases with integers of each group, linearised at a position.
fn phases(
    epoch: &RtkEpoch,
    position: &Vector3<f64>,
    border: &[f64],
    arcs: &Arcs,
    scratch: &mut Scratch,
) -> Vec<Vec<Phase>> {
    let mut state = State::zeros();
    state.fixed_rows_mut::<3>(0).copy_from(position);
    epoch.see(&state, scratch);
    let mut groups = Vec::new();
    for group in epoch.groups.iter().filter(|group| group.is_carrier) {
        epoch.linearize_group(group, border, scratch);
        arcs.put_labels(border, &mut scratch.rows);
        let factors = &epoch.rows[group.begin..group.end];
        let phase = |row: &SharingRow<3>| {
            let (variable, _) = row.border?;
            let is_its = |ambiguity: Ambiguity| ambiguity.variable == variable;
            let factor = factors.iter().find(|factor| factor.ambiguity.is_some_and(is_its))?;
            Some(Phase { sight: factor.sight, row: SharingRow { share: 1.0, ..*row } })
        };
        groups.push(scratch.rows.iter().filter_map(phase).collect());
    }
    groups
}

/// −Jᵀr and JᵀJ of the position, where it has `moved` (m); offsets and common cycles eliminated.
fn normal_equations(
    groups: &[Vec<Phase>],
    moved: &Vector3<f64>,
    kernel: &Kernel,
    scratch: &mut Scratch,
) -> (Vector3<f64>, Matrix3<f64>) {
    let known = START_M.powi(-2);
    let (mut pull, mut information) = (-moved * known, Matrix3::identity() * known);
    let Scratch { rows, numbers, .. } = scratch;
    for group in groups {
        rows.clear();
        rows.extend(group.iter().map(|phase| {
            let mut row = phase.row;
            row.row.residual += Vector3::from(row.row.jacobian).dot(moved);
            row
        }));
        take_common_cycles_out(rows);
        let offset_m = shared_offset(rows, kernel, numbers);
        let (mut total, mut mean) = (0.0, Vector3::zeros());
        numbers.clear();
        for row in rows.iter() {
            let weight = kernel.weight(row.row.residual + row.by_offset * offset_m);
            let weight = weight * row.by_offset.powi(2);
            numbers.push(weight);
            total += weight;
            mean += slope(row) * weight;
        }
        if total == 0.0 {
            continue;
        }
        mean /= total;
        let weighted = rows.iter().zip(&*numbers);
        let mean_m = weighted.clone().map(|(row, w)| w * wavelength_m(row)).sum::<f64>() / total;
        let (mut tie, mut common) = (Vector3::zeros(), COMMON_INFORMATION);
        for (row, weight) in weighted {
            let (centred, beyond_m) = (slope(row) - mean, wavelength_m(row) - mean_m);
            information += centred * centred.transpose() * *weight;
            pull -= centred * (weight * (row.row.residual / row.by_offset + offset_m));
            tie += centred * (weight * beyond_m);
            common += weight * beyond_m.powi(2);
        }
        // The common cycles' part of the pull is out of the residuals.
        information -= tie * tie.transpose() / common;
    }
    (pull, information)
}

/// Wavelength of a row's ambiguity (m).
fn wavelength_m(row: &SharingRow<3>) -> f64 {
    row.border.map_or(0.0, |(_, slope)| slope / row.by_offset)
}

/// Takes out of the residuals of a group what cycles common to all explain. Where wavelengths
/// differ, as GLONASS's do, that is no offset, and so uncertain before position and integers are
/// known that the graph's estimate leaves centimetres.
pub(super) fn take_common_cycles_out(rows: &mut [SharingRow<3>]) {
    let (mut total, mut mean_m, mut mean_miss_m) = (0.0, 0.0, 0.0);
    for row in rows.iter() {
        let weight = row.by_offset.powi(2);
        total += weight;
        mean_m += weight * wavelength_m(row);
        mean_miss_m += row.by_offset * row.row.residual;
    }
    if total == 0.0 {
        return;
    }
    (mean_m, mean_miss_m) = (mean_m / total, mean_miss_m / total);
    let (mut along, mut information) = (0.0, COMMON_INFORMATION);
    for row in rows.iter() {
        let (weight, beyond_m) = (row.by_offset.powi(2), wavelength_m(row) - mean_m);
        along += weight * beyond_m * (row.row.residual / row.by_offset - mean_miss_m);
        information += weight * beyond_m.powi(2);
    }
    let cycles = along / information;
    for row in rows {
        row.row.residual -= cycles * (wavelength_m(row) - mean_m) * row.by_offset;
    }
}

/// Slope of a row by the position, over that by the offset.
fn slope(row: &SharingRow<3>) -> Vector3<f64> {
    Vector3::from(row.row.jacobian) / row.by_offset
}

/// See [`Placed::hidden_m`]; of cycles common to all, as if they were known.
fn hidden_slope_m(groups: &[Vec<Phase>], satellites: usize) -> f64 {
    let mut information = Matrix3::zeros();
    let mut sums = vec![(0.0, Vector3::zeros()); satellites];
    for group in groups {
        let weight = |phase: &Phase| phase.row.by_offset.powi(2);
        let total: f64 = group.iter().map(weight).sum();
        let weighted: Vector3<f64> = group.iter().map(|p| slope(&p.row) * weight(p)).sum();
        for phase in group {
            let (own, centred) = (weight(phase), slope(&phase.row) - weighted / total);
            information += centred * centred.transpose() * own;
            let (alone, moving) = &mut sums[phase.sight];
            *alone += own - own * own / total;
            *moving += centred * own;
        }
    }
    let Some(covariance) = information.try_inverse() else { return f64::INFINITY };
    let slopes = sums.iter().filter(|(alone, _)| 0.0 < *alone).map(|(alone, moving)| {
        let shift = covariance * moving;
        let left = alone - moving.dot(&shift);
        match CHECKED_LEAST * alone < left {
            true => shift.xy().norm() / left.sqrt(),
            false => f64::INFINITY,
        }
    });
    slopes.fold(0.0, f64::max)
}

/// Where joint estimates leave the position with so many integers held.
pub(super) fn fixed_position(joint: &Joint, held: usize, probability: f64) -> FixedPosition {
    FixedPosition {
        position: joint.estimate.fixed_rows::<3>(0).into_owned(),
        covariance: joint.covariance.fixed_view::<3, 3>(0, 0).into_owned(),
        held,
        probability,
    }
}

#[cfg(test)]
mod tests {
    use super::super::arcs::{Arc, Label};
    use super::super::epoch::{DifferenceFactor, Group};
    use super::*;
    use crate::gnss::{
        Band, Constellation, Ecef, GpsTime, LocalFrame, ObservationCode, SatelliteId,
    };
    use crate::positioning::factors::Sight;

    const SATELLITES: usize = 10;
    const WAVELENGTH_M: f64 = 0.19;
    const SIGMA_M: f64 = 0.01;
    const TRUTH: [f64; 3] = [0.3, -0.2, 0.5];

    /// An epoch at [`TRUTH`] with integers 3k and a common offset of 7 m; the phase of one satellite
    /// is too long by so much.
    fn epoch(satellites: usize, astray: usize, by_m: f64) -> (RtkEpoch, Vec<f64>, Arcs) {
        let frame = LocalFrame::at(Ecef(Vector3::new(4.0e6, 1.0e6, 4.85e6)));
        let (mut epoch, mut arcs) = (RtkEpoch::new(), Arcs::default());
        let code = ObservationCode::parse("1C").unwrap();
        for k in 0..satellites {
            let (azimuth, elevation) = (2.4 * k as f64, 0.3 + 0.12 * k as f64);
            let level = f64::cos(elevation);
            let line = Vector3::new(level * azimuth.sin(), level * azimuth.cos(), elevation.sin());
            let satellite = Ecef(frame.origin.0 + frame.rotation.transpose() * line * 2.2e7);
            let sight = Sight::new(&frame, satellite);
            let (range_m, _) = sight.range(&Vector3::from(TRUTH));
            let error_m = if k == astray { by_m } else { 0.0 };
            epoch.sights.push(sight);
            epoch.rows.push(DifferenceFactor {
                sight: k,
                range_m: range_m + 3.0 * k as f64 * WAVELENGTH_M + 7.0 + error_m,
                inverse_sigma: SIGMA_M.recip(),
                share: 0.2,
                ambiguity: Some(Ambiguity { variable: k, wavelength_m: WAVELENGTH_M }),
                bias: None,
            });
            arcs.list.push(Arc {
                satellite: SatelliteId::new(Constellation::Gps, 1 + k as u8).unwrap(),
                band: Band::L1,
                codes: [code; 2],
                variable: k,
                serial: k as u64,
                frequency_hz: 1_575.42e6,
                last: GpsTime::EPOCH,
                epochs: 9,
                half_cycle: false,
                elevation_rad: elevation,
                label: Some(Label { origin: 1, integer: 3 * k as i64 }),
            });
        }
        epoch.groups.push(Group { begin: 0, end: satellites, is_carrier: true });
        let border = (0..satellites).map(|k| 3.0 * k as f64).collect();
        (epoch, border, arcs)
    }

    fn placed(satellites: usize, astray: usize, by_m: f64) -> Placed {
        let (epoch, border, arcs) = epoch(satellites, astray, by_m);
        place(&epoch, &Vector3::zeros(), &border, &arcs, &mut Scratch::default()).unwrap()
    }

    fn horizontal_error_m(placed: &Placed) -> f64 {
        (placed.position - Vector3::from(TRUTH)).xy().norm()
    }

    /// Whatever share of its weight a phase had, its σ of 1 cm is about that of the position. Among
    /// ten satellites any one that is a cycle astray is left out.
    #[test]
    fn phases_that_agree_place_the_rover() {
        let right = placed(SATELLITES, 0, 0.0);
        assert!((right.position - Vector3::from(TRUTH)).norm() < 1e-4, "{right:?}");
        let sigma_m = right.covariance[(0, 0)].sqrt();
        assert!((0.005..0.02).contains(&sigma_m), "{sigma_m}");
        for astray in 0..SATELLITES {
            let one = placed(SATELLITES, astray, WAVELENGTH_M);
            assert!(horizontal_error_m(&one) < 0.01, "{astray}: {one:?}");
        }
    }

    /// An error too small to be left out moves the position by no more than its residuals tell;
    /// that of the worst satellite by just that.
    #[test]
    fn residuals_bound_what_one_satellite_does() {
        let mut worst: f64 = 0.0;
        for astray in 0..SATELLITES {
            let (epoch, border, arcs) = epoch(SATELLITES, astray, 1e-3);
            let scratch = &mut Scratch::default();
            let one = place(&epoch, &Vector3::zeros(), &border, &arcs, scratch).unwrap();
            let groups = phases(&epoch, &one.position, &border, &arcs, scratch);
            let quadratic = &Kernel::QUADRATIC;
            let rows: Vec<_> = groups[0].iter().map(|phase| phase.row).collect();
            let offset_m = shared_offset(&rows, quadratic, &mut Vec::new());
            let miss = |row: &SharingRow<3>| row.row.residual + row.by_offset * offset_m;
            let norm = rows.iter().map(|row| miss(row).powi(2)).sum::<f64>().sqrt();
            worst = worst.max(horizontal_error_m(&one) / (norm * one.hidden_m));
        }
        assert!((0.95..1.02).contains(&worst), "{worst}");
    }

    /// Three hundred cycles common to wavelengths that differ, and 7 m: the cycles go, the offset
    /// stays, and so does what one row is off beside them.
    #[test]
    fn common_cycles_are_no_residual() {
        let row = |k: usize| {
            let wavelength_m = 0.187 + 6.6e-5 * k as f64;
            let off_m = if k == 3 { 0.01 } else { 0.0 };
            SharingRow {
                row: crate::graph::Row {
                    residual: (7.0 + 300.0 * wavelength_m + off_m) / SIGMA_M,
                    columns: [0, 1, 2],
                    jacobian: [0.0; 3],
                },
                by_offset: SIGMA_M.recip(),
                border: Some((k, wavelength_m / SIGMA_M)),
                share: 1.0,
            }
        };
        let mut rows: Vec<_> = (0..8).map(row).collect();
        take_common_cycles_out(&mut rows);
        let miss_m = |k: usize| (rows[k].row.residual - rows[0].row.residual) * SIGMA_M;
        assert!((1..8).filter(|&k| k != 3).all(|k| miss_m(k).abs() < 1.5e-3));
        assert!((miss_m(3) - 0.01).abs() < 1e-3, "{}", miss_m(3));
    }

    /// With four satellites nothing checks any; residuals as large as expected still hide nothing.
    #[test]
    fn what_nothing_checks_may_hide_anything() {
        let four = placed(4, 0, 0.0);
        assert_eq!(four.hidden_shift_m(4.1, 4), f64::INFINITY);
        assert_eq!(four.hidden_shift_m(4.0, 4), 0.0);
        let shift_m = placed(SATELLITES, 0, 0.0).hidden_shift_m(16.0, SATELLITES);
        assert!((0.01..0.2).contains(&shift_m), "{shift_m}");
    }
}
