//! The track from above, with equal scales.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::style::{GRID, INK, MUTED, QualityStyle, REFERENCE, Thinning, draw_title, label};
use super::{Judgement, PlotError};
use crate::gnss::{Ecef, LocalFrame};

/// Margin for the name and the labels of the axis (pixels).
const MARGIN_LEFT: u32 = 24;
const LABELS: u32 = 60;
const LEFT: u32 = MARGIN_LEFT + LABELS;
const BOTTOM: u32 = 54;
const TOP: u32 = 34;
const RIGHT: u32 = 24;
/// A longer gap of the reference interrupts the line (s).
const REFERENCE_GAP_S: f64 = 10.0;
/// Smallest range of the axes (m).
const SMALLEST_SPAN_M: f64 = 0.02;

/// Draws reference and solutions, east and north of the reference's first point (m).
pub(super) fn draw<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    judgement: &Judgement,
) -> Result<(), PlotError> {
    let origin = judgement.epochs.first().ok_or(PlotError::Empty)?.reference;
    let frame = LocalFrame::at(origin);
    let flat = |position: Ecef| {
        let enu = frame.to_enu(position).0;
        (enu.x, enu.y)
    };
    let solutions: Vec<_> = judgement
        .epochs
        .iter()
        .map(|epoch| {
            let solved = LocalFrame::at(epoch.reference).to_ecef(epoch.error);
            (flat(solved), epoch.quality)
        })
        .collect();
    let is_static = judgement.reference.len() == 1;
    let reference: Vec<_> = match is_static {
        true => vec![(judgement.reference[0].time, (0.0, 0.0))],
        false => judgement.reference.iter().map(|row| (row.time, flat(row.position))).collect(),
    };
    let points = solutions.iter().map(|(point, _)| *point);
    let (width, height) = area.dim_in_pixel();
    let pixels = (width - LEFT - RIGHT, height - TOP - BOTTOM);
    let (x, y) = equal_ranges(points.chain(reference.iter().map(|(_, point)| *point)), pixels);
    let mut thinning = Thinning::new((x.end - x.start, y.end - y.start), pixels);
    let mut chart = ChartBuilder::on(area)
        .margin_left(MARGIN_LEFT)
        .margin_top(TOP)
        .margin_right(RIGHT)
        .x_label_area_size(BOTTOM)
        .y_label_area_size(LABELS)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(MUTED)
        .label_style(label(15, &INK))
        .axis_desc_style(label(16, &INK))
        .x_desc("east (m)")
        .y_desc("north (m)")
        .draw()?;
    for segment in reference.chunk_by(|a, b| b.0 - a.0 <= REFERENCE_GAP_S) {
        let line = segment.iter().map(|(_, point)| *point);
        chart.draw_series(LineSeries::new(line, REFERENCE.stroke_width(2)))?;
    }
    let shown: Vec<_> = solutions
        .into_iter()
        .filter(|(point, quality)| thinning.is_new(*point, *quality))
        .collect();
    chart.draw_series(shown.iter().map(|(point, quality)| {
        Circle::new(*point, 3, QualityStyle::of(*quality).color.mix(0.75).filled())
    }))?;
    if is_static {
        chart.draw_series([Cross::new((0.0, 0.0), 9, REFERENCE.stroke_width(3))])?;
    }
    let what = if is_static { "cross: truth" } else { "grey line: truth" };
    draw_title(area, &format!("Track from above ({what})"), LEFT as i32)
}

/// Ranges of x and y around the points, with equal scales.
pub(super) fn equal_ranges(
    points: impl Iterator<Item = (f64, f64)>,
    pixels: (u32, u32),
) -> (std::ops::Range<f64>, std::ops::Range<f64>) {
    let (mut low, mut high) = ((0.0_f64, 0.0_f64), (0.0_f64, 0.0_f64));
    for (x, y) in points {
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    }
    let (wide, tall) = (f64::from(pixels.0), f64::from(pixels.1));
    let span = |low: f64, high: f64| (1.08 * (high - low)).max(SMALLEST_SPAN_M);
    let per_pixel = (span(low.0, high.0) / wide).max(span(low.1, high.1) / tall);
    let range = |low: f64, high: f64, pixels: f64| {
        let (middle, half) = ((low + high) / 2.0, per_pixel * pixels / 2.0);
        middle - half..middle + half
    };
    (range(low.0, high.0, wide), range(low.1, high.1, tall))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metre_is_as_long_on_both_axes() {
        let points = [(0.0, 0.0), (100.0, 10.0)];
        let (x, y) = equal_ranges(points.into_iter(), (400, 200));
        assert!(((x.end - x.start) / 400.0 - (y.end - y.start) / 200.0).abs() < 1e-12);
        assert!(x.start < 0.0 && 100.0 < x.end && y.start < 0.0 && 10.0 < y.end);
    }
}
