//! Distribution of the errors: cumulative shares of 2D, vertical and 3D errors.

use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::style::{BLUE, GREEN, GRID, INK, MUTED, VERMILION, draw_title, label};
use super::{Judgement, PlotError};
use crate::evaluation::statistics::{ErrorStatistics, percentile, sorted};
use crate::evaluation::{JudgedEpoch, MatchedReport};

/// Margin for the name and the labels of the axis (pixels).
const MARGIN_LEFT: u32 = 24;
const LABELS: u32 = 60;
const LEFT: u32 = MARGIN_LEFT + LABELS;
/// Width of the table beside the curves (pixels).
const RIGHT: u32 = 330;
const TOP: u32 = 34;
const BOTTOM: u32 = 60;
/// Shares listed in the table (%).
const MARKED: [f64; 3] = [50.0, 68.0, 95.0];
/// Number of points of a curve.
const CURVE_POINTS: usize = 400;
/// Smaller errors are drawn at this value (m).
const SMALLEST_M: f64 = 1e-4;
const COLUMN_WIDTH: i32 = 60;
const ROW_HEIGHT: i32 = 22;

/// One of the curves.
struct Curve {
    name: &'static str,
    color: RGBColor,
    value: fn(&JudgedEpoch) -> f64,
    statistics: fn(&MatchedReport) -> &ErrorStatistics,
}

const CURVES: [Curve; 3] = [
    Curve {
        name: "2D",
        color: BLUE,
        value: JudgedEpoch::error_2d_m,
        statistics: |errors| &errors.err2d,
    },
    Curve {
        name: "|up|",
        color: VERMILION,
        value: |epoch| epoch.error.0.z.abs(),
        statistics: |errors| &errors.err_up,
    },
    Curve {
        name: "3D",
        color: GREEN,
        value: JudgedEpoch::error_3d_m,
        statistics: |errors| &errors.err3d,
    },
];

/// Draws the curves over a logarithmic axis (m), and a table of their percentiles.
pub(super) fn draw<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    judgement: &Judgement,
    errors: &MatchedReport,
) -> Result<(), PlotError> {
    let samples = CURVES.map(|curve| {
        let values: Vec<_> = judgement.epochs.iter().map(curve.value).collect();
        sorted(&values)
    });
    let smallest = samples[0].first().copied().unwrap_or(SMALLEST_M).max(SMALLEST_M);
    let low = percentile(&samples[0], 2.0).max(smallest).log10() - 0.1;
    let high = errors.err3d.max.max(10.0 * SMALLEST_M).log10() + 0.05;
    let range = low.min(high - 0.5)..high;
    let mut chart = ChartBuilder::on(area)
        .margin_left(MARGIN_LEFT)
        .margin_top(TOP)
        .margin_right(RIGHT)
        .x_label_area_size(BOTTOM)
        .y_label_area_size(LABELS)
        .build_cartesian_2d(range.clone(), 0.0..100.0)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_labels(0)
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(MUTED)
        .label_style(label(15, &INK))
        .axis_desc_style(label(16, &INK))
        .x_desc("error (m), logarithmic")
        .y_desc("epochs with a smaller error (%)")
        .y_label_formatter(&|share| format!("{share:.0}"))
        .draw()?;
    let plane = Plane::of(area, &range);
    draw_grid(area, &plane, &range)?;
    for (curve, sample) in CURVES.iter().zip(&samples) {
        chart.draw_series(LineSeries::new(
            curve_points(sample, range.start),
            curve.color.stroke_width(2),
        ))?;
        chart.draw_series(MARKED.map(|share| {
            let x = percentile(sample, share).max(SMALLEST_M).log10().max(range.start);
            Circle::new((x, share), 4, curve.color.filled())
        }))?;
    }
    draw_table(area, errors, plane.pixel(range.end, 100.0))?;
    draw_title(area, "Distribution of the errors", LEFT as i32)
}

/// Position of the axes in the panel, for drawing outside the chart.
struct Plane {
    start: f64,
    pixels_per_decade: f64,
    pixels_per_percent: f64,
}

impl Plane {
    fn of<DB: DrawingBackend>(area: &DrawingArea<DB, Shift>, range: &std::ops::Range<f64>) -> Self {
        let (width, height) = area.dim_in_pixel();
        Self {
            start: range.start,
            pixels_per_decade: f64::from(width - LEFT - RIGHT) / (range.end - range.start),
            pixels_per_percent: f64::from(height - TOP - BOTTOM) / 100.0,
        }
    }

    /// The pixel of an error (log10 of metres) and a share (%).
    fn pixel(&self, log_error: f64, share: f64) -> (i32, i32) {
        let across = f64::from(LEFT) + (log_error - self.start) * self.pixels_per_decade;
        let down = f64::from(TOP) + (100.0 - share) * self.pixels_per_percent;
        (across.round() as i32, down.round() as i32)
    }
}

/// Draws lines at round errors and at the marked shares, with labels.
fn draw_grid<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    plane: &Plane,
    range: &std::ops::Range<f64>,
) -> Result<(), PlotError> {
    for metres in ticks(range) {
        let (x, bottom) = plane.pixel(metres.log10(), 0.0);
        area.draw(&PathElement::new([(x, bottom), plane.pixel(metres.log10(), 100.0)], GRID))?;
        let style = label(15, &INK).pos(Pos::new(HPos::Center, VPos::Top));
        area.draw_text(&format!("{metres}"), &style, (x, bottom + 8))?;
    }
    for share in MARKED {
        let ends = [plane.pixel(range.start, share), plane.pixel(range.end, share)];
        area.draw(&DashedPathElement::new(ends, 6, 5, MUTED.stroke_width(1)))?;
        let style = label(14, &MUTED).pos(Pos::new(HPos::Left, VPos::Bottom));
        area.draw_text(&format!("{share} %"), &style, (ends[0].0 + 6, ends[0].1 - 1))?;
    }
    Ok(())
}

/// Points (log10 of error, share) of the cumulative share of a sorted sample.
fn curve_points(sample: &[f64], lowest: f64) -> Vec<(f64, f64)> {
    let step = 100.0 / CURVE_POINTS as f64;
    let shares = (0..=CURVE_POINTS).map(|index| index as f64 * step);
    let point = |share: f64| (percentile(sample, share).max(SMALLEST_M).log10(), share);
    shares.map(point).filter(|(x, _)| lowest <= *x).collect()
}

/// 1, 2 and 5 times the powers of ten in a range of log10; only the powers in a wide range.
fn ticks(range: &std::ops::Range<f64>) -> Vec<f64> {
    let steps: &[f64] = if range.end - range.start < 3.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let decades = range.start.floor() as i32..=range.end.ceil() as i32;
    let all = decades.flat_map(|decade| steps.iter().map(move |step| rounded(*step, decade)));
    all.filter(|metres| range.contains(&metres.log10())).collect()
}

/// step·10^decade as the float nearest to its decimal text.
fn rounded(step: f64, decade: i32) -> f64 {
    format!("{step}e{decade}").parse().expect("the text is a float")
}

/// Draws the table of percentiles, right of and below `corner` (pixels).
fn draw_table<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    errors: &MatchedReport,
    corner: (i32, i32),
) -> Result<(), PlotError> {
    let (left, top) = (corner.0 + 22, corner.1 + 30);
    let right = left + COLUMN_WIDTH * 5 - 16;
    let cell = |text: &str, column: i32, row: i32, color: &RGBColor| {
        let style = label(15, color).pos(Pos::new(HPos::Right, VPos::Top));
        let at = (right - COLUMN_WIDTH * (4 - column), top + ROW_HEIGHT * row);
        area.draw_text(text, &style, at)
    };
    for (column, title) in (1..).zip(["50 %", "68 %", "95 %", "max (m)"]) {
        cell(title, column, 0, &MUTED)?;
    }
    for (row, curve) in (1..).zip(&CURVES) {
        let s = (curve.statistics)(errors);
        let middle = top + ROW_HEIGHT * row + 8;
        area.draw(&PathElement::new(
            [(left, middle), (left + 18, middle)],
            curve.color.stroke_width(3),
        ))?;
        cell(curve.name, 0, row, &INK)?;
        for (column, value) in (1..).zip([s.p50, s.p68, s.p95, s.max]) {
            cell(&metres(value), column, row, &INK)?;
        }
    }
    Ok(())
}

/// A length with three significant digits, or in whole millimetres.
fn metres(value: f64) -> String {
    match value {
        v if v < 10.0 => format!("{v:.3}"),
        v if v < 100.0 => format!("{v:.2}"),
        v => format!("{v:.1}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(&(-1.1..0.8)), [0.1, 0.2, 0.5, 1.0, 2.0, 5.0]);
        assert_eq!(ticks(&(-3.0..1.5)), [0.001, 0.01, 0.1, 1.0, 10.0]);
    }

    #[test]
    fn a_curve_rises_to_all() {
        let points = curve_points(&[0.1, 1.0, 10.0], -2.0);
        assert_eq!(points[0], (-1.0, 0.0));
        assert_eq!(points[points.len() - 1], (1.0, 100.0));
        assert!(points.is_sorted_by(|a, b| a.0 <= b.0));
    }
}
