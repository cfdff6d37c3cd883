//! The check of a base's stated position.
//!
//! The base's own single-point positions, each wrong by some metres, are averaged over ten epochs
//! and compared with the stated position. Both the desk for bases and the RTK estimators use this
//! check.

use nalgebra::Vector3;

use crate::gnss::Ecef;
use crate::snapshot::snapshot_fields;

/// Epochs whose single-point positions are averaged.
const EPOCHS_MAX: u32 = 10;
/// Beyond this distance a position is doubtful (m): single-point positions are wrong by some
/// metres.
const DOUBTFUL_M: f64 = 10.0;
/// Beyond this distance a position is refused (m).
const REFUSED_M: f64 = 100.0;

/// The stated position of a base compared with the mean of its single-point positions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BasePositionCheck {
    sum_m: Vector3<f64>,
    /// Number of epochs with a single-point position so far; zero if there is no navigation data of
    /// their time.
    pub epochs: u32,
}

snapshot_fields!(BasePositionCheck { sum_m, epochs });

/// The result of a check, from good to bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BasePositionVerdict {
    /// No epoch has checked the position.
    Unchecked,
    /// The position agrees with the base's own.
    Agrees,
    /// The position may be wrong: it is used, with a warning.
    Doubtful,
    /// The position is wrong: it is not used.
    Refused,
}

impl BasePositionCheck {
    /// A check without epochs.
    pub fn new() -> Self {
        Self { sum_m: Vector3::zeros(), epochs: 0 }
    }

    /// Whether enough epochs have been added.
    pub const fn is_done(&self) -> bool {
        EPOCHS_MAX <= self.epochs
    }

    /// Adds a single-point position of a base whose antenna reference point is stated.
    pub fn add(&mut self, stated: Ecef, observed: Ecef) {
        self.sum_m += observed.0 - stated.0;
        self.epochs += 1;
    }

    /// Distance from the stated antenna reference point to the mean single-point position (m).
    pub fn distance_m(&self) -> Option<f64> {
        (0 < self.epochs).then(|| self.sum_m.norm() / f64::from(self.epochs))
    }

    /// The verdict that follows from the distance.
    pub fn verdict(&self) -> BasePositionVerdict {
        match self.distance_m() {
            None => BasePositionVerdict::Unchecked,
            Some(distance_m) if REFUSED_M < distance_m => BasePositionVerdict::Refused,
            Some(distance_m) if DOUBTFUL_M < distance_m => BasePositionVerdict::Doubtful,
            Some(_) => BasePositionVerdict::Agrees,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of two positions 8 m and 4 m off in opposite directions, the mean is 2 m off.
    #[test]
    fn the_mean_distance_decides() {
        let stated = Ecef::new(4e6, 0.0, 0.0);
        let mut check = BasePositionCheck::new();
        assert_eq!((check.distance_m(), check.verdict()), (None, BasePositionVerdict::Unchecked));
        check.add(stated, Ecef::new(4e6, 8.0, 0.0));
        check.add(stated, Ecef::new(4e6, -4.0, 0.0));
        assert_eq!((check.distance_m(), check.verdict()), (Some(2.0), BasePositionVerdict::Agrees));
        check.add(stated, Ecef::new(4e6, 0.0, 60.0));
        assert_eq!(check.verdict(), BasePositionVerdict::Doubtful);
        check.add(stated, Ecef::new(4e6, 0.0, 600.0));
        assert_eq!(check.verdict(), BasePositionVerdict::Refused);
        assert!(!check.is_done());
    }
}
