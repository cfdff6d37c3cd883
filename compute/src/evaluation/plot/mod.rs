//! A judgement as one figure: track, error over time, distribution of the errors.

mod distribution;
pub(crate) mod series;
mod style;
mod timeline;
mod track;

use std::path::Path;

use plotters::coord::Shift;
use plotters::drawing::DrawingAreaErrorKind;
use plotters::prelude::*;

use self::style::{INK, MUTED, QualityStyle, label, register_fonts};
use super::{Judgement, MatchedReport};

/// Width and height of the figure (pixels).
pub(crate) const SIZE: (u32, u32) = (1680, 1180);
const HEADER_HEIGHT: u32 = 92;
const TRACK_WIDTH: u32 = 780;
const TRACK_HEIGHT: u32 = 660;
const MARGIN: i32 = 28;

/// Why a figure cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// There is no data to draw.
    #[error("no solution matches the truth, so there is nothing to draw")]
    Empty,
    /// The drawing library failed.
    #[error("drawing failed: {0}")]
    Draw(String),
    /// The file's name ends in neither `.svg` nor `.png`.
    #[error("{0:?} ends in neither .svg nor .png")]
    UnknownFormat(String),
    /// The file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// Path of the file.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
}

impl<E: std::error::Error + Send + Sync> From<DrawingAreaErrorKind<E>> for PlotError {
    fn from(error: DrawingAreaErrorKind<E>) -> Self {
        Self::Draw(error.to_string())
    }
}

/// Writes the figure as SVG or PNG, by the extension of the path.
pub fn write(path: &Path, title: &str, judgement: &Judgement) -> Result<(), PlotError> {
    let ending = path.extension().and_then(|ending| ending.to_str()).map(str::to_lowercase);
    let content = match ending.as_deref() {
        Some("svg") => svg(title, judgement)?.into_bytes(),
        Some("png") => png(title, judgement)?,
        _ => return Err(PlotError::UnknownFormat(path.display().to_string())),
    };
    std::fs::write(path, content)
        .map_err(|source| PlotError::Write { path: path.display().to_string(), source })
}

/// The figure as a PNG image.
fn png(title: &str, judgement: &Judgement) -> Result<Vec<u8>, PlotError> {
    let (width, height) = SIZE;
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    let area = BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area();
    draw(&area, title, judgement)?;
    drop(area);
    let mut image = Vec::new();
    let mut encoder = png::Encoder::new(&mut image, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&pixels))
        .map_err(|error| PlotError::Draw(error.to_string()))?;
    Ok(image)
}

/// The figure as an SVG document.
pub(crate) fn svg(title: &str, judgement: &Judgement) -> Result<String, PlotError> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
    draw(&area, title, judgement)?;
    drop(area);
    Ok(text)
}

fn draw<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    title: &str,
    judgement: &Judgement,
) -> Result<(), PlotError> {
    let errors = judgement.report.errors.as_ref().ok_or(PlotError::Empty)?;
    register_fonts();
    area.fill(&WHITE)?;
    let (header, body) = area.split_vertically(HEADER_HEIGHT);
    let (left, right) = body.split_horizontally(TRACK_WIDTH);
    let (upper, lower) = left.split_vertically(TRACK_HEIGHT);
    draw_header(&header, title, judgement, errors)?;
    track::draw(&upper, judgement)?;
    distribution::draw(&lower, judgement, errors)?;
    timeline::draw(&right, judgement)?;
    area.present()?;
    Ok(())
}

fn draw_header<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    title: &str,
    judgement: &Judgement,
    errors: &MatchedReport,
) -> Result<(), PlotError> {
    area.draw_text(title, &label(26, &INK), (MARGIN, 18))?;
    area.draw_text(&summary(judgement, errors), &label(17, &MUTED), (MARGIN, 56))?;
    let mut right = SIZE.0 as i32 - MARGIN;
    for (quality, count) in errors.q_counts.iter().rev() {
        let style = QualityStyle::of(*quality);
        let text = format!("{} {count}", style.name);
        let font = label(17, &INK);
        right -= area.estimate_text_size(&text, &font)?.0 as i32;
        area.draw_text(&text, &font, (right, 22))?;
        right -= 14;
        area.draw(&Circle::new((right, 31), 6, style.color.filled()))?;
        right -= 24;
    }
    Ok(())
}

fn summary(judgement: &Judgement, errors: &MatchedReport) -> String {
    let report = &judgement.report;
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let mut text = format!("{} of {} epochs", report.matched, report.expected);
    if let Some(availability) = report.availability {
        text += &format!(" ({})", percent(availability));
    }
    if let Some(fixes) = &errors.fix.errors {
        text += &format!(
            "   fixed {}, of these correct {}",
            percent(errors.fix.rate_of_solutions),
            percent(fixes.correct_3d)
        );
    }
    if let Some(stated) = &errors.uncertainty {
        text += &format!(
            "   inside the stated 95 % ellipse: {} (2D), {} (3D)",
            percent(stated.inside_95_2d),
            percent(stated.inside_95_3d)
        );
    }
    text
}
