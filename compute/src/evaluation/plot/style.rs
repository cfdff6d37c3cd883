//! Colours, fonts and the thinning of points, common to the panels.

use std::collections::HashSet;
use std::sync::Once;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::{FontStyle, TextStyle, register_font};

use super::PlotError;
use crate::gnss::Status;

/// Colour of text and axes.
pub(super) const INK: RGBColor = RGBColor(34, 34, 34);
/// Colour of secondary text.
pub(super) const MUTED: RGBColor = RGBColor(96, 96, 96);
/// Colour of grid lines.
pub(super) const GRID: RGBColor = RGBColor(225, 225, 225);
/// Colour of the reference track.
pub(super) const REFERENCE: RGBColor = RGBColor(90, 90, 90);
/// Colour of stated 95 % intervals.
pub(super) const BAND: RGBColor = RGBColor(222, 228, 236);

// The palette of Okabe & Ito (2008), distinguishable with every kind of colour vision.
pub(super) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(super) const VERMILION: RGBColor = RGBColor(213, 94, 0);
pub(super) const GREEN: RGBColor = RGBColor(0, 158, 115);
pub(super) const ORANGE: RGBColor = RGBColor(230, 159, 0);
pub(super) const SKY: RGBColor = RGBColor(86, 180, 233);
pub(super) const PURPLE: RGBColor = RGBColor(204, 121, 167);

const FONT: &str = "sans-serif";

/// Style of solutions with one quality number.
pub(super) struct QualityStyle {
    pub(super) name: &'static str,
    pub(super) color: RGBColor,
}

impl QualityStyle {
    /// The style of one of RTKLIB's quality numbers.
    pub(super) const fn of(quality: i64) -> Self {
        let (name, color) = match quality {
            1 => ("fixed", GREEN),
            2 => ("float", ORANGE),
            3 => ("SBAS", SKY),
            4 => ("DGNSS", SKY),
            5 => ("single", BLUE),
            6 => ("PPP", PURPLE),
            _ => ("other", VERMILION),
        };
        Self { name, color }
    }
}

/// The colour of a status, as in the dashboard.
pub(super) const fn status_color(status: Status) -> RGBColor {
    match status {
        Status::Fixed => RGBColor(0, 120, 90),
        Status::Float => RGBColor(168, 100, 0),
        Status::Fgo => RGBColor(11, 118, 184),
        Status::Ekf => RGBColor(68, 80, 200),
        Status::Single => RGBColor(168, 50, 124),
        Status::None => RGBColor(194, 58, 0),
    }
}

/// Registers the embedded font; repeated calls have no effect.
pub(super) fn register_fonts() {
    static REGISTERED: Once = Once::new();
    REGISTERED.call_once(|| {
        register_font(FONT, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
            .ok()
            .expect("the embedded font is an OpenType font");
    });
}

/// Text style of a height (pixels) and a colour.
pub(super) fn label(height: u32, color: &RGBColor) -> TextStyle<'static> {
    (FONT, height).into_font().color(color)
}

/// Draws a panel's title in its upper left corner.
pub(super) fn draw_title<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    title: &str,
    x: i32,
) -> Result<(), PlotError> {
    Ok(area.draw_text(title, &label(19, &INK), (x, 4))?)
}

/// Drops points that fall on pixels already drawn, so that the cost of a figure is bounded by its
/// pixels, not by the length of the file.
pub(super) struct Thinning {
    pixels: (f64, f64),
    seen: HashSet<(i64, i64, i64)>,
}

impl Thinning {
    /// Thinning for an axis range of `spans` (x, y) shown on `pixels`.
    pub(super) fn new(spans: (f64, f64), pixels: (u32, u32)) -> Self {
        let per_unit = (f64::from(pixels.0) / spans.0, f64::from(pixels.1) / spans.1);
        Self { pixels: per_unit, seen: HashSet::new() }
    }

    /// Whether the point's pixel has no point of this kind yet.
    pub(super) fn is_new(&mut self, point: (f64, f64), kind: i64) -> bool {
        let pixel = |value: f64, per_unit: f64| (value * per_unit).round() as i64;
        self.seen.insert((pixel(point.0, self.pixels.0), pixel(point.1, self.pixels.1), kind))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_one_pixel_are_drawn_once() {
        let mut thinning = Thinning::new((10.0, 10.0), (100, 100));
        assert!(thinning.is_new((1.0, 1.0), 5));
        assert!(!thinning.is_new((1.01, 1.01), 5));
        assert!(thinning.is_new((1.01, 1.01), 1));
        assert!(thinning.is_new((1.1, 1.0), 5));
    }
}
