//! Detector that asks all satellites how the antenna moved, and which phases say otherwise.
//!
//! From one epoch to the next, with both satellite positions seen from one place p,
//!
//! Δ(λφ + c·δtˢ − ρ(s, p) − T) = uᵀΔx + cΔδt + drift + slip + noise, u = ∂ρ/∂p.
//!
//! Displacement Δx and clock change are found by least absolute values (Huber & Ronchetti 2009,
//! *Robust Statistics*, 7.7, by reweighting), then by least squares on what agrees; what does not
//! is left out one after the other (Baarda 1968, *A testing procedure for use in geodetic
//! networks*). A phase that was away meanwhile is tested against the sum of the displacements
//! since.

use nalgebra::{Matrix4, Vector4};

use super::causes::SlipCause;
use super::track::{AntennaPosition, Candidate, Odometer, Sample, Track, Verdict};
use crate::gnss::GpsTime;
use crate::models::geometric_range;

/// Standard deviations that a phase may be off.
const FACTOR: f64 = 4.0;
/// A phase is not doubted for less than half of half a cycle.
const TOLERATED_CYCLES: f64 = 0.25;
/// What all signals of a satellite do alike is no slip of each below this (cycles of the shortest).
const COMMON_CYCLES: f64 = 0.75;
/// Fastest turn of a line of sight (rad/s): v/(a − R) of the GLONASS orbit, 3.95 km/s over
/// 19 130 km, less what the Earth turns with it.
const TURN_RAD_S: f64 = 1.8e-4;
/// What satellite clocks and wet air add at random (m/√s). Caesium clocks, of 10⁻¹¹ over a second,
/// make 3 mm; with 2 mm in all, `hers-hert` shows many jumps of 5 to 15 cm within 30 s that both
/// frequencies share.
const WANDER_M_SQRT_S: f64 = 0.004;
/// What a static antenna may move between epochs (m).
const STATIC_SIGMA_M: f64 = 0.005;
/// Satellites that must agree: one more than the unknowns, the clock of a static antenna being one.
const AGREEING_MOVING: usize = 5;
const AGREEING_STATIC: usize = 3;
const REWEIGHTINGS: usize = 15;

/// The equation of one phase.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    candidate: usize,
    /// ∂/∂(Δx, cΔδt), 1×4.
    slope: Vector4<f64>,
    change_m: f64,
    sigma_m: f64,
    wavelength_m: f64,
    is_used: bool,
}

/// Displacement and clock change (m) with the inverse of their normal matrix.
struct Step {
    value: Vector4<f64>,
    cofactor: Matrix4<f64>,
}

/// Tests all phases that go on; returns displacement and clock change since the last epoch, or
/// `None` where too few satellites agree.
pub(super) fn test(
    candidates: &mut [Candidate],
    tracks: &[Track],
    last: Option<GpsTime>,
    antenna: AntennaPosition,
    is_static: bool,
    rows: &mut Vec<Row>,
) -> Option<Vector4<f64>> {
    rows.clear();
    for (index, candidate) in candidates.iter().enumerate() {
        let track = candidate.continued(tracks).filter(|track| Some(track.last.time) == last);
        rows.extend(track.and_then(|track| row(index, candidate, track, antenna)));
    }
    let step = agreement(rows, is_static)?;
    let needed = if is_static { AGREEING_STATIC } else { AGREEING_MOVING };
    let count = |is_used: bool| {
        let of = |row: &&Row| row.is_used == is_used;
        let satellites =
            rows.iter().filter(of).map(|row| candidates[row.candidate].sample.satellite);
        let mut last = None;
        satellites.filter(|satellite| last.replace(*satellite) != Some(*satellite)).count()
    };
    let (agreeing, others) = (count(true), count(false));
    if agreeing < needed || agreeing <= others {
        return None;
    }
    for row in rows.iter() {
        judge(&mut candidates[row.candidate], row, &step);
    }
    Some(step.value)
}

/// The equation of a phase since `track` was last seen; none without both states of the satellite.
fn row(
    index: usize,
    candidate: &Candidate,
    track: &Track,
    antenna: AntennaPosition,
) -> Option<Row> {
    let (after, before) = (&candidate.sample, &track.last);
    let (now, then) = (after.sight?, before.sight?);
    if now.issue != then.issue {
        return None;
    }
    let elapsed_s = after.time - before.time;
    let (range_m, by_position) = geometric_range(now.position, antenna.position);
    let (range_before_m, _) = geometric_range(then.position, antenna.position);
    let reduced = |sample: &Sample, clock_m: f64, range_m: f64| sample.phase_m + clock_m - range_m;
    let change_m = reduced(after, now.clock_m - now.troposphere_m, range_m)
        - reduced(before, then.clock_m - then.troposphere_m, range_before_m);
    let noise_m2 = after.phase_sigma_m().powi(2) + before.phase_sigma_m().powi(2);
    let parallax_m = TURN_RAD_S * antenna.sigma_m * elapsed_s;
    let wander_m2 = WANDER_M_SQRT_S * WANDER_M_SQRT_S * elapsed_s;
    let drift_m2 = track.trend.variance_m2(elapsed_s);
    let variance_m2 = noise_m2 + parallax_m * parallax_m + wander_m2 + drift_m2;
    let smallest_sigma_m = TOLERATED_CYCLES * after.wavelength_m / FACTOR;
    Some(Row {
        candidate: index,
        slope: Vector4::new(by_position.x, by_position.y, by_position.z, 1.0),
        change_m: change_m - track.trend.expected_m(elapsed_s),
        sigma_m: variance_m2.sqrt().max(smallest_sigma_m),
        wavelength_m: after.wavelength_m,
        is_used: true,
    })
}

/// The step on which most agree, rows that do not being marked as not used.
fn agreement(rows: &mut [Row], is_static: bool) -> Option<Step> {
    let mut step = solve(rows, is_static, |row, _| 1.0 / (row.sigma_m * row.sigma_m), None)?;
    for _ in 0..REWEIGHTINGS {
        let weight =
            |row: &Row, residual_m: f64| 1.0 / (row.sigma_m * residual_m.abs().max(row.sigma_m));
        step = solve(rows, is_static, weight, Some(&step))?;
    }
    for row in rows.iter_mut() {
        row.is_used = residual_m(row, &step).abs() <= FACTOR * row.sigma_m;
    }
    let least_squares = |row: &Row, _: f64| match row.is_used {
        true => 1.0 / (row.sigma_m * row.sigma_m),
        false => 0.0,
    };
    for _ in 0..rows.len() {
        step = solve(rows, is_static, least_squares, Some(&step))?;
        let ratio = |row: &Row| tested(row, &step).0;
        let used = rows.iter().enumerate().filter(|(_, row)| row.is_used);
        let worst = used.max_by(|(_, a), (_, b)| ratio(a).total_cmp(&ratio(b)));
        match worst.map(|(index, row)| (index, ratio(row))) {
            Some((index, ratio)) if FACTOR < ratio => rows[index].is_used = false,
            _ => break,
        }
    }
    Some(step)
}

/// Weighted least squares; the displacement of a static antenna is drawn to zero.
fn solve(
    rows: &[Row],
    is_static: bool,
    weight: impl Fn(&Row, f64) -> f64,
    at: Option<&Step>,
) -> Option<Step> {
    let held = if is_static { 1.0 / (STATIC_SIGMA_M * STATIC_SIGMA_M) } else { 0.0 };
    let mut normal = Matrix4::from_diagonal(&Vector4::new(held, held, held, 0.0));
    let mut right = Vector4::zeros();
    for row in rows {
        let weight = weight(row, at.map_or(0.0, |step| residual_m(row, step)));
        normal += row.slope * row.slope.transpose() * weight;
        right += row.slope * (row.change_m * weight);
    }
    let cofactor = normal.cholesky()?.inverse();
    Some(Step { value: cofactor * right, cofactor })
}

/// Model less measurement (m).
fn residual_m(row: &Row, step: &Step) -> f64 {
    row.slope.dot(&step.value) - row.change_m
}

/// Residual over its own standard deviation, and that over the row's: √(1 − h) for a row that
/// took part, √(1 + h) for one that did not, h its leverage.
fn tested(row: &Row, step: &Step) -> (f64, f64) {
    let variance = row.slope.dot(&(step.cofactor * row.slope)) / (row.sigma_m * row.sigma_m);
    let share = if row.is_used { (1.0 - variance).max(0.0) } else { 1.0 + variance };
    let residual_sigma_m = row.sigma_m * share.sqrt();
    // A row that alone determines something has no residual to speak of.
    let ratio = match 1e-6 < share {
        true => residual_m(row, step).abs() / residual_sigma_m,
        false => 0.0,
    };
    (ratio, share.sqrt())
}

/// Says of a phase whether it slipped, if the smallest slip would have shown: one cycle, or half of
/// one where the receiver says that half cycles are open.
fn judge(candidate: &mut Candidate, row: &Row, step: &Step) {
    let (ratio, share) = tested(row, step);
    // A slip moves the residual of a row that took part by 1 − h of itself.
    let smallest_cycles = if candidate.sample.half_cycle { 0.5 } else { 1.0 };
    let shown_m = smallest_cycles * row.wavelength_m * if row.is_used { share } else { 1.0 };
    let needed_m = FACTOR * row.sigma_m * if row.is_used { 1.0 } else { share };
    candidate.miss_m = residual_m(row, step);
    if FACTOR < ratio {
        candidate.verdict = Verdict::Slipped;
        candidate.causes.insert(SlipCause::TimeDifference);
    } else if needed_m < shown_m {
        candidate.verdict = Verdict::Continues;
    }
}

/// Takes back that the signals of a satellite slipped where all of them, on two frequencies or more
/// and agreeing with one another, moved by less than a cycle: it was the satellite's clock or the
/// air. Asked after the signals were compared.
pub(super) fn excuse_common(group: &mut [Candidate]) {
    let is_shared = group.iter().all(|candidate| {
        let limit_m = COMMON_CYCLES * candidate.sample.wavelength_m;
        candidate.verdict == Verdict::Slipped
            && !candidate.sample.half_cycle
            && !candidate.causes.contains(SlipCause::GeometryFree)
            && candidate.miss_m.abs() < limit_m
    });
    let first_hz = group[0].sample.frequency_hz;
    if is_shared && group.iter().any(|candidate| candidate.sample.frequency_hz != first_hz) {
        group.iter_mut().for_each(|candidate| candidate.verdict = Verdict::Shared);
    }
}

/// Tests the phases that were away for some epochs against the sum of the displacements since.
pub(super) fn test_returned(
    candidates: &mut [Candidate],
    tracks: &[Track],
    last: Option<GpsTime>,
    antenna: AntennaPosition,
    odometer: &Odometer,
) {
    for (index, candidate) in candidates.iter_mut().enumerate() {
        let track = candidate.continued(tracks);
        let away = track
            .filter(|track| Some(track.last.time) != last && track.odometer.run == odometer.run);
        let Some(track) = away else { continue };
        let Some(mut row) = row(index, candidate, track, antenna) else { continue };
        row.is_used = false;
        let moved_m = odometer.moved_m - track.odometer.moved_m;
        let clock_m = odometer.clock_m - track.odometer.clock_m;
        let value = Vector4::new(moved_m.x, moved_m.y, moved_m.z, clock_m);
        judge(candidate, &row, &Step { value, cofactor: Matrix4::zeros() });
    }
}

/// What a phase says of its own drift, once the step is known (m), with its variance (m²).
pub(super) fn drift(
    candidate: &Candidate,
    track: &Track,
    antenna: AntennaPosition,
    step: &Vector4<f64>,
) -> Option<(f64, f64)> {
    let row = row(0, candidate, track, antenna)?;
    let elapsed_s = candidate.sample.time - track.last.time;
    let drift_m = row.change_m + track.trend.expected_m(elapsed_s) - row.slope.dot(step);
    let noise_m2 = 2.0 * candidate.sample.phase_sigma_m().powi(2);
    Some((drift_m, noise_m2))
}
