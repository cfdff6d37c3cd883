//! Figures of several series: lines over time, lines in a plane, strips of states.

use plotters::coord::ranged1d::ValueFormatter;
use plotters::prelude::*;

use super::PlotError;
use super::style::{
    BLUE, GREEN, GRID, INK, MUTED, ORANGE, PURPLE, QualityStyle, REFERENCE, SKY, Thinning,
    VERMILION, label, register_fonts,
};
use super::track::equal_ranges;

/// Width and height of a line figure (pixels).
const LINES: (u32, u32) = (1120, 360);
/// Width and height of a figure in a plane (pixels).
const PLANE: (u32, u32) = (1120, 760);
/// Height of one strip, and of the margins of all strips (pixels).
const STRIP: (u32, u32) = (34, 62);
const MARGIN: u32 = 12;
const LABELS_LEFT: u32 = 64;
const LABELS_BELOW: u32 = 48;
/// Width of the names of strips (pixels).
const NAMES: i32 = 170;
/// Colours of series, in order; distinguishable with every kind of colour vision.
const COLORS: [RGBColor; 7] = [VERMILION, GREEN, BLUE, ORANGE, PURPLE, SKY, REFERENCE];

/// Points to be connected, except where neighbours are too far apart in x.
#[derive(Clone, Debug)]
pub(crate) struct Series {
    /// The points, in the order in which they are connected.
    pub points: Vec<(f64, f64)>,
}

/// Labels and scale of the axes of a line figure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axes<'a> {
    /// Label of the x axis.
    pub x: &'a str,
    /// Label of the y axis.
    pub y: &'a str,
    /// Whether y is logarithmic.
    pub is_logarithmic: bool,
    /// Neighbours further apart in x are not connected.
    pub gap: f64,
}

/// The CSS colour of series number `index`.
pub(crate) fn css_color(index: usize) -> String {
    let RGBColor(red, green, blue) = COLORS[index % COLORS.len()];
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// The CSS colour and the name of one of RTKLIB's quality numbers.
pub(crate) fn css_quality(quality: i64) -> (String, &'static str) {
    let QualityStyle { name, color: RGBColor(red, green, blue) } = QualityStyle::of(quality);
    (format!("#{red:02x}{green:02x}{blue:02x}"), name)
}

/// Lines over a common x axis, as an SVG document.
///
/// # Errors
/// No points, or the drawing fails.
pub(crate) fn lines(axes: &Axes<'_>, series: &[Series]) -> Result<String, PlotError> {
    register_fonts();
    let points = || series.iter().flat_map(|series| series.points.iter().copied());
    let (low_x, high_x) = span(points().map(|point| point.0)).ok_or(PlotError::Empty)?;
    let is_drawn = |y: &f64| !axes.is_logarithmic || 0.0 < *y;
    let (low_y, high_y) =
        span(points().map(|point| point.1).filter(is_drawn)).ok_or(PlotError::Empty)?;
    let x = low_x..high_x.max(low_x + 1.0);
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, LINES).into_drawing_area();
    let mut builder = ChartBuilder::on(&area);
    builder.margin(MARGIN).x_label_area_size(LABELS_BELOW).y_label_area_size(LABELS_LEFT);
    if axes.is_logarithmic {
        let y = (low_y * 0.8..high_y * 1.25).log_scale();
        draw_lines(builder.build_cartesian_2d(x, y)?, axes, series)?;
    } else {
        let margin = (0.05 * (high_y - low_y)).max(1e-3);
        let y = low_y.min(0.0)..high_y + margin;
        draw_lines(builder.build_cartesian_2d(x, y)?, axes, series)?;
    }
    area.present()?;
    drop(area);
    Ok(text)
}

type Chart<'a, 'b, Y> =
    ChartContext<'a, SVGBackend<'b>, Cartesian2d<plotters::coord::types::RangedCoordf64, Y>>;

fn draw_lines<Y>(
    mut chart: Chart<'_, '_, Y>,
    axes: &Axes<'_>,
    series: &[Series],
) -> Result<(), PlotError>
where
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(MUTED)
        .label_style(label(14, &INK))
        .axis_desc_style(label(15, &INK))
        .x_desc(axes.x)
        .y_desc(axes.y)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_label_formatter(&|y| short(*y))
        .draw()?;
    let range = chart.x_range();
    for (index, series) in series.iter().enumerate() {
        let color = COLORS[index % COLORS.len()];
        let mut thinning = Thinning::new((range.end - range.start, 1e-9), (4 * LINES.0, 0));
        let points = series.points.iter().filter(|point| !axes.is_logarithmic || 0.0 < point.1);
        let points: Vec<_> =
            points.copied().filter(|point| thinning.is_new((point.0, 0.0), 0)).collect();
        for segment in points.chunk_by(|a, b| b.0 - a.0 <= axes.gap) {
            if let [single] = segment {
                chart.draw_series([Circle::new(*single, 1, color.filled())])?;
            }
            chart.draw_series(LineSeries::new(segment.iter().copied(), color.stroke_width(1)))?;
        }
    }
    Ok(())
}

/// Lines in a plane with equal scales, and the true line in black below them, as an SVG document.
/// Points are in order of time; those more than `gap_m` apart are not connected.
///
/// # Errors
/// No points, or the drawing fails.
pub(crate) fn plane(
    reference: &[(f64, f64)],
    series: &[Series],
    gap_m: f64,
) -> Result<String, PlotError> {
    register_fonts();
    let points = || series.iter().flat_map(|series| series.points.iter().copied());
    points().next().ok_or(PlotError::Empty)?;
    let pixels = (PLANE.0 - 2 * MARGIN - LABELS_LEFT, PLANE.1 - 2 * MARGIN - LABELS_BELOW);
    let (x, y) = equal_ranges(points().chain(reference.iter().copied()), pixels);
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, PLANE).into_drawing_area();
    let mut chart = ChartBuilder::on(&area)
        .margin(MARGIN)
        .x_label_area_size(LABELS_BELOW)
        .y_label_area_size(LABELS_LEFT)
        .build_cartesian_2d(x.clone(), y.clone())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(MUTED)
        .label_style(label(14, &INK))
        .axis_desc_style(label(15, &INK))
        .x_desc("east (m)")
        .y_desc("north (m)")
        .x_label_formatter(&|x| short(*x))
        .y_label_formatter(&|y| short(*y))
        .draw()?;
    let is_near = |a: &(f64, f64), b: &(f64, f64)| (a.0 - b.0).hypot(a.1 - b.1) <= gap_m;
    for (index, series) in series.iter().enumerate() {
        let color = COLORS[index % COLORS.len()];
        let mut thinning = Thinning::new((x.end - x.start, y.end - y.start), pixels);
        let shown = series.points.iter().copied().filter(|point| thinning.is_new(*point, 0));
        let shown: Vec<_> = shown.collect();
        for segment in shown.chunk_by(is_near) {
            let line = color.mix(0.8).stroke_width(1);
            chart.draw_series(LineSeries::new(segment.iter().copied(), line))?;
        }
        chart.draw_series(shown.iter().map(|point| Circle::new(*point, 2, color.filled())))?;
    }
    for segment in reference.chunk_by(is_near) {
        chart.draw_series(LineSeries::new(segment.iter().copied(), BLACK.stroke_width(2)))?;
    }
    if let [point] = reference {
        chart.draw_series([Cross::new(*point, 9, BLACK.stroke_width(3))])?;
    }
    area.present()?;
    drop(chart);
    drop(area);
    Ok(text)
}

/// An interval of a strip: start and end on the x axis, and one of RTKLIB's quality numbers.
pub(crate) type Stretch = (f64, f64, i64);

/// One named strip a row, coloured by quality over time, as an SVG document.
///
/// # Errors
/// No intervals, or the drawing fails.
pub(crate) fn strips(rows: &[(String, Vec<Stretch>)]) -> Result<String, PlotError> {
    register_fonts();
    let times = rows.iter().flat_map(|(_, segments)| segments.iter().flat_map(|p| [p.0, p.1]));
    let (start, end) = span(times).ok_or(PlotError::Empty)?;
    let height = STRIP.0 * rows.len() as u32 + STRIP.1;
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, (LINES.0, height)).into_drawing_area();
    let mut chart = ChartBuilder::on(&area)
        .margin(MARGIN)
        .margin_left(NAMES)
        .x_label_area_size(LABELS_BELOW)
        .build_cartesian_2d(start..end.max(start + 1.0), -(rows.len() as f64)..0.0)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(MUTED)
        .label_style(label(14, &INK))
        .axis_desc_style(label(15, &INK))
        .x_desc("GPS seconds of week (s)")
        .x_label_formatter(&|x| format!("{x:.0}"))
        .draw()?;
    for (index, (name, segments)) in rows.iter().enumerate() {
        let top = -(index as f64) - 0.15;
        chart.draw_series(segments.iter().map(|(from, to, quality)| {
            let corners = [(*from, top), (*to, top - 0.7)];
            Rectangle::new(corners, QualityStyle::of(*quality).color.filled())
        }))?;
        let y = MARGIN as i32 + 9 + STRIP.0 as i32 * index as i32;
        area.draw_text(name, &label(14, &INK), (MARGIN as i32, y))?;
    }
    area.present()?;
    drop(chart);
    drop(area);
    Ok(text)
}

/// A number without superfluous digits.
fn short(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The smallest and the largest value; `None` without values.
fn span(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let finite = values.filter(|value| value.is_finite());
    finite.fold(None, |span, value| match span {
        None => Some((value, value)),
        Some((low, high)) => Some((f64::min(low, value), f64::max(high, value))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: Axes<'_> = Axes { x: "time (s)", y: "error (m)", is_logarithmic: false, gap: 5.0 };

    /// Four points, a gap after the second: two lines, in the colour of their series.
    #[test]
    fn a_gap_cuts_a_line() {
        let series = [Series { points: vec![(0.0, 1.0), (1.0, 2.0), (9.0, 1.0), (10.0, 1.5)] }];
        let colored = |gap| {
            let svg = lines(&Axes { gap, ..AXES }, &series).unwrap();
            svg.matches(&format!("stroke=\"{}\"", css_color(0).to_uppercase())).count()
        };
        assert_eq!((colored(5.0), colored(20.0)), (2, 1));
    }

    #[test]
    fn a_logarithmic_axis_takes_zeros_and_nothing_at_all_is_an_error() {
        let axes = Axes { is_logarithmic: true, ..AXES };
        let series = [Series { points: vec![(0.0, 0.0), (1.0, 0.01), (2.0, 10.0)] }];
        assert!(lines(&axes, &series).unwrap().contains("<polyline"));
        let zeros = [Series { points: vec![(0.0, 0.0)] }];
        assert!(matches!(lines(&axes, &zeros), Err(PlotError::Empty)));
        assert!(matches!(plane(&[], &[], 1.0), Err(PlotError::Empty)));
        assert!(matches!(strips(&[]), Err(PlotError::Empty)));
    }

    #[test]
    fn a_strip_has_the_colour_of_its_quality() {
        let rows = [("RTK".to_owned(), vec![(0.0, 10.0, 1), (10.0, 20.0, 2)])];
        let svg = strips(&rows).unwrap().to_lowercase();
        for quality in [1, 2] {
            assert!(svg.contains(&css_quality(quality).0), "{quality}");
        }
    }
}
