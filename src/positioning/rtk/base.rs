//! What is remembered of the base between epochs of the rover.

use nalgebra::Vector3;

use crate::gnss::{BaseStation, Ecef, Epoch, GpsTime, ObservationCode, SatelliteId};
use crate::positioning::aiding::BASE_LATER_S;
use crate::positioning::engine::EpochInputs;
use crate::positioning::spp::SinglePoint;
use crate::snapshot::{snapshot_fields, state_fields};

/// Base epochs whose single-point positions are averaged to check the stated one.
const CHECKS_MAX: u32 = 10;
/// A base whose stated position changes by more has moved (m): messages tell tenths of millimetres.
const MOVED_M: f64 = 1e-3;

/// How far the stated position of a base is from what the base observes.
#[derive(Clone, Copy, Debug)]
struct PositionCheck {
    stated: Ecef,
    sum_m: Vector3<f64>,
    count: u32,
}

/// The newest base epoch, and where the base may have slipped since it was last used.
#[derive(Debug, Default)]
pub(super) struct BaseMemory {
    /// The name of the base, and where it stood last.
    station: Option<(String, Ecef)>,
    newest: Option<Epoch>,
    /// Satellites and codes that lost lock.
    pub(super) lost: Vec<(SatelliteId, ObservationCode)>,
    /// The base lost power.
    pub(super) power_failed: bool,
    check: Option<PositionCheck>,
}

snapshot_fields!(PositionCheck { stated, sum_m, count });
state_fields!(BaseMemory { station, newest, lost, power_failed, check });

impl BaseMemory {
    /// From the base that is remembered to this one, where it is another (m).
    pub(super) fn changed_m(&self, station: &BaseStation) -> Option<f64> {
        let (_, place) = self.station.as_ref().filter(|(name, _)| *name != station.name)?;
        Some(place.distance_m(station.antenna_reference_point))
    }

    /// Remembers which base it is.
    pub(super) fn know(&mut self, station: &BaseStation) {
        let place = station.antenna_reference_point;
        match &mut self.station {
            Some((name, known)) if *name == station.name => *known = place,
            other => *other = Some((station.name.clone(), place)),
        }
    }

    /// Takes the epochs that are new and not later than the rover's at `time`.
    pub(super) fn take(&mut self, epochs: &[Epoch], time: GpsTime) {
        for epoch in epochs {
            let is_new = self.newest.as_ref().is_none_or(|newest| newest.time < epoch.time);
            if !is_new || BASE_LATER_S < epoch.time - time {
                continue;
            }
            self.power_failed |= epoch.power_failure;
            let slipped = epoch.observations.iter().filter(|o| o.loss_of_lock);
            self.lost.extend(slipped.map(|o| (o.satellite, o.code)));
            match &mut self.newest {
                Some(newest) => {
                    newest.time = epoch.time;
                    newest.power_failure = epoch.power_failure;
                    newest.observations.clone_from(&epoch.observations);
                }
                None => self.newest = Some(epoch.clone()),
            }
        }
    }

    /// How far the stated position is from the mean of the base's own single-point positions (m),
    /// ten epochs of which are taken; `None` while there is none.
    pub(super) fn position_error_m(
        &mut self,
        station: &BaseStation,
        single_point: &mut SinglePoint,
        inputs: &EpochInputs<'_>,
    ) -> Option<f64> {
        let stated = station.antenna_reference_point;
        let fresh = PositionCheck { stated, sum_m: Vector3::zeros(), count: 0 };
        let mut check = self.check.filter(|check| check.stated == stated).unwrap_or(fresh);
        if check.count < CHECKS_MAX
            && let Some(newest) = &self.newest
        {
            let of_base = EpochInputs { epoch: newest, ..*inputs };
            let alone = single_point.solve(&of_base, Some(stated));
            if let Some(estimate) = alone.estimate {
                check.sum_m += estimate.position.0 - stated.0;
                check.count += 1;
            }
        }
        self.check = Some(check);
        (0 < check.count).then(|| check.sum_m.norm() / f64::from(check.count))
    }

    /// How far the base moved since it was used last (m); `None` where it stands where it stood.
    ///
    /// Its phases are then those of another place, and none of them can be relied upon to go on.
    pub(super) fn moved_m(&self, station: &BaseStation) -> Option<f64> {
        let stated = self.check?.stated;
        Some(stated.distance_m(station.antenna_reference_point)).filter(|m| MOVED_M < *m)
    }

    /// The newest epoch.
    pub(super) fn newest(&self) -> Option<&Epoch> {
        self.newest.as_ref()
    }

    /// Forgets the slips, which have been dealt with.
    pub(super) fn settle(&mut self) {
        self.lost.clear();
        self.power_failed = false;
    }
}
