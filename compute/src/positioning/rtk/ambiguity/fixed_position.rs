//! The position with fixed integers: the float solution conditioned on them, then the phases alone.

use nalgebra::{Matrix3, Vector3};

use crate::graph::{Kernel, SharingRow, shared_offset};
use crate::positioning::rtk::observed::{
    Arcs, CarrierArc, EpochAmbiguity, RowScratch, RtkEpoch, State,
};
use crate::positioning::setup::{CARRIER_KERNEL, OFFSET_KERNEL};

use super::joint::Joint;

/// Standard deviation of the prior at the start (m): much larger than that of the phases.
const START_M: f64 = 10.0;
/// Factors on the kernel's width, one for each iteration. The kernel is wide at first, because
/// outliers are visible only when the other phases agree.
const WIDENINGS: [f64; 7] = [4.0, 2.0, 1.4, 1.0, 1.0, 1.0, 1.0];
/// Number of iterations before these, with the convex kernel of the group offsets.
const CONVEX_ITERATIONS: usize = 3;
/// If less than this fraction of a satellite's information is redundant, no other satellite checks
/// it.
const REDUNDANCY_MIN: f64 = 1e-9;
/// Prior information on the cycles that all phases of a group share (1/cycles²): σ = 1000 cycles.
const COMMON_INFORMATION: f64 = 1e-6;
/// Largest horizontal standard deviation of a fix (m): 95 % of its errors are within 12 cm.
const FIXED_SIGMA_M: f64 = 0.05;
/// Largest vertical standard deviation of a fix (m). All satellites are above the receiver, so the
/// height is two to three times less certain than the horizontal position.
const FIXED_SIGMA_UP_M: f64 = 3.0 * FIXED_SIGMA_M;

/// A position with its covariance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalPosition {
    /// Local (m).
    pub(crate) position: Vector3<f64>,
    /// (m²).
    pub(crate) covariance: Matrix3<f64>,
}

impl LocalPosition {
    /// The position of a joint estimate.
    pub(crate) fn of(joint: &Joint) -> Self {
        Self {
            position: joint.estimate.fixed_rows::<3>(0).into_owned(),
            covariance: joint.covariance.fixed_view::<3, 3>(0, 0).into_owned(),
        }
    }

    /// Adds this position as a prior to normal equations whose unknown is a shift from `origin`,
    /// linearised at the shift `moved` (m).
    fn add_to(
        &self,
        (origin, moved): (&Vector3<f64>, &Vector3<f64>),
        (pull, information): (&mut Vector3<f64>, &mut Matrix3<f64>),
    ) {
        let Some(own) = self.covariance.try_inverse() else { return };
        *pull += own * (self.position - origin - moved);
        *information += own;
    }
}

/// A position conditioned on held integers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FixedPosition {
    /// Local (m).
    pub(crate) position: Vector3<f64>,
    /// (m²).
    pub(crate) covariance: Matrix3<f64>,
    /// Number of double differences with integers.
    pub(crate) held: usize,
    /// Probability that all these integers are right.
    pub(crate) probability: f64,
    /// Position from the proven integers alone, by this epoch and the earlier ones; `None` if too
    /// few are proven.
    pub(crate) by_proven: Option<LocalPosition>,
}

impl FixedPosition {
    /// The standard deviation that is too large for a fix, if there is one (m): the largest
    /// horizontal one, else the vertical one.
    pub(crate) fn excessive_sigma_m(&self) -> Option<f64> {
        let horizontal = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let horizontal_m = horizontal.symmetric_eigenvalues().max().sqrt();
        let vertical_m = self.covariance[(2, 2)].sqrt();
        let is_excessive = |(sigma_m, limit_m): &(f64, f64)| limit_m < sigma_m;
        let both = [(horizontal_m, FIXED_SIGMA_M), (vertical_m, FIXED_SIGMA_UP_M)];
        both.into_iter().find(is_excessive).map(|(sigma_m, _)| sigma_m)
    }
}

/// A position from phases with integers alone.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PhasePosition {
    /// Local (m).
    pub(crate) position: Vector3<f64>,
    /// (m²).
    pub(crate) covariance: Matrix3<f64>,
    /// Horizontal shift by one faulty satellite, divided by the norm of the whitened residuals that
    /// it leaves: the largest of all satellites (m). Infinite if no other satellite checks one of
    /// them.
    slope_m: f64,
}

impl PhasePosition {
    /// Largest variance along a horizontal direction (m²).
    pub(crate) fn horizontal_variance_m2(&self) -> f64 {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().max()
    }

    /// Largest shift of the position by one faulty satellite (m), given the sum of `squares` of the
    /// whitened residuals and the number of residuals.
    ///
    /// An error b of satellite s, common to its signals, moves the position by b·C·Σ wa. It leaves
    /// residuals of the norm b·√(Σ w − (Σ wa)ᵀ·C·(Σ wa)). The sums are over the rows of s with
    /// weight w and slope a. So the norm of the residuals gives the shift. Excess χ² is attributed
    /// to the satellite with the largest slope.
    ///
    /// Source: the characteristic slope of receiver autonomous integrity monitoring; Zhao, Song &
    /// Wang (2024), *An improved RAIM availability assessment method based on the characteristic
    /// slope*, Sensors 24, 3283.
    pub(crate) fn undetected_shift_m(&self, squares: f64, residuals: usize) -> f64 {
        let beyond = squares - residuals as f64;
        if beyond <= 0.0 { 0.0 } else { self.slope_m * beyond.sqrt() }
    }
}

/// An epoch whose ambiguities have integers.
#[derive(Clone, Copy)]
pub(crate) struct FixedEpoch<'a> {
    pub(crate) epoch: &'a RtkEpoch,
    /// Float ambiguities by variable (cycles).
    pub(crate) border: &'a [f64],
    /// The arcs with their integers.
    pub(crate) arcs: &'a Arcs,
}

/// A phase with its integer. The row's independent share is the fraction of the phase's information
/// that the known position does not contain.
struct Phase {
    sight: usize,
    row: SharingRow<3>,
}

/// The position from the phases of an epoch, by iterations from `start`; `None` if they do not
/// determine one.
///
/// The graph counts only a fraction of a phase's weight, because errors are correlated in time and
/// earlier epochs have determined its ambiguity. With integers no ambiguity is left: each phase has
/// its full weight under [`CARRIER_KERNEL`], which rejects outliers. Each group has an offset and,
/// where wavelengths differ, a number of cycles that all its phases share.
///
/// These offsets are free here. So few phases in many groups determine a position badly, and one
/// phase with a large error may move it so far that other phases are rejected. The `known`
/// position, that of the proven integers in the graph, uses the offsets of earlier epochs. It
/// enters as a prior. It contains the fraction of a proven phase that the graph has counted; the
/// rest is added here.
pub(crate) fn position_from_fixed_phases(
    fixed: &FixedEpoch<'_>,
    start: &Vector3<f64>,
    known: Option<&LocalPosition>,
    scratch: &mut RowScratch,
) -> Option<PhasePosition> {
    let groups = phases(fixed, start, known.is_some(), scratch);
    let convex = std::iter::repeat_n(OFFSET_KERNEL, CONVEX_ITERATIONS);
    let kernels = convex.chain(WIDENINGS.map(|factor| CARRIER_KERNEL.widened(factor)));
    let (mut moved, mut covariance) = (Vector3::zeros(), Matrix3::zeros());
    for kernel in kernels {
        let (mut pull, mut information) = normal_equations(&groups, &moved, &kernel, scratch);
        if let Some(known) = known {
            known.add_to((start, &moved), (&mut pull, &mut information));
        }
        covariance = information.try_inverse()?;
        moved += covariance * pull;
    }
    let slope_m = characteristic_slope_m(&groups, known, fixed.epoch.sights.len());
    Some(PhasePosition { position: start + moved, covariance, slope_m })
}

/// Subtracts the integers of the newest datum from the rows of one group and drops the other rows.
/// The cycles of the datum are unknown. Where wavelengths differ they are not an offset, so they
/// are set to the mean of the float ambiguities minus their integers.
pub(crate) fn subtract_integers(arcs: &Arcs, border: &[f64], rows: &mut Vec<SharingRow<3>>) {
    let held = |row: &SharingRow<3>| {
        let (variable, _) = row.border?;
        let is_its = |arc: &&CarrierArc| arc.variable == variable;
        arcs.list().iter().find(is_its)?.held
    };
    let newest = rows.iter().filter_map(held).map(|held| held.datum).max();
    let (mut common, mut count) = (0.0, 0.0);
    for row in rows.iter() {
        if let Some((own, (variable, _))) = held(row).zip(row.border)
            && Some(own.datum) == newest
        {
            common += border[variable] - own.cycles as f64;
            count += 1.0;
        }
    }
    common /= f64::max(count, 1.0);
    rows.retain_mut(|row| {
        let own = held(row).filter(|held| Some(held.datum) == newest);
        let (Some(held), Some((variable, slope))) = (own, row.border) else { return false };
        row.row.residual += (held.cycles as f64 + common - border[variable]) * slope;
        true
    });
}

/// The phases with integers of each group, linearised at a position. If `has_proven_position`, the
/// proven integers have already given a position: their phases then lose the information that it
/// contains.
fn phases(
    fixed: &FixedEpoch<'_>,
    position: &Vector3<f64>,
    has_proven_position: bool,
    scratch: &mut RowScratch,
) -> Vec<Vec<Phase>> {
    let FixedEpoch { epoch, border, arcs } = *fixed;
    let mut state = State::zeros();
    state.fixed_rows_mut::<3>(0).copy_from(position);
    epoch.see(&state, scratch);
    let mut groups = Vec::new();
    for group in epoch.groups.iter().filter(|group| group.is_carrier) {
        epoch.linearize_group(group, border, scratch);
        subtract_integers(arcs, border, &mut scratch.rows);
        let factors = &epoch.rows[group.begin..group.end];
        let phase = |row: &SharingRow<3>| {
            let (variable, _) = row.border?;
            let is_its = |ambiguity: EpochAmbiguity| ambiguity.variable == variable;
            let factor = factors.iter().find(|factor| factor.ambiguity.is_some_and(is_its))?;
            let is_proven =
                |arc: &CarrierArc| arc.variable == variable && arc.is_proven && has_proven_position;
            let independent_share = match arcs.list().iter().any(is_proven) {
                true => 1.0 - factor.independent_share,
                false => 1.0,
            };
            Some(Phase { sight: factor.sight, row: SharingRow { independent_share, ..*row } })
        };
        groups.push(scratch.rows.iter().filter_map(phase).collect());
    }
    groups
}

/// −Jᵀr and JᵀJ of the position after a shift by `moved` (m); offsets and common cycles are
/// eliminated.
fn normal_equations(
    groups: &[Vec<Phase>],
    moved: &Vector3<f64>,
    kernel: &Kernel,
    scratch: &mut RowScratch,
) -> (Vector3<f64>, Matrix3<f64>) {
    let known = START_M.powi(-2);
    let (mut pull, mut information) = (-moved * known, Matrix3::identity() * known);
    let RowScratch { rows, numbers, .. } = scratch;
    for group in groups {
        rows.clear();
        rows.extend(group.iter().map(|phase| {
            let mut row = phase.row;
            row.row.residual += Vector3::from(row.row.jacobian).dot(moved);
            row
        }));
        subtract_common_cycles(rows);
        let offset_m = shared_offset(rows, kernel, numbers);
        let (mut total, mut mean) = (0.0, Vector3::zeros());
        numbers.clear();
        for row in rows.iter() {
            let weight = kernel.weight(row.row.residual + row.by_offset * offset_m);
            let weight = weight * row.independent_share * row.by_offset.powi(2);
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
        // The residuals are already without the common cycles, so `pull` has no such part.
        information -= tie * tie.transpose() / common;
    }
    (pull, information)
}

/// Wavelength of a row's ambiguity (m).
fn wavelength_m(row: &SharingRow<3>) -> f64 {
    row.border.map_or(0.0, |(_, slope)| slope / row.by_offset)
}

/// Removes from the residuals of a group the cycles that all its phases share. Where wavelengths
/// differ, as with GLONASS, these are not an offset, and the graph determines them only to
/// centimetres.
pub(crate) fn subtract_common_cycles(rows: &mut [SharingRow<3>]) {
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

/// ∂r/∂position of a row over its ∂r/∂offset.
fn slope(row: &SharingRow<3>) -> Vector3<f64> {
    Vector3::from(row.row.jacobian) / row.by_offset
}

/// [`PhasePosition::slope_m`]. The cycles common to a group are taken as known. Phases have their
/// full weight, because a satellite's error is in the known position as well.
fn characteristic_slope_m(
    groups: &[Vec<Phase>],
    known: Option<&LocalPosition>,
    satellites: usize,
) -> f64 {
    let own = known.and_then(|known| known.covariance.try_inverse());
    let mut information = own.unwrap_or_else(Matrix3::zeros);
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
        match REDUNDANCY_MIN * alone < left {
            true => shift.xy().norm() / left.sqrt(),
            false => f64::INFINITY,
        }
    });
    slopes.fold(0.0, f64::max)
}

/// The position of a joint estimate after conditioning on `held` integers.
pub(crate) fn fixed_position(joint: &Joint, held: usize, probability: f64) -> FixedPosition {
    let LocalPosition { position, covariance } = LocalPosition::of(joint);
    FixedPosition { position, covariance, held, probability, by_proven: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{
        Band, Constellation, Ecef, GpsTime, LocalFrame, ObservationCode, SatelliteId,
    };
    use crate::positioning::factors::Sight;
    use crate::positioning::rtk::observed::{DifferenceFactor, Group, HeldInteger};

    const SATELLITES: usize = 10;
    const WAVELENGTH_M: f64 = 0.19;
    const SIGMA_M: f64 = 0.01;
    const TRUTH: [f64; 3] = [0.3, -0.2, 0.5];

    /// An epoch at [`TRUTH`] with integers 3k and a common offset of 7 m. The phase of satellite
    /// `faulty` is too long by `by_m`.
    fn epoch(satellites: usize, faulty: usize, by_m: f64) -> (RtkEpoch, Vec<f64>, Arcs) {
        let frame = LocalFrame::at(Ecef(Vector3::new(4.0e6, 1.0e6, 4.85e6)));
        let (mut epoch, mut arcs) = (RtkEpoch::default(), Vec::new());
        let code = ObservationCode::parse("1C").unwrap();
        for k in 0..satellites {
            let (azimuth, elevation) = (2.4 * k as f64, 0.3 + 0.12 * k as f64);
            let level = f64::cos(elevation);
            let line = Vector3::new(level * azimuth.sin(), level * azimuth.cos(), elevation.sin());
            let satellite = Ecef(frame.origin.0 + frame.rotation.transpose() * line * 2.2e7);
            let sight = Sight::new(&frame, satellite);
            let (range_m, _) = sight.range(&Vector3::from(TRUTH));
            let error_m = if k == faulty { by_m } else { 0.0 };
            epoch.sights.push(sight);
            epoch.rows.push(DifferenceFactor {
                sight: k,
                range_m: range_m + 3.0 * k as f64 * WAVELENGTH_M + 7.0 + error_m,
                inverse_sigma: SIGMA_M.recip(),
                independent_share: 0.2,
                ambiguity: Some(EpochAmbiguity { variable: k, wavelength_m: WAVELENGTH_M }),
                bias: None,
            });
            arcs.push(CarrierArc {
                satellite: SatelliteId::new(Constellation::Gps, 1 + k as u8).unwrap(),
                band: Band::L1,
                codes: [code; 2],
                variable: k,
                serial: k as u64,
                frequency_hz: 1_575.42e6,
                last: GpsTime::EPOCH,
                unobserved_s: 0.0,
                epochs: 9,
                half_cycle: false,
                elevation_rad: elevation,
                code_minus_phase_m: None,
                held: Some(HeldInteger { datum: 1, cycles: 3 * k as i64 }),
                found: 1,
                is_proven: true,
            });
        }
        epoch.groups.push(Group { begin: 0, end: satellites, is_carrier: true });
        let border = (0..satellites).map(|k| 3.0 * k as f64).collect();
        (epoch, border, Arcs::of(arcs))
    }

    fn by_phases(satellites: usize, faulty: usize, by_m: f64) -> PhasePosition {
        let (epoch, border, arcs) = epoch(satellites, faulty, by_m);
        let fixed = FixedEpoch { epoch: &epoch, border: &border, arcs: &arcs };
        let scratch = &mut RowScratch::default();
        position_from_fixed_phases(&fixed, &Vector3::zeros(), None, scratch).unwrap()
    }

    fn horizontal_error_m(found: &PhasePosition) -> f64 {
        (found.position - Vector3::from(TRUTH)).xy().norm()
    }

    /// The position has about the phases' σ of 1 cm, for every independent share. Of ten satellites
    /// any one whose phase is wrong by a cycle is rejected.
    #[test]
    fn phases_that_agree_place_the_rover() {
        let right = by_phases(SATELLITES, 0, 0.0);
        assert!((right.position - Vector3::from(TRUTH)).norm() < 1e-4, "{right:?}");
        let sigma_m = right.covariance[(0, 0)].sqrt();
        assert!((0.005..0.02).contains(&sigma_m), "{sigma_m}");
        for faulty in 0..SATELLITES {
            let one = by_phases(SATELLITES, faulty, WAVELENGTH_M);
            assert!(horizontal_error_m(&one) < 0.01, "{faulty}: {one:?}");
        }
    }

    /// Three satellites with a σ of 1 cm leave the position uncertain by metres; with a position
    /// known to 2 cm the fix is as good as that. Phases then keep four fifths of their information.
    /// If four of ten satellites are wrong by a cycle, a known position makes all four rejected.
    #[test]
    fn a_known_position_tells_which_phases_are_wrong() {
        let known = LocalPosition {
            position: Vector3::from(TRUTH),
            covariance: Matrix3::identity() * 4e-4,
        };
        let scratch = &mut RowScratch::default();
        let mut place = |satellites: usize, faulty: usize, known: Option<&LocalPosition>| {
            let (mut epoch, border, arcs) = epoch(satellites, SATELLITES, 0.0);
            for row in &mut epoch.rows[..faulty] {
                row.range_m += WAVELENGTH_M;
            }
            let start = Vector3::zeros();
            let fixed = FixedEpoch { epoch: &epoch, border: &border, arcs: &arcs };
            position_from_fixed_phases(&fixed, &start, known, scratch).unwrap()
        };
        let sigma_m = |found: PhasePosition| found.covariance.symmetric_eigenvalues().max().sqrt();
        assert!(1.0 < sigma_m(place(3, 0, None)));
        assert!((0.015..0.0201).contains(&sigma_m(place(3, 0, Some(&known)))));
        let (alone, with) = (place(SATELLITES, 0, None), place(SATELLITES, 0, Some(&known)));
        let vague = LocalPosition { covariance: Matrix3::identity() * 1e4, ..known };
        let shared = place(SATELLITES, 0, Some(&vague));
        assert!(sigma_m(with) < sigma_m(alone));
        assert!((sigma_m(shared) / sigma_m(alone) - 0.8_f64.sqrt().recip()).abs() < 1e-3);
        let wrong = place(SATELLITES, 4, Some(&known));
        assert!(horizontal_error_m(&wrong) < 0.01, "{wrong:?}");
    }

    /// An error too small to be rejected moves the position by no more than its residuals allow;
    /// the error of the worst satellite moves it by exactly that.
    #[test]
    fn residuals_bound_what_one_satellite_does() {
        let mut worst: f64 = 0.0;
        for faulty in 0..SATELLITES {
            let (epoch, border, arcs) = epoch(SATELLITES, faulty, 1e-3);
            let scratch = &mut RowScratch::default();
            let fixed = FixedEpoch { epoch: &epoch, border: &border, arcs: &arcs };
            let one = position_from_fixed_phases(&fixed, &Vector3::zeros(), None, scratch).unwrap();
            let groups = phases(&fixed, &one.position, false, scratch);
            let quadratic = &Kernel::QUADRATIC;
            let rows: Vec<_> = groups[0].iter().map(|phase| phase.row).collect();
            let offset_m = shared_offset(&rows, quadratic, &mut Vec::new());
            let residual = |row: &SharingRow<3>| row.row.residual + row.by_offset * offset_m;
            let norm = rows.iter().map(|row| residual(row).powi(2)).sum::<f64>().sqrt();
            worst = worst.max(horizontal_error_m(&one) / (norm * one.slope_m));
        }
        assert!((0.95..1.02).contains(&worst), "{worst}");
    }

    /// Wavelengths differ; 300 cycles and 7 m are common to all phases. The cycles are removed, and
    /// the offset and the error of one row stay.
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
                independent_share: 1.0,
            }
        };
        let mut rows: Vec<_> = (0..8).map(row).collect();
        subtract_common_cycles(&mut rows);
        let miss_m = |k: usize| (rows[k].row.residual - rows[0].row.residual) * SIGMA_M;
        assert!((1..8).filter(|&k| k != 3).all(|k| miss_m(k).abs() < 1.5e-3));
        assert!((miss_m(3) - 0.01).abs() < 1e-3, "{}", miss_m(3));
    }

    /// With four satellites the others check none of them; small residuals then prove nothing.
    #[test]
    fn what_nothing_checks_may_hide_anything() {
        let four = by_phases(4, 0, 0.0);
        assert_eq!(four.undetected_shift_m(4.1, 4), f64::INFINITY);
        assert_eq!(four.undetected_shift_m(4.0, 4), 0.0);
        let shift_m = by_phases(SATELLITES, 0, 0.0).undetected_shift_m(16.0, SATELLITES);
        assert!((0.01..0.2).contains(&shift_m), "{shift_m}");
    }
}
