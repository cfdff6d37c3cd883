//! The reference position at a time.

use crate::formats::truth::TruthRow;
use crate::gnss::{Ecef, GpsTime};

/// A reference trajectory in order of time, without repeated times.
pub(super) struct Trajectory {
    rows: Vec<TruthRow>,
}

impl Trajectory {
    /// Sorts the rows; of several at one time the first one counts.
    pub(super) fn new(mut rows: Vec<TruthRow>) -> Self {
        rows.sort_by_key(|row| row.time);
        rows.dedup_by_key(|row| row.time);
        Self { rows }
    }

    /// The rows in order of time.
    pub(super) fn rows(&self) -> &[TruthRow] {
        &self.rows
    }

    /// The position at `time`: linear in ECEF between neighbours at most `max_gap_s` apart, else
    /// the nearest row within `tolerance_s`.
    pub(super) fn at(&self, time: GpsTime, tolerance_s: f64, max_gap_s: f64) -> Option<Ecef> {
        let next = self.rows.partition_point(|row| row.time < time);
        let after = self.rows.get(next);
        let before = next.checked_sub(1).map(|index| &self.rows[index]);
        match (before, after) {
            (_, Some(row)) if row.time == time => Some(row.position),
            (Some(a), Some(b)) if b.time - a.time <= max_gap_s => {
                let weight = (time - a.time) / (b.time - a.time);
                Some(Ecef(a.position.0.lerp(&b.position.0, weight)))
            }
            _ => {
                let distance_s = |row: &TruthRow| (row.time - time).abs();
                let candidates = [after, before].into_iter().flatten();
                let nearest = candidates.min_by(|a, b| distance_s(a).total_cmp(&distance_s(b)))?;
                (distance_s(nearest) <= tolerance_s).then_some(nearest.position)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trajectory(points: &[(f64, f64)]) -> Trajectory {
        let row = |(seconds, x): &(f64, f64)| TruthRow {
            time: GpsTime::from_week_seconds(2000, *seconds),
            position: Ecef::new(*x, 0.0, 0.0),
        };
        Trajectory::new(points.iter().map(row).collect())
    }

    #[test]
    fn between_neighbours_at_the_ends_and_in_gaps() {
        let reference = trajectory(&[(10.0, 1.0), (11.0, 3.0), (11.0, 99.0), (20.0, 5.0)]);
        let at = |seconds| {
            let time = GpsTime::from_week_seconds(2000, seconds);
            reference.at(time, 0.02, 1.5).map(|position| position.0.x)
        };
        assert_eq!(at(10.25), Some(1.5));
        assert_eq!(at(11.0), Some(3.0));
        assert_eq!((at(9.99), at(9.9)), (Some(1.0), None));
        assert_eq!((at(11.015), at(15.0), at(19.985)), (Some(3.0), None, Some(5.0)));
        assert_eq!((at(20.01), at(20.1)), (Some(5.0), None));
    }
}
