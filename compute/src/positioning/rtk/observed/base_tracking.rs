//! New data of rover and base at an epoch, and whether the base can be used.
//!
//! Shared by the graph and the filter, so that both see the same measurements and refuse the same
//! epochs.

use crate::gnss::{BaseStation, Ecef, GpsTime, Reason, SatelliteId};
use crate::models::geometric_range;
use crate::positioning::BasePositionVerdict;
use crate::positioning::aiding::TAG_SLACK_S;
use crate::positioning::differencing::{
    BaseSide, CommonSatellite, SignalLevels, SingleDifferences,
};
use crate::positioning::engine::EpochInputs;
use crate::positioning::spp::SinglePoint;
use crate::positioning::starts::are_refuting;
use crate::snapshot::state_fields;

use super::base::BaseMemory;
use super::losses::{LockWatch, Losses};

/// A base that can be used.
#[derive(Clone, Debug)]
pub(crate) struct UsableBase<'a> {
    pub(crate) station: &'a BaseStation,
    /// Age of its newest epoch (s).
    pub(crate) age_s: f64,
    /// Why its position is doubtful, if it is.
    pub(crate) position_warning: Option<Reason>,
}

/// New information about the base and about slips at an epoch.
#[derive(Debug)]
pub(crate) struct Received {
    pub(crate) losses: Losses,
    /// Distance between the last epoch's base and this one (m), if the base is another one.
    pub(crate) base_changed_m: Option<f64>,
    /// Distance between the base's last position and its present one (m), if the same base moved.
    pub(crate) base_moved_m: Option<f64>,
}

impl Received {
    /// Whether positions now refer to another point.
    pub(crate) fn is_moved(&self) -> bool {
        self.base_changed_m.is_some() || self.base_moved_m.is_some()
    }

    /// Why positions now refer to another point.
    pub(crate) fn reasons(&self) -> impl Iterator<Item = Reason> + use<> {
        let changed = self.base_changed_m.map(|distance_m| Reason::BaseChanged { distance_m });
        let moved = self.base_moved_m.map(|distance_m| Reason::BaseMoved { distance_m });
        changed.into_iter().chain(moved)
    }
}

/// Scratch for the differences of one epoch.
#[derive(Debug, Default)]
pub(crate) struct Intake {
    pub(crate) single_point: SinglePoint,
    pub(crate) differences: SingleDifferences,
    /// Satellites whose arcs ended at this epoch.
    pub(crate) slipped: Vec<SatelliteId>,
    residuals_m: Vec<f64>,
}

impl Intake {
    /// Whether the rover's pseudoranges of the epoch that was differenced refute a position.
    pub(crate) fn refutes(&mut self, rover: Ecef) -> bool {
        let Self { differences, residuals_m, .. } = self;
        residuals_m.clear();
        let miss_m = |common: &CommonSatellite| {
            common.rover_range_m - geometric_range(common.state.position, rover).0
        };
        residuals_m.extend(differences.satellites.iter().map(miss_m));
        are_refuting(residuals_m)
    }
}

/// The base, and the time of the newest answered epoch.
#[derive(Debug, Default)]
pub(crate) struct BaseTracking {
    base: BaseMemory,
    /// C/N0 levels of the rover's signals.
    levels: SignalLevels,
    /// Losses of lock at the rover.
    locks: LockWatch,
    /// Time of the newest epoch answered.
    last: Option<GpsTime>,
}

state_fields!(BaseTracking { base, levels, locks, last });

impl BaseTracking {
    /// Takes in an epoch and the new base epochs. `None`, and no change, if the epoch is not after
    /// the last one.
    pub(crate) fn receive(&mut self, inputs: &EpochInputs<'_>) -> Option<Received> {
        let epoch = inputs.epoch;
        if self.last.is_some_and(|last| epoch.time <= last) {
            return None;
        }
        self.last = Some(epoch.time);
        let (base, gap_s) = (inputs.base.as_ref(), inputs.options().rtk.arc_gap_s);
        let base_changed_m = base.and_then(|base| self.base.changed_m(base.station));
        if base_changed_m.is_some() {
            (self.base, self.levels) = (BaseMemory::default(), SignalLevels::default());
        }
        self.levels.learn(epoch);
        let base_moved_m = base.and_then(|base| self.base.moved_m(base.station));
        if let Some(base) = base {
            self.base.take(base.epochs, epoch.time, gap_s);
            self.base.know(base.station);
        }
        let mut rover = Vec::new();
        let watched = self.locks.take(epoch, gap_s, &mut rover);
        let of_base = self.base.take_losses();
        let losses = Losses {
            all: epoch.power_failure
                || of_base.power_failed
                || base_moved_m.is_some()
                || inputs.options().rtk.single_epoch,
            rover,
            base: of_base.lost,
            survival: watched.survival * of_base.survival,
            unobserved_s: watched.unobserved_s,
        };
        Some(Received { losses, base_changed_m, base_moved_m })
    }

    /// The base, or the reason why it cannot be used.
    pub(crate) fn usable<'a>(
        &mut self,
        inputs: &EpochInputs<'a>,
        single_point: &mut SinglePoint,
    ) -> Result<UsableBase<'a>, Reason> {
        let station = inputs.base.map(|base| base.station).ok_or(Reason::BaseMissing)?;
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let age_s = inputs.epoch.time - newest.time;
        if inputs.options().rtk.base_age_max_s + TAG_SLACK_S < age_s {
            return Err(Reason::BaseStale { age_s });
        }
        let check = self.base.checked(station, single_point, inputs);
        let distance_m = check.distance_m().unwrap_or(0.0);
        let position_warning = match check.verdict() {
            BasePositionVerdict::Unchecked | BasePositionVerdict::Agrees => None,
            BasePositionVerdict::Doubtful => Some(Reason::BasePositionDoubtful { distance_m }),
            BasePositionVerdict::Refused => {
                return Err(Reason::BasePositionDoubtful { distance_m });
            }
        };
        Ok(UsableBase { station, age_s, position_warning })
    }

    /// Differences an epoch against the base; `rover` is the approximate position of the rover.
    pub(crate) fn difference(
        &self,
        inputs: &EpochInputs<'_>,
        rover: Ecef,
        station: &BaseStation,
        differences: &mut SingleDifferences,
    ) -> Result<(), Reason> {
        let EpochInputs { epoch, navigation, .. } = *inputs;
        let length_m = rover.distance_m(station.antenna_reference_point);
        if inputs.options().rtk.baseline_max_m < length_m {
            return Err(Reason::BaselineTooLong { length_m });
        }
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let side = BaseSide { station, epoch: newest, levels: &self.levels };
        let gathered = differences.gather(epoch, rover, &side, navigation, inputs.options());
        gathered.ok_or(Reason::NotConverged)?;
        let (used, needed) = differences.used_and_needed();
        match used < needed {
            true => Err(Reason::TooFewCommonSatellites { used, needed }),
            false => Ok(()),
        }
    }
}
