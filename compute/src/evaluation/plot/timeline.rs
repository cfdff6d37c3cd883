//! Error over time: east, north, up and 2D, in panels on one time axis.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::style::{BAND, GRID, INK, MUTED, QualityStyle, Thinning, draw_title, label};
use super::{Judgement, PlotError};
use crate::evaluation::JudgedEpoch;

/// Margin for the name and the labels of the axis (pixels).
const MARGIN_LEFT: u32 = 24;
const LABELS: u32 = 60;
const LEFT: u32 = MARGIN_LEFT + LABELS;
const RIGHT: u32 = 28;
const TOP: u32 = 34;
const BOTTOM: u32 = 30;
const BOTTOM_OF_LAST: u32 = 54;
/// Two-sided 95 % of a normal distribution, in standard deviations.
const NORMAL_95: f64 = 1.959_964;
/// Largest number of segments in the band of stated errors.
const BAND_PIECES: usize = 400;
/// A longer gap interrupts the band (s).
const BAND_GAP_S: f64 = 60.0;
/// Smallest range of the axis (m).
const SMALLEST_SPAN_M: f64 = 0.02;

/// One of the panels.
struct Panel {
    title: &'static str,
    axis: &'static str,
    value: fn(&JudgedEpoch) -> f64,
    sigma: Option<fn(&JudgedEpoch) -> Option<f64>>,
}

const PANELS: [Panel; 4] = [
    Panel {
        title: "East error (grey: stated 95 %)",
        axis: "east (m)",
        value: |epoch| epoch.error.0.x,
        sigma: Some(|epoch| epoch.stated_sigma_m.map(|sigma| sigma.x)),
    },
    Panel {
        title: "North error",
        axis: "north (m)",
        value: |epoch| epoch.error.0.y,
        sigma: Some(|epoch| epoch.stated_sigma_m.map(|sigma| sigma.y)),
    },
    Panel {
        title: "Up error",
        axis: "up (m)",
        value: |epoch| epoch.error.0.z,
        sigma: Some(|epoch| epoch.stated_sigma_m.map(|sigma| sigma.z)),
    },
    Panel { title: "2D error", axis: "2D (m)", value: JudgedEpoch::error_2d_m, sigma: None },
];

/// Draws the four panels.
pub(super) fn draw<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    judgement: &Judgement,
) -> Result<(), PlotError> {
    for (index, (panel, area)) in PANELS.iter().zip(area.split_evenly((4, 1))).enumerate() {
        draw_panel(&area, panel, &judgement.epochs, index + 1 == PANELS.len())?;
    }
    Ok(())
}

fn draw_panel<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    panel: &Panel,
    epochs: &[JudgedEpoch],
    is_last: bool,
) -> Result<(), PlotError> {
    let (first, last) = (epochs.first(), epochs.last());
    let (first, last) = first.zip(last).ok_or(PlotError::Empty)?;
    let start_s = first.time.seconds_of_week();
    let at = |epoch: &JudgedEpoch| start_s + (epoch.time - first.time);
    let end_s = start_s + (last.time - first.time).max(1.0);
    let y = value_range(epochs.iter().map(panel.value));
    let (width, height) = area.dim_in_pixel();
    let bottom = if is_last { BOTTOM_OF_LAST } else { BOTTOM };
    let pixels = (width - LEFT - RIGHT, height - TOP - bottom);
    let mut thinning = Thinning::new((end_s - start_s, y.end - y.start), pixels);
    let mut chart = ChartBuilder::on(area)
        .margin_left(MARGIN_LEFT)
        .margin_top(TOP)
        .margin_right(RIGHT)
        .x_label_area_size(bottom)
        .y_label_area_size(LABELS)
        .build_cartesian_2d(start_s..end_s, y.clone())?;
    if let Some(sigma) = panel.sigma {
        for band in band_segments(epochs, |epoch| Some((at(epoch), sigma(epoch)?))) {
            let polygon = band_polygon(&band, &y);
            chart.draw_series([Polygon::new(polygon, BAND.filled())])?;
        }
    }
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(MUTED)
        .label_style(label(15, &INK))
        .axis_desc_style(label(16, &INK))
        .y_labels(6)
        .y_desc(panel.axis)
        .x_label_formatter(&|seconds| format!("{seconds:.0}"));
    if is_last {
        mesh.x_desc("GPS seconds of week (s)");
    }
    mesh.draw()?;
    chart.draw_series(LineSeries::new([(start_s, 0.0), (end_s, 0.0)], MUTED.stroke_width(1)))?;
    let points: Vec<_> = epochs
        .iter()
        .map(|epoch| ((at(epoch), (panel.value)(epoch)), epoch.quality))
        .filter(|(point, quality)| thinning.is_new(*point, *quality))
        .collect();
    chart.draw_series(points.iter().map(|(point, quality)| {
        Circle::new(*point, 2, QualityStyle::of(*quality).color.filled())
    }))?;
    draw_title(area, panel.title, LEFT as i32)
}

/// The range of the values and zero, with a margin.
fn value_range(values: impl Iterator<Item = f64>) -> std::ops::Range<f64> {
    let (low, high) = values.fold((0.0_f64, 0.0_f64), |(l, h), v| (l.min(v), h.max(v)));
    let margin = (0.06 * (high - low)).max(SMALLEST_SPAN_M / 2.0);
    low - margin..high + margin
}

/// Time (s) and standard deviation (m) of segments without gaps, thinned to the largest deviation
/// in each bucket.
fn band_segments(
    epochs: &[JudgedEpoch],
    point: impl Fn(&JudgedEpoch) -> Option<(f64, f64)>,
) -> Vec<Vec<(f64, f64)>> {
    let points: Vec<_> = epochs.iter().filter_map(point).collect();
    let bucket = points.len().div_ceil(BAND_PIECES).max(1);
    let segments = points.chunk_by(|a, b| b.0 - a.0 <= BAND_GAP_S);
    let thinned = segments.map(|segment| {
        let largest = |chunk: &[(f64, f64)]| {
            let sigma = chunk.iter().fold(0.0_f64, |largest, (_, sigma)| largest.max(*sigma));
            [(chunk[0].0, sigma), (chunk[chunk.len() - 1].0, sigma)]
        };
        segment.chunks(bucket).flat_map(largest).collect()
    });
    thinned.collect()
}

/// Outline of ±1.96 σ, cut at the panel's limits.
fn band_polygon(band: &[(f64, f64)], y: &std::ops::Range<f64>) -> Vec<(f64, f64)> {
    let upper = band.iter().map(|(t, sigma)| (*t, (NORMAL_95 * sigma).min(y.end)));
    let lower = band.iter().rev().map(|(t, sigma)| (*t, (-NORMAL_95 * sigma).max(y.start)));
    upper.chain(lower).collect()
}
