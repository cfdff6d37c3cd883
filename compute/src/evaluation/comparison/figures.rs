//! The figures of a report.

use super::Comparison;
use crate::evaluation::JudgedEpoch;
use crate::evaluation::plot::PlotError;
use crate::evaluation::plot::series::{Axes, Scale, Series, Stretch, lines, plane, strips};
use crate::formats::pos::quality;
use crate::gnss::{Ecef, GpsTime, LocalFrame, Solution};

/// A longer pause interrupts a line (s).
const GAP_S: f64 = 60.0;
/// Consecutive positions further apart are not connected (m).
const GAP_M: f64 = 200.0;
/// Ratio of the methods' errors above which the axis is logarithmic.
const LARGE_RATIO: f64 = 30.0;
/// Smaller errors are drawn at this value (m).
const SMALLEST_M: f64 = 1e-4;
/// Larger ratios are drawn at this value.
const RATIO_MAX: f64 = 1e3;
const TIME_AXIS: &str = "GPS seconds of week (s)";

/// The positions of each method over the true track; figures 5 and 6 of the paper.
pub(super) fn tracks(comparison: &Comparison) -> Result<String, PlotError> {
    let reference = comparison.judgements.first().map_or(&[][..], |j| &j.reference);
    let first = comparison.methods.iter().flat_map(|m| m.with_position()).next();
    let first = first.and_then(|solution| solution.estimate.as_ref()).map(|e| e.position);
    let origin = reference.first().map(|row| row.position).or(first).ok_or(PlotError::Empty)?;
    let frame = LocalFrame::at(origin);
    let flat = |position: Ecef| {
        let enu = frame.to_enu(position).0;
        (enu.x, enu.y)
    };
    let of_method = |solutions: &[Solution]| Series {
        points: solutions
            .iter()
            .filter_map(|solution| solution.estimate.as_ref())
            .map(|estimate| flat(estimate.position))
            .collect(),
    };
    let series: Vec<_> = comparison.methods.iter().map(|m| of_method(&m.solutions)).collect();
    let reference: Vec<_> = reference.iter().map(|row| flat(row.position)).collect();
    plane(&reference, &series, GAP_M)
}

/// Horizontal error of each method over time; without truth its distance to the last method.
pub(super) fn errors(comparison: &Comparison) -> Result<String, PlotError> {
    let (y, series) = match comparison.judgements.is_empty() {
        false => ("2D error (m)", errors_of_truth(comparison)),
        true => ("distance to the last method (m)", distances(comparison)),
    };
    let typical: Vec<f64> = series.iter().filter_map(typical_m).collect();
    let smallest = typical.iter().copied().fold(f64::INFINITY, f64::min);
    let largest = typical.iter().copied().fold(0.0, f64::max);
    let scale = match LARGE_RATIO * smallest.max(SMALLEST_M) < largest {
        true => Scale::Logarithmic,
        false => Scale::FromZero,
    };
    lines(&Axes { x: TIME_AXIS, y, scale, gap: GAP_S, span: None }, &series)
}

fn errors_of_truth(comparison: &Comparison) -> Vec<Series> {
    let start = start_of(comparison);
    let point = |epoch: &JudgedEpoch| (at(epoch.time, start), epoch.error_2d_m().max(SMALLEST_M));
    let of_judgement =
        |epochs: &[JudgedEpoch]| Series { points: epochs.iter().map(point).collect() };
    comparison.judgements.iter().map(|judgement| of_judgement(&judgement.epochs)).collect()
}

fn distances(comparison: &Comparison) -> Vec<Series> {
    let start = start_of(comparison);
    let Some((last, others)) = comparison.methods.split_last() else { return Vec::new() };
    let position = |solution: &Solution| solution.estimate.as_ref().map(|e| e.position);
    let of_method = |solutions: &[Solution]| {
        let mut points = Vec::new();
        let mut partners = last.solutions.iter().peekable();
        for solution in solutions {
            while partners.next_if(|partner| partner.time < solution.time).is_some() {}
            let partner = partners.peek().filter(|partner| partner.time == solution.time);
            if let Some((a, b)) = position(solution).zip(partner.and_then(|p| position(p))) {
                let distance_m = LocalFrame::at(a).to_enu(b).0.xy().norm();
                points.push((at(solution.time, start), distance_m.max(SMALLEST_M)));
            }
        }
        Series { points }
    };
    others.iter().map(|method| of_method(&method.solutions)).collect()
}

/// The median of a series.
fn typical_m(series: &Series) -> Option<f64> {
    let mut values: Vec<f64> = series.points.iter().map(|point| point.1).collect();
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Number of satellites used by each method over time.
pub(super) fn satellites(comparison: &Comparison) -> Result<String, PlotError> {
    let value = |solution: &Solution| {
        let estimate = solution.estimate.as_ref();
        Some(estimate.map_or(0.0, |estimate| estimate.satellites_used.len() as f64))
    };
    over_time(comparison, "satellites used", Scale::FromZero, value)
}

/// Ratio of the integers over time.
pub(super) fn ratios(comparison: &Comparison) -> Result<String, PlotError> {
    let value = |solution: &Solution| {
        let relative = solution.estimate.as_ref()?.relative.as_ref()?;
        relative.ratio.map(|ratio| ratio.min(RATIO_MAX))
    };
    over_time(comparison, "ratio of the integers", Scale::Logarithmic, value)
}

fn over_time(
    comparison: &Comparison,
    y: &str,
    scale: Scale,
    value: impl Fn(&Solution) -> Option<f64>,
) -> Result<String, PlotError> {
    let start = start_of(comparison);
    let of_method = |solutions: &[Solution]| Series {
        points: solutions
            .iter()
            .filter_map(|solution| Some((at(solution.time, start), value(solution)?)))
            .collect(),
    };
    let series: Vec<_> = comparison.methods.iter().map(|m| of_method(&m.solutions)).collect();
    lines(&Axes { x: TIME_AXIS, y, scale, gap: GAP_S, span: None }, &series)
}

/// Status of each method over time, as a coloured strip.
pub(super) fn statuses(comparison: &Comparison) -> Result<String, PlotError> {
    let start = start_of(comparison);
    let segments = |solutions: &[Solution]| {
        let mut segments: Vec<Stretch> = Vec::new();
        for pair in solutions.windows(2) {
            let [from, to] = [&pair[0], &pair[1]].map(|solution| at(solution.time, start));
            let Some(quality) = quality(pair[0].status) else { continue };
            let quality = i64::from(quality);
            match segments.last_mut() {
                Some(last) if last.2 == quality && last.1 == from => last.1 = to,
                _ if to - from <= GAP_S => segments.push((from, to, quality)),
                _ => {}
            }
        }
        segments
    };
    let rows: Vec<_> =
        comparison.methods.iter().map(|m| (m.name(), segments(&m.solutions))).collect();
    strips(&rows)
}

fn start_of(comparison: &Comparison) -> GpsTime {
    let first = comparison.methods.iter().filter_map(|m| m.solutions.first()).map(|s| s.time).min();
    first.unwrap_or(GpsTime::EPOCH)
}

/// Seconds of week of `start`, continuing after the end of the week.
fn at(time: GpsTime, start: GpsTime) -> f64 {
    start.seconds_of_week() + (time - start)
}
