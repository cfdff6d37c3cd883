//! The base between epochs of the rover.

use nalgebra::Vector3;

use crate::gnss::{BaseStation, Ecef, Epoch, GpsTime, ObservationCode, SatelliteId};
use crate::positioning::aiding::BASE_LATER_S;
use crate::positioning::engine::EpochInputs;
use crate::positioning::spp::SinglePoint;
use crate::snapshot::{snapshot_fields, state_fields};

/// Base epochs whose single-point positions are averaged to check the stated one.
const CHECKS_MAX: u32 = 10;
/// A base whose stated position changes by more has moved (m): RTCM resolves 0.1 mm.
const MOVED_M: f64 = 1e-3;

/// Difference between a base's stated position and its single points.
#[derive(Clone, Copy, Debug)]
struct PositionCheck {
    stated: Ecef,
    sum_m: Vector3<f64>,
    count: u32,
}

/// The newest base epoch, and where the base may have slipped since the rover's last epoch.
#[derive(Debug, Default)]
pub(crate) struct BaseMemory {
    /// Name and last position of the base.
    station: Option<(String, Ecef)>,
    newest: Option<Epoch>,
    /// Satellites and codes that lost lock.
    lost: Vec<(SatelliteId, ObservationCode)>,
    /// The base lost power.
    power_failed: bool,
    check: Option<PositionCheck>,
}

snapshot_fields!(PositionCheck { stated, sum_m, count });
state_fields!(BaseMemory { station, newest, lost, power_failed, check });

impl BaseMemory {
    /// Distance from the known base to this one, where this is another (m).
    pub(crate) fn changed_m(&self, station: &BaseStation) -> Option<f64> {
        let (_, known) = self.station.as_ref().filter(|(name, _)| *name != station.name)?;
        Some(known.distance_m(station.antenna_reference_point))
    }

    /// Keeps the name and position of the base.
    pub(crate) fn know(&mut self, station: &BaseStation) {
        let position = station.antenna_reference_point;
        match &mut self.station {
            Some((name, known)) if *name == station.name => *known = position,
            other => *other = Some((station.name.clone(), position)),
        }
    }

    /// Takes in the epochs that are new and not later than the rover's at `time`.
    pub(crate) fn take(&mut self, epochs: &[Epoch], time: GpsTime) {
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

    /// Distance of the stated position from the mean of the base's first ten single points (m);
    /// `None` while there is none.
    pub(crate) fn position_error_m(
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

    /// Distance that the base moved since it was used last (m); `None` where it has not. Its phases
    /// are then those of another position: no arc continues.
    pub(crate) fn moved_m(&self, station: &BaseStation) -> Option<f64> {
        let stated = self.check?.stated;
        Some(stated.distance_m(station.antenna_reference_point)).filter(|m| MOVED_M < *m)
    }

    /// The newest epoch.
    pub(crate) fn newest(&self) -> Option<&Epoch> {
        self.newest.as_ref()
    }

    /// Whether the base lost power since the last call, and what lost lock on it.
    pub(crate) fn take_losses(&mut self) -> (bool, Vec<(SatelliteId, ObservationCode)>) {
        (std::mem::take(&mut self.power_failed), std::mem::take(&mut self.lost))
    }
}
