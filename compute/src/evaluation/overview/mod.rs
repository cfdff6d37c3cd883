//! A run as figures: track, statuses, height, uncertainty, satellites and integers over time.
//!
//! Solutions are thinned while they come to what a figure can show, so the memory of an
//! [`Overview`] and the size of its figures are bounded, whatever the length of the recording.

mod intervals;
mod track;

use std::collections::BTreeSet;

use self::intervals::{Extent, Intervals};
use self::track::TrackCells;

use super::html::{figure, swatch};
use super::plot::PlotError;
use super::plot::series::{
    Axes, Scale, Series, css_color, css_status, lines, positions, status_strip,
};
use crate::gnss::{Ecef, Geodetic, GpsTime, LeapSeconds, LocalFrame, Solution, Status};

/// The values over time, in their order in the intervals.
const UP: usize = 0;
const SIGMA: usize = 1;
const PROTECTION: usize = 2;
const SATELLITES: usize = 3;
const RATIO: usize = 4;
const PROBABILITY: usize = 5;
const VALUES: usize = 6;
/// Larger ratios are drawn at this value.
const RATIO_MAX: f64 = 1e3;

/// What is kept of the solutions of a run for its figures.
#[derive(Debug)]
pub struct Overview {
    /// Times of the first and the last epoch.
    span: Option<(GpsTime, GpsTime)>,
    /// At the first position.
    frame: Option<LocalFrame>,
    intervals: Intervals<VALUES>,
    track: TrackCells,
}

/// The unit of a time axis.
struct TimeUnit {
    label: &'static str,
    seconds: f64,
}

impl Default for Overview {
    fn default() -> Self {
        Self::new()
    }
}

impl Overview {
    /// The overview of a run without epochs.
    pub fn new() -> Self {
        Self { span: None, frame: None, intervals: Intervals::new(), track: TrackCells::new() }
    }

    /// Adds the next solution.
    pub fn add(&mut self, solution: &Solution) {
        let (first, last) = self.span.get_or_insert((solution.time, solution.time));
        *last = solution.time.max(*last);
        let time_s = solution.time - *first;
        let mut values = [None; VALUES];
        if let Some(estimate) = &solution.estimate {
            let frame = self.frame.get_or_insert_with(|| LocalFrame::at(estimate.position));
            let enu = frame.to_enu(estimate.position).0;
            self.track.add(enu.x, enu.y, solution.status);
            values[UP] = Some(enu.z);
            values[SIGMA] = Some(estimate.sigmas_m().0);
            values[SATELLITES] = Some(estimate.satellites_used.len() as f64);
            values[PROTECTION] = solution.protection.map(|level| level.horizontal_m);
            if let Some(relative) = &estimate.relative {
                values[RATIO] = relative.ratio.map(|ratio| ratio.min(RATIO_MAX));
                values[PROBABILITY] = relative.fix_probability;
            }
        }
        self.intervals.add(time_s, solution.status, values);
    }

    /// The first position (m).
    pub fn first_position(&self) -> Option<Ecef> {
        self.frame.as_ref().map(|frame| frame.origin)
    }

    /// The figures, as part of an HTML page.
    ///
    /// # Errors
    /// The drawing has failed.
    pub fn figures(&self) -> Result<String, PlotError> {
        let mut text = self.introduction();
        text += &self.track_figure()?;
        text += &self.status_figure()?;
        let up = self.told(UP, "Metres above the first position", 3);
        text += &self.line_figure(("Height over time", &up), "height (m)", Scale::Around, &[UP])?;
        let sigma = self.told(SIGMA, "Horizontal standard deviation in metres", 3);
        let level = self.told(PROTECTION, "Horizontal protection level in metres", 3);
        let both = ("Horizontal uncertainty over time", &*format!("{sigma} {level}"));
        let uncertainties = [SIGMA, PROTECTION];
        text += &self.line_figure(both, "uncertainty (m)", Scale::Logarithmic, &uncertainties)?;
        let satellites = self.told(SATELLITES, "Number of satellites", 0);
        let titled = ("Satellites used over time", &*satellites);
        text += &self.line_figure(titled, "satellites", Scale::FromZero, &[SATELLITES])?;
        if self.intervals.extent(RATIO).is_some() {
            let ratio = self.told(RATIO, "Ratio", 1);
            let titled = ("Ratio of the integers over time", &*ratio);
            text += &self.line_figure(titled, "ratio", Scale::Logarithmic, &[RATIO])?;
        }
        if self.intervals.extent(PROBABILITY).is_some() {
            let probability = self.told(PROBABILITY, "Probability", 3);
            let titled = ("Probability that the fix is right over time", &*probability);
            text += &self.line_figure(titled, "probability", Scale::Around, &[PROBABILITY])?;
        }
        Ok(text)
    }

    /// When and where it is.
    fn introduction(&self) -> String {
        let Some((first, last)) = self.span else { return String::new() };
        let utc = |time: GpsTime| time.to_rfc3339(&LeapSeconds::table());
        let mut text = format!(
            "<p>Epochs from <time>{}</time> to <time>{}</time> (UTC; GPS week {}, seconds {:.3} to \
             {:.3}).",
            utc(first),
            utc(last),
            first.week(),
            first.seconds_of_week(),
            first.seconds_of_week() + (last - first)
        );
        if let Some(frame) = &self.frame {
            let Geodetic { latitude_rad, longitude_rad, height_m } =
                Ecef(frame.origin.0).to_geodetic();
            text += &format!(
                " East, north and height are those from the first position, {:.8}°, {:.8}°, \
                 {height_m:.3} m above the ellipsoid.",
                latitude_rad.to_degrees(),
                longitude_rad.to_degrees()
            );
        }
        text + " Of several epochs on one pixel the figures show the smallest, the largest and \
                the last value.</p>\n"
    }

    fn track_figure(&self) -> Result<String, PlotError> {
        let points = self.track.points();
        let reach_m =
            points.iter().map(|((east, north), _)| east.hypot(*north)).fold(0.0, f64::max);
        let text = format!(
            "Positions from above, coloured by status. The farthest is {reach_m:.3} m from the \
             first one."
        );
        let statuses = points.iter().map(|(_, status)| *status);
        figure(("Track", &text), &status_legend(statuses), positions(points))
    }

    fn status_figure(&self) -> Result<String, PlotError> {
        let stretches = self.intervals.stretches();
        let unit = self.unit();
        let scaled = |(from, to, status): &(f64, f64, Status)| {
            (from / unit.seconds, to / unit.seconds, *status)
        };
        let text = format!(
            "A strip coloured by the status of most epochs, with {} changes.",
            stretches.len().saturating_sub(1)
        );
        let legend = status_legend(stretches.iter().map(|stretch| stretch.2));
        let scaled: Vec<_> = stretches.iter().map(scaled).collect();
        figure(("Status over time", &text), &legend, status_strip(unit.label, &scaled))
    }

    fn line_figure(
        &self,
        titled: (&str, &str),
        y: &str,
        scale: Scale,
        values: &[usize],
    ) -> Result<String, PlotError> {
        let unit = self.unit();
        let of_value = |value: &usize| {
            let points = self.intervals.points(*value).into_iter();
            Series { points: points.map(|(time_s, y)| (time_s / unit.seconds, y)).collect() }
        };
        let series: Vec<_> = values.iter().map(of_value).collect();
        let gap = self.intervals.gap_s() / unit.seconds;
        let legend = match values {
            [_] => titled.1.to_owned(),
            _ => ["standard deviation", "protection level"]
                .into_iter()
                .enumerate()
                .map(|(index, name)| format!("<span>{}{name}</span>", swatch(&css_color(index))))
                .collect(),
        };
        let end = self.span.map_or(0.0, |(first, last)| last - first) / unit.seconds;
        // At least a second, as the points have.
        let span = Some((0.0, end.max(1.0 / unit.seconds)));
        let drawn = lines(&Axes { x: unit.label, y, scale, gap, span }, &series);
        figure(titled, &legend, drawn)
    }

    /// A value in words.
    fn told(&self, value: usize, name: &str, decimals: usize) -> String {
        match self.intervals.extent(value) {
            None => format!("{name}: none."),
            Some(Extent { min, max, last }) => format!(
                "{name}: {min:.decimals$} to {max:.decimals$}, at the end {last:.decimals$}."
            ),
        }
    }

    /// A unit in which the run has a readable length.
    fn unit(&self) -> TimeUnit {
        const HOUR_S: f64 = 3600.0;
        match self.span.map_or(0.0, |(first, last)| last - first) {
            ..600.0 => TimeUnit { label: "time from the first epoch (s)", seconds: 1.0 },
            ..18_000.0 => TimeUnit { label: "time from the first epoch (min)", seconds: 60.0 },
            ..864_000.0 => TimeUnit { label: "time from the first epoch (h)", seconds: HOUR_S },
            _ => TimeUnit { label: "time from the first epoch (days)", seconds: 24.0 * HOUR_S },
        }
    }
}

/// The colours of the statuses that occur, from none to best.
fn status_legend(statuses: impl Iterator<Item = Status>) -> String {
    let occurring: BTreeSet<Status> = statuses.collect();
    let entry =
        |status: &Status| format!("<span>{}{}</span>", swatch(&css_status(*status)), status.name());
    occurring.iter().rev().map(entry).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::sample;
    use crate::gnss::Protection;

    fn solution(second: u32, status: Status) -> Solution {
        let mut solution = sample::solution(second as usize, f64::from(second) * 0.01, status);
        solution.protection = Some(Protection { horizontal_m: 0.08, vertical_m: 0.1 });
        solution.estimate = solution.estimate.filter(|_| status != Status::None);
        if let Some(estimate) = &mut solution.estimate {
            estimate.position.0.x += 0.5; // Up at this place.
            estimate.covariance *= 1e-4;
            if let Some(relative) = &mut estimate.relative {
                relative.fix_probability = Some(0.995);
            }
        }
        solution
    }

    fn figures(solutions: impl Iterator<Item = Solution>) -> String {
        let mut overview = Overview::new();
        solutions.for_each(|solution| overview.add(&solution));
        overview.figures().unwrap()
    }

    #[test]
    fn figures_tell_what_they_show() {
        let statuses = [Status::None, Status::Float, Status::Fixed, Status::Fixed];
        let page =
            figures(statuses.into_iter().zip(0..).map(|(status, second)| solution(second, status)));
        assert_eq!(page.matches("role=\"img\"").count(), 7, "{page}");
        assert!(page.contains("Horizontal standard deviation in metres: 0.010 to 0.010"), "{page}");
        assert!(page.contains("Horizontal protection level in metres: 0.080 to 0.080"), "{page}");
        assert!(page.contains("Probability: 0.995 to 0.995"), "{page}");
        assert!(page.contains("The farthest is 0.020 m"), "{page}");
        assert!(page.contains("with 2 changes"), "{page}");
        assert!(page.contains(">FIXED</span>") && page.contains(">NONE</span>"), "{page}");
        assert!(page.contains("first position, 0.00000000°, 0.00000009°, 0.500 m"), "{page}");
        let other = page.replace("http://www.w3.org/2000/svg", "");
        for foreign in ["http", "<script", " style=", "url("] {
            assert!(!other.contains(foreign), "{foreign}");
        }
    }

    /// A day of 1 Hz needs no more than some hundred kilobytes.
    #[test]
    fn the_figures_of_a_day_are_small() {
        let status =
            |second: u32| if second.is_multiple_of(7) { Status::Float } else { Status::Fixed };
        let page = figures((0..86_400).map(|second| solution(second, status(second))));
        assert!(page.len() < 700_000, "{}", page.len());
    }

    #[test]
    fn nothing_is_told_as_nothing() {
        assert!(figures(std::iter::empty()).contains("Nothing to show"));
        let page = figures([solution(0, Status::None)].into_iter());
        assert!(page.contains("Metres above the first position: none."), "{page}");
        // One epoch is enough for a figure.
        assert!(figures([solution(0, Status::Single)].into_iter()).contains("<circle"));
    }
}
