//! Figures of several series: lines over time, lines in a plane, strips of states.

use std::ops::Range;

use plotters::coord::Shift;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::prelude::*;

use super::PlotError;
use super::style::{
    BLUE, GREEN, GRID, INK, MUTED, ORANGE, PURPLE, QualityStyle, REFERENCE, SKY, Thinning,
    VERMILION, label, register_fonts, status_color,
};
use super::track::equal_ranges;
use crate::gnss::Status;

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

/// Scale of the y axis of a line figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    /// Linear from zero.
    FromZero,
    /// Linear around the values.
    Around,
    /// Logarithmic; values that are not positive are left out.
    Logarithmic,
}

/// Labels and scale of the axes of a line figure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axes<'a> {
    /// Label of the x axis.
    pub x: &'a str,
    /// Label of the y axis.
    pub y: &'a str,
    /// Scale of the y axis.
    pub scale: Scale,
    /// Neighbours further apart in x are not connected.
    pub gap: f64,
    /// Begin and end of the x axis; `None` for those of the points.
    pub span: Option<(f64, f64)>,
}

/// The CSS colour of series number `index`.
pub(crate) fn css_color(index: usize) -> String {
    css(COLORS[index % COLORS.len()])
}

/// The CSS colour and the name of one of RTKLIB's quality numbers.
pub(crate) fn css_quality(quality: i64) -> (String, &'static str) {
    let QualityStyle { name, color } = QualityStyle::of(quality);
    (css(color), name)
}

/// The CSS colour of a status.
pub(crate) fn css_status(status: Status) -> String {
    css(status_color(status))
}

/// A colour as the attributes of an SVG's elements have it.
fn css(RGBColor(red, green, blue): RGBColor) -> String {
    format!("#{red:02X}{green:02X}{blue:02X}")
}

/// Lines over a common x axis, as an SVG document.
///
/// # Errors
/// No points, or the drawing fails.
pub(crate) fn lines(axes: &Axes<'_>, series: &[Series]) -> Result<String, PlotError> {
    register_fonts();
    let points = || series.iter().flat_map(|series| series.points.iter().copied());
    let (low_x, high_x) = span(points().map(|point| point.0)).ok_or(PlotError::Empty)?;
    let (low_x, high_x) = axes.span.unwrap_or((low_x, high_x));
    let is_drawn = |y: &f64| axes.takes(*y);
    let (low_y, high_y) =
        span(points().map(|point| point.1).filter(is_drawn)).ok_or(PlotError::Empty)?;
    let x = low_x..high_x.max(low_x + 1.0);
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, LINES).into_drawing_area();
    let mut builder = ChartBuilder::on(&area);
    builder.margin(MARGIN).x_label_area_size(LABELS_BELOW).y_label_area_size(LABELS_LEFT);
    if axes.scale == Scale::Logarithmic {
        let y = (low_y * 0.8..high_y * 1.25).log_scale();
        draw_lines(builder.build_cartesian_2d(x, y)?, axes, series)?;
    } else {
        let margin = (0.05 * (high_y - low_y)).max(1e-3);
        let low_y = if axes.scale == Scale::FromZero { low_y.min(0.0) } else { low_y - margin };
        let y = low_y..high_y + margin;
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
        let points = series.points.iter().copied().filter(|point| axes.takes(point.1));
        let points = thinned(points, f64::from(LINES.0) / (range.end - range.start));
        for segment in points.chunk_by(|a, b| b.0 - a.0 <= axes.gap) {
            if let [single] = segment {
                chart.draw_series([Circle::new(*single, 1, color.filled())])?;
            }
            chart.draw_series(LineSeries::new(segment.iter().copied(), color.stroke_width(1)))?;
        }
    }
    Ok(())
}

impl Axes<'_> {
    /// Whether a value is drawn.
    fn takes(&self, y: f64) -> bool {
        self.scale != Scale::Logarithmic || 0.0 < y
    }
}

/// The smallest, the largest and the last of the points on each pixel of the x axis, in their
/// order.
fn thinned(points: impl Iterator<Item = (f64, f64)>, pixels_per_unit: f64) -> Vec<(f64, f64)> {
    let pixel = |point: &(f64, f64)| (point.0 * pixels_per_unit).floor();
    let points: Vec<_> = points.collect();
    let mut shown = Vec::new();
    for column in points.chunk_by(|a, b| pixel(a) == pixel(b)) {
        let by_y = |a: &usize, b: &usize| column[*a].1.total_cmp(&column[*b].1);
        let mut kept = [
            (0..column.len()).min_by(by_y).expect("a chunk has points"),
            (0..column.len()).max_by(by_y).expect("a chunk has points"),
            column.len() - 1,
        ];
        kept.sort_unstable();
        let distinct = kept.iter().enumerate().filter(|(i, k)| *i == 0 || kept[i - 1] != **k);
        shown.extend(distinct.map(|(_, index)| column[*index]));
    }
    shown
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
    let mut chart = plane_chart(&area, (x.clone(), y.clone()))?;
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

type PlaneChart<'a, 'b> = Chart<'a, 'b, plotters::coord::types::RangedCoordf64>;

/// Axes of east and north.
fn plane_chart<'a, 'b>(
    area: &'a DrawingArea<SVGBackend<'b>, Shift>,
    (x, y): (Range<f64>, Range<f64>),
) -> Result<PlaneChart<'a, 'b>, PlotError> {
    let mut chart = ChartBuilder::on(area)
        .margin(MARGIN)
        .x_label_area_size(LABELS_BELOW)
        .y_label_area_size(LABELS_LEFT)
        .build_cartesian_2d(x, y)?;
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
    Ok(chart)
}

/// An interval of a strip: start and end on the x axis, and one of RTKLIB's quality numbers.
pub(crate) type Stretch = (f64, f64, i64);

/// One named strip a row, coloured by quality over time, as an SVG document.
///
/// # Errors
/// No intervals, or the drawing fails.
pub(crate) fn strips(rows: &[(String, Vec<Stretch>)]) -> Result<String, PlotError> {
    let colored = |(from, to, quality): &Stretch| (*from, *to, QualityStyle::of(*quality).color);
    let rows: Vec<Row<'_>> =
        rows.iter().map(|(name, row)| (&**name, row.iter().map(colored).collect())).collect();
    draw_strips("GPS seconds of week (s)", NAMES, &rows)
}

/// A strip coloured by status over time, as an SVG document. A stretch has start, end and status.
///
/// # Errors
/// No intervals, or the drawing fails.
pub(crate) fn status_strip(
    x_label: &str,
    stretches: &[(f64, f64, Status)],
) -> Result<String, PlotError> {
    let colored = stretches.iter().map(|(from, to, status)| (*from, *to, status_color(*status)));
    draw_strips(x_label, (MARGIN + LABELS_LEFT) as i32, &[("", colored.collect())])
}

/// The name of a strip, and its stretches: start, end, colour.
type Row<'a> = (&'a str, Vec<(f64, f64, RGBColor)>);

fn draw_strips(x_label: &str, left: i32, rows: &[Row<'_>]) -> Result<String, PlotError> {
    register_fonts();
    let times = rows.iter().flat_map(|(_, segments)| segments.iter().flat_map(|p| [p.0, p.1]));
    let (start, end) = span(times).ok_or(PlotError::Empty)?;
    let height = STRIP.0 * rows.len() as u32 + STRIP.1;
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, (LINES.0, height)).into_drawing_area();
    let mut chart = ChartBuilder::on(&area)
        .margin(MARGIN)
        .margin_left(left)
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
        .x_desc(x_label)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .draw()?;
    for (index, (name, segments)) in rows.iter().enumerate() {
        let top = -(index as f64) - 0.15;
        chart.draw_series(segments.iter().map(|(from, to, color)| {
            let corners = [(*from, top), (*to, top - 0.7)];
            Rectangle::new(corners, color.filled())
        }))?;
        let y = MARGIN as i32 + 9 + STRIP.0 as i32 * index as i32;
        area.draw_text(name, &label(14, &INK), (MARGIN as i32, y))?;
    }
    area.present()?;
    drop(chart);
    drop(area);
    Ok(text)
}

/// Positions in a plane with equal scales, coloured by status, as an SVG document.
///
/// # Errors
/// No points, or the drawing fails.
pub(crate) fn positions(points: &[((f64, f64), Status)]) -> Result<String, PlotError> {
    register_fonts();
    if points.is_empty() {
        return Err(PlotError::Empty);
    }
    let pixels = (PLANE.0 - 2 * MARGIN - LABELS_LEFT, PLANE.1 - 2 * MARGIN - LABELS_BELOW);
    let (x, y) = equal_ranges(points.iter().map(|(point, _)| *point), pixels);
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, PLANE).into_drawing_area();
    let mut chart = plane_chart(&area, (x.clone(), y.clone()))?;
    let mut thinning = Thinning::new((x.end - x.start, y.end - y.start), pixels);
    let shown = points.iter().filter(|(point, status)| thinning.is_new(*point, *status as i64));
    chart.draw_series(
        shown.map(|(point, status)| Circle::new(*point, 2, status_color(*status).filled())),
    )?;
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

    const AXES: Axes<'_> =
        Axes { x: "time (s)", y: "error (m)", scale: Scale::FromZero, gap: 5.0, span: None };

    /// Four points, a gap after the second: two lines, in the colour of their series.
    #[test]
    fn a_gap_cuts_a_line() {
        let series = [Series { points: vec![(0.0, 1.0), (1.0, 2.0), (9.0, 1.0), (10.0, 1.5)] }];
        let colored = |gap| {
            let svg = lines(&Axes { gap, ..AXES }, &series).unwrap();
            svg.matches(&format!("stroke=\"{}\"", css_color(0))).count()
        };
        assert_eq!((colored(5.0), colored(20.0)), (2, 1));
    }

    #[test]
    fn a_logarithmic_axis_takes_zeros_and_nothing_at_all_is_an_error() {
        let axes = Axes { scale: Scale::Logarithmic, ..AXES };
        let series = [Series { points: vec![(0.0, 0.0), (1.0, 0.01), (2.0, 10.0)] }];
        assert!(lines(&axes, &series).unwrap().contains("<polyline"));
        let zeros = [Series { points: vec![(0.0, 0.0)] }];
        assert!(matches!(lines(&axes, &zeros), Err(PlotError::Empty)));
        assert!(matches!(plane(&[], &[], 1.0), Err(PlotError::Empty)));
        assert!(matches!(strips(&[]), Err(PlotError::Empty)));
    }

    /// Of a thousand points on a pixel the smallest, the largest and the last remain.
    #[test]
    fn a_pixel_keeps_its_extremes() {
        let value = |i: i32| if i == 500 { -9.0 } else { f64::from(i % 7) };
        let points = (0..2000).map(|i| (f64::from(i) / 1000.0, value(i)));
        let shown = thinned(points, 1.0);
        assert_eq!(shown.len(), 6, "{shown:?}");
        assert_eq!(shown[0], (0.5, -9.0));
        assert_eq!(shown[2], (0.999, value(999)));
        assert_eq!(thinned([(3.0, 1.0)].into_iter(), 1.0), [(3.0, 1.0)]);
    }

    #[test]
    fn positions_have_the_colours_of_their_statuses() {
        let points = [((0.0, 0.0), Status::Fixed), ((1.0, 5.0), Status::Single)];
        let svg = positions(&points).unwrap();
        assert_eq!(svg.matches("<circle").count(), 2);
        for (_, status) in points {
            assert!(svg.contains(&css_status(status)), "{status:?}");
        }
        assert!(matches!(positions(&[]), Err(PlotError::Empty)));
        let strip = status_strip("time (s)", &[(0.0, 4.0, Status::None)]).unwrap();
        assert!(strip.contains(&css_status(Status::None)));
    }

    #[test]
    fn a_strip_has_the_colour_of_its_quality() {
        let rows = [("RTK".to_owned(), vec![(0.0, 10.0, 1), (10.0, 20.0, 2)])];
        let svg = strips(&rows).unwrap();
        for quality in [1, 2] {
            assert!(svg.contains(&css_quality(quality).0), "{quality}");
        }
    }
}
