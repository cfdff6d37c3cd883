//! Statistics over all judged epochs.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::Serialize;

use super::epoch::JudgedEpoch;
use super::statistics::{ErrorStatistics, percentile, root_mean_square, sorted};
use crate::gnss::GpsTime;

/// RTKLIB's quality number of a fixed solution.
const FIXED: i64 = 1;
/// Limits (m) whose shares are reported, and their names in JSON.
const LIMITS: [(&str, f64); 5] = [("0.1", 0.1), ("0.5", 0.5), ("1", 1.0), ("3", 3.0), ("10", 10.0)];
/// 95 % quantile of χ² with two degrees of freedom, −2 ln 0.05.
const CHI_SQUARE_2_95: f64 = 5.991_464_547_107_98;
/// 95 % quantile of χ² with three degrees of freedom; Abramowitz & Stegun (1964), table 26.8.
const CHI_SQUARE_3_95: f64 = 7.814_73;
/// 3D error above which a wrong fix is counted separately (m).
const GROSSLY_WRONG_M: f64 = 0.5;

/// Statistics of a judgement; the keys of its JSON form are the field names.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Number of epochs that should have a solution.
    pub expected: usize,
    /// Number of judged solutions.
    pub matched: usize,
    /// Number of solutions in the window without reference.
    pub unmatched_solutions: usize,
    /// Judged over expected; `None` if nothing is expected.
    pub availability: Option<f64>,
    /// Statistics that need judged solutions.
    #[serde(flatten)]
    pub errors: Option<MatchedReport>,
}

/// Statistics of at least one judged solution.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MatchedReport {
    /// Seconds of week of the first judged solution (s).
    pub first_tow: f64,
    /// Seconds of week of the last judged solution (s).
    pub last_tow: f64,
    /// Mean error, east, north, up (m).
    pub bias_enu_mean: [f64; 3],
    /// Median error, east, north, up (m).
    pub bias_enu_median: [f64; 3],
    /// Horizontal error (m).
    pub err2d: ErrorStatistics,
    /// Absolute vertical error (m).
    pub err_up: ErrorStatistics,
    /// Three-dimensional error (m).
    pub err3d: ErrorStatistics,
    /// Number of solutions by quality number.
    pub q_counts: BTreeMap<i64, usize>,
    /// Statistics of the fixes.
    pub fix: FixReport,
    /// Shares within limits, 2D and 3D, by limit (m).
    pub within: BTreeMap<&'static str, [f64; 2]>,
    /// Errors relative to the stated covariances; `None` if no row has one.
    pub uncertainty: Option<Uncertainty>,
}

/// Number and correctness of fixed solutions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FixReport {
    /// Number of fixed solutions.
    pub n: usize,
    /// Fixed over judged solutions.
    pub rate_of_solutions: f64,
    /// Fixed solutions over expected epochs.
    pub rate_of_expected: Option<f64>,
    /// Statistics that need fixes.
    #[serde(flatten)]
    pub errors: Option<FixedErrors>,
}

/// Statistics of at least one fix.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FixedErrors {
    /// Share within the limit, 3D.
    pub correct_3d: f64,
    /// Share within the limit, 2D.
    pub correct_2d: f64,
    /// Share beyond the limit, 3D.
    pub wrong_3d_gt_tol: f64,
    /// Share with a 3D error above 0.5 m.
    pub wrong_3d_gt_0p5: f64,
    /// Fixes correct in 3D over expected epochs.
    pub correct_fix_of_expected: Option<f64>,
    /// Time from the first judged solution to the first fix (s).
    pub ttff_s: f64,
    /// Horizontal error of the fixes (m).
    pub err2d: ErrorStatistics,
    /// Three-dimensional error of the fixes (m).
    pub err3d: ErrorStatistics,
}

/// Consistency of the stated covariances with the errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Uncertainty {
    /// Number of judged solutions with a covariance.
    pub n: usize,
    /// Share inside the stated 95 % ellipse (2D); 0.95 if consistent.
    pub inside_95_2d: f64,
    /// Share inside the stated 95 % ellipsoid (3D); 0.95 if consistent.
    pub inside_95_3d: f64,
    /// √ of the mean of eᵀC⁻¹e/2; 1 if consistent, above it the covariance is too small.
    pub normalised_rms_2d: f64,
    /// √ of the mean of eᵀC⁻¹e/3; 1 if consistent.
    pub normalised_rms_3d: f64,
}

/// Statistics of `epochs`, in order of time; `None` without epochs.
pub(super) fn matched_report(
    epochs: &[JudgedEpoch],
    expected: usize,
    fix_tolerance_m: f64,
) -> Option<MatchedReport> {
    let (first, last) = (epochs.first()?, epochs.last()?);
    let errors = |of: fn(&JudgedEpoch) -> f64| epochs.iter().map(of).collect::<Vec<_>>();
    let (horizontal, spatial) = (errors(JudgedEpoch::error_2d_m), errors(JudgedEpoch::error_3d_m));
    let axes = [errors(|e| e.error.0.x), errors(|e| e.error.0.y), errors(|e| e.error.0.z)];
    let sum: Vector3<f64> = epochs.iter().map(|epoch| epoch.error.0).sum();
    let mut q_counts = BTreeMap::new();
    for epoch in epochs {
        *q_counts.entry(epoch.quality).or_default() += 1;
    }
    let within = |limit: f64| {
        [&horizontal, &spatial].map(|errors| share_where(errors, |error| error < limit))
    };
    Some(MatchedReport {
        first_tow: first.time.seconds_of_week(),
        last_tow: last.time.seconds_of_week(),
        bias_enu_mean: (sum / epochs.len() as f64).into(),
        bias_enu_median: axes.map(|axis| percentile(&sorted(&axis), 50.0)),
        err2d: ErrorStatistics::of(&horizontal)?,
        err_up: ErrorStatistics::of(&errors(|epoch| epoch.error.0.z.abs()))?,
        err3d: ErrorStatistics::of(&spatial)?,
        q_counts,
        fix: fix_report(epochs, expected, fix_tolerance_m),
        within: LIMITS.into_iter().map(|(name, limit)| (name, within(limit))).collect(),
        uncertainty: uncertainty(epochs),
    })
}

fn fix_report(epochs: &[JudgedEpoch], expected: usize, tolerance_m: f64) -> FixReport {
    let fixed: Vec<_> = epochs.iter().filter(|epoch| epoch.quality == FIXED).collect();
    FixReport {
        n: fixed.len(),
        rate_of_solutions: fixed.len() as f64 / epochs.len() as f64,
        rate_of_expected: share(fixed.len(), expected),
        errors: fixed_errors(&fixed, epochs[0].time, expected, tolerance_m),
    }
}

fn fixed_errors(
    fixed: &[&JudgedEpoch],
    start: GpsTime,
    expected: usize,
    tolerance_m: f64,
) -> Option<FixedErrors> {
    let spatial: Vec<_> = fixed.iter().map(|epoch| epoch.error_3d_m()).collect();
    let horizontal: Vec<_> = fixed.iter().map(|epoch| epoch.error_2d_m()).collect();
    let correct = spatial.iter().filter(|error| **error < tolerance_m).count();
    Some(FixedErrors {
        err2d: ErrorStatistics::of(&horizontal)?,
        err3d: ErrorStatistics::of(&spatial)?,
        correct_3d: share_where(&spatial, |error| error < tolerance_m),
        correct_2d: share_where(&horizontal, |error| error < tolerance_m),
        wrong_3d_gt_tol: share_where(&spatial, |error| tolerance_m <= error),
        wrong_3d_gt_0p5: share_where(&spatial, |error| GROSSLY_WRONG_M < error),
        correct_fix_of_expected: share(correct, expected),
        ttff_s: fixed.first()?.time - start,
    })
}

fn uncertainty(epochs: &[JudgedEpoch]) -> Option<Uncertainty> {
    let squares: Vec<_> = epochs.iter().filter_map(|epoch| epoch.normalised_squares).collect();
    let (plane, space): (Vec<f64>, Vec<f64>) = squares.iter().copied().unzip();
    let rms = |squares: &[f64], freedom: f64| {
        let roots: Vec<_> = squares.iter().map(|square| (square / freedom).sqrt()).collect();
        root_mean_square(&roots)
    };
    (!squares.is_empty()).then(|| Uncertainty {
        n: squares.len(),
        inside_95_2d: share_where(&plane, |square| square <= CHI_SQUARE_2_95),
        inside_95_3d: share_where(&space, |square| square <= CHI_SQUARE_3_95),
        normalised_rms_2d: rms(&plane, 2.0),
        normalised_rms_3d: rms(&space, 3.0),
    })
}

/// `part` over `whole`; `None` if `whole` is zero.
pub(super) fn share(part: usize, whole: usize) -> Option<f64> {
    (whole != 0).then(|| part as f64 / whole as f64)
}

fn share_where(values: &[f64], holds: impl Fn(f64) -> bool) -> f64 {
    values.iter().filter(|value| holds(**value)).count() as f64 / values.len() as f64
}
