//! Positions from above, thinned while they come: one of each status in each cell of a grid.

use std::collections::HashSet;

use crate::gnss::Status;

/// Most positions.
const LIMIT: usize = 4096;
/// Size of a cell at first (m).
const SMALLEST_CELL_M: f64 = 1e-3;
/// Positions further from the first one are left out: a quarter of the way around the Earth (m).
const FARTHEST_M: f64 = 1e7;

type Cell = (i64, i64, Status);

/// Positions east and north of the first one (m). When there are too many, the cells become twice
/// as large.
#[derive(Debug)]
pub(super) struct TrackCells {
    cell_m: f64,
    taken: HashSet<Cell>,
    points: Vec<((f64, f64), Status)>,
}

impl TrackCells {
    pub(super) fn new() -> Self {
        Self { cell_m: SMALLEST_CELL_M, taken: HashSet::new(), points: Vec::new() }
    }

    pub(super) fn add(&mut self, east_m: f64, north_m: f64, status: Status) {
        let is_near = |value_m: f64| value_m.abs() <= FARTHEST_M;
        if !is_near(east_m) || !is_near(north_m) {
            return;
        }
        let point = ((east_m, north_m), status);
        if self.taken.insert(self.cell(&point)) {
            self.points.push(point);
        }
        while LIMIT < self.points.len() {
            self.coarsen();
        }
    }

    fn cell(&self, ((east_m, north_m), status): &((f64, f64), Status)) -> Cell {
        let index = |value_m: f64| (value_m / self.cell_m).floor() as i64;
        (index(*east_m), index(*north_m), *status)
    }

    fn coarsen(&mut self) {
        self.cell_m *= 2.0;
        let mut taken = HashSet::new();
        let points = std::mem::take(&mut self.points);
        let kept = points.into_iter().filter(|point| taken.insert(self.cell(point)));
        self.points = kept.collect();
        self.taken = taken;
    }

    /// The positions that remain, in their order.
    pub(super) fn points(&self) -> &[((f64, f64), Status)] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_track_keeps_its_shape() {
        let mut track = TrackCells::new();
        for second in 0..86_400 {
            let status = if second % 2 == 0 { Status::Fixed } else { Status::Float };
            track.add(f64::from(second) * 0.3, 1.0, status);
        }
        let points = track.points();
        assert!(LIMIT / 4 < points.len() && points.len() <= LIMIT, "{}", points.len());
        assert_eq!(points[0].0, (0.0, 1.0));
        let farthest_m = points.iter().map(|point| point.0.0).fold(0.0, f64::max);
        assert!(86_399.0 * 0.3 - 60.0 < farthest_m, "{farthest_m}");
    }

    #[test]
    fn standing_still_is_one_point_of_each_status() {
        let mut track = TrackCells::new();
        for _ in 0..10 {
            track.add(0.0001, 0.0002, Status::Fixed);
            track.add(0.0001, 0.0002, Status::Single);
            track.add(f64::NAN, 0.0, Status::Single);
            track.add(0.0, f64::INFINITY, Status::Single);
        }
        assert_eq!(track.points().len(), 2);
    }
}
