//! Odometry of a recording: assigns rows to epochs.

use crate::formats::odometry::OdometryRow;
use crate::gnss::{GpsTime, Odometry};

/// Largest difference between the times of a row and of its epoch (s), and at most half of the
/// row's duration.
const NEAR_S: f64 = 0.05;

/// Rows that are assigned to epochs in the order of time.
#[derive(Debug)]
pub(super) struct OdometryRows {
    rows: Vec<OdometryRow>,
    next: usize,
    matched: usize,
}

impl OdometryRows {
    /// From rows in the order of their times.
    pub(super) fn new(rows: Vec<OdometryRow>) -> Self {
        Self { rows, next: 0, matched: 0 }
    }

    /// The displacement that ended at `time`; times must rise from call to call.
    pub(super) fn at(&mut self, time: GpsTime) -> Option<Odometry> {
        let late = |row: &&OdometryRow| NEAR_S < time - row.time;
        self.next += self.rows[self.next..].iter().take_while(late).count();
        let away_s = |index: usize| self.rows.get(index).map(|row| (row.time - time).abs());
        // Of two rows within the tolerance the nearer one.
        while let (Some(here), Some(further)) = (away_s(self.next), away_s(self.next + 1))
            && further < here
        {
            self.next += 1;
        }
        let near = self
            .rows
            .get(self.next)
            .filter(|row| (row.time - time).abs() <= NEAR_S.min(row.odometry.interval_s / 2.0))?;
        self.next += 1;
        self.matched += 1;
        Some(near.odometry)
    }

    /// The number of rows without an epoch.
    pub(super) fn unmatched(&self) -> usize {
        self.rows.len() - self.matched
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::gnss::OdometryFrame;

    fn rows(seconds: &[f64]) -> OdometryRows {
        let row = |second: &f64| OdometryRow {
            time: GpsTime::from_week_seconds(2051, *second),
            odometry: Odometry {
                interval_s: 1.0,
                frame: OdometryFrame::Enu,
                displacement_m: Vector3::new(*second, 0.0, 0.0),
                covariance: Matrix3::identity(),
            },
        };
        OdometryRows::new(seconds.iter().map(row).collect())
    }

    #[test]
    fn each_row_goes_to_the_epoch_it_is_near_to() {
        let mut rows = rows(&[0.5, 1.04, 2.0, 2.96, 3.01, 7.0]);
        let mut at = |second| {
            let found = rows.at(GpsTime::from_week_seconds(2051, second));
            found.map(|odometry| odometry.displacement_m.x)
        };
        assert_eq!([1.0, 2.0, 3.0, 4.0].map(&mut at), [Some(1.04), Some(2.0), Some(3.01), None]);
        assert_eq!(rows.unmatched(), 3);
    }
}
