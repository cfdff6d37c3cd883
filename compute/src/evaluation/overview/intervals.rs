//! Values over time, thinned while they come: the smallest, the largest and the last one of each
//! interval.

use crate::gnss::Status;

/// Most intervals. A figure has about a thousand pixels in a row.
const LIMIT: usize = 2048;
/// Length of an interval at first (s).
const SHORTEST_S: f64 = 0.05;
/// Later times are those of a wrong clock, and left out (s).
const LONGEST_S: f64 = 1e9;

/// The smallest, the largest and the last value of an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    pub(super) min: f64,
    pub(super) max: f64,
    pub(super) last: f64,
}

/// `N` values of the epochs of an interval, and the number of epochs with each status.
#[derive(Clone, Debug, PartialEq)]
struct Interval<const N: usize> {
    statuses: [u32; Status::ALL.len()],
    values: [Option<Extent>; N],
}

/// Equal intervals from the first epoch on. When there are too many, each two become one.
#[derive(Debug)]
pub(super) struct Intervals<const N: usize> {
    length_s: f64,
    intervals: Vec<Interval<N>>,
    /// Time of the epoch before, and the shortest time between two epochs (s).
    before_s: Option<f64>,
    spacing_s: f64,
}

impl Extent {
    fn of(value: f64) -> Self {
        Self { min: value, max: value, last: value }
    }

    /// This extent and a later one.
    fn and(self, later: Self) -> Self {
        Self { min: self.min.min(later.min), max: self.max.max(later.max), last: later.last }
    }
}

impl<const N: usize> Interval<N> {
    const EMPTY: Self = Self { statuses: [0; Status::ALL.len()], values: [None; N] };

    fn add(&mut self, later: &Self) {
        for (count, more) in self.statuses.iter_mut().zip(later.statuses) {
            *count += more;
        }
        for (value, more) in self.values.iter_mut().zip(later.values) {
            *value = match (*value, more) {
                (Some(before), Some(more)) => Some(before.and(more)),
                (before, more) => before.or(more),
            };
        }
    }

    /// The status of most epochs; `None` without epochs.
    fn status(&self) -> Option<Status> {
        let counted = Status::ALL.into_iter().zip(self.statuses);
        let most = counted.max_by_key(|(_, count)| *count);
        most.filter(|(_, count)| 0 < *count).map(|(status, _)| status)
    }
}

impl<const N: usize> Intervals<N> {
    pub(super) const fn new() -> Self {
        Self {
            length_s: SHORTEST_S,
            intervals: Vec::new(),
            before_s: None,
            spacing_s: f64::INFINITY,
        }
    }

    /// Adds an epoch at a time since the first one (s). One before the first is left out.
    pub(super) fn add(&mut self, time_s: f64, status: Status, values: [Option<f64>; N]) {
        if !(0.0..LONGEST_S).contains(&time_s) {
            return;
        }
        if let Some(spacing_s) = self.before_s.replace(time_s).map(|before_s| time_s - before_s)
            && 0.0 < spacing_s
        {
            self.spacing_s = self.spacing_s.min(spacing_s);
        }
        while LIMIT <= (time_s / self.length_s) as usize {
            self.halve();
        }
        let index = (time_s / self.length_s) as usize;
        if self.intervals.len() <= index {
            self.intervals.resize(index + 1, Interval::EMPTY);
        }
        let finite = |value: Option<f64>| value.filter(|value| value.is_finite());
        let mut epoch =
            Interval { values: values.map(|v| finite(v).map(Extent::of)), ..Interval::EMPTY };
        epoch.statuses[status as usize] = 1;
        self.intervals[index].add(&epoch);
    }

    /// Joins each two intervals.
    fn halve(&mut self) {
        self.length_s *= 2.0;
        let joined = self.intervals.chunks(2).map(|pair| {
            let mut joined = pair[0].clone();
            pair[1..].iter().for_each(|later| joined.add(later));
            joined
        });
        self.intervals = joined.collect();
    }

    /// Times further apart are a gap (s).
    pub(super) fn gap_s(&self) -> f64 {
        let spacing_s = if self.spacing_s.is_finite() { self.spacing_s } else { 0.0 };
        (10.0 * spacing_s).max(2.5 * self.length_s)
    }

    /// The points of a value, in order of time (s).
    pub(super) fn points(&self, value: usize) -> Vec<(f64, f64)> {
        let mut points = Vec::new();
        for (index, interval) in self.intervals.iter().enumerate() {
            let Some(Extent { min, max, last }) = interval.values[value] else { continue };
            let time_s = index as f64 * self.length_s;
            points.extend([(time_s, min), (time_s, max), (time_s, last)]);
        }
        points.dedup();
        points
    }

    /// The smallest and the largest value of all epochs, and the last one.
    pub(super) fn extent(&self, value: usize) -> Option<Extent> {
        self.intervals.iter().filter_map(|interval| interval.values[value]).reduce(Extent::and)
    }

    /// Stretches of time in which most epochs have one status: begin, end (s) and status.
    pub(super) fn stretches(&self) -> Vec<(f64, f64, Status)> {
        let mut stretches: Vec<(f64, f64, Status)> = Vec::new();
        for (index, interval) in self.intervals.iter().enumerate() {
            let Some(status) = interval.status() else { continue };
            let from = index as f64 * self.length_s;
            let to = from + self.length_s;
            match stretches.last_mut() {
                // A stretch lasts until the next one begins, if no epoch is missing.
                Some(last) if from - last.1 <= self.gap_s() => {
                    last.1 = from;
                    if last.2 == status {
                        last.1 = to;
                    } else {
                        stretches.push((from, to, status));
                    }
                }
                _ => stretches.push((from, to, status)),
            }
        }
        stretches
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A day of 1 Hz with one outlier and a status that changes at noon.
    #[test]
    fn a_day_is_thinned_and_keeps_its_extremes() {
        let mut day = Intervals::<1>::new();
        for second in 0..86_400 {
            let value = if second == 50_001 { -7.0 } else { f64::from(second % 5) };
            let status = if second < 43_200 { Status::Float } else { Status::Fixed };
            day.add(f64::from(second), status, [Some(value)]);
        }
        assert!(day.intervals.len() <= LIMIT && LIMIT / 2 < day.intervals.len() + 400);
        assert_eq!(day.extent(0), Some(Extent { min: -7.0, max: 4.0, last: 4.0 }));
        assert_eq!(day.points(0).iter().filter(|point| point.1 == -7.0).count(), 1);
        let stretches = day.stretches();
        let statuses: Vec<_> = stretches.iter().map(|stretch| stretch.2).collect();
        assert_eq!(statuses, [Status::Float, Status::Fixed]);
        assert!((stretches[1].0 - 43_200.0).abs() < 52.0, "{stretches:?}");
        assert_eq!(stretches[0].1, stretches[1].0);
    }

    #[test]
    fn a_gap_ends_a_stretch_and_wrong_times_are_left_out() {
        let mut intervals = Intervals::<1>::new();
        for time_s in [0.0, 1.0, 2.0, 60.0, 61.0, -1.0, 1e12, f64::NAN] {
            intervals.add(time_s, Status::Single, [None]);
        }
        assert_eq!(intervals.gap_s(), 10.0);
        let stretches = intervals.stretches();
        assert_eq!(stretches.len(), 2, "{stretches:?}");
        assert!(stretches[0].1 < 3.0 && 59.9 < stretches[1].0);
        assert_eq!((intervals.points(0), intervals.extent(0)), (vec![], None));
    }
}
