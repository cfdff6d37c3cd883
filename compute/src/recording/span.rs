//! The requested part of a recording.

use crate::gnss::{GpsTime, wrap_half_week};

/// The span of a recording from and to seconds of week, which its first epoch dates.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Span {
    from_s: Option<f64>,
    to_s: Option<f64>,
    /// Time of the first epoch.
    first: Option<GpsTime>,
}

impl Span {
    /// The span of these GPS seconds of week; `None` is not bounded.
    pub(super) const fn new(from_s: Option<f64>, to_s: Option<f64>) -> Self {
        Self { from_s, to_s, first: None }
    }

    /// Whether an epoch belongs to it. Epochs are asked for in the order of the file.
    ///
    /// Seconds of week before those of the first epoch are of the next week if this begins within
    /// half a week, and the last second follows the first one likewise.
    pub(super) fn contains(&mut self, time: GpsTime) -> bool {
        let first = *self.first.get_or_insert(time);
        let from = self.from_s.map_or(first, |from_s| after(first, from_s));
        let to = self.to_s.map(|to_s| after(from, to_s));
        from <= time && to.is_none_or(|to| time <= to)
    }
}

/// The time with this second of week that is not before `time`, unless it is nearer before it.
fn after(time: GpsTime, second_of_week: f64) -> GpsTime {
    let ahead_s = second_of_week - time.seconds_of_week();
    time + if 0.0 <= ahead_s { ahead_s } else { wrap_half_week(ahead_s) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds of week of the epochs inside, of a recording from 604,740 s to 90 s of the next week.
    fn inside(from_s: Option<f64>, to_s: Option<f64>) -> Vec<i32> {
        let mut span = Span::new(from_s, to_s);
        let begin = GpsTime::from_week_seconds(2200, 604_740.0);
        let times = (0..=15).map(|n| begin + 10.0 * f64::from(n));
        let inside = times.filter(|time| span.contains(*time));
        inside.map(|time| time.seconds_of_week() as i32).collect()
    }

    #[test]
    fn a_span_may_cross_the_end_of_the_week() {
        assert_eq!(inside(Some(604_770.0), Some(20.0)), [604_770, 604_780, 604_790, 0, 10, 20]);
        assert_eq!(inside(Some(604_790.0), None)[..2], [604_790, 0]);
        assert_eq!(inside(Some(80.0), None), [80, 90]);
        assert_eq!(inside(None, Some(604_750.0)), [604_740, 604_750]);
        assert_eq!(inside(None, None).len(), 16);
        assert_eq!(inside(Some(604_000.0), Some(604_745.0)), [604_740]);
        assert!(inside(Some(604_780.0), Some(604_770.0)).is_empty(), "ends before it begins");
    }

    /// A file of a whole week.
    #[test]
    fn a_long_span_stays_within_its_week() {
        let mut span = Span::new(Some(400_000.0), Some(600_000.0));
        let at = |second| GpsTime::from_week_seconds(2200, second);
        let inside: Vec<bool> = [0.0, 399_999.0, 400_000.0, 600_000.0, 600_001.0]
            .map(|second| span.contains(at(second)))
            .to_vec();
        assert_eq!(inside, [false, false, true, true, false]);
    }
}
